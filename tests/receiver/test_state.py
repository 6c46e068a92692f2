"""The arrays of a batch: views of one buffer, and what a detector may see of them."""

import copy
import pickle

import numpy as np
import pytest

from spoofgym.receiver.epoch import (
    ALWAYS_SEEN,
    OPTIONAL,
    SEEN,
    Epoch,
    ReceiverBuffers,
    TracedEpoch,
    epoch_view,
)

OF_OTHER_RECEIVERS = ("gnss_position", "auxiliary_position", "cn0_dbhz")


@pytest.mark.nojit
@pytest.mark.parametrize("wanted", [SEEN, (), ("design", "innovation_cov")])
@pytest.mark.parametrize(("receivers", "channels"), [(1, 4), (3, 12), (8, 5), (17, 7)])
def test_what_is_seen_fills_its_buffer_without_overlap(receivers, channels, wanted):
    buffers = ReceiverBuffers(receivers, channels, wanted)
    assert list(buffers.seen) == [name for name in SEEN if name in {*ALWAYS_SEEN, *wanted}]
    floats = buffers.seen_floats
    floats[:] = np.arange(float(len(floats)))
    views = [buffers.time, buffers.interval, buffers.position_e, buffers.velocity_e]
    views += buffers.seen.values()
    np.testing.assert_array_equal(np.concatenate([a.ravel() for a in views]), floats)
    for array in views:
        assert array.shape[0] == receivers
        assert array.flags.c_contiguous
    for name, place in zip(SEEN, buffers.places, strict=True):
        assert (place >= 0) == (name in buffers.seen)
        if place >= 0:
            assert buffers.seen[name].flat[0] == floats[place]


def test_shapes():
    buffers = ReceiverBuffers(3, 7, SEEN)
    assert buffers.assumed["noise_variance"].shape == (3, 14)
    assert buffers.assumed["noise_psd"].shape == (3, 17)
    assert buffers.fields["innovation"].shape == (3, 14)
    assert buffers.visible.shape == (3, 7)
    shapes = {name: array.shape[1:] for name, array in buffers.seen.items()}
    assert shapes == {
        "innovation": (14,),
        "innovation_variance": (14,),
        "innovation_cov": (14, 14),
        "predicted_cov": (17, 17),
        "design": (14, 17),
        "transition": (17, 17),
        "imu_delta": (6,),
        "pseudorange": (7,),
        "range_rate": (7,),
        "satellite_position": (7, 3),
        "satellite_velocity": (7, 3),
    }
    assert buffers.covariance.shape == (3, 17, 17)


@pytest.mark.parametrize("receivers", [1, 3, 9])
def test_a_covariance_is_kept_as_its_upper_triangle(receivers):
    buffers, rng = ReceiverBuffers(receivers, 4), np.random.default_rng(0)
    root = rng.standard_normal((receivers, 17, 17))
    given = root @ root.transpose(0, 2, 1)
    buffers.put_covariance(np.arange(receivers), given)
    np.testing.assert_array_equal(buffers.covariance, given)
    buffers.put_covariance(np.array([receivers - 1]), np.diag(np.arange(17.0)))
    given[receivers - 1] = np.diag(np.arange(17.0))
    np.testing.assert_array_equal(buffers.covariance, given)
    assert not np.shares_memory(buffers.covariance, buffers.fields.data)


@pytest.mark.parametrize("receivers", [1, 2, 9])
@pytest.mark.parametrize("way", [copy.deepcopy, lambda b: pickle.loads(pickle.dumps(b))])
def test_a_copy_has_arrays_of_its_own(way, receivers):
    buffers = ReceiverBuffers(receivers, 4, SEEN)
    buffers.fields["clock"] = 3.0
    buffers.seen["design"][:] = 3.0
    buffers.time[:], buffers.visible[:] = 3.0, True
    copied = way(buffers)
    views = ("time", "interval", "position_e", "velocity_e", *SEEN)
    for name in views:
        array = copied.seen[name] if name in SEEN else getattr(copied, name)
        assert np.shares_memory(array, copied.seen_floats), name
    np.testing.assert_array_equal(copied.fields["clock"], 3.0)
    np.testing.assert_array_equal(copied.seen["design"], 3.0)
    copied.fields["clock"] = -1.0
    copied.seen_floats[:] = -1.0
    copied.visible[:] = False
    np.testing.assert_array_equal(copied.time, -1.0)
    np.testing.assert_array_equal(buffers.fields["clock"], 3.0)
    np.testing.assert_array_equal(buffers.seen["design"], 3.0)
    np.testing.assert_array_equal(buffers.time, 3.0)
    assert buffers.visible.all()


