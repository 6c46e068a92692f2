"""The loosely coupled receiver: its error model, its update, and noise that tunes itself."""

from functools import cache

import numpy as np
import pytest

from spoofgym.core.memory import Memory
from spoofgym.earth.wgs84 import ecef_to_geodetic, radii_of_curvature
from spoofgym.receiver import SelfTuning
from spoofgym.receiver._loose_kernels import invert, joseph, propagate_loose
from spoofgym.receiver.adaptive import CLAMPED, RAW, SKIP, process_factor, windowed_covariance
from spoofgym.receiver.loose import LooselyCoupled, LooseReceivers
from spoofgym.receiver.loose_states import STATES, fill_local_axes
from spoofgym.truth.run import flown_world

from ..lazily import Lazily

WORLD = Lazily(flown_world, "shadmehri2025", 0.1)
ARCSEC = np.pi / 180.0 / 3600.0
BIASES = np.repeat([0.01 * ARCSEC, 100e-6 * 9.80665], 3)
SD = np.array([2.0, 1.0, 3.0])


def begun(error, **tuning):
    settings = LooselyCoupled(self_tuning=tuning or None)
    batch = LooseReceivers(settings, Memory(len(error)), WORLD.samples, WORLD.imu_interval_s)
    first = np.zeros(len(error), dtype=np.int64)
    truth = WORLD.position_e[first], WORLD.velocity_e[first], WORLD.C_eb[first]
    batch.start_episodes(*truth, np.asarray(error, dtype=float))
    return batch


def predict(batch, epoch, bias=0.0, error=0.0):
    """Up to an epoch by perfect samples, but for constant biases, and a position that is off."""
    n = WORLD.samples
    batch.samples[:] = WORLD.run[(epoch - 1) * n : epoch * n] + bias
    batch.fix_e[:] = WORLD.position_e[epoch] + error
    batch.predict()


def local(position_e):
    latitude, longitude, height = map(float, ecef_to_geodetic(position_e))
    C_el = np.empty((3, 3))
    fill_local_axes(latitude, longitude, C_el)
    return C_el, latitude, longitude, height


def error_states(state, epoch):
    """Errors of one receiver by their definitions, not by the filter's formulas."""
    true_e = WORLD.position_e[epoch]
    C_el, latitude, longitude, height = local(true_e)
    D_el, latitude_hat, longitude_hat, height_hat = local(state.position_e[0])
    meridian, transverse = radii_of_curvature(latitude)
    position = [
        (transverse + height) * np.cos(latitude) * (longitude_hat - longitude),
        (meridian + height) * (latitude_hat - latitude),
        height_hat - height,
    ]
    velocity = D_el.T @ state.velocity_e[0] - C_el.T @ WORLD.velocity_e[epoch]
    turned = (D_el.T @ state.C_eb[0]) @ (C_el.T @ WORLD.C_eb[epoch]).T  # I - [phi x]
    skew = 0.5 * (turned.T - turned)
    return np.concatenate([[skew[2, 1], skew[0, 2], skew[1, 0]], velocity, position])


@pytest.mark.parametrize(
    ("arcsec", "velocity", "position", "biased"),
    [
        ([20.0, 20.0, 180.0], 0.0, 0.0, 0.0),
        (0.0, [0.1, -0.1, 0.1], 0.0, 0.0),
        (0.0, 0.0, [4.0, -4.0, 6.0], 0.0),
        (0.0, 0.0, 0.0, 1.0),
        ([20.0, -20.0, 180.0], [-0.1, 0.1, 0.1], [-4.0, 4.0, 6.0], 1.0),
    ],
)
def test_errors_grow_as_the_transition_says(arcsec, velocity, position, biased):
    parts = [np.multiply(arcsec, ARCSEC), velocity, position, biased * BIASES[:3]]
    x = np.concatenate([np.broadcast_to(part, 3) for part in [*parts, biased * BIASES[3:]]])
    bias, batch = np.concatenate([x[12:], x[9:12]]), begun(x[None])
    apart, size = [], []
    for k in range(1, 301):
        predict(batch, k, bias)
        x = batch._transition[0] @ x
        apart.append(error_states(batch.state, k) - x[:9])
        size.append(x[:9])
    rms, size = np.sqrt(np.mean(np.square(apart), axis=0)), np.abs(size).max(axis=0)
    assert rms[6:].max() < 0.6e-3  # m
    assert (rms < 2e-3 * size.reshape(3, 3).max(axis=1).repeat(3) + 1e-10).all()


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
    batch = begun(np.zeros((1, STATES)))
    predict(batch, 1, error=50.0)
    before = [np.array(a) for a in batch.state]
    batch.update(np.zeros((1, 3)))
    for name, mine, theirs in zip(batch.state._fields, batch.state, before, strict=True):
        if name != "seen":
            np.testing.assert_allclose(mine, theirs, rtol=1e-15, err_msg=name)


