"""Every score by its formula, on arrays made by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from spoofgym.bench.runs import record
from spoofgym.bench.scores import statistics
from spoofgym.bench.scores.scores import (
    by_chance,
    missed_in_time,
    score_stealth,
    survival,
    worst_skies,
)

pytestmark = pytest.mark.nojit


def test_every_epoch_is_in_one_part_of_the_stanford_diagram():
    level = np.array([[5.0, 5.0, 5.0, 15.0, np.inf, 5.0]]).T
    error = np.array([[5.0, 9.0, 11.0, 1.0, 99.0, 1.0]]).T
    found = record.count_stanford(error, level, np.array([[False] * 5 + [True]]).T, 10.0)
    expected = {"nominal": 1, "misleading": 1, "hazardous": 1, "unavailable": 3}
    assert {name: n.tolist() for name, n in found.items()} == {
        f"{name}_epochs": [n] for name, n in expected.items()
    }


def test_undetected_displacement_by_hand():
    # five epochs of errors, two epochs to alert
    error = np.array([[1.0, 3.0, 2.0, 5.0, 4.0]]).T
    first = [0, 7, 6, 5, 4, 3, 1]
    found = [record.undetected_displacement(error, [alarm], 2)[0] for alarm in first]
    assert found == [5.0, 5.0, 3.0, 3.0, 1.0, 0.0, 0.0]
    # what comes after the alarm may be unknown
    error = np.array([[1.0, 2.0, np.nan, np.nan]]).T
    assert record.undetected_displacement(error, [3], 1)[0] == 1.0


@given(
    error=st.lists(st.floats(0.0, 100.0), min_size=1, max_size=12),
    alarms=st.lists(st.booleans(), min_size=15, max_size=15),
    hold=st.integers(0, 3),
)
def test_undetected_displacement_is_what_its_definition_says(error, alarms, hold):
    alarm = np.array(alarms[: len(error) + hold])
    first = int(alarm.argmax()) + 1 if alarm.any() else 0
    # the largest error at k with no alarm in epochs 1 to k + hold
    expected = max([0.0] + [e for k, e in enumerate(error, start=1) if not alarm[: k + hold].any()])
    assert record.undetected_displacement(np.array(error)[:, None], [first], hold)[0] == expected


def test_a_run_counts_that_is_silent_before_the_onset_and_has_a_silent_twin():
    found = record.mask_valid_runs([False, True, False, True], [0, 0, 7, 7])
    np.testing.assert_array_equal(found, [True, False, False, False])
    np.testing.assert_array_equal(record.mask_valid_runs([False] * 2, [True, False]), [False, True])


def test_stealthy_displacement_is_over_the_runs_that_count():
    moved, alarm = [10.0, 20.0, 90.0, 30.0], [False, True, True, False]
    found = score_stealth(moved, alarm, [True, True, False, True])
    assert (found.runs, found.alarms, found.displacement_m) == (3, 1, 20.0)
    assert found.alarm_rate == 1.0 / 3.0
    assert found.seems_to_keep(0.34)
    assert not found.keeps(0.34)
    nothing = score_stealth(moved, alarm, np.zeros(4, dtype=bool))
    assert math.isnan(nothing.displacement_m)
    assert (nothing.alarm_limit, nothing.keeps(0.99), nothing.seems_to_keep(1.0)) == (1, 0, 0)


@pytest.mark.parametrize(("alarms", "runs"), [(0, 59), (0, 1), (3, 200), (39, 1024)])
def test_the_limit_of_an_alarm_rate_is_one_sided(alarms, runs):
    # as many alarms or fewer come by chance in one of twenty cases at the limit
    assert binom.cdf(alarms, runs, statistics.alarm_limit(alarms, runs)) == pytest.approx(0.05)


def test_what_runs_can_show_of_a_budget():
    assert statistics.fewest_runs(0.05) == 59
    assert statistics.keeps(0, 59, 0.05)
    assert not statistics.keeps(0, 58, 0.05)
    assert statistics.most_alarms(58, 0.05) == -1
    most = statistics.most_alarms(500, 0.05)
    assert statistics.keeps(most, 500, 0.05)
    assert not statistics.keeps(most + 1, 500, 0.05)
    assert statistics.aim(500, 0.05) == most / 500
    assert statistics.aim(10, 0.05) == pytest.approx(0.01)  # never far below
    assert statistics.alarm_limit(4, 4) == 1.0


@pytest.mark.parametrize(
    ("share", "expected"), [(0.5, 3.0), (0.25, 4.0), (0.05, 4.0), (1.0, 1.0), (0.51, 2.0)]
)
def test_the_displacement_that_is_reached_in_a_share_of_the_runs(share, expected):
    x = [2.0, 4.0, 1.0, 3.0]
    assert record.compute_upper_quantile(x, share) == expected
    assert np.mean(np.array(x) >= expected) >= share
    assert np.mean(np.array(x) > expected) < share


def test_the_worst_tenth_of_the_skies():
    sky = np.repeat(np.arange(20), 5)
    moved = np.where(np.isin(sky, (3, 17)), 9.0, 1.0)
    np.testing.assert_array_equal(worst_skies(moved, sky), [3, 17])
    assert worst_skies(moved[:45], sky[:45]) is None  # nine of them


def test_an_alarm_is_chance_where_the_twin_has_alarmed_by_then():
    first, twin = [5, 5, 5, 5, 0, 0], [0, 4, 5, 6, 3, 0]
    np.testing.assert_array_equal(by_chance(first, twin), [False, True, True, False, False, False])


def test_missed_is_no_alarm_in_time_after_the_crossing():
    first, crossing = [0, 12, 13, 8, 3], [10, 10, 10, 10, 0]
    # two epochs to alert; the last run never crosses the limit
    np.testing.assert_array_equal(missed_in_time(first, crossing, 2), [True, False, True, False])


def test_kaplan_meier_by_hand():
    # detected at 1 and 3, one run no longer watched at 2: S = 1, 2/3 from 1 on, 0 from 3 on
    found = survival([1.0, 2.0, 3.0], [True, False, True], [0.5, 1.0, 2.5, 3.0])
    np.testing.assert_allclose(found.share, [1.0, 2.0 / 3.0, 2.0 / 3.0, 0.0])
    np.testing.assert_array_equal(found.at_risk, [3, 3, 1, 1])
    assert (found.low <= found.share).all()
    assert (found.high >= found.share).all()
    # where nobody detected the horizon has Wilson's interval
    found = survival(np.full(20, 160.0), np.zeros(20, dtype=bool), [80.0, 160.0])
    np.testing.assert_array_equal(found.share, 1.0)
    np.testing.assert_allclose(found.low, 20 / (20 + 1.959963984540054**2))
    np.testing.assert_array_equal(found.high, 1.0)
