"""Stretches of alarms."""

import math

import numpy as np
import pytest

from spoofgym.bench.runs.episode import alarm_intervals

pytestmark = pytest.mark.nojit


def of(text):
    alarm = np.array([letter == "x" for letter in text])
    return alarm_intervals(alarm, 0.5 * np.arange(len(text)))


def test_an_interval_is_from_the_first_alarm_to_the_first_epoch_without():
    assert of("..xx..") == [(1.0, 2.0)]
    assert of("......") == []
    assert of("x.x.x.") == [(0.0, 0.5), (1.0, 1.5), (2.0, 2.5)]


def test_what_is_not_over_has_no_end():
    assert of("x..xx") == [(0.0, 0.5), (1.5, math.inf)]
    assert of("xx") == [(0.0, math.inf)]
