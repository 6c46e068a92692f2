"""Chi-square tests: of positions, with an estimated covariance, and of two sides."""

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import DetectorContext, SequentialChi2, SnapshotChi2, WindowedChi2
from spoofgym.detectors.chi_square import estimated_covariance_thresholds

from .support import belief, context, epoch, judge_all, judge_drifts, likely, stacked

B, N = 3, 4


def judge_positions(detector, z, S):
    """Verdicts on (K, B, 3) innovations of a receiver that measures a position."""
    receivers = z.shape[1]
    detector.bind(DetectorContext(receivers, 0, 0.1, np.ones(3), ()))
    blank = epoch(np.zeros((receivers, 0)), np.zeros((receivers, 0, 0)))
    design, S = np.tile(np.eye(3), (receivers, 1, 1)), np.tile(S, (receivers, 1, 1))
    blank = blank._replace(innovation_cov=S, design=design)
    return stacked([detector.judge(blank._replace(innovation=each)) for each in z])


def test_the_windows_sum_of_positions_has_three_degrees_an_epoch_once_it_is_full():
    rng = np.random.default_rng(0)
    S = belief(rng, 3)[:3, :3].copy()
    z = rng.standard_normal((12, B, 3))
    found = judge_positions(WindowedChi2(window=5, false_alarm=1e-3), z, S)
    assert not found.statistic[:4].any()
    assert not found.alarm[:4].any()
    q = np.einsum("kbi,ij,kbj->kb", z, np.linalg.inv(S), z)
    for k in range(4, 12):
        np.testing.assert_allclose(found.statistic[k, :, 0], q[k - 4 : k + 1].sum(axis=0))
    np.testing.assert_allclose(found.threshold[4:], scipy.stats.chi2.isf(1e-3, 15), rtol=1e-9)
    assert found.weights is None
    # a missing fix has no degrees of freedom
    drifts = [[1.0, 1.0], [np.nan, 1.0], [1.0, np.nan], [1.0, np.nan]]
    found = judge_drifts(WindowedChi2(window=3), drifts)
    np.testing.assert_allclose(found.statistic[-1, :, 0], [2.0, 1.0])
    np.testing.assert_allclose(found.threshold[-1, :, 0], scipy.stats.chi2.isf(1e-5, [4, 2]))
    estimated = WindowedChi2(window=3, covariance="estimated", covariance_window=20)
    alarms = judge_positions(estimated, np.full((30, 2, 3), 1e3), np.eye(3)).alarm[:, 0, 0]
    assert alarms.tolist() == [False] * 22 + [True] * 8


def test_thresholds_of_an_estimated_covariance_are_hotellings_and_keep_the_false_alarms():
    for w, want in ((20, 61.5), (30, 44.5), (50, 35.3), (100, 30.1)):
        threshold = estimated_covariance_thresholds(1e-5, 1, w, np.array([3.0]))[0]
        exact = 3.0 * w / (w - 2.0) * scipy.stats.f.isf(1e-5, 3, w - 2)
        assert threshold == pytest.approx(exact, rel=1e-9)
        assert threshold == pytest.approx(want, abs=0.06)
    rows = np.array([3.0, 30.0])
    limit = estimated_covariance_thresholds(1e-5, 10, 10**8, rows)
    np.testing.assert_allclose(limit, scipy.stats.chi2.isf(1e-5, rows), rtol=1e-5)
    rng, runs, alpha, n, w = np.random.default_rng(2), 20_000, 0.01, 5, 30
    x, z = rng.standard_normal((runs, w, 3)), rng.standard_normal((runs, n, 3))
    S = np.einsum("bwi,bwj->bij", x, x) / w
    q = np.einsum("bki,bij,bkj->b", z, np.linalg.inv(S), z)
    threshold = estimated_covariance_thresholds(alpha, n, w, np.array([3.0 * n]))[0]
    low, high = likely(runs, alpha)
    assert low <= (q > threshold).sum() <= high
    assert (q > scipy.stats.chi2.isf(alpha, 3 * n)).sum() > high


@pytest.mark.parametrize(
    ("settings", "channels", "said"),
    [
        ({"covariance": "estimated", "two_sided": True}, N, "`two_sided` takes a known covariance"),
        ({"signals": "pseudorange"}, 0, "`signals` must be 'both' for a receiver that measures"),
        (
            {"covariance": "estimated", "covariance_window": 11},
            N,
            "at least 12 for 8 innovations, got 11",
        ),
    ],
)
def test_what_the_receiver_cannot_give_is_refused(settings, channels, said):
    with pytest.raises(ValueError, match=said):
        WindowedChi2(**settings).bind(context(1, channels))


TWO_SIDED = {
    "snapshot": lambda **settings: SnapshotChi2(signals="both", **settings),
    "sequential": lambda **settings: SequentialChi2(window_s=5.0, signals="both", **settings),
    "windowed": lambda **settings: WindowedChi2(window=10, signals="both", **settings),
}


@pytest.mark.parametrize("kind", TWO_SIDED)
def test_each_side_alarms_as_often_as_stated_and_quiet_innovations_are_seen_by_two_alone(kind):
    receivers, made = 4000, TWO_SIDED[kind]
    z = np.random.default_rng(1).standard_normal((10, receivers, 2 * N))
    both = judge_all(made(false_alarm=0.1, two_sided=True), z)
    np.testing.assert_array_equal(both.threshold, 1.0)
    np.testing.assert_array_equal(both.alarm, both.statistic > 1.0)
    one = judge_all(made(false_alarm=0.05), z)
    last, large = both.alarm[-1, :, 0], one.alarm[-1, :, 0]
    assert last[large].all()
    for alarms, alpha in ((last, 0.1), (last & ~large, 0.05)):
        low, high = likely(receivers, alpha)
        assert low <= alarms.sum() <= high
    made, z = TWO_SIDED[kind], 0.3 * np.random.default_rng(1).standard_normal((20, 300, 2 * N))
    quiet = judge_all(made(false_alarm=1e-3, two_sided=True), z).alarm[-1]
    assert quiet.mean() > (0.4 if kind == "snapshot" else 0.99)
    assert not judge_all(made(false_alarm=1e-3), z).alarm.any()
    # without satellites nothing is too small
    unseen = judge_all(made(two_sided=True), z[:12, :2], visible=False)
    assert not unseen.statistic.any()
    if kind == "windowed":  # before it is full neither
        early = judge_all(made(two_sided=True), 1e-3 * z[:12])
        assert not early.statistic[:9].any()
        assert (early.statistic[9:] > 1.0).all()
