"""Two-sided tests: alarms for innovations that are too small, as rare as stated."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import SequentialChi2, SnapshotChi2, WindowedChi2
from spoofgym.detectors.innovation import chi2_lower_thresholds

from .support import context, drawn, epoch

N = 5
KINDS = {
    "snapshot": lambda **settings: SnapshotChi2(**settings),
    "sequential": lambda **settings: SequentialChi2(window_s=5.0, **settings),
    "windowed": lambda **settings: WindowedChi2(window=10, **settings),
}


def ratios(detector, receivers, epochs, scale, seed=1):
    """(K, B) statistics of unit innovations times `scale`."""
    rng, found = np.random.default_rng(seed), []
    detector.bind(context(receivers, N))
    S = np.tile(np.eye(2 * N), (receivers, 1, 1))
    for _ in range(epochs):
        verdict = detector.judge(epoch(scale * drawn(rng, S), S))
        np.testing.assert_array_equal(verdict.threshold, 1.0)
        np.testing.assert_array_equal(verdict.alarm, verdict.statistic > 1.0)
        found.append(verdict.statistic[:, 0])
    return np.array(found)


def test_lower_limits_are_those_of_chi_square():
    degrees = np.arange(1.0, 200.0)
    for alpha in (0.1, 1e-5, 1e-12):
        want = scipy.stats.chi2.ppf(alpha, degrees)
        np.testing.assert_allclose(chi2_lower_thresholds(alpha, degrees), want, rtol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_where_the_belief_is_right_each_side_alarms_as_often_as_stated(kind):
    detector = KINDS[kind](false_alarm=0.1, signals="both", two_sided=True)
    last = ratios(detector, 4000, 10, 1.0)[-1]  # receivers are independent, epochs are not
    low, high = scipy.stats.binom.ppf([1e-4, 1.0 - 1e-4], 4000, 0.1)
    assert low <= (last > 1.0).sum() <= high
    one = KINDS[kind](false_alarm=0.05, signals="both")
    one.bind(context(4000, N))
    rng = np.random.default_rng(1)
    S = np.tile(np.eye(2 * N), (4000, 1, 1))
    for _ in range(10):
        verdict = one.judge(epoch(drawn(rng, S), S))
    large = verdict.alarm[:, 0]
    assert (last[large] > 1.0).all()  # the side of too large ones is the one-sided test of half
    small = (last > 1.0) & ~large
    low, high = scipy.stats.binom.ppf([1e-4, 1.0 - 1e-4], 4000, 0.05)
    assert low <= small.sum() <= high


@pytest.mark.parametrize("kind", KINDS)
def test_quiet_innovations_are_seen_by_two_sides_and_never_by_one(kind):
    quiet = ratios(KINDS[kind](false_alarm=1e-3, signals="both", two_sided=True), 300, 20, 0.3)
    assert (quiet[-1] > 1.0).mean() > (0.4 if kind == "snapshot" else 0.99)
    one = KINDS[kind](false_alarm=1e-3, signals="both")
    one.bind(context(300, N))
    S = np.tile(np.eye(2 * N), (300, 1, 1))
    rng = np.random.default_rng(1)
    for _ in range(20):
        assert not one.judge(epoch(0.3 * drawn(rng, S), S)).alarm.any()


@pytest.mark.parametrize("kind", KINDS)
def test_without_satellites_nothing_is_too_small(kind):
    detector = KINDS[kind](two_sided=True)
    detector.bind(context(2, N))
    S = np.tile(np.eye(2 * N), (2, 1, 1))
    for _ in range(12):
        verdict = detector.judge(epoch(np.zeros((2, 2 * N)), S, np.zeros((2, N), dtype=bool)))
        assert not verdict.statistic.any()


def test_a_window_is_full_and_its_covariance_known_before_anything_is_too_small():
    quiet = ratios(KINDS["windowed"](two_sided=True), 3, 12, 1e-3)
    assert not quiet[:9].any()
    assert (quiet[9:] > 1.0).all()
    with pytest.raises(ValueError, match="`two_sided` takes a known covariance, got `covariance`"):
        WindowedChi2(covariance="estimated", two_sided=True)