@pytest.mark.parametrize("alike", [False, True])
@pytest.mark.parametrize("wanted", [(), SEEN])
@pytest.mark.parametrize(("here", "there"), [(1, 9), (9, 1), (9, 17), (8, 8)])
def test_receivers_are_taken_over_from_a_batch_of_any_width(here, there, wanted, alike):
    mine = ReceiverBuffers(here, 4, wanted, alike=alike)
    other, rng = ReceiverBuffers(there, 4, SEEN, alike=alike), np.random.default_rng(3)
    other.assumed["noise_psd"] = rng.standard_normal(17)
    other.fields.data[:] = rng.standard_normal(other.fields.data.shape)
    other.seen_floats[:] = rng.standard_normal(len(other.seen_floats))
    other.visible[:], other.coasting[:] = rng.random((there, 4)) < 0.5, rng.random(there) < 0.5
    before = copy.deepcopy(mine)
    to, rows = np.array([here - 1]), np.array([there - 1])
    mine.copy_rows(to, other, rows)
    for name in ("time", "interval", "position_e", "velocity_e", "visible", "coasting"):
        np.testing.assert_array_equal(getattr(mine, name)[to], getattr(other, name)[rows])
        np.testing.assert_array_equal(getattr(mine, name)[:-1], getattr(before, name)[:-1])
    for name, array in mine.seen.items():
        np.testing.assert_array_equal(array[to], other.seen[name][rows])
        np.testing.assert_array_equal(array[:-1], before.seen[name][:-1])
    for name in mine.assumed.shapes:
        taken = other.assumed.get(name, rows)
        np.testing.assert_array_equal(mine.assumed[name][to], taken)
        rest = np.tile(taken, (here - 1, 1)) if alike else before.assumed[name][:-1]
        np.testing.assert_array_equal(mine.assumed[name][:-1], rest)
    for name in mine.fields.shapes:
        np.testing.assert_array_equal(mine.fields[name][to], other.fields.get(name, rows))
        np.testing.assert_array_equal(mine.fields[name][:-1], before.fields[name][:-1])


def test_an_epoch_is_read_only_and_follows_the_buffers():
    buffers = ReceiverBuffers(2, 4, SEEN)
    epoch = epoch_view(buffers)
    for name, array in epoch._asdict().items():
        if name in OF_OTHER_RECEIVERS:
            assert array is None
            continue
        assert array.flags.c_contiguous
        assert array.shape[0] == 2
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    buffers.seen["innovation"][1, 3] = 7.0
    buffers.seen["predicted_cov"][0, 2, 2] = 5.0
    buffers.position_e[1] = 3.0
    assert epoch.innovation[1, 3] == 7.0
    assert epoch.predicted_cov[0, 2, 2] == 5.0
    np.testing.assert_array_equal(epoch.predicted_position[1], 3.0)


def test_an_epoch_has_no_field_of_truth():
    assert not [name for name in Epoch._fields if "true" in name or "attack" in name]


def test_the_fields_that_are_always_there():
    always = ("time", "interval", "innovation", "innovation_variance", "visible")
    assert Epoch._fields[: -len(OPTIONAL)] == (*always, "predicted_position", "predicted_velocity")
    epoch = epoch_view(ReceiverBuffers(2, 4, SEEN))
    assert [name for name in Epoch._fields if getattr(epoch, name) is None] == [*OF_OTHER_RECEIVERS]
    some = epoch_view(ReceiverBuffers(2, 4, {"design", "cn0_dbhz"}))
    assert [name for name in OPTIONAL if getattr(some, name) is not None] == ["design"]
    assert all(getattr(some, name) is not None for name in always)


def test_a_traced_epoch_notes_what_is_read():
    traced = TracedEpoch(*epoch_view(ReceiverBuffers(2, 4, SEEN)))
    assert traced.innovation.shape == (2, 8)
    assert traced.read_fields == set()
    changed = traced._replace(innovation=traced.innovation + 1.0)
    assert changed.design is not None
    assert traced.cn0_dbhz is None
    assert traced.read_fields == changed.read_fields == {"design", "cn0_dbhz"}
