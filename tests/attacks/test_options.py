"""What imperfect equipment does to counterfeit signals."""

import json
import math
from functools import cache

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
from spoofgym.envs import SpoofCore
from spoofgym.simulation import TightlyCoupledSetup

from .support import ONSET, WORLD, check_displaced, offsets


def seen():
    return WORLD.visible[ONSET + 1]


def test_a_tracking_error_is_a_second_order_gauss_markov_process():
    sd, receivers, tau, beta = 3.0, 1000, 0.5, 1.0 / 30.0
    attack = FalsePosition(tracking=TrackingError(sd_m=sd, correlation_s=30.0))
    errors = offsets(attack, [None] * 41, receivers, watch="target_error")
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


@pytest.mark.parametrize("kind", [FalsePosition, PerChannel])
def test_range_rates_follow_the_tracking_error(kind):
    tracking = {"sd_m": 2.0, "correlation_s": 60.0}
    ranges, rates = offsets(kind(tracking=tracking), [None] * 30)
    change, mean = np.diff(ranges, axis=0)[..., seen()], 0.5 * (rates[1:] + rates[:-1])[..., seen()]
    np.testing.assert_allclose(change, 0.5 * mean, rtol=0, atol=5e-3)
    assert np.abs(rates[..., seen()]).max() > 0.02
    without, none = offsets(kind(tracking=tracking, coherent=False), [None] * 30)
    np.testing.assert_array_equal(without, ranges)
    assert not none.any()


def test_a_tracking_error_moves_the_antenna_that_is_counterfeited():
    k, attack = ONSET + 4, FalsePosition(control="rate", tracking={"bias_m": [3.0, -4.0, 5.0]})
    ranges, rates = offsets(attack, [(1.0, 0.0)] * 4)
    moved = np.array([13.0, -4.0, 5.0])
    speed = WORLD.C_en[k] @ [5.0, 0.0, 0.0] + WORLD.axes_turning[k] @ moved
    check_displaced(WORLD, k, ranges[-1, 0], rates[-1, 0], WORLD.C_en[k] @ moved, speed)


@pytest.mark.parametrize("delay", [0.5, 0.7, 3.0])
def test_a_late_spoofer_takes_an_old_position_for_the_present_one(delay):
    k = 121
    attack = FalsePosition(tracking={"delay_s": delay})
    error = offsets(attack, [None], onset=k - 1, watch="target_error")[0, 0]
    time = WORLD.epoch_time[k] - delay
    truth = np.hstack([WORLD.position_e, WORLD.velocity_e])
    old = [np.interp(time, WORLD.epoch_time, column) for column in truth.T]
    np.testing.assert_allclose(error, old - truth[k], rtol=0, atol=0.5)
    if delay == 0.5:
        np.testing.assert_allclose(error, truth[k - 1] - truth[k], rtol=0, atol=1e-8)
    # before the run it lies straight behind
    error = offsets(attack, [None], onset=0, watch="target_error")[0, 0]
    straight = WORLD.position_e[0] + (0.5 - delay) * WORLD.velocity_e[0] - WORLD.position_e[1]
    np.testing.assert_allclose(error[:3], straight, rtol=0, atol=1e-6)


def test_the_spoofers_clock_is_common_and_coherent_and_wanders():
    clock = SpooferClock(offset_m=7.0, drift_mps=0.5)
    ranges, rates = offsets(FalsePosition(spoofer_clock=clock), [None] * 10)[:, :, 0]
    time = 0.5 * np.arange(1.0, 11.0)[:, None]
    np.testing.assert_allclose(ranges, (7.0 + 0.5 * time) * seen(), rtol=1e-12)
    np.testing.assert_array_equal(rates, 0.5 * np.tile(seen(), (10, 1)))
    # it differs from episode to episode
    clock = SpooferClock(offset_sd_m=20.0, drift_sd_mps=0.3, frequency_psd=0.04)
    both = offsets(PerChannel(spoofer_clock=clock), [None] * 2, receivers=2000)
    ranges, rates = both[..., np.flatnonzero(seen())[0]]
    assert ranges[0].std() == pytest.approx(20.0, rel=0.07)
    assert rates[0].std() == pytest.approx(math.sqrt(0.3**2 + 0.04 * 0.5), rel=0.07)
    assert (rates[1] - rates[0]).std() == pytest.approx(math.sqrt(0.04 * 0.5), rel=0.07)


def test_only_what_is_due_and_aligned_is_captured_and_it_stays_so():
    fast, push = {"axes": "e", "control": "rate", "rate_limit_mps": 100.0}, [(1.0,)] * 8
    attack = FalsePosition(capture=Capture(delay_s=2.0, alignment_m=120.0), **fast)
    ranges, rates = offsets(attack, push)
    free, _ = offsets(FalsePosition(**fast), push)
    within = seen() & (np.abs(free[3, 0]) <= 120.0)
    assert 0 < within.sum() < seen().sum()
    np.testing.assert_array_equal(attack.memory["captured"][0], within)
    for each in (ranges, rates):
        assert not each[:3].any()
        assert not each[:, 0, ~within].any()
    beyond = ranges[3:, 0, within]
    np.testing.assert_array_equal(beyond, free[3:, 0, within])
    assert np.abs(beyond).max() > 120.0  # captured channels follow further than the limit


