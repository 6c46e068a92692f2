"""Scores of detectors: the worst family counts, runs are paired, and finished parts are kept."""

import json
from dataclasses import replace

import numpy as np
import pytest
from onnx import numpy_helper

from spoofgym.bench.experiments import audit_worlds as module
from spoofgym.bench.experiments.audit import Auditor
from spoofgym.bench.runs.record import MEASURES
from spoofgym.bench.scores.detector import CLEAN, WINDOW
from spoofgym.tasks import EVENTS

from ..detectors.learned.files import write_guard
from ..nightly import heavy
from .detector_support import NOMINAL, small_task

CHI2 = {"name": "snapshot-chi2", "signals": "range_rate"}
TEST = {**CHI2, **NOMINAL}
WEIGHING = {"name": "ewma", "smoothing": 0.1, "weight_scale": 0.3, **NOMINAL}
FAMILIES = ("ramps", "subset", "meaconer", "turn")


def judge_of(runs, selection_runs, families, **more):
    sizes = {"runs": runs, "selection_runs": selection_runs, "families": families, "threads": 1}
    return Auditor(small_task(), **{"entropy": 0, **sizes, **more})


@pytest.fixture(scope="module")
def scores():
    judges = {
        "never": "never",
        "lottery": {"name": "lottery", "mean_wait_s": 500.0},
        "test": TEST,
        "loose": {**CHI2, "threshold_scale": 3.0},
        "weighing": WEIGHING,
    }
    return dict(zip(judges, judge_of(24, 12, FAMILIES).scores([*judges.values()]), strict=True))


def test_without_a_defence_every_attack_is_hazardous_and_look_alikes_are_false_alarms(scores):
    never, lottery = scores["never"], scores["lottery"]
    assert (never.p_hmi.value, never.worst.counted) == (1.0, 24)
    assert [each.family for each in never.families] == list(FAMILIES)
    assert not never.false_alarms[WINDOW].any()
    for family in ((), *((name,) for name in FAMILIES)):
        gap = lottery.difference_to(never, *family)
        assert gap.low <= 0.0 <= gap.high
    assert lottery.false_alarms[CLEAN].any()  # it does alarm
    assert lottery.worst.counted < 24
    score = scores["weighing"]
    assert {score.false_alarms[event].shape for event in EVENTS} == {(24,)}
    # a step of the clock is not in the error model of a test of single channels
    assert score.false_alarm_rate("clock_step").value > score.false_alarm_rate(CLEAN).value
    assert (score.false_alarms[CLEAN] >= score.false_alarms[WINDOW]).all()


def test_the_worst_family_counts_and_differences_are_paired_and_signed(scores):
    for score in scores.values():
        by_family = [each.p_hmi.value for each in score.families]
        assert score.p_hmi.value == max(by_family) == score.worst.p_hmi.value
        for share in (0.5, 0.05):
            each = [family.estimate_quantile(share) for family in score.families]
            whole = score.estimate_quantile(share)
            assert whole.value == max(one.value for one in each)
            # every draw looks for the worst of all families, not of that which is the worst here
            assert whole.low >= max(one.low for one in each)
        assert score.p_hmi.low <= score.p_hmi.value <= score.p_hmi.high
        found = json.loads(json.dumps(score.as_dict(), allow_nan=False))
        assert found["worst_family"] == score.worst.family
        assert {*found["false_alarms"]} == {WINDOW, CLEAN, *EVENTS}
        assert [each["family"] for each in found["families"]] == list(FAMILIES)
    assert "never in small: P(HMI | attack) 100.0 (" in str(scores["never"])
    mine, other = scores["test"], scores["never"]
    assert mine.difference_to(other).value == pytest.approx(-other.difference_to(mine).value)
    assert (mine.difference_to(mine), mine.ratio_to(mine)) == ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    assert mine.ratio_to(other).value == pytest.approx(mine.p_hmi.value / other.p_hmi.value)
    assert min(each.p_hmi.value for each in mine.families) < 1.0
    assert mine.difference_to(scores["loose"]).value <= 0.0
    for family in FAMILIES:
        assert mine.difference_to(scores["loose"], family).low <= 0.0
    with pytest.raises(ValueError, match="have not played the same runs: `runs` differ"):
        mine.difference_to(replace(other, runs=25))
    with pytest.raises(ValueError, match="`families` differ"):
        mine.difference_to(replace(other, families=other.families[:1]))
    with pytest.raises(ValueError, match="has not met the family 'quiet'; played: ramps"):
        mine.difference_to(other, "quiet")


