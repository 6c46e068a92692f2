"""The joint chart: the EWMA chart's onset, and an end of its own."""

import numpy as np
import pytest

from spoofgym.detectors import Ewma, JointChart
from spoofgym.detectors.charts import compute_median_distance

from .support import belief, context, drawn, epoch

S1 = np.diag([4.0, 1.0])[None]
NOISE = 0.6


def run(detector, offsets, seed=0):
    """Verdicts on one channel whose innovations have offsets [m]."""
    rng = np.random.default_rng(seed)
    detector.bind(context(1, 1))
    z = np.asarray(offsets) + NOISE * rng.standard_normal(len(offsets))
    return [detector.judge(epoch(np.array([[x, 0.0]]), S1)) for x in z]


def alarms(detector, offsets, seed=0):
    return np.array([verdict.alarm[0, 0] for verdict in run(detector, offsets, seed)])


BURSTS = np.concatenate([np.zeros(40), np.full(60, 12.0), np.zeros(20), 0.3 * np.arange(60)])
ENDED = np.concatenate([BURSTS, np.zeros(40)])


@pytest.mark.parametrize("seed", range(4))
def test_its_alarm_begins_with_the_ewma_charts_and_ends_with_the_offset(seed):
    mine = alarms(JointChart(), ENDED, seed)
    ewma = alarms(Ewma(), ENDED, seed)
    assert mine.argmax() == ewma.argmax()
    edges = np.flatnonzero(np.diff(mine.astype(int)))
    assert len(edges) == 4
    assert edges[1] == 99  # the last epoch of the step
    assert edges[3] == 179  # of the ramp
    assert ewma[100:105].all()


def test_chart_and_time_index_begin_anew_at_the_end():
    verdicts = run(JointChart(), ENDED)
    for verdict in verdicts:
        np.testing.assert_array_equal(verdict.alarm, verdict.statistic > verdict.threshold)
    assert verdicts[99].alarm[0, 0]
    assert verdicts[100].statistic[0, 0] == 0.0
    fresh = run(JointChart(), np.zeros(5))
    got = [v.threshold[0, 0] for v in verdicts[101:106]]
    np.testing.assert_allclose(got, [v.threshold[0, 0] for v in fresh])
    assert verdicts[100].weights[0, 0] == 1.0


def test_until_its_first_end_it_says_what_the_ewma_chart_says():
    rng = np.random.default_rng(3)
    mine, ewma = JointChart(max_exclusion_s=None, min_satellites=0), Ewma()
    for detector in (mine, ewma):
        detector.bind(context(3, 4))
    for k in range(60):
        S = belief(rng, 3, 4)
        z = drawn(rng, S)
        z[:, 1] = 0.3 * (k + 1) + 0.1 * z[:, 1]
        a, b = (detector.judge(epoch(z, S)) for detector in (mine, ewma))
        for name in ("statistic", "threshold", "alarm", "weights"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_an_offset_that_only_grows_is_no_end():
    assert alarms(JointChart(), np.concatenate([np.zeros(20), np.arange(200.0)]))[40:].all()


def test_an_offset_that_fades_ends_with_the_chart():
    fading = np.concatenate([np.zeros(20), np.full(40, 12.0), np.linspace(12.0, 0.0, 200)])
    mine = alarms(JointChart(weight_scale=None), np.append(fading, np.zeros(30)))
    ewma = alarms(Ewma(weight_scale=None), np.append(fading, np.zeros(30)))
    np.testing.assert_array_equal(mine, ewma)


def test_the_printed_rule_ends_every_alarm_at_once():
    mine = alarms(
        JointChart(end_rule="literal"), np.concatenate([np.zeros(40), np.full(100, 12.0)])
    )
    runs = np.diff(np.flatnonzero(np.diff(np.concatenate([[0], mine.astype(int), [0]]))))[::2]
    assert len(runs) > 1
    assert set(runs) == {1}


def test_the_distance_from_the_median():
    rng = np.random.default_rng(0)
    for three in rng.standard_normal((50, 3)):
        want = np.abs(three - np.median(three)).max()
        assert compute_median_distance(*three) == pytest.approx(want, abs=1e-12)


def test_a_satellite_that_sets_while_it_alarms_begins_anew():
    detector = JointChart()
    detector.bind(context(1, 1))
    far = np.array([[12.0, 0.0]])
    for _ in range(30):
        verdict = detector.judge(epoch(far, S1))
    assert verdict.alarm[0, 0]
    verdict = detector.judge(epoch(far, S1, np.zeros((1, 1), dtype=bool)))
    assert not verdict.alarm.any()
    assert not detector.memory["spoofed"].any()
    assert not detector.memory["ratios"].any()
