"""The loosely coupled receiver: its error model, its update, its covariance."""

import numpy as np
import pytest

from spoofgym.core.memory import Memory
from spoofgym.earth.wgs84 import ecef_to_geodetic, radii_of_curvature
from spoofgym.receiver import SelfTuning
from spoofgym.receiver._loose_kernels import invert, joseph, propagate_loose
from spoofgym.receiver.loose import LooselyCoupled, LooseReceivers
from spoofgym.receiver.loose_states import STATES, fill_local_axes, geodetic_point
from spoofgym.truth.flight import flight_from_velocity, inverse_kinematics
from spoofgym.truth.run import flown_world, loose_world

WORLD = flown_world("shadmehri2025", 0.1)
ARCSEC = np.pi / 180.0 / 3600.0
BIASES = np.concatenate([np.full(3, 0.01 * ARCSEC), np.full(3, 100e-6 * 9.80665)])


def receivers(count, settings=None, world=WORLD):
    return LooseReceivers(
        LooselyCoupled() if settings is None else settings,
        Memory(count),
        world.samples,
        world.imu_interval_s,
    )


def feed(batch, world, epoch, bias=0.0):
    """Perfect samples, but for constant biases, and the true position."""
    n = world.samples
    batch.samples[:] = world.run[(epoch - 1) * n : epoch * n]
    batch.samples[:, :, :3] += bias if np.ndim(bias) == 0 else bias[None, None, 3:]
    batch.samples[:, :, 3:] += bias if np.ndim(bias) == 0 else bias[None, None, :3]
    batch.fix_e[:] = world.position_e[epoch]


def local(position_e):
    latitude, longitude, height = ecef_to_geodetic(position_e)
    C_el = np.empty((3, 3))
    fill_local_axes(float(latitude), float(longitude), C_el)
    return C_el, float(latitude), float(longitude), float(height)


def error_states(state, world, epoch):
    """Errors of one receiver by their definitions, not by the filter's formulas."""
    true_e = world.position_e[epoch]
    C_el, latitude, longitude, height = local(true_e)
    D_el, latitude_hat, longitude_hat, height_hat = local(state.position_e[0])
    meridian, transverse = radii_of_curvature(latitude)
    position = [
        (transverse + height) * np.cos(latitude) * (longitude_hat - longitude),
        (meridian + height) * (latitude_hat - latitude),
        height_hat - height,
    ]
    velocity = D_el.T @ state.velocity_e[0] - C_el.T @ world.velocity_e[epoch]
    turned = (D_el.T @ state.C_eb[0]) @ (C_el.T @ world.C_eb[epoch]).T  # I - [phi x]
    skew = 0.5 * (turned.T - turned)
    return np.concatenate([[skew[2, 1], skew[0, 2], skew[1, 0]], velocity, position])


