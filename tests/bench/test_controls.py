"""A campaign at one rate of false alarms: controls, and a toy detector."""

import copy
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from spoofgym.bench import run_campaign, summarize
from spoofgym.bench.experiments.calibration import calibrate_players
from spoofgym.bench.report import campaign as report
from spoofgym.bench.report.campaign_page import build_page
from spoofgym.bench.report.page import render_page
from spoofgym.bench.runs.record import MEASURES
from spoofgym.bench.scores.campaign import compare_controls, compute_times, headline
from spoofgym.bench.search.amplitude import Tuning
from spoofgym.bench.search.attack_suite import Selection
from spoofgym.detectors import DETECTORS, Detector, Verdict

from .support import RAMP, small_suite

RATE = 20.0  # so many an hour are an alarm in 13 % of the runs of 25 s
TOY, LOTTERY = (f"{name}(false_alarms_per_hour=20)" for name in ("toy", "lottery"))


@dataclass
class Toy(Detector):
    unit: float = 3.0
    paper: ClassVar[str] = "barshalom2001"

    def bind(self, context):
        super().bind(context)

    def judge(self, epoch):
        size = np.abs(epoch.innovation) / np.sqrt(epoch.innovation_variance)
        statistic = size.max(axis=1, keepdims=True)
        threshold = np.full_like(statistic, self.unit)
        return Verdict(statistic, threshold, statistic > threshold)


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """Results of `never`, `lottery`, a detector of the package, and one that is new to it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(DETECTORS, "toy", Toy)
        patch.setenv("SPOOFGYM_CALIBRATIONS", str(tmp_path_factory.mktemp("calibrations")))
        # fewer clean runs than by default: an alarm in 13 % of them needs few
        patch.setattr("spoofgym.calibration.thresholds.PASSIVE_RUNS", 200)
        rated = [
            {"name": name, "false_alarms_per_hour": RATE}
            for name in ("lottery", "snapshot-chi2", "toy")
        ]
        suite = small_suite(
            detectors=["never", *rated],
            spoofers=[RAMP, {"name": "step", "amplitude": "tuned"}],
            tuning=Tuning(runs=24, sift_runs=8, values=5, refined=2, budget=0.2),
            attack={"name": "false-position", "acceleration_limit_mps2": 0.5},
            selection=Selection(runs=24, sift_runs=8, values=4),
            runs=60,
        )
        calibrate_players(suite.world, suite.detector_players, threads=1)
        folder = run_campaign(suite, tmp_path_factory.mktemp("played") / "results", threads=1)
        yield suite, folder, summarize(folder)


def test_a_detector_helps_and_chance_neither_helps_nor_detects_in_time(played):
    _, _, summary = played
    against_never = [row for row in summary["comparisons"] if row["control"] == "never"]
    rows = [row for row in against_never if row["detector"] == LOTTERY]
    scores = {row["score"] for row in rows}
    assert scores == {"stealthy displacement", "protection 50 %", "protection 5 %"}
    for row in rows:
        assert row["difference_m"]["low"] <= 0.0 <= row["difference_m"]["high"]
        assert not row["above"]
    lottery = next(row for row in summary["detectors"] if row["detector"] == LOTTERY)
    assert lottery["false_alarm_per_run"]["value"] > 0.0  # it does alarm
    (half,) = (
        row["difference_m"]
        for row in against_never
        if (row["detector"], row["score"]) == (TOY, "protection 50 %")
    )
    assert half["high"] < 0.0
    _, folder, _ = played
    cell = folder.runs(LOTTERY, "step")
    assert ((cell.records["first_alarm"] > 0) & ~cell.records["warmup_alarm"]).any()
    # as if every run came beyond the limit at once
    crossed = {**cell.records, "crossing": np.ones(cell.runs, dtype=np.int64)}
    found = compute_times(replace(cell, records=crossed))
    assert (found["missed"]["value"], found["after_crossing_s"]) == (1.0, None)


def test_who_reads_the_statistic_is_compared_with_never_alone(played):
    _, folder, summary = played
    footings = {row["detector"]: row["footing"] for row in summary["detectors"]}
    cells = [folder.runs(label, "step") for label in footings]
    oracle = {"knowledge": {"run_time": "oracle"}}
    reading = [replace(each, head={**each.head, **oracle}) for each in cells]
    controls = {row["control"] for row in compare_controls(cells, [], footings)}
    assert controls == {"never", LOTTERY}
    rows = compare_controls(reading, [], footings)
    assert {row["control"] for row in rows} == {"never"}
    assert not any("lottery" in row["detector"] for row in rows)


def test_a_new_detector_is_calibrated_and_scored_by_its_name_alone(played):
    suite, _, summary = played
    row = next(row for row in summary["detectors"] if row["detector"] == TOY)
    (point,) = suite.world.points(suite.detector_players[-1])
    expected = pytest.approx(1 - np.exp(-RATE * 25 / 3600))
    assert row["claimed"]["per_run"] == point.per_run == expected
    assert row["false_alarm_per_run"]["low"] <= 1.6 * point.per_run
    assert row["false_alarm_per_run"]["high"] >= 0.6 * point.per_run
    (found,) = [each for each in summary["protection"] if each["detector"] == TOY]
    half, few = (headline(found, share) for share in (0.5, 0.05))
    assert half["measure"] == MEASURES[0]
    assert 0.0 < half["value"] <= few["value"]


def test_every_table_has_one_rate_and_marks_who_is_no_better_or_alarms_before_the_onset(played):
    _, folder, summary = played
    (group,) = report.groups(summary)
    assert (group.rate, len(group.detectors)) == ("20", 4)
    assert len(report.detector_rows(summary, group)) == 4
    told = copy.deepcopy(summary)
    for cell in told["cells"]:
        cell["knowledge"]["run_time"] = "oracle+reported"
    column = report.ATTACKS["spoofer"]
    names, marked = (
        [column.text(row) for row in report.attack_rows(each, group)] for each in (summary, told)
    )
    assert len(names) == 8
    assert marked == [f"{name} (oracle)" for name in names]
    text = render_page(build_page(folder, summary))
    assert "<h2>Detectors at 20 false alarms an hour</h2>" in text
    assert "spoofgym-scripted" in text
    assert f"{LOTTERY} less never" in text.replace("<wbr>", "")
    assert "nan" not in text
    rates = {"a": "0.2", "b": "0.002", "never": "any", "c": "nominal"}
    several = {"detectors": [{"detector": k, "footing": v} for k, v in rates.items()]}
    found = {group.rate: group.detectors for group in report.groups(several)}
    assert found == {"0.002": ["b", "never"], "0.2": ["a", "never"], "": ["c"]}
    _, _, summary = played
    assert report.mark_detector(summary, TOY) == ""
    nothing = {"value": 0.0, "low": 0.0, "high": 0.0}
    alike = [{**row, "difference_m": nothing, "below": False} for row in summary["comparisons"]]
    assert report.mark_detector({**summary, "comparisons": alike}, TOY) == "no better than never"
    early = copy.deepcopy(summary)
    for row in early["detectors"]:
        (row["claimed"] or {})["warmup_alarms"] = 0.34
    assert "alarms before the onset in 34 % of clean runs" in report.mark_detector(early, TOY)
    for low, marked in ((5.0, True), (0.1, False)):
        (row,) = (row for row in early["detectors"] if row["detector"] == TOY)
        row["false_alarms_per_hour"] = {"value": 9.0, "low": low, "high": 14.0}
        row["claimed"] = {**(row["claimed"] or {}), "false_alarms_per_hour": 0.2}
        said = f"false alarms above the claimed rate: 9.0 ({low} to 14.0) an hour, claimed 0.2"
        assert (said in report.mark_detector(early, TOY)) is marked
