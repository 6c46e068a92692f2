"""The table of `docs/costs.md`: processor time and memory of commands, and what stored runs took.

python -m tools.costs demo "run, picture"   # measures these rows; without names it writes the table
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shlex
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from statistics import median
from typing import Any

from agents.folder import write_json
from spoofgym.bench.report.table import Table
from spoofgym.core.registry import check_choice
from spoofgym.detectors.calibration_file import FOLDER_VARIABLE
from tools.pages import DOCS, ROOT, marks, put_between

PAGE, DATA_FILE = DOCS / "costs.md", DOCS / "costs.json"
COMMANDS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text())


def measure(command: str) -> dict[str, Any]:
    """Run a command with no results of its own; what it and its children took."""
    with tempfile.TemporaryDirectory() as out:
        words = shlex.split(command.format(out=out))
        process = subprocess.Popen(
            [sys.executable, "-W", "ignore", "-m", "spoofgym", *words],
            env={**os.environ, FOLDER_VARIABLE: out},
            cwd=out,
            stdout=subprocess.DEVNULL,
        )
        _, status, used = os.wait4(process.pid, 0)
        if status:
            raise SystemExit(f"{command!r} failed")
    return {"cpu_s": round(used.ru_utime + used.ru_stime, 1), "memory_mb": used.ru_maxrss // 1024}


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
        cpu_s, memory_mb = kept["rows"].get(name, {"cpu_s": None, "memory_mb": "-"}).values()
        minutes = "not measured" if cpu_s is None else f"{cpu_s / 60.0:.1f}"
        shown = f"`spoofgym {command.partition(' --out {out}')[0]}`"
        rows.append((name, shown, minutes, str(memory_mb)))
    measured = Table.of_texts("row", "command", "CPU [min]", "largest process [MB]").markdown(rows)
    stored = Table.of_texts("computed by", "on the clock [min]").markdown(read_stored())
    head = "On the clock, when the stored results were computed, on the machine of that day:"
    return f"Measured on: {kept['machine']}.\n\n{measured}\n\n{head}\n\n{stored}\n"


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("rows", nargs="*", help=f"what is measured: {', '.join(COMMANDS)}")
    names = parser.parse_args(arguments).rows
    for name in names:
        check_choice("row", name, COMMANDS)
    kept = json.loads(DATA_FILE.read_text()) if DATA_FILE.exists() else {"rows": {}}
    for name in names:
        kept["rows"][name] = measure(COMMANDS[name])
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(x for x in lines if x.startswith("model name")).partition(": ")[2]
        machine = f"{model}, {os.cpu_count()} cores, {platform.system()}, other programs running"
        write_json(DATA_FILE, {**kept, "machine": machine}, None)
    put_between(PAGE, *marks("costs"), build_tables(json.loads(DATA_FILE.read_text())))


if __name__ == "__main__":
    os.chdir(ROOT)
    main(sys.argv[1:])
