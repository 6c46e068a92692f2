"""Tables and pictures of `docs/learned_spoofers.md`, from results of trainings.

    python -m tools.learned_page runs/ppo-T3 runs/ppo-T5 runs/plain-T3 runs/spoofers runs/refits

takes the results of these folders into `docs/learned_spoofers.json`, those of `train.ppo_spoofer`
with their pictures, those of `train.plain_ppo`, `train.spoofers` and `tools.refits`, and what
`tools.transfer --json` has written to a file, such as runs/transfer.json, and writes the tables of
the page; without a folder it writes the tables again.  Trainings with an `--entropy` of
their own, on other runs, have a table apart.  Cells of `train.spoofers` and
tasks of `tools.refits` that a folder lacks stay as they are.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from statistics import median
from typing import Any

from agents.seeds import (
    KIND_HEAD,
    keeps_budget,
    kind_cells,
    marked,
    middle_of,
    reached_by,
    value_of,
)
from agents.spoofer_table import RIVALS, page
from spoofgym.bench.report.table import Table, interval
from spoofgym.core.files import write_file

from .pages import marks, put_between
from .refits import RESULTS as REFITS
from .refits import table as table_of_refits

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE, KEPT = DOCS / "learned_spoofers.md", DOCS / "learned_spoofers.json"
MANY = "spoofers.json"
"""Results of `train.spoofers` in their folder."""
TASK_HEAD = (
    *("task", "detector", "ramp [m]", "accelerating ramp [m]", "blind optimum [m]"),
    *("PPO, median and range of the seeds [m]", "of the best of the three", "untrained [m]"),
)
CURVE_HEAD = ("task", "arguments", "thousands of steps: stealthy displacement")
TRANSFERRED = ("as fitted at home", "refitted")
KINDS = {"plain": "five arguments", "defaults": "those of the library alone"}


def taken(
    results: dict[str, Any], whom: Iterable[str] = RIVALS, *, alone: bool = True
) -> dict[str, Any]:
    """What the page needs of the results of `train.ppo_spoofer`. `whom`: of which rivals; `alone`:
    whether it is one of the recipe, and no cell of many."""
    plain = ("command", "versions", "detector", "kept")
    further = ("wall_s", "untrained") if alone else ("wall_s",)
    seeds = [
        {
            **{name: row[name] for name in ("seed", "steps", "chosen_at", "diverged")},
            **{name: row[name] for name in further if name in row},  # older ones have none
            "score": row["score"],
            "ratios": row.get("ratios", {}),
        }
        for row in results["seeds"]
    ]
    rivals = {name: results["rivals"][name] for name in whom}
    return {**{name: results[name] for name in plain}, "rivals": rivals, "seeds": seeds}


def taken_of_plain(results: dict[str, Any]) -> dict[str, Any]:
    """What the page needs of the results of `train.plain_ppo`."""
    kinds = {
        kind: [
            {name: row[name] for name in ("seed", "curve", "score", "ratios", "untrained")}
            for row in rows
        ]
        for kind, rows in results["kinds"].items()
    }
    return {"steps": results["steps"], "ramps": results["ramps"], "kinds": kinds}


def bar_of(found: dict[str, Any]) -> str:
    """The rival that gets farthest on the evaluation runs."""
    rivals = found["rivals"]
    return max(RIVALS, key=lambda name: value_of(rivals[name]) * keeps_budget(rivals[name]))


def shown_of_tasks(kept: dict[str, Any]) -> str:
    """Table of the recipe: a line for each task."""
    tasks = [_task_cells(task, found) for task, found in kept.items()]
    return Table.of_texts(*TASK_HEAD).markdown(tasks) + "\n"


def shown(kept: dict[str, Any]) -> str:
    """Tables of the recipe: a line for each task, and all seeds."""
    seeds = sorted({row["seed"] for found in kept.values() for row in found["seeds"]})
    every = [_seed_cells(task, found, seeds) for task, found in kept.items()]
    lines = [
        shown_of_tasks(kept).rstrip(),
        "",
        Table.of_texts("task", *(f"seed {seed}" for seed in seeds)).markdown(every),
    ]
    return "\n".join(lines) + "\n"


def _task_cells(task: str, found: dict[str, Any]) -> tuple[str, ...]:
    """A task, in the order of `TASK_HEAD`."""
    bar = bar_of(found)
    middle = middle_of(found["seeds"], bar)
    ratio = interval(middle["ratios"][bar], 2) if middle["score"] else "0"
    return (
        *(task, f"`{found['detector'].partition('(')[0]}`"),
        *(marked(found["rivals"][name]) for name in RIVALS),
        f"**{reached_by(found['seeds'])}**",
        f"{ratio} {bar}",
        reached_by(found["seeds"], "untrained"),
    )


def _seed_cells(task: str, found: dict[str, Any], seeds: list[int]) -> tuple[str, ...]:
    """Every seed of a task: displacement, times the ramp, and alarms."""
    rows = {row["seed"]: row for row in found["seeds"]}
    return (task, *(_seed(rows[seed]) if seed in rows else "-" for seed in seeds))


def _seed(row: dict[str, Any]) -> str:
    if not row["score"]:
        return "none within the budget"
    rate = 100.0 * row["score"]["alarm_rate"]["value"]
    return f"{marked(row['score'])} m, {interval(row['ratios']['ramp'], 2)} ramps, {rate:.1f} %"


def shown_of_plain(kept: dict[str, Any]) -> str:
    """Table of what five arguments and the defaults reach, and of how they learned."""
    kinds = [
        (task, KINDS[kind], rows, found["ramps"]["ramp"])
        for task, found in kept.items()
        for kind, rows in found["kinds"].items()
    ]
    lines = [
        Table.of_texts(*KIND_HEAD).markdown(kind_cells(*each) for each in kinds),
        *("", "Medians of the learning curves, on training runs [m]:", ""),
        Table.of_texts(*CURVE_HEAD).markdown((task, kind, _curve(x)) for task, kind, x, _ in kinds),
    ]
    return "\n".join(lines) + "\n"


def _curve(rows: list[dict[str, Any]]) -> str:
    """Median over the seeds at every score, of those that have not diverged."""
    return ", ".join(
        f"{median(step for step, _ in each) / 1000:.0f}: {median(m for _, m in each):.1f}"
        for each in zip(*(row["curve"] for row in rows if row["score"]), strict=True)
    )


def taken_of_transfer(rows: list[dict[str, Any]]) -> dict[str, Any]:
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
    """Table of transfer: a line for each spoofer and its home, a column for each world."""
    worlds = list(next(iter(kept.values()), {}))
    rows = [
        (
            *name.split(" | "),
            *("; ".join(marked(cells[world][how]) for how in TRANSFERRED) for world in worlds),
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
"""What the page has between its marks: which results, and how they are shown."""


def main() -> None:
    """Take the results of the folders that are given, and write the page."""
    further = [part for part, _ in TABLES.values() if part not in ("recipe", "plain")]
    kept = {part: {} for part in further} | json.loads(KEPT.read_text(encoding="utf-8"))
    for folder in map(Path, sys.argv[1:]):
        if folder.suffix == ".json":
            rows = json.loads(folder.read_text(encoding="utf-8"))
            kept["transfer"] = taken_of_transfer(rows)
            continue
        if (folder / MANY).is_file():
            cells = json.loads((folder / MANY).read_text(encoding="utf-8"))
            kept["spoofers"] |= {
                cell: taken(found, found["rivals"], alone=False) for cell, found in cells.items()
            }
            continue
        if (folder / REFITS).is_file():
            kept["refits"] |= json.loads((folder / REFITS).read_text(encoding="utf-8"))
            continue
        results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        if "kinds" in results:
            found = taken_of_plain(results)
            part = kept["plain_fresh" if results.get("entropy") else "plain"]
            before = part.get(results["task"], found)
            found["kinds"] = {**before["kinds"], **found["kinds"]}  # played in several parts
            part[results["task"]] = found
            continue
        config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
        task = config["arguments"]["task"]
        if config["arguments"]["entropy"]:
            kept["fresh"][task] = taken(results)
            continue
        kept["recipe"][task] = taken(results)
        picture = (folder / "curve.png").read_bytes()
        write_file(DOCS / f"learning_{task.lower()}.png", picture)
    kept = {part: dict(sorted(found.items())) for part, found in kept.items()}
    write_file(KEPT, (json.dumps(kept, indent=1) + "\n").encode())
    for mark, (part, show) in TABLES.items():
        put_between(PAGE, *marks(mark), show(kept[part]))


if __name__ == "__main__":
    main()
