"""The tables of all detectors in three worlds: played, kept as JSON with their digest, and shown.

    python -m tools.headlines                  # plays what is missing, into results/headlines
    python -m tools.headlines --world trolley  # one of them; the others stay as they are kept
    python -m tools.headlines --limits-only    # floors and zero-alarm bounds again, of a --world
    python -m tools.headlines --tables-only    # docs/scores.md again from docs/headlines.json

All detectors work at 0.2 false alarms an hour; ramps, profiles, blind optima and feedback meet each
of them.  Their bracket is shown with what was achieved.
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

from spoofgym.bench.report import table as tables
from spoofgym.bench.report.bounds import floor_notes
from spoofgym.bench.report.campaign import markdown_table
from spoofgym.bench.scores.campaign import bracket_of
from spoofgym.cli.bench import LEFT_OUT, standard_suite
from spoofgym.core.files import write_file
from spoofgym.core.settings import digest_of
from spoofgym.spoofers.base import sees_statistics
from tools.pages import put_between

DOCS = Path(__file__).resolve().parents[1] / "docs"
KEPT, PAGE = DOCS / "headlines.json", DOCS / "scores.md"
BEGIN, END = "<!-- headlines:begin -->", "<!-- headlines:end -->"
WORLDS = {
    "trolley": ["--suite", "standard"],
    "zhong2025": ["--scenario", "zhong2025"],
    "aviation-actual": ["--scenario", "aviation-actual", "--tuning", "matched"],
}
"""Options of a campaign by world; sky, heading, onset and turn-on constants are drawn for
every run."""
SPOOFERS = ("ramp", "accelerating-ramp", "feedback", "snapshot-chi2-profile", "blind-optimum")
CURVES = ("p_hmi", "survival")
"""Of a cell, which are not kept; those of the protection are."""
COLUMNS = {
    "detector": "detector",
    "clean alarms [per hour]": "measured: per hour",
    "floor of 50 % [m]": "floor of 50 % [m]",
    "exceeded in 50 % [m]": "exceeded in 50 % [m]",
    "in 5 % [m]": "in 5 % [m]",
    "worst skies [m]": "worst skies, in 50 % [m]",
    "worst attack": "worst attack",
    "floor, stealthy [m]": "floor, stealthy [m]",
    "zero-alarm bound [m]": "zero-alarm bound [m]",
}
"""Columns of the table before those of the attacks, and what they are in the campaign's."""
NO_LIMITS: dict[str, Any] = {"floor": None, "zero_alarm": {}}
"""Of a world that was played before there were any."""


def options(name: str, sizes: list[str]) -> list[str]:
    """Of the command line, for a world."""
    if "--suite" in WORLDS[name]:
        return ["bench", *WORLDS[name]]
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
    parts = ("detectors", "cells", "protection", "comparisons", "limits")
    return {
        "command": " ".join(["spoofgym", *given]),
        "versions": config["versions"],
        "notes": config["notes"],
        "calibrations": config["calibrations"],
        **{key: summary[key] for key in (*wanted, *parts)},
        "cells": [shortened(cell) for cell in summary["cells"]],
    }


