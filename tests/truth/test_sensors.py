"""The arrays of a batch of sensors: what an episode begins with."""

from dataclasses import replace

import numpy as np
import pytest

from spoofgym.truth.clock import ReceiverClock
from spoofgym.truth.gnss_errors import ERRORS
from spoofgym.truth.sensors import IMU_GRADES, SOURCES, SensorBuffers

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
