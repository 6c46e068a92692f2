"""Tables and pictures of `docs/learned_*.md`, from results of trainings.

    python -m tools.learned_page runs/ppo-T3 runs/ppo-T5 runs/plain-T3 runs/spoofers runs/refits

takes the results of these folders, and what `tools.transfer --json` has written to a file, such as
runs/transfer.json, into `docs/learned_spoofers.json`; what they lack stays as it is.  Trainings on
other runs, with an `--entropy`, have a table apart.  Without a folder it writes the tables again.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

from agents import seeds
from agents.folder import write_json
from agents.seeds import get_displacement, keeps_budget, mark_displacement
from agents.spoofer_table import RIVALS, page
from spoofgym.bench.report.table import Table, interval
from spoofgym.core.files import write_file

from .pages import DOCS, fit_tables, marks, parse_folders, put_between
from .refits import RESULTS as REFITS
from .refits import table as table_of_refits

DATA_FILE = DOCS / "learned_spoofers.json"
MANY = "spoofers.json"  # of `train.spoofers`
TASK_HEAD = (
    *("task", "detector", "ramp [m]", "accelerating ramp [m]", "optimized open-loop attack [m]"),
    *("PPO, median and range of the seeds [m]", "of the best of the three", "untrained [m]"),
)
CURVE_HEAD = ("task", "arguments", "thousands of steps: stealthy displacement")
TRANSFERRED = ("as fitted at home", "refitted")
KINDS = {"plain": "five arguments", "defaults": "those of the library alone"}


def find_bar(found: dict[str, Any]) -> str:
    """The rival that gets farthest on the evaluation runs."""
    rivals = found["rivals"]
    return max(RIVALS, key=lambda name: get_displacement(rivals[name]) * keeps_budget(rivals[name]))


def shown_of_tasks(kept: dict[str, Any]) -> str:
    tasks = [_task_cells(task, found) for task, found in kept.items()]
    return Table.of_texts(*TASK_HEAD).markdown(tasks) + "\n"


def shown(kept: dict[str, Any]) -> str:
    numbers = sorted({row["seed"] for found in kept.values() for row in found["seeds"]})
    every = [(task, *(_seed(found, seed) for seed in numbers)) for task, found in kept.items()]
    table = Table.of_texts("task", *(f"seed {seed}" for seed in numbers)).markdown(every)
    return f"{shown_of_tasks(kept)}\n{table}\n"


def _task_cells(task: str, found: dict[str, Any]) -> tuple[str, ...]:
    bar = find_bar(found)
    middle = seeds.find_median_seed(found["seeds"], bar)
    ratio = interval(middle["ratios"][bar], 2) if middle["score"] else "0"
    return (
        *(task, f"`{found['detector'].partition('(')[0]}`"),
        *(mark_displacement(found["rivals"][name]) for name in RIVALS),
        f"**{seeds.reached_by(found['seeds'])}**",
        f"{ratio} {bar}",
        seeds.reached_by(found["seeds"], "untrained"),
    )


def _seed(found: dict[str, Any], seed: int) -> str:
    """A seed of a task: displacement, times the ramp, and alarms."""
    row = next((each for each in found["seeds"] if each["seed"] == seed), None)
    if row is None or not row["score"]:
        return "none within the budget" if row else "-"
    rate = 100.0 * row["score"]["alarm_rate"]["value"]
    reached = mark_displacement(row["score"])
    return f"{reached} m, {interval(row['ratios']['ramp'], 2)} ramps, {rate:.1f} %"


def shown_of_plain(kept: dict[str, Any]) -> str:
    """Table of what five arguments and the defaults reach, and of how they learned."""
    kinds = [
        (task, KINDS[kind], rows, found["ramps"]["ramp"])
        for task, found in kept.items()
        for kind, rows in found["kinds"].items()
    ]
    table = Table.of_texts(*seeds.KIND_HEAD).markdown(seeds.kind_cells(*each) for each in kinds)
    curves = Table.of_texts(*CURVE_HEAD).markdown((a, b, _curve(rows)) for a, b, rows, _ in kinds)
    return f"{table}\n\nMedians of the learning curves, on training runs [m]:\n\n{curves}\n"


def _curve(rows: list[dict[str, Any]]) -> str:
    """Median over the seeds at every score, of those that have not diverged."""
    return ", ".join(
        f"{median(step for step, _ in each) / 1000:.0f}: {median(m for _, m in each):.1f}"
        for each in zip(*(row["curve"] for row in rows if row["score"]), strict=True)
    )


def select_transfer(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What the page needs of `tools.transfer --json`: by spoofer and home, by world."""
    found: dict[str, Any] = {}
    parts = ("stealthy_displacement_m", "within_budget", "fit_within_budget", "alarm_rate")
    for row in rows:
        name = f"`{row['spoofer']}` | {row['home']}"
        found.setdefault(name, {})[row["world"]] = {
            how: {part: row[how][part] for part in parts} for how in TRANSFERRED
        }
    return found


def shown_of_transfer(kept: dict[str, Any]) -> str:
    worlds = list(next(iter(kept.values()), {}))
    rows = [
        (
            *name.split(" | "),
            *(
                "; ".join(mark_displacement(cells[world][how]) for how in TRANSFERRED)
                for world in worlds
            ),
        )
        for name, cells in kept.items()
    ]
    head = ("spoofer", "trained on", *(f"`{world}` [m]" for world in worlds))
    return Table.of_texts(*head).markdown(rows) + "\n"


TABLES: dict[str, tuple[str, Callable[[dict[str, Any]], str]]] = {
    "learned": ("recipe", shown),
    "fresh": ("fresh", shown_of_tasks),
    "plain": ("plain", shown_of_plain),
    "plain-fresh": ("plain_fresh", shown_of_plain),
    "refits": ("refits", table_of_refits),
    "transfer": ("transfer", shown_of_transfer),
    "spoofers": ("spoofers", page),
}
"""What the pages have between their marks: which results, and how they are shown."""


def find_page(mark: str) -> Path:
    return next(x for x in DOCS.glob("learned_*.md") if marks(mark)[0] in x.read_text())


def take(folder: Path, kept: dict[str, Any]) -> None:
    if folder.suffix == ".json":
        kept["transfer"] = select_transfer(_read(folder))
    elif (folder / MANY).is_file():
        kept["spoofers"] |= _read(folder / MANY)
    elif (folder / REFITS).is_file():
        kept["refits"] |= _read(folder / REFITS)
    elif "kinds" in (results := _read(folder / "results.json")):
        part = kept["plain_fresh" if results.get("entropy") else "plain"]
        before = part.get(results["task"], results)["kinds"]  # played in several parts
        part[results["task"]] = {**results, "kinds": {**before, **results["kinds"]}}
    else:
        given = _read(folder / "config.json")["config"]["arguments"]
        kept["fresh" if given["entropy"] else "recipe"][given["task"]] = results
        if not given["entropy"]:
            picture = (folder / "curve.png").read_bytes()
            write_file(DOCS / f"learning_{given['task'].lower()}.png", picture)


def _read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def main() -> None:
    kept = _read(DATA_FILE)
    for folder in parse_folders("Write the page of learned spoofers."):
        take(folder, kept)
    kept = {part: dict(sorted(found.items())) for part, found in kept.items()}
    write_json(DATA_FILE, kept)
    for mark, (part, show) in TABLES.items():
        put_between(find_page(mark), *marks(mark), fit_tables(show(kept[part])))


if __name__ == "__main__":
    main()
