"""Charts of single satellites: printed ones, weights, the end of an alarm, and of an exclusion."""

import math

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import Ewma, JointChart, Shewhart
from spoofgym.detectors.charts import compute_median_distance

from .support import belief, context, drawn, judge_all, padded

B, N, K = 3, 5, 80


def plain(innovations, variances, visible, smoothing, alpha, scale):
    """EWMA chart of one channel as it is printed, (K,) each: size, threshold, weight."""
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
def test_the_ewma_chart_is_the_printed_one_whether_it_weighs_or_watches(smoothing, alpha, scale):
    rng = np.random.default_rng(0)
    S = belief(rng, N, K, B)
    z = drawn(rng, S)
    z[40:, :, 1] += 5.0
    visible = rng.uniform(size=(K, B, N)) < 0.9
    visible[:20, :, 3] = False  # rises
    settings = {"smoothing": smoothing, "false_alarm": alpha}
    found = judge_all(Ewma(**settings, weight_scale=scale), z, S, visible)
    for b in range(B):
        for j in range(N):
            size, threshold, weight = plain(
                z[:, b, j], S[:, b, j, j], visible[:, b, j], smoothing, alpha, scale
            )
            np.testing.assert_allclose(found.statistic[:, b, j], size, rtol=1e-10, atol=1e-12)
            np.testing.assert_allclose(found.threshold[:, b, j], threshold, rtol=1e-12)
            np.testing.assert_allclose(found.weights[:, b, j], weight, rtol=1e-8, atol=1e-10)
    np.testing.assert_array_equal(found.alarm, found.statistic > found.threshold)
    np.testing.assert_array_equal(found.weights[:, :, N:], 1.0)  # range rates are not weighed
    watches = judge_all(Ewma(**settings, weight_scale=None), z, S, visible)
    assert watches.weights is None
    np.testing.assert_array_equal(watches.statistic, found.statistic)
    np.testing.assert_array_equal(watches.alarm, found.alarm)


def test_shewharts_chart_weighs_pseudoranges_down_where_it_is_told_to():
    z = np.zeros((1, 1, 2 * N))
    z[..., :3], z[..., N] = [1.0, 1.8, 4.0], 9.0
    alpha = 2.0 * scipy.stats.norm.sf(5.0)
    found = judge_all(Shewhart(false_alarm=alpha, weight_scale=0.5, min_satellites=0), z)
    # full weight up to 1.25, none from 2.5 on
    want = [1.0, 1.25 / 1.8 * (0.7 / 1.25) ** 2, 0.0, *np.ones(2 * N - 3)]
    np.testing.assert_allclose(found.weights[0, 0], want)


# --- the joint chart -----------------------------------------------------------------------------

ENDED = np.repeat([0.0, 12.0, 0.0, 0.0, 0.0], [40, 60, 20, 60, 40])
ENDED[120:180] = 0.3 * np.arange(60)
"""Offsets of a step, and of a ramp."""


def run(detector, offsets, seed=0, visible=True):
    noise = 0.6 * np.random.default_rng(seed).standard_normal(len(offsets))
    z = padded((offsets + noise)[:, None])
    return judge_all(detector, z, np.diag([4.0, 1.0]), visible)


@pytest.mark.parametrize("seed", range(2))
def test_the_joint_charts_alarm_begins_with_the_ewma_charts_and_ends_with_the_offset(seed):
    found = run(JointChart(), ENDED, seed)
    mine, ewma = found.alarm.ravel(), run(Ewma(), ENDED, seed).alarm.ravel()
    assert mine.argmax() == ewma.argmax()
    edges = np.flatnonzero(np.diff(mine.astype(int)))
    assert len(edges) == 4
    assert (edges[1], edges[3]) == (99, 179)  # the last epochs of the step and of the ramp
    assert ewma[100:105].all()
    np.testing.assert_array_equal(found.alarm, found.statistic > found.threshold)
    # chart and time index begin anew
    assert (found.statistic[100], found.weights[100, 0, 0]) == (0.0, 1.0)
    fresh = run(JointChart(), np.zeros(5))
    np.testing.assert_allclose(found.threshold[101:106], fresh.threshold)