def test_what_is_refused():
    assert LooselyCoupled(self_tuning={"window": 50}).tuning == SelfTuning(window=50)
    with pytest.raises(ValueError, match="`window` must be a whole number from 2 to 100000, got 1"):
        LooselyCoupled(self_tuning={"window": 1})
    with pytest.raises(TypeError, match=r"`self_tuning` must be a dict of settings .* got 'r'"):
        LooselyCoupled(self_tuning="r")
    with pytest.raises(ValueError, match=r"must be a multiple of .* 0\.00625 s, got 0\.1001"):
        flown_world("shadmehri2025", 0.1001)


@pytest.mark.nojit
@pytest.mark.parametrize(
    ("rule", "ratio", "factor"),
    [
        (RAW, 4.0, 2.0),
        (RAW, -1.0, 0.0),
        (SKIP, -1.0, 1.0),
        (SKIP, 0.25, 0.5),
        (CLAMPED, 100.0, 2.0),
        (CLAMPED, -1.0, 0.5),
    ],
)
def test_what_the_rules_make_of_a_ratio_and_a_window_of_residuals(rule, ratio, factor):
    assert process_factor(rule, ratio) == factor
    window, out = np.random.default_rng(0).standard_normal((20, 3)), np.empty((3, 3))
    windowed_covariance(window, out)
    np.testing.assert_allclose(out, window.T @ window / 20, rtol=1e-12)


@cache
def flown(receivers, epochs, weight=1.0, **tuning):
    """White errors of SD on every fix, and perfect inertial samples; what every epoch had of S and
    P, and after it of R and P."""
    rng, log = np.random.default_rng(0), []
    batch = begun(np.zeros((receivers, STATES)), **tuning)
    for k in range(1, epochs + 1):
        error = SD * rng.standard_normal((receivers, 3))
        predict(batch, k, error=error @ WORLD.C_el[k].T)
        state = batch.state
        row = [np.array(state.innovation_cov), np.array(state.covariance[:, 6:9, 6:9])]
        batch.update(np.full((receivers, 3), weight))
        log.append([*row, np.array(state.measurement_cov), np.array(state.covariance[:, 6:9, 6:9])])
    return batch, log


@pytest.mark.parametrize("weight", [1.0, 0.0])
def test_the_noise_is_residuals_and_what_the_estimate_adds(weight):
    batch, log = flown(3, 60, weight, window=20)
    residuals = batch.state.residuals
    want = np.einsum("bwi,bwj->bij", residuals, residuals) / 20 + log[-1][3]
    np.testing.assert_allclose(batch.state.measurement_cov, want, rtol=1e-12)
    # it stays until the window is full and holds from the next epoch on
    stated = np.diag(batch.settings.noise_variance())
    for k, (S, P, R, _) in enumerate(log, start=1):
        before = stated if k <= 20 else log[k - 2][2]
        np.testing.assert_allclose(S, P + before, rtol=1e-12)
        assert np.allclose(R, stated) == (k < 20)
    if weight == 0.0:  # rejected fixes raise the noise so that they are believed again
        S, _, _, P = (np.trace(each, axis1=1, axis2=2) for each in log[-1])
        assert (S > P).all()


def test_white_noise_is_found_a_floor_holds_and_the_paper_s_process_noise_has_no_rest():
    R = flown(40, 200, window=100)[0].state.measurement_cov
    variance = np.diagonal(R, axis1=1, axis2=2)
    np.testing.assert_allclose(variance.mean(axis=0), SD**2, rtol=0.1)
    assert np.linalg.eigvalsh(R).min() > 0.0
    R = flown(4, 60, window=20, floor_m=5.0)[0].state.measurement_cov
    np.testing.assert_allclose(np.diagonal(R, axis1=1, axis2=2), 25.0)
    assert (flown(10, 300, window=30)[0].state.process_scale == 1.0).all()
    for process in ("raw", "clamped"):
        state = flown(10, 300, window=30, process=process)[0].state
        assert np.median(state.process_scale) > 100.0
        assert np.isfinite(state.covariance).all()
