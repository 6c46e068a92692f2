"""Errors of airborne signals: what they share, how they wander, and that they telescope."""

from __future__ import annotations

import math

import numpy as np
import pytest

from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.simulator import run_serially
from spoofgym.truth.clock import ReceiverClock
from spoofgym.truth.gnss_errors import ERRORS, GnssErrors
from spoofgym.truth.noise import normals
from spoofgym.truth.scenario import Scenario
from spoofgym.truth.sensors import IMU_GRADES
from spoofgym.truth.signal_errors import (
    HALF_LIFE,
    SIGNAL_ERRORS,
    SignalErrors,
    compute_mappings,
    correlation,
    obliquities,
    process_coefficients,
)

TIMELINE = {"warmup_s": 5.0, "live_s": 0.0, "attack_s": 5.0, "time_to_alert_s": 0.0}
FLIGHT = {"flight": "zhong2025", "imu_rate_hz": 10.0}


RANGES = frozenset({"pseudorange", "range_rate"})


def errors(**signals):
    """Errors of signals alone, on a perfect clock."""
    white = {"code_sd_m": 0.0, "range_rate_sd_mps": 0.0, "signal_in_space_sd_m": 0.0}
    none = {"zenith_iono_sd_m": 0.0, "zenith_tropo_sd_m": 0.0}
    clock = ReceiverClock(offset_m=0.0, drift_mps=0.0)
    return GnssErrors(**white, **none, clock=clock, signals=SignalErrors(**signals))


def ranges_of(simulator):
    """(B, 2, n) measured pseudoranges and range rates [m], [m/s]."""
    return np.stack([simulator.epoch.pseudorange, simulator.epoch.range_rate], axis=1)


def measured(given, receivers, epochs, seed=0, **settings):
    """(K, B, n) errors of codes and of range rates, the world and its epochs, of a clean run."""
    scenario = Scenario(errors=given, **{**FLIGHT, **settings})
    setup = TightlyCoupledSetup(scenario=scenario, detector="never", timeline=TIMELINE)
    setup.fields = RANGES
    simulator = setup.simulator(receivers, run_serially)
    simulator.start_episodes([np.random.default_rng([seed, row]) for row in range(receivers)])
    world, found = setup.world, []
    for _ in range(epochs):
        simulator.run_filter_only(1)
        k = int(simulator.epochs[0])
        truth = world.satellites[k, :, 6:].T
        both = ranges_of(simulator) - truth
        both -= simulator.sensors.fields["clock"][:, :, None]
        found.append(np.where(world.visible[k], both, np.nan))
    codes, rates = np.array(found).transpose(2, 0, 1, 3)
    return codes, rates, world, np.arange(1, epochs + 1)


def in_view(world, epochs):
    """(n,) bool, satellites that are in view all the time."""
    return world.visible[epochs].all(axis=0)


def test_range_rates_of_carriers_telescope():
    """Their sum over 150 s has the noise of two readings of the carrier."""
    codes, rates, world, epochs = measured(errors(carrier_sd_m=0.0025), 150, 300)
    seen, count = in_view(world, epochs), 150 * in_view(world, epochs).sum()
    rates = rates[:, :, seen]
    assert not codes[:, :, seen].any() or np.abs(codes[:, :, seen]).max() < 1e-7
    sd = math.sqrt(2.0) * 0.0025 / 0.5
    assert rates.std() == pytest.approx(sd, rel=0.01)
    one = (rates[1:] * rates[:-1]).mean() / sd**2
    assert one == pytest.approx(-0.5, abs=0.01)
    for lag in (2, 3, 10):
        assert (rates[lag:] * rates[:-lag]).mean() / sd**2 == pytest.approx(0.0, abs=0.01)
    total = 0.5 * rates.sum(axis=0)
    assert total.std() == pytest.approx(math.sqrt(2.0) * 0.0025, rel=4.0 / math.sqrt(2 * count))
    assert total.std() < 0.1 * 0.5 * sd * math.sqrt(300.0)  # what white noise would add up to


def test_the_ionosphere_is_one_delay_seen_through_obliquities_and_advances_carriers():
    codes, rates, world, epochs = measured(errors(ionosphere_sd_m=2.0, ionosphere_s=120.0), 20, 200)
    seen = in_view(world, epochs)
    slant = obliquities(world.elevation[epochs][:, seen])[0][:, None]
    zenith = codes[:, :, seen] / slant
    np.testing.assert_allclose(zenith, np.broadcast_to(zenith[:, :, :1], zenith.shape), atol=1e-6)
    assert slant.max() > 1.5 * slant.min()
    change = np.gradient(codes[:, :, seen], 0.5, axis=0)[1:-1]
    assert np.std(rates[1:-1][:, :, seen] + change) < 0.15 * np.std(change)
    assert np.corrcoef(rates[1:-1][:, :, seen].ravel(), change.ravel())[0, 1] < -0.99


