"""GNSS errors of ranges and positions: what stays, what is white, and how they add up."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from spoofgym.core.compile import njit
from spoofgym.core.simd import load
from spoofgym.truth._kernels import first_errors, measure, measure_loose
from spoofgym.truth.clock import ReceiverClock
from spoofgym.truth.gnss_errors import ERRORS, GnssErrors, PositionErrors
from spoofgym.truth.noise import pad_count
from spoofgym.truth.run import InertialErrors, flown_world
from spoofgym.truth.sensors import IMU_GRADES, SensorBuffers

from ..lazily import Lazily

N = 8


def test_biases_in_the_zenith_and_at_the_horizon_and_errors_measured_on_the_trolley():
    errors = ERRORS["groves"]
    zenith, horizon = errors.bias_sd(np.array([math.pi / 2, 0.0]))
    assert zenith == pytest.approx(math.sqrt(1.0 + 2.0**2 + 0.2**2))
    assert horizon == pytest.approx(math.sqrt(1.0 + 2.0**2 / 0.101 + 0.2**2 / 0.002))
    elevation = np.radians([10.0, 45.0, 80.0])
    assert (np.diff(errors.bias_sd(elevation)) < 0.0).all()  # the lower, the longer the path
    np.testing.assert_array_equal(ERRORS["white"].bias_sd(elevation), 0.0)
    np.testing.assert_array_equal(ERRORS["zhong2025"].bias_sd(elevation), 1.0)
    # autocorrelation of the code error: 0.73 at 1 s, 0.32 at 30 s, 0.02 at 120 s
    errors = ERRORS["trolley"]
    wandering, white = errors.correlated_sd_m**2, errors.code_sd_m**2
    for lag, found in ((1.0, 0.73), (30.0, 0.32), (120.0, 0.02)):
        model = wandering * math.exp(-lag / errors.correlation_s) / (wandering + white)
        assert model == pytest.approx(found, abs=0.06)


@njit
def measured(sensors, constants, keys, epoch, tau, sky, noise, added, out):
    """Pseudoranges and range rates of a group, in all rows of `out`."""
    n = out.shape[0] // 2
    k, dt = load(epoch, 0), load(tau, 0)
    both = sensors, 0, constants, 0
    measure(both, n, keys, 0, k, dt, sky, noise, added, added[:0], out, 0)


def epochs_of(errors, count, tau=0.5, bias_sd=0.0, change=None, seed=3):
    """(count, N) errors of pseudoranges and range rates of one receiver, and its clocks."""
    buffers = SensorBuffers(1, N, with_authentic=True)
    buffers.draw_keys(np.arange(1), [np.random.default_rng(seed)])
    buffers.start_episodes(np.arange(1), IMU_GRADES["aviation"], errors, np.full(N, bias_sd))
    if change is not None:
        change(buffers)
    added = np.concatenate([buffers.range_offset[0], buffers.rate_offset[0], buffers.authentic[0]])
    truth = np.zeros((1, N, 8))
    truth[0, :, 6], truth[0, :, 7] = 2.2e7 + np.arange(N), 100.0 * np.arange(N)
    out, clocks = np.empty((count, 2 * N)), np.empty((count, 2))
    own = [each.data for each in (buffers.fields, buffers.constants, buffers.words)]
    for k in range(count):
        now = np.array([k], dtype=np.uint64), np.array([tau if k else 0.0])
        measured(*own, *now, truth.ravel(), np.empty(pad_count(2 * N)), added, out[k])
        clocks[k] = buffers.fields["clock"][0]
    out -= truth[0, :, 6:].T.ravel()
    return out[:, :N], out[:, N:], clocks, buffers.fields


SILENT = GnssErrors(
    code_sd_m=0.0,
    range_rate_sd_mps=0.0,
    signal_in_space_sd_m=0.0,
    zenith_iono_sd_m=0.0,
    zenith_tropo_sd_m=0.0,
    clock=ReceiverClock(offset_m=1000.0, drift_mps=-20.0),
)


def test_sources_of_noise_have_streams_of_their_own_and_without_them_clock_and_attack_are_left():
    def attack(buffers):
        buffers.range_offset[0] = np.arange(N) * 3.0
        buffers.rate_offset[0] = np.arange(N) * -0.1

    ranges, rates, clocks, _ = epochs_of(SILENT, 5, change=attack)
    np.testing.assert_array_equal(clocks[0], [1000.0, -20.0])
    np.testing.assert_allclose(clocks[:, 0], 1000.0 - 10.0 * np.arange(5))
    added = clocks[:, :1] + 3.0 * np.arange(N)
    np.testing.assert_allclose(ranges, added, rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        rates, np.tile(-20.0 - 0.1 * np.arange(N), (5, 1)), rtol=0, atol=1e-12
    )
    white = replace(SILENT, code_sd_m=1.0, range_rate_sd_mps=0.1)
    quiet, rates, quiet_clocks, _ = epochs_of(white, 30)
    noisy, _, clocks, _ = epochs_of(replace(white, clock=ReceiverClock(phase_psd=1.0)), 30)
    np.testing.assert_allclose(noisy - clocks[:, :1], quiet - quiet_clocks[:, :1], atol=2e-8)
    both, same, _, fields = epochs_of(replace(white, correlated_sd_m=0.75), 30)
    np.testing.assert_array_equal(rates, same)
    np.testing.assert_allclose((both - quiet)[-1], fields["correlated"][0], rtol=0, atol=1e-8)
    alone, _, _, _ = epochs_of(replace(SILENT, correlated_sd_m=0.75), 30)
    np.testing.assert_allclose(both - quiet, alone - quiet_clocks[:, :1], rtol=0, atol=2e-8)


def test_biases_stay_and_the_rest_is_white():
    count = 2000
    ranges, rates, _, fields = epochs_of(
        replace(ERRORS["groves"], clock=ReceiverClock(offset_m=0.0, drift_mps=0.0)),
        count,
        bias_sd=3.0,
    )
    white = ranges - fields["satellite_bias"][0]
    for errors, sd in ((white, 1.0), (rates, 0.02)):
        assert scipy.stats.kstest(errors.ravel() / sd, "norm").pvalue > 1e-3
        correlation = (errors[1:] * errors[:-1]).mean() / sd**2
        assert abs(correlation) < 4.0 / math.sqrt(count * N)
        channels = np.corrcoef(errors.T) - np.eye(N)
        assert np.abs(channels).max() < 5.0 / math.sqrt(count)
    assert abs(np.corrcoef(white.ravel(), rates.ravel())[0, 1]) < 4.0 / math.sqrt(count * N)
    assert 0.5 < fields["satellite_bias"][0].std() < 6.0


WANDERING = replace(
    SILENT,
    correlated_sd_m=0.75,
    correlation_s=35.0,
    clock=ReceiverClock(offset_m=0.0, drift_mps=0.0),
)


def test_correlated_errors_are_gauss_markov_and_stationary():
    tau = 5.0
    ranges = np.concatenate(
        [epochs_of(WANDERING, 200, tau, seed=seed)[0] for seed in range(40)], axis=1
    )
    count = ranges.shape[1]  # independent histories
    for k in (0, 1, 50, 199):
        assert ranges[k].std() == pytest.approx(0.75, rel=4.0 / math.sqrt(2 * count))
    for lag in (1, 5, 20):
        found = (ranges[lag:] * ranges[:-lag]).mean() / 0.75**2
        assert found == pytest.approx(math.exp(-lag * tau / 35.0), abs=0.12)
    # what drives it is white
    driving = ranges[1:] - math.exp(-tau / 35.0) * ranges[:-1]
    spread = 0.75 * math.sqrt(1.0 - math.exp(-2.0 * tau / 35.0))
    assert driving.std() == pytest.approx(spread, rel=0.02)
    assert abs((driving[1:] * driving[:-1]).mean()) < 0.02 * spread**2


def test_errors_of_authentic_signals_can_be_taken_away_with_the_receivers_noise_or_without():
    def capture(buffers):
        buffers.authentic[0, :3] = -1.0
        buffers.authentic[0, 3:5] = 0.0
        buffers.authentic[0, 5] = 0.25
        buffers.authentic[0, N : N + 2] = -1.0
        buffers.authentic[0, N + 2] = 0.0

    errors = replace(
        ERRORS["groves"], correlated_sd_m=2.0, clock=ReceiverClock(offset_m=5.0, drift_mps=1.0)
    )
    ranges, rates, _, _ = epochs_of(errors, 1, bias_sd=3.0, change=capture)
    own, own_rates, _, fields = epochs_of(errors, 1, bias_sd=3.0)
    np.testing.assert_allclose(ranges[0, :3], 5.0, rtol=0, atol=2e-8)
    np.testing.assert_allclose(rates[0, :2], 1.0, rtol=0, atol=1e-12)
    path = (fields["satellite_bias"] + fields["correlated"])[0]
    np.testing.assert_allclose(ranges[0, 3:5], (own[0] - path)[3:5], rtol=0, atol=2e-8)
    assert np.abs(ranges[0, 3:5] - 5.0).min() > 1e-3  # the noise of the receiver
    np.testing.assert_allclose(ranges[0, 5], own[0, 5] - 0.75 * path[5], rtol=0, atol=2e-8)
    np.testing.assert_array_equal(ranges[0, 6:], own[0, 6:])
    np.testing.assert_array_equal(rates[0, 2:], own_rates[0, 2:])


WORLD = Lazily(flown_world, "shadmehri2025", 0.1)


def measured_fixes(decay, receivers=300, epochs=30):
    errors, inertial = PositionErrors(decay=decay), InertialErrors()
    keys = np.random.default_rng(1).integers(0, 2**63, (receivers, 3, 2)).astype(np.uint64)
    first, error = np.empty((receivers, 15)), np.empty((receivers, 3))
    deviates = np.empty(128)
    first_errors(keys, inertial.initial_sd, errors.sd, deviates, first, error)
    epoch, displacement = np.zeros(receivers, dtype=np.int64), np.zeros((receivers, 3))
    displacement[:, 1] = 7.0
    samples, fix = np.empty((receivers, WORLD.samples, 6)), np.empty((receivers, 3))
    world = WORLD.run, WORLD.position_e, WORLD.C_el, WORLD.imu_interval_s
    given = inertial.noise, first[:, 9:].copy(), decay, errors.sd, displacement
    noise, seen = [], []
    for k in range(1, epochs + 1):
        measure_loose(keys, epoch, *world, *given, deviates, error, samples, fix)
        seen.append((fix - WORLD.position_e[k]) @ WORLD.C_el[k])
        truth = WORLD.run[(k - 1) * WORLD.samples : k * WORLD.samples]
        bias = np.hstack([first[:, 12:], first[:, 9:12]])
        noise.append(samples - truth - bias[:, None])
    return first, np.array(seen), np.concatenate(noise, axis=1)


@pytest.mark.parametrize("decay", [0.0, 0.9, 0.999])
def test_fixes_err_by_their_errors_and_the_displacement(decay):
    _, seen, _ = measured_fixes(decay)
    apart, sd = seen - [0.0, 7.0, 0.0], np.array([1.6, 1.6, 3.0])
    assert np.abs(apart.mean(axis=(0, 1))).max() < 0.6
    np.testing.assert_allclose(apart.std(axis=(0, 1)), sd, rtol=0.1)
    steps = np.diff(apart, axis=0).std(axis=(0, 1))
    np.testing.assert_allclose(steps, np.sqrt(2.0 - 2.0 * decay) * sd, rtol=0.05)


def test_inertial_noise_and_biases_have_their_density():
    first, _, noise = measured_fixes(0.999)
    np.testing.assert_allclose(first.std(axis=0), InertialErrors().initial_sd, rtol=0.15)
    level = InertialErrors().noise.repeat(3) / np.sqrt(WORLD.imu_interval_s)
    np.testing.assert_allclose(noise.std(axis=(0, 1)), level, rtol=0.02)
    assert np.abs(np.corrcoef(noise.reshape(-1, 6).T) - np.eye(6)).max() < 0.02
