"""What the filter believes of innovations, and small solvers, against dense algebra."""

import numpy as np
import pytest

from spoofgym.receiver._kernels import solve_in_place
from spoofgym.receiver.kalman import normalized_innovation_squared


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