def test_troposphere_orbits_and_clocks_are_the_same_in_code_and_carrier():
    given = errors(troposphere_sd_m=1.0, troposphere_s=120.0)
    codes, rates, world, epochs = measured(given, 10, 200)
    seen = in_view(world, epochs)
    thick = obliquities(world.elevation[epochs][:, seen])[1][:, None]
    zenith = codes[:, :, seen] / thick
    np.testing.assert_allclose(zenith, np.broadcast_to(zenith[:, :, :1], zenith.shape), atol=1e-6)
    for own in (given, errors(orbit_clock_sd_m=0.5, orbit_clock_s=120.0)):
        codes, rates, _, _ = measured(own, 10, 200)
        change = np.gradient(codes[:, :, seen], 0.5, axis=0)[1:-1]
        assert np.corrcoef(rates[1:-1][:, :, seen].ravel(), change.ravel())[0, 1] > 0.99
    apart = np.corrcoef(codes[0, :, seen])  # each satellite has an error of its own
    assert np.abs(apart - np.eye(seen.sum())).max() < 1.0


@pytest.mark.parametrize("order", [1, 2])
def test_wandering_errors_are_stationary_and_fall_to_1_over_e(order):
    name = {1: "noise_sd_m", 2: "orbit_clock_sd_m"}[order]
    sd = {1: (0.3, 0.0), 2: 0.3}[order]
    time = {1: "smoothing_s", 2: "orbit_clock_s"}[order]
    codes, rates, world, epochs = measured(errors(**{name: sd, time: 50.0}), 400, 101)
    seen = in_view(world, epochs)
    codes, count = codes[:, :, seen], 400 * seen.sum()
    for k in (0, 50, 100):
        assert codes[k].std() == pytest.approx(0.3, rel=4.0 / math.sqrt(2 * count))
    for lag in (1, 40, 100):
        found = (codes[lag] * codes[0]).mean() / 0.09
        want = correlation(np.array(0.5 * lag), 50.0, order == 2)
        assert found == pytest.approx(float(want), abs=4.0 / math.sqrt(count))
    assert (codes[100] * codes[0]).mean() / 0.09 == pytest.approx(math.exp(-1.0), abs=0.07)
    if order == 1:
        assert np.abs(rates[:, :, seen]).max() < 1e-9  # the code's alone
    else:
        speed = 0.3 * HALF_LIFE / 50.0
        assert rates[:, :, seen].std() == pytest.approx(speed, rel=0.05)


def test_multipath_and_noise_follow_the_elevation():
    for name, e_fold in (("multipath_sd_m", 10.0), ("noise_sd_m", 6.9)):
        given = errors(**{name: (0.2, 0.8), "smoothing_s": 1.0})
        codes, _, world, epochs = measured(given, 400, 20)
        seen = in_view(world, epochs)
        degrees = np.degrees(world.elevation[epochs][:, seen])
        want = 0.2 + 0.8 * np.exp(-degrees / e_fold)
        found = codes[:, :, seen].std(axis=1)
        np.testing.assert_allclose(found.mean(axis=0), want.mean(axis=0), rtol=0.05)
        assert want.max() > 1.2 * want.min()


def test_obliquities_are_those_of_the_standard():
    ionosphere, troposphere, multipath, noise = obliquities(np.radians([90.0, 5.0, -3.0]))
    np.testing.assert_allclose([ionosphere[0], multipath[0] < 1e-3], [1.0, True])
    assert troposphere[0] == pytest.approx(1.0, abs=1e-6)
    assert ionosphere[1] == pytest.approx(3.04, abs=0.02)  # 3.0 in all texts on thin shells
    assert troposphere[1] == pytest.approx(10.2, abs=0.1)
    assert multipath[1] == pytest.approx(math.exp(-0.5))
    assert noise[1] == pytest.approx(math.exp(-5.0 / 6.9))
    at_horizon = obliquities(np.zeros(1))
    for below, at in zip((ionosphere, troposphere, multipath, noise), at_horizon, strict=True):
        assert below[2] == at[0]


