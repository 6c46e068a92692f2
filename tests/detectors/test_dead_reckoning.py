"""Detectors of positions: ACNA against its own words and the ends of its exclusions, and RIO."""

import numpy as np
import pytest

from spoofgym.detectors import Acna, Rio

from .support import fix_context, fix_epoch, judge_drifts

pytestmark = pytest.mark.nojit

JUMP, SLOW = 1.5, 1.28
NAN = np.nan
QUIET = [0.3] * 5


def judged(detector, drifts, **settings):
    """Alarms and first weights of one receiver, (K,) each."""
    found = judge_drifts(detector, drifts, **settings)
    return found.alarm[:, 0, 0], found.weights[:, 0, 0]


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


@pytest.mark.parametrize(("n_j", "n_s"), [(2, 5), (1, 9), (7, 1), (2, 3)])
def test_literal_is_the_flowchart(n_j, n_s):
    rng = np.random.default_rng(0)
    drifts = np.abs(rng.normal(0.0, 1.2, (40, 50))) * rng.choice([0.3, 1.0, 3.0], (40, 50))
    found = judge_drifts(Acna(variant="literal", jump_window=n_j, slow_window=n_s), drifts)
    expected = np.stack([flowchart(column, n_j, n_s) for column in drifts.T], axis=1)
    assert 0.1 < expected.mean() < 0.9
    np.testing.assert_array_equal(found.alarm[..., 0], ~expected)
    np.testing.assert_array_equal(found.weights[..., 0], expected)


def test_the_statistic_is_continuous_of_all_coordinates_and_a_rule_can_be_switched_off():
    found = judge_drifts(Acna(variant="literal"), [0.6, 1.2, 1.2])
    np.testing.assert_allclose(found.statistic.ravel(), [0.6 / 5 / SLOW, 0.6 / JUMP, 1.2 / JUMP])
    detector = Acna(variant="literal", jump_window=1)
    detector.bind(fix_context(1))
    verdict = detector.judge(fix_epoch(np.array([[13.0, -6.0]]), np.array([[10.0, -2.0]])))
    assert verdict.statistic[0, 0] == pytest.approx(5.0 / JUMP)
    drifts = [0.0, 9.0, 9.0, 9.0]
    only_jump = Acna(variant="literal", slow_threshold_m=None)
    assert judged(only_jump, drifts)[0].tolist() == [False, False, True, True]
    only_slow = Acna(variant="literal", jump_threshold_m=None, slow_threshold_m=4.0)
    assert judged(only_slow, drifts)[0].tolist() == [False, False, False, True]


@pytest.mark.parametrize("variant", ["literal", "held", "production"])
def test_a_jump_alarms_at_once_unless_drifts_are_capped_and_a_missing_fix_says_nothing(variant):
    alarm, _ = judged(Acna(variant=variant), [0.3] * 6 + [28.0, 28.0])
    assert alarm.argmax() == (6 if variant == "literal" else 7)  # literal by the slow rule
    if variant != "literal":  # a pending fix is held back, and a false point forgiven
        alarm, weight = judged(Acna(variant=variant), [0.3] * 6 + [28.0] + [0.3] * 6)
        assert not alarm.any()
        assert weight.tolist() == [1.0] * 6 + [0.0] + [1.0] * 6
    found = judge_drifts(Acna(variant=variant), [0.4, NAN, 20.0, NAN, 20.0, NAN])
    assert not found.statistic[1::2].any()
    assert not found.alarm[1::2].any()
    assert (found.weights[1::2] == 1.0).all()
    assert found.alarm[4]  # the jump goes on where it was interrupted


def test_production_readmits_after_three_passes():
    alarm, weight = judged(Acna(), QUIET + [20.0] * 10 + [0.5, 9.0, 0.5, 0.5, 0.5, 0.2, 0.2])
    assert weight.tolist() == [1.0] * 5 + [0.0] * 14 + [1.0] * 3
    # the first fix of the jump is only pending
    assert alarm.tolist() == [False] * 6 + [True] * 13 + [False] * 3


@pytest.mark.parametrize(
    ("outage", "drift", "settings", "readmitted"),
    [
        (50, 5.2, {}, True),  # at the first pass an outage of 50 s allows 1.28 + 0.08 * 50
        (50, 5.4, {}, False),
        (10, 5.2, {}, False),
        (200, 6.2, {}, True),
        (200, 6.4, {}, False),
        (50, 5.2, {"readmission_cap_m": 1.0}, False),
    ],
)
def test_the_readmission_threshold_widens_with_the_outage_up_to_its_cap(
    outage, drift, settings, readmitted
):
    _, weight = judged(Acna(**settings), QUIET + [30.0] * outage + [drift] * 3)
    assert weight[-1] == readmitted


def test_an_exclusion_has_an_end_in_production_and_an_interruption_may_drift():
    drifts = QUIET + [30.0] * 80
    alarm, weight = judged(Acna(max_exclusion_s=60.0), drifts)
    assert weight[6:].argmax() == 61  # the first fix after 60 s of alarms
    assert alarm[6:67].all()
    alarm, weight = judged(Acna(max_exclusion_s=None), drifts)
    assert not weight[6:].any()
    assert alarm[6:].all()
    _, weight = judged(Acna(max_exclusion_s=10.0), drifts, interval_s=0.5)
    assert weight[6:].argmax() == 21
    alarm, weight = judged(Acna(), QUIET + [NAN] * 40 + [3.5, *QUIET])
    assert not alarm.any()
    assert weight.all()
    assert judged(Acna(variant="literal"), QUIET + [NAN] * 40 + [3.5] * 2)[0][-1]


def test_rio_rejects_by_dead_reckoning_first_and_by_the_estimate_until_a_fix_comes_near():
    alarm, weight = judged(Rio(), [1.0, 16.4, 16.6, 10.0, 5.1, 4.9, 16.4])
    assert alarm.tolist() == [False, False, True, True, True, False, False]
    np.testing.assert_array_equal(weight, 1.0 - alarm)
    # a missing fix changes nothing
    found = judge_drifts(Rio(), [20.0, NAN, 10.0, NAN, 1.0])
    assert found.alarm.ravel().tolist() == [True, False, True, False, False]
    assert not found.statistic[[1, 3]].any()
    assert found.weights[:, 0, 0].tolist() == [0.0, 1.0, 0.0, 1.0, 1.0]
    detector = Rio()
    detector.bind(fix_context(1))
    near, far = np.array([[20.0, 0.0]]), np.array([[0.0, 0.0]])
    first, second = (detector.judge(fix_epoch(near, near, far)) for _ in range(2))
    assert (first.statistic[0, 0], first.threshold[0, 0]) == (20.0, 16.5)
    assert first.alarm[0, 0]
    assert not first.weights.any()
    assert (second.statistic[0, 0], second.threshold[0, 0]) == (0.0, 5.0)
    assert not second.alarm[0, 0]
