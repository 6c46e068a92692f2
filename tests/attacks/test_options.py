"""What imperfect equipment does to counterfeit signals."""

import math
from itertools import pairwise

import numpy as np
import pytest

from spoofgym.attacks import (
    Capture,
    CounterfeitErrors,
    FalsePosition,
    PerChannel,
    SpooferClock,
    TrackingError,
)
from spoofgym.earth.wgs84 import range_and_rate
from spoofgym.envs import SpoofCore
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.truth.scenario import Scenario

from .support import ONSET, begin, offsets

KINDS = [FalsePosition, PerChannel]
TIMELINE = {"warmup_s": 10, "live_s": 5, "attack_s": 10, "time_to_alert_s": 1}


@pytest.fixture(scope="module")
def world():
    return Scenario(flight="zhong2025").world()


def target_errors(attack, world, receivers, epochs):
    """(K, B, 6) errors of the position that the spoofer takes for the target's."""
    begin(attack, world, receivers)
    at, unused = np.full(receivers, ONSET), np.empty((2, receivers, world.channels))
    found = []
    for _ in range(epochs):
        attack.command(None, at, *unused, 0, receivers)
        at = at + 1
        found.append(attack.memory["target_error"].copy())
    return np.array(found)


def test_a_tracking_error_is_a_second_order_gauss_markov_process(world):
    sd, time_constant = 3.0, 30.0
    tracking = TrackingError(sd_m=sd, correlation_s=time_constant)
    receivers, tau, beta = 4000, 0.5, 1.0 / time_constant
    errors = target_errors(FalsePosition(tracking=tracking), world, receivers, 41)
    position, rate = errors[..., :3], errors[..., 3:]
    spread = 4.0 / math.sqrt(2 * 3 * receivers)
    for k in (0, 20, 40):  # stationary from the first epoch on
        assert position[k].std() == pytest.approx(sd, rel=spread)
        assert rate[k].std() == pytest.approx(beta * sd, rel=spread)
        assert abs((position[k] * rate[k]).mean()) < 4.0 * beta * sd**2 / math.sqrt(3 * receivers)
    for lag in (1, 10, 40):
        x = beta * lag * tau
        want = sd**2 * (1.0 + x) * math.exp(-x)
        assert (position[lag] * position[0]).mean() == pytest.approx(want, abs=2 * spread * sd**2)
    # the rate is the position's: what is left is white acceleration, integrated within an epoch
    gap = np.diff(position, axis=0) - 0.5 * tau * (rate[1:] + rate[:-1])
    assert gap.std() == pytest.approx(sd * math.sqrt(4.0 * beta**3 * tau**3 / 12.0), rel=0.1)


@pytest.mark.parametrize("kind", KINDS)
def test_range_rates_follow_the_tracking_error(world, kind):
    attack = kind(tracking={"sd_m": 2.0, "correlation_s": 60.0})
    ranges, rates = offsets(attack, world, [None] * 30)
    seen = world.visible[ONSET + 1]
    for (d0, v0), (d1, v1) in pairwise(zip(ranges[:, 0], rates[:, 0], strict=True)):
        np.testing.assert_allclose((d1 - d0)[seen], 0.25 * (v0 + v1)[seen], rtol=0, atol=5e-3)
    assert np.abs(rates[:, 0, seen]).max() > 0.02
    without, none = offsets(
        kind(tracking={"sd_m": 2.0, "correlation_s": 60.0}, coherent=False), world, [None] * 30
    )
    np.testing.assert_array_equal(without, ranges)
    assert not none.any()


def test_a_tracking_error_moves_the_antenna_that_is_counterfeited(world):
    attack = FalsePosition(control="rate", tracking={"bias_m": [3.0, -4.0, 5.0]})
    (*_, last), _ = offsets(attack, world, [(1.0, 0.0)] * 4)
    k = ONSET + 4
    displaced = world.position_e[k] + world.C_en[k] @ [3.0 + 10.0, -4.0, 5.0]
    for s in np.flatnonzero(world.visible[k]):
        p, v = (world.satellites[k, s, :3], world.satellites[k, s, 3:6]), world.velocity_e[k]
        there, here = (
            range_and_rate(*p, displaced, v),
            range_and_rate(*p, world.position_e[k], v),
        )
        assert last[0, s] == pytest.approx(there[0] - here[0], abs=2e-8)