def test_rates_of_obliquities_do_not_cross_from_one_world_to_the_next():
    elevation = np.radians(np.linspace(20.0, 60.0, 10))[:, None] * np.ones(3)
    one = compute_mappings(elevation, 0.5, 10)
    two = compute_mappings(np.concatenate([elevation, elevation]), 0.5, 10)
    np.testing.assert_array_equal(two, np.concatenate([one, one]))


@pytest.mark.parametrize("time_s", [0.7, 30.0, 7200.0, 1e7])
def test_a_process_keeps_its_variance(time_s):
    f00, f01, f10, f11, l11, l21, l22 = process_coefficients(0.6, time_s, 0.5)
    beta = HALF_LIFE / time_s
    P = 0.36 * np.diag([1.0, beta**2])
    Phi, L = np.array([[f00, f01], [f10, f11]]), np.array([[l11, 0.0], [l21, l22]])
    scale = np.diag([1.0, 1.0 / beta])  # rates in units of their own
    kept = scale @ (Phi @ P @ Phi.T + L @ L.T) @ scale
    np.testing.assert_allclose(kept, 0.36 * np.eye(2), rtol=0, atol=1e-12)


def test_the_worlds_of_aviation():
    actual, overbound = SIGNAL_ERRORS["aviation-actual"], SIGNAL_ERRORS["aviation-overbound"]
    for item in ("carrier_sd_m", "ionosphere_sd_m", "troposphere_sd_m", "orbit_clock_sd_m"):
        assert 0.0 < getattr(actual, item) <= getattr(overbound, item)
    elevation = np.radians(np.linspace(10.0, 90.0, 17))
    assert (actual.code_variance(elevation) < overbound.code_variance(elevation)).all()
    # at 2 Hz a range rate has 7 mm/s
    assert ERRORS["aviation-actual"].rate_sd(0.5) == pytest.approx(0.00707, abs=1e-5)
    setups = [
        TightlyCoupledSetup(scenario=name, receiver="matched", detector="never")
        for name in ("aviation-actual", "aviation-overbound")
    ]
    one, other = (setup.combinations[0] for setup in setups)
    np.testing.assert_array_equal(one.noise_variance, other.noise_variance)
    assert one.errors is not other.errors
    n = setups[0].world.channels
    assert (one.epoch_variance[:n] < one.noise_variance[:n]).all()
    assert one.epoch_variance[:n].max() < 5.0**2


def test_the_constants_of_inertial_sensors_are_drawn_by_the_data_sheet():
    grade = IMU_GRADES["tactical"]
    setup = TightlyCoupledSetup(
        scenario={"name": "zhong2025-tactical", "imu_rate_hz": 10},
        domain={"turn_on": "drawn"},
        detector="never",
        timeline=TIMELINE,
    )
    simulator = setup.simulator(300, run_serially)
    for _ in range(2):
        simulator.start_episodes([np.random.default_rng(row) for row in range(300)])
        fields = simulator.sensors.constants
        for name in ("accel_bias", "gyro_bias", "g_dependence"):
            rms = np.sqrt(np.mean(getattr(grade, name) ** 2))
            assert fields[name].std() == pytest.approx(rms, rel=0.1)
            assert abs(fields[name].mean()) < 0.15 * rms
        for name in ("accel_matrix", "gyro_matrix"):
            rms = np.sqrt(np.mean((getattr(grade, name) - np.eye(3)) ** 2))
            assert (fields[name] - np.eye(3)).std() == pytest.approx(rms, rel=0.1)
        np.testing.assert_array_equal(fields["imu_noise"][0][:2], grade.noise[:2])
    bias, k = simulator.sensors.constants["accel_bias"][7], simulator.sensors.words["bias"][7]
    out = np.empty(64)
    normals(*k, 1, out)
    np.testing.assert_allclose(bias, np.sqrt(np.mean(grade.accel_bias**2)) * out[:3])


def events_run(given, receivers=40, **settings):
    """Errors of the whole of an episode, its simulator and its first epoch."""
    setup = TightlyCoupledSetup(
        scenario=Scenario(errors=errors(**settings), **FLIGHT),
        domain={"events": given},
        detector="never",
        timeline={"warmup_s": 20.0, "live_s": 10.0, "attack_s": 100.0, "time_to_alert_s": 0.0},
    )
    setup.fields = RANGES
    simulator = setup.simulator(receivers, run_serially)
    simulator.start_episodes([np.random.default_rng([1, row]) for row in range(receivers)])
    epochs, found, seen = setup.onset + setup.steps, [], []
    for _ in range(epochs):
        simulator.run_filter_only(1)
        truth = setup.world.satellites[int(simulator.epochs[0]), :, 6:].T
        found.append(ranges_of(simulator) - truth)
        seen.append(simulator.buffers.visible.copy())
    codes, rates = np.array(found).transpose(2, 0, 1, 3)
    return setup, simulator, codes, rates, np.array(seen)


