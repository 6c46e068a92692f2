"""The control chart against a plain one, its false-alarm rate, and its settling time."""

import math

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import Ewma

from .support import belief, context, drawn, epoch

B, N, K = 3, 5, 80


def plain(innovations, variances, visible, smoothing, alpha, scale):
    """Chart of one channel as it is printed, (K,) each: size, threshold, weight."""
    z = scipy.stats.norm.isf(alpha / 2.0)
    mean, count, out = 0.0, 0, []
    for x, variance, seen in zip(innovations, variances, visible, strict=True):
        if not seen:  # a satellite that sets begins anew
            mean, count = 0.0, 0
        else:
            count += 1
            mean = smoothing * x + (1.0 - smoothing) * mean
        k = max(count, 1)
        spread = smoothing / (2.0 - smoothing) * (1.0 - (1.0 - smoothing) ** (2 * k))
        threshold = z * math.sqrt((variance if seen else 1.0) * spread)
        reject, size = scale * threshold, abs(mean)
        accept = reject / 2.0
        weight = 1.0
        if size > reject:
            weight = 0.0
        elif size > accept:
            weight = accept / size * ((reject - size) / (reject - accept)) ** 2
        out.append((size, threshold, weight))
    return np.array(out).T


@pytest.mark.parametrize(
    ("smoothing", "alpha", "scale"), [(0.1, 1e-5, 0.3), (0.5, 1e-3, 1.0), (1.0, 0.01, 0.1)]
)
def test_the_chart_is_the_printed_one(smoothing, alpha, scale):
    rng = np.random.default_rng(0)
    S = np.array([belief(rng, B, N) for _ in range(K)])
    z = np.array([drawn(rng, S[k]) for k in range(K)])
    z[40:, :, 1] += 5.0
    visible = rng.uniform(size=(K, B, N)) < 0.9
    visible[:20, :, 3] = False  # rises
    detector = Ewma(smoothing=smoothing, false_alarm=alpha, weight_scale=scale)
    detector.bind(context(B, N))
    verdicts = [detector.judge(epoch(z[k], S[k], visible[k])) for k in range(K)]
    for b in range(B):
        for j in range(N):
            size, threshold, weight = plain(
                z[:, b, j], S[:, b, j, j], visible[:, b, j], smoothing, alpha, scale
            )
            got = [np.array([getattr(v, name)[b, j] for v in verdicts]) for name in v_names]
            np.testing.assert_allclose(got[0], size, rtol=1e-10, atol=1e-12)
            np.testing.assert_allclose(got[1], threshold, rtol=1e-12)
            np.testing.assert_allclose(got[2], weight, rtol=1e-8, atol=1e-10)
            np.testing.assert_array_equal(got[3], got[0] > got[1])
    for verdict in verdicts:
        np.testing.assert_array_equal(verdict.weights[:, N:], 1.0)  # range rates are not weighed


v_names = ("statistic", "threshold", "weights", "alarm")


def test_a_chart_that_only_watches_says_the_same_without_weights():
    rng = np.random.default_rng(1)
    charts = [Ewma(), Ewma(weight_scale=None)]
    for chart in charts:
        chart.bind(context(B, N))
    for _ in range(10):
        S = belief(rng, B, N)
        seen = epoch(drawn(rng, S), S)
        defends, watches = (chart.judge(seen) for chart in charts)
        assert watches.weights is None
        np.testing.assert_array_equal(watches.statistic, defends.statistic)
        np.testing.assert_array_equal(watches.alarm, defends.alarm)


@pytest.mark.parametrize(("epochs", "smoothing"), [(1, 0.1), (4, 0.6), (30, 0.1)])
def test_where_the_belief_is_right_alarms_are_as_rare_as_stated(epochs, smoothing):
    """At every epoch, from the first on: the threshold widens as the average does."""
    receivers, alpha = 10_000, 0.01
    rng = np.random.default_rng(epochs)
    chart = Ewma(smoothing=smoothing, false_alarm=alpha, weight_scale=None)
    chart.bind(context(receivers, 1))
    S = np.tile(np.diag([4.0, 1.0]), (receivers, 1, 1))
    for _ in range(epochs):
        alarms = chart.judge(epoch(drawn(rng, S), S)).alarm
    low, high = scipy.stats.binom.ppf([1e-4, 1.0 - 1e-4], receivers, alpha)
    assert low <= alarms.sum() <= high
