"""The likelihood-ratio scans against regressions, and biases."""

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import GlrRamp, GlrStep

from .support import belief, drawn, judge_all, normalized, padded

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
    rng, epochs = np.random.default_rng(0), 34
    S = belief(rng, N, epochs, B)
    z = drawn(rng, S)
    z[26:, :, 1] += 4.0
    visible = np.ones((epochs, B, N), dtype=bool)
    visible[16:18, 0, 2] = False
    detector = kind(window=window, baseline=baseline, signals=signals)
    found = judge_all(detector, z, S, visible)
    u = normalized(z, S)
    rows = {"pseudorange": [0], "range_rate": [N], "both": [0, N]}[signals]
    for k, b, j in np.ndindex(epochs, B, N):
        begun = 18 if (b, j) == (0, 2) and k >= 18 else 0
        seen = [u[begun : k + 1, b, row + j] for row in rows]
        want = max(by_regression(each, window, baseline, kind is GlrRamp) for each in seen)
        want *= visible[k, b, j]
        assert found.statistic[k, b, j] == pytest.approx(want, rel=1e-9, abs=1e-9)


@pytest.mark.nojit
@pytest.mark.parametrize(("signals", "series"), [("pseudorange", 1), ("both", 2)])
def test_the_threshold_shares_the_false_alarms_among_all_tests(signals, series):
    detector = GlrStep(false_alarm=1e-4, window=20, signals=signals)
    found = judge_all(detector, np.zeros((1, 1, 2 * N)), visible=[True, True, False])
    want = scipy.stats.chi2.isf(1e-4 / (20 * series * 2), 1)
    np.testing.assert_allclose(found.threshold, want, rtol=1e-9)


@pytest.mark.parametrize("kind", [GlrStep, GlrRamp])
def test_a_bias_is_no_change_and_a_change_is_found(kind):
    z = np.random.default_rng(2).standard_normal((600, 5)) + np.array([0, 3, -30, 0.5, 1])
    since = np.maximum(0, np.arange(600) - 399)
    z[:, 1] += (since > 0) * 4.0 if kind is GlrStep else 0.1 * since
    alarms = judge_all(kind(), padded(z)).alarm[:, 0]
    assert not alarms[:400].any()
    assert not np.delete(alarms, 1, axis=1).any()
    assert np.argmax(alarms[400:, 1]) in (range(8) if kind is GlrStep else range(10, 60))
