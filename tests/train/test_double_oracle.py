"""The double oracle, end to end, in a world that takes seconds."""

import json
import sys
from functools import partial

import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
for name in ("stable_baselines3", "onnxscript", "tyro"):
    pytest.importorskip(name)

import spoofgym.tasks
from agents.folder import learning_versions
from spoofgym import duel_v0
from spoofgym.bench.experiments import Store
from spoofgym.calibration import calibrate_detectors
from spoofgym.detectors import make_detector
from spoofgym.detectors.calibration_file import FOLDER_VARIABLE
from spoofgym.tasks import Task
from train import double_oracle
from train.double_oracle import RESULTS, Arguments, DoubleOracle, main, run

from ..spoofers.policies import network, written

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 2.0}
QUICK = {
    "iterations": 2,
    "runs": 6,
    "selection_runs": 4,
    "sift_runs": 2,
    "values": 2,
    "search_runs": 8,
    "generations": 1,
    "detectors": (
        "snapshot-chi2:thresholds=nominal",
        "cusum:thresholds=nominal,signals=range_rate",
    ),
}


@pytest.fixture(autouse=True, scope="module")
def short_task():
    task = Task(
        "T3", "short", {"scenario": "zhong2025", "timeline": SHORT}, ({"name": "ewma"},), 5.0
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(spoofgym.tasks.TASKS, "T3", task)
        yield


def play(out, **changes):
    return run(Arguments(out=out, **{**QUICK, **changes}))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("game") / "whole"


@pytest.fixture(scope="module")
def whole(folder):
    return play(folder)


def test_a_game_grows_and_has_a_page(folder, whole):
    first, last = (each["matrix"] for each in whole["iterations"])
    assert len(last["detectors"]) == len(first["detectors"]) == 2
    labels = [each["label"] for each in last["spoofers"]]
    assert labels[: len(first["spoofers"])] == [each["label"] for each in first["spoofers"]]
    assert "feedback (start)" in labels
    for each in whole["iterations"]:
        assert each["exploitability"]["below"]["value"] is not None
        assert each["matrix"]["split"] == "game"
    make_detector(whole["final"]["pool"])
    page = (folder / "game.md").read_text()
    rows = [line for line in page.splitlines() if line.startswith("| ")]
    last = [line for line in rows if line.startswith("| feedback (start) | oracle |")]
    assert last  # what an oracle reaches is marked
    assert json.loads((folder / RESULTS).read_text()) == json.loads(json.dumps(whole))


@pytest.mark.nightly
def test_a_killed_game_goes_on_to_the_same_result(tmp_path, whole, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(double_oracle, "exploitability", lambda *args: sys.exit(1))
        with pytest.raises(SystemExit):
            play(tmp_path / "killed")
    cells = tmp_path / "killed" / "cells"
    assert [path.stem for path in cells.iterdir()] == ["start"]
    assert play(tmp_path / "killed") == whole
    monkeypatch.setattr(DoubleOracle, "_iterate", None)  # what is finished is not played again
    monkeypatch.setattr(DoubleOracle, "_final", None)
    assert play(tmp_path / "killed") == whole


def test_what_is_not_valid_is_refused(tmp_path, monkeypatch):
    config = {**Arguments(out=tmp_path, **QUICK).config, "runs": 7}
    Store(tmp_path).open("double-oracle", {**config, "versions": learning_versions()})
    with pytest.raises(ValueError, match=r"other results \(config\.runs: 7, not 6\)"):
        play(tmp_path)
    bad = {"task": "T9", "payoff": "gold", "iterations": 0, "detector_command": "python"}
    for name, value in bad.items():
        with pytest.raises(ValueError, match=f"{value}|{name}"):
            Arguments(out=tmp_path, **{name: value})
    with pytest.raises(ValueError, match="detector_command"):
        Arguments(out=tmp_path, detector_response="learned")
    # a detector that is misspelt does not occupy the folder
    words = ["double_oracle", "--out", str(tmp_path / "game"), "--detectors", "cusumm"]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit, match=r"^error: .*cusumm") as found:
        main()
    assert "\n" not in found.value.code
    assert not (tmp_path / "game").exists()


def test_a_policy_that_diverges_takes_no_part_and_stops_no_game(tmp_path, monkeypatch, capsys):
    from stable_baselines3 import PPO

    def diverge(self, steps):
        self.policy.action_net.weight.data.fill_(float("nan"))

    monkeypatch.setattr(PPO, "learn", diverge)
    found = play(tmp_path, iterations=1, search_runs=0, ppo_steps=100)
    assert not any("PPO" in name for name in found["iterations"][0]["best_spoofer"]["best"])
    assert "PPO has diverged against" in capsys.readouterr().out
    assert not list(tmp_path.glob("ppo-*"))


@pytest.mark.nightly
def test_what_learns_enters_on_both_sides(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "calibrations"))
    view = duel_v0.DetectorView(scenario="zhong2025", timeline=SHORT)
    guard = tmp_path / "guard.onnx"
    guard.write_bytes(written(network(view.observation_space.shape[0], view.action_space.shape[0])))
    duel_v0.write_card(guard, view, name="guard")
    script = tmp_path / "write.py"
    script.write_text(
        "import json, pathlib, shutil, sys\n"
        "assert json.load(open(sys.argv[3]))['weights']\n"
        "guard, out = map(pathlib.Path, sys.argv[1:3])\n"
        "for end in ('.onnx', '.json'):\n"
        "    shutil.copy(guard.with_suffix(end), out.with_suffix(end))\n"
    )
    monkeypatch.setattr(double_oracle, "calibrate", partial(calibrate_detectors, runs=60))
    command = f"{sys.executable} {script} {guard} {{out}} {{pool}}"
    torn = tmp_path / "game" / "detector-0.onnx"  # as a kill leaves it, before the card
    learn, train = DoubleOracle._learn, DoubleOracle._train_detector

    def killed(self, mix, turn):
        if turn == 0:
            torn.write_bytes(b"torn")
        return train(self, mix, turn)

    def once(self, mix, turn, file):
        return turn == 1 and learn(self, mix, turn, file)

    monkeypatch.setattr(DoubleOracle, "_train_detector", killed)
    monkeypatch.setattr(DoubleOracle, "_learn", once)
    learned = {"detector_response": "learned", "detector_command": command, "ppo_steps": 100}
    found = play(tmp_path / "game", search_runs=0, false_alarms_per_hour=60.0, **learned)
    assert torn.read_bytes() == guard.read_bytes()
    first, second = found["iterations"]
    labels = [[m["label"] for m in each["matrix"]["detectors"]] for each in (first, second)]
    assert labels[1] == [*labels[0], "learned 0"]
    assert "learned 1" in second["best_detector"]["best"]
    assert {"PPO 1, 0.5", "PPO 1, 0.7", "PPO 1, 1"} <= {*first["best_spoofer"]["best"]}
