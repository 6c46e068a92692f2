"""Inertial sensors: what an episode begins with, what they make of the truth, quantization."""

import math
from dataclasses import replace

import numpy as np
import pytest

from spoofgym.core.simd import LANES
from spoofgym.earth.wgs84 import STANDARD_GRAVITY
from spoofgym.truth._kernels import CHUNK
from spoofgym.truth.clock import ReceiverClock
from spoofgym.truth.gnss_errors import ERRORS
from spoofgym.truth.noise import normals, pad_count
from spoofgym.truth.sensors import IMU_GRADES, SOURCES, SensorBuffers

from .sensing import draw_group, modelled, run_of, sensed_by_eight, sensors_of

N = 5
BIAS_SD = np.linspace(1.0, 3.0, N)


def generators(receivers, first=0):
    return [np.random.default_rng(first + row) for row in range(receivers)]


def begin(buffers, rngs, grade="tactical", errors=ERRORS["groves"]):
    rows = np.arange(len(rngs))
    buffers.draw_keys(rows, rngs)
    buffers.start_episodes(rows, IMU_GRADES[grade], errors, BIAS_SD)
    return buffers


def test_an_episode_begins_with_the_errors_of_the_grade():
    clock = ReceiverClock(offset_m=7.0, drift_mps=3.0, phase_psd=0.1, frequency_psd=0.2)
    errors = replace(ERRORS["white"], code_sd_m=0.5, range_rate_sd_mps=0.1, clock=clock)
    buffers, grade = SensorBuffers(2, N, with_authentic=True), IMU_GRADES["consumer"]
    state, constants = buffers.fields, buffers.constants
    offsets = buffers.range_offset, buffers.rate_offset
    for array in (state.data, constants.data, buffers.authentic, *offsets):
        array[:] = np.nan
    begin(buffers, generators(2), "consumer", errors)
    assert np.isfinite(state.data).all()
    assert np.isfinite(constants.data).all()
    np.testing.assert_array_equal(buffers.authentic, np.ones((2, 2 * N)))
    assert SensorBuffers(2, N).authentic.size == 0
    for zero in (state["residual"], state["correlated"], *offsets):
        assert not zero.any()
    for b in range(2):
        for name in ("accel_bias", "gyro_matrix", "g_dependence"):
            np.testing.assert_array_equal(constants[name][b], getattr(grade, name))
        np.testing.assert_array_equal(state["clock"][b], [7.0, 3.0])
        np.testing.assert_array_equal(constants["clock_psd"][b], [0.1, 0.2])
        np.testing.assert_array_equal(constants["gnss_noise"][b], [0.5, 0.1])


def test_chance_is_that_of_the_seed_and_the_number_of_the_episode():
    many, one, seen = generators(3), generators(1, first=2), []
    for _ in range(3):
        batch, alone = begin(SensorBuffers(3, N), many), begin(SensorBuffers(1, N), one)
        one[0].standard_normal(1000)
        np.testing.assert_array_equal(batch.keys[:, 2], alone.keys[:, 0])
        biases = batch.fields["satellite_bias"][2], alone.fields["satellite_bias"][0]
        np.testing.assert_array_equal(*biases)
        seen += [tuple(key) for key in batch.keys.reshape(-1, 2)]
    assert len(set(seen)) == 9 * len(SOURCES)


def test_biases_have_the_standard_deviations_given():
    buffers = begin(SensorBuffers(400, N), generators(400))
    biases = buffers.fields["satellite_bias"] / BIAS_SD
    assert abs(biases.mean()) < 4.0 / np.sqrt(biases.size)
    assert biases.std() == pytest.approx(1.0, abs=4.0 / np.sqrt(2 * biases.size))
    assert np.abs(np.corrcoef(biases.T) - np.eye(N)).max() < 0.2


DEG = math.pi / 180.0


def rounded(samples, level, residual):
    """Quantization as it is defined: round each sample and what the last one left over."""
    out, left = np.empty_like(samples), residual
    for i, x in enumerate(samples):
        out[i] = level * math.floor((x + left) / level + 0.5)
        left += x - out[i]
    return out, left


