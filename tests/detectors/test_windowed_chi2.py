"""The windowed test: its sum, its degrees of freedom, its two thresholds, its false alarms."""

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import DetectorContext, WindowedChi2
from spoofgym.detectors.chi_square import estimated_covariance_thresholds

from .positions import judge_drifts
from .support import belief, context, drawn, epoch

N = 4


def position_context(receivers):
    return DetectorContext(receivers, 0, 0.1, np.ones(3), ())


def position_epoch(z, S):
    """Epoch of a receiver that measures a position."""
    b = len(z)
    empty = epoch(np.zeros((b, 0)), np.zeros((b, 0, 0)))
    return empty._replace(innovation=z, innovation_cov=S, design=np.tile(np.eye(3), (b, 1, 1)))


def judge_all(detector, z, S):
    """Verdicts on the epochs of (K, B, 3) innovations."""
    detector.bind(position_context(z.shape[1]))
    return [detector.judge(position_epoch(z[k], S)) for k in range(len(z))]


def test_the_sum_over_the_window_against_three_degrees_an_epoch():
    rng = np.random.default_rng(0)
    S = belief(rng, 3, 3)[:, :3, :3].copy()
    z = rng.standard_normal((12, 3, 3))
    verdicts = judge_all(WindowedChi2(window=5, false_alarm=1e-3), z, S)
    q = np.einsum("kbi,bij,kbj->kb", z, np.linalg.inv(S), z)
    for k, verdict in enumerate(verdicts):
        if k < 4:
            assert not verdict.statistic.any()
            assert not verdict.alarm.any()
            continue
        np.testing.assert_allclose(verdict.statistic[:, 0], q[k - 4 : k + 1].sum(axis=0))
        np.testing.assert_allclose(verdict.threshold, scipy.stats.chi2.isf(1e-3, 15), rtol=1e-9)
        assert verdict.weights is None


@pytest.mark.parametrize(("signals", "each"), [("both", 2), ("pseudorange", 1), ("range_rate", 1)])
def test_every_satellite_of_the_window_counts(signals, each):
    detector = WindowedChi2(window=2, signals=signals)
    detector.bind(context(1, N))
    S = np.eye(2 * N)[None]
    for visible in (0, 4, 1, 0, 0):
        seen = np.arange(N)[None] < visible
        verdict = detector.judge(epoch(np.ones((1, 2 * N)), S, seen))
        total = detector.memory["past_rows"].sum()
        want = scipy.stats.chi2.isf(1e-5, max(total, 1))
        np.testing.assert_allclose(verdict.threshold, want, rtol=1e-9)
        if detector.memory["seen"][0] > 1:
            assert verdict.statistic == total
    assert total == 0
    assert each in (1, 2)


def test_a_window_longer_than_the_run_never_judges():
    z = np.full((50, 2, 3), 1e3)
    for verdict in judge_all(WindowedChi2(window=51), z, np.tile(np.eye(3), (2, 1, 1))):
        assert not verdict.statistic.any()
        assert not verdict.alarm.any()
    assert judge_all(WindowedChi2(window=50), z, np.tile(np.eye(3), (2, 1, 1)))[-1].alarm.all()


def test_a_missing_fix_has_no_degrees_of_freedom():
    detector = WindowedChi2(window=3)
    verdict = judge_drifts(detector, [[1.0, 1.0], [np.nan, 1.0], [1.0, np.nan], [1.0, np.nan]])[-1]
    np.testing.assert_allclose(verdict.statistic[:, 0], [2.0, 1.0])
    np.testing.assert_allclose(verdict.threshold[:, 0], scipy.stats.chi2.isf(1e-5, [4, 2]))


def test_an_estimated_covariance_has_a_window_to_fill_as_well():
    z = np.full((30, 1, 3), 1e3)
    detector = WindowedChi2(window=3, covariance="estimated", covariance_window=20)
    alarms = [v.alarm[0, 0] for v in judge_all(detector, z, np.eye(3)[None])]
    assert alarms == [False] * 22 + [True] * 8


def test_one_epoch_with_an_estimated_covariance_is_hotelling_s_test():
    for w, want in ((20, 61.5), (30, 44.5), (50, 35.3), (100, 30.1)):
        threshold = estimated_covariance_thresholds(1e-5, 1, w, np.array([3.0]))[0]
        exact = 3.0 * w / (w - 2.0) * scipy.stats.f.isf(1e-5, 3, w - 2)
        assert threshold == pytest.approx(exact, rel=1e-9)
        assert threshold == pytest.approx(want, abs=0.06)


def test_a_known_covariance_is_the_limit_of_an_estimated_one():
    rows = np.array([3.0, 30.0])
    limit = estimated_covariance_thresholds(1e-5, 10, 10**8, rows)
    np.testing.assert_allclose(limit, scipy.stats.chi2.isf(1e-5, rows), rtol=1e-5)


@pytest.mark.parametrize(("n", "w"), [(1, 20), (5, 30), (10, 100)])
def test_the_estimated_threshold_keeps_the_false_alarms_of_a_sampled_covariance(n, w):
    rng, runs, alpha = np.random.default_rng(2), 20_000, 0.01
    x, z = rng.standard_normal((runs, w, 3)), rng.standard_normal((runs, n, 3))
    S = np.einsum("bwi,bwj->bij", x, x) / w
    q = np.einsum("bki,bij,bkj->b", z, np.linalg.inv(S), z)
    threshold = estimated_covariance_thresholds(alpha, n, w, np.array([3.0 * n]))[0]
    low, high = scipy.stats.binom.ppf([1e-4, 1.0 - 1e-4], runs, alpha)
    assert low <= (q > threshold).sum() <= high
    assert (q > scipy.stats.chi2.isf(alpha, 3 * n)).sum() > high


@pytest.mark.parametrize("window", [1, 7])
@pytest.mark.parametrize("measures", ["satellites", "position"])
def test_where_the_belief_is_right_alarms_are_as_rare_as_stated(measures, window):
    rng, alpha, receivers = np.random.default_rng(3), 0.02, 400
    detector = WindowedChi2(window=window, false_alarm=alpha)
    at = context(receivers, N) if measures == "satellites" else position_context(receivers)
    detector.bind(at)
    alarms, judged = 0, 0
    for k in range(10 * window):
        S = belief(rng, receivers, N)
        if measures == "position":
            S = S[:, :3, :3].copy()
            made = position_epoch(drawn(rng, S), S)
        else:
            visible = rng.uniform(size=(receivers, N)) < 0.8
            made = epoch(drawn(rng, S), S, visible)
        verdict = detector.judge(made)
        if k % window == window - 1:  # windows that do not overlap are independent
            alarms += verdict.alarm.sum()
            judged += receivers
    low, high = scipy.stats.binom.ppf([1e-4, 1.0 - 1e-4], judged, alpha)
    assert low <= alarms <= high


def test_what_the_receiver_cannot_give_is_refused():
    with pytest.raises(ValueError, match="`signals` must be 'both' for a receiver that measures"):
        WindowedChi2(signals="pseudorange").bind(position_context(1))
    short = WindowedChi2(covariance="estimated", covariance_window=6)
    with pytest.raises(
        ValueError, match="`covariance_window` must be at least 7 for 3 rows, got 6"
    ):
        short.bind(position_context(1))
