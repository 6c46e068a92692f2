"""Do the calibrations of the headlines hold on fresh runs?  Counted, kept and shown.

    python -m tools.holdouts                        # counts, and writes docs/holdouts.json
    python -m tools.holdouts --task S1 --runs 4096  # the suite of a task, added to what is kept

The seeds are those of the split `holdout`, runs 0 to N - 1, entropy 0: fixed before the first
count, and never drawn again.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Collection
from operator import methodcaller
from typing import Any, NamedTuple

from agents.folder import write_json
from spoofgym.bench.experiments.calibration import hold_out, transfer
from spoofgym.bench.experiments.suite import list_standard_detectors
from spoofgym.bench.report.table import Table, interval
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.runs.world import World
from spoofgym.bench.scores.statistics import clopper_pearson
from spoofgym.calibration.holdouts import HOLDOUT_WEIGHING
from spoofgym.calibration.thresholds import inner_detectors
from spoofgym.core.progress import show_progress
from spoofgym.detectors import Calibration, Detector
from spoofgym.detectors.calibrated import STANDARD_RATE, describe_identity
from spoofgym.detectors.calibration_file import SHIPPED_FOLDER, hourly_rate, load_stored
from spoofgym.simulation.setup import Setup
from spoofgym.simulation.simulator import weighs
from spoofgym.tasks import get_task
from tools.calibrations import HEADLINES, build_setup, list_detectors
from tools.pages import DOCS, fit_tables, put_between, render_page

DATA_FILE, PAGE = DOCS / "holdouts.json", DOCS / "calibration_worlds.md"
START, END = "<!-- holdouts:begin -->", "<!-- holdouts:end -->"
TRANSFERRED = 1_000
"""Runs in another world."""
RARE_RATE = 0.002
"""The other rate an hour at which passive detectors are counted, of the order of aviation's."""
RARE_RUNS = 100_000
"""Runs of a calibration that suffice for it."""


class HoldoutWorld(NamedTuple):
    """A world, its detectors that have a calibration, and those whose statistic is degenerate."""

    name: str
    setup: Setup
    passive: list[tuple[Calibration, Detector]]
    rescaled: list[tuple[Calibration, Detector]]
    weighing: list[tuple[Calibration, Detector]]
    degenerate: list[str]

    @property
    def groups(self) -> list[list[tuple[Calibration, Detector]]]:
        """Detectors that share a pass, or are like those that do."""
        few = [pair for pair in self.passive if pair[0].runs < RARE_RUNS]
        many = [pair for pair in self.passive if pair[0].runs >= RARE_RUNS]
        return [group for group in (many, few, self.rescaled, self.weighing) if group]


def load_world(name: str, only: Collection[str] = ()) -> HoldoutWorld:
    """A world with what is shipped for it; `only` these detectors, by default all."""
    found = HoldoutWorld(name, build_setup(name), [], [], [], [])
    for detector in list_detectors(name, found.setup):
        if only and describe_identity(detector)["name"] not in only:
            continue
        alone = found.weighing if weighs(found.setup, detector) else found.passive
        for rescaled in (False, True)[: 1 + detector.drifts]:
            what = found.setup.conditions, describe_identity(detector), rescaled
            made = next(load_stored(*what, SHIPPED_FOLDER), None)
            if made is None:
                raise SystemExit(f"{name} has no calibration of {detector}: tools.calibrations")
            try:
                made.point(STANDARD_RATE)
            except ValueError:
                found.degenerate.append(_name(made))
                continue
            (found.rescaled if rescaled else alone).append((made, detector))
    return found


def _name(made: Calibration) -> str:
    return str(made.detector["name"]) + (", rescaled" if made.rescale is not None else "")


def count_holdouts(
    world: HoldoutWorld, others: list[HoldoutWorld], runs: int, cells: int
) -> dict[str, Any]:
    """Hold-out of a world, and the rate of its thresholds in the other ones."""
    rows = []
    for group in world.groups:
        passive = group is not world.weighing
        count = runs if passive else min(runs, 10 * HOLDOUT_WEIGHING)
        made, detectors = zip(*group, strict=True)
        rare_too = passive and all(each.runs >= RARE_RUNS for each in made)
        rates = [STANDARD_RATE, RARE_RATE] if rare_too else [STANDARD_RATE]
        asked: dict[str, Any] = {"false_alarms_per_hour": rates, "progress": show_progress}
        counts = hold_out(world.setup, made, detectors, runs=count, cells=cells, **asked)
        asked |= {"false_alarms_per_hour": STANDARD_RATE, "runs": TRANSFERRED}
        there = {x.name: transfer(x.setup, made, detectors, **asked) for x in others}
        held, rare = counts[: len(made)], counts[len(made) :]
        for k, one in enumerate(held):
            elsewhere = {name: each[k].as_dict()["per_hour"] for name, each in there.items()}
            kind = {"name": _name(made[k]), "calibrated": made[k].runs, "passive": passive}
            rows.append({**one.as_dict(), **kind, "in": elsewhere})
            if rare:
                rows[-1]["rare"] = rare[k].as_dict()
    return {
        "world": world.name,
        "settings": world.setup.conditions.digest,
        "window_s": world.setup.window_s,
        "degenerate": world.degenerate,
        "mean_passive_per_hour": _mean(rows, world.setup.window_s),
        "detectors": rows,
    }


