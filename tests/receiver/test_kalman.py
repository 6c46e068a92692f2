"""What the filter believes of innovations, and small solvers, against dense algebra."""

import numpy as np
import pytest

from spoofgym.core.compile import njit
from spoofgym.core.simd import LANES
from spoofgym.receiver import kalman
from spoofgym.receiver._kernels import solve_in_place
from spoofgym.receiver.kalman import normalized_innovation_squared
from spoofgym.receiver.states import PACKED

from ..lanes import in_all_lanes, side_by_side
from .reference import covariance, design, measured, sky

UPPER = np.triu_indices(17)


@njit
def belief_of_the_measurements(x, S, variance, t):
    n = variance.shape[0] // 2
    u, R, visible = PACKED, PACKED + 3 * n, PACKED + 5 * n
    kalman.innovation_covariance(x, 0, u, x, R, visible, n, S, t)
    kalman.innovation_variance(x, 0, u, x, R, visible, n, variance)


@pytest.mark.nojit
def test_the_innovation_covariance_is_h_p_h_plus_r():
    rng, n, cases = np.random.default_rng(14), 7, []
    for _ in range(LANES):
        P, u, (_, R) = covariance(rng), sky(rng, n), measured(rng, n)
        cases.append((P, u, R, rng.uniform(size=n) < 0.7))
    x = side_by_side(
        [np.concatenate([P[UPPER], np.ravel(u * v[:, None]), R, v]) for P, u, R, v in cases]
    )
    S, variance = np.full((4 * n * n, LANES), np.nan), np.full((2 * n, LANES), np.nan)
    in_all_lanes(belief_of_the_measurements, x, S, variance, np.empty((8, LANES)), scratch=1)
    for i, (P, u, R, visible) in enumerate(cases):
        H = design(u, visible)
        both = np.concatenate([visible, visible])
        want = H @ P @ H.T + np.diag(np.where(both, R, 1.0))
        upper = np.triu_indices(2 * n)
        mine = S[:, i].reshape(2 * n, 2 * n)[upper]
        np.testing.assert_allclose(mine, want[upper], rtol=1e-12, atol=1e-12)
        unseen = ~(both[:, None] & both)[upper]
        np.testing.assert_array_equal(mine[unseen], np.eye(2 * n)[upper][unseen])
        np.testing.assert_allclose(variance[:, i], np.diag(want), rtol=1e-14)
        np.testing.assert_array_equal(variance[~both, i], 1.0)


@pytest.mark.nojit
@pytest.mark.parametrize("k", [1, 4, 8])
def test_elimination_solves_what_needs_pivots(k):
    rng = np.random.default_rng(k)
    M, y = rng.standard_normal((k, k)), rng.standard_normal(k)
    if k > 1:
        M[0, 0], M[1, 1] = 0.0, 0.0
    x = M @ y
    solve_in_place(M.copy(), x)
    np.testing.assert_allclose(x, y, rtol=1e-9, atol=1e-12)


@pytest.mark.nojit
@pytest.mark.parametrize(("first", "last"), [(0, 8), (4, 8), (2, 3)])
def test_normalized_innovations_are_the_quadratic_form(first, last):
    rng = np.random.default_rng(0)
    root = rng.standard_normal((5, 8, 8))
    S = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(8)
    z = rng.standard_normal((5, 8))
    rows = [r for r in range(first, last) if r != 5]  # that of an invisible satellite adds nothing
    z[:, 5], S[:, 5], S[:, :, 5] = 0.0, 0.0, 0.0
    S[:, 5, 5] = 1.0
    want = [
        a[rows] @ np.linalg.solve(B[np.ix_(rows, rows)], a[rows]) for a, B in zip(z, S, strict=True)
    ]
    np.testing.assert_allclose(normalized_innovation_squared(z, S, first, last), want, rtol=1e-10)
    assert not normalized_innovation_squared(0.0 * z, S, first, last).any()
    S[1, 2, 2] = -1.0  # which is no covariance
    found = normalized_innovation_squared(z, S, first, last)
    assert np.isinf(found).tolist() == [False, first <= 2, False, False, False]
