"""Every command, recipe and block of code of README and docs, as its reader has it.

Each page is played in a copy of the checkout, by processes of its own, with the default rate of
false alarms and nothing in the user's folders; only compiled code is taken from where it is.
`as_users` has what is made smaller or left out, with its reason.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from baselines.papers.paper import KEYS
from spoofgym.core import compile as compiling
from spoofgym.policies import list_shipped

from .as_users import (
    BESIDE,
    CODE,
    CODE_FIRST,
    COMMANDS,
    NEEDS,
    PAGES,
    SHOWN,
    SMALLER,
    SMALLER_CODE,
    code_of,
    form_of,
    languages_of,
    name_of,
    steps_of,
    with_options,
)
from .pages import ROOT, blocks_of

STEPS = {name_of(page): steps_of(page) for page in PAGES}
PLAYED = [name for name, steps in STEPS.items() if steps]
LEFT_BEHIND = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info")
WRITTEN = {"build", "dist", "results", "runs"}
"""Folders beside the package that commands write, which a fresh checkout does not have."""
GIVEN = {
    "my.onnx": "spoofgym/policies/zoo/ewma-ppo.onnx",
    "my.json": "spoofgym/policies/zoo/ewma-ppo.json",
}
"""Files of the reader's own."""
FLOWN = {
    "flight.json.gz": "adsb_flights/ajaccio.json.gz",
    "brdc.12n": "gnss_broadcast/brdc3050.12n",
    **{
        name: f"ublox_walk/{name}"
        for name in ("walk_rawx.csv.gz", "walk_convbin.nav", "walk_0827_imu_1730_sf.csv.gz")
    },
}
"""Those that are in the folder of real data."""
PLAYER = """
import json, subprocess, sys, time, traceback

failed, scope = 0, {"__name__": "__main__"}
for number, (kind, text) in enumerate(json.load(open(sys.argv[1]))):
    print(f"--- {number}: {text}", flush=True)
    began = time.perf_counter()
    try:
        if kind == "python":
            exec(compile(text, f"block {number}", "exec"), scope)
        elif kind == "command":
            subprocess.run(["bash", "-c", text], check=True, stdin=subprocess.DEVNULL)
        else:
            open(kind, "w").write(text)
    except BaseException:
        failed += 1
        traceback.print_exc()
        print(f"=== {number} FAILED", flush=True)
    print(f"=== {number} {time.perf_counter() - began:.0f} s", flush=True)
sys.exit(bool(failed))
"""
"""Runs the steps of a page in their order, its code in one session; goes on after a failure."""


def checkout(folder: Path) -> dict[str, str]:
    """A copy of the checkout with a `.venv` that make takes for installed; its environment."""
    copy, programs = folder / "checkout", folder / "checkout" / ".venv" / "bin"

    def ignored(at: str, names: list[str]) -> set[str]:
        return {*LEFT_BEHIND(at, names), *(WRITTEN if Path(at) == ROOT else ())}

    shutil.copytree(ROOT, copy, ignore=ignored)
    programs.mkdir(parents=True)
    for name, words in {"python": "", "spoofgym": " -m spoofgym"}.items():
        (programs / name).write_text(f'#!/bin/sh\nexec {sys.executable}{words} "$@"\n')
        (programs / name).chmod(0o755)
    for target in ("bench", "test", "train", "learn"):
        (copy / ".venv" / f".installed-{target}").touch()
    for name, source in GIVEN.items():
        shutil.copy(ROOT / source, copy / name)
    (copy / "runs").mkdir()
    own = {
        key: value
        for key, value in os.environ.items()
        if not key.startswith(("SPOOFGYM_", "PYTEST_", "XDG_"))
    }
    return own | {
        "HOME": str(folder / "home"),
        "MPLBACKEND": "agg",
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(copy),
        compiling.CACHE_VARIABLE: str(compiling.cache_parent()),
    }


def play(folder: Path, environment: dict[str, str], steps: list[tuple[str, str]]) -> None:
    """Run steps and print what they print and how long each takes, which `-rP` shows."""
    (folder / "steps.json").write_text(json.dumps(steps))
    printed = folder / "printed.txt"
    with printed.open("w") as stream:
        done = subprocess.run(
            [sys.executable, "-c", PLAYER, str(folder / "steps.json")],
            cwd=folder / "checkout",
            env=environment,
            stdout=stream,
            stderr=subprocess.STDOUT,
        )
    print(printed.read_text())
    assert done.returncode == 0, printed.read_text()


@pytest.mark.nightly
@pytest.mark.parametrize("name", PLAYED)
def test_everything_on_a_page_runs(name, tmp_path, request):
    environment, steps = checkout(tmp_path), []
    for step in STEPS[name]:
        text = form_of(step.text) if step.kind == "command" else code_of(step.text)
        if text is not None and step.needs not in NEEDS:
            steps.append((step.kind, text))
    for file, source in FLOWN.items():
        if any(file in text for _, text in steps):
            data = request.getfixturevalue("data_folder")
            shutil.copy(data / source, tmp_path / "checkout" / file)
    play(tmp_path, environment, steps)


@pytest.mark.nightly
@pytest.mark.parametrize("name", list_shipped("spoofer"))
def test_the_recipe_plays_every_shipped_spoofer(name, tmp_path):
    (code,) = (code for _, code in blocks_of("train_your_own.md") if "load_card(" in code)
    play(tmp_path, checkout(tmp_path), [(CODE, code.replace("ewma-ppo", name))])


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_no_block_is_left_out_without_a_reason(page):
    assert languages_of(page) <= {CODE, *COMMANDS, *SHOWN}
    fences = len(re.findall(r"^ *```\S", page.read_text(), flags=re.MULTILINE))
    blocks = re.findall(r"^ *```\S+\n.*?^ *```$", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    assert len(blocks) == fences


def test_what_is_declared_is_on_the_pages():
    commands = [
        step.text.removeprefix(".venv/bin/")
        for steps in STEPS.values()
        for step in steps
        if step.kind == "command"
    ]
    for begin in SMALLER:
        assert any(re.match(begin, command) for command in commands), begin
    for part in SMALLER_CODE:
        assert any(part in step.text for steps in STEPS.values() for step in steps), part
    needs = {step.needs for steps in STEPS.values() for step in steps}
    assert {*NEEDS} <= needs
    assert {*SHOWN} <= set().union(*map(languages_of, PAGES))
    assert {*BESIDE, *CODE_FIRST} <= {*PLAYED}


def test_all_papers_are_among_the_commands_and_options_take_the_place_of_others():
    commands = {step.text for steps in STEPS.values() for step in steps}
    assert {f"python -m baselines.papers {key}" for key in KEYS} <= commands
    quick = "python -m baselines.papers all --quick"
    assert quick in commands
    assert form_of(quick) == quick
    line = "python -m x --seeds 5 6 7 --out runs/x --steps 40000"
    smaller = "python -m x --out runs/x --seeds 0 --steps 2"
    assert with_options(line, "--seeds 0 --steps 2") == smaller