@pytest.mark.parametrize("delay", [0.5, 0.7, 3.0])
def test_a_late_spoofer_takes_an_old_position_for_the_present_one(world, delay):
    onset = 120
    attack = FalsePosition(tracking={"delay_s": delay})
    begin(attack, world, 1, onset)
    unused = np.empty((2, 1, world.channels))
    attack.command(None, np.array([onset]), *unused, 0, 1)
    time = world.epoch_time[onset + 1] - delay
    error = attack.memory["target_error"][0]
    for i in range(3):
        old = np.interp(time, world.epoch_time, world.position_e[:, i])
        assert error[i] == pytest.approx(old - world.position_e[onset + 1, i], abs=0.5)
        old = np.interp(time, world.epoch_time, world.velocity_e[:, i])
        assert error[3 + i] == pytest.approx(old - world.velocity_e[onset + 1, i], abs=0.5)
    if delay == 0.5:
        change = world.position_e[onset] - world.position_e[onset + 1]
        np.testing.assert_allclose(error[:3], change, rtol=0, atol=1e-8)


def test_before_the_run_an_old_position_lies_straight_behind(world):
    attack = FalsePosition(tracking={"delay_s": 10.0})
    begin(attack, world, 1, 2)
    attack.command(None, np.array([2]), *np.empty((2, 1, world.channels)), 0, 1)
    want = world.position_e[0] - 8.5 * world.velocity_e[0] - world.position_e[3]
    np.testing.assert_allclose(attack.memory["target_error"][0, :3], want, rtol=0, atol=1e-6)


def test_the_spoofers_clock_is_common_and_coherent(world):
    clock = SpooferClock(offset_m=7.0, drift_mps=0.5)
    ranges, rates = offsets(FalsePosition(spoofer_clock=clock), world, [None] * 10)
    seen = world.visible[ONSET + 1]
    time = 0.5 * np.arange(1.0, 11.0)
    for k in range(10):
        np.testing.assert_allclose(ranges[k, 0, seen], 7.0 + 0.5 * time[k], rtol=1e-12)
        np.testing.assert_array_equal(rates[k, 0, seen], 0.5)
        assert not ranges[k, 0, ~seen].any()


def test_a_clock_differs_from_episode_to_episode_and_wanders(world):
    clock = SpooferClock(offset_sd_m=20.0, drift_sd_mps=0.3, frequency_psd=0.04)
    ranges, rates = offsets(PerChannel(spoofer_clock=clock), world, [None] * 2, receivers=2000)
    s = np.flatnonzero(world.visible[ONSET + 1])[0]
    assert ranges[0, :, s].std() == pytest.approx(20.0, rel=0.07)
    assert rates[0, :, s].std() == pytest.approx(math.sqrt(0.3**2 + 0.04 * 0.5), rel=0.07)
    steps = rates[1, :, s] - rates[0, :, s]
    assert steps.std() == pytest.approx(math.sqrt(0.04 * 0.5), rel=0.07)


def test_nothing_is_captured_before_its_time(world):
    attack = PerChannel(control="rate", rate_limit_mps=1.0, capture={"delay_s": 3.0})
    action = np.ones(len(attack.action_names(world)))
    ranges, rates = offsets(attack, world, [action] * 10)
    seen = world.visible[ONSET + 1]
    assert not ranges[:5].any()
    assert not rates[:5].any()
    np.testing.assert_allclose(ranges[5:, 0, seen].T, [0.5 * np.arange(6.0, 11.0)] * seen.sum())


def test_only_what_is_aligned_is_captured_and_it_stays_so(world):
    fast = {"axes": "e", "control": "rate", "rate_limit_mps": 100.0}
    attack = FalsePosition(capture=Capture(delay_s=2.0, alignment_m=120.0), **fast)
    ranges, _ = offsets(attack, world, [(1.0,)] * 8)
    free, _ = offsets(FalsePosition(**fast), world, [(1.0,)] * 8)
    seen = world.visible[ONSET + 4]
    within = seen & (np.abs(free[3, 0]) <= 120.0)
    assert 0 < within.sum() < seen.sum()
    np.testing.assert_array_equal(attack.memory["captured"][0], within)
    assert not ranges[:3].any()
    assert not ranges[:, 0, ~within].any()
    beyond = ranges[3:, 0, within]
    np.testing.assert_array_equal(beyond, free[3:, 0, within])
    assert np.abs(beyond).max() > 120.0  # captured channels follow further than the limit


