"""Statistics and thresholds of tests of innovations, against plain ones."""

import math
from functools import partial

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import (
    Aime,
    ClockDrift,
    CumulativeBank,
    Cusum,
    FiniteMovingAverage,
    GlrRamp,
    GlrStep,
    LagCusum,
    SequentialChi2,
    Shewhart,
    SnapshotChi2,
    WindowedChi2,
)

from .support import belief, context, drawn, judge_all, normalized

B, N, K, ALPHA = 2, 3, 60, 0.01
SIGNALS = {"pseudorange": [0], "range_rate": [1], "both": [0, 1]}
every_signal = pytest.mark.parametrize("signals", SIGNALS)


def play():
    rng = np.random.default_rng(0)
    S = belief(rng, N, K, B)
    z = drawn(rng, S)
    z[26:, :, [1, N + 1]] += 4.0
    visible = np.ones((K, B, N), dtype=bool)
    visible[20:22, 0, 2] = visible[:3, 1, 1] = visible[44, 1] = False
    return z, S, visible


# --- of single satellites: by the series of their innovations, NaN where they are away -----------


def unbroken(x):
    return x[np.append(-1, np.flatnonzero(np.isnan(x)))[-1] + 1 :]


def plain_cusum(x):
    high = low = 0.0
    for value in unbroken(x):
        high, low = max(0.0, high + value - 0.3), max(0.0, low - value - 0.3)
    return max(high, low)


def plain_lagged(lag, baseline, x):
    x, above, below = unbroken(x), 0.0, 0.0
    for k, value in enumerate(x):
        older = x[: max(k - lag, math.ceil(k / 2))][-baseline:]
        if len(older):
            change, least = value - np.mean(older), max(0.7, 5.0 / math.sqrt(len(older)))
            above, below = max(0.0, above + change - least), max(0.0, below - change - least)
    return max(above, below)


def plain_sum(ramp, x):
    x = x[-5:]
    c = (np.arange(1.0, 6.0) if ramp else np.ones(5))[-len(x) :][~np.isnan(x)]
    return abs(c @ x[~np.isnan(x)]) / np.linalg.norm(c)


def by_regression(window, baseline, ramp, x):
    x, best = unbroken(x), 0.0
    for n in range(1, min(window, len(x) - 1) + 1):
        z = x[max(0, len(x) - n - baseline) :]
        change = np.maximum(0.0, np.arange(len(z)) - (len(z) - n - 1.0))
        with_change = np.column_stack([np.ones(len(z)), change if ramp else change > 0.0])
        found = np.linalg.lstsq(with_change, z, rcond=None)[0]
        left = ((z - with_change @ found) ** 2).sum()
        best = max(best, ((z - z.mean()) ** 2).sum() - left)
    return best


def quantile(rows, seen):
    return scipy.stats.norm.isf(ALPHA / 2.0 / rows)


def shared(window, rows, seen):
    return scipy.stats.chi2.isf(ALPHA / (window * rows * np.maximum(seen, 1)), 1)


def limit(rows, seen):
    return 4.0


def average(shape):
    return partial(FiniteMovingAverage, false_alarm=ALPHA, window_s=2.5, shape=shape)


def lagged(lag, baseline):
    make = partial(LagCusum, drift=0.7, threshold=4.0, lag=lag, baseline=baseline)
    return make, partial(plain_lagged, lag, baseline), limit


def scan(kind, window, baseline):
    make = partial(kind, false_alarm=ALPHA, window=window, baseline=baseline)
    plain = partial(by_regression, window, baseline, kind is GlrRamp)
    return make, plain, partial(shared, window)


OF_SATELLITES = {
    "shewhart": (partial(Shewhart, false_alarm=ALPHA), lambda x: abs(x[-1]), quantile),
    "cusum": (partial(Cusum, allowance=0.3, limit=4.0), plain_cusum, limit),
    "average": (average("step"), partial(plain_sum, False), quantile),
    "average, ramp": (average("ramp"), partial(plain_sum, True), quantile),
    "lagged": lagged(25, 8),
    "lagged, short": lagged(1, 1),
    "lagged, long": lagged(500, 500),
    "step": scan(GlrStep, 9, 1),
    "step, long": scan(GlrStep, 500, 300),
    "ramp": scan(GlrRamp, 7, 12),
    "ramp, long": scan(GlrRamp, 500, 300),
}


