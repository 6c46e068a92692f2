"""RIO: a distance to dead reckoning, and a latch."""

import numpy as np
import pytest

from spoofgym.detectors import Rio

from .positions import context, epoch, judge_drifts, told

pytestmark = pytest.mark.nojit


def test_a_fix_beyond_the_limit_is_rejected_until_one_comes_near():
    _, alarm, weight = told(judge_drifts(Rio(), [1.0, 16.4, 16.6, 10.0, 5.1, 4.9, 16.4]))
    assert alarm[:, 0].tolist() == [False, False, True, True, True, False, False]
    np.testing.assert_array_equal(weight, 1.0 - alarm)


def test_it_looks_at_dead_reckoning_first_and_at_the_estimate_later():
    detector = Rio()
    detector.bind(context(1))
    near, far = np.array([[20.0, 0.0]]), np.array([[0.0, 0.0]])
    first = detector.judge(epoch(near, predicted=near, odometry=far))
    assert (first.statistic[0, 0], first.threshold[0, 0]) == (20.0, 16.5)
    assert first.alarm[0, 0]
    assert not first.weights.any()
    second = detector.judge(epoch(near, predicted=near, odometry=far))
    assert (second.statistic[0, 0], second.threshold[0, 0]) == (0.0, 5.0)
    assert not second.alarm[0, 0]


def test_a_missing_fix_changes_nothing():
    statistic, alarm, weight = told(judge_drifts(Rio(), [20.0, np.nan, 10.0, np.nan, 1.0]))
    assert alarm[:, 0].tolist() == [True, False, True, False, False]
    assert not statistic[[1, 3]].any()
    assert weight[:, 0].tolist() == [0.0, 1.0, 0.0, 1.0, 1.0]
