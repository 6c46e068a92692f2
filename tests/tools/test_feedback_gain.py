"""The gain of feedback: paired with the open-loop attack, feedback may be switched off."""

import json

import pytest

from spoofgym.bench.experiments.evaluate import Evaluator
from tools import feedback_gain
from tools.feedback_gain import FEEDBACK, OFF, OPEN_LOOP, RIDER, TRIED, cases, play_kinds, rows

WORLD = {
    "scenario": "zhong2025",
    "timeline": {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 2.0},
    "receiver": "matched",
    "detector": {"name": "snapshot-chi2", "signals": "range_rate", "thresholds": "nominal"},
}
CURVE = [0.1, 0.5]


def test_feedback_is_fitted_no_worse_than_the_curve_that_it_follows(monkeypatch):
    judge = Evaluator(runs=24, fit_runs=80, entropy=3, **WORLD)
    found = play_kinds(judge, CURVE)
    training = found[FEEDBACK]["training_m"]
    assert len(training) == len(TRIED[FEEDBACK]) + 1
    assert max(training.values()) >= found[OPEN_LOOP]["training_m"][""] > 0.0
    assert training[feedback_gain._words(found[FEEDBACK]["settings"])] == max(training.values())
    # a row names what it knows and whether it keeps the budget
    told = {**found, "room": True, "bound": {"value": 5.0, "kind": "exact"}}
    lines = rows("mine", told)
    assert [line[2] for line in lines] == [f"{FEEDBACK} (oracle)", f"{RIDER} (oracle)"]
    assert all(line[-1] == "5.0" for line in lines)
    assert "*" in rows("mine", {**told, RIDER: {**found[RIDER], "within_budget": False}})[1][4]
    # switched off it is the curve
    monkeypatch.setattr(feedback_gain, "TRIED", {OPEN_LOOP: [{}], FEEDBACK: []})
    off = play_kinds(judge, CURVE)[FEEDBACK]
    assert (off["settings"], off["ratio"]) == (OFF, {"value": 1.0, "low": 1.0, "high": 1.0})


def test_the_headlines_give_curve_bound_and_room():
    (case,) = cases(["aime(signals"]).values()
    assert case["room"]
    assert len(case["rates_mps"]) > 2
    assert case["bound"]["value"] > case["blind_m"]["value"]
    assert not cases(["never"])["never"]["room"]
    with pytest.raises(ValueError, match=r"no detector of headlines\.json has 'nobody'"):
        cases(["nobody"])


def test_what_has_no_room_is_not_played_and_what_is_kept_neither(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(feedback_gain, "Evaluator", None)
    shown = []
    for words in (["--json"], ["--json"], []):
        feedback_gain.main(["never", "--out", str(tmp_path / "out"), *words])
        shown.append(capsys.readouterr().out)
        monkeypatch.setattr(feedback_gain, "play_case", None)
    assert shown[0] == shown[1]
    assert json.loads(shown[0])["never"]["room"] is False
    assert "no room" in shown[2]
    with pytest.raises(SystemExit, match=r"^error: no detector .* 'nobody'"):
        feedback_gain.main(["nobody"])
