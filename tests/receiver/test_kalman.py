"""The update on eight sums against the textbook's, row by row."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spoofgym.receiver.kalman import (
    COVARIANCE_UPDATES,
    OBSERVED,
    accumulate,
    gain_solution,
    innovation_covariance,
    innovation_variance,
    solve_in_place,
)

SD = np.repeat([2e-4, 0.05, 8.0, 3e-4, 5e-9, 0.0], 3)[:17].copy()
SD[15:] = 6.0, 0.3
"""Standard deviations of the 17 states that a filter has in flight."""
PROPERTY = settings(max_examples=60, deadline=None)


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


def eight_sums(P, u, z, R, w, visible, update):
    code = COVARIANCE_UPDATES[update]
    A, A1, A2 = (np.full((8, 8), np.nan) for _ in range(3))
    y, dx = np.full(8, np.nan), np.full(17, np.nan)
    accumulate(u, z, R, w, visible, code, A, A1, A2, y)
    after = P.ravel().copy()
    scratch = np.empty((8, 8)), np.empty((8, 8)), np.empty(64), np.empty(136), np.empty(136)
    gain_solution(after, A, A1, A2, y, code, *scratch, dx)
    return dx, after.reshape(17, 17)


def check(P, u, z, R, w, visible, update, tolerance=1e-10):
    dx, after = eight_sums(P, u, z, R, w, visible, update)
    want_dx, want = textbook(P, u, z, R, w, visible, update)
    sd = np.sqrt(np.diag(P))
    np.testing.assert_allclose(dx / sd, want_dx / sd, rtol=tolerance, atol=tolerance * 10)
    np.testing.assert_allclose(
        after / np.outer(sd, sd), want / np.outer(sd, sd), rtol=0, atol=tolerance
    )
    np.testing.assert_array_equal(after, after.T)


def measured(rng, n):
    R = np.concatenate([rng.uniform(0.5, 30.0, n), rng.uniform(1e-3, 0.1, n)])
    return rng.standard_normal(2 * n) * 3.0 * np.sqrt(R), R


@pytest.mark.parametrize("update", COVARIANCE_UPDATES)
@PROPERTY
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 14), weighted=st.booleans())
def test_any_sky_and_any_weights_give_the_textbook_s_update(update, seed, n, weighted):
    rng = np.random.default_rng(seed)
    z, R = measured(rng, n)
    w = rng.uniform(0.0, 1.0, 2 * n) if weighted else np.ones(2 * n)
    w[rng.uniform(size=2 * n) < 0.2] = 0.0 if weighted else 1.0
    visible = rng.uniform(size=n) < 0.8
    check(covariance(rng), sky(rng, n), z, R, w, visible, update)


@pytest.mark.nojit
@pytest.mark.parametrize("update", COVARIANCE_UPDATES)
@pytest.mark.parametrize("n", [0, 1, 2, 3, 4])
def test_few_satellites_or_none(update, n):
    rng = np.random.default_rng(n)
    z, R = measured(rng, 6)
    visible = np.arange(6) < n
    P = covariance(rng)
    w = rng.uniform(0.0, 1.0, 12)
    if n:
        check(P, sky(rng, 6), z, R, w, visible, update)
    else:
        dx, after = eight_sums(P, sky(rng, 6), z, R, w, visible, update)
        np.testing.assert_array_equal(dx, 0.0)
        np.testing.assert_array_equal(after, P)


@pytest.mark.parametrize("update", COVARIANCE_UPDATES)
@pytest.mark.parametrize(
    "u",
    [
        np.tile([0.6, 0.0, 0.8], (8, 1)),  # all in one direction
        np.repeat([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8]], 4, axis=0),  # in two
        np.array([[0.6 * np.cos(a), 0.6 * np.sin(a), 0.8] for a in range(8)]),  # on a cone
        np.array([[np.cos(a), np.sin(a), 0.0] for a in range(8)]),  # in a plane
    ],
)
def test_singular_geometry_tells_what_it_can(update, u):
    rng = np.random.default_rng(9)
    z, R = measured(rng, 8)
    check(covariance(rng), u, z, R, rng.uniform(0.0, 1.0, 16), np.ones(8, dtype=bool), update, 1e-9)


@pytest.mark.parametrize("update", COVARIANCE_UPDATES)
@pytest.mark.parametrize("scale", [1e-6, 1e4])
def test_a_sure_and_an_unsure_filter(update, scale):
    rng = np.random.default_rng(10)
    z, R = measured(rng, 8)
    P = covariance(rng, scale)
    check(P, sky(rng, 8), z, R, np.ones(16), np.ones(8, dtype=bool), update, 1e-9)


def test_with_all_weights_one_the_three_updates_are_the_same():
    rng = np.random.default_rng(11)
    z, R = measured(rng, 8)
    P, u = covariance(rng), sky(rng, 8)
    after = [
        eight_sums(P, u, z, R, np.ones(16), np.ones(8, dtype=bool), update)
        for update in COVARIANCE_UPDATES
    ]
    for dx, P_after in after[1:]:
        np.testing.assert_allclose(dx, after[0][0], rtol=1e-12)
        np.testing.assert_allclose(P_after / np.outer(SD, SD), after[0][1] / np.outer(SD, SD), 1e-9)


@pytest.mark.parametrize("update", ["plain", "general"])
def test_rejected_satellites_are_as_good_as_absent_in_the_state(update):
    """With weight 0 nothing is learned; the covariance of `unweighted` shrinks all the same."""
    rng = np.random.default_rng(12)
    z, R = measured(rng, 6)
    P, u = covariance(rng), sky(rng, 6)
    dx, after = eight_sums(P, u, z, R, np.zeros(12), np.ones(6, dtype=bool), update)
    np.testing.assert_array_equal(dx, 0.0)
    np.testing.assert_allclose(after / np.outer(SD, SD), P / np.outer(SD, SD), atol=1e-12)
    dx, after = eight_sums(P, u, z, R, np.zeros(12), np.ones(6, dtype=bool), "unweighted")
    np.testing.assert_array_equal(dx, 0.0)
    assert np.diag(after)[6:9].sum() < np.diag(P)[6:9].sum()


def test_an_invisible_slot_tells_nothing_whatever_it_holds():
    rng = np.random.default_rng(13)
    z, R = measured(rng, 5)
    P, u, visible = covariance(rng), sky(rng, 5), np.array([True, True, False, True, True])
    want = eight_sums(P, u, z, R, np.ones(10), visible, "general")
    u[2], z[[2, 7]], R[[2, 7]] = np.nan, np.nan, np.nan
    got = eight_sums(P, u, z, R, np.ones(10), visible, "general")
    for a, b in zip(want, got, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.nojit
def test_the_innovation_covariance_is_h_p_h_plus_r():
    rng = np.random.default_rng(14)
    n = 7
    u, visible = sky(rng, n), rng.uniform(size=n) < 0.7
    P, (_, R) = covariance(rng), measured(rng, n)
    S = np.full((2 * n, 2 * n), np.nan)
    innovation_covariance(P.ravel(), u, R, visible, np.empty(17), S)
    H = design(u, visible)
    both = np.concatenate([visible, visible])
    want = H @ P @ H.T + np.diag(np.where(both, R, 1.0))
    np.testing.assert_allclose(S, want, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(S, S.T)
    np.testing.assert_array_equal(S[~both], np.eye(2 * n)[~both])
    variance = np.full(2 * n, np.nan)
    innovation_variance(P.ravel(), u, R, visible, variance)
    np.testing.assert_array_equal(variance, np.diagonal(S))


@pytest.mark.nojit
def test_the_states_that_satellites_see():
    H = design(np.array([[0.1, 0.2, 0.3]]), np.array([True]))
    assert set(np.flatnonzero(H.any(axis=0))) == set(OBSERVED)


@pytest.mark.nojit
@pytest.mark.parametrize("k", [1, 4, 8])
def test_elimination_solves_what_needs_pivots(k):
    rng = np.random.default_rng(k)
    M, X = rng.standard_normal((k, k)), rng.standard_normal((k, 5))
    if k > 1:
        M[0, 0], M[1, 1] = 0.0, 0.0
    B = M @ X
    kept = B[:, 3:].copy()
    solve_in_place(M.copy(), B, 3)
    np.testing.assert_allclose(B[:, :3], X[:, :3], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(B[:, 3:], kept)
