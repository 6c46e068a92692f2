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
from spoofgym.bench.runs.world import World
from spoofgym.calibration import clean_runs, holdouts
from spoofgym.calibration import thresholds as calibration
from spoofgym.cli import app
from spoofgym.core.progress import no_progress
from spoofgym.detectors import SnapshotChi2, calibrated
from spoofgym.detectors.calibration_file import FOLDER_VARIABLE

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 2.0}


@dataclass
class Toy(SnapshotChi2):
    """A detector that nobody has heard of."""


@pytest.fixture(autouse=True)
def few(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "own"))
    monkeypatch.setattr(calibration, "PASSIVE_RUNS", 60)
    monkeypatch.setattr(calibration, "WEIGHING_RUNS", 40)


def small(*detectors):
    return Suite(detectors=detectors, spoofers=["none"], timeline=SHORT, runs=4)


def test_a_toy_detector_is_calibrated_and_scored_from_its_name(tmp_path):
    name = f"{__name__}:Toy"
    suite = small({"name": name, "false_alarms_per_hour": 20.0}, "never")
    with pytest.raises(ValueError, match=r"detector Toy.* in spoofgym/.*: there is no calibration"):
        suite.check_fit()
    totals = []

    def bar(total):
        totals.append(total)
        return no_progress(total)

    for _ in range(2):
        calibrate_players(suite.world, suite.detector_players, progress=bar)
    assert totals == [60]
    suite.check_fit()
    (caption,) = suite.captions
    assert caption == (
        "Toy(false_alarms_per_hour=20): 20 false alarms an hour, 9.01 % of runs of 17 s (60 clean "
        "runs)"
    )
    assert caption in suite.config["notes"]
    point = suite.config["calibrations"]["Toy(false_alarms_per_hour=20)"][0]
    assert (point["runs"], point["rank"]) == (60, 5)
    folder = run_campaign(suite, tmp_path / "results", threads=1)
    assert folder.runs("Toy(false_alarms_per_hour=20)", "none").runs == 4
    calibrate_players(suite.world, suite.detector_players)  # replays what is there


def test_killed_calibrations_and_hold_outs_go_on(tmp_path, monkeypatch):
    """From the runs that they have played, with the same counts; they leave nothing behind."""
    setup, specs = World.of(timeline=SHORT).setup, ["snapshot-chi2", "cusum"]
    asked = {"false_alarms_per_hour": 20.0, "runs": 40, "threads": 1}
    whole = calibration.calibrate_detectors(setup, specs, **asked, folder=tmp_path / "whole")
    counted = holdouts.hold_out(setup, whole, specs, **asked)
    played, left = [], tmp_path / "own" / "unfinished"

    def until_killed(*given):
        played.append(given)
        if len(played) == 3:
            raise KeyboardInterrupt
        return play(*given)

    play = clean_runs._play
    monkeypatch.setattr(clean_runs, "_play", until_killed)
    asked["player"] = partial(ResumablePlayer, chunk=8)
    for function, given in (
        (calibrate, {**asked, "folder": tmp_path / "again"}),
        (partial(hold_out, calibrations=whole), asked),
    ):
        played.clear()
        with pytest.raises(Interrupted, match="2 of 5 cells are finished"):
            function(setup, detectors=specs, **given)
        (folder,) = left.iterdir()
        assert len(list((folder / "cells").iterdir())) == 2
        before = len(played)
        found = function(setup, detectors=specs, **given)
        assert found in (whole, counted)
        assert len(played) - before == 3
        assert not list(left.iterdir())


def test_specs_say_what_is_asked_of_thresholds(monkeypatch):
    rate = {"name": "ewma", "false_alarms_per_hour": 0.5}
    (entry,) = small(rate).detector_players
    assert entry.label == "ewma(false_alarms_per_hour=0.5)"
    assert small(entry.spec).detector_players == (entry,)
    assert [each.label for each in small("ewma").detector_players] == ["ewma"]
    nominal = {"name": "ewma", "thresholds": "nominal"}
    assert small(nominal).detector_players == small("ewma").detector_players
    monkeypatch.setattr(calibrated, "DEFAULT_RATE", 0.5)
    assert [each.label for each in small("ewma", nominal).detector_players] == [
        "ewma",
        "ewma(thresholds=nominal)",
    ]
    assert small("ewma").detector_players[0].spec == entry.spec
    (entry,) = small(nominal).detector_players
    assert small(entry.spec).detector_players == (entry,)


@pytest.mark.nightly
def test_of_all_detectors_those_without_a_calibration_are_left_out(monkeypatch):
    """In this receiver's belief clean innovations never exceed what a CUSUM allows for."""
    monkeypatch.chdir(calibration.user_folder().parent)
    times = "--warmup-s 20 --live-s 10 --attack-s 15 --time-to-alert-s 2 --seeds 2"
    world = "--scenario trolley --tuning matched --selection-seeds 0 --spoofer none --json"
    asked = f"bench {times} {world} --false-alarms-per-hour 20 --set domain={{}}".split()
    named = CliRunner().invoke(app, [*asked, "--detector", "cusum"])
    assert named.exit_code == 2, named.output
    assert "the statistic of cusum is degenerate" in named.output
    found = CliRunner().invoke(app, [*asked, "--detector", "all"])
    assert found.exit_code == 0, found.output
    summary = json.loads(found.stdout)
    labels = [row["detector"] for row in summary["detectors"]]
    assert "cusum(false_alarms_per_hour=20)" not in labels
    assert any("cusum" in label and "rescaled" in label for label in labels)
    assert any("snapshot-chi2" in label for label in labels)
    notes = CampaignResults.load(summary["folder"]).config["notes"]
    assert any("cusum" in note and "is left out" in note for note in notes)


@pytest.mark.usefixtures("default_rate")
def test_nominal_is_what_it_says_whatever_the_default(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    times = "--warmup-s 20 --live-s 10 --attack-s 15 --time-to-alert-s 2 --seeds 2"
    asked = f"bench {times} --nominal --selection-seeds 0 --spoofer none --set domain={{}}".split()
    found = CliRunner().invoke(app, asked)
    assert found.exit_code == 0, found.output
    config = CampaignResults.load(tmp_path / "results").config
    assert config["calibrations"] == {}
    labels = [entry["label"] for entry in config["detectors"]]
    assert "ewma(thresholds=nominal)" in labels
