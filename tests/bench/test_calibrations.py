"""A campaign's detectors at a rate: calibrated from their names alone."""

import json
from dataclasses import dataclass
from functools import partial

import pytest
from typer.testing import CliRunner

from spoofgym.bench import CampaignResults
from spoofgym.bench.experiments import Interrupted
from spoofgym.bench.experiments.calibration import (
    ResumablePlayer,
    calibrate,
    calibrate_players,
    hold_out,
)
from spoofgym.bench.experiments.campaign import run_campaign
from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.runs.world import PLAIN_ID, World
from spoofgym.calibration import clean_runs, holdouts
from spoofgym.calibration import thresholds as calibration
from spoofgym.cli import app
from spoofgym.core.progress import no_progress
from spoofgym.detectors import SnapshotChi2, calibrated
from spoofgym.detectors.calibration_file import FOLDER_VARIABLE

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 2.0}
TIMES = "--warmup-s 20 --live-s 10 --attack-s 15 --time-to-alert-s 2 --runs 2"
CLEAN = f"bench {TIMES} --selection-runs 0 --spoofer none --set domain={{}}"


@dataclass
class Toy(SnapshotChi2):
    """A detector that nobody has heard of."""


@pytest.fixture(autouse=True)
def few(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "own"))
    monkeypatch.setattr(calibration, "PASSIVE_RUNS", 60)
    monkeypatch.setattr(calibration, "WEIGHING_RUNS", 40)
    monkeypatch.chdir(tmp_path)


def small(*detectors):
    own = {"env": PLAIN_ID, "timeline": SHORT, "runs": 4}
    return Suite(detectors=detectors, spoofers=["none"], **own)


def call(words):
    return CliRunner().invoke(app, f"{CLEAN} {words}".split())


def test_a_toy_detector_is_calibrated_and_scored_from_its_name(tmp_path):
    label = "Toy(false_alarms_per_hour=20)"
    suite = small({"name": f"{__name__}:Toy", "false_alarms_per_hour": 20.0}, "never")
    with pytest.raises(ValueError, match=r"detector Toy.* in spoofgym/.*: there is no calibration"):
        suite.check_fit()
    totals = []
    bar = {"progress": lambda total: totals.append(total) or no_progress(total)}
    for _ in range(2):  # the second one replays what is there
        calibrate_players(suite.world, suite.detector_players, **bar)
    assert totals == [60]
    suite.check_fit()
    (caption,) = suite.captions
    rate = "20 false alarms an hour, 9.01 % of runs of 17 s (60 clean runs)"
    assert caption == f"{label}: {rate}"
    assert caption in suite.config["notes"]
    point = suite.config["calibrations"][label][0]
    assert (point["runs"], point["rank"]) == (60, 5)
    assert run_campaign(suite, tmp_path / "results", threads=1).runs(label, "none").runs == 4


def test_killed_calibrations_and_hold_outs_go_on(tmp_path):
    setup, specs = World.of(scenario="zhong2025", timeline=SHORT).setup, ["snapshot-chi2", "cusum"]
    asked = {"false_alarms_per_hour": 20.0, "runs": 40, "threads": 1}
    whole = calibration.calibrate_detectors(setup, specs, **asked, folder=tmp_path / "whole")
    counted = holdouts.hold_out(setup, whole, specs, **asked)
    played, left, play = [], tmp_path / "own" / "unfinished", clean_runs.play_batch

    def until_killed(*given):
        played.append(given)
        if len(played) == 3:
            raise KeyboardInterrupt
        return play(*given)

    asked["player"] = partial(ResumablePlayer, chunk=8, batch=until_killed)
    for function, given, wanted in (
        (calibrate, {**asked, "folder": tmp_path / "again"}, whole),
        (partial(hold_out, calibrations=whole), asked, counted),
    ):
        played.clear()
        with pytest.raises(Interrupted, match="2 of 5 cells are finished"):
            function(setup, detectors=specs, **given)
        (folder,) = left.iterdir()
        assert len(list((folder / "cells").iterdir())) == 2
        assert function(setup, detectors=specs, **given) == wanted
        assert len(played) == 3 + 3
        assert not list(left.iterdir())


def test_specs_say_what_is_asked_of_thresholds(monkeypatch):
    def labels(*detectors):
        return [each.label for each in small(*detectors).detector_players]

    (entry,) = small({"name": "ewma", "false_alarms_per_hour": 0.5}).detector_players
    assert entry.label == "ewma(false_alarms_per_hour=0.5)"
    assert small(entry.spec).detector_players == (entry,)
    nominal = {"name": "ewma", "thresholds": "nominal"}
    assert small(nominal).detector_players == small("ewma").detector_players
    assert labels("ewma") == ["ewma"]
    monkeypatch.setattr(calibrated, "DEFAULT_RATE", 0.5)
    assert labels("ewma", nominal) == ["ewma", "ewma(thresholds=nominal)"]
    assert small("ewma").detector_players[0].spec == entry.spec
    (entry,) = small(nominal).detector_players
    assert small(entry.spec).detector_players == (entry,)


@pytest.mark.nightly
def test_of_all_detectors_those_without_a_calibration_are_left_out():
    world = "--scenario trolley --tuning matched --json --false-alarms-per-hour 20 --detector"
    named, found = (call(f"{world} {name}") for name in ("cusum", "all"))
    assert named.exit_code == 2, named.output
    assert "the statistic of cusum is degenerate" in named.output
    assert found.exit_code == 0, found.output
    summary = json.loads(found.stdout)
    labels = [row["detector"] for row in summary["detectors"]]
    assert "cusum(false_alarms_per_hour=20)" not in labels
    assert any("cusum" in label and "rescaled" in label for label in labels)
    assert any("snapshot-chi2" in label for label in labels)
    notes = CampaignResults.load(summary["folder"]).config["notes"]
    assert any("cusum" in note and "is left out" in note for note in notes)