def test_neither_the_other_detectors_nor_the_number_of_runs_decide_anything(scores):
    (alone,) = judge_of(9, 12, FAMILIES[:2]).scores([TEST])
    for mine, theirs in zip(alone.families, scores["test"].families, strict=False):
        pairs = zip(mine.protection.winners, theirs.protection.winners, strict=True)
        for one, other in pairs:
            assert one.spec == other.spec
            few, many = (each.displacement[MEASURES[0]] for each in (one, other))
            np.testing.assert_array_equal(few, many[:9])


def test_finished_parts_are_kept_and_go_with_their_settings(tmp_path, monkeypatch):
    whom, played, real = [TEST, WEIGHING], [], module.Panel
    found = judge_of(4, 4, ["dashes"], folder=tmp_path).scores(whom)
    monkeypatch.setattr(module, "Panel", lambda *given: played.append(given) or real(*given))
    again = judge_of(4, 4, ["dashes"], folder=tmp_path).scores(whom)
    assert not played
    assert [each.as_dict() for each in again] == [each.as_dict() for each in found]
    judge_of(5, 4, ["dashes"], folder=tmp_path).scores(whom[:1])
    assert played


OTHERS = ["quiet", "satellite-switch", "chance-alarm", "feedback"]


@pytest.mark.parametrize("key", heavy(OTHERS, *OTHERS[:2]))
def test_the_other_families_are_played_too(key):
    sizes = {"runs": 4, "selection_runs": 4, "entropy": 0, "threads": 1}
    (score,) = Auditor(small_task(), families=[key], **sizes).scores([TEST])
    assert score.worst.family == key
    assert 0.0 <= score.p_hmi.value <= 1.0


def test_detectors_of_one_name_do_not_share_runs(tmp_path):
    judge, found = judge_of(12, 6, ["ramps"]), []
    for name, bias in (("deaf", -1e6), ("nervous", 1e6)):  # of the statistic

        def shift(model, bias=bias):
            (tensor,) = (each for each in model.graph.initializer if each.name == "action_in_b")
            tensor.CopyFrom(numpy_helper.from_array(np.float32([bias]), "action_in_b"))

        file = write_guard(tmp_path / name, threshold=0.5, edit=shift)
        found += judge.scores([{"name": str(file), **NOMINAL}])
    deaf, nervous = found
    assert (deaf.detector, deaf.p_hmi.value) == (nervous.detector, 1.0)
    assert not deaf.false_alarms[CLEAN].any()
    assert nervous.false_alarms[CLEAN].all()


@pytest.mark.parametrize(
    ("detectors", "task", "settings", "message"),
    [
        (["never"], "D1", {"families": ["ramp"]}, "unknown family of attacks of D1 'ramp'"),
        (["never"], "D1", {"families": []}, "`families` must name at least one"),
        ([], small_task(), {}, "no detector is given"),
        (["never", "never"], small_task(), {}, "listed twice"),
        ([{**CHI2, "false_alarms_per_hour": 0.2}], small_task(), {}, "no calibration of snapshot-"),
    ],
)
def test_bad_input_is_refused(detectors, task, settings, message):
    with pytest.raises(ValueError, match=message):
        Auditor(task, **settings).scores(detectors)
