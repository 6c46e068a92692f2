"""Normalized innovation squared: against a plain solution."""

import numpy as np
import pytest

from spoofgym.receiver.kalman import normalized_innovation_squared


def drawn(receivers, m, seed=0):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((receivers, m, m))
    S = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(m)
    z = np.einsum("bij,bj->bi", np.linalg.cholesky(S), rng.standard_normal((receivers, m)))
    return z, S


@pytest.mark.nojit
@pytest.mark.parametrize(("first", "last"), [(0, 8), (4, 8), (2, 3)])
def test_it_is_the_quadratic_form(first, last):
    z, S = drawn(5, 8)
    part = z[:, first:last], S[:, first:last, first:last]
    want = [a @ np.linalg.solve(B, a) for a, B in zip(*part, strict=True)]
    np.testing.assert_allclose(normalized_innovation_squared(z, S, first, last), want, rtol=1e-10)


@pytest.mark.nojit
def test_an_invisible_row_adds_nothing():
    z, S = drawn(3, 4)
    padded, belief = np.zeros((3, 6)), np.tile(np.eye(6), (3, 1, 1))
    rows = np.array([0, 2, 3, 5])
    padded[:, rows] = z
    belief[np.ix_(range(3), rows, rows)] = S
    np.testing.assert_allclose(
        normalized_innovation_squared(padded, belief, 0, 6),
        normalized_innovation_squared(z, S, 0, 4),
        rtol=1e-12,
    )
    nothing = normalized_innovation_squared(np.zeros((3, 6)), np.tile(np.eye(6), (3, 1, 1)), 0, 6)
    np.testing.assert_array_equal(nothing, 0.0)


@pytest.mark.nojit
def test_it_is_infinite_where_s_is_no_covariance():
    z, S = drawn(3, 4)
    S[1, 2, 2] = -1.0
    q = normalized_innovation_squared(z, S, 0, 4)
    assert np.isfinite(q[[0, 2]]).all()
    assert q[1] == np.inf


def test_a_receiver_has_the_same_in_any_batch():
    z, S = drawn(33, 8)
    together = normalized_innovation_squared(z, S, 0, 8)
    for b in (7, 32):
        alone = normalized_innovation_squared(z[b : b + 1].copy(), S[b : b + 1].copy(), 0, 8)
        assert together[b : b + 1].tobytes() == alone.tobytes()