@pytest.mark.parametrize(
    ("name", "signals"),
    [(name, each) for name in OF_SATELLITES for each in (["both"] if "," in name else SIGNALS)],
)
def test_a_satellites_statistic_is_the_largest_of_its_series(name, signals):
    make, plain, threshold = OF_SATELLITES[name]
    z, S, visible = play()
    found = judge_all(make(signals=signals), z, S, visible)
    u = np.where(visible[:, :, None], normalized(z, S).reshape(K, B, 2, N), np.nan)
    for k, b, j in np.ndindex(K, B, N):
        series = [u[: k + 1, b, row, j] for row in SIGNALS[signals]]
        want = max(map(plain, series)) if visible[k, b, j] else 0.0
        assert found.statistic[k, b, j] == pytest.approx(want, rel=1e-9, abs=1e-9)
    wanted = threshold(len(SIGNALS[signals]), visible.sum(axis=2, keepdims=True))
    shown = visible.any(axis=2)
    wanted = np.broadcast_to(wanted, visible.shape)[shown]
    np.testing.assert_allclose(found.threshold[shown], wanted, rtol=1e-9)
    np.testing.assert_array_equal(found.alarm, found.statistic > found.threshold)
    assert found.alarm.any() or name == "lagged, short"
    assert found.weights is None


# --- of the receiver: by sums of squares ---------------------------------------------------------


def squares(z, S, visible, signals):
    """(K, B) normalized innovations squared, and their degrees of freedom."""
    q, degrees = np.zeros((2, K, B))
    for k, b in np.ndindex(K, B):
        seen = np.flatnonzero(visible[k, b])
        rows = np.concatenate([N * row + seen for row in SIGNALS[signals]])
        q[k, b] = z[k, b, rows] @ np.linalg.solve(S[k, b][np.ix_(rows, rows)], z[k, b, rows])
        degrees[k, b] = len(rows)
    return q, degrees


def sum_of_last(values, length):
    return np.array([values[max(0, k + 1 - length) : k + 1].sum(axis=0) for k in range(K)])


SUMS = {
    "snapshot": (SnapshotChi2, 1),
    "sequential": (SequentialChi2, K),
    "sequential, 7 epochs": (partial(SequentialChi2, window_s=3.5), 7),
    "windowed": (partial(WindowedChi2, window=5), 5),
}


@pytest.mark.nojit
@every_signal
@pytest.mark.parametrize("name", SUMS)
def test_the_receivers_statistic_is_a_sum_of_squares(name, signals):
    make, length = SUMS[name]
    given = play()
    found = judge_all(make(false_alarm=ALPHA, signals=signals), *given)
    total, degrees = (sum_of_last(each, length) for each in squares(*given, signals))
    if name == "windowed":  # judges full windows alone
        total[: length - 1] = 0.0
    np.testing.assert_allclose(found.statistic[..., 0], total, rtol=1e-9, atol=1e-12)
    want = scipy.stats.chi2.isf(ALPHA, np.maximum(degrees, 1))
    np.testing.assert_allclose(found.threshold[..., 0], want, rtol=1e-9)
    np.testing.assert_array_equal(found.alarm, found.statistic > found.threshold)
    assert found.weights is None


WINDOWS = (2, 5, 9)
WINDOWS_S = tuple(0.5 * w for w in WINDOWS)


@pytest.mark.nojit
@every_signal
def test_the_bank_is_the_largest_ratio_of_its_windows(signals):
    given = play()
    found = judge_all(CumulativeBank(0.03, WINDOWS_S, signals), *given)
    q, degrees = squares(*given, signals)
    ratios = [
        sum_of_last(q, w) / scipy.stats.chi2.isf(0.01, np.maximum(sum_of_last(degrees, w), 1))
        for w in WINDOWS
    ]
    np.testing.assert_allclose(found.statistic[..., 0], np.max(ratios, axis=0), rtol=1e-9)
    np.testing.assert_array_equal(found.threshold, 1.0)
    np.testing.assert_array_equal(found.alarm, found.statistic > 1.0)
    assert found.weights is None