def errors_of(rng, quantization):
    return {
        "accel_bias": rng.normal(0.0, 1.0, 3),
        "gyro_bias": rng.normal(0.0, 1.0, 3),
        "accel_matrix": rng.normal(0.0, 1.0, (3, 3)),
        "gyro_matrix": rng.normal(0.0, 1.0, (3, 3)),
        "g_dependence": rng.normal(0.0, 1.0, (3, 3)),
        "imu_noise": [*rng.uniform(0.1, 1.0, 2), *quantization],
        "residual": rng.normal(0.0, 1e-3, 6) * (np.repeat(quantization, 3) > 0.0),
    }


@pytest.mark.nojit
@pytest.mark.parametrize("count", [1, CHUNK, 2 * CHUNK + 3])
@pytest.mark.parametrize("together", [True, False])
def test_eight_receivers_sense_as_each_alone(count, together):
    rng = np.random.default_rng(count)
    lengths, most = rng.uniform(0.005, 0.02, 100), 100 - count
    truth, deviates = rng.normal(0.0, 1.0, (6, 100)), rng.normal(0.0, 1.0, (LANES, 6, count))
    levels = [(0.0, 0.0), (1e-2, 0.0), (0.0, 1e-3), *rng.uniform(1e-5, 1e-2, (5, 2))]
    errors, fields = [errors_of(rng, level) for level in levels], sensors_of(LANES)
    for b, each in enumerate(errors):
        for name, value in each.items():
            fields.put(name, np.array([b]), value)
    first = np.full(LANES, most) if together else rng.integers(0, most + 1, LANES)
    active = np.ones(LANES) if together else (np.arange(LANES) % 3 > 0).astype(float)
    before = fields["residual"].copy()
    got = sensed_by_eight(fields, run_of(truth, lengths), deviates, first, active)
    for b, each in enumerate(errors):
        now = slice(first[b], first[b] + count)
        noise = np.repeat(each["imu_noise"][:2], 3)[:, None] * deviates[b] * lengths[now] ** -0.5
        want = modelled(each, truth[:, now]) + noise
        for c in range(6):
            level, left = levels[b][c // 3], each["residual"][c]
            expected, left = rounded(want[c], level, left) if level else (want[c], left)
            np.testing.assert_allclose(got[b, c], expected, rtol=0, atol=max(1e-6 * level, 1e-10))
            kept = left if active[b] else before[b, c]
            np.testing.assert_allclose(fields["residual"][b, c], kept, rtol=0, atol=1e-9)


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
    aviation, consumer = IMU_GRADES["aviation"], IMU_GRADES["consumer"]
    for better, worse in ((aviation, grade), (grade, consumer)):
        for name in ("accel_bias", "gyro_bias", "noise"):
            assert (np.abs(getattr(worse, name)) > np.abs(getattr(better, name))).all()


def test_drawn_samples_are_the_error_model_of_the_grade():
    grade, count, n = IMU_GRADES["consumer"], 50, 8
    rng = np.random.default_rng(5)
    step = 0.01
    buffers = SensorBuffers(1, n)
    buffers.draw_keys(np.arange(1), [np.random.default_rng(9)])
    buffers.start_episodes(np.arange(1), grade, ERRORS["white"], np.zeros(n))
    residual, levels = np.zeros(6), np.repeat(grade.noise[2:], 3)
    errors = {name: buffers.constants[name][0] for name in buffers.constants.shapes}
    keys, first = buffers.words["imu"][0], np.array([20])
    for epoch in (1, 2):
        truth, size = rng.normal(0.0, 1.0, (6, 80)), pad_count(6 * 60)  # of the longest interval
        run, samples = run_of(truth, np.full(80, step)), np.full(size, np.nan)
        now, dt = np.array([epoch], dtype=np.uint64), np.empty(60)
        sensors = buffers.fields.data, buffers.constants.data
        given = run, first, count, buffers.words.data, now, *sensors, samples, dt
        draw_group(*given, np.ones(1), np.empty(8 * CHUNK))
        deviates = np.empty(size)
        normals(keys[0], keys[1], epoch, deviates)
        white = deviates[: 6 * count].reshape(6, -1)
        noise = np.repeat(grade.noise[:2], 3)[:, None] * white * step**-0.5
        want = modelled(errors, truth[:, 20:70]) + noise
        for c in range(6):
            expected, residual[c] = rounded(want[c], levels[c], residual[c])
            got = samples[c * count : (c + 1) * count]
            np.testing.assert_allclose(got, expected, rtol=0, atol=1e-6 * levels[c])
        np.testing.assert_allclose(buffers.fields["residual"][0], residual, rtol=0, atol=1e-12)
