"""Errors of airborne signals: what they share, how they wander, and that they telescope."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest

from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.simulator import run_serially
from spoofgym.truth.clock import ReceiverClock
from spoofgym.truth.events import BenignEvents, EventWindow, draw_events
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
    stack_obliquities,
)

TIMELINE = {"warmup_s": 5.0, "live_s": 0.0, "attack_s": 5.0, "time_to_alert_s": 0.0}
FLIGHT = {"flight": "zhong2025", "imu_rate_hz": 10.0}


def errors(**signals):
    white = {"code_sd_m": 0.0, "range_rate_sd_mps": 0.0, "signal_in_space_sd_m": 0.0}
    none = {"zenith_iono_sd_m": 0.0, "zenith_tropo_sd_m": 0.0}
    clock = ReceiverClock(offset_m=0.0, drift_mps=0.0)
    return GnssErrors(**white, **none, clock=clock, signals=SignalErrors(**signals))


def measured(given, receivers, epochs):
    """(K, B, n) errors of codes and range rates, and the elevation of satellites always in view."""
    setup = TightlyCoupledSetup(
        scenario=Scenario(errors=given, **FLIGHT), detector="never", timeline=TIMELINE
    )
    _, found, seen = played(setup, receivers, epochs)
    always = seen[:, 0].all(axis=0)
    codes, rates = found.transpose(2, 0, 1, 3)[..., always]
    return codes, rates, setup.world.elevation[1 : epochs + 1, always]


def played(setup, receivers, epochs):
    """A simulator after a clean run, (K, B, 2, n) its errors, and what it sees."""
    setup.fields = frozenset({"pseudorange", "range_rate"})
    simulator = setup.simulator(receivers, run_serially)
    simulator.start_episodes([np.random.default_rng([1, row]) for row in range(receivers)])
    found, seen = [], []
    for _ in range(epochs):
        simulator.run_filter_only(1)
        shown = np.stack([simulator.epoch.pseudorange, simulator.epoch.range_rate], axis=1)
        truth = setup.world.satellites[int(simulator.epochs[0]), :, 6:].T
        found.append(shown - truth)
        seen.append(simulator.buffers.visible.copy())
    return simulator, np.array(found), np.array(seen)


def test_range_rates_of_carriers_telescope_and_follow_orbits_and_clocks():
    codes, rates, _ = measured(errors(carrier_sd_m=0.0025), 100, 200)
    assert np.abs(codes).max() < 1e-7
    sd = math.sqrt(2.0) * 0.0025 / 0.5
    assert rates.std() == pytest.approx(sd, rel=0.015)
    for lag, want in ((1, -0.5), (2, 0.0), (10, 0.0)):
        assert (rates[lag:] * rates[:-lag]).mean() / sd**2 == pytest.approx(want, abs=0.015)
    total = 0.5 * rates.sum(axis=0)  # white noise would add up to ten times that
    spread = pytest.approx(math.sqrt(2.0) * 0.0025, rel=4.0 / math.sqrt(2 * total.size))
    assert total.std() == spread
    codes, rates, _ = measured(errors(orbit_clock_sd_m=0.5, orbit_clock_s=120.0), 10, 200)
    change = np.gradient(codes, 0.5, axis=0)[1:-1]
    assert np.corrcoef(rates[1:-1].ravel(), change.ravel())[0, 1] > 0.99
    apart = np.corrcoef(codes[0].T) - np.eye(codes.shape[2])
    assert np.abs(apart).max() < 0.999


@pytest.mark.parametrize(
    ("source", "which", "sign"), [("ionosphere", 0, -1), ("troposphere", 1, 1)]
)
def test_one_delay_is_seen_through_obliquities(source, which, sign):
    """The ionosphere advances carriers by what it delays codes, the troposphere delays both."""
    given = errors(**{f"{source}_sd_m": 2.0, f"{source}_s": 120.0})
    codes, rates, elevation = measured(given, 10, 200)
    slant = obliquities(elevation)[which][:, None]
    zenith = codes / slant
    np.testing.assert_allclose(zenith, np.broadcast_to(zenith[:, :, :1], zenith.shape), atol=1e-6)
    assert slant.max() > 1.5 * slant.min()
    change, rates = np.gradient(codes, 0.5, axis=0)[1:-1], rates[1:-1]
    assert np.std(rates - sign * change) < 0.15 * np.std(change)


@pytest.mark.parametrize("order", [1, 2])
def test_wandering_errors_are_stationary_and_fall_to_1_over_e(order):
    given = (
        errors(noise_sd_m=(0.3, 0.0), smoothing_s=50.0)
        if order == 1
        else errors(orbit_clock_sd_m=0.3, orbit_clock_s=50.0)
    )
    codes, rates, _ = measured(given, 200, 101)
    count = codes[0].size
    for k in (0, 50, 100):
        assert codes[k].std() == pytest.approx(0.3, rel=4.0 / math.sqrt(2 * count))
    for lag in (1, 40, 100):
        found = (codes[lag] * codes[0]).mean() / 0.09
        want = correlation(np.array(0.5 * lag), 50.0, order == 2)
        assert found == pytest.approx(float(want), abs=4.0 / math.sqrt(count))
    assert correlation(np.array(50.0), 50.0, order == 2) == pytest.approx(math.exp(-1.0))
    if order == 1:
        assert np.abs(rates).max() < 1e-9  # the code's alone
    else:
        assert rates.std() == pytest.approx(0.3 * HALF_LIFE / 50.0, rel=0.05)


def test_obliquities_are_those_of_the_standard_and_end_with_their_world():
    ionosphere, troposphere, multipath, noise = obliquities(np.radians([90.0, 5.0, -3.0]))
    assert ionosphere[:2] == pytest.approx([1.0, 3.04], abs=0.02)  # 3.0 in texts on thin shells
    assert troposphere[0] == pytest.approx(1.0, abs=1e-6)
    assert troposphere[1] == pytest.approx(10.2, abs=0.1)
    assert multipath[:2] == pytest.approx([0.0, math.exp(-0.5)], abs=1e-3)
    assert noise[:2] == pytest.approx([0.0, math.exp(-5.0 / 6.9)], abs=1e-5)
    at_horizon = obliquities(np.zeros(1))
    for below, at in zip((ionosphere, troposphere, multipath, noise), at_horizon, strict=True):
        assert below[2] == at[0]
    elevation = np.radians(np.linspace(20.0, 60.0, 10))[:, None] * np.ones(3)
    table, time = stack_obliquities(np.concatenate([elevation, elevation])), 0.5 * np.arange(10.0)
    both = compute_mappings(table, np.tile(time, 2), np.arange(20))  # worlds do not mix
    for values, column, rate in ((table[..., 0], 0, 1), (table[..., 1], 2, 3)):
        np.testing.assert_array_equal(both[..., column], values)
        one = np.gradient(values[:10], 0.5, axis=0)
        np.testing.assert_array_equal(both[..., rate], np.concatenate([one, one]))
    np.testing.assert_array_equal(both[..., 4:], table[..., 2:])


@pytest.mark.parametrize(("name", "e_fold"), [("multipath_sd_m", 10.0), ("noise_sd_m", 6.9)])
def test_multipath_and_noise_follow_the_elevation(name, e_fold):
    codes, _, elevation = measured(errors(**{name: (0.2, 0.8), "smoothing_s": 1.0}), 200, 20)
    want = (0.2 + 0.8 * np.exp(-np.degrees(elevation) / e_fold)).mean(axis=0)
    np.testing.assert_allclose(codes.std(axis=1).mean(axis=0), want, rtol=0.05)
    assert want.max() > 1.2 * want.min()


@pytest.mark.parametrize("time_s", [0.7, 7200.0, 1e7])
def test_a_process_keeps_its_variance(time_s):
    f00, f01, f10, f11, l11, l21, l22 = process_coefficients(0.6, time_s, 0.5)
    beta = HALF_LIFE / time_s
    P = 0.36 * np.diag([1.0, beta**2])
    Phi, L = np.array([[f00, f01], [f10, f11]]), np.array([[l11, 0.0], [l21, l22]])
    scale = np.diag([1.0, 1.0 / beta])  # rates in units of their own
    kept = scale @ (Phi @ P @ Phi.T + L @ L.T) @ scale
    np.testing.assert_allclose(kept, 0.36 * np.eye(2), rtol=0, atol=1e-12)


def test_the_worlds_of_aviation():
    names = ("aviation-actual", "aviation-overbound")
    actual, overbound = (SIGNAL_ERRORS[name] for name in names)
    for item in ("carrier_sd_m", "ionosphere_sd_m", "troposphere_sd_m", "orbit_clock_sd_m"):
        assert 0.0 < getattr(actual, item) <= getattr(overbound, item)
    elevation = np.radians(np.linspace(10.0, 90.0, 17))
    assert (actual.code_variance(elevation) < overbound.code_variance(elevation)).all()
    # at 2 Hz a range rate has 7 mm/s
    assert ERRORS["aviation-actual"].rate_sd(0.5) == pytest.approx(0.00707, abs=1e-5)
    one, other = (
        TightlyCoupledSetup(scenario=name, receiver="matched", detector="never").combinations._all[
            0
        ]
        for name in names
    )
    np.testing.assert_array_equal(one.noise_variance, other.noise_variance)
    assert one.errors is not other.errors
    n = len(one.epoch_variance) // 2
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
    simulator.start_episodes([np.random.default_rng(row) for row in range(300)])
    fields = simulator.sensors.constants
    ideal = {"accel_matrix": np.eye(3), "gyro_matrix": np.eye(3)}
    for name in ("accel_bias", "gyro_bias", "g_dependence", "accel_matrix", "gyro_matrix"):
        rms = np.sqrt(np.mean((getattr(grade, name) - ideal.get(name, 0.0)) ** 2))
        drawn = fields[name] - ideal.get(name, 0.0)
        assert drawn.std() == pytest.approx(rms, rel=0.1)
        assert abs(drawn.mean()) < 0.15 * rms
    np.testing.assert_array_equal(fields["imu_noise"][0][:2], grade.noise[:2])
    out = np.empty(64)
    normals(*simulator.sensors.words["bias"][7], 1, out)
    rms = np.sqrt(np.mean(grade.accel_bias**2))
    np.testing.assert_allclose(fields["accel_bias"][7], rms * out[:3])


def events_run(given):
    """Setup and simulator of 40 whole episodes, errors of codes and rates, and what was seen."""
    setup = TightlyCoupledSetup(
        scenario=Scenario(errors=errors(), **FLIGHT),
        domain={"events": given},
        detector="never",
        timeline={"warmup_s": 20.0, "live_s": 10.0, "attack_s": 100.0, "time_to_alert_s": 0.0},
    )
    simulator, found, seen = played(setup, 40, setup.onset + setup.steps)
    codes, rates = found.transpose(2, 0, 1, 3)
    return setup, simulator, codes, rates, seen


def test_a_step_of_the_clock_is_common_to_all_signals_and_to_them_alone():
    setup, _, codes, rates, seen = events_run({"clock_step": 1.0, "clock_step_m": [2.0, 5.0]})
    steps = np.diff(np.where(seen, codes, np.nan), axis=0)
    jumps = np.nanmax(np.abs(steps), axis=2)
    assert (jumps.max(axis=0) > 1.99).all()
    assert (jumps.max(axis=0) < 5.01).all()
    first = jumps.argmax(axis=0)
    assert first.min() + 2 > setup.filter_only  # as epochs
    assert len(set(first)) > 20
    common = steps[first, np.arange(40)]
    mean = np.nanmean(common, axis=1)
    assert np.nanmax(np.abs(common - mean[:, None])) < 1e-7
    assert 5 < (mean > 0.0).sum() < 35
    assert np.abs(rates[seen]).max() < 1e-9


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


@pytest.mark.parametrize(("within_s", "parts"), [(None, (0.2, 0.2)), (100.0, (0.2, 1.0 - 0.8**4))])
def test_events_are_parts_of_episodes_or_as_likely_at_any_time(within_s, parts):
    events, rng = BenignEvents(clock_step=0.2, within_s=within_s), np.random.default_rng(3)
    sky = np.ones((801, 4), dtype=np.bool_), lambda _: (np.ones((1, 4)), np.zeros((1, 4)))
    keys = rng.integers(0, 2**63, (1000, 2), dtype=np.uint64)
    for epochs, part in zip((200, 800), parts, strict=True):
        window = EventWindow(1, epochs, 0.5, *sky)
        came = sum("clock_step" in draw_events(events, key, window) for key in keys)
        assert binomtest(came, len(keys), part).pvalue > 1e-4


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: SignalErrors(multipath_sd_m=(1.0,)), "`multipath_sd_m` must be two numbers"),
        (
            lambda: replace(ERRORS["white"], signals=SignalErrors(carrier_sd_m=0.003)),
            "`range_rate_sd_mps` must be 0 where range rates are",
        ),
        (lambda: BenignEvents(clock_step_m=[3.0, 1.0]), "`clock_step_m` must be two numbers"),
    ],
)
def test_what_cannot_be_is_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()
