"""The page on training one's own spoofer: its commands and its code run, with small settings."""

import re
import shlex
import sys
from dataclasses import fields

import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "onnxscript", "tyro", "tensorboard", "cmaes"):
    pytest.importorskip(name)

from agents import curve
from spoofgym import cli
from spoofgym.calibration import thresholds
from train import ppo_spoofer

from .pages import text_of

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")
PAGE = text_of("train_your_own.md")
COMMANDS = "\n".join(re.findall(r"```console\n(.*?)```", PAGE, flags=re.DOTALL)).split("\n")
PROGRAMS = {
    "make": ppo_spoofer.main,  # train
    "train.ppo_spoofer": ppo_spoofer.main,
    "agents.curve": curve.app,
    "spoofgym": cli.main,
}
SMALL = {
    "make": "--steps 200 --num-envs 4 --batch-size 400 --stages 1 --fit-runs 80 --runs 20 "
    "--threads 1 --rivals",
    "bench": "--seeds 4 --training-seeds 60",
}
"""What is appended to a command, and taken from it before."""


def words_of(line):
    """Program of a command of the page and its arguments, with small settings."""
    program, *words = shlex.split(line.removeprefix(".venv/bin/").removeprefix("python -m "))
    if program == "make":
        assert words[0] == "train"
        words = shlex.split(words[1].removeprefix("ARGS="))
    small = shlex.split(SMALL.get(program, SMALL.get(words[0], "")))
    for flag in {word for word in words if word.startswith("--")} & {*small}:
        at = words.index(flag)
        del words[at : at + 2]
    return [program, *words, *small]


@pytest.mark.slow
def test_the_commands_run_in_their_order(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(thresholds, "PASSIVE_RUNS", 3000)
    threads = torch.get_num_threads()
    for line in filter(None, COMMANDS):
        words = words_of(line)
        monkeypatch.setattr(sys, "argv", words)
        try:
            PROGRAMS[words[0]]()
        except SystemExit as end:
            if end.code:
                pytest.fail(f"{line}: {end.code} {capsys.readouterr()}")
    torch.set_num_threads(threads)
    folder = tmp_path / "runs" / "my-first"
    written = {path.name for path in folder.iterdir()}
    assert {"my-first.onnx", "my-first.json", "results.json"} <= written
    assert {"curve.png", "seed.png", "attack.png"} <= written
    assert "my-first" in (folder / "bench" / "results.md").read_text()


def test_every_setting_of_the_table_exists():
    known = {f"--{field.name.replace('_', '-')}" for field in fields(ppo_spoofer.Arguments)}
    for row in re.findall(r"^\| `--.*$", PAGE, flags=re.MULTILINE):
        named = re.findall(r"`(--[a-z-]+)`", row.split("|")[1])
        assert named
        assert set(named) <= known
