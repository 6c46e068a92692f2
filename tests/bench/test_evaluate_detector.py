"""Scores of detectors: the worst family counts, runs are paired, and finished parts are kept."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from onnx import numpy_helper

import spoofgym
from spoofgym.bench.experiments import protect as module
from spoofgym.bench.experiments.protect import DetectorEvaluator
from spoofgym.bench.runs.record import MEASURES
from spoofgym.bench.scores.detector import CLEAN, WINDOW
from spoofgym.tasks import EVENTS, DetectorTask

from ..detectors.learned.files import write_guard
from .detector_support import NOMINAL, small_task

LOTTERY = {"name": "lottery", "mean_wait_s": 500.0}
TEST = {"name": "snapshot-chi2", "signals": "range_rate", **NOMINAL}
LOOSE = {"name": "snapshot-chi2", "signals": "range_rate", "threshold_scale": 3.0}
WEIGHING = {"name": "ewma", "smoothing": 0.1, "weight_scale": 0.3, **NOMINAL}
FAMILIES = ("ramps", "subset", "meaconer", "turn")


@pytest.fixture(scope="module")
def scores():
    evaluator = DetectorEvaluator(
        small_task(), runs=24, selection_runs=12, families=FAMILIES, threads=1
    )
    found = evaluator.scores(["never", LOTTERY, TEST, LOOSE, WEIGHING])
    return dict(zip(("never", "lottery", "test", "loose", "weighing"), found, strict=True))


def test_without_a_defence_every_attack_is_hazardous(scores):
    score = scores["never"]
    assert (score.p_hmi.value, score.worst.counted) == (1.0, 24)
    assert [each.family for each in score.families] == list(FAMILIES)
    assert not score.false_alarms[WINDOW].any()


def test_chance_is_not_told_from_nothing(scores):
    difference = scores["lottery"].difference_to(scores["never"])
    assert difference.low <= 0.0 <= difference.high
    for family in FAMILIES:
        gap = scores["lottery"].difference_to(scores["never"], family)
        assert gap.low <= 0.0 <= gap.high
    assert scores["lottery"].false_alarms[CLEAN].any()  # it does alarm
    assert scores["lottery"].worst.counted < 24


def test_the_worst_family_counts(scores):
    for score in scores.values():
        by_family = [each.p_hmi.value for each in score.families]
        assert score.p_hmi.value == max(by_family) == score.worst.p_hmi.value
        for share in (0.5, 0.05):
            each = [family.estimate_quantile(share).value for family in score.families]
            assert score.estimate_quantile(share).value == max(each)
        assert score.p_hmi.low <= score.p_hmi.value <= score.p_hmi.high


def test_a_tighter_threshold_is_not_worse(scores):
    gap = scores["test"].difference_to(scores["loose"])
    assert gap.value <= 0.0
    for family in FAMILIES:
        assert scores["test"].difference_to(scores["loose"], family).low <= 0.0


def test_a_test_defends_better_than_none_against_one_family_at_least(scores):
    assert min(each.p_hmi.value for each in scores["test"].families) < 1.0


def test_differences_are_paired_and_signed(scores):
    mine, other = scores["test"], scores["never"]
    there, back = mine.difference_to(other), other.difference_to(mine)
    assert there.value == pytest.approx(-back.value)
    assert mine.difference_to(mine) == (0.0, 0.0, 0.0)
    assert mine.ratio_to(other).value == pytest.approx(mine.p_hmi.value / other.p_hmi.value)
    nobody = replace(other, runs=25)
    with pytest.raises(ValueError, match="have not played the same runs: `runs` differ"):
        mine.difference_to(nobody)
    fewer = replace(other, families=other.families[:1])
    with pytest.raises(ValueError, match="`families` differ"):
        mine.difference_to(fewer)
    with pytest.raises(ValueError, match="has not met the family 'quiet'; played: ramps"):
        mine.difference_to(other, "quiet")


def test_a_score_is_json_and_a_line(scores):
    for score in scores.values():
        found = json.loads(json.dumps(score.as_dict(), allow_nan=False))
        assert found["worst_family"] == score.worst.family
        assert {*found["false_alarms"]} == {WINDOW, CLEAN, *EVENTS}
        assert [each["family"] for each in found["families"]] == list(FAMILIES)
    assert "never in small: P(HMI | attack) 100.0 %" in str(scores["never"])


def test_look_alikes_count_as_false_alarms_of_the_same_runs(scores):
    score = scores["weighing"]
    for event in EVENTS:
        assert score.false_alarms[event].shape == (24,)
    # a step of the clock is not in the error model of a test of single channels
    assert score.false_alarm_rate("clock_step").value > score.false_alarm_rate(CLEAN).value
    assert (score.false_alarms[CLEAN] >= score.false_alarms[WINDOW]).all()


def test_what_a_detector_gets_does_not_depend_on_whom_it_is_played_with(scores):
    alone = DetectorEvaluator(
        small_task(), runs=24, selection_runs=12, families=FAMILIES[:2], threads=1
    ).scores([TEST])[0]
    for mine, theirs in zip(alone.families, scores["test"].families, strict=False):
        assert mine.attack.spec == theirs.attack.spec
        for winner, other in zip(mine.protection.winners, theirs.protection.winners, strict=True):
            np.testing.assert_array_equal(
                winner.displacement[MEASURES[0]], other.displacement[MEASURES[0]]
            )


def test_evaluation_decides_nothing():
    sizes = {"selection_runs": 8, "families": ["dashes"], "threads": 1}
    few, many = (
        spoofgym.evaluate_detector(TEST, small_task(), runs=runs, **sizes) for runs in (4, 9)
    )
    (mine,), (more,) = few.families, many.families
    assert [w.spec for w in mine.protection.winners] == [w.spec for w in more.protection.winners]
    first = more.protection.winners[0].displacement[MEASURES[0]][:4]
    np.testing.assert_array_equal(mine.protection.winners[0].displacement[MEASURES[0]], first)


def test_finished_parts_are_kept_and_go_with_their_settings(tmp_path, monkeypatch):
    sizes = {"runs": 4, "selection_runs": 4, "families": ["dashes"], "threads": 1}
    whom = [TEST, WEIGHING]
    found = DetectorEvaluator(small_task(), folder=tmp_path, **sizes).scores(whom)
    played = []
    real = module.Panel
    monkeypatch.setattr(module, "Panel", lambda *given: played.append(given) or real(*given))
    again = DetectorEvaluator(small_task(), folder=tmp_path, **sizes).scores(whom)
    assert not played
    assert [each.as_dict() for each in again] == [each.as_dict() for each in found]
    other = DetectorEvaluator(small_task(), folder=tmp_path, **{**sizes, "runs": 5})
    other.scores(whom[:1])
    assert played


@pytest.mark.parametrize("key", ["quiet", "satellite-switch", "chance-alarm", "feedback"])
def test_the_other_families_are_played_too(key):
    score = spoofgym.evaluate_detector(
        TEST, small_task(), runs=4, selection_runs=4, families=[key], threads=1
    )
    assert score.worst.family == key
    assert 0.0 <= score.p_hmi.value <= 1.0


def test_detectors_of_one_name_do_not_share_runs(tmp_path):
    """As two files of one name in two folders have it."""
    evaluator = DetectorEvaluator(
        small_task(), runs=12, selection_runs=6, families=["ramps"], threads=1
    )
    files = []
    for name, bias in (("deaf", -1e6), ("nervous", 1e6)):  # of the statistic

        def shift(model, bias=bias):
            (tensor,) = (each for each in model.graph.initializer if each.name == "action_in_b")
            tensor.CopyFrom(numpy_helper.from_array(np.float32([bias]), "action_in_b"))

        files.append(write_guard(tmp_path / name, threshold=0.5, edit=shift))
    (first,), (second,) = (evaluator.scores([{"name": str(file), **NOMINAL}]) for file in files)
    assert first.detector == second.detector
    assert first.p_hmi.value == 1.0
    assert not first.false_alarms[CLEAN].any()
    assert second.false_alarms[CLEAN].all()


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match="unknown task for detectors 'T1'"):
        spoofgym.evaluate_detector("never", "T1")
    with pytest.raises(ValueError, match="unknown family of attacks of D1 'ramp'"):
        spoofgym.evaluate_detector("never", "D1", families=["ramp"])
    with pytest.raises(ValueError, match="`families` must name at least one"):
        spoofgym.evaluate_detector("never", "D1", families=[])
    with pytest.raises(ValueError, match="`runs` must be"):
        spoofgym.evaluate_detector("never", "D1", runs=1)
    judge = DetectorEvaluator(small_task())
    with pytest.raises(ValueError, match="no detector is given"):
        judge.scores([])
    with pytest.raises(ValueError, match="listed twice"):
        judge.scores(["never", "never"])
    with pytest.raises(ValueError, match=r"no calibration of snapshot-chi2.*spoofgym calibrate"):
        judge.scores([{"name": "snapshot-chi2", "false_alarms_per_hour": 0.2}])
    assert isinstance(judge.task, DetectorTask)
