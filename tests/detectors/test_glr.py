"""The likelihood-ratio scans against regressions, their bound on false alarms, and biases."""

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import GlrRamp, GlrStep

from .support import belief, context, drawn, epoch

B, N = 2, 3


def by_regression(values, window, baseline, ramp):
    """Statistic after the last of some values: by how much a change lowers the sum of squares."""
    best, count = 0.0, len(values)
    for n in range(1, min(window, count - 1) + 1):
        z = values[max(0, count - n - baseline) :]
        change = np.zeros(len(z))
        change[-n:] = np.arange(1, n + 1) if ramp else 1.0
        with_change = np.column_stack([np.ones(len(z)), change])
        found = np.linalg.lstsq(with_change, z, rcond=None)[0]
        without = ((z - z.mean()) ** 2).sum()
        best = max(best, without - ((z - with_change @ found) ** 2).sum())
    return best


@pytest.mark.parametrize("kind", [GlrStep, GlrRamp])
@pytest.mark.parametrize(
    ("signals", "window", "baseline"),
    [("pseudorange", 7, 12), ("range_rate", 10, 4), ("both", 9, 1), ("pseudorange", 500, 300)],
)
def test_the_statistic_is_that_of_a_regression(kind, signals, window, baseline):
    rng = np.random.default_rng(0)
    epochs = 45
    S = np.array([belief(rng, B, N) for _ in range(epochs)])
    z = np.array([drawn(rng, S[k]) for k in range(epochs)])
    z[30:, :, 1] += 4.0
    visible = np.ones((epochs, B, N), dtype=bool)
    visible[20:22, 0, 2] = False
    detector = kind(window=window, baseline=baseline, signals=signals)
    detector.bind(context(B, N))
    normalized = z / np.sqrt(np.diagonal(S, axis1=2, axis2=3))
    rows = {"pseudorange": [0], "range_rate": [N], "both": [0, N]}[signals]
    for k in range(epochs):
        verdict = detector.judge(epoch(z[k], S[k], visible[k]))
        for b in range(B):
            for j in range(N):
                begun = 22 if (b, j) == (0, 2) and k >= 22 else 0
                want = max(
                    by_regression(
                        normalized[begun : k + 1, b, row + j],
                        window,
                        baseline,
                        kind is GlrRamp,
                    )
                    for row in rows
                )
                want = want if visible[k, b, j] else 0.0
                assert verdict.statistic[b, j] == pytest.approx(want, rel=1e-9, abs=1e-9)


@pytest.mark.nojit
@pytest.mark.parametrize(("signals", "series"), [("pseudorange", 1), ("both", 2)])
def test_the_threshold_shares_the_false_alarms_among_all_tests(signals, series):
    detector = GlrStep(false_alarm=1e-4, window=20, signals=signals)
    detector.bind(context(1, N))
    visible = np.array([[True, True, False]])
    verdict = detector.judge(epoch(np.zeros((1, 2 * N)), np.eye(2 * N)[None], visible))
    want = scipy.stats.chi2.isf(1e-4 / (20 * series * 2), 1)
    np.testing.assert_allclose(verdict.threshold, want, rtol=1e-9)


@pytest.mark.parametrize("kind", [GlrStep, GlrRamp])
def test_alarms_are_not_more_frequent_than_stated(kind):
    receivers, channels, alpha = 2000, 2, 0.05
    rng = np.random.default_rng(1)
    detector = kind(false_alarm=alpha, window=20, baseline=40)
    detector.bind(context(receivers, channels))
    S = np.tile(np.eye(2 * channels), (receivers, 1, 1))
    for _ in range(80):
        alarms = detector.judge(epoch(rng.standard_normal((receivers, 2 * channels)), S)).alarm
    count = alarms.any(axis=1).sum()
    assert 0 < count <= scipy.stats.binom.isf(1e-4, receivers, alpha)


def alarms_of(detector, z):
    """(K, n) alarms of one receiver whose belief is the identity."""
    channels = z.shape[1]
    detector.bind(context(1, channels))
    S = np.eye(2 * channels)[None]
    return np.array(
        [detector.judge(epoch(np.concatenate([row, 0 * row])[None], S)).alarm[0] for row in z]
    )


@pytest.mark.parametrize("kind", [GlrStep, GlrRamp])
def test_a_bias_is_no_change_and_a_change_is_found(kind):
    z = np.random.default_rng(2).standard_normal((600, 5)) + np.array([0, 3, -30, 0.5, 1])
    since = np.maximum(0, np.arange(600) - 399)
    z[:, 1] += (since > 0) * 4.0 if kind is GlrStep else 0.1 * since
    alarms = alarms_of(kind(), z)
    assert not alarms[:400].any()
    assert not alarms[:, [0, 2, 3, 4]].any()
    assert np.argmax(alarms[400:, 1]) in (range(8) if kind is GlrStep else range(10, 60))
