"""Cumulative sums: their recursion, and the mean time between false alarms."""

import math

import numpy as np
import pytest

from spoofgym.detectors import Cusum

from .support import belief, context, drawn, epoch, run_length

B, N = 3, 4


@pytest.mark.parametrize("signals", ["pseudorange", "range_rate", "both"])
def test_the_sums_are_the_printed_ones(signals):
    rng = np.random.default_rng(0)
    detector = Cusum(allowance=0.3, limit=4.0, signals=signals)
    detector.bind(context(B, N))
    high, low = np.zeros((B, 2 * N)), np.zeros((B, 2 * N))
    rows = {"pseudorange": [0], "range_rate": [1], "both": [0, 1]}[signals]
    for _ in range(40):
        S = belief(rng, B, N)
        visible = rng.uniform(size=(B, N)) < 0.9
        z = drawn(rng, S)
        found = detector.judge(epoch(z, S, visible))
        u = z / np.sqrt(np.diagonal(S, axis1=1, axis2=2))
        gone = ~np.hstack([visible, visible])
        high = np.where(gone, 0.0, np.maximum(0.0, high + u - 0.3))
        low = np.where(gone, 0.0, np.maximum(0.0, low - u - 0.3))
        both = np.maximum(high, low).reshape(B, 2, N)[:, rows].max(axis=1)
        np.testing.assert_allclose(found.statistic, both, atol=1e-12)
        np.testing.assert_array_equal(found.alarm, both > 4.0)


def test_false_alarms_are_as_far_apart_as_stated():
    """Restarted at each of them; their number is that of a renewal process."""
    receivers, epochs, limit = 400, 1500, 4.0
    rng = np.random.default_rng(1)
    detector = Cusum(limit=limit)
    detector.bind(context(receivers, 1))
    S = np.tile(np.eye(2), (receivers, 1, 1))
    alarms = 0
    for _ in range(epochs):
        alarm = detector.judge(epoch(rng.standard_normal((receivers, 2)), S)).alarm[:, 0]
        alarms += alarm.sum()
        detector.reset(alarm)
    expected = receivers * epochs / (0.5 * run_length(0.5, limit))
    # four standard deviations of a count, and the 1 % that the formula is good for
    assert alarms == pytest.approx(expected, abs=4.0 * math.sqrt(expected), rel=0.01)


def test_the_default_promises_one_false_alarm_in_1e5_epochs_of_eight_satellites():
    assert run_length(0.5, 12.4) / 16.0 == pytest.approx(1e5, rel=0.05)
