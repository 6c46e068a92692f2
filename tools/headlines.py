"""The table of all detectors in the world of the standard suite: played, kept as JSON with its
digest, and shown.

    python -m tools.headlines                  # plays what is missing, into results/headlines
    python -m tools.headlines --scores-only    # scores what was played there, by whatever code

All detectors work at 0.2 false alarms an hour; ramps, open-loop optima and feedback meet each of
them.  Their bracket is shown with what was achieved.  `FIRST`, that of the first suite, is kept for
`tools.feedback_gain`, and is not shown.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from agents.folder import write_json
from spoofgym.bench.experiments.campaign import CampaignResults, summarize
from spoofgym.bench.report import campaign as report
from spoofgym.bench.report.table import Table, interval
from spoofgym.bench.scores.campaign import compute_bounds, extract_name
from spoofgym.cli.suites import LEFT_OUT
from spoofgym.core.settings import compute_digest
from spoofgym.spoofers.base import sees_statistics
from tools.pages import DOCS, fit_tables, marks, put_between, render_page

DATA_FILE, PAGE = DOCS / "headlines.json", DOCS / "suite.md"
START, END = marks("headlines")
COMMAND = ["bench"]
WORLD, FIRST = "S1", "trolley"
"""Worlds that are kept: that of the table, and that of the first suite."""
SPOOFERS = ("ramp", "accelerating-ramp", "open-loop", "feedback")
CURVES = ("p_hmi", "survival")
"""Of a cell, which are not kept; those of the protection are."""
COLUMNS = {
    "detector": "detector",
    "clean alarms [per hour]": "measured: per hour",
    "exceeded in 50 % [m]": "exceeded in 50 % [m]",
    "in 5 % [m]": "in 5 % [m]",
    "worst skies [m]": "worst skies, in 50 % [m]",
    "worst attack": "worst attack",
}
"""Columns of the first table, and what they are in the campaign's."""


def play_world(out: Path, sizes: list[str], play: bool) -> dict[str, Any]:
    """Scores of the world of the table, of what lies in a folder, which is completed before."""
    given = [*COMMAND, *sizes]
    words = ["-W", "ignore", "-m", "spoofgym", *given, "--out", str(out / WORLD)]
    if play:
        subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL)
    summary = summarize(CampaignResults.load(out / WORLD))
    found = json.loads((out / WORLD / "config.json").read_text())
    config = found["config"]
    wanted = ("campaign", "scenario", "runs", "entropy", "budget", "alert_limit_m", "attack_suite")
    parts = ("detectors", "cells", "protection", "comparisons", "limits")
    return {
        "command": " ".join(["spoofgym", *given]),
        "versions": found["code"],
        **{key: config[key] for key in ("notes", "calibrations")},
        **{key: summary[key] for key in (*wanted, *parts)},
        "cells": [
            {key: value for key, value in cell.items() if key not in CURVES}
            for cell in summary["cells"]
        ],
    }


def _add_bounds(world: dict[str, Any], limits: dict[str, Any]) -> dict[str, Any]:
    found = []
    for row in world["detectors"]:
        own = {
            part: [each for each in world[part] if each["detector"] == row["detector"]]
            for part in ("cells", "protection")
        }
        worst = next(iter(own["protection"]), None)
        found.append({"bracket": compute_bounds(row, limits, own["cells"], worst, ()), **row})
    return {**world, "limits": limits, "detectors": found}


def shown(kept: dict[str, Any]) -> str:
    world = kept["worlds"][WORLD]
    world = _add_bounds(world, world["limits"])
    points = (point for points in world["calibrations"].values() for point in points)
    (per_run,) = {point["per_run"] for point in points}
    notes = (note.partition(LEFT_OUT) for note in world["notes"])
    left_out = [label for label, found, _ in notes if found]
    world |= {"tables": _tables(world), "per_run": per_run, "left_out": left_out}
    notes = report.list_limit_notes
    return fit_tables(render_page("headlines.md.j2", worlds=[world], list_limit_notes=notes))


def _tables(world: dict[str, Any]) -> str:
    """Two tables, of scores and of attacks by their stealthy displacement; a row a detector."""
    columns = [report.DETECTORS[name]._replace(title=title) for title, name in COLUMNS.items()]
    cells = {(cell["detector"], extract_name(cell["spoofer"])): cell for cell in world["cells"]}
    met = {extract_name(cell["spoofer"]): cell["knowledge"]["run_time"] for cell in world["cells"]}
    spoofers = [name for name in SPOOFERS if name in met]
    spoofers.sort(key=lambda name: sees_statistics(met[name]))  # oracles come last
    attacks = (
        (
            f"{report.format_spoofer(name, met[name])} [m]",
            lambda row, name=name: cells.get((row["detector"], name)),
            _displacement,
        )
        for name in spoofers
    )
    ends = [report.DETECTORS[name] for name in ("zero-alarm bound [m]", "mark")]
    marked = (
        "zero-alarm bound [m]; mark",
        lambda x: "; ".join(filter(None, (y.text(x) for y in ends))),
    )
    rows = [report.detector_rows(world, group) for group in report.groups(world)]
    halves = columns, [columns[0], *attacks, marked]
    return "\n\n".join(Table(*half).markdown(each) for each in rows for half in halves)


def _displacement(cell: dict[str, Any]) -> str:
    over = "" if cell["within_budget"] else report.OVER
    return interval(cell["stealthy_displacement_m"]) + over


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("results/headlines"))
    for name in ("budget", "runs", "training-runs", "selection-runs"):
        parser.add_argument(f"--{name}", help="as of `spoofgym bench`")
    parser.add_argument("--tables-only", action="store_true", help="play nothing")
    parser.add_argument("--scores-only", action="store_true", help="play nothing, score `--out`")
    given = vars(parser.parse_args(arguments))
    worlds = json.loads(DATA_FILE.read_text())["worlds"]
    if not given.pop("tables_only"):
        out, play = given.pop("out"), not given.pop("scores_only")
        named = ((name, each) for name, each in given.items() if each)
        sizes = [word for name, each in named for word in (f"--{name.replace('_', '-')}", each)]
        kept = {WORLD: play_world(out, sizes, play), FIRST: worlds[FIRST]}
        write_json(DATA_FILE, {"digest": compute_digest(kept), "worlds": kept}, None)
    put_between(PAGE, START, END, shown(json.loads(DATA_FILE.read_text())))


if __name__ == "__main__":
    main(sys.argv[1:])
