"""Spoofing intervals from alarms."""

import math

import numpy as np
import pytest

from spoofgym.bench.runs.episode import Interval, spoofing_intervals

pytestmark = pytest.mark.nojit


def of(text, **settings):
    alarm = np.array([letter == "x" for letter in text])[:, None, None]
    found = spoofing_intervals(alarm, 0.5 * np.arange(len(text)), **settings)
    return [(one.onset_s, one.end_s) for one in found]


def test_an_interval_is_from_the_first_alarm_to_the_first_epoch_without():
    assert of("..xx..") == [(1.0, 2.0)]
    assert of("......") == []
    assert of("x.x.x.") == [(0.0, 0.5), (1.0, 1.5), (2.0, 2.5)]


def test_what_is_not_over_has_no_end():
    assert of("x..xx") == [(0.0, 0.5), (1.5, math.inf)]
    assert of("xx") == [(0.0, math.inf)]


def test_short_gaps_can_be_bridged():
    assert of("xx.x..x...x", bridge_s=0.5) == [(0.0, 2.0), (3.0, 3.5), (5.0, math.inf)]
    assert of("xx.x..x...x", bridge_s=1.0) == [(0.0, 3.5), (5.0, math.inf)]
    assert of("xx.x..x...x", bridge_s=10.0) == [(0.0, math.inf)]


def test_receivers_and_channels_are_told_apart():
    alarm = np.zeros((4, 2, 3), dtype=bool)
    alarm[1:3, 0, 2] = True
    alarm[2:, 1, 0] = True
    found = spoofing_intervals(alarm, [10.0, 11.0, 12.5, 13.0])
    assert found == [Interval(0, 2, 11.0, 13.0), Interval(1, 0, 12.5, math.inf)]
    assert found[0].duration_s == 2.0
    assert math.isinf(found[1].duration_s)


def test_no_epochs_no_intervals():
    assert spoofing_intervals(np.zeros((0, 2, 3), dtype=bool), []) == []


def test_what_does_not_fit_is_refused():
    alarm = np.zeros((3, 1, 1), dtype=bool)
    with pytest.raises(ValueError, match=r"`alarm` must have shape \(K, B, c\)"):
        spoofing_intervals(alarm[:, :, 0], np.arange(3))
    with pytest.raises(ValueError, match=r"`time_s` shape \(K,\), got \(3, 1, 1\) and \(2,\)"):
        spoofing_intervals(alarm, np.arange(2))
    with pytest.raises(ValueError, match="`time_s` must increase"):
        spoofing_intervals(alarm, [0.0, 1.0, 1.0])
    with pytest.raises(ValueError, match="`bridge_s` must be >= 0, got -1"):
        spoofing_intervals(alarm, np.arange(3), bridge_s=-1.0)