def count_task(task: str, runs: int) -> dict[str, Any]:
    """Hold-out of the detectors of a task's suite that have a calibration in its world."""
    world, pairs = World.of(task), []
    for spec in list_standard_detectors(get_task(task)):
        label = specify_detector(spec).label
        for each in inner_detectors([spec]):  # none of one that never alarms
            what = world.setup.conditions, describe_identity(each), False
            pairs += [(made, each, label) for made in load_stored(*what, SHIPPED_FOLDER)][:1]
    made, detectors, labels = zip(*pairs, strict=True)
    asked: dict[str, Any] = {"false_alarms_per_hour": STANDARD_RATE, "progress": show_progress}
    held = hold_out(world.setup, made, detectors, runs=runs, **asked)
    rows = [
        {**each.as_dict(), "name": label, "calibrated": one.runs}
        for one, each, label in zip(made, held, labels, strict=True)
    ]
    return {"task": task, "settings": world.setup.conditions.digest, "detectors": rows}


def join_detectors(before: dict[str, Any], later: dict[str, Any]) -> dict[str, Any]:
    if before["settings"] != later["settings"]:
        raise SystemExit(f"{before['world']} has changed: count all of its detectors again")
    names = {row["name"] for row in later["detectors"]}
    kept = [row for row in before["detectors"] if row["name"] not in names]
    rows = [*kept, *later["detectors"]]
    mean = _mean(rows, later["window_s"])
    return {**before, "detectors": rows, "mean_passive_per_hour": mean}


def _mean(rows: list[dict[str, Any]], window_s: float) -> float:
    shares = [row["alarms"] / row["runs"] for row in rows if row["passive"]]
    return hourly_rate(math.fsum(shares) / len(shares), window_s)


def shown(kept: dict[str, Any]) -> str:
    shapes = {"table": _table, "others": _others, "of_task": _tabulate_task}
    return fit_tables(render_page("holdouts.md.j2", **kept, **shapes))


def _table(world: dict[str, Any]) -> Table:
    rare = methodcaller("get", "rare")
    return Table(
        ("detector", "name"),
        ("runs with an alarm (predicted)", _format_count),
        ("per hour", lambda row: _rate(row["per_hour"])),
        (
            "per hour in the worst sky (by chance)",
            lambda x: f"{_rate(x['worst_world_per_hour'])} ({_rate(x['worst_world_by_chance'])})",
        ),
        (f"runs with an alarm at {RARE_RATE:g} an hour (predicted)", rare, _format_count),
        ("alarm before the attack [%]", lambda row: f"{100 * row['early'] / row['runs']:.2g}"),
    )


def _tabulate_task(world: dict[str, Any]) -> Table:
    return Table(
        ("detector", "name"),
        ("calibrated on", "calibrated", "{:,}".format),
        ("runs with an alarm (predicted)", _format_count),
        ("per hour", lambda row: interval(_find_hourly(row))),
        (
            "per hour at ages of 1 to 3, to 10, to 30, to 60 min",
            lambda row: ", ".join(_rate(each) for _, each in row["per_hour_by_age"]),
        ),
        ("alarm before the attack [%]", lambda row: f"{100 * row['early'] / row['runs']:.2g}"),
    )


def _find_hourly(row: dict[str, Any]) -> dict[str, Any]:
    share = clopper_pearson(row["alarms"], row["runs"])
    return {end: hourly_rate(getattr(share, end), row["window_s"]) for end in share.as_json()}


def _others(world: dict[str, Any]) -> Table:
    names = ((name.removeprefix("headline-"), name) for name in world["detectors"][0]["in"])
    return Table(
        ("detector", "name"),
        ("calibrated on", "calibrated", "{:,}".format),
        ("fresh runs", "runs", "{:,}".format),
        *((f"per hour in {short}", lambda x, n=name: _rate(x["in"][n])) for short, name in names),
    )


def _format_count(row: dict[str, Any]) -> str:
    outside = "" if row["holds"] else ", outside"
    return f"{row['alarms']:,} ({row['low']} to {row['high']}{outside})"


def _rate(per_hour: float | None) -> str:
    return "every run" if per_hour is None else f"{per_hour:.3g}"


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=100_000, help="of passive detectors")
    parser.add_argument("--only", nargs="*", default=(), help="detectors to add to what is kept")
    parser.add_argument("--task", choices=("S1",), help="count the suite of a task alone")
    parser.add_argument("--tables-only", action="store_true", help="count nothing")
    given = parser.parse_args(arguments)
    if given.task:
        kept = json.loads(DATA_FILE.read_text())
        write_json(DATA_FILE, {**kept, "tasks": [count_task(given.task, given.runs)]})
    elif not given.tables_only:
        worlds = [load_world(name, given.only) for name in HEADLINES]
        before = json.loads(DATA_FILE.read_text()) if given.only else {"cells": 0, "worlds": []}
        cells = before["cells"]
        for world in worlds:
            passive = [made for made, _ in (*world.passive, *world.rescaled)]
            rare = sum(made.runs >= RARE_RUNS for made in passive)
            cells += len(passive) + rare + len(world.weighing)
        found = []
        for world in worlds:
            others = [other for other in worlds if other is not world]
            found.append(count_holdouts(world, others, given.runs, cells))
            print(world.name, found[-1]["mean_passive_per_hour"], flush=True)
        if given.only:
            found = [join_detectors(*pair) for pair in zip(before["worlds"], found, strict=True)]
        cells = sum(1 + ("rare" in row) for world in found for row in world["detectors"])
        kept = {"rate": STANDARD_RATE, "split": "holdout", "cells": cells, "worlds": found}
        kept["tasks"] = json.loads(DATA_FILE.read_text())["tasks"]
        write_json(DATA_FILE, kept)
    put_between(PAGE, START, END, shown(json.loads(DATA_FILE.read_text())))


if __name__ == "__main__":
    main(sys.argv[1:])
