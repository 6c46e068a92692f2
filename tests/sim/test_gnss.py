"""GNSS errors: what stays with a satellite, what is white, and how they add up."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from spoofgym.sim._kernels import gnss_epoch
from spoofgym.sim.clock import ReceiverClock
from spoofgym.sim.gnss import ERRORS, GnssErrors
from spoofgym.sim.imu import IMU_GRADES
from spoofgym.sim.noise import padded
from spoofgym.sim.sensors import SensorBuffers

N = 8


def test_biases_in_the_zenith_and_at_the_horizon():
    errors = ERRORS["groves"]
    zenith, horizon = errors.bias_sd(np.array([math.pi / 2, 0.0]))
    assert zenith == pytest.approx(math.sqrt(1.0 + 2.0**2 + 0.2**2))
    assert horizon == pytest.approx(math.sqrt(1.0 + 2.0**2 / 0.101 + 0.2**2 / 0.002))
    elevation = np.radians(np.arange(5.0, 90.0, 5.0))
    assert (np.diff(errors.bias_sd(elevation)) < 0.0).all()  # the lower, the longer the path


def test_biases_of_the_presets():
    elevation = np.radians([10.0, 45.0, 80.0])
    np.testing.assert_array_equal(ERRORS["white"].bias_sd(elevation), 0.0)
    np.testing.assert_array_equal(ERRORS["zhong2025"].bias_sd(elevation), 1.0)


@pytest.mark.parametrize(
    "name",
    [
        "code_sd_m",
        "range_rate_sd_mps",
        "signal_in_space_sd_m",
        "zenith_iono_sd_m",
        "zenith_tropo_sd_m",
    ],
)
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_standard_deviations_must_be_finite_and_not_negative(name, value):
    with pytest.raises(ValueError, match=f"`{name}` must be finite and >= 0, got {value}"):
        replace(ERRORS["groves"], **{name: value})


def epochs_of(errors, count, tau=0.5, bias_sd=0.0, change=None):
    """(count, N) errors of pseudoranges and range rates of one receiver, and its clocks."""
    buffers = SensorBuffers(1, N)
    generator = np.random.default_rng(3)
    buffers.draw_keys(np.arange(1), [generator])
    buffers.begin(np.arange(1), IMU_GRADES["aviation"], errors, np.full(N, float(bias_sd)))
    if change is not None:
        change(buffers.state)
    truth = np.zeros((N, 8))
    truth[:, 6], truth[:, 7] = 2.2e7 + np.arange(N), 100.0 * np.arange(N)
    ranges, rates, clocks = np.empty((count, N)), np.empty((count, N)), np.empty((count, 2))
    noise = np.empty(padded(2 * N))
    for k in range(count):
        gnss_epoch(
            buffers.state,
            0,
            buffers.keys[2, 0],
            buffers.keys[1, 0],
            k,
            tau if k else 0.0,
            truth,
            noise,
            ranges[k],
            rates[k],
        )
        clocks[k] = buffers.state.clock[0]
    return ranges - truth[:, 6], rates - truth[:, 7], clocks, buffers.state


SILENT = GnssErrors(
    code_sd_m=0.0,
    range_rate_sd_mps=0.0,
    signal_in_space_sd_m=0.0,
    zenith_iono_sd_m=0.0,
    zenith_tropo_sd_m=0.0,
    clock=ReceiverClock(offset_m=1000.0, drift_mps=-20.0),
)


def test_without_noise_only_the_clock_is_left():
    ranges, rates, clocks, _ = epochs_of(SILENT, 5)
    np.testing.assert_allclose(clocks[:, 0], 1000.0 - 10.0 * np.arange(5))
    np.testing.assert_allclose(ranges, np.tile(clocks[:, :1], (1, N)), rtol=0, atol=1e-8)
    np.testing.assert_allclose(rates, -20.0, rtol=0, atol=1e-12)


def test_an_attack_adds_to_every_channel():
    def attack(state):
        state.range_offset[0] = np.arange(N) * 3.0
        state.rate_offset[0] = np.arange(N) * -0.1

    ranges, rates, _, _ = epochs_of(SILENT, 1, change=attack)
    np.testing.assert_allclose(ranges[0], 1000.0 + 3.0 * np.arange(N), rtol=0, atol=1e-8)
    np.testing.assert_allclose(rates[0], -20.0 - 0.1 * np.arange(N), rtol=0, atol=1e-12)


def test_biases_stay_and_the_rest_is_white():
    count = 2000
    ranges, rates, _, state = epochs_of(
        replace(ERRORS["groves"], clock=ReceiverClock(offset_m=0.0, drift_mps=0.0)),
        count,
        bias_sd=3.0,
    )
    white = ranges - state.satellite_bias[0]
    for errors, sd in ((white, 1.0), (rates, 0.02)):
        assert scipy.stats.kstest(errors.ravel() / sd, "norm").pvalue > 1e-3
        correlation = (errors[1:] * errors[:-1]).mean() / sd**2
        assert abs(correlation) < 4.0 / math.sqrt(count * N)
        channels = np.corrcoef(errors.T) - np.eye(N)
        assert np.abs(channels).max() < 5.0 / math.sqrt(count)
    assert abs(np.corrcoef(white.ravel(), rates.ravel())[0, 1]) < 4.0 / math.sqrt(count * N)
    assert 0.5 < state.satellite_bias[0].std() < 6.0


def test_a_noisy_clock_wanders_as_its_densities_say():
    count, tau = 4000, 0.5
    clock = ReceiverClock(offset_m=0.0, drift_mps=0.0, phase_psd=0.3, frequency_psd=0.2)
    _, _, clocks, _ = epochs_of(replace(SILENT, clock=clock), count, tau)
    noise = np.column_stack([np.diff(clocks[:, 0]) - tau * clocks[:-1, 1], np.diff(clocks[:, 1])])
    Q = np.array(
        [[0.3 * tau + 0.2 * tau**3 / 3.0, 0.2 * tau**2 / 2.0], [0.2 * tau**2 / 2.0, 0.2 * tau]]
    )
    np.testing.assert_allclose(np.cov(noise.T), Q, rtol=0.12, atol=0)
    whitened = np.linalg.solve(np.linalg.cholesky(Q), noise.T)
    assert scipy.stats.kstest(whitened.ravel(), "norm").pvalue > 1e-3
    assert abs(np.mean(whitened[:, 1:] * whitened[:, :-1])) < 4.0 / math.sqrt(2 * count)


def test_the_clock_stands_still_at_the_first_epoch():
    _, _, clocks, _ = epochs_of(SILENT, 1)
    np.testing.assert_array_equal(clocks[0], [1000.0, -20.0])


def test_noise_of_other_sources_does_not_move_with_the_clock_s():
    quiet, _, _, _ = epochs_of(replace(SILENT, code_sd_m=1.0), 20)
    noisy, _, clocks, _ = epochs_of(
        replace(SILENT, code_sd_m=1.0, clock=ReceiverClock(phase_psd=1.0)), 20
    )
    np.testing.assert_allclose(
        noisy - clocks[:, :1], quiet - (1000.0 - 10.0 * np.arange(20)[:, None]), atol=2e-8
    )
