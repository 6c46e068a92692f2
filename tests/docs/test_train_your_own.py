"""The page on training one's own spoofer: its commands and its code run, with small settings."""

import json
import os
import re
import shlex
import subprocess
import sys
import types
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "onnxscript", "tyro", "tensorboard", "cmaes"):
    pytest.importorskip(name)

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")
ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "train_your_own.md").read_text()
CODE = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
COMMANDS = [
    line
    for block in re.findall(r"```console\n(.*?)```", PAGE, flags=re.DOTALL)
    for line in block.splitlines()
]
SMALL = {
    "train.ppo_spoofer": "--steps 200 --num-envs 4 --batch-size 400 --stages 1 --fit-runs 80 "
    "--runs 20 --threads 1 --rivals",
    "bench": "--seeds 4 --training-seeds 60",
}
"""What is appended to a command; the last of an option counts."""
IN_ONE_PROCESS = """
import json, runpy, sys
from spoofgym.calibration import thresholds

thresholds.PASSIVE_RUNS = 3000
for words in json.load(sys.stdin):
    sys.argv = words
    try:
        runpy.run_module(words[0], run_name="__main__", alter_sys=True)
    except SystemExit as end:
        if end.code:
            sys.exit(f"{' '.join(words)}: {end.code}")
"""
"""Runs modules as ``python -m`` does; libraries are loaded once, which takes longest."""


def words_of(line: str) -> list[str]:
    """Module of a command of the page and its arguments, with small settings."""
    words = shlex.split(line)
    if words[:2] == ["make", "train"]:
        given = shlex.split(words[2].removeprefix("ARGS="))
        words = [".venv/bin/python", "-m", "train.ppo_spoofer", *given]
    if words[0] == ".venv/bin/spoofgym":
        words[:1] = [".venv/bin/python", "-m", "spoofgym"]
    assert words[:2] == [".venv/bin/python", "-m"], line
    small = shlex.split(SMALL.get(words[2], SMALL.get(words[3], "")))
    flags = [word for word in words if word.startswith("--") and word in small]
    for flag in flags:  # typer would take the last one of two; tyro refuses two
        at = words.index(flag)
        del words[at : at + 2]
    return [*words[2:], *small]


@pytest.mark.slow
def test_the_commands_run_in_their_order(tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    commands = [words_of(line) for line in COMMANDS]
    done = subprocess.run(
        [sys.executable, "-c", IN_ONE_PROCESS],
        input=json.dumps(commands),
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=3600,
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    folder = tmp_path / "runs" / "my-first"
    written = {path.name for path in folder.iterdir()}
    assert {"my-first.onnx", "my-first.json", "results.json"} <= written
    assert {"curve.png", "seed.png", "attack.png"} <= written
    assert "my-first" in (folder / "bench" / "results.md").read_text()


@pytest.mark.parametrize("number", range(len(CODE)))
def test_every_block_of_code_runs(number, monkeypatch):
    threads = torch.get_num_threads()
    module = types.ModuleType("page")
    monkeypatch.setitem(sys.modules, "page", module)  # pickle looks classes up
    exec(compile(CODE[number], f"train_your_own.md block {number}", "exec"), module.__dict__)
    torch.set_num_threads(threads)


def test_every_setting_of_the_table_exists():
    from dataclasses import fields

    from train.ppo_spoofer import Arguments

    known = {f"--{field.name.replace('_', '-')}" for field in fields(Arguments)}
    for row in re.findall(r"^\| `--.*$", PAGE, flags=re.MULTILINE):
        named = re.findall(r"`(--[a-z-]+)`", row.split("|")[1])
        assert named
        assert set(named) <= known
