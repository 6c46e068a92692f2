"""`spoofgym game`: the matrix, both mixes, and what it refuses."""

import json

import pytest

import spoofgym.tasks
from spoofgym.bench.experiments.game import Game
from spoofgym.tasks import Task

from .command_line import call

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 2.0}
CHI2, CUSUM = "snapshot-chi2:thresholds=nominal", "cusum:thresholds=nominal,signals=range_rate"
COMMAND = ("game", "--task", "T3", "--detector", CHI2, "--detector", CUSUM, "--runs", "4")
RAMP = ("--spoofer", "ramp")


@pytest.fixture(autouse=True)
def short_task(monkeypatch):
    task = Task("T3", "short", {"timeline": SHORT}, ({"name": "ewma"},), 5.0)
    monkeypatch.setitem(spoofgym.tasks.TASKS, "T3", task)


def test_json_is_the_matrix_and_its_equilibrium_also_of_shards(tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    line = (*COMMAND, "--spoofer", "none", "--spoofer", "ramp:rate_mps=0.2", "--json", "--out")
    printed = call(*line, whole).stdout
    matrix = Game("T3", runs=4, folder=whole).matrix(
        ["none", {"name": "ramp", "rate_mps": 0.2}],
        [
            {"name": "snapshot-chi2", "thresholds": "nominal"},
            {"name": "cusum", "signals": "range_rate", "thresholds": "nominal"},
        ],
    )
    assert len(list(whole.glob("cells/*.npz"))) == 4
    expected = {**matrix.as_json(), "equilibrium": matrix.spread().as_json()}
    assert json.loads(printed) == json.loads(json.dumps(expected))
    # each meets both detectors in one pass
    first, second = (call(*line, parts, "--shard", f"{i}/2") for i in (1, 2))
    assert (first.exit_code, first.stdout) == (0, "")
    assert "shard 1/2 is finished; cells left by others" in first.stderr
    assert second.stdout == printed


def test_the_table_says_what_each_spoofer_observes():
    shown = call(*COMMAND, *RAMP, "--spoofer", "feedback", "--oracles").stdout
    assert "a pure pair solves it" in shown
    assert [line.split()[1] for line in shown.splitlines() if " feedback " in line] == ["oracle"]


def test_wrong_input_is_named(tmp_path):
    (tmp_path / "3f2a.npz").touch()
    for more, message in (
        ([*RAMP, "--spoofer", "feedback"], "oracle"),
        ([*RAMP, "--out", tmp_path], "holds no config.json of an experiment (3f2a.npz)"),
        ([*RAMP, "--jobs", "2"], "need a folder of results: --out"),
        (["--spoofer", "rmap"], "rmap"),
        ([*RAMP, "--payoff", "gold"], "'stealth' or 'hmi', got 'gold'"),
    ):
        result = call(*COMMAND, *more)
        assert (result.exit_code, len(result.stderr.splitlines())) == (2, 1)
        assert message in result.stderr