def played(attack, steps=15, receivers=3, **settings):
    """Core under random commands, and the innovations of its last epoch."""
    setup = TightlyCoupledSetup(
        scenario="trolley",
        receiver="matched",
        attack=attack,
        detector="never",
        timeline=TIMELINE,
        **settings,
    )
    setup.fields = frozenset({"pseudorange", "range_rate"})
    core = SpoofCore(receivers, setup, knowledge="blind", threads=1)
    core.reset([np.random.default_rng([3, row]) for row in range(receivers)])
    results = [core.step(np.zeros((receivers, len(core.action_names)))) for _ in range(steps)]
    return core, [result for result, _ in results]


def test_zero_command_and_inherited_errors_are_the_clean_run_to_the_bit():
    clean, _ = played("false-position")
    for attack in (
        {"name": "per-channel", "capture": {"delay_s": 2.0}},
        {"name": "false-position", "capture": {"alignment_m": 1.0}, "channels": "S1*"},
        {"name": "meaconer", "antenna_m": [0.0, 0.0, 0.0]},
    ):
        core, _ = played(attack)
        for name in ("position_e", "packed_covariance", "clock"):
            mine, theirs = (each.engine.simulator.buffers.fields for each in (core, clean))
            np.testing.assert_array_equal(mine[name], theirs[name])


def test_counterfeit_errors_replace_the_authentic_ones():
    """Pseudorange less truth and clock has the counterfeit signal's errors alone."""
    errors = {"code_sd_m": 0.0, "range_rate_sd_mps": 0.0, "bias_sd_m": 0.0}
    inherited, _ = played("false-position")
    replaced, _ = played({"name": "false-position", "errors": errors, "channels": "S1*"})
    for core in (inherited, replaced):
        simulator, world = core.engine.simulator, core.setup.world
        k, seen = int(simulator.epochs[0]), world.visible[int(simulator.epochs[0])]
        clock = simulator.sensors.fields["clock"]
        ranges, rates = simulator.epoch.pseudorange, simulator.epoch.range_rate
        code = ranges - world.satellites[k, :, 6] - clock[:, :1]
        rate = rates - world.satellites[k, :, 7] - clock[:, 1:]
        taken = seen & core.setup.attack.select_channels(world)
        if core is replaced:
            assert 0 < taken.sum() < seen.sum()
            np.testing.assert_allclose(code[:, taken], 0.0, atol=3e-8)
            np.testing.assert_allclose(rate[:, taken], 0.0, atol=1e-10)
            taken = seen & ~taken
        assert np.abs(code[:, taken]).min() > 1e-4  # the authentic errors
        assert np.abs(rate[:, taken]).min() > 1e-6


def test_counterfeit_errors_have_the_standard_deviations_given(world):
    errors = CounterfeitErrors(code_sd_m=0.3, range_rate_sd_mps=0.05, bias_sd_m=2.0)
    ranges, rates = offsets(PerChannel(errors=errors), world, [None] * 40, receivers=300)
    seen = world.visible[ONSET + 1] & world.visible[ONSET + 40]
    codes = ranges[:, :, seen]
    assert codes.mean(axis=0).std() == pytest.approx(2.0, rel=0.08)
    assert (codes - codes.mean(axis=0)).std() == pytest.approx(0.3, rel=0.03)
    assert rates[:, :, seen].std() == pytest.approx(0.05, rel=0.03)
    white = codes - codes.mean(axis=0)
    assert abs((white[1:] * white[:-1]).mean()) < 0.05 * 0.3**2


