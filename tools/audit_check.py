"""Check quick audits by standard ones: ``python -m tools.audit_check D1 --draw 5 --seeds 1 2 3``.

A row says whether the intervals of a quick audit hold the figures of a standard one on other runs.
Detectors that only look share their passes. Killed, it goes on.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spoofgym.bench.experiments.audit import Auditor
from spoofgym.bench.experiments.audit_cells import AuditCells
from spoofgym.bench.experiments.audit_worlds import TRAINED
from spoofgym.bench.experiments.suite import list_task_detectors
from spoofgym.bench.scores.audit import compare_exceeded
from spoofgym.bench.scores.campaign import CONTROLS
from spoofgym.bench.scores.detector import DetectorScore
from spoofgym.bench.scores.scores import SHARES
from spoofgym.cli.app import progress
from spoofgym.core.registry import format_label
from spoofgym.tasks import DetectorTask, get_detector_task

PLAIN_US = 10.0
"""Time for an epoch of a receiver up to which a detector is drawn."""
STANDARD_SEED, DRAW_SEED = 100, 42
Row = dict[str, Any]


def draw_detectors(task: DetectorTask, count: int) -> list[Any]:
    """So many of a task's plain detectors for which a shipped spoofer was made, and as many others.

    Plain ones only look, have thresholds, are no control and take at most `PLAIN_US`.
    """
    worlds = Auditor(task, "quick", entropy=0, threads=1).worlds
    kinds: dict[bool, list[Any]] = {True: [], False: []}
    for spec in list_task_detectors(task.task):
        try:
            (each,) = worlds.build_detectors([spec])
        except ValueError as error:
            print(f"left out: {format_label(spec, None)}: {str(error)[:60]}", file=sys.stderr)
            continue
        worlds.measure_cost(each.judge, 1)  # compiles
        plain = each.passive and worlds.measure_cost(each.judge, 1)[0] <= PLAIN_US
        if plain and spec["name"] not in CONTROLS:
            kinds[bool(worlds.list_attacks(TRAINED, each.player))].append(spec)
    rng = np.random.default_rng(DRAW_SEED)
    drawn = []
    for own in kinds.values():
        chosen = rng.choice(len(own), min(count, len(own)), replace=False)
        drawn += [own[k] for k in sorted(chosen)]
    return drawn


def score(
    task: DetectorTask, specs: Sequence[Any], budget: str, seed: int, out: Path
) -> list[DetectorScore]:
    """Scores by one size, with the family of shipped spoofers."""
    auditor = Auditor(task, budget, entropy=seed, threads=1, folder=out / f"{budget}-{seed}")
    cells = AuditCells(auditor, auditor.worlds.build_detectors(specs))
    return cells.scores(auditor.run(cells, progress))


def list_figures(found: DetectorScore) -> Row:
    """P(HMI), and what is exceeded in shares of the runs, each with its interval."""
    return {
        "p_hmi": found.p_hmi,
        **{f"exceeded_{share:g}": found.estimate_quantile(share) for share in SHARES},
    }


def compare(quick: DetectorScore, standard: DetectorScore) -> Iterator[Row]:
    """A row for each figure; it is held where it lies in the interval as both are printed."""
    others = list_figures(standard)
    for name, one in list_figures(quick).items():
        low, high, value = (float(f"{x:.3g}") for x in (one.low, one.high, others[name].value))
        yield {
            "detector": quick.detector,
            "seed": quick.entropy,
            "figure": name,
            **{f"quick_{x}": getattr(one, x) for x in ("value", "low", "high")},
            **{f"standard_{x}": getattr(others[name], x) for x in ("value", "low", "high")},
            "contains": low <= value and not value > high,
        }


def compare_shipped(found: DetectorScore) -> Row | None:
    """What the worst of all families exceeds less what the worst shipped spoofer does, paired."""
    by_key = {each.family: each.protection for each in found.families}
    shipped = by_key.pop(TRAINED.key, None)
    if shipped is None:
        return None
    half = {each.family: each.estimate_quantile(SHARES[0]).value for each in found.families}
    own = max(by_key, key=lambda key: half[key])
    less = compare_exceeded(by_key[own], shipped, SHARES[0])
    return {"shipped": half[TRAINED.key], "worst": half[own], "family": own, **less._asdict()}


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, [*rows[0]])
        writer.writeheader()
        writer.writerows(rows)


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("task")
    parser.add_argument("--draw", type=int, default=5, help="detectors of either kind")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="of quick audits")
    parser.add_argument("--out", type=Path, default=Path("results/audit-check"))
    given = parser.parse_args(arguments)
    task = get_detector_task(given.task)
    specs = draw_detectors(task, given.draw)
    quick = [score(task, specs, "quick", seed, given.out) for seed in given.seeds]
    standard = score(task, specs, "standard", STANDARD_SEED, given.out)
    rows = [
        row
        for found in quick
        for pair in zip(found, standard, strict=True)
        for row in compare(*pair)
    ]
    write_rows(given.out / "contains.csv", rows)
    for name in dict.fromkeys(row["figure"] for row in rows):
        own = [row["contains"] for row in rows if row["figure"] == name]
        print(f"{name}: {sum(own)} of {len(own)} quick intervals hold the standard figure")
    paired = {each.detector: compare_shipped(each) for each in standard}
    for label, less in paired.items():
        print(label, "no shipped spoofer was made for it" if less is None else less)
    half = [row["contains"] for row in rows if row["figure"] == f"exceeded_{SHARES[0]:g}"]
    behind = [x for x in paired.values() if x is not None and x["high"] < 0.0]
    return int(10 * sum(half) < 9 * len(half) or bool(behind))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
