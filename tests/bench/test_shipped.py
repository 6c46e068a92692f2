"""Shipped spoofers in a campaign: who plays by default, who is left out, what is written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from spoofgym.bench import Suite, run_campaign, summarize
from spoofgym.bench.report.campaign import format_target, markdown
from spoofgym.bench.report.figures import draw_campaign
from spoofgym.bench.runs.players import DEFAULT_SPOOFERS, describe_knowledge, specify_spoofer
from spoofgym.simulation import Timeline
from spoofgym.spoofers import make_spoofer
from spoofgym.spoofers.build import card_behind

from .support import SHORT, small_suite, use_zoo, write_policy, write_zoo

USUAL = ["none", "step", "ramp(tuned)", "accelerating-ramp(tuned)", "blind-optimum"]


@pytest.fixture(scope="module")
def zoo_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("zoo")
    write_zoo(folder, small_suite())
    return folder


@pytest.fixture(autouse=True)
def _zoo(zoo_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_zoo(zoo_folder, monkeypatch)


def labels(suite: Suite) -> list[str]:
    return [entry.label for entry in suite.spoofer_players]


def test_those_that_fit_play_by_default() -> None:
    suite = Suite(timeline=SHORT)
    assert labels(suite) == [*USUAL, "curve", "push", "track"]
    assert suite.left_out == ()
    assert labels(Suite(timeline=SHORT, spoofers=DEFAULT_SPOOFERS)) == USUAL


def test_an_empty_zoo_leaves_the_usual_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_zoo(tmp_path, monkeypatch)
    suite = Suite(timeline=SHORT)
    assert labels(suite) == USUAL
    assert suite.config["notes"] == []


def test_those_that_do_not_fit_are_named_with_the_reason() -> None:
    longer = Timeline(warmup_s=20.0, live_s=10.0, attack_s=30.0, time_to_alert_s=5.0)
    suite = Suite(timeline=longer, notes=("mine",))
    assert labels(suite) == USUAL
    assert suite.config["notes"][0] == "mine"
    for name, note in zip(("curve", "push", "track"), suite.left_out, strict=True):
        assert note.startswith(f"shipped spoofer {name} is left out: ")
        assert "conditions.steps: 40 on the card, 60 here" in note
    by_rate = Suite(timeline=SHORT, attack={"name": "false-position", "control": "rate"})
    assert "action: north_acceleration, east_acceleration only on the card" in by_rate.left_out[1]
    assert Suite(timeline=longer, spoofers=("step",)).left_out == ()


def test_one_that_does_not_fit_is_refused_when_it_is_asked_for(tmp_path: Path) -> None:
    suite = small_suite(attack={"name": "false-position", "rate_limit_mps": 2.0}, spoofers=["push"])
    with pytest.raises(ValueError, match=r"conditions.rate_limit_mps: 5.0 on the card, 2.0 here"):
        run_campaign(suite, tmp_path, threads=1)


def test_the_file_is_part_of_the_campaign(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"there is no ONNX file .*mine\.onnx"):
        small_suite(spoofers=(str(tmp_path / "mine.onnx"),))
    digests = []
    for push in (0.01, 0.02):
        write_policy(tmp_path / "mine.onnx", small_suite(), "blind", (0.0, push))
        suite = small_suite(spoofers=(str(tmp_path / "mine.onnx"),))
        (_, entry) = suite.spoofer_players
        assert (entry.label, len(entry.spec["sha256"])) == ("mine", 64)
        digests.append(suite.digest)
    assert digests[0] != digests[1]


def known(spec: Any, detector: str = "ewma", **changes: Any) -> dict[str, Any]:
    suite = small_suite(detectors=(detector,), **changes)
    (judge,) = suite.detector_players
    return describe_knowledge(specify_spoofer(spec), suite.setup(judge), judge)


def test_what_they_were_made_for() -> None:
    assert known("track") == {
        "run_time": "tracking",
        "design_time": "ewma, by hand",
        "detector": "ewma",
        "transfer": [],
    }
    elsewhere = known("curve", "snapshot-chi2", receiver={"tuning": "matched"})
    assert elsewhere["detector"] == "ewma"
    assert elsewhere["transfer"] == ["detector", "receiver"]
    assert format_target({"knowledge": elsewhere}) == "ewma (transfer: detector, receiver)"
    calmer = {"name": "zhong2025", "errors": "groves"}
    pseudorange_only = {"name": "false-position", "coherent": False}
    assert known("push", scenario=calmer)["transfer"] == ["scenario"]
    assert known("push", attack=pseudorange_only)["transfer"] == ["attack"]
    assert known("push", attack="false-position-ideal")["transfer"] == []  # the same by name
    tuned = known({"name": "ramp", "rate_mps": "tuned"}, "snapshot-chi2")
    assert (tuned["detector"], tuned["transfer"]) == ("snapshot-chi2", [])
    assert known("step")["design_time"] == "nothing"


def test_what_has_no_card_tells_for_itself() -> None:
    own = {"name": "profile", "rates_mps": [0.0, 0.3], "designed_on": "a hunch | or two"}
    told = known(own)
    assert (told["detector"], told["design_time"]) == (None, "a hunch | or two")
    assert format_target({"knowledge": told}) == "a hunch | or two"
    # the name of a shipped one does not make it that
    assert card_behind(make_spoofer({**own, "label": "curve"})) is None


def test_two_of_one_label_are_refused() -> None:
    curves = [{"name": "profile", "rates_mps": [0.0, rate]} for rate in (0.1, 0.2)]
    with pytest.raises(ValueError, match="listed twice: profile; a `label` of its own tells"):
        small_suite(spoofers=curves)
    curves[1]["label"] = "faster"
    assert labels(small_suite(spoofers=curves)) == ["none", "profile", "faster"]
    curves[1]["label"] = "profile?"  # another label, but the same file
    with pytest.raises(ValueError, match=r"listed twice: profile, profile\?"):
        small_suite(spoofers=curves)


def test_a_campaign_with_learned_and_optimised_spoofers(tmp_path: Path) -> None:
    suite = small_suite(
        spoofers=("step", {"name": "ramp", "rate_mps": "tuned"}, "curve", "push", "track")
    )
    folder = run_campaign(suite, tmp_path, threads=1)
    summary = summarize(folder)
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    moved = {
        (cell["detector"], cell["spoofer"]): cell["stealthy_displacement_m"]["value"]
        for cell in summary["cells"]
    }
    # twice the command, half the displacement apart
    assert moved["ewma", "push"] > moved["ewma", "track"] > 0.0
    text = markdown(folder, summary)
    for part in (
        "| snapshot-chi2 | push | ewma (transfer) | sha256=",
        "| ewma | push | ewma | sha256=",
        "| ewma | curve | ewma | rates_mps: 3 from 0 to 0.2 |",
        "| track | tracking | ewma, by hand |",
        "knowledge of the spoofers at run time: blind, tracking",
    ):
        assert part in text
    assert draw_campaign(folder, summary).stat().st_size > 10_000
