"""Runs of a task for detectors: the onsets are as they are said to be, and passes are shared."""

import numpy as np
import pytest

from spoofgym.attacks import make_attack
from spoofgym.bench.runs import panel as module
from spoofgym.bench.runs.panel import NearAlarm, Panel, PanelAttack, generators, select_runs
from spoofgym.bench.runs.play import WarmStart, play
from spoofgym.bench.runs.record import compute_displacement
from spoofgym.bench.runs.world import World
from spoofgym.detectors import Calibrated, Never, PooledDetector, SnapshotChi2, make_detector
from spoofgym.tasks import CANDIDATES, SWITCH_WITHIN_S, TURNING_DEGPS

from .detector_support import small_task

TEST = {"name": "snapshot-chi2", "signals": "range_rate", "thresholds": "nominal"}
RAMP = {"name": "ramp", "rate_mps": 0.4}
IDLE = {"name": "profile", "rates_mps": [0.0, 0.0]}


@pytest.fixture(scope="module")
def setup():
    return World(settings=small_task().world_kwargs).setup


def rngs_of(setup, numbers):
    return lambda: generators(setup, 0, "evaluation", np.asarray(numbers))


def start_of(setup, judge, numbers):
    return WarmStart(setup.copy_with(detector=judge), rngs_of(setup, numbers)(), threads=1)


def meaconer(east_m):
    return make_attack({"name": "meaconer", "antenna_m": [0.0, east_m, 0.0]})


def heading_rate(setup, epoch):
    """Turn of the track at an epoch, from positions alone [deg/s]."""
    moved = np.diff(setup.true_position[epoch - 1 : epoch + 3], axis=0) @ setup.C_en[epoch]
    heading = np.unwrap(np.arctan2(moved[:, 1], moved[:, 0]))
    return np.degrees(np.abs(heading[-1] - heading[0])) / (2.0 * setup.interval_s)


def test_onsets_are_at_a_turn_or_a_switch_of_satellites_where_that_is_said(setup, monkeypatch):
    numbers = select_runs(setup, 0, "evaluation", 12, "turn")
    everyone = select_runs(setup, 0, "evaluation", int(numbers[-1]) + 1, None)
    left = sorted({*everyone.tolist()} - {*numbers.tolist()})[:8]
    switch = select_runs(setup, 0, "evaluation", 12, "satellite-switch")
    turning, others, switching = (
        play(start_of(setup, Never(), each), "none").onset for each in (numbers, left, switch)
    )
    assert all(heading_rate(setup, k) > 0.5 * TURNING_DEGPS for k in turning)
    assert all(heading_rate(setup, k) < 1.5 * TURNING_DEGPS for k in others)
    span = round(SWITCH_WITHIN_S / setup.interval_s)
    for k in switching:
        world = k // setup.epochs_each * setup.epochs_each
        near = slice(max(k - span, world), min(k + span, world + setup.epochs_each - 1) + 1)
        seen = setup.world.visible[near]
        assert (seen != seen[0]).any()
    never = np.zeros(len(setup.epoch_time), dtype=np.bool_)
    monkeypatch.setitem(module.CONDITIONS, "turn", lambda setup: never)
    monkeypatch.setattr(module, "MOST_TRIED", 1024)
    with pytest.raises(ValueError, match="of 1024 runs in trolley only 0 have an onset at a turn"):
        select_runs(setup, 0, "evaluation", 2, "turn")


def test_detectors_that_share_a_pass_get_what_each_gets_alone(setup):
    tight = Calibrated(SnapshotChi2(), scale=0.3)
    judges = [make_detector(TEST), tight, make_detector({**TEST, "name": "shewhart"})]
    together = Panel(setup, judges, rngs_of(setup, range(9)), 1)
    moved = together.displacement(PanelAttack(RAMP, 9))
    np.testing.assert_array_equal(together.displacement(PanelAttack(RAMP, 4)), moved[:, :4])
    for k, judge in enumerate(judges):
        alone = Panel(setup, [judge], rngs_of(setup, range(9)), 1)
        np.testing.assert_array_equal(alone.displacement(PanelAttack(RAMP, 9))[0], moved[k])
        np.testing.assert_array_equal(alone.counts[:, 0], together.counts[:, k])
        np.testing.assert_array_equal(alone.twin_alarm[:, 0], together.twin_alarm[:, k])
        start = start_of(setup, judge, range(9))
        own = compute_displacement(setup, play(start, RAMP), play(start, "none"))
        np.testing.assert_allclose(own, moved[k], atol=1e-6)
    assert (moved[1] < moved[0]).any()  # they do not all say the same