@pytest.mark.parametrize("signals", ["pseudorange", "both"])
def test_with_a_constant_covariance_aime_is_the_classical_average(signals):
    """By Diesel and Luu: mean of z with the inverse of the summed information."""
    rng, rows = np.random.default_rng(0), slice(0, N * len(SIGNALS[signals]))
    S = belief(rng, N, B)
    z = drawn(rng, np.broadcast_to(S, (25, *S.shape)))
    found = judge_all(Aime(false_alarm=0.03, windows_s=WINDOWS_S, signals=signals), z, S)
    information = np.linalg.inv(S[:, rows, rows])
    for k in range(25):
        recent = [z[max(0, k + 1 - w) : k + 1, :, rows] for w in WINDOWS]
        means = [(len(each), each.mean(axis=0)) for each in recent]
        want = [n * np.einsum("bi,bij,bj->b", mean, information, mean) for n, mean in means]
        np.testing.assert_allclose(found.statistic[k, :, 0], np.max(want, axis=0), rtol=1e-9)
    threshold = scipy.stats.chi2.isf(0.01, rows.stop)
    np.testing.assert_allclose(found.threshold, threshold, rtol=1e-9)


def test_a_satellite_that_is_away_leaves_the_others_of_aime_in_place():
    visible = np.ones((12, B, N), dtype=bool)
    visible[6:8, :, 1] = visible[10:, :, 2] = False
    z = 2.0 * np.random.default_rng(1).standard_normal((12, B, 2 * N))
    S = np.diag(np.repeat([4.0, 1.0], N))
    found = judge_all(Aime(windows_s=(4.0,)), z, S, visible)
    y = np.where(visible, z[:, :, :N] / 2.0, 0.0)[-8:]
    counts = visible[-8:].sum(axis=0)
    q = np.where(visible[-1], y.sum(axis=0) ** 2 / counts, 0.0).sum(axis=1)
    np.testing.assert_allclose(found.statistic[-1, :, 0], q)
    np.testing.assert_allclose(found.threshold[-1], scipy.stats.chi2.isf(1e-5, 2), rtol=1e-9)


@every_signal
def test_the_clocks_part_is_the_quadratic_form_of_the_least_squares_estimate(signals):
    rng, kinds = np.random.default_rng(0), SIGNALS[signals]
    rows = slice(N * kinds[0], N * (kinds[-1] + 1))
    S = belief(rng, N, B)
    z = 2.0 * drawn(rng, S)
    found = judge_all(ClockDrift(signals=signals, window_s=0.5, false_alarm=0.01), z[None], S)
    A = np.repeat(np.eye(2), N, axis=0)[rows, kinds]
    for b in range(B):
        weight = np.linalg.inv(S[b, rows, rows])
        information = A.T @ weight @ A
        estimate = np.linalg.solve(information, A.T @ weight @ z[b, rows])
        want = estimate @ information @ estimate
        np.testing.assert_allclose(found.statistic[0, b, 0], want, rtol=1e-9)
    np.testing.assert_allclose(found.threshold, scipy.stats.chi2.isf(0.01, len(kinds)))


def test_the_clocks_average_gains_by_its_window_and_what_cancels_is_not_the_clocks():
    """A constant common offset of one standard deviation of the estimate: q grows to W."""
    z = np.zeros((15, B, 2 * N))
    z[:, :, N:] = 1.0 / np.sqrt(N)
    found = judge_all(ClockDrift(signals="range_rate", window_s=5.0), z)
    want = np.minimum(np.arange(1, 16), 10)[:, None]
    np.testing.assert_allclose(found.statistic[:, :, 0], np.tile(want, B))
    z[:, :, :2], z[:, :, N:] = [50.0, -50.0], 0.0
    assert not judge_all(ClockDrift(), z).statistic.any()


@pytest.mark.parametrize(
    ("detector", "epochs"),
    [
        (FiniteMovingAverage(window_s=3.0), 6),
        (CumulativeBank(windows_s=WINDOWS_S), 9),
        (Aime(windows_s=WINDOWS_S, bias_window_s=2.0), 13),
        (ClockDrift(window_s=5.0), 10),
        (SequentialChi2(window_s=3.5), 7),
        (WindowedChi2(window=5), 5),
    ],
)
def test_the_memory_is_as_long_as_the_windows(detector, epochs):
    detector.bind(context(B, N))
    assert detector.memory_epochs == epochs
