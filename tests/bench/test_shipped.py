"""Shipped spoofers in a campaign: who plays by default, who is left out, what is written."""

import pytest

from spoofgym.bench import Suite, run_campaign
from spoofgym.bench.report.campaign import format_target
from spoofgym.bench.runs.players import describe_knowledge, specify_spoofer
from spoofgym.bench.runs.world import PLAIN_ID
from spoofgym.simulation import Timeline
from spoofgym.spoofers import make_spoofer
from spoofgym.spoofers.build import card_behind

from .support import RAMP, SHORT, small_suite, use_zoo, write_zoo

USUAL = ["none", "step", "ramp(tuned)", "accelerating-ramp(tuned)", "open-loop"]


@pytest.fixture(scope="module")
def zoo_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("zoo")
    write_zoo(folder, small_suite())
    return folder


@pytest.fixture(autouse=True)
def _zoo(zoo_folder, monkeypatch):
    use_zoo(zoo_folder, monkeypatch)


def labels(suite):
    return [entry.label for entry in suite.spoofer_players]


def test_those_that_fit_play_by_default_and_others_are_named_with_the_reason(tmp_path, monkeypatch):
    longer = Timeline(warmup_s=20.0, live_s=10.0, attack_s=30.0, time_to_alert_s=5.0)
    suite = Suite(env=PLAIN_ID, timeline=longer, notes=("mine",))
    assert labels(suite) == USUAL
    assert suite.config["notes"][0] == "mine"
    for name, note in zip(("curve", "push", "track"), suite.left_out, strict=True):
        assert note.startswith(f"shipped spoofer {name} is left out: ")
        assert "conditions.steps: 40 on the card, 60 here" in note
    by_rate = {"name": "false-position", "control": "rate"}
    by_rate = Suite(env=PLAIN_ID, timeline=SHORT, attack=by_rate)
    assert "action: north_acceleration, east_acceleration only on the card" in by_rate.left_out[1]
    assert Suite(env=PLAIN_ID, timeline=longer, spoofers=("step",)).left_out == ()
    # one that is asked for is refused
    asked = small_suite(attack={"name": "false-position", "rate_limit_mps": 2.0}, spoofers=["push"])
    with pytest.raises(ValueError, match=r"conditions.rate_limit_mps: 5.0 on the card, 2.0 here"):
        run_campaign(asked, tmp_path / "results", threads=1)
    suite = Suite(env=PLAIN_ID, timeline=SHORT)
    assert (labels(suite), suite.left_out) == ([*USUAL, "curve", "push", "track"], ())
    use_zoo(tmp_path, monkeypatch)
    suite = Suite(env=PLAIN_ID, timeline=SHORT)
    assert (labels(suite), suite.config["notes"]) == (USUAL, [])


def known(spec, detector="ewma", **changes):
    suite = small_suite(detectors=(detector,), **changes)
    (judge,) = suite.detector_players
    return describe_knowledge(specify_spoofer(spec), suite.setup(judge), judge)


def test_what_they_were_made_for():
    told = {"run_time": "tracking", "design_time": "ewma, by hand", "detector": "ewma"}
    assert known("track") == {**told, "transfer": []}
    elsewhere = known("curve", "snapshot-chi2", receiver={"tuning": "matched"})
    assert (elsewhere["detector"], elsewhere["transfer"]) == ("ewma", ["detector", "receiver"])
    assert format_target({"knowledge": elsewhere}) == "ewma (transfer: detector, receiver)"
    for changes, transfer in (
        ({"scenario": {"name": "zhong2025", "errors": "groves"}}, ["scenario"]),
        ({"attack": {"name": "false-position", "coherent": False}}, ["attack"]),
        ({"attack": "false-position-ideal"}, []),  # the same by name
    ):
        assert known("push", **changes)["transfer"] == transfer
    tuned = known(RAMP, "snapshot-chi2")
    assert (tuned["detector"], tuned["transfer"]) == ("snapshot-chi2", [])
    assert known("step")["design_time"] == "nothing"
    # what has no card tells for itself
    own = {"name": "profile", "rates_mps": [0.0, 0.3], "designed_on": "a hunch | or two"}
    told = known(own)
    assert (told["detector"], told["design_time"]) == (None, "a hunch | or two")
    assert format_target({"knowledge": told}) == "a hunch | or two"
    # the name of a shipped one does not make it that
    assert card_behind(make_spoofer({**own, "label": "curve"})) is None


def test_two_of_one_label_are_refused():
    curves = [{"name": "profile", "rates_mps": [0.0, rate]} for rate in (0.1, 0.2)]
    with pytest.raises(ValueError, match="listed twice: profile; a `label` of its own tells"):
        small_suite(spoofers=curves)
    curves[1]["label"] = "faster"
    assert labels(small_suite(spoofers=curves)) == ["none", "profile", "faster"]
    curves[1]["label"] = "profile?"  # another label, but the same file
    with pytest.raises(ValueError, match=r"listed twice: profile, profile\?"):
        small_suite(spoofers=curves)
