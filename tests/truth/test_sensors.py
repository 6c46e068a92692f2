"""The arrays of a batch of sensors: what an episode begins with."""

import copy
import pickle

import numpy as np
import pytest

from spoofgym.truth.clock import ReceiverClock
from spoofgym.truth.gnss_errors import ERRORS, GnssErrors
from spoofgym.truth.sensors import CONSTANTS, IMU_GRADES, SOURCES, SensorBuffers, sensor_shapes

N = 5
BIAS_SD = np.linspace(1.0, 3.0, N)


def begun(seeds, rows=None, receivers=None, errors=ERRORS["groves"], grade="tactical"):
    rows = np.arange(len(seeds)) if rows is None else np.array(rows)
    count = len(seeds) if receivers is None else receivers
    buffers = SensorBuffers(count, N, with_authentic=True)
    generators = [np.random.default_rng(seed) for seed in seeds]
    buffers.draw_keys(rows, generators)
    buffers.start_episodes(rows, IMU_GRADES[grade], errors, BIAS_SD)
    return buffers


def arrays_of(buffers):
    """All arrays of a batch, by name."""
    lanes = buffers.fields, buffers.constants
    fields = {name: each[name] for each in lanes for name in each.shapes}
    plain = ("epoch", "range_offset", "rate_offset", "authentic")
    return {**fields, **{name: getattr(buffers, name) for name in plain}}


@pytest.mark.nojit
@pytest.mark.parametrize(("receivers", "channels"), [(1, 4), (3, 12), (9, 5)])
def test_every_receiver_has_all_quantities(receivers, channels):
    buffers = SensorBuffers(receivers, channels)
    for name, shape in sensor_shapes(channels).items():
        assert buffers.fields[name].shape == (receivers, *shape)
    for name, shape in CONSTANTS.items():
        assert buffers.constants[name].shape == (receivers, *shape)
    assert buffers.keys.shape == (len(SOURCES), receivers, 2)
    assert buffers.keys.dtype == np.uint64
    assert buffers.authentic.size == 0
    attacked = SensorBuffers(receivers, channels, with_authentic=True).authentic
    np.testing.assert_array_equal(attacked, np.ones((receivers, 2 * channels)))


def test_an_episode_begins_with_the_errors_of_the_grade():
    clock = ReceiverClock(offset_m=7.0, drift_mps=3.0, phase_psd=0.1, frequency_psd=0.2)
    errors = GnssErrors(
        code_sd_m=0.5,
        range_rate_sd_mps=0.1,
        signal_in_space_sd_m=1.0,
        zenith_iono_sd_m=0.0,
        zenith_tropo_sd_m=0.0,
        clock=clock,
    )
    buffers = SensorBuffers(2, N, with_authentic=True)
    buffers.fields.data[:] = buffers.constants.data[:] = np.nan
    buffers.range_offset[:] = buffers.rate_offset[:] = buffers.authentic[:] = np.nan
    generators = [np.random.default_rng(seed) for seed in (1, 2)]
    grade = IMU_GRADES["consumer"]
    buffers.draw_keys(np.arange(2), generators)
    buffers.start_episodes(np.arange(2), grade, errors, BIAS_SD)
    state, constants = buffers.fields, buffers.constants
    assert np.isfinite(state.data).all()
    assert np.isfinite(constants.data).all()
    assert buffers.authentic.all()
    for b in range(2):
        np.testing.assert_array_equal(constants["accel_bias"][b], grade.accel_bias)
        np.testing.assert_array_equal(constants["gyro_matrix"][b], grade.gyro_matrix)
        np.testing.assert_array_equal(constants["g_dependence"][b], grade.g_dependence)
        np.testing.assert_array_equal(state["clock"][b], [7.0, 3.0])
        np.testing.assert_array_equal(constants["clock_psd"][b], [0.1, 0.2])
        np.testing.assert_array_equal(constants["gnss_noise"][b], [0.5, 0.1])
        for zero in (
            state["residual"],
            state["correlated"],
            buffers.range_offset,
            buffers.rate_offset,
        ):
            assert not zero[b].any()


@pytest.mark.parametrize("receivers", [1, 9])
def test_sensors_that_are_alike_keep_their_constants_once(receivers):
    rngs = [np.random.default_rng(seed) for seed in range(receivers)]
    each, together = (SensorBuffers(receivers, N, alike=alike) for alike in (False, True))
    assert together.constants.groups == 1
    for buffers in (each, together):
        buffers.draw_keys(np.arange(receivers), rngs)
        buffers.start_episodes(
            np.arange(receivers), IMU_GRADES["tactical"], ERRORS["groves"], BIAS_SD
        )
    taken = SensorBuffers(receivers, N, alike=True)
    taken.copy_rows(np.array([0]), together, np.array([receivers - 1]))
    for name in CONSTANTS:
        np.testing.assert_array_equal(together.constants[name], each.constants[name])
        np.testing.assert_array_equal(taken.constants[name], each.constants[name])


