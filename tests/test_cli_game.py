"""`spoofgym game`: the matrix, both mixes, and what it refuses."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

import spoofgym.tasks
from spoofgym.bench.experiments.game import Game
from spoofgym.cli import app
from spoofgym.tasks import Task

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 2.0}
CHI2, CUSUM = "snapshot-chi2:thresholds=nominal", "cusum:thresholds=nominal,signals=range_rate"


@pytest.fixture(autouse=True)
def short_task(monkeypatch):
    task = Task("T3", "short", {"timeline": SHORT}, ({"name": "ewma"},), 5.0)
    monkeypatch.setitem(spoofgym.tasks.TASKS, "T3", task)


def called(*more):
    command = ["game", "--task", "T3", "--detector", CHI2, "--detector", CUSUM, "--runs", "4"]
    return CliRunner().invoke(app, [*command, *more])


def test_json_is_the_matrix_and_its_equilibrium(tmp_path):
    spoofers = ("--spoofer", "none", "--spoofer", "ramp:rate_mps=0.2")
    found = json.loads(called(*spoofers, "--json", "--out", str(tmp_path)).stdout)
    matrix = Game("T3", runs=4, folder=tmp_path).matrix(
        ["none", {"name": "ramp", "rate_mps": 0.2}],
        [
            {"name": "snapshot-chi2", "thresholds": "nominal"},
            {"name": "cusum", "signals": "range_rate", "thresholds": "nominal"},
        ],
    )
    assert len(list(tmp_path.glob("cells/*.npz"))) == 4
    assert found == json.loads(
        json.dumps({**matrix.as_json(), "equilibrium": matrix.spread().as_json()})
    )


def test_the_table_says_what_each_spoofer_observes():
    refused = called("--spoofer", "ramp", "--spoofer", "feedback")
    assert refused.exit_code == 2
    assert "oracle" in refused.stderr
    shown = called("--spoofer", "ramp", "--spoofer", "feedback", "--oracles").stdout
    assert "a pure pair solves it" in shown
    assert [line.split()[1] for line in shown.splitlines() if " feedback " in line] == ["oracle"]


def test_shards_fill_one_folder(tmp_path):
    spoofers = ("--spoofer", "ramp", "--spoofer", "step")  # each meets both detectors in one pass
    parts = [(*spoofers, "--out", str(tmp_path), "--shard", f"{i}/2") for i in (1, 2)]
    first, second = (called(*part, "--json") for part in parts)
    assert (first.exit_code, first.stdout) == (0, "")
    assert "shard 1/2 is finished; others leave" in first.stderr
    assert second.stdout == called(*spoofers, "--json").stdout


def test_wrong_input_is_named(tmp_path):
    (tmp_path / "3f2a.npz").touch()
    old = called("--spoofer", "ramp", "--out", str(tmp_path))
    assert (old.exit_code, len(old.stderr.splitlines())) == (2, 1)
    assert "holds no config.json of an experiment (3f2a.npz)" in old.stderr
    assert "need a folder of results: --out" in called("--spoofer", "ramp", "--jobs", "2").stderr
    assert "rmap" in called("--spoofer", "rmap").stderr
    assert (
        "'stealth' or 'hmi', got 'gold'" in called("--spoofer", "ramp", "--payoff", "gold").stderr
    )
