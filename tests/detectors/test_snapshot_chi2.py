"""The snapshot test: its statistic, its degrees of freedom, and its false-alarm rate."""

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import SnapshotChi2

from .support import belief, context, drawn, epoch

N = 5
ROWS = {"both": slice(0, 2 * N), "pseudorange": slice(0, N), "range_rate": slice(N, 2 * N)}


@pytest.mark.parametrize("signals", ROWS)
def test_the_statistic_is_the_quadratic_form_of_its_rows(signals):
    rng = np.random.default_rng(0)
    S = belief(rng, 4, N)
    z = 3.0 * drawn(rng, S)
    detector = SnapshotChi2(signals=signals)
    detector.bind(context(4, N))
    verdict = detector.judge(epoch(z, S))
    rows = ROWS[signals]
    want = [a[rows] @ np.linalg.solve(B[rows, rows], a[rows]) for a, B in zip(z, S, strict=True)]
    np.testing.assert_allclose(verdict.statistic[:, 0], want, rtol=1e-10)
    assert verdict.weights is None


@pytest.mark.parametrize(("signals", "each"), [("both", 2), ("pseudorange", 1), ("range_rate", 1)])
def test_every_visible_satellite_counts(signals, each):
    detector = SnapshotChi2(false_alarm=1e-3, signals=signals)
    detector.bind(context(N + 1, N))
    S = np.tile(np.eye(2 * N), (N + 1, 1, 1))
    visible = np.arange(N)[None, :] < np.arange(N + 1)[:, None]
    verdict = detector.judge(epoch(np.ones((N + 1, 2 * N)), S, visible))
    np.testing.assert_allclose(verdict.statistic[:, 0], each * np.arange(N + 1))
    want = scipy.stats.chi2.isf(1e-3, each * np.arange(1, N + 1))
    np.testing.assert_allclose(verdict.threshold[1:, 0], want, rtol=1e-9)
    assert np.isfinite(verdict.threshold[0, 0])
    assert not verdict.alarm[0, 0]


@pytest.mark.parametrize("signals", ROWS)
@pytest.mark.parametrize("alpha", [0.05, 1e-3])
def test_where_the_belief_is_right_alarms_are_as_rare_as_stated(signals, alpha):
    receivers, epochs = 500, 40
    rng = np.random.default_rng(1)
    detector = SnapshotChi2(false_alarm=alpha, signals=signals)
    detector.bind(context(receivers, N))
    alarms = 0
    for _ in range(epochs):
        S = belief(rng, receivers, N)
        visible = rng.uniform(size=(receivers, N)) < 0.8
        visible[:, 0] = True
        alarms += detector.judge(epoch(drawn(rng, S), S, visible)).alarm.sum()
    low, high = scipy.stats.binom.ppf([1e-4, 1.0 - 1e-4], receivers * epochs, alpha)
    assert low <= alarms <= high