def test_attacks_side_by_side_are_what_each_is_alone(setup):
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
    wanted = [
        play(start_of(setup, judges[number], range(9)).first(attack.runs), attack.spec)
        for attack, number in attacks
    ]
    for drop in (False, True):
        for runs, alone in zip(panel.play(attacks, drop=drop), wanted, strict=True):
            np.testing.assert_array_equal(runs.first_alarm, alone.first_alarm)
            if not drop:
                for mine, own in zip(runs, alone, strict=True):
                    np.testing.assert_array_equal(mine, own)
    assert not panel.warmup_alarm[:, 2].any()


def test_an_attack_of_its_own_meets_the_same_runs(setup):
    panel = Panel(setup, [Never(), make_detector(TEST)], rngs_of(setup, range(4)), 1)
    assert np.abs(panel.displacement(PanelAttack(IDLE, 4))).max() == 0.0
    near, far = (panel.displacement(PanelAttack(IDLE, 4, meaconer(x))) for x in (4.0, 8.0))
    # the filter comes nearer to the antenna for as long as the window lasts, in proportion
    assert ((near[0] > 1.0) & (near[0] < 4.0)).all()
    np.testing.assert_allclose(far[0], 2.0 * near[0], rtol=0.05)
    assert (near[1] <= near[0]).all()
    # to the bit as after a warm-up in its own world, its own noise and times of capture, too
    clock = {"offset_sd_m": 3.0, "drift_sd_mps": 0.1}
    for options in ({"errors": "quiet"}, {"capture": {"delay_s": 9.0}, "spoofer_clock": clock}):
        own = make_attack({"name": "meaconer", "antenna_m": [0.0, 8.0, 0.0], **options})
        other = setup.copy_with(detector=Never())
        other.attack = own
        alone = play(WarmStart(other, rngs_of(setup, range(4))(), threads=1), IDLE)
        (runs,) = panel.play([(PanelAttack(IDLE, 4, own), 0)], drop=False)
        np.testing.assert_array_equal(runs.position, alone.position)


def test_near_an_alarm_are_those_whose_statistic_was_largest(setup):
    judge, runs = make_detector(TEST), 3
    everyone = range(CANDIDATES * runs)
    found = NearAlarm(setup, judge, rngs_of(setup, everyone), 1)
    count = len(everyone)
    simulator = setup.copy_with(detector=judge).simulator(count, lambda work, n: work(0, n))
    simulator.start_episodes(rngs_of(setup, everyone)())
    simulator.run_filter_only(setup.filter_only)
    largest = np.zeros(count)
    for _ in range(setup.live):  # which is shorter than the time that counts
        simulator.step(attacked=False)
        largest = np.maximum(largest, simulator.ratio())
    np.testing.assert_allclose(np.sort(found.ratio), np.sort(largest)[-runs:])
    chosen = np.sort(np.argsort(-largest, kind="stable")[:runs])
    twin = play(start_of(setup, judge, everyone), "none")
    np.testing.assert_array_equal(found.sky, (twin.onset // setup.epochs_each)[chosen])
    np.testing.assert_array_equal(found.counts[:, 0], (twin.first_alarm == 0)[chosen])
    # an attack of its own meets the same runs: replayed where the target is, it moves nothing
    assert found.runs == len(found.rngs()) == runs
    still = Panel(setup, [judge], rngs_of(setup, chosen), 1)
    attack = PanelAttack(IDLE, runs, meaconer(0.0))
    np.testing.assert_allclose(found.displacement(attack), still.displacement(attack), atol=1e-6)


def test_thresholds_go_along_into_any_world():
    scaled = Calibrated(SnapshotChi2(), scale=0.4)
    scaled.resolved_for = "another world"
    settled = module.in_any_world(scaled)
    assert (settled.scale, settled.resolved_for) == (0.4, None)
    pool = module.in_any_world(PooledDetector([scaled, Never()], [1, 3]))
    assert [getattr(each, "scale", None) for each in pool.judges] == [0.4, None]
    assert pool.weights == [1, 3]
