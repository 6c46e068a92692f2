"""Scores of a spoofer on several sets of runs."""

import json
import shlex

import pytest

import spoofgym.tasks
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.tasks import Task
from tools.refits import RESULTS, list_specs, options, play, table

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 2.0}
QUICK = shlex.split("--task T1 --entropies 3 4 --fit-runs 80 --runs 10 --threads 1 --spoofer dash")


def test_every_set_is_fitted_and_scored_by_itself(tmp_path, monkeypatch):
    met = {"name": "snapshot-chi2", "signals": "range_rate", "thresholds": "nominal"}
    short = Task("T1", "short", {"timeline": SHORT, "receiver": "matched"}, (met,), 5.0)
    monkeypatch.setitem(spoofgym.tasks.TASKS, "T1", short)
    settings = options([*QUICK, "--out", str(tmp_path)])
    found = play(settings)
    rows = found["T1/80"]["spoofers"]
    ramp, dash = rows
    assert (ramp[:4], dash[:4]) == ("ramp", "dash")
    assert [score["of_ramp"]["value"] for score in rows[ramp]] == [1.0, 1.0]
    alone = Evaluator("T1", runs=10, fit_runs=80, entropy=4, threads=1).score("ramp")
    assert rows[ramp][1] == {**alone.as_dict(), "of_ramp": alone.ratio_to(alone).as_json()}
    assert rows[ramp][0]["value"] != rows[ramp][1]["value"]
    assert json.loads((settings.out / RESULTS).read_text()) == found
    monkeypatch.setattr("tools.refits.score_specs", None)  # what is finished is not played again
    assert play(settings) == found


def test_the_table_has_median_range_and_who_is_over_the_budget():
    def score(metres, times, within, knowledge="blind"):
        value = {"value": metres, "low": metres, "high": metres}
        kept = {"within_budget": within, "fit_within_budget": True}
        known = {"knowledge": knowledge, "of_ramp": {"value": times}}
        return {"stealthy_displacement_m": value, **kept, **known}

    three = [score(9.0, 3.0, True), score(2.0, 1.0, True), score(4.0, 2.0, False)]
    for name, scores, shown in (
        ("mine", [score(1.0, None, True)], "| `mine` | 1 | 1.0 [1.0, 1.0] | - |  |"),
        ("mine", three, "| `mine` | 3 | 4.0 [2.0, 9.0] | 2.00 [1.00, 3.00] | 1 |"),
        ("it", [score(1.0, 2.0, True, "oracle")], "| `it` (oracle) |"),
    ):
        case = {"task": "T3", "fit_runs": 256, "spoofers": {name: scores}}
        assert f"| T3 | 256 {shown}" in table({"a": case})


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--entropies 1 1", "`entropies` must be different"),
        ("--task T4", "no learned spoofer is shipped for T4: give `spoofer`"),
        ("--task T9", "unknown task 'T9'"),
    ],
)
def test_bad_options_are_refused(words, message):
    with pytest.raises(ValueError, match=message):
        options(words.split())
    with pytest.raises(ValueError, match="listed twice: dash"):
        list_specs("T1", ["dash", "dash"])
