"""One cell: shared warm-ups, dropped runs and observations change no bit."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from spoofgym.bench.runs.play import (
    SpooferController,
    WarmStart,
    induced_error,
    make_bound_spoofer,
    play,
)
from spoofgym.bench.runs.record import compute_displacement, record_runs
from spoofgym.detectors import Ewma
from spoofgym.simulation import Engine
from spoofgym.spoofers import Spoofer

from .support import Mirror, small_suite

FAST = {"name": "ramp", "rate_mps": 0.6}
RUNS = 40


def start_of(runs=RUNS, threads=1, split="evaluation", **changes):
    # a low threshold, so that some runs of twenty seconds alarm and others do not
    suite = small_suite(**{"detectors": (Ewma(false_alarm=0.02),), **changes})
    setup = suite.setup(suite.detector_players[0])
    return WarmStart(setup, suite.generators(split, runs), threads=threads), suite


@pytest.fixture(scope="module")
def start():
    return start_of()[0]


@pytest.fixture(scope="module")
def clean(start):
    return play(start, "none")


@pytest.fixture(scope="module")
def fast(start):
    play(start, "step")
    return play(start, FAST)


def test_neither_shared_warm_ups_nor_other_cells_threads_or_runs_change_a_bit(start, fast):
    setup = start.setup
    _, suite = start_of()
    engine = Engine(RUNS, setup, threads=1)
    engine.reset(suite.generators("evaluation", RUNS))
    spoofer, observer, _ = make_bound_spoofer(FAST, setup, RUNS)
    for k in range(setup.steps + setup.hold):
        action = spoofer.act(observer(engine, k)) if k < setup.steps else None
        verdict = engine.step(action)
        np.testing.assert_array_equal(fast.position[k], engine.simulator.position)
        np.testing.assert_array_equal(fast.alarm[k], verdict.alarm.any(axis=1))
    fresh, _ = start_of(threads=2)
    np.testing.assert_array_equal(fresh._engine.simulator.weights, start.engine().simulator.weights)
    for one, other in (
        (play(fresh, FAST), fast),
        (play(fresh, Mirror()), play(start, Mirror())),
        (play(start.first(7), FAST), fast.first(7)),
    ):
        for mine, theirs in zip(one, other, strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_dropping_settled_runs_changes_no_score_and_a_cell_scores_as_a_search_does(
    start, clean, fast
):
    dropped = play(start, FAST, drop_alarmed=True)
    assert 0.3 < fast.alarm.any(axis=0).mean() < 1.0
    assert np.isnan(dropped.position).any()
    np.testing.assert_array_equal(fast.first_alarm, dropped.first_alarm)
    scores = [compute_displacement(start.setup, each, clean) for each in (fast, dropped)]
    np.testing.assert_array_equal(*scores)
    known = np.isfinite(dropped.position)
    np.testing.assert_array_equal(fast.position[known], dropped.position[known])
    cell = record_runs(start.setup, {}, start.warmup_alarm, fast, clean, 40.0)
    so_far = np.logical_or.accumulate(fast.alarm, axis=0)
    np.testing.assert_allclose(cell.series["alarmed"], so_far.mean(axis=1), atol=1e-6)
    assert 0.0 < cell.series["alarmed"][0] < cell.series["alarmed"][-1] < 1.0
    scored = compute_displacement(start.setup, fast, clean)
    np.testing.assert_allclose(scored, cell.records["undetected_displacement_m"], atol=1e-6)


@pytest.mark.parametrize("interval_s", [None, 2.0])
def test_a_spoofer_decides_nothing_after_the_attack_window(interval_s):
    start, _ = start_of(2, decision_interval_s=interval_s)
    attacker, setup = SpooferController([FAST], start.engine()), start.setup
    given = [attacker.command(k) is not None for k in range(setup.steps + setup.hold)]
    assert given == [True] * setup.steps + [False] * setup.hold


def test_no_attack_induces_nothing_and_a_slow_one_carries_the_victim_along(start, clean):
    still, slow = (play(start, {**FAST, "rate_mps": rate}) for rate in (0.0, 0.1))
    assert not induced_error(start.setup, still, clean).any()
    assert not compute_displacement(start.setup, still, clean).any()
    error = induced_error(start.setup, slow, clean)[start.setup.steps - 1]
    assert error.mean() == pytest.approx(0.1 * (20.0 - 1.0), rel=0.5)


def test_no_attack_is_not_seen_by_its_tracking_error():
    few = {"runs": 4, "split": "training", "detectors": ("snapshot-chi2",)}
    tracked = {"name": "tracking-1m", "tracking": {"sd_m": 5.0}}
    start, other = (start_of(**few, attack=x)[0] for x in (tracked, "false-position-ideal"))
    clean = play(start, "none", drop_alarmed=True)
    np.testing.assert_array_equal(clean.position, play(other, "none").position)
    still = play(start, {"name": "ramp", "rate_mps": 0.0})
    assert (still.peak > 2.0 * clean.peak).all()


@dataclass
class Wild(Spoofer):
    value: float = 0.0
    wide: int = 0
    knowledge: ClassVar[str] = "blind"

    def act(self, observation):
        a = len(self.context.action_names) + self.wide
        return np.full((len(observation), a), self.value)


def test_bad_actions_are_refused(start):
    for spoofer, message in (
        (Wild(float("nan")), r"Wild must return actions within \[-1, 1\], got nan"),
        (Wild(wide=1), r"actions of shape \(40, 2\) .* got \(40, 3\)"),
    ):
        with pytest.raises(ValueError, match=message):
            play(start, spoofer)
