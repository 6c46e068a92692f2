"""Runs on a device, by the simulator of one: those of a search, and clean ones that are counted."""

import json

import pytest

from tests.cuda.test_simulated import DETECTORS, FAST, TACTICAL, run

pytest.importorskip("torch")
AGILE = {"acceleration_limit_mps2": 20.0}
PULLED = {**FAST, "attack": {"name": "false-position", **AGILE}}
LOUD = {**DETECTORS["ewma"], "false_alarm": 0.05}


def compare(*works):
    return run("tests.bench.on_device", json.dumps(works), simulated=True)


def test_attacks_and_clean_runs_are_those_of_the_processor():
    clean = ["count_false_alarms", FAST, ["ewma", "cusum"]]
    attacked, counted = compare(["compare_attacks", PULLED, LOUD], clean)
    assert attacked["compare_attacks"] > 300
    assert counted == {"count_false_alarms": 2}


@pytest.mark.nightly
def test_searches_for_amplitudes_and_campaigns_are_those_of_the_processor():
    other = {**TACTICAL, "attack": {"name": "per-channel", **AGILE}}
    found = compare(
        ["compare_attacks", other, DETECTORS["windowed-chi2"]],
        ["compare_scores", PULLED, DETECTORS["ewma"]],
        ["compare_scores", PULLED, DETECTORS["cusum"]],
        ["compare_campaigns", ["ewma", "innovation-rate"]],
    )
    assert found[-1] == {"compare_campaigns": 4}