def test_chance_depends_on_the_seed_alone():
    batch = begun([10, 11, 12])
    for row, seed in enumerate([10, 11, 12]):
        alone = begun([seed])
        np.testing.assert_array_equal(batch.keys[:, row], alone.keys[:, 0])
        np.testing.assert_array_equal(
            batch.fields["satellite_bias"][row], alone.fields["satellite_bias"][0]
        )


def test_sources_receivers_and_episodes_have_keys_of_their_own():
    generator = np.random.default_rng(4)
    buffers = SensorBuffers(1, N)
    seen = []
    for _ in range(3):  # three episodes of one receiver
        buffers.draw_keys(np.arange(1), [generator])
        buffers.start_episodes(np.arange(1), IMU_GRADES["aviation"], ERRORS["white"], BIAS_SD)
        seen += [tuple(key) for key in buffers.keys[:, 0]]
    seen += [tuple(key) for key in begun([5]).keys[:, 0]]
    assert len(set(seen)) == 4 * len(SOURCES)


def test_an_episode_depends_on_its_number_and_not_on_what_was_drawn():
    first, second = np.random.default_rng(4), np.random.default_rng(4)
    second.standard_normal(1000)  # draws of the generator itself move no key
    a, b = SensorBuffers(1, N), SensorBuffers(1, N)
    for _ in range(2):
        for buffers, generator in ((a, first), (b, second)):
            buffers.draw_keys(np.arange(1), [generator])
            buffers.start_episodes(np.arange(1), IMU_GRADES["aviation"], ERRORS["white"], BIAS_SD)
    np.testing.assert_array_equal(a.keys, b.keys)
    np.testing.assert_array_equal(a.fields["satellite_bias"], b.fields["satellite_bias"])


def test_only_the_receivers_that_begin_are_touched():
    buffers = begun([1, 2, 3])
    buffers.fields["clock"] = 5.0
    buffers.range_offset[:] = 3.0
    before = copy.deepcopy(buffers)
    generators = [np.random.default_rng(7)]
    buffers.draw_keys(np.array([1]), generators)
    buffers.start_episodes(np.array([1]), IMU_GRADES["tactical"], ERRORS["groves"], BIAS_SD)
    for b in (0, 2):
        theirs = arrays_of(before)
        for name, array in arrays_of(buffers).items():
            np.testing.assert_array_equal(array[b], theirs[name][b], err_msg=name)
        np.testing.assert_array_equal(buffers.keys[:, b], before.keys[:, b])
    assert (buffers.keys[:, 1] != before.keys[:, 1]).any()


def test_biases_have_the_standard_deviations_given():
    biases = begun(range(400)).fields["satellite_bias"] / BIAS_SD
    assert abs(biases.mean()) < 4.0 / np.sqrt(biases.size)
    assert biases.std() == pytest.approx(1.0, abs=4.0 / np.sqrt(2 * biases.size))
    assert np.abs(np.corrcoef(biases.T) - np.eye(N)).max() < 0.2


@pytest.mark.parametrize("seeds", [[1], [1, 2], range(9)])
@pytest.mark.parametrize("way", [copy.deepcopy, lambda b: pickle.loads(pickle.dumps(b))])
def test_a_copy_has_arrays_of_its_own(way, seeds):
    buffers = begun(seeds)
    copied, keys = way(buffers), buffers.keys.copy()
    before = {name: array.copy() for name, array in arrays_of(buffers).items()}
    for name, array in arrays_of(copied).items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)
    np.testing.assert_array_equal(copied.keys, keys)
    copied.fields.data[:] = copied.constants.data[:] = -1.0
    copied.words.data[:] = 1
    copied.epoch[:] = copied.authentic[:] = copied.range_offset[:] = copied.rate_offset[:] = -1
    for name, array in arrays_of(buffers).items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)
    np.testing.assert_array_equal(buffers.keys, keys)


@pytest.mark.parametrize(("here", "there"), [(1, 9), (9, 1), (17, 9)])
def test_receivers_are_taken_over_from_a_batch_of_any_width(here, there):
    mine, other = begun(range(here)), begun(range(100, 100 + there), grade="consumer")
    other.range_offset[:], other.epoch[:], other.authentic[:] = 3.0, 7, 0.5
    before = copy.deepcopy(mine)
    mine.copy_rows(np.array([here - 1]), other, np.array([there - 1]))
    theirs, old = arrays_of(other), arrays_of(before)
    for name, array in arrays_of(mine).items():
        np.testing.assert_array_equal(array[-1], theirs[name][-1], err_msg=name)
        np.testing.assert_array_equal(array[:-1], old[name][:-1], err_msg=name)
    np.testing.assert_array_equal(mine.keys[:, -1], other.keys[:, -1])
    np.testing.assert_array_equal(mine.keys[:, :-1], before.keys[:, :-1])
