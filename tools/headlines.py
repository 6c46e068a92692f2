"""The table of all detectors in three worlds: played, kept as JSON with its digest, and shown.

    python -m tools.headlines                  # plays what is missing, into results/headlines
    python -m tools.headlines --tables-only    # docs/scores.md again from docs/headlines.json

All detectors work at 0.2 false alarms an hour; ramps, profiles and feedback meet each of them.
Killed, it goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from spoofgym._describe import digest_of
from spoofgym._files import write_file
from spoofgym.bench import tables
from spoofgym.bench.report import markdown_table
from spoofgym.cli.suites import LEFT_OUT
from tools.pages import put_between

DOCS = Path(__file__).resolve().parents[1] / "docs"
KEPT, PAGE = DOCS / "headlines.json", DOCS / "scores.md"
BEGIN, END = "<!-- headlines:begin -->", "<!-- headlines:end -->"
WORLDS = {
    "zhong2025": ["--scenario", "zhong2025"],
    "trolley": ["--scenario", "trolley", "--tuning", "matched"],
    "aviation-actual": ["--scenario", "aviation-actual", "--tuning", "matched"],
}
"""Options of a campaign by world; sky, heading, onset and turn-on constants are drawn for
every run."""
SPOOFERS = ("ramp", "accelerating-ramp", "feedback", "snapshot-chi2-profile")
CURVES = ("p_hmi", "survival")
"""Of a cell, which are not kept; those of the protection are."""
HEAD = (
    "detector",
    "clean alarms [per hour]",
    "exceeded in 50 % [m]",
    "in 5 % [m]",
    "worst skies [m]",
    "worst attack",
    *(f"{name} [m]" for name in SPOOFERS),
    "mark",
)


def options(name: str, sizes: list[str]) -> list[str]:
    """Of the command line, for a world."""
    players = [word for spoofer in SPOOFERS for word in ("--spoofer", spoofer)]
    return ["bench", "--detector", "all", *WORLDS[name], *players, *sizes]


def played(name: str, out: Path, sizes: list[str]) -> dict[str, Any]:
    """Play a world, and return what is kept of it."""
    given = options(name, sizes)
    command = [sys.executable, "-W", "ignore", "-m", "spoofgym", *given]
    done = subprocess.run(
        [*command, "--out", str(out / name), "--json"], check=True, stdout=subprocess.PIPE
    )
    summary = json.loads(done.stdout)
    config = json.loads((out / name / "config.json").read_text())
    wanted = ("campaign", "scenario", "runs", "entropy", "budget", "alert_limit_m", "attack_suite")
    parts = ("detectors", "cells", "protection", "comparisons")
    return {
        "command": " ".join(["spoofgym", *given]),
        "versions": config["versions"],
        "notes": config["notes"],
        "calibrations": config["calibrations"],
        **{key: summary[key] for key in (*wanted, *parts)},
        "cells": [shortened(cell) for cell in summary["cells"]],
    }


def shortened(cell: dict[str, Any]) -> dict[str, Any]:
    """A cell without its curves."""
    return {key: value for key, value in cell.items() if key not in CURVES}


def write_kept(worlds: dict[str, Any]) -> None:
    """Write what is kept."""
    kept = {"digest": digest_of(worlds), "worlds": worlds}
    write_file(KEPT, (json.dumps(kept, allow_nan=False) + "\n").encode())


def shown(kept: dict[str, Any]) -> str:
    """Tables of all worlds, for the page."""
    return "\n".join(line for world in kept["worlds"].values() for line in _lines(world))


def _lines(world: dict[str, Any]) -> Iterator[str]:
    """Heading, table and caption of a world."""
    yield f"### {world['scenario']}"
    yield ""
    for group in tables.groups(world):
        yield from markdown_table(HEAD, list(_rows(world, group)))
    yield ""
    rates = {point["per_run"] for points in world["calibrations"].values() for point in points}
    (per_run,) = rates
    notes = (note.partition(LEFT_OUT) for note in world["notes"])
    left_out = [label for label, found, _ in notes if found]
    yield (
        f"At 0.2 false alarms an hour, {100 * per_run:.3g} % of runs; {world['runs']} runs, "
        f"`{world['command']}`; campaign {world['campaign']}."
        + "".join(f" Left out: {label}." for label in left_out)
    )
    yield ""


def _rows(world: dict[str, Any], group: tables.Group) -> Iterator[tuple[str, ...]]:
    """A row for each detector; of an attack its stealthy displacement."""
    cells = {(cell["detector"], cell["spoofer"].split("(")[0]): cell for cell in world["cells"]}
    for row in tables.detector_rows(world, group):
        label, _, _, per_hour, half, few, skies, worst, mark = row
        attacks = (cells.get((label, name)) for name in SPOOFERS)
        found = ("-" if cell is None else _displacement(cell) for cell in attacks)
        yield (label, per_hour, half, few, skies, worst, *found, mark)


def _displacement(cell: dict[str, Any]) -> str:
    over = "" if cell["within_budget"] else tables.OVER
    return tables.interval(cell["stealthy_displacement_m"]) + over


def main(arguments: list[str]) -> None:
    """Play the three worlds, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("results/headlines"))
    parser.add_argument("--seeds", default="1000", help="evaluation runs of every cell")
    parser.add_argument("--training-seeds", default="256")
    parser.add_argument("--selection-seeds", default="192")
    parser.add_argument("--tables-only", action="store_true", help="play nothing")
    given = parser.parse_args(arguments)
    if not given.tables_only:
        sizes = ["--seeds", given.seeds, "--training-seeds", given.training_seeds]
        sizes += ["--selection-seeds", given.selection_seeds]
        worlds = {name: played(name, given.out, sizes) for name in WORLDS}
        write_kept(worlds)
    put_between(PAGE, BEGIN, END, shown(json.loads(KEPT.read_text())))


if __name__ == "__main__":
    main(sys.argv[1:])
