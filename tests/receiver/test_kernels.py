"""The two compiled calls of an epoch, over batches of receivers."""

import numpy as np
import pytest

from spoofgym.earth.attitude import skew
from spoofgym.receiver.kalman import COVARIANCE_UPDATES
from spoofgym.receiver.state import ReceiverBuffers

from .batches import update
from .test_kalman import SD, covariance, measured, sky, textbook

N = 6


def batch(receivers, visible=None):
    """Buffers as they are after a prediction, each receiver with a sky of its own."""
    buffers = ReceiverBuffers(receivers, N, 1)
    for b in range(receivers):
        fill(buffers, b, b)
    if visible is not None:
        buffers.measured.visible[:] = visible
    return buffers


def fill(buffers, row, number):
    rng = np.random.default_rng(number)
    state, m = buffers.state, buffers.measured
    state.position_e[row] = rng.normal([6.4e6, 0.0, 0.0], 100.0)
    state.velocity_e[row] = rng.normal(0.0, 100.0, 3)
    state.C_eb[row] = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    state.accel_bias_b[row] = rng.normal(0.0, 1e-3, 3)
    state.gyro_bias_b[row] = rng.normal(0.0, 1e-6, 3)
    state.clock[row] = rng.normal(0.0, 100.0, 2)
    state.covariance[row] = covariance(rng)
    m.line_of_sight[row] = sky(rng, N)
    m.innovation[row], m.noise_variance[row] = measured(rng, N)
    m.visible[row] = True


@pytest.mark.parametrize("covariance_update", COVARIANCE_UPDATES)
def test_corrections_are_fed_back(covariance_update):
    buffers, before = batch(3), batch(3)
    weights = np.random.default_rng(9).uniform(0.0, 1.0, (3, 2 * N))
    update(buffers, weights, update=covariance_update)
    for b in range(3):
        m, old, new = before.measured, before.state, buffers.state
        x, P = textbook(
            old.covariance[b],
            m.line_of_sight[b],
            m.innovation[b],
            m.noise_variance[b],
            weights[b],
            m.visible[b],
            covariance_update,
        )
        close = {"rtol": 0, "atol": 1e-9}
        np.testing.assert_allclose(new.C_eb[b], (np.eye(3) - skew(x[:3])) @ old.C_eb[b], **close)
        np.testing.assert_allclose(new.velocity_e[b], old.velocity_e[b] - x[3:6], **close)
        np.testing.assert_allclose(new.position_e[b], old.position_e[b] - x[6:9], rtol=0, atol=1e-8)
        np.testing.assert_allclose(new.accel_bias_b[b], old.accel_bias_b[b] + x[9:12], **close)
        np.testing.assert_allclose(new.gyro_bias_b[b], old.gyro_bias_b[b] + x[12:15], rtol=1e-9)
        np.testing.assert_allclose(new.clock[b], old.clock[b] + x[15:], **close)
        np.testing.assert_allclose(
            new.covariance[b] / np.outer(SD, SD), P / np.outer(SD, SD), rtol=0, atol=1e-9
        )
    assert not buffers.measured.coasting.any()


@pytest.mark.parametrize("covariance_update", COVARIANCE_UPDATES)
@pytest.mark.parametrize("receivers", [2, 9])
def test_a_receiver_is_updated_alike_in_any_batch(receivers, covariance_update):
    buffers = batch(receivers)
    weights = np.random.default_rng(3).uniform(0.0, 1.0, (receivers, 2 * N))
    update(buffers, weights, update=covariance_update, orthonormal=True)
    for b in range(receivers):
        alone = ReceiverBuffers(1, N, 1)
        fill(alone, 0, b)
        alone_weights = weights[b : b + 1].copy()
        update(alone, alone_weights, update=covariance_update, orthonormal=True)
        for together, single in zip(buffers.state, alone.state, strict=True):
            assert together[b].tobytes() == single[0].tobytes()


@pytest.mark.parametrize("min_satellites", [0, 4, 6])
def test_with_fewer_satellites_than_it_wants_a_receiver_coasts(min_satellites):
    seen = np.arange(N)[None, :] < np.arange(N + 1)[:, None]  # receiver b sees b satellites
    buffers, before = batch(N + 1, seen), batch(N + 1, seen)
    update(buffers, least=min_satellites)
    coasting = np.arange(N + 1) < min_satellites
    np.testing.assert_array_equal(buffers.measured.coasting, coasting)
    for b in range(N + 1):
        same = all(
            new[b].tobytes() == old[b].tobytes()
            for new, old in zip(buffers.state, before.state, strict=True)
        )
        assert same == (coasting[b] or b == 0)


def test_the_attitude_is_made_orthonormal_only_when_asked():
    plain, orthonormal = batch(2), batch(2)
    for buffers, wanted in ((plain, False), (orthonormal, True)):
        buffers.state.C_eb[:] *= 1.0 + 1e-7
        update(buffers, orthonormal=wanted)

    def off(buffers):
        C = buffers.state.C_eb
        return np.abs(C @ C.transpose(0, 2, 1) - np.eye(3)).max()

    assert off(plain) > 1e-7
    assert off(orthonormal) < 1e-12


def test_only_the_receivers_of_a_slice_are_updated():
    buffers, before = batch(5), batch(5)
    update(buffers, lo=0, hi=3)
    for b in range(5):
        same = buffers.state.position_e[b].tobytes() == before.state.position_e[b].tobytes()
        assert same == (b >= 3)
