"""ACNA against its own words, and the ends that its exclusions have."""

import numpy as np
import pytest

from spoofgym.detectors import Acna

from .positions import context, judge_drifts, told

pytestmark = pytest.mark.nojit

JUMP, SLOW = 1.5, 1.28
NAN = np.nan


def flowchart(drifts, n_j=2, n_s=5, jump=JUMP, slow=SLOW):
    """The paper's steps 4 to 7, word by word: whether each fix is believed."""
    flag, past, believed = 0, [], []
    for drift in drifts:
        flag = flag + 1 if drift > jump else 0
        past.append(drift)
        if flag >= n_j:
            believed.append(False)
            continue
        believed.append(sum(past[-n_s:]) / n_s < slow)
    return np.array(believed)


def test_literal_is_the_flowchart():
    rng = np.random.default_rng(0)
    drifts = np.abs(rng.normal(0.0, 1.2, (200, 40))) * rng.choice([0.3, 1.0, 3.0], (200, 40))
    _, alarm, weight = told(judge_drifts(Acna(variant="literal"), drifts))
    expected = np.stack([flowchart(column) for column in drifts.T], axis=1)
    assert 0.1 < expected.mean() < 0.9
    np.testing.assert_array_equal(alarm, ~expected)
    np.testing.assert_array_equal(weight, expected)


@pytest.mark.parametrize(("n_j", "n_s"), [(1, 9), (7, 1), (2, 3)])
def test_literal_is_the_flowchart_for_other_windows(n_j, n_s):
    rng = np.random.default_rng(n_j)
    drifts = np.abs(rng.normal(1.0, 1.0, 150))
    detector = Acna(variant="literal", jump_window=n_j, slow_window=n_s)
    _, alarm, _ = told(judge_drifts(detector, drifts))
    np.testing.assert_array_equal(alarm[:, 0], ~flowchart(drifts, n_j, n_s))


def test_a_rule_can_be_switched_off():
    drifts = [0.0, 9.0, 9.0, 9.0]
    only_jump = Acna(variant="literal", slow_threshold_m=None)
    assert told(judge_drifts(only_jump, drifts))[1][:, 0].tolist() == [False, False, True, True]
    only_slow = Acna(variant="literal", jump_threshold_m=None, slow_threshold_m=4.0)
    assert told(judge_drifts(only_slow, drifts))[1][:, 0].tolist() == [False, False, False, True]


def test_the_statistic_is_continuous_and_in_units_of_the_threshold():
    statistic, _, _ = told(judge_drifts(Acna(variant="literal"), [0.6, 1.2, 1.2]))
    expected = [0.6 / 5 / SLOW, 0.6 / JUMP, 1.2 / JUMP]
    np.testing.assert_allclose(statistic[:, 0], expected)


def test_a_large_jump_alarms_at_once_by_the_slow_rule_unless_drifts_are_capped():
    drifts = [0.3] * 6 + [28.0, 28.0]
    for variant, first in (("literal", 6), ("held", 7), ("production", 7)):
        _, alarm, _ = told(judge_drifts(Acna(variant=variant), drifts))
        assert alarm[:, 0].argmax() == first, variant


def test_a_pending_fix_is_held_back_and_a_false_point_forgiven():
    drifts = [0.3] * 6 + [28.0] + [0.3] * 6
    for variant in ("held", "production"):
        _, alarm, weight = told(judge_drifts(Acna(variant=variant), drifts))
        assert not alarm.any()
        assert weight[:, 0].tolist() == [1.0] * 6 + [0.0] + [1.0] * 6


def test_production_readmits_after_three_passes():
    drifts = [0.3] * 5 + [20.0] * 10 + [0.5, 9.0, 0.5, 0.5, 0.5, 0.2, 0.2]
    _, alarm, weight = told(judge_drifts(Acna(), drifts))
    believed = [True] * 5 + [False] * 14 + [True] * 3
    assert weight[:, 0].tolist() == [float(b) for b in believed]
    # the first fix of the jump is only pending
    assert alarm[:, 0].tolist() == [False] * 6 + [True] * 13 + [False] * 3


def test_the_readmission_threshold_widens_with_the_outage_up_to_its_cap():
    def readmitted(outage, drift, **settings):
        drifts = [0.3] * 5 + [30.0] * outage + [drift] * 3
        return told(judge_drifts(Acna(**settings), drifts))[2][-1, 0] == 1.0

    # at the first pass an outage of 50 s allows 1.28 + 0.08 * 50
    assert readmitted(50, 5.2)
    assert not readmitted(50, 5.4)
    assert not readmitted(10, 5.2)
    assert readmitted(200, 6.2)
    assert not readmitted(200, 6.4)
    assert not readmitted(50, 5.2, readmission_cap_m=1.0)


def test_an_exclusion_has_an_end_in_production():
    drifts = [0.3] * 5 + [30.0] * 80
    _, alarm, weight = told(judge_drifts(Acna(max_exclusion_s=60.0), drifts))
    assert weight[6:, 0].tolist().index(1.0) == 61  # the first fix after 60 s of alarms
    assert alarm[6:67, 0].all()
    _, alarm, weight = told(judge_drifts(Acna(max_exclusion_s=None), drifts))
    assert not weight[6:].any()
    assert alarm[6:].all()

    _, _, weight = told(judge_drifts(Acna(max_exclusion_s=10.0), drifts, interval_s=0.5))
    assert weight[6:, 0].tolist().index(1.0) == 21


def test_a_missing_fix_says_nothing():
    for variant in ("literal", "held", "production"):
        verdicts = judge_drifts(Acna(variant=variant), [0.4, NAN, 20.0, NAN, 20.0, NAN])
        statistic, alarm, weight = told(verdicts)
        missing = [1, 3, 5]
        assert not statistic[missing].any()
        assert not alarm[missing].any()
        assert (weight[missing] == 1.0).all()
        assert alarm[4, 0], variant  # the jump goes on where it was interrupted


def test_production_allows_for_the_drift_of_an_interruption():
    drifts = [0.3] * 5 + [NAN] * 40 + [3.5] + [0.3] * 5
    _, alarm, weight = told(judge_drifts(Acna(), drifts))
    assert not alarm.any()
    assert weight.all()
    _, alarm, _ = told(judge_drifts(Acna(variant="literal"), [0.3] * 5 + [NAN] * 40 + [3.5] * 2))
    assert alarm[-1, 0]


def test_a_drift_is_measured_in_all_coordinates():
    from .positions import epoch

    detector = Acna(variant="literal", jump_window=1)
    detector.bind(context(1))
    verdict = detector.judge(epoch(np.array([[13.0, -6.0]]), np.array([[10.0, -2.0]])))
    assert verdict.statistic[0, 0] == pytest.approx(5.0 / JUMP)
