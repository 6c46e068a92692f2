"""The bank of cumulative monitors: its sums, and what each length of window finds."""

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import CumulativeBank, SequentialChi2

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


def test_with_one_window_it_is_the_sequential_test():
    rng = np.random.default_rng(1)
    S = belief(rng, B, N)
    bank = CumulativeBank(1e-3, (4.0,), "pseudorange")
    one = SequentialChi2(1e-3, window_s=4.0, signals="pseudorange")
    for each in (bank, one):
        each.bind(context(B, N))
    for _ in range(20):
        seen = epoch(drawn(rng, S), S)
        found, theirs = bank.judge(seen), one.judge(seen)
        np.testing.assert_allclose(found.statistic, theirs.statistic / theirs.threshold)


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


def test_a_short_window_is_quick_and_a_long_one_sees_little_faults():
    receivers, rng = 300, np.random.default_rng(3)
    S = np.tile(np.eye(2 * N), (receivers, 1, 1))
    lengths = {"short": (2.0,), "long": (50.0,), "both": (2.0, 50.0)}

    def found_after(epochs, shift):
        banks = {name: CumulativeBank(1e-4, each) for name, each in lengths.items()}
        for each in banks.values():
            each.bind(context(receivers, N))
        for k in range(100 + epochs):
            seen = epoch(rng.standard_normal((receivers, 2 * N)) + shift * (k >= 100), S)
            found = {name: each.judge(seen).alarm.mean() for name, each in banks.items()}
        return found

    loud, faint = found_after(3, 1.9), found_after(100, 0.55)
    assert min(loud["short"], loud["both"], faint["long"], faint["both"]) > 0.8
    assert max(loud["long"], faint["short"]) < 0.2
