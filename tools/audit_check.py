"""Check quick audits by standard ones: ``python -m tools.audit_check D1 aime raim``.

A row says whether the interval of a quick audit holds the figure of a standard one on other runs.
Killed, it goes on; the least costly detectors come first.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from spoofgym.bench.experiments.audit import Auditor, audit
from spoofgym.bench.experiments.suite import list_task_detectors
from spoofgym.bench.scores.scores import SHARES
from spoofgym.cli.app import progress
from spoofgym.core.registry import format_label
from spoofgym.tasks import DetectorTask, get_detector_task

HALF = f"{SHARES[0]:g}"
SIZES = ("quick", "standard")
Row = dict[str, Any]


def list_costs(task: DetectorTask, names: list[str]) -> list[tuple[float, Any]]:
    """Detectors of a task by their time for an epoch [us]; those without thresholds are left
    out, by name."""
    worlds, found = Auditor(task, "quick", entropy=0, threads=1).worlds, []
    for spec in list_task_detectors(task.task):
        if not names or spec["name"] in names:
            try:
                (each,) = worlds.build_detectors([spec])
            except ValueError as error:
                print(f"left out: {format_label(spec, None)}: {str(error)[:60]}", file=sys.stderr)
            else:
                found.append((worlds.measure_cost(each.judge, 1)[0], spec))
    return sorted(found, key=lambda each: each[0])


def check_detector(task: DetectorTask, spec: Any, out: Path) -> Row:
    """What is exceeded in half of the runs, by both sizes, and whether the interval holds."""
    sizes: dict[str, dict[str, Any]] = {
        size: {"folder": out / size, "threads": 1} for size in SIZES
    }
    found = {size: audit(spec, task, size, progress=progress, **x) for size, x in sizes.items()}
    row: Row = {size: each.figures["exceeded_m"][HALF] for size, each in found.items()}
    quick, value = row["quick"], row["standard"]["value"]
    contains = quick["low"] <= value <= quick["high"]
    return {"detector": found["quick"].score.detector, **row, "contains": contains}


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("task")
    parser.add_argument("detectors", nargs="*", help="names; by default all with thresholds")
    parser.add_argument("--out", type=Path, default=Path("results/audit-check"))
    given = parser.parse_args(arguments)
    task, rows = get_detector_task(given.task), list[Row]()
    for _, spec in list_costs(task, given.detectors):
        rows.append(check_detector(task, spec, given.out))
        print(json.dumps(rows[-1]), flush=True)
    return int(10 * sum(row["contains"] for row in rows) < 9 * len(rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
