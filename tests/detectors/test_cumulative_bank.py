"""The bank of cumulative monitors: its sums, and what each length of window finds."""

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import CumulativeBank

from .support import belief, context, drawn, epoch

B, N = 3, 4


@pytest.mark.nojit
@pytest.mark.parametrize("signals", ["pseudorange", "both"])
def test_it_is_the_largest_ratio_of_the_windows(signals):
    rng = np.random.default_rng(0)
    S = belief(rng, B, N)
    windows = (2, 5, 9)
    detector = CumulativeBank(0.03, tuple(0.5 * w for w in windows), signals)
    detector.bind(context(B, N))
    assert detector.memory_epochs == 9
    past, rows = [], []
    for _ in range(14):
        visible = rng.random((B, N)) < 0.7
        z = drawn(rng, S)
        found = detector.judge(epoch(z, S, visible))
        squares, counts = np.zeros(B), np.zeros(B)
        for b in range(B):
            kept = np.r_[visible[b], visible[b] & (signals == "both")].nonzero()[0]
            part = np.linalg.inv(S[b][np.ix_(kept, kept)])
            squares[b], counts[b] = z[b, kept] @ part @ z[b, kept], len(kept)
        past.append(squares)
        rows.append(counts)
        want = np.zeros(B)
        for w in windows:
            total, degrees = np.sum(past[-w:], axis=0), np.sum(rows[-w:], axis=0)
            limit = scipy.stats.chi2.isf(0.01, np.maximum(degrees, 1))
            want = np.maximum(want, total / limit)
        np.testing.assert_allclose(found.statistic[:, 0], want, rtol=1e-9)
        np.testing.assert_array_equal(found.threshold, 1.0)
        np.testing.assert_array_equal(found.alarm, found.statistic > 1.0)
    assert found.weights is None


def test_white_innovations_alarm_less_often_than_it_says():
    receivers, rng = 400, np.random.default_rng(2)
    S = np.tile(np.eye(2 * N), (receivers, 1, 1))
    bank = CumulativeBank(0.05, (2.0, 8.0, 20.0))
    bank.bind(context(receivers, N))
    rates = []
    for k in range(240):
        alarm = bank.judge(epoch(rng.standard_normal((receivers, 2 * N)), S)).alarm
        if k >= 40:
            rates.append(alarm.mean())
    assert 0.02 < np.mean(rates) < 0.05
