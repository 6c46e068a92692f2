"""Runs of a task for detectors: the onsets are as they are said to be, and passes are shared."""

from __future__ import annotations

import numpy as np
import pytest

from spoofgym.attacks import make_attack
from spoofgym.bench.runs.panel import (
    MOST_TRIED,
    NearAlarm,
    Panel,
    PanelAttack,
    generators,
    in_any_world,
    select_runs,
)
from spoofgym.bench.runs.play import WarmStart, play
from spoofgym.bench.runs.record import compute_displacement
from spoofgym.bench.runs.world import World
from spoofgym.detectors import Calibrated, Never, PooledDetector, SnapshotChi2, make_detector
from spoofgym.tasks import CANDIDATES, SWITCH_WITHIN_S, TURNING_DEGPS

from .detector_support import small_task

TEST = {"name": "snapshot-chi2", "signals": "range_rate", "thresholds": "nominal"}
RAMP = {"name": "ramp", "rate_mps": 0.4}
MEACONER = {"name": "meaconer"}


@pytest.fixture(scope="module")
def setup():
    return World(settings=small_task().world_kwargs).setup


def rngs_of(setup, numbers, split="evaluation"):
    return lambda: generators(setup, 0, split, np.asarray(numbers))


def heading_rate(setup, epoch):
    """Turn of the track at an epoch, from positions alone [deg/s]."""
    step = setup.true_position[epoch - 1 : epoch + 3]
    moved = np.diff(step, axis=0) @ setup.C_en[epoch]
    heading = np.unwrap(np.arctan2(moved[:, 1], moved[:, 0]))
    return np.degrees(np.abs(heading[-1] - heading[0])) / (2.0 * setup.interval_s)


def test_in_a_turn_the_flight_turns_at_the_onset(setup):
    numbers = select_runs(setup, 0, "evaluation", 12, "turn")
    start = WarmStart(setup.copy_with(detector=Never()), rngs_of(setup, numbers)(), threads=1)
    onset = play(start, "none").onset
    assert all(heading_rate(setup, k) > 0.5 * TURNING_DEGPS for k in onset)
    # and others do not
    everyone = select_runs(setup, 0, "evaluation", int(numbers[-1]) + 1, None)
    left = sorted({*everyone.tolist()} - {*numbers.tolist()})[:8]
    start = WarmStart(setup.copy_with(detector=Never()), rngs_of(setup, left)(), threads=1)
    onset = play(start, "none").onset
    assert all(heading_rate(setup, k) < 1.5 * TURNING_DEGPS for k in onset)


def test_at_a_switch_a_satellite_rises_or_sets_within_the_time(setup):
    numbers = select_runs(setup, 0, "evaluation", 12, "satellite-switch")
    start = WarmStart(setup.copy_with(detector=Never()), rngs_of(setup, numbers)(), threads=1)
    onset = play(start, "none").onset
    span = round(SWITCH_WITHIN_S / setup.interval_s)
    for k in onset:
        world = k // setup.epochs_each * setup.epochs_each
        near = slice(max(k - span, world), min(k + span, world + setup.epochs_each - 1) + 1)
        seen = setup.world.visible[near]
        assert (seen != seen[0]).any()


def test_where_there_is_none_it_is_said(setup, monkeypatch):
    monkeypatch.setitem(
        __import__("spoofgym.bench.runs.panel", fromlist=["CONDITIONS"]).CONDITIONS,
        "turn",
        lambda setup: np.zeros(len(setup.epoch_time), dtype=np.bool_),
    )
    monkeypatch.setattr("spoofgym.bench.runs.panel.MOST_TRIED", 1024)
    with pytest.raises(ValueError, match="of 1024 runs in trolley only 0 have an onset at a turn"):
        select_runs(setup, 0, "evaluation", 2, "turn")
    assert MOST_TRIED > 1024


def test_detectors_that_share_a_pass_get_what_each_gets_alone(setup):
    tight = Calibrated(SnapshotChi2(), scale=0.3)
    judges = [make_detector(TEST), tight, make_detector({**TEST, "name": "shewhart"})]
    rngs = rngs_of(setup, range(9))
    together = Panel(setup, judges, rngs, 1)
    moved = together.displacement(PanelAttack(RAMP, 9))
    few = together.displacement(PanelAttack(RAMP, 4))
    np.testing.assert_array_equal(few, moved[:, :4])
    for k, judge in enumerate(judges):
        alone = Panel(setup, [judge], rngs, 1)
        np.testing.assert_array_equal(alone.displacement(PanelAttack(RAMP, 9))[0], moved[k])
        np.testing.assert_array_equal(alone.counts[:, 0], together.counts[:, k])
        np.testing.assert_array_equal(alone.twin_alarm[:, 0], together.twin_alarm[:, k])
        start = WarmStart(setup.copy_with(detector=judge), rngs(), threads=1)
        own = compute_displacement(setup, play(start, RAMP), play(start, "none"))
        np.testing.assert_allclose(own, moved[k], atol=1e-6)
    assert (moved[1] < moved[0]).any()  # they do not all say the same


