"""The check of a verdict: every shipped detector passes it in one compiled call, in no time."""

from __future__ import annotations

import time

import numpy as np
import pytest

from spoofgym.detectors import DETECTORS, Ewma, make_detector
from spoofgym.detectors import base as verdicts
from spoofgym.detectors.base import check_verdict, judge_epoch
from spoofgym.receiver.epoch import Epoch
from spoofgym.testing.epochs import position_script, trying_script

SCRIPTS = {"satellites": trying_script, "position": lambda: position_script(2)}


def epoch_of(script, number, rows, needs):
    return Epoch(**script.epoch(number, rows, needs))


@pytest.mark.parametrize("name", DETECTORS)
def test_a_shipped_detector_needs_no_closer_look(name, monkeypatch):
    detector = make_detector(name)
    script = SCRIPTS["position" if detector.measures == "position" else "satellites"]()
    detector.bind(script.context)
    rows = np.arange(script.context.receivers)

    def examine(*args):
        raise AssertionError("this verdict is not of the usual form")

    monkeypatch.setattr(verdicts, "_examine", examine)
    for number in range(len(script.epochs)):
        judge_epoch(detector, epoch_of(script, number, rows, detector.needs))


def test_a_verdict_of_another_layout_is_sound_all_the_same():
    script, detector = trying_script(), Ewma()
    detector.bind(script.context)
    epoch = script.epochs[3]
    verdict = detector.judge(epoch)
    shape = verdict.threshold.shape
    by_columns = verdict._replace(
        statistic=np.asfortranarray(verdict.statistic), threshold=np.broadcast_to(4.0, shape)
    )
    assert check_verdict(by_columns, detector, epoch) is by_columns
    by_columns.statistic[2, 1] = np.nan
    with pytest.raises(ValueError, match=r"`statistic` .* got nan for receiver 2 of 5, column 1"):
        check_verdict(by_columns, detector, epoch)


def test_the_check_takes_less_than_a_microsecond_a_receiver():
    script, detector, receivers = trying_script(), Ewma(), 64
    detector.bind(script.context._replace(receivers=receivers))
    epoch = epoch_of(script, 3, np.arange(receivers) % 5, detector.needs)
    verdict = detector.judge(epoch)
    check_verdict(verdict, detector, epoch)
    took = []
    for _ in range(50):
        begun = time.perf_counter()
        for _ in range(100):
            check_verdict(verdict, detector, epoch)
        took.append((time.perf_counter() - begun) / (100 * receivers))
    assert min(took) < 1e-6