def test_counterfeit_errors_have_the_standard_deviations_given():
    errors = CounterfeitErrors(code_sd_m=0.3, range_rate_sd_mps=0.05, bias_sd_m=2.0)
    both = offsets(PerChannel(errors=errors), [None] * 40, receivers=300)
    codes, rates = both[..., seen() & WORLD.visible[ONSET + 40]]
    white = codes - codes.mean(axis=0)
    assert codes.mean(axis=0).std() == pytest.approx(2.0, rel=0.08)
    assert white.std() == pytest.approx(0.3, rel=0.03)
    assert rates.std() == pytest.approx(0.05, rel=0.03)
    assert abs((white[1:] * white[:-1]).mean()) < 0.05 * 0.3**2


# --- on receivers --------------------------------------------------------------------------------


def play(attack):
    """Core after 15 steps without commands, and what each step told."""
    setup = TightlyCoupledSetup(
        scenario={"name": "trolley", "imu_rate_hz": 20.0},
        receiver="matched",
        attack=attack,
        detector="never",
        timeline={"warmup_s": 4, "live_s": 2, "attack_s": 8, "time_to_alert_s": 1},
    )
    setup.fields = frozenset({"pseudorange", "range_rate"})
    core = SpoofCore(3, setup, knowledge="blind", threads=1)
    core.reset([np.random.default_rng([3, row]) for row in range(3)])
    results = [core.step(np.zeros((3, len(core.action_names)))) for _ in range(15)]
    return core, [result.info for result, _ in results]


@cache
def _played(settings):
    return play({"name": "false-position", **json.loads(settings)})


def played(**settings):
    """The same of a false position, for tests that only look."""
    return _played(json.dumps(settings))


def errors_of(core):
    """(B, 2n) errors of the measurements but for the clock, and who is visible (2n,)."""
    simulator, world = core.engine.simulator, core.setup.world
    k, clock = int(simulator.epochs[0]), simulator.sensors.fields["clock"]
    code = simulator.epoch.pseudorange - world.satellites[k, :, 6] - clock[:, :1]
    rate = simulator.epoch.range_rate - world.satellites[k, :, 7] - clock[:, 1:]
    return np.hstack([code, rate]), np.tile(world.visible[k], 2)


@pytest.mark.parametrize(
    "attack",
    [
        {"name": "per-channel", "capture": {"delay_s": 2.0}},
        {"name": "false-position", "capture": {"alignment_m": 1.0}, "channels": "S1*"},
        {"name": "meaconer", "antenna_m": [0.0, 0.0, 0.0]},
    ],
)
def test_zero_command_and_inherited_errors_are_the_clean_run_to_the_bit(attack):
    fields = [core.engine.simulator.buffers.fields for core, _ in (play(attack), played())]
    for name in ("position_e", "packed_covariance", "clock"):
        mine, theirs = (each[name] for each in fields)
        np.testing.assert_array_equal(mine, theirs)


def test_counterfeit_errors_replace_the_authentic_ones():
    none = {"code_sd_m": 0.0, "range_rate_sd_mps": 0.0, "bias_sd_m": 0.0}
    core = played(errors=none, channels="S1*")[0]
    errors, seen = errors_of(core)
    taken = seen & np.tile(core.setup.attack.select_channels(core.setup.world), 2)
    assert 0 < taken.sum() < seen.sum()
    np.testing.assert_allclose(errors[:, taken], 0.0, atol=3e-8)
    assert np.abs(errors[:, seen & ~taken]).min() > 1e-6  # the authentic errors
    # the noise of the receiver stays as its world has it
    inherited, replaced = played()[0], played(errors="replaced")[0]
    authentic, seen = errors_of(inherited)
    fields, n = inherited.engine.simulator.sensors.fields, len(seen) // 2
    authentic[:, :n] -= fields["satellite_bias"] + fields["correlated"]
    mine, _ = errors_of(replaced)
    np.testing.assert_allclose(mine[:, seen], authentic[:, seen], rtol=0, atol=3e-8)
    assert np.abs(mine[:, seen]).min() > 1e-6


def test_what_stays_of_the_authentic_errors():
    def stays(**settings):
        return played(**settings)[0].engine.simulator.sensors.authentic

    _, seen = errors_of(played()[0])
    n = len(seen) // 2
    late = stays(errors="quiet", capture={"delay_s": 2.0})
    age = (15 - 4) * 0.5  # captured at the fourth of 15 epochs
    np.testing.assert_allclose(late[:, seen], 1.0 - age / 30.0, rtol=1e-9)
    assert not stays(errors={"blend_s": 3.0})[:, seen].any()
    code_only = stays(errors="replaced", coherent=False)  # the carrier's errors stay
    assert not code_only[:, :n][:, seen[:n]].any()
    assert (code_only[:, n:] == 1.0).all()


def test_information_counts_the_captured_channels_and_a_new_episode_has_its_own_errors():
    core, told = play({"name": "false-position", "errors": "replaced", "capture": {"delay_s": 2.0}})
    counts = [info["captured_channels"][0] for info in told]
    assert counts == [0] * 3 + [core.setup.world.visible[core.setup.onset + 5].sum()] * 12
    assert "captured_channels" not in played()[1][0]
    simulator = core.engine.simulator
    assert not simulator.sensors.authentic.all()
    core.reset([np.random.default_rng(1)], np.array([1]))
    assert simulator.sensors.authentic[1].all()
    assert not simulator.attack.memory["captured"][1].any()