def test_replaced_errors_leave_the_noise_of_the_receiver_as_its_world_has_it():
    inherited, _ = played("false-position")
    replaced, _ = played({"name": "false-position", "errors": "replaced"})
    errors = []
    for core in (inherited, replaced):
        simulator, world = core.engine.simulator, core.setup.world
        k, fields = int(simulator.epochs[0]), simulator.sensors.fields
        seen = world.visible[k]
        ranges, rates = simulator.epoch.pseudorange, simulator.epoch.range_rate
        code = ranges - world.satellites[k, :, 6] - fields["clock"][:, :1]
        if core is inherited:
            code -= fields["satellite_bias"] + fields["correlated"]
        rate = rates - world.satellites[k, :, 7] - fields["clock"][:, 1:]
        errors.append((code[:, seen], rate[:, seen]))
    for mine, theirs in zip(*errors, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=3e-8)
        assert np.abs(mine).min() > 1e-5


def test_a_quiet_counterfeit_lets_the_errors_fade():
    core, _ = played({"name": "false-position", "errors": "quiet", "capture": {"delay_s": 2.0}})
    simulator = core.engine.simulator
    seen = np.tile(core.setup.world.visible[int(simulator.epochs[0])], 2)
    age = (15 - 4) * 0.5  # captured at the fourth of 15 epochs
    np.testing.assert_allclose(simulator.sensors.authentic[:, seen], 1.0 - age / 30.0, rtol=1e-9)
    core, _ = played({"name": "false-position", "errors": {"blend_s": 3.0}})
    assert not core.engine.simulator.sensors.authentic[:, seen].any()
    assert FalsePosition(errors="quiet").label == "false-position-quiet"
    assert FalsePosition(errors={"blend_s": 5.0}).label == "false-position-replaced"
    with pytest.raises(ValueError, match=r"`blend_s` 3\.0 takes the receiver's own noise"):
        CounterfeitErrors(blend_s=3.0, code_sd_m=0.5)


def test_without_coherence_the_authentic_range_rates_keep_their_errors():
    core, _ = played({"name": "false-position", "errors": "replaced", "coherent": False})
    n = core.setup.world.channels
    authentic = core.engine.simulator.sensors.authentic
    seen = core.setup.world.visible[core.setup.onset + 1]
    assert not authentic[:, :n][:, seen].any()
    assert (authentic[:, n:] == 1.0).all()


def test_information_counts_the_captured_channels():
    core, results = played({"name": "false-position", "capture": {"delay_s": 2.0}})
    counts = [result.info["captured_channels"][0] for result in results]
    assert counts == [0] * 3 + [core.setup.world.visible[core.setup.onset + 5].sum()] * 12
    _, results = played("false-position", steps=1)
    assert "captured_channels" not in results[0].info


def test_a_new_episode_has_the_authentic_errors_again():
    core, _ = played({"name": "false-position", "errors": "replaced"})
    assert not core.engine.simulator.sensors.authentic.all()
    core.reset([np.random.default_rng(1)], np.array([1]))
    assert core.engine.simulator.sensors.authentic[1].all()
    assert not core.engine.simulator.attack.memory["captured"][1].any()


def test_labels_tell_the_options():
    assert FalsePosition(errors="replaced").label == "false-position-replaced"
    assert FalsePosition(tracking={}).label == "false-position-tracking"
    assert PerChannel(spoofer_clock={}, capture={}, channels="S*", coherent=False).label == (
        "per-channel-partial-clock-capture-pseudorange-only"
    )


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"errors": "own"}, "`errors` must be 'inherited', 'replaced' or 'quiet', got 'own'"),
        ({"errors": {"sd": 1.0}}, "`errors` has no setting 'sd'; valid: code_sd_m"),
        ({"tracking": {"bias_m": [1.0, 2.0]}}, r"three finite numbers: .*got \(1.0, 2.0\)"),
        ({"tracking": {"bias_m": 3.0}}, "three finite numbers: north, east, down; got 3.0"),
        ({"capture": {"delay_s": -1.0}}, "`delay_s` must be a number of at least 0, got -1"),
    ],
)
def test_options_are_checked_at_birth(settings, said):
    with pytest.raises(ValueError, match=said):
        FalsePosition(**settings)


def test_options_that_are_no_records_are_refused():
    with pytest.raises(TypeError, match="`tracking` must be a dict of settings or an instance of"):
        FalsePosition(tracking=1.0)
