"""Detectors by name, and the one that never alarms."""

import numpy as np
import pytest

from spoofgym.detectors import Ewma, Never, make_detector

from .support import belief, context, epoch


def test_settings_and_copies():
    assert make_detector({"name": "ewma", "smoothing": 0.3}) == Ewma(smoothing=0.3)
    mine = Ewma(smoothing=0.3)
    assert make_detector(mine) == mine
    assert make_detector(mine) is not mine
    with pytest.raises(ValueError, match="detector 'ewma' has no setting 'lambda'; valid: smooth"):
        make_detector({"name": "ewma", "lambda": 0.1})


def test_without_a_defence_nothing_alarms():
    detector = Never()
    detector.bind(context(3, 4))
    verdict = detector.judge(epoch(np.full((3, 8), 1e9), belief(np.random.default_rng(0), 3, 4)))
    assert not verdict.alarm.any()
    assert not verdict.statistic.any()
    assert verdict.weights is None
