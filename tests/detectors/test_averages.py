"""Averages and sums over windows: AIME, the bank, the moving average, the clock's part."""

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import Aime, ClockDrift, CumulativeBank, FiniteMovingAverage

from .support import belief, drawn, judge_all, normalized, padded

B, N = 3, 4
WINDOWS = (2, 5, 9)
WINDOWS_S = tuple(0.5 * w for w in WINDOWS)
ROWS = {"pseudorange": slice(0, N), "range_rate": slice(N, 2 * N), "both": slice(0, 2 * N)}


@pytest.mark.parametrize("signals", ["pseudorange", "both"])
def test_with_a_constant_covariance_aime_is_the_classical_average(signals):
    """By Diesel and Luu: mean of z with the inverse of the summed information."""
    rng, rows = np.random.default_rng(0), ROWS[signals]
    S = belief(rng, N, B)
    z = drawn(rng, np.broadcast_to(S, (25, *S.shape)))
    detector = Aime(false_alarm=0.01, windows_s=WINDOWS_S, signals=signals)
    found = judge_all(detector, z, S)
    information = np.linalg.inv(S[:, rows, rows])
    for k in range(25):
        want = np.zeros(B)
        for w in WINDOWS:
            recent = z[max(0, k + 1 - w) : k + 1, :, rows]
            q = np.einsum("bi,bij,bj->b", recent.mean(axis=0), information, recent.mean(axis=0))
            want = np.maximum(want, len(recent) * q)
        np.testing.assert_allclose(found.statistic[k, :, 0], want, rtol=1e-9)
    threshold = scipy.stats.chi2.isf(0.01 / 3, rows.stop)
    np.testing.assert_allclose(found.threshold, threshold, rtol=1e-9)


def test_a_satellite_that_is_away_leaves_the_others_of_aime_in_place():
    """Its epochs count for nobody, and its average goes on over those in which it was there."""
    visible = np.ones((12, B, N), dtype=bool)
    visible[6:8, :, 1] = visible[10:, :, 3] = False
    z = 2.0 * np.random.default_rng(1).standard_normal((12, B, 2 * N))
    S = np.diag(np.repeat([4.0, 1.0], N))
    found = judge_all(Aime(windows_s=(4.0,)), z, S, visible)
    y = np.where(visible, z[:, :, :N] / 2.0, 0.0)[-8:]
    counts = visible[-8:].sum(axis=0)
    q = np.where(visible[-1], y.sum(axis=0) ** 2 / counts, 0.0).sum(axis=1)
    np.testing.assert_allclose(found.statistic[-1, :, 0], q)
    np.testing.assert_allclose(found.threshold[-1], scipy.stats.chi2.isf(1e-5, 3), rtol=1e-9)


@pytest.mark.nojit
@pytest.mark.parametrize("signals", ["pseudorange", "both"])
def test_the_bank_is_the_largest_ratio_of_its_windows(signals):
    rng, epochs = np.random.default_rng(0), 14
    S = belief(rng, N, B)
    visible = rng.random((epochs, B, N)) < 0.7
    z = drawn(rng, np.broadcast_to(S, (epochs, *S.shape)))
    detector = CumulativeBank(0.03, WINDOWS_S, signals)
    found = judge_all(detector, z, S, visible)
    assert detector.memory_epochs == 9
    squares, degrees = np.zeros((2, epochs, B))
    for k, b in np.ndindex(epochs, B):
        kept = np.flatnonzero(np.r_[visible[k, b], visible[k, b] & (signals == "both")])
        part = np.linalg.inv(S[b][np.ix_(kept, kept)])
        squares[k, b], degrees[k, b] = z[k, b, kept] @ part @ z[k, b, kept], len(kept)
    for k in range(epochs):
        want = np.zeros(B)
        for w in WINDOWS:
            last = slice(max(0, k + 1 - w), k + 1)
            limit = scipy.stats.chi2.isf(0.01, np.maximum(degrees[last].sum(axis=0), 1))
            want = np.maximum(want, squares[last].sum(axis=0) / limit)
        np.testing.assert_allclose(found.statistic[k, :, 0], want, rtol=1e-9)
    np.testing.assert_array_equal(found.threshold, 1.0)
    np.testing.assert_array_equal(found.alarm, found.statistic > 1.0)
    assert found.weights is None


