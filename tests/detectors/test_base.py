"""What a detector reads, and what becomes of its verdict."""

import numpy as np
import pytest

from spoofgym.detectors import (
    DETECTORS,
    Detector,
    Ewma,
    Never,
    PooledDetector,
    Verdict,
    make_detector,
)
from spoofgym.detectors import base as verdicts
from spoofgym.detectors.base import UndeclaredFieldError, check_verdict, compare, judge_epoch
from spoofgym.receiver.epoch import OPTIONAL, Epoch, TracedEpoch
from spoofgym.testing import check_detector
from spoofgym.testing.detector import list_scripts
from spoofgym.testing.epochs import trying_script


def bound(detector, script):
    made = make_detector(detector)
    made.bind(script.context)
    return made


def epoch_of(script, number, needs):
    return Epoch(**script.epoch(number, np.arange(script.context.receivers), needs))


@pytest.mark.parametrize("name", DETECTORS)
def test_a_shipped_detector_reads_what_it_declares_and_needs_no_closer_look(name, monkeypatch):
    def examine(*args):
        raise AssertionError("this verdict is not of the usual form")

    monkeypatch.setattr(verdicts, "_examine", examine)
    read = set()
    for script in list_scripts(make_detector(name).measures):
        detector = bound(name, script)
        for number, epoch in enumerate(script.epochs):
            traced = TracedEpoch(*epoch)
            judge_epoch(detector, traced)
            read |= traced.read_fields
            judge_epoch(detector, epoch_of(script, number, detector.needs))
    assert read == detector.needs


class Forgetful(Detector):
    """Reads what it doesn't declare, and fails at it."""

    paper = "page1954"
    needs = frozenset({"design"})

    def bind(self, context):
        super().bind(context)

    def judge(self, epoch):
        size = np.abs(epoch.imu_delta).max(axis=1, keepdims=True) + epoch.design[:, :1, 0]
        return Verdict(size, np.full_like(size, 1e9), size > 1e9)


class Lenient(Forgetful):
    def judge(self, epoch):
        one = np.ones((len(epoch.time), 1))
        return Verdict(one if epoch.imu_delta is None else 2.0 * one, 3.0 * one, one > 3.0)


class Silent(Forgetful):
    """Makes NaN of it, which only the check of the verdict finds."""

    def judge(self, epoch):
        nothing = np.array(epoch.imu_delta, dtype=np.float64)
        size = np.full((len(epoch.time), 1), nothing if nothing.ndim == 0 else 1.0)
        return Verdict(size, np.ones_like(size), size > 9.0)


class Broken(Never):
    def judge(self, epoch):
        raise KeyError("of another kind")


LINE = r"write `needs = frozenset\({'design', 'imu_delta'}\)` into the class"
MESSAGES = {
    Forgetful: rf"Forgetful reads `epoch.imu_delta`, None here, without declaring it; {LINE}",
    Silent: rf"Silent reads `epoch.imu_delta`, None here, .*{LINE}",
    Lenient: rf"Lenient reads `epoch.imu_delta`, .*{LINE}",
}


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
def test_who_forgets_is_found_by_the_check_and_by_a_run_that_fails(kind):
    with pytest.raises(AssertionError, match=MESSAGES[kind]):
        check_detector(kind())
    script = trying_script()
    detector = bound(kind(), script)
    if kind is not Lenient:
        with pytest.raises(UndeclaredFieldError, match=MESSAGES[kind]) as caught:
            judge_epoch(detector, epoch_of(script, 3, detector.needs))
        assert caught.value.__cause__ is not None
    judge_epoch(detector, epoch_of(script, 3, OPTIONAL))  # where others need it, it is there


def test_other_failures_stay_what_they_are_and_the_member_of_a_pool_is_named():
    script, pool = trying_script(), PooledDetector([Forgetful(), "never"], [1.0, 0.0])
    with pytest.raises(KeyError, match="of another kind"):
        judge_epoch(bound(Broken(), script), epoch_of(script, 3, ()))
    with pytest.raises(UndeclaredFieldError, match=MESSAGES[Forgetful]):
        judge_epoch(bound(pool, script), epoch_of(script, 3, pool.needs))
    with pytest.raises(AssertionError, match="a setting of type Forgetful can't be written down"):
        check_detector(pool)


@pytest.mark.parametrize("needs", [frozenset({"designs", "design"}), {"design"}, None])
def test_needs_are_checked(needs):
    detector = Never()
    detector.needs = needs
    wrong = r"\['designs'\]" if isinstance(needs, frozenset) else ""
    message = rf"`Never.needs` must be a frozenset of optional .*weights\), got .*{wrong}"
    with pytest.raises(ValueError, match=message):
        detector.bind(trying_script().context)
    with pytest.raises(ValueError, match=message):
        PooledDetector([detector])
    with pytest.raises(AssertionError, match=message):
        check_detector(detector)


def test_a_verdict_of_another_layout_is_sound_all_the_same():
    script, detector = trying_script(), Ewma()
    detector.bind(script.context)
    epoch = script.epochs[3]
    verdict = detector.judge(epoch)
    by_columns = verdict._replace(
        statistic=np.asfortranarray(verdict.statistic),
        threshold=np.broadcast_to(4.0, verdict.threshold.shape),
    )
    assert check_verdict(by_columns, detector, epoch) is by_columns
    by_columns.statistic[2, 1] = np.nan
    with pytest.raises(ValueError, match=r"`statistic` .* got nan for receiver 2 of 5, column 1"):
        check_verdict(by_columns, detector, epoch)


class Thresholdless(Never):
    """Compares with a number of its own, not above 0."""

    def __init__(self, limit=0.0):
        self.limit = limit

    def judge(self, epoch):
        statistic = np.abs(epoch.innovation).max(axis=1, keepdims=True)
        return compare(statistic, self.limit)


@pytest.mark.parametrize("limit", [0.0, -1.0, np.inf, np.nan])
def test_a_threshold_is_above_0_since_a_calibration_multiplies_it(limit):
    script, detector = trying_script(), Thresholdless(limit)
    said = (
        r"Thresholdless, epoch at .* `threshold` must be finite and above 0, got .* for receiver 0"
    )
    with pytest.raises(ValueError, match=said):
        judge_epoch(bound(detector, script), epoch_of(script, 3, ()))
    with pytest.raises(AssertionError, match=said):
        check_detector(detector)
