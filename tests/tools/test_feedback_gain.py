"""The gain of feedback: paired with the blind optimum, feedback may be switched off."""

import json

import pytest

from spoofgym.bench.experiments.evaluate import Evaluator
from tools import feedback_gain
from tools.feedback_gain import FEEDBACK, OFF, OPEN_LOOP, RIDER, TRIED, cases, play_kinds, rows

WORLD = {
    "timeline": {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 2.0},
    "receiver": "matched",
    "detector": {"name": "snapshot-chi2", "signals": "range_rate", "thresholds": "nominal"},
}
CURVE = [0.1, 0.5]


@pytest.fixture(scope="module")
def evaluator():
    return Evaluator(runs=24, fit_runs=80, entropy=3, **WORLD)


@pytest.fixture(scope="module")
def found(evaluator):
    return play_kinds(evaluator, CURVE)


def test_switched_off_it_is_the_curve(monkeypatch, evaluator):
    monkeypatch.setitem(TRIED, FEEDBACK, [])
    off = play_kinds(evaluator, CURVE)
    assert off[FEEDBACK]["settings"] == OFF
    assert off[FEEDBACK]["ratio"] == {"value": 1.0, "low": 1.0, "high": 1.0}


def test_feedback_is_fitted_no_worse_than_the_curve_that_it_follows(found):
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
    given, shown = ["never", "--out", str(tmp_path)], []
    for words in (["--json"], ["--json"], []):
        feedback_gain.main([*given, *words])
        shown.append(capsys.readouterr().out)
        monkeypatch.setattr(feedback_gain, "play_case", None)
    assert shown[0] == shown[1]
    assert json.loads(shown[0])["never"]["room"] is False
    assert "no room" in shown[2]


def test_a_mistake_and_an_interrupt_are_one_line(tmp_path, monkeypatch):
    with pytest.raises(SystemExit, match=r"^error: no detector .* 'nobody'"):
        feedback_gain.main(["nobody"])

    def interrupted(*given):
        raise KeyboardInterrupt

    monkeypatch.setattr(feedback_gain, "play_case", interrupted)
    with pytest.raises(SystemExit, match=r"^interrupted: 0 of 1 cells .*the same command goes on"):
        feedback_gain.main(["never", "--out", str(tmp_path / "out")])