def test_until_its_first_end_the_joint_chart_is_the_ewma_chart_and_growing_is_no_end():
    rng = np.random.default_rng(3)
    S = belief(rng, 4, 60, 3)
    z = drawn(rng, S)
    z[..., 1] = 0.3 * np.arange(1, 61)[:, None] + 0.1 * z[..., 1]
    mine = judge_all(JointChart(max_exclusion_s=None, min_satellites=0), z, S)
    for one, other in zip(mine, judge_all(Ewma(), z, S), strict=True):
        np.testing.assert_array_equal(one, other)
    assert run(JointChart(), np.append(np.zeros(20), np.arange(200.0))).alarm[40:].all()
    fading = np.concatenate([np.zeros(20), np.full(40, 12.0), np.linspace(12.0, 0.0, 200)])
    fading = np.append(fading, np.zeros(30))
    np.testing.assert_array_equal(run(JointChart(), fading).alarm, run(Ewma(), fading).alarm)
    literal = run(JointChart(end_rule="literal"), np.append(np.zeros(40), np.full(100, 12.0)))
    edges = np.flatnonzero(np.diff(literal.alarm.ravel().astype(int), prepend=0, append=0))
    assert len(edges) > 2
    assert set(np.diff(edges)[::2]) == {1}


def test_the_distance_from_the_median():
    for three in np.random.default_rng(0).standard_normal((50, 3)):
        want = np.abs(three - np.median(three)).max()
        assert compute_median_distance(*three) == pytest.approx(want, abs=1e-12)


def test_a_satellite_that_sets_while_it_alarms_begins_anew():
    detector = JointChart()
    found = run(detector, np.full(31, 12.0), visible=np.arange(31)[:, None, None] < 30)
    assert found.alarm[29]
    assert not found.alarm[30]
    assert not detector.memory["spoofed"].any()
    assert not detector.memory["ratios"].any()


# --- nobody is locked out for good, and not everybody at once ------------------------------------

S6 = np.diag(np.repeat([4.0, 1.0], 6))
KINDS = [
    Ewma(max_exclusion_s=10.0, min_satellites=0),
    JointChart(max_exclusion_s=10.0, min_satellites=0),
    Shewhart(weight_scale=0.3, max_exclusion_s=10.0, min_satellites=0),
]


def weights(detector, ratios, epochs):
    """(K, 6) weights of pseudoranges that stay at these parts of the threshold."""
    settled = judge_all(detector, np.zeros((60, 1, 12)), S6).threshold[-1, 0, 0]
    z = padded(np.tile(settled * np.asarray(ratios), (epochs, 1)))
    return judge_all(detector, z, S6).weights[:, 0, :6]


@pytest.mark.parametrize("detector", KINDS, ids=lambda d: type(d).__name__)
def test_an_exclusion_ends_after_the_maximum_time_or_with_its_alarm(detector):
    found = weights(detector, [0, 0, 0.7, 0, 0, 0], 120)  # beyond m T = 0.3 T, and no alarm
    out = np.flatnonzero(found[:, 2] == 0.0)
    assert len(out) == 20  # 10 s
    assert np.all(np.diff(out) == 1)
    assert np.all(found[out[-1] + 1 :, 2] == 1.0)
    assert np.all(np.delete(found, 2, axis=1) == 1.0)
    assert np.all(weights(detector, [0, 0, 3.0, 0, 0, 0], 60)[1:, 2] == 0.0)


@pytest.mark.parametrize("kind", [Ewma, JointChart])
def test_the_satellites_that_deviate_least_are_kept(kind):
    ratios = np.array([6.0, 3.0, 8.0, 4.0, 5.0, 7.0])
    found = weights(kind(max_exclusion_s=None, min_satellites=4), ratios, 60)[-1]
    np.testing.assert_array_equal(found == 1.0, ratios <= 6.0)


def test_exclusions_are_counted_where_limited_and_no_more_readmitted_than_there_are():
    assert (weights(JointChart(min_satellites=32), [3.0] * 6, 5) == 1.0).all()
    for detector in (Ewma(), JointChart(max_exclusion_s=None, min_satellites=0)):
        assert (weights(detector, [0.7] * 6, 200)[20:] == 0.0).all()
    limits = {"max_exclusion_s": 10.0}, {"min_satellites": 4}
    for settings in ({}, *limits, {**limits[1], "weight_scale": None}):  # the last has no weights
        detector = Ewma(**settings)
        detector.bind(context(B, N))
        assert ("excluded" in detector.memory) == (settings in limits)