def test_a_step_of_the_clock_is_common_to_all_signals_and_to_them_alone():
    setup, _, codes, rates, seen = events_run({"clock_step": 1.0, "clock_step_m": [2.0, 5.0]})
    steps = np.diff(np.where(seen, codes, np.nan), axis=0)
    jumps = np.nanmax(np.abs(steps), axis=(0, 2))
    assert (jumps > 1.99).all()
    assert (jumps < 5.01).all()
    first = np.nanargmax(np.nanmax(np.abs(steps), axis=2), axis=0) + 2  # as epochs
    assert first.min() > setup.filter_only
    assert len(set(first)) > 20
    for b in range(40):
        size = steps[first[b] - 2, b]
        np.testing.assert_allclose(size[np.isfinite(size)], np.nanmean(size), atol=1e-7)
    assert np.nanmax(np.abs(np.where(seen, rates, np.nan))) < 1e-9
    signs = [np.nanmean(steps[first[b] - 2, b]) > 0.0 for b in range(40)]
    assert 5 < sum(signs) < 35


def test_a_satellite_is_lost_for_a_while():
    given = {"satellite_loss": 1.0, "satellite_loss_s": [5.0, 10.0]}
    setup, simulator, _, _, seen = events_run(given)
    world = setup.world.visible[1 : len(seen) + 1]
    missing = world[:, None] & ~seen
    assert not (seen & ~world[:, None]).any()
    assert (missing.any(axis=0).sum(axis=1) == 1).sum() > 30  # one whose end is in the run
    for b in range(40):
        gone = np.flatnonzero(missing[:, b].any(axis=1))
        assert len(gone) <= 20
        assert (np.diff(gone) == 1).all()
    assert np.isfinite(simulator.position).all()


def test_a_front_delays_codes_and_advances_carriers_one_after_the_other():
    given = {
        "front": 1.0,
        "front_slope_mm_per_km": [100.0, 100.0],
        "front_width_km": [30.0, 30.0],
        "front_speed_mps": [3000.0, 3000.0],
    }
    _, simulator, codes, rates, seen = events_run(given)
    delay = np.where(seen, codes, 0.0)
    assert delay.max() == pytest.approx(3.0, abs=1e-6)  # slope by width
    assert delay.min() > -1e-6
    growing = np.where(seen, rates, 0.0)
    assert growing.min() == pytest.approx(-1e-4 * 3000.0, abs=1e-9)
    assert growing.max() < 1e-9
    arrival = simulator.sensors.signals["front_arrival"]
    spread = [np.ptp(row[row < 1e17]) * 0.5 * 3000.0 for row in arrival]
    assert 3e5 < np.mean(spread) < 3e6  # pierce points lie hundreds of kilometres apart


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"multipath_sd_m": (1.0,)}, "`multipath_sd_m` must be two numbers"),
        ({"noise_sd_m": (0.1, math.nan)}, "`noise_sd_m` must be a number of at least 0"),
    ],
)
def test_bad_settings_are_refused(settings, said):
    with pytest.raises(ValueError, match=said):
        SignalErrors(**settings)


def test_range_rates_are_white_or_of_carriers_but_not_both():
    with pytest.raises(ValueError, match="`range_rate_sd_mps` must be 0 where range rates are"):
        GnssErrors(
            code_sd_m=0.0,
            range_rate_sd_mps=0.1,
            signal_in_space_sd_m=0.0,
            zenith_iono_sd_m=0.0,
            zenith_tropo_sd_m=0.0,
            signals=SignalErrors(carrier_sd_m=0.003),
        )


@pytest.mark.parametrize(
    ("events", "said"),
    [
        ({"front": 1.5}, "`front` must be a number from 0 to 1, got 1.5"),
        ({"clock_step_m": [3.0, 1.0]}, "`clock_step_m` must be two numbers above 0"),
        ({"satellite_loss_s": 3.0}, "`satellite_loss_s` must be two numbers above 0"),
    ],
)
def test_bad_events_are_refused(events, said):
    with pytest.raises(ValueError, match=said):
        TightlyCoupledSetup(domain={"events": events})