CASES = {
    "attitude": (np.repeat([20 * ARCSEC, 180 * ARCSEC], [2, 1]), 0.0, 0.0, 0.0),
    "velocity": (0.0, np.array([0.1, -0.1, 0.1]), 0.0, 0.0),
    "position": (0.0, 0.0, np.array([4.0, -4.0, 6.0]), 0.0),
    "biases": (0.0, 0.0, 0.0, 1.0),
    "all": (
        np.array([20.0, -20.0, 180.0]) * ARCSEC,
        np.array([-0.1, 0.1, 0.1]),
        np.array([-4.0, 4.0, 6.0]),
        1.0,
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_errors_grow_as_the_transition_says(case):
    """Linear propagation explains the drift of a noise-free INS over 30 s."""
    first = np.zeros(STATES)
    for i, part in enumerate(CASES[case][:3]):
        first[3 * i : 3 * i + 3] = part
    bias = CASES[case][3] * BIASES
    first[9:] = bias
    batch = receivers(1)
    batch.start_episodes(WORLD.position_e[:1], WORLD.velocity_e[:1], WORLD.C_eb[:1], first[None])
    x, apart, size = first.copy(), [], []
    for k in range(1, 301):
        feed(batch, WORLD, k, bias)
        batch.predict()
        x = batch._transition[0] @ x
        apart.append(error_states(batch.state, WORLD, k) - x[:9])
        size.append(x[:9])
    apart, size = np.array(apart), np.abs(size).max(axis=0)
    rms = np.sqrt((apart**2).mean(axis=0))
    assert rms[6:].max() < 0.6e-3  # m
    assert (rms < 2e-3 * size.reshape(3, 3).max(axis=1).repeat(3) + 1e-10).all()


def at_rest(seconds):
    n = round(seconds * 160.0)
    zero = np.zeros(n + 1)
    flight = flight_from_velocity(
        "rest", 0.6, 0.9, 1000.0, np.zeros((n + 1, 3)), zero, zero, zero, 1.0 / 160.0
    )
    return loose_world(inverse_kinematics(flight), 0.1)


@pytest.mark.parametrize("corrected", [False, True])
def test_what_stands_still_stays_still(corrected):
    world = at_rest(60.0)
    batch = receivers(1, world=world)
    batch.start_episodes(
        world.position_e[:1], world.velocity_e[:1], world.C_eb[:1], np.zeros((1, STATES))
    )
    for k in range(1, world.epochs):
        feed(batch, world, k)
        batch.predict()
        if corrected:
            batch.update(None)
    assert np.linalg.norm(batch.state.position_e[0] - world.position_e[0]) < 1e-6
    assert np.linalg.norm(batch.state.velocity_e[0]) < 1e-7


def test_perfect_measurements_take_the_initial_errors_away():
    batch = receivers(2)
    sd = batch.settings.initial_sd() / 3.0
    first = [0, 0]
    batch.start_episodes(
        WORLD.position_e[first], WORLD.velocity_e[first], WORLD.C_eb[first], np.array([sd, -sd])
    )
    for k in range(1, 301):
        feed(batch, WORLD, k)
        batch.predict()
        batch.update(None)
    for b in range(2):
        apart = batch.state.position_e[b] - WORLD.position_e[300]
        assert np.linalg.norm(apart) < 0.2 * np.linalg.norm(sd[6:9])
        product = batch.state.C_eb[b] @ batch.state.C_eb[b].T
        np.testing.assert_allclose(product, np.eye(3), atol=1e-8)
    diagonal = np.diagonal(batch.state.covariance, axis1=1, axis2=2)
    assert (diagonal[:, :9] < batch.settings.initial_sd()[:9] ** 2).all()
    np.testing.assert_array_equal(batch.state.covariance, batch.state.covariance.transpose(0, 2, 1))


def random_covariance(rng, size):
    root = rng.standard_normal((size, size))
    return root @ root.T + 0.1 * np.eye(size)


@pytest.mark.nojit
def test_covariance_kernels_are_their_matrix_equations():
    rng = np.random.default_rng(0)
    P, R, weights = random_covariance(rng, 15), random_covariance(rng, 3), np.diag([1.0, 0.3, 0.0])
    Phi = np.eye(15)
    Phi[:9] += 0.1 * rng.standard_normal((9, 15))
    psd, tau = rng.uniform(size=15), 0.1
    half = np.diag(0.5 * tau * psd)
    work, predicted = np.empty((15, 15)), P.copy()
    propagate_loose(predicted, Phi, psd, tau, work)
    np.testing.assert_allclose(predicted, Phi @ (P + half) @ Phi.T + half, rtol=1e-12, atol=1e-12)
    inverse, H = np.empty((3, 3)), np.zeros((3, 15))
    H[:, 6:9] = -np.eye(3)
    S = H @ P @ H.T + R
    invert(S, inverse)
    np.testing.assert_allclose(inverse, np.linalg.inv(S), rtol=1e-10)
    K = P @ H.T @ inverse @ weights
    updated = P.copy()
    joseph(updated, np.ascontiguousarray(-K), R, work, np.empty((15, 3)))
    A = np.eye(15) - K @ H
    np.testing.assert_allclose(updated, A @ P @ A.T + K @ R @ K.T, rtol=1e-11, atol=1e-11)


def test_a_rejected_fix_changes_nothing():
    batch = receivers(1)
    batch.start_episodes(
        WORLD.position_e[:1], WORLD.velocity_e[:1], WORLD.C_eb[:1], np.zeros((1, STATES))
    )
    feed(batch, WORLD, 1)
    batch.fix_e += 50.0
    batch.predict()
    before = [np.array(a) for a in batch.state]
    batch.update(np.zeros((1, 3)))
    for name, mine, theirs in zip(batch.state._fields, batch.state, before, strict=True):
        if name != "seen":
            np.testing.assert_allclose(mine, theirs, rtol=1e-15, err_msg=name)


@pytest.mark.nojit
def test_a_position_s_latitude_longitude_and_height():
    rng = np.random.default_rng(1)
    for _ in range(20):
        position = rng.standard_normal(3)
        position *= (6.37e6 + rng.uniform(0.0, 2e4)) / np.linalg.norm(position)
        want = [float(x) for x in ecef_to_geodetic(position)]
        got = geodetic_point(*position)
        np.testing.assert_allclose(got[:2], want[:2], atol=1e-11)
        assert got[2] == pytest.approx(want[2], abs=1e-4)


def test_self_tuning_is_a_record_or_its_settings():
    assert LooselyCoupled(self_tuning={"window": 50}).tuning == SelfTuning(window=50)
    with pytest.raises(ValueError, match="`window` must be a whole number from 2 to 100000, got 1"):
        LooselyCoupled(self_tuning={"window": 1})
    with pytest.raises(TypeError, match=r"`self_tuning` must be a dict of settings .* got 'r'"):
        LooselyCoupled(self_tuning="r")


def test_an_epoch_has_a_whole_number_of_samples():
    with pytest.raises(ValueError, match=r"must be a multiple of .* 0\.00625 s, got 0\.1001"):
        flown_world("shadmehri2025", 0.1001)
