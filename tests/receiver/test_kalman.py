"""The update on eight sums against the textbook's, row by row, in one lane and in eight."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spoofgym.core.compile import njit
from spoofgym.core.simd import LANES
from spoofgym.receiver import kalman
from spoofgym.receiver._kernels import solve_in_place
from spoofgym.receiver.kalman import COVARIANCE_UPDATES, normalized_innovation_squared
from spoofgym.receiver.states import INDEX, PACKED

from ..lanes import in_all_lanes, side_by_side

SD = np.array([*np.repeat([2e-4, 0.05, 8.0, 3e-4, 5e-9], 3), 6.0, 0.3])
"""Standard deviations of the 17 states that a filter has in flight."""
UPPER = np.triu_indices(17)
PROPERTY = settings(max_examples=15, deadline=None)


def covariance(rng, scale=1.0):
    root = rng.standard_normal((17, 17))
    correlation = root @ root.T / 17.0 + 0.05 * np.eye(17)
    return correlation * np.outer(SD, SD) * scale


def sky(rng, n):
    u = rng.standard_normal((n, 3))
    return u / np.linalg.norm(u, axis=1)[:, None]


def design(u, visible):
    """H of all 2n rows; zero where invisible."""
    n = len(u)
    H = np.zeros((2 * n, 17))
    H[:n, 6:9], H[:n, 15] = u, 1.0
    H[n:, 3:6], H[n:, 16] = u, 1.0
    return H * np.concatenate([visible, visible])[:, None]


def textbook(P, u, z, R, w, visible, update):
    """State correction and updated covariance, with the weights W on the gain's columns."""
    both = np.concatenate([visible, visible])
    H = design(u, visible)[both]
    z, R, w = z[both], np.diag(R[both]), w[both]
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    KW = K * w
    if update == "unweighted":
        after = (np.eye(17) - K @ H) @ P
    elif update == "plain":
        after = (np.eye(17) - KW @ H) @ P
        after = 0.5 * (after + after.T)
    else:
        left = np.eye(17) - KW @ H
        after = left @ P @ left.T + KW @ R @ KW.T
    return KW @ z, after


@njit
def sum_and_update(x, precision, weights, codes, work):
    """What `_kernels.correct` calls; `x`: packed covariance, lines of sight, innovations."""
    n, code = weights.shape[0] // 2, codes.shape[0]
    u, z = PACKED, PACKED + 3 * n
    for half in range(2):
        for power in range(1 if code == kalman.UNWEIGHTED else 3):
            kalman.information(x, u, z, precision, weights, half, n, power, work)
    kalman.update(x, 0, code, work)


def eight_sums(cases, update):
    """Corrections and covariances of up to eight receivers, side by side; the first fill up.

    A case is (P, u, z, R, w, visible) with as many slots as the others; each receiver gets from
    eight lanes what it gets alone.
    """
    filled = [cases[i % len(cases)] for i in range(LANES)]
    P = side_by_side([case[0][UPPER] for case in filled])
    seen = side_by_side([np.concatenate([case[5], case[5]]) for case in filled])
    u, z, R, w = (side_by_side([case[k] for case in filled]) for k in (1, 2, 3, 4))
    u, z = u * np.repeat(seen[: len(seen) // 2], 3, axis=0), z * seen
    code, work = (
        np.empty((COVARIANCE_UPDATES[update], LANES)),
        np.full((kalman.WORK, LANES), np.nan),
    )
    x = np.vstack([P, u, z])
    in_all_lanes(sum_and_update, x, np.where(seen, 1.0 / R, 0.0), w, code, work)
    dx = work[kalman.X : kalman.X + 17]
    return [(dx[:, i], x[:PACKED, i][INDEX]) for i in range(len(cases))]


def check(cases, update, tolerance=1e-10):
    for case, (dx, after) in zip(cases, eight_sums(cases, update), strict=True):
        want_dx, want = textbook(*case, update)
        sd = np.sqrt(np.diag(case[0]))
        np.testing.assert_allclose(dx / sd, want_dx / sd, rtol=tolerance, atol=tolerance * 10)
        np.testing.assert_allclose(
            after / np.outer(sd, sd), want / np.outer(sd, sd), rtol=0, atol=tolerance
        )


def measured(rng, n):
    R = np.concatenate([rng.uniform(0.5, 30.0, n), rng.uniform(1e-3, 0.1, n)])
    return rng.standard_normal(2 * n) * 3.0 * np.sqrt(R), R


@pytest.mark.parametrize("update", COVARIANCE_UPDATES)
@PROPERTY
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 14), weighted=st.booleans())
def test_any_sky_and_any_weights_give_the_textbook_s_update(update, seed, n, weighted):
    rng, cases = np.random.default_rng(seed), []
    for _ in range(LANES):
        z, R = measured(rng, n)
        w = rng.uniform(0.0, 1.0, 2 * n) if weighted else np.ones(2 * n)
        w[rng.uniform(size=2 * n) < 0.2] = 0.0 if weighted else 1.0
        visible = rng.uniform(size=n) < 0.8
        cases.append((covariance(rng), sky(rng, n), z, R, w, visible))
    check(cases, update)


@pytest.mark.nojit
@pytest.mark.parametrize("update", COVARIANCE_UPDATES)
def test_few_satellites_or_none(update):
    rng, cases = np.random.default_rng(0), []
    for n in range(5):
        w = rng.uniform(0.0, 1.0, 12)
        cases.append((covariance(rng), sky(rng, 6), *measured(rng, 6), w, np.arange(6) < n))
    check(cases, update)
    dx, after = eight_sums(cases, update)[0]
    np.testing.assert_array_equal(dx, 0.0)
    np.testing.assert_array_equal(after, cases[0][0][UPPER][INDEX])


SINGULAR = (
    np.tile([0.6, 0.0, 0.8], (8, 1)),  # all in one direction
    np.repeat([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8]], 4, axis=0),  # in two
    np.array([[0.6 * np.cos(a), 0.6 * np.sin(a), 0.8] for a in range(8)]),  # on a cone
    np.array([[np.cos(a), np.sin(a), 0.0] for a in range(8)]),  # in a plane
)


@pytest.mark.parametrize("update", COVARIANCE_UPDATES)
def test_singular_geometry_and_sure_and_unsure_filters_side_by_side(update):
    rng, cases = np.random.default_rng(9), []
    skies = [(sky(rng, 8), scale) for scale in (1e-6, 1.0, 1e4)] + [(u, 1.0) for u in SINGULAR]
    for u, scale in skies:
        w = np.ones(16) if scale != 1.0 else rng.uniform(0.0, 1.0, 16)
        cases.append((covariance(rng, scale), u, *measured(rng, 8), w, np.ones(8, dtype=bool)))
    check(cases, update, 1e-9)


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