@pytest.mark.nojit
@pytest.mark.parametrize("signals", ROWS)
@pytest.mark.parametrize("shape", ["step", "ramp"])
def test_a_moving_average_is_the_normalized_sum_of_a_window(signals, shape):
    """Satellites that are away count in neither sum."""
    rng, epochs = np.random.default_rng(0), 14
    S = belief(rng, N, B)
    visible = rng.random((epochs, B, N)) < 0.8
    z = drawn(rng, np.broadcast_to(S, (epochs, *S.shape)))
    detector = FiniteMovingAverage(false_alarm=0.01, window_s=2.5, shape=shape, signals=signals)
    found = judge_all(detector, z, S, visible)
    weights = np.arange(1.0, 6.0) if shape == "ramp" else np.ones(5)
    kinds = {"pseudorange": [0], "range_rate": [1], "both": [0, 1]}[signals]
    u = np.where(visible[:, :, None], normalized(z, S).reshape(epochs, B, 2, N), 0.0)
    for k in range(epochs):
        last = slice(max(0, k - 4), k + 1)
        c = weights[-len(u[last]) :, None, None]
        total = np.abs((c[..., None] * u[last]).sum(axis=0))[:, kinds].max(axis=1)
        squares = (c**2 * visible[last]).sum(axis=0)
        want = np.where(visible[k], total / np.sqrt(np.maximum(squares, 1e-9)), 0.0)
        np.testing.assert_allclose(found.statistic[k], want, rtol=1e-12)
    quantile = scipy.stats.norm.isf(0.005 / len(kinds))
    np.testing.assert_allclose(found.threshold, quantile, rtol=1e-9)
    assert found.weights is None


def test_an_old_fault_is_forgotten_with_the_window():
    detector = FiniteMovingAverage(window_s=3.0)
    found = judge_all(detector, padded(np.eye(7, N) * [100.0, 0.0, 0.0, 0.0]))
    assert detector.memory_epochs == 6
    assert found.alarm[0, 0, 0]
    want = [*(100.0 / np.sqrt(range(1, 7))), 0.0]
    np.testing.assert_allclose(found.statistic[:, 0, 0], want)


@pytest.mark.parametrize("signals", ROWS)
def test_the_clocks_part_is_the_quadratic_form_of_the_least_squares_estimate(signals):
    rng, rows = np.random.default_rng(0), ROWS[signals]
    S = belief(rng, N, B)
    z = 2.0 * drawn(rng, S)
    detector = ClockDrift(signals=signals, window_s=0.5, false_alarm=0.01)
    found = judge_all(detector, z[None], S)
    A = np.repeat(np.eye(2), N, axis=0)[rows]
    A = A[:, A.any(axis=0)]
    for b in range(B):
        weight = np.linalg.inv(S[b, rows, rows])
        information = A.T @ weight @ A
        estimate = np.linalg.solve(information, A.T @ weight @ z[b, rows])
        want = estimate @ information @ estimate
        np.testing.assert_allclose(found.statistic[0, b, 0], want, rtol=1e-9)
    np.testing.assert_allclose(found.threshold, scipy.stats.chi2.isf(0.01, A.shape[1]))


def test_the_clocks_average_gains_by_its_window_and_what_cancels_is_not_the_clocks():
    """A constant common offset of one standard deviation of the estimate: q grows to W."""
    z = np.zeros((15, B, 2 * N))
    z[:, :, N:] = 1.0 / np.sqrt(N)
    found = judge_all(ClockDrift(signals="range_rate", window_s=5.0), z)
    want = np.minimum(np.arange(1, 16), 10)[:, None]
    np.testing.assert_allclose(found.statistic[:, :, 0], np.tile(want, B))
    z[:, :, :2], z[:, :, N:] = [50.0, -50.0], 0.0
    assert not judge_all(ClockDrift(), z).statistic.any()
