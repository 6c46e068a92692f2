"""The arrays of a batch: views of one buffer, and what a detector may see of them."""

import copy

import numpy as np
import pytest

from spoofgym.receiver.epoch import OPTIONAL, SEEN, Epoch, ReceiverBuffers, TracedEpoch, epoch_view

OF_OTHER_RECEIVERS = ("gnss_position", "auxiliary_position", "cn0_dbhz")


@pytest.mark.parametrize("receivers", [1, 9])
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


@pytest.mark.parametrize(("alike", "wanted"), [(False, SEEN), (True, ())])
@pytest.mark.parametrize(("here", "there"), [(1, 9), (9, 1), (8, 17)])
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


def test_an_epoch_is_read_only_follows_the_buffers_and_tells_what_of_it_is_read():
    assert not [name for name in Epoch._fields if "true" in name or "attack" in name]
    buffers = ReceiverBuffers(2, 4, SEEN)
    epoch = epoch_view(buffers)
    assert [name for name in Epoch._fields if getattr(epoch, name) is None] == [*OF_OTHER_RECEIVERS]
    for array in (each for each in epoch if each is not None):
        assert array.flags.c_contiguous
        assert array.shape[0] == 2
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    buffers.seen["innovation"][1, 3] = buffers.seen["predicted_cov"][0, 2, 2] = 7.0
    buffers.position_e[1] = 3.0
    assert epoch.innovation[1, 3] == epoch.predicted_cov[0, 2, 2] == 7.0
    np.testing.assert_array_equal(epoch.predicted_position[1], 3.0)
    always = ("time", "interval", "innovation", "innovation_variance", "visible")
    assert Epoch._fields[: -len(OPTIONAL)] == (*always, "predicted_position", "predicted_velocity")
    some = epoch_view(ReceiverBuffers(2, 4, {"design", "cn0_dbhz"}))
    assert [name for name in OPTIONAL if getattr(some, name) is not None] == ["design"]
    assert all(getattr(some, name) is not None for name in always)
    traced = TracedEpoch(*epoch_view(ReceiverBuffers(2, 4, SEEN)))
    assert (traced.innovation.shape, traced.read_fields) == ((2, 8), set())
    changed = traced._replace(innovation=traced.innovation + 1.0)
    assert changed.design is not None
    assert traced.cn0_dbhz is None
    assert traced.read_fields == changed.read_fields == {"design", "cn0_dbhz"}
