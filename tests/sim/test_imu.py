"""Inertial sensors: what they make of the truth, their noise, and quantization."""

import math
from itertools import pairwise

import numpy as np
import pytest
import scipy.stats

from spoofgym.earth.wgs84 import STANDARD_GRAVITY
from spoofgym.sim._kernels import imu_block
from spoofgym.sim.gnss import ERRORS
from spoofgym.sim.imu import IMU_GRADES, quantize, sense
from spoofgym.sim.noise import normals, padded
from spoofgym.sim.sensors import SensorBuffers

DEG = math.pi / 180.0


def rounded(samples, level, residual):
    """Quantization as it is defined: round each sample and what the last one left over."""
    out, left = np.empty_like(samples), residual
    for i, x in enumerate(samples):
        out[i] = level * math.floor((x + left) / level + 0.5)
        left += x - out[i]
    return out, left


@pytest.mark.nojit
@pytest.mark.parametrize("grade", IMU_GRADES)
def test_quantization_is_that_of_its_definition(grade):
    levels = np.repeat(IMU_GRADES[grade].noise[2:], 3)
    rng = np.random.default_rng(1)
    residual, expected_residual = np.zeros(6), np.zeros(6)
    for count in (100, 1, 37):  # the residual goes on from block to block
        truth = rng.normal(0.0, 3.0 * levels[:, None], (6, count)) + 0.3 * levels[:, None]
        samples = np.full((6, 120), np.nan)
        samples[:, :count] = truth
        quantize(samples, count, levels[0], levels[3], residual)
        for c in range(6):
            want, expected_residual[c] = rounded(truth[c], levels[c], expected_residual[c])
            np.testing.assert_allclose(samples[c, :count], want, rtol=0, atol=1e-6 * levels[c])
        np.testing.assert_allclose(residual, expected_residual, rtol=0, atol=1e-9 * levels[0])
        assert np.isnan(samples[:, count:]).all()


@pytest.mark.nojit
def test_quantization_loses_nothing_in_the_long_run():
    rng = np.random.default_rng(2)
    truth = rng.normal(0.0, 1e-4, (6, 5000))
    samples, residual = truth.copy(), np.zeros(6)
    quantize(samples, 5000, 1e-2, 2e-4, residual)
    steps = samples / np.repeat([1e-2, 2e-4], 3)[:, None]
    np.testing.assert_allclose(steps, np.round(steps), rtol=0, atol=1e-9)
    lag = np.cumsum(truth, axis=1) - np.cumsum(samples, axis=1)
    assert (np.abs(lag) <= 0.5 * np.repeat([1e-2, 2e-4], 3)[:, None] * (1.0 + 1e-9)).all()
    np.testing.assert_allclose(lag[:, -1], residual, rtol=0, atol=1e-12)


@pytest.mark.nojit
def test_without_a_level_samples_stay_as_they_are():
    truth = np.random.default_rng(3).normal(0.0, 10.0, (6, 50))
    samples, residual = truth.copy(), np.zeros(6)
    quantize(samples, 50, 0.0, 0.0, residual)
    np.testing.assert_allclose(samples, truth, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(residual, 0.0)


def test_a_sensor_is_linear_in_the_truth():
    rng = np.random.default_rng(4)
    truth, noise = rng.normal(0.0, 1.0, (6, 30)), rng.normal(0.0, 1.0, 30)
    row, out = tuple(rng.normal(0.0, 1.0, 6)), np.empty(30)
    root_rate = np.full(30, 10.0)
    sense(tuple(truth), noise, root_rate, row, 0.7, 0.3, out)
    np.testing.assert_allclose(out, 0.7 + 0.3 * 10.0 * noise + np.array(row) @ truth, rtol=1e-12)


@pytest.mark.parametrize("step", [0.01, 0.002])
def test_white_noise_has_its_density_at_any_rate(step):
    out, zeros = np.empty(100 * 64), np.zeros(100 * 64)
    noise = np.empty_like(out)
    normals(np.uint64(3), np.uint64(4), 0, noise)
    sense((zeros,) * 6, noise, np.full(len(out), step**-0.5), (0.0,) * 6, 0.0, 2e-3, out)
    density = out.var() * step
    low, high = scipy.stats.chi2.ppf([1e-4, 1.0 - 1e-4], len(out)) / len(out)
    assert low * 2e-3**2 < density < high * 2e-3**2


def test_grades_are_given_in_the_units_of_data_sheets():
    grade = IMU_GRADES["tactical"]
    micro_g, degree_per_hour = STANDARD_GRAVITY * 1e-6, DEG / 3600.0
    np.testing.assert_allclose(grade.accel_bias, np.array([900, -1300, 800]) * micro_g)
    np.testing.assert_allclose(grade.gyro_bias, np.array([-9, 13, -8]) * degree_per_hour)
    assert grade.accel_matrix[0, 1] == pytest.approx(-300e-6)
    assert grade.accel_matrix[1, 1] == pytest.approx(1.0 - 600e-6)
    assert grade.gyro_matrix[1, 2] == pytest.approx(-150e-6)
    assert grade.g_dependence[0, 2] == pytest.approx(-0.6 * degree_per_hour / STANDARD_GRAVITY)
    np.testing.assert_allclose(
        grade.noise, [100 * micro_g, 0.01 * DEG / 60.0, 1e-2, 2e-4], rtol=1e-12
    )


def test_each_grade_is_worse_than_the_one_before():
    grades = [IMU_GRADES[name] for name in ("aviation", "tactical", "consumer")]
    for better, worse in pairwise(grades):
        assert (np.abs(worse.accel_bias) > np.abs(better.accel_bias)).all()
        assert (np.abs(worse.gyro_bias) > np.abs(better.gyro_bias)).all()
        assert (worse.noise > better.noise).all()


def test_a_block_of_samples_is_the_error_model_of_the_grade():
    grade, samples_of_block, n = IMU_GRADES["consumer"], 50, 8
    rng = np.random.default_rng(5)
    step = 0.01
    buffers = SensorBuffers(2, n)
    generators = [np.random.default_rng(seed) for seed in (8, 9)]
    buffers.draw_keys(np.arange(2), generators)
    buffers.begin(np.arange(2), grade, ERRORS["white"], np.zeros(n))
    residual = np.zeros(6)
    levels = np.repeat(grade.noise[2:], 3)
    scratch = np.empty(padded(6 * samples_of_block))
    for epoch in (1, 2):
        truth = rng.normal(0.0, 1.0, (6, samples_of_block))
        out = np.empty((6, samples_of_block))
        root_rate = np.full(samples_of_block, step**-0.5)
        keys = buffers.keys[0, 1]
        imu_block(buffers.state, 1, keys, epoch, tuple(truth), root_rate, scratch, out)

        deviates = np.empty_like(scratch)
        normals(keys[0], keys[1], epoch, deviates)
        white = deviates[: 6 * samples_of_block].reshape(6, -1) * step**-0.5
        f, w = truth[:3], truth[3:]
        want = np.vstack(
            [
                grade.accel_bias[:, None] + grade.accel_matrix @ f + grade.noise[0] * white[:3],
                grade.gyro_bias[:, None]
                + grade.gyro_matrix @ w
                + grade.g_dependence @ f
                + grade.noise[1] * white[3:],
            ]
        )
        for c in range(6):
            expected, residual[c] = rounded(want[c], levels[c], residual[c])
            np.testing.assert_allclose(out[c], expected, rtol=0, atol=1e-6 * levels[c])
        np.testing.assert_allclose(buffers.state.residual[1], residual, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(buffers.state.residual[0], 0.0)  # the other receiver's
