"""The page on training one's own detector: its commands and its code run, with small settings."""

import re
import shlex
import sys
from typing import Any

import pytest

torch = pytest.importorskip("torch")
for name in ("onnxscript", "tyro"):
    pytest.importorskip(name)

# ruff: noqa: E402 - the packages of the laboratory may be missing
import tyro
from rich.console import Console
from typer.testing import CliRunner

from spoofgym.cli import app
from spoofgym.detectors.calibration_file import FOLDER_VARIABLE
from spoofgym.tasks import TASKS
from train.detector import Arguments, train

from .pages import blocks_of, text_of

PAGE = "train_your_own_detector.md"
COMMANDS = [
    line
    for block in re.findall(r"```console\n(.*?)```", text_of(PAGE), flags=re.DOTALL)
    for line in block.splitlines()
]
TIMES = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 2.0}
RATE = "--false-alarms-per-hour 60"
SMALL = {
    "dataset": "--train 4 --validation 4 --test 4 "
    "--detector solution-separation:thresholds=nominal",
    "calibrate": f"--runs 8 {RATE}",
    "run": f"--no-picture {RATE} "
    + " ".join(f"--{name.replace('_', '-')} {value}" for name, value in TIMES.items()),
    "train.detector": f"--passes 1 --width 8 {RATE}",
}
"""What is appended to a command; the last of an option counts."""
LEARNED = {"solution-separation-ppo": "step:size_m=3", "hidden-pool-ppo": "intermittent"}
"""Spoofers that fit no shorter attack, and who stands in for them."""


def test_its_commands_and_its_code_run(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "calibrations"))
    monkeypatch.setitem(TASKS["T3"].settings, "timeline", TIMES)
    before = torch.get_num_threads()
    for line in COMMANDS:
        words = [LEARNED.get(word, word) for word in shlex.split(line)]
        if words[0] == "spoofgym":
            given = [*words[1:], *shlex.split(SMALL[words[1]])]
            result = CliRunner().invoke(app, given)
            assert result.exit_code == 0, result.output
        else:
            assert words[:3] == ["python", "-m", "train.detector"]
            given = [*words[3:], *shlex.split(SMALL["train.detector"])]
            file = train(tyro.cli(Arguments, args=given), Console(quiet=True))
            assert file.as_posix() == "runs/guard/guard.onnx"
    torch.set_num_threads(before)
    monkeypatch.setattr(sys, "argv", [""])
    for _, code in blocks_of(PAGE):
        exec(compile(code, PAGE, "exec"), {})
