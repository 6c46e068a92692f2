"""Transfer: what is fitted at home is played as it is, what is refitted keeps the budget there."""

import json
from dataclasses import replace

import pytest

from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.tasks import get_task
from tools import transfer
from tools.transfer import evaluators, line, table

TIMES = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 2.0}
SHARP = {"name": "snapshot-chi2", "signals": "range_rate", "thresholds": "nominal"}
CHANGES = {
    "home": {"timeline": TIMES, "receiver": "matched", "detector": SHARP},
    "blunt": {"timeline": TIMES, "receiver": "matched", "detector": {"name": "never"}},
}

SIZES = {"runs": 24, "fit_runs": 80, "entropy": 3}


RAMP = [({"name": "ramp"}, None)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("transfer")


@pytest.fixture(scope="module")
def rows(folder):
    found = table(evaluators("T1", CHANGES, **SIZES), RAMP, folder)
    assert len(found) == 4
    return {(row["home"], row["world"]): row for row in found}


def test_amplitudes_are_refitted_or_those_of_home_and_what_is_kept_is_not_played_again(
    rows, folder, monkeypatch
):
    for home in CHANGES:
        for kind in ("as fitted at home", "refitted"):
            found = rows[home, home][kind]
            assert found["of_native"] == {"value": 1.0, "low": 1.0, "high": 1.0}
            assert found["value"] == rows[home, home]["refitted"]["value"]
    # refitted a ramp is the native one, since its rate is all that there is to train
    row = rows["home", "blunt"]
    assert row["refitted"]["of_native"]["value"] == 1.0
    assert row["as fitted at home"]["of_native"]["high"] < 1.0
    assert row["as fitted at home"]["value"] == rows["home", "home"]["refitted"]["value"]
    # a budget that is broken elsewhere is marked
    row = rows["blunt", "home"]
    assert not row["as fitted at home"]["within_budget"]
    words = line(row)
    assert words[0] == "ramp(tuned) (blind)"
    assert ["over the budget" in word for word in words[3:5]] == [True, False]
    monkeypatch.setattr(Evaluator, "score", None)
    monkeypatch.setattr(Evaluator, "fit", None)
    worlds = evaluators("T1", CHANGES, **SIZES, threads=1)
    assert table(worlds, RAMP, folder) == list(rows.values())


def test_one_that_was_trained_in_a_world_has_that_home_alone(folder, rows, monkeypatch, capsys):
    own = {**get_task("T1").settings, "timeline": TIMES, "receiver": "matched"}
    short = replace(get_task("T1"), settings=own, detectors=(SHARP,))
    monkeypatch.setattr(transfer, "HOME", "first")
    monkeypatch.setattr(transfer, "get_task", lambda key: short)
    given = ["--out", str(folder), "--runs", "24", "--fit-runs", "80", "--seed", "3", "--json"]
    world = f"blunt={json.dumps(CHANGES['blunt'])}"
    transfer.main([*given, "--world", world, "--spoofer", "ramp@first"])
    found = json.loads(capsys.readouterr().out)
    where = [(each["home"], each["world"]) for each in found]
    assert where == [("first", "first"), ("first", "blunt")]
    assert found[1]["refitted"] == rows["home", "blunt"]["refitted"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["ramp", "--world", "blunt={"], "must be NAME=JSON"),
        (["ramp", "--world", "blunt=[1]"], "with an object of settings"),
        (["ramp@moon"], "moon.*home"),
    ],
)
def test_a_mistake_says_what_is_wanted(words, message):
    with pytest.raises(SystemExit, match=f"^error: .*{message}"):
        transfer.main(["--spoofer", *words])
