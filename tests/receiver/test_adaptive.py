"""Self-tuning noise: what the window says, when it takes effect, and that Q has no rest."""

import numpy as np
import pytest

from spoofgym.core.memory import Memory
from spoofgym.receiver.adaptive import (
    CLAMPED,
    RAW,
    SKIP,
    process_factor,
    windowed_covariance,
)
from spoofgym.receiver.loose import LooselyCoupled, LooseReceivers
from spoofgym.truth.run import flown_world

WORLD = flown_world("shadmehri2025", 0.1)
SD = np.array([2.0, 1.0, 3.0])


@pytest.mark.nojit
def test_the_window_s_covariance_is_the_mean_of_outer_products():
    window, out = np.random.default_rng(0).standard_normal((20, 3)), np.empty((3, 3))
    windowed_covariance(window, out)
    np.testing.assert_allclose(out, window.T @ window / 20, rtol=1e-12)


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
def test_what_the_rules_make_of_a_ratio(rule, ratio, factor):
    assert process_factor(rule, ratio) == factor


def fly(receivers, epochs, seed=0, weights=None, **tuning):
    """White errors of SD on every fix, and perfect inertial samples."""
    rng = np.random.default_rng(seed)
    settings = LooselyCoupled(self_tuning=tuning)
    batch = LooseReceivers(settings, Memory(receivers), WORLD.samples, WORLD.imu_interval_s)
    first = np.zeros(receivers, dtype=np.int64)
    batch.start_episodes(
        WORLD.position_e[first],
        WORLD.velocity_e[first],
        WORLD.C_eb[first],
        np.zeros((receivers, 15)),
    )
    log = []
    for k in range(1, epochs + 1):
        n = WORLD.samples
        batch.samples[:] = WORLD.run[(k - 1) * n : k * n]
        error = SD * rng.standard_normal((receivers, 3))
        batch.fix_e[:] = WORLD.position_e[k] + error @ WORLD.C_el[k].T
        batch.predict()
        state = batch.state
        log.append([np.array(state.innovation_cov), np.array(state.covariance[:, 6:9, 6:9])])
        batch.update(weights)
        log[-1] += [np.array(state.measurement_cov), np.array(state.covariance[:, 6:9, 6:9])]
    return batch, log


def test_the_noise_stays_until_the_window_is_full_and_holds_from_the_next_epoch_on():
    batch, log = fly(2, 25, window=20)
    stated = np.diag(batch.settings.noise_variance())
    for k, (S, P, R, _) in enumerate(log, start=1):
        before = stated if k <= 20 else log[k - 2][2]
        np.testing.assert_allclose(S, P + before, rtol=1e-12)
        assert np.allclose(R, stated) == (k < 20)


def test_the_noise_is_residuals_and_what_the_estimate_adds():
    batch, log = fly(3, 40, window=15)
    residuals = batch.state.residuals
    want = np.einsum("bwi,bwj->bij", residuals, residuals) / 15 + log[-1][3]
    np.testing.assert_allclose(batch.state.measurement_cov, want, rtol=1e-12)


def test_white_noise_is_found():
    batch, _ = fly(40, 200, window=100)
    R = batch.state.measurement_cov
    variance = np.diagonal(R, axis1=1, axis2=2)
    np.testing.assert_allclose(variance.mean(axis=0), SD**2, rtol=0.1)
    assert np.linalg.eigvalsh(R).min() > 0.0


def test_a_floor_holds():
    batch, _ = fly(4, 60, window=20, floor_m=5.0)
    np.testing.assert_allclose(np.diagonal(batch.state.measurement_cov, axis1=1, axis2=2), 25.0)


def test_rejected_fixes_raise_the_noise_so_that_they_are_believed_again():
    batch, log = fly(3, 60, window=20, weights=np.zeros((3, 3)))
    assert (np.trace(log[-1][0], axis1=1, axis2=2) > np.trace(log[-1][3], axis1=1, axis2=2)).all()
    residuals = batch.state.residuals
    want = np.einsum("bwi,bwj->bij", residuals, residuals) / 20 + log[-1][3]
    np.testing.assert_allclose(batch.state.measurement_cov, want, rtol=1e-12)


def test_the_paper_s_process_noise_has_no_rest_under_white_noise():
    """The scale grows by orders of magnitude although the stated Q is right."""
    fixed, _ = fly(10, 300, window=30)
    assert (fixed.state.process_scale == 1.0).all()
    for process in ("raw", "clamped"):
        batch, _ = fly(10, 300, window=30, process=process)
        assert np.median(batch.state.process_scale) > 100.0
        assert np.isfinite(batch.state.covariance).all()
