"""The table of `docs/costs.md`: processor time and memory of commands, and what stored runs took.

python -m tools.costs demo "run, picture"   # measures these rows; without names it writes the table
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import shlex
import subprocess
import sys
import tempfile
import time
import timeit
import tomllib
from pathlib import Path
from statistics import median
from typing import Any

from agents.folder import write_json
from spoofgym.bench.report.table import Table
from spoofgym.core.registry import check_choice
from spoofgym.detectors.calibration_file import FOLDER_VARIABLE
from tools.pages import DOCS, ROOT, fit_tables, marks, put_between

LOOP = "for k in range(20_000_000): k += 1"
"""What says how fast a machine is."""
PAGE, DATA_FILE = DOCS / "costs.md", DOCS / "costs.json"
COMMANDS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text())


def play(words: list[str], folder: str) -> tuple[dict[str, Any], list[str]]:
    """Run Python in a folder, with nothing calibrated before: what it and its children took, and
    the lines that it printed."""
    process = subprocess.Popen(
        [sys.executable, "-W", "ignore", *words],
        env={**os.environ, FOLDER_VARIABLE: folder},
        cwd=folder,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    with process.stdout as stdout:
        printed = stdout.read().splitlines()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)  # it can't be waited for again
    if process.returncode:
        raise SystemExit(f"{shlex.join(words)!r} failed")
    took = {"cpu_s": round(used.ru_utime + used.ru_stime, 1), "memory_mb": used.ru_maxrss // 1024}
    return took, printed


def measure(command: str) -> dict[str, Any]:
    """What a command with no results of its own takes, and the time of `LOOP` beside it."""
    with tempfile.TemporaryDirectory() as out:
        loop_s = timeit.timeit(LOOP, number=1, timer=time.process_time)
        took = play(["-m", "spoofgym", *shlex.split(command.format(out=out))], out)[0]
        return {**took, "loop_s": round(loop_s, 1)}


def read_processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next(x for x in lines if x.startswith("model name")).partition(": ")[2]


def read_stored() -> list[tuple[str, str]]:
    """Command, and what its stored results took on the clock of the machine they are from [min]."""
    papers = sorted((DOCS / "papers").glob("*.json"))
    took = {f"baselines.papers {x.stem}`": json.loads(x.read_text())["seconds"] for x in papers}
    trained = json.loads((DOCS / "learned_spoofers.json").read_text())["spoofers"].values()
    seeds = [x["wall_s"] for found in trained for x in found["seeds"] if x.get("wall_s")]
    took["train.spoofers`, median of a seed"] = median(seeds)
    return [(f"`python -m {name}", f"{seconds / 60.0:.1f}") for name, seconds in took.items()]


def build_tables(kept: dict[str, Any]) -> str:
    rows = []
    for name, command in COMMANDS.items():
        took = {"cpu_s": None, "memory_mb": "-", "loop_s": "-", **kept["rows"].get(name, {})}
        cpu_s, *rest = took.values()
        minutes = "not measured" if cpu_s is None else f"{cpu_s / 60.0:.1f}"
        shown = f"`spoofgym {re.sub(' --out {out}.*|{out}/', '', command)}`"
        rows.append((name, shown, minutes, *map(str, rest)))
    head = "row", "command", "CPU [min]", "largest process [MB]", "loop [s]"
    measured = fit_tables(Table.of_texts(*head).markdown(rows) + "\n").rstrip()
    stored = Table.of_texts("computed by", "on the clock [min]").markdown(read_stored())
    second = "On the clock, when the stored results were computed, on the machine of that day:"
    return f"Measured on: {kept['machine']}.\n\n{measured}\n\n{second}\n\n{stored}\n"


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("rows", nargs="*", help=f"what is measured: {', '.join(COMMANDS)}")
    names = parser.parse_args(arguments).rows
    for name in names:
        check_choice("row", name, COMMANDS)
    kept = json.loads(DATA_FILE.read_text()) if DATA_FILE.exists() else {"rows": {}}
    for name in names:
        kept["rows"][name] = measure(COMMANDS[name])
        cores = f"{os.cpu_count()} cores, {platform.system()}, other programs running"
        write_json(DATA_FILE, {**kept, "machine": f"{read_processor()}, {cores}"}, None)
    put_between(PAGE, *marks("costs"), build_tables(json.loads(DATA_FILE.read_text())))


if __name__ == "__main__":
    os.chdir(ROOT)
    main(sys.argv[1:])