def with_limits(world: dict[str, Any]) -> dict[str, Any]:
    """A standard suite that is kept, with its limits computed again: they need no run."""
    suite = standard_suite(None, {"spoofers": []})
    brackets = suite.brackets()
    bounds = {}
    for entry in suite.detector_entries:
        if entry.label in {row["detector"] for row in world["detectors"]}:
            print(entry.label, flush=True)
            bounds[entry.label] = brackets.zero_alarm(entry).as_json()
    limits = {"floor": brackets.floor(), "zero_alarm": bounds}
    bare = [{key: x for key, x in row.items() if key != "bracket"} for row in world["detectors"]]
    return {
        **world,
        "limits": limits,
        "detectors": _bracketed({**world, "detectors": bare}, limits),
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
    limits = world.get("limits", NO_LIMITS)
    world = {**world, "limits": limits, "detectors": _bracketed(world, limits)}
    columns = [name for name in COLUMNS if limits["floor"] or " bound" not in name]
    columns = [name for name in columns if limits["floor"] or "floor" not in name]
    met = {_plain(cell): cell["knowledge"]["run_time"] for cell in world["cells"]}
    spoofers = [name for name in SPOOFERS if name in met]
    spoofers.sort(key=lambda name: sees_statistics(met[name]))  # oracles come last
    head = [*columns, *(f"{tables.titled(name, met[name])} [m]" for name in spoofers), "mark"]
    for group in tables.groups(world):
        yield from markdown_table(head, list(_rows(world, group, columns, spoofers)))
    yield ""
    if limits["floor"]:
        yield from floor_notes(world)
        yield ""
    rates = {point["per_run"] for points in world["calibrations"].values() for point in points}
    (per_run,) = rates
    notes = (note.partition(LEFT_OUT) for note in world["notes"])
    left_out = [label for label, found, _ in notes if found]
    yield (
        f"At 0.2 false alarms an hour, {100 * per_run:.3g} % of runs; {world['runs']} runs, "
        f"`{world['command']}`; attack suite {_suite(world)}; campaign {world['campaign']}."
        + "".join(f" Left out: {label}." for label in left_out)
    )
    yield ""


def _suite(world: dict[str, Any]) -> str:
    """Name and version of the attack suite that was played."""
    found = world["attack_suite"]
    return f"`{found['name']}` {found['version']}"


def _bracketed(world: dict[str, Any], limits: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of the detectors with their brackets."""
    found = []
    for row in world["detectors"]:
        own = {
            part: [each for each in world[part] if each["detector"] == row["detector"]]
            for part in ("cells", "protection")
        }
        worst = next(iter(own["protection"]), None)
        found.append({"bracket": bracket_of(row, limits, own["cells"], worst, ()), **row})
    return found


def _plain(cell: dict[str, Any]) -> str:
    """Name of a cell's spoofer."""
    return str(cell["spoofer"]).split("(")[0]


def _rows(
    world: dict[str, Any], group: tables.Group, columns: list[str], spoofers: list[str]
) -> Iterator[tuple[str, ...]]:
    """A row for each detector; of an attack its stealthy displacement."""
    cells = {(cell["detector"], _plain(cell)): cell for cell in world["cells"]}
    places = [tables.DETECTORS_HEAD.index(COLUMNS[name]) for name in columns]
    for row in tables.detector_rows(world, group):
        attacks = (cells.get((row[0], name)) for name in spoofers)
        found = ("-" if cell is None else _displacement(cell) for cell in attacks)
        yield (*(row[k] for k in places), *found, row[-1])


def _displacement(cell: dict[str, Any]) -> str:
    over = "" if cell["within_budget"] else tables.OVER
    return tables.interval(cell["stealthy_displacement_m"]) + over


def main(arguments: list[str]) -> None:
    """Play the three worlds, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("results/headlines"))
    parser.add_argument("--world", choices=WORLDS, action="append", help="by default all")
    parser.add_argument("--seeds", default="1000", help="evaluation runs of every cell")
    parser.add_argument("--training-seeds", default="256")
    parser.add_argument("--selection-seeds", default="192")
    parser.add_argument("--tables-only", action="store_true", help="play nothing")
    parser.add_argument("--limits-only", action="store_true", help="of a standard suite")
    given = parser.parse_args(arguments)
    if given.limits_only:
        worlds = json.loads(KEPT.read_text())["worlds"]
        for name in given.world or []:
            worlds[name] = with_limits(worlds[name])
            write_kept({name: worlds[name] for name in WORLDS})
    elif not given.tables_only:
        sizes = ["--seeds", given.seeds, "--training-seeds", given.training_seeds]
        sizes += ["--selection-seeds", given.selection_seeds]
        worlds = json.loads(KEPT.read_text())["worlds"]
        for name in given.world or WORLDS:
            worlds[name] = played(name, given.out, sizes)
            write_kept({name: worlds[name] for name in WORLDS})
    put_between(PAGE, BEGIN, END, shown(json.loads(KEPT.read_text())))


if __name__ == "__main__":
    main(sys.argv[1:])