def test_attacks_side_by_side_are_what_each_is_alone(setup):
    """Also with a spoofer that reads statistics, and in front of some of the detectors."""
    judges = [make_detector(TEST), Calibrated(SnapshotChi2(), scale=0.3), Never()]
    panel = Panel(setup, judges, rngs_of(setup, range(9)), 1)
    attacks = [
        (PanelAttack(RAMP, 9), 0),
        (PanelAttack({**RAMP, "rate_mps": 0.1}, 9), 0),
        (PanelAttack({"name": "step", "size_m": 20.0}, 5), 0),
        (PanelAttack(RAMP, 9), 1),
        (PanelAttack({"name": "feedback", "amplitude": 0.5}, 9), 1),
        (PanelAttack({"name": "profile", "rates_mps": [0.0, 0.3]}, 7), 1),
    ]
    for drop in (False, True):
        for (attack, number), runs in zip(attacks, panel.play(attacks, drop=drop), strict=True):
            alone = WarmStart(
                setup.copy_with(detector=judges[number]), rngs_of(setup, range(9))(), threads=1
            ).first(attack.runs)
            wanted = play(alone, attack.spec)
            np.testing.assert_array_equal(runs.first_alarm, wanted.first_alarm)
            if not drop:
                for mine, own in zip(runs, wanted, strict=True):
                    np.testing.assert_array_equal(mine, own)
    assert not panel.warmup_alarm[:, 2].any()


def test_a_tighter_threshold_never_lets_an_attack_farther(setup):
    loose, tight = (Calibrated(SnapshotChi2(), scale=scale) for scale in (0.6, 0.3))
    panel = Panel(setup, [loose, tight], rngs_of(setup, range(12)), 1)
    shorter = 0
    for rate in (0.1, 0.3, 0.5):
        far, near = panel.displacement(PanelAttack({**RAMP, "rate_mps": rate}, 12))
        assert (near <= far).all()
        shorter += int((near < far).sum())
    assert shorter  # the thresholds matter


def test_an_attack_of_its_own_meets_the_same_runs(setup):
    panel = Panel(setup, [Never(), make_detector(TEST)], rngs_of(setup, range(4)), 1)
    idle = {"name": "profile", "rates_mps": [0.0, 0.0]}
    assert np.abs(panel.displacement(PanelAttack(idle, 4))).max() == 0.0
    near, far = (
        panel.displacement(
            PanelAttack(idle, 4, make_attack({**MEACONER, "antenna_m": [0.0, x, 0.0]}))
        )
        for x in (4.0, 8.0)
    )
    # the filter comes nearer to the antenna for as long as the window lasts, in proportion
    assert (near[0] > 1.0).all()
    assert (near[0] < 4.0).all()
    np.testing.assert_allclose(far[0], 2.0 * near[0], rtol=0.05)
    assert (near[1] <= near[0]).all()


def test_near_an_alarm_are_those_whose_statistic_was_largest(setup):
    judge = make_detector(TEST)
    runs = 3
    found = NearAlarm(setup, judge, rngs_of(setup, range(CANDIDATES * runs)), 1)
    assert found.runs == runs
    start = WarmStart(setup.copy_with(detector=judge), rngs_of(setup, range(12))(), threads=1)
    engine_rngs = rngs_of(setup, range(12))()
    simulator = setup.copy_with(detector=judge).simulator(12, lambda work, count: work(0, count))
    simulator.start_episodes(engine_rngs)
    simulator.run_filter_only(setup.filter_only)
    largest = np.zeros(12)
    for _ in range(setup.live):  # which is shorter than the time that counts
        simulator.step(attacked=False)
        largest = np.maximum(largest, simulator.ratio())
    np.testing.assert_allclose(np.sort(found.ratio), np.sort(largest)[-runs:])
    chosen = np.sort(np.argsort(-largest, kind="stable")[:runs])
    twin = play(start, "none")
    np.testing.assert_array_equal(found.sky, (twin.onset // setup.epochs_each)[chosen])
    np.testing.assert_array_equal(found.counts[:, 0], (twin.first_alarm == 0)[chosen])
    # an attack of its own meets the same runs: replayed where the target is, it moves nothing
    assert len(found.rngs()) == runs
    there = make_attack({**MEACONER, "antenna_m": [0.0, 0.0, 0.0]})
    still = Panel(setup, [judge], rngs_of(setup, chosen), 1)
    idle = {"name": "profile", "rates_mps": [0.0, 0.0]}
    attack = PanelAttack(idle, runs, there)
    np.testing.assert_allclose(found.displacement(attack), still.displacement(attack), atol=1e-6)


def test_thresholds_go_along_into_any_world():
    scaled = Calibrated(SnapshotChi2(), scale=0.4)
    scaled.resolved_for = "another world"
    settled = in_any_world(scaled)
    assert (settled.scale, settled.resolved_for) == (0.4, None)
    pool = in_any_world(PooledDetector([scaled, Never()], [1, 3]))
    assert [getattr(each, "scale", None) for each in pool.judges] == [0.4, None]
    assert pool.weights == [1, 3]
