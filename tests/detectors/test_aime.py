"""Averages over windows: their statistic, and what they see that sums of squares don't."""

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import Aime

from .support import belief, context, drawn, epoch

B, N = 3, 4


@pytest.mark.parametrize("signals", ["pseudorange", "both"])
def test_with_a_constant_covariance_it_is_the_classical_average(signals):
    """By Diesel and Luu: mean of z with the inverse of the summed information."""
    rng = np.random.default_rng(0)
    S = belief(rng, B, N)
    rows = slice(0, N if signals == "pseudorange" else 2 * N)
    windows = (2, 5, 9)
    detector = Aime(false_alarm=0.01, windows_s=tuple(0.5 * w for w in windows), signals=signals)
    detector.bind(context(B, N))
    past = []
    for _ in range(25):
        past.append(drawn(rng, S))
        found = detector.judge(epoch(past[-1], S))
        want = np.zeros(B)
        for w in windows:
            recent = np.array(past[-w:])
            for b in range(B):
                information = len(recent) * np.linalg.inv(S[b, rows, rows])
                mean = recent[:, b, rows].mean(axis=0)
                want[b] = max(want[b], mean @ information @ mean)
        np.testing.assert_allclose(found.statistic[:, 0], want, rtol=1e-9)
    degrees = rows.stop
    np.testing.assert_allclose(found.threshold, scipy.stats.chi2.isf(0.01 / 3, degrees), rtol=1e-9)


def test_a_satellite_that_is_away_leaves_the_others_in_place():
    """Its epochs count for nobody, and its average goes on over those in which it was there."""
    rng = np.random.default_rng(1)
    S = np.tile(np.diag(np.repeat([4.0, 1.0], N)), (B, 1, 1))
    detector = Aime(windows_s=(4.0,))
    detector.bind(context(B, N))
    z, shown = [], []
    for k in range(12):
        visible = np.ones((B, N), dtype=bool)
        visible[:, 1] = k not in (6, 7)
        visible[:, 3] = k < 10
        z.append(drawn(rng, S))
        shown.append(visible)
        found = detector.judge(epoch(z[-1], S, visible))
    y = np.where(shown, np.array(z)[:, :, :N] / 2.0, 0.0)[-8:]
    counts = np.array(shown)[-8:].sum(axis=0)
    q = np.where(shown[-1], y.sum(axis=0) ** 2 / counts, 0.0).sum(axis=1)
    np.testing.assert_allclose(found.statistic[:, 0], q)
    np.testing.assert_allclose(found.threshold, scipy.stats.chi2.isf(1e-5, 3), rtol=1e-9)
