"""A campaign at one rate of false alarms: controls, and a toy detector."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest

from spoofgym.bench import run_campaign, summarize
from spoofgym.bench.experiments.calibration import calibrate_players
from spoofgym.bench.report.campaign import (
    ATTACKS,
    attack_rows,
    detector_rows,
    groups,
    mark_detector,
    markdown,
)
from spoofgym.bench.report.campaign import (
    DETECTORS as TABLE,
)
from spoofgym.bench.runs.record import MEASURES
from spoofgym.bench.scores.campaign import compare_controls, compute_times
from spoofgym.bench.search.amplitude import Tuning
from spoofgym.bench.search.attack_suite import Selection
from spoofgym.detectors import DETECTORS, Detector, Verdict

from .support import small_suite

RATE = 20.0
"""So many an hour are an alarm in 13 % of the runs of 25 s."""
LABEL = "false_alarms_per_hour=20"
RUNS = 60


@dataclass
class Toy(Detector):
    """Largest normalised innovation of an epoch."""

    unit: float = 3.0

    paper: ClassVar[str] = "barshalom2001"

    def bind(self, context: Any) -> None:
        super().bind(context)

    def judge(self, epoch: Any) -> Verdict:
        size = np.abs(epoch.innovation) / np.sqrt(epoch.innovation_variance)
        statistic = size.max(axis=1, keepdims=True)
        threshold = np.full_like(statistic, self.unit)
        return Verdict(statistic, threshold, statistic > threshold)


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Results of `never`, `lottery`, a detector of the package, and one that is new to it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(DETECTORS, "toy", Toy)
        patch.setenv("SPOOFGYM_CALIBRATIONS", str(tmp_path_factory.mktemp("calibrations")))
        # fewer clean runs than by default: an alarm in 13 % of them needs few
        patch.setattr("spoofgym.calibration.thresholds.PASSIVE_RUNS", 200)
        suite = small_suite(
            detectors=[
                "never",
                *({"name": n, "false_alarms_per_hour": RATE} for n in ("lottery", "snapshot-chi2")),
                {"name": "toy", "false_alarms_per_hour": RATE},
            ],
            spoofers=[
                {"name": "ramp", "rate_mps": "tuned"},
                {"name": "step", "amplitude": "tuned"},
            ],
            tuning=Tuning(runs=24, sift_runs=8, values=5, refined=2, budget=0.2),
            attack={"name": "false-position", "acceleration_limit_mps2": 0.5},
            selection=Selection(runs=24, sift_runs=8, values=4),
            runs=RUNS,
        )
        calibrate_players(suite.world, suite.detector_players, threads=1)
        folder = run_campaign(suite, tmp_path_factory.mktemp("played") / "results", threads=1)
        yield suite, folder, summarize(folder)


def test_never_and_lottery_can_not_be_told_apart(played: Any) -> None:
    _, _, summary = played
    rows = [
        row
        for row in summary["comparisons"]
        if {row["detector"].partition("(")[0], row["control"].partition("(")[0]}
        == {"never", "lottery"}
    ]
    scores = {row["score"] for row in rows}
    assert scores == {"stealthy displacement", "protection 50 %", "protection 5 %"}
    for row in rows:
        gap = row["difference_m"]
        assert gap["low"] <= 0.0 <= gap["high"]
        assert not row["above"]
    lottery = next(row for row in summary["detectors"] if "lottery" in row["detector"])
    # it does alarm, and by chance alone
    assert lottery["false_alarm_per_run"]["value"] > 0.0


def test_who_reads_the_statistic_is_compared_with_never_alone(played: Any) -> None:
    """It obeys that of a lottery, too."""
    _, folder, summary = played
    footings = {row["detector"]: row["footing"] for row in summary["detectors"]}
    cells = [folder.runs(label, "step") for label in footings]
    reading = [
        replace(each, head={**each.head, "knowledge": {"run_time": "oracle"}}) for each in cells
    ]
    assert {row["control"] for row in compare_controls(cells, [], footings)} == {
        "never",
        f"lottery({LABEL})",
    }
    rows = compare_controls(reading, [], footings)
    assert {row["control"] for row in rows} == {"never"}
    assert not any("lottery" in row["detector"] for row in rows)


def test_an_alarm_by_chance_is_no_detection_in_time(played: Any) -> None:
    """All that a lottery catches is chance."""
    _, folder, _ = played
    cell = folder.runs(f"lottery({LABEL})", "step")
    assert ((cell.records["first_alarm"] > 0) & ~cell.records["warmup_alarm"]).any()
    # as if every run came beyond the limit at once
    crossed = {**cell.records, "crossing": np.ones(cell.runs, dtype=np.int64)}
    found = compute_times(replace(cell, records=crossed))
    assert found["missed"]["value"] == 1.0
    assert found["after_crossing_s"] is None


def test_a_detector_that_alarms_before_the_onset_is_marked(played: Any) -> None:
    _, _, summary = played
    label = f"toy({LABEL})"
    rows = [
        {**row, "claimed": row["claimed"] and {**row["claimed"], "warmup_alarms": 0.34}}
        for row in summary["detectors"]
    ]
    assert mark_detector(summary, label) == ""
    nothing = {"value": 0.0, "low": 0.0, "high": 0.0}
    alike = [{**row, "difference_m": nothing, "below": False} for row in summary["comparisons"]]
    assert mark_detector({**summary, "comparisons": alike}, label) == "no better than never"
    text = "alarms before the onset in 34 % of clean runs"
    assert text in mark_detector({**summary, "detectors": rows}, label)
    assert text not in mark_detector(summary, label)


def test_skies_that_are_not_the_worst_ones_have_no_figure(played: Any) -> None:
    """A campaign with one sky has none; where they hold less than all skies do, neither."""
    _, _, summary = played
    label = f"toy({LABEL})"
    (group,) = (each for each in groups(summary) if each.rate == f"{RATE:g}")
    column = TABLE["worst skies, in 50 % [m]"]

    def cell(*values: float | None) -> str:
        found = [
            {**each, "exceeded": [*each["exceeded"], *(skies(each, value) for value in values)]}
            for each in summary["protection"]
        ]
        rows = detector_rows({**summary, "protection": found}, group)
        return next(column.text(row) for row in rows if row["detector"] == label)

    def skies(found: dict[str, Any], value: float | None) -> dict[str, Any]:
        half = next(row for row in found["exceeded"] if row["share"] == 0.5)
        names = ("value", "low", "high")
        three = {key: None if value is None else half[key] + value for key in names}
        return {**half, **three, "worst_skies": True}

    assert cell() == cell(None) == "-"
    assert cell(1.0) != "-"


def test_a_new_detector_is_calibrated_and_scored_by_its_name_alone(played: Any) -> None:
    suite, _, summary = played
    label = f"toy({LABEL})"
    row = next(row for row in summary["detectors"] if row["detector"] == label)
    (point,) = suite.world.points(suite.detector_players[-1])
    assert (
        row["claimed"]["per_run"] == point.per_run == pytest.approx(1 - np.exp(-RATE * 25 / 3600))
    )
    low, high = (row["false_alarm_per_run"][key] for key in ("low", "high"))
    assert low <= 1.6 * point.per_run
    assert high >= 0.6 * point.per_run
    cells = [cell for cell in summary["cells"] if cell["detector"] == label]
    assert [cell["spoofer"] for cell in cells] == ["none", "ramp(tuned)", "step"]
    for cell in cells[1:]:
        assert cell["stealthy_displacement_m"]["value"] > 0.0
    (found,) = [each for each in summary["protection"] if each["detector"] == label]
    half, few = (
        next(
            row
            for row in found["exceeded"]
            if (row["measure"], row["share"], row["worst_skies"]) == (MEASURES[0], share, False)
        )
        for share in (0.5, 0.05)
    )
    assert 0.0 < half["value"] <= few["value"]


def test_a_detector_helps_where_never_does_not(played: Any) -> None:
    _, _, summary = played
    gaps = {
        row["detector"]: row["difference_m"]["high"]
        for row in summary["comparisons"]
        if row["control"] == "never" and row["score"] == "protection 50 %"
    }
    assert gaps[f"toy({LABEL})"] < 0.0


def test_every_table_has_one_rate(played: Any) -> None:
    _, folder, summary = played
    (group,) = groups(summary)
    assert (group.rate, len(group.detectors)) == ("20", 4)
    assert len(detector_rows(summary, group)) == 4
    column = ATTACKS["spoofer"]
    names = [column.text(row) for row in attack_rows(summary, group)]
    assert len(names) == 8
    assert not any("oracle" in name for name in names)
    for cell in (told := copy.deepcopy(summary))["cells"]:
        cell["knowledge"]["run_time"] = "oracle+reported"
    told_names = [column.text(row) for row in attack_rows(told, group)]
    assert told_names == [f"{name} (oracle)" for name in names]
    for protection in told["protection"]:
        for row in protection["exceeded"]:
            row["letter"] = "e"
    worst = TABLE["worst attack"]
    marked = [text for row in detector_rows(told, group) if (text := worst.text(row)) != "-"]
    assert marked
    assert all(row.startswith("(e) ") and " (oracle), " in row for row in marked)
    text = markdown(folder, summary)
    for part in (
        "## Detectors at 20 false alarms an hour",
        "the suite spoofgym-scripted 2",
        "lottery(false_alarms_per_hour=20) less never",
    ):
        assert part in text
    assert "nan" not in text


def test_detectors_at_different_rates_share_no_table() -> None:
    rates = {"a": "0.2", "b": "0.002", "never": "any", "c": "nominal"}
    summary = {"detectors": [{"detector": k, "footing": v} for k, v in rates.items()]}
    found = {group.rate: group.detectors for group in groups(summary)}
    assert found == {"0.002": ["b", "never"], "0.2": ["a", "never"], "": ["c"]}
