"""The arrays of a batch: views of one buffer, and what a detector may see of them."""

import copy
import pickle

import numpy as np
import pytest

from spoofgym.receiver.epoch import OPTIONAL, Epoch, TracedEpoch, epoch_view
from spoofgym.receiver.state import LANES, ReceiverBuffers, buffer_size, unpack

OF_OTHER_RECEIVERS = ("gnss_position", "auxiliary_position", "cn0_dbhz")


@pytest.mark.nojit
@pytest.mark.parametrize(("receivers", "channels"), [(1, 4), (3, 12), (8, 5)])
def test_arrays_fill_the_buffer_without_overlap(receivers, channels):
    floats = np.arange(float(buffer_size(receivers, channels)))
    flags = np.zeros(receivers * (channels + 1), dtype=np.bool_)
    state, measured, noise_psd = unpack(floats, flags, receivers, channels)
    numbers = [*state, *(a for a in measured if a.dtype == np.float64), noise_psd]
    np.testing.assert_array_equal(np.sort(np.concatenate([a.ravel() for a in numbers])), floats)
    for array in (*state, *measured, noise_psd):
        assert array.shape[0] == receivers
        assert array.flags.c_contiguous
    measured.visible[:] = True
    assert flags.sum() == receivers * channels
    measured.coasting[:] = True
    assert flags.all()


def test_shapes():
    buffers = ReceiverBuffers(3, 7, 20)
    m = buffers.measured
    assert m.innovation.shape == m.innovation_variance.shape == m.noise_variance.shape == (3, 14)
    assert m.innovation_cov.shape == (3, 14, 14)
    assert m.design.shape == (3, 14, 17)
    assert buffers.state.covariance.shape == m.transition.shape == (3, 17, 17)
    assert buffers.samples.shape == (1, 20, 6 * LANES)
    np.testing.assert_array_equal(m.transition, np.tile(np.eye(17), (3, 1, 1)))


def test_samples_of_every_receiver_come_back():
    receivers = 2 * LANES + 3
    buffers = ReceiverBuffers(receivers, 4, 30)
    rng = np.random.default_rng(0)
    put = {}
    for b in range(receivers):
        put[b] = rng.standard_normal((int(rng.integers(1, 31)), 6))
        buffers.put_samples(b, put[b])
        buffers.block[1, b] = len(put[b])
    for b in range(receivers):
        np.testing.assert_array_equal(buffers.measured_samples(b), put[b])
    assert not np.shares_memory(buffers.measured_samples(0), buffers.samples)


@pytest.mark.parametrize("way", [copy.deepcopy, lambda b: pickle.loads(pickle.dumps(b))])
def test_a_copy_has_arrays_of_its_own(way):
    buffers = ReceiverBuffers(2, 4, 3)
    buffers.state.clock[:] = 3.0
    copied = way(buffers)
    np.testing.assert_array_equal(copied.state.clock, 3.0)
    copied.state.clock[:] = -1.0
    assert (copied.floats == -1.0).sum() == 4  # views of its own buffer
    np.testing.assert_array_equal(buffers.state.clock, 3.0)


def test_an_epoch_is_read_only_and_follows_the_buffers():
    buffers = ReceiverBuffers(2, 4, 3)
    epoch = epoch_view(buffers)
    for name, array in epoch._asdict().items():
        if name in OF_OTHER_RECEIVERS:
            assert array is None
            continue
        assert array.flags.c_contiguous
        assert array.shape[0] == 2
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    buffers.measured.innovation[1, 3] = 7.0
    buffers.state.covariance[0, 2, 2] = 5.0
    assert epoch.innovation[1, 3] == 7.0
    assert epoch.predicted_cov[0, 2, 2] == 5.0


def test_an_epoch_has_no_field_of_truth():
    assert not [name for name in Epoch._fields if "true" in name or "attack" in name]


def test_the_fields_that_are_always_there():
    always = ("time", "interval", "innovation", "innovation_variance", "visible")
    assert Epoch._fields[: -len(OPTIONAL)] == (*always, "predicted_position", "predicted_velocity")
    epoch = epoch_view(ReceiverBuffers(2, 4, 3))
    assert [name for name in Epoch._fields if getattr(epoch, name) is None] == [*OF_OTHER_RECEIVERS]
    some = epoch_view(ReceiverBuffers(2, 4, 3), {"design", "cn0_dbhz"})
    assert [name for name in OPTIONAL if getattr(some, name) is not None] == ["design"]
    assert all(getattr(some, name) is not None for name in always)


def test_a_traced_epoch_notes_what_is_read():
    traced = TracedEpoch(*epoch_view(ReceiverBuffers(2, 4, 3)))
    assert traced.innovation.shape == (2, 8)
    assert traced.read == set()
    changed = traced._replace(innovation=traced.innovation + 1.0)
    assert changed.design is not None
    assert traced.cn0_dbhz is None
    assert traced.read == changed.read == {"design", "cn0_dbhz"}
