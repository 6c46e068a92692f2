"""The table of `docs/costs.md`: processor time and memory of commands, and what stored runs took.

python -m tools.costs demo "run, picture"   # measures these rows; without names it writes the table
"""

from __future__ import annotations

import json
import os
import platform
import shlex
import subprocess
import sys
import tempfile
from statistics import median
from typing import Any

from agents.folder import write_json
from spoofgym.bench.report.table import Table
from spoofgym.detectors.calibration_file import FOLDER_VARIABLE
from tools.pages import DOCS, ROOT, marks, put_between

PAGE, DATA_FILE = DOCS / "costs.md", DOCS / "costs.json"
BENCH = "solution-separation:filter=augmented,spacing=geometric"
COMMANDS = {
    "demo": "demo --out {out}/demo.png",
    "run, picture": "run --scenario zhong2025 --detector ewma --out {out}/run.png",
    "audit, quick": "audit snapshot-chi2:signals=range_rate --task D1 --budget quick --out {out}/a",
    "audit, standard": "audit snapshot-chi2:signals=range_rate --task D1 --out {out}/a",
    "limits, 4 worlds": "limits --worlds 4",
    "calibrate, 2000 runs": "calibrate --scenario zhong2025 --detector cusum --runs 2000",
    "bench, quick": "bench --budget quick --detector " + BENCH + " --out {out}/b",
    "bench, standard": "bench --detector " + BENCH + " --out {out}/b",
    "bench, full": "bench --budget full --detector " + BENCH + " --out {out}/b",
}
"""Rows of the table, and the command of each; what has not been measured says so."""
COLUMNS = ("row", "command", "processor time [min]", "memory, largest process [MB]")


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
    read = lambda name: json.loads((DOCS / name).read_text())  # noqa: E731
    papers = [*(path.stem for path in sorted((DOCS / "papers").glob("*.json")))]
    rows = [(f"baselines.papers {key}", read(f"papers/{key}.json")["seconds"]) for key in papers]
    trained = read("learned_spoofers.json")["spoofers"]
    seeds = [x.get("wall_s") for found in trained.values() for x in found["seeds"]]
    rows.append(("train.spoofers, one seed, median", median(x for x in seeds if x)))
    detectors = read("residual.json")["detectors"].values()
    trials = [x for each in detectors for row in each["rows"].values() for x in row["trials"]]
    rows.append(("train.residual_ppo, one seed, median", median(x["wall_s"] for x in trials)))
    return [(f"`python -m {name}", f"{seconds / 60.0:.1f}") for name, seconds in rows]


def build_tables(kept: dict[str, Any]) -> str:
    rows = []
    for name, command in COMMANDS.items():
        found = kept["rows"].get(name)
        figures = ("not measured", "-")
        if found:
            figures = f"{found['cpu_s'] / 60.0:.1f}", str(found["memory_mb"])
        shown = command.partition(" --out {out}")[0]
        rows.append((name, f"`spoofgym {shown}`", *figures))
    measured = Table.of_texts(*COLUMNS).markdown(rows)
    taken = [(name.replace(",", "`,", 1) + "`" * ("," not in name), t) for name, t in read_stored()]
    stored = Table.of_texts("stored results of", "on the clock [min]").markdown(taken)
    return f"Measured on: {kept['machine']}.\n\n{measured}\n\nOf stored results:\n\n{stored}\n"


def main(names: list[str]) -> None:
    kept = json.loads(DATA_FILE.read_text()) if DATA_FILE.exists() else {"rows": {}}
    for name in names:
        kept["rows"][name] = measure(COMMANDS[name])
        with open("/proc/cpuinfo", encoding="utf-8") as stream:
            model = next(x for x in stream if x.startswith("model name")).partition(":")[2].strip()
        machine = f"{model}, {os.cpu_count()} cores, {platform.system()}, other programs running"
        write_json(DATA_FILE, {**kept, "machine": machine}, None)
    put_between(PAGE, *marks("costs"), build_tables(json.loads(DATA_FILE.read_text())))


if __name__ == "__main__":
    os.chdir(ROOT)
    main(sys.argv[1:])
