"""Cumulative sums, plain and lagged: printed recursions, and the time between false alarms."""

import math

import numpy as np
import pytest

from spoofgym.detectors import Cusum, LagCusum

from .support import belief, context, drawn, epoch, judge_all, normalized, padded

ROWS = {"pseudorange": [0], "range_rate": [1], "both": [0, 1]}


def run_length(drift, threshold):
    """Mean epochs until a cumulative sum exceeds its threshold without a change, siegmund1985."""
    exponent = 2.0 * drift * (threshold + 1.166)
    return (math.exp(exponent) - exponent - 1.0) / (2.0 * drift * drift)


@pytest.mark.parametrize("signals", ROWS)
def test_the_sums_are_the_printed_ones(signals):
    B, N, epochs = 3, 4, 40
    rng = np.random.default_rng(0)
    S = belief(rng, N, epochs, B)
    z = drawn(rng, S)
    visible = rng.uniform(size=(epochs, B, N)) < 0.9
    found = judge_all(Cusum(allowance=0.3, limit=4.0, signals=signals), z, S, visible)
    high, low = np.zeros((2, B, 2 * N))
    for k, u in enumerate(normalized(z, S)):
        gone = ~np.hstack([visible[k], visible[k]])
        high = np.where(gone, 0.0, np.maximum(0.0, high + u - 0.3))
        low = np.where(gone, 0.0, np.maximum(0.0, low - u - 0.3))
        both = np.maximum(high, low).reshape(B, 2, N)[:, ROWS[signals]].max(axis=1)
        np.testing.assert_allclose(found.statistic[k], both, atol=1e-12)
    np.testing.assert_array_equal(found.alarm, found.statistic > 4.0)


def test_false_alarms_are_as_far_apart_as_stated():
    """Restarted at each of them; their number is that of a renewal process."""
    receivers, epochs, limit = 800, 500, 4.0
    rng = np.random.default_rng(1)
    detector = Cusum(limit=limit)
    detector.bind(context(receivers, 1))
    blank = epoch(np.zeros((receivers, 2)), np.eye(2))
    alarms = 0
    for _ in range(epochs):
        z = rng.standard_normal((receivers, 2))
        alarm = detector.judge(blank._replace(innovation=z)).alarm[:, 0]
        alarms += alarm.sum()
        detector.reset(alarm)
    expected = receivers * epochs / (0.5 * run_length(0.5, limit))
    # four standard deviations of a count, and the 1 % that the formula is good for
    assert alarms == pytest.approx(expected, abs=4.0 * math.sqrt(expected), rel=0.01)


def test_defaults_promise_the_false_alarms_of_eight_satellites():
    assert run_length(0.5, Cusum().limit) / 16.0 == pytest.approx(1e5, rel=0.05)
    assert 16.0 / run_length(0.5, LagCusum().threshold) == pytest.approx(4e-6, rel=0.1)


def plain_lagged(values, lag, baseline, drift):
    """Larger of the two sums after every value of one series."""
    above = below = 0.0
    out = []
    for k, value in enumerate(values):
        older = values[: max(k - lag, math.ceil(k / 2))][-baseline:]
        if len(older):
            change, least = value - np.mean(older), max(drift, 5.0 / math.sqrt(len(older)))
            above = max(0.0, above + change - least)
            below = max(0.0, below - change - least)
        out.append(max(above, below))
    return np.array(out)


@pytest.mark.parametrize(
    ("signals", "lag", "baseline"),
    [("pseudorange", 10, 30), ("range_rate", 1, 1), ("both", 25, 8), ("both", 500, 500)],
)
def test_the_lagged_sums_are_plain_ones(signals, lag, baseline):
    B, N, epochs = 2, 3, 120
    rng = np.random.default_rng(0)
    S = belief(rng, N, epochs, B)
    z = 3.0 * drawn(rng, S)
    visible = np.ones((epochs, B, N), dtype=bool)
    visible[50:53, 1, 0] = False
    detector = LagCusum(drift=0.7, threshold=4.0, lag=lag, baseline=baseline, signals=signals)
    found = judge_all(detector, z, S, visible)
    u = normalized(z, S)
    for b, j in np.ndindex(B, N):
        parts = [slice(0, 50), slice(53, epochs)] if (b, j) == (1, 0) else [slice(0, epochs)]
        for part in parts:
            sums = [plain_lagged(u[part, b, N * r + j], lag, baseline, 0.7) for r in ROWS[signals]]
            want = np.max(sums, axis=0)
            np.testing.assert_allclose(found.statistic[part, b, j], want, rtol=1e-9, atol=1e-9)
    assert found.alarm.any()
    np.testing.assert_array_equal(found.alarm, found.statistic > 4.0)


def test_a_bias_is_no_change_and_a_change_is_found():
    z = np.random.default_rng(2).standard_normal((900, 6))
    z += np.array([0.0, 3.0, -30.0, 0.5, 1.0, -0.7])
    z[600:, 1] -= 4.0
    alarms = judge_all(LagCusum(), padded(z)).alarm[:, 0]
    assert not alarms[:600].any()
    assert not np.delete(alarms, 1, axis=1).any()
    assert 2 <= np.argmax(alarms[600:, 1]) <= 8
