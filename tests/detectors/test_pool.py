"""A hidden pool: one of its detectors judges a whole episode, whoever else is in the batch."""

import json

import numpy as np
import pytest

from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.runs.play import WarmStart, play
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.runs.world import PLAIN_ID
from spoofgym.detectors import Calibrated, PooledDetector, SnapshotChi2, make_detector

from .support import context, epoch

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 2.0}
SHARP = {"name": "snapshot-chi2", "false_alarm": 0.5}
MEMBERS = ["ewma", SHARP, "never"]
POOL = {"name": "pool", "members": MEMBERS}
LAX = {"name": "solution-separation", "false_alarm": 0.1, "longest_s": 20.0, "spacing_s": 5.0}


def played(detector, runs=12, rows=None):
    suite = Suite(env=PLAIN_ID, detectors=[detector], timeline=SHORT, runs=2)
    rngs = suite.generators("training", runs)
    if rows is not None:
        rngs = [rngs[row] for row in rows]
    start = WarmStart(suite.setup(suite.detector_players[0]), rngs, threads=1)
    memory = start.engine().simulator.detector.memory
    return play(start, {"name": "ramp", "rate_mps": 0.5}), memory


@pytest.mark.parametrize(
    "members", [MEMBERS, [LAX, {**LAX, "false_alarm": 1e-3}, "never"]], ids=["all", "some"]
)
def test_every_run_is_judged_by_the_detector_that_was_drawn(members):
    pool = {"name": "pool", "members": members}
    pooled, memory = played(pool)
    opponent = memory["opponent"]
    assert set(opponent) == {0, 1, 2}
    for k, member in enumerate(members):
        alone, _ = played(member)
        own = opponent == k
        np.testing.assert_array_equal(pooled.alarm[:, own], alone.alarm[:, own])
        np.testing.assert_array_equal(pooled.position[:, own], alone.position[:, own])
        np.testing.assert_array_equal(pooled.peak[own], alone.peak[own])
    if members is MEMBERS:
        _, weighed = played({**pool, "weights": [0.0, 1.0, 0.0]})
        assert (weighed["opponent"] == 1).all()
        some, few = played(pool, rows=[7, 2])
        np.testing.assert_array_equal(few["opponent"], opponent[[7, 2]])
        np.testing.assert_array_equal(some.position, pooled.position[:, [7, 2]])
    else:
        np.testing.assert_array_equal(memory.parts[0]["epochs"] > 0, opponent == 0)


class Careless(SnapshotChi2):
    def judge(self, epoch):
        if self.judged_rows is not None:
            raise RuntimeError(f"asked for {len(self.judged_rows)}")
        return super().judge(epoch)


def test_a_detector_knows_whom_it_judges_only_while_a_pool_asks():
    pool = PooledDetector([Calibrated(Careless(), scale=1.0), "never"])
    pool.bind(context(2, 4))
    with pytest.raises(RuntimeError, match="asked for 2"):
        pool.judge(epoch(np.zeros((2, 8)), np.eye(8)))
    judge = pool.judges[0]
    assert judge.judged_rows is judge.detector.judged_rows is None


def test_its_settings_are_written_down_and_make_it_again():
    entry = specify_detector(POOL)
    assert entry.label == "pool(members=ewma+snapshot-chi2+never)"
    told = json.loads(json.dumps(entry.spec))
    whole = {"signals": "both", "bias_window_s": 0.0, "two_sided": False}
    assert told["members"][1] == {**SHARP, **whole}
    assert specify_detector(told) == entry
    assert make_detector(make_detector(POOL)).members == make_detector(told).members


@pytest.mark.parametrize(
    ("members", "scope", "measures", "oracle"),
    [
        (MEMBERS, "receiver", "satellites", False),
        (["ewma", "cusum"], "channel", "satellites", False),
        (["rio", "never"], "receiver", "position", False),
        (["oracle-step", "ewma"], "channel", "satellites", True),
    ],
)
def test_what_a_pool_has_in_common(members, scope, measures, oracle):
    pool = make_detector({"name": "pool", "members": members})
    assert (pool.scope, pool.measures, pool.oracle) == (scope, measures, oracle)
    assert pool.needs == frozenset().union(*(judge.needs for judge in pool.judges))


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"members": []}, "at least one opponent, got none"),
        ({"members": "ewma"}, "`members` must be a list of detectors, got 'ewma'"),
        ({"members": [POOL]}, "can't be one of the detectors of a pool"),
        ({"members": ["ewma", "rio"]}, r"the same, got Ewma \(satellites\), Rio \(position\)"),
        ({"members": ["ewma"], "weights": [1.0, 2.0]}, "one number for each of the 1 opponents"),
        ({"members": ["ewma"], "weights": [0.0]}, "not all 0"),
    ],
)
def test_what_no_pool_is(settings, told):
    with pytest.raises((ValueError, TypeError), match=told):
        PooledDetector(**settings)
