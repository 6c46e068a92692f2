"""Tables of `docs/learned_spoofers.md`, from results of trainings.

    python -m tools.learned_page runs/ppo-T3 runs/ppo-T5

takes the `results.json` of these folders into `docs/learned_spoofers.json`, and writes the tables
of the page; without a folder it writes the tables again.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from statistics import median
from typing import Any

from spoofgym._files import write_file
from spoofgym.bench.tables import interval

from .pages import put_between

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE, KEPT = DOCS / "learned_spoofers.md", DOCS / "learned_spoofers.json"
BEGIN, END = "<!-- learned:begin -->", "<!-- learned:end -->"
RIVALS = ("ramp", "accelerating-ramp", "blind-optimum")


def taken(results: dict[str, Any]) -> dict[str, Any]:
    """What the page needs of the results of a training."""
    plain = ("command", "versions", "detector", "kept")
    seeds = [
        {
            **{name: row[name] for name in ("seed", "steps", "chosen_at", "diverged")},
            "untrained_m": row["untrained"]["stealthy_displacement_m"]["value"],
            "score": row["score"],
            "ratios": row["ratios"],
        }
        for row in results["seeds"]
    ]
    rivals = {name: results["rivals"][name] for name in RIVALS}
    return {**{name: results[name] for name in plain}, "rivals": rivals, "seeds": seeds}


def shown(kept: dict[str, Any]) -> str:
    """Tables of all trainings."""
    return "\n\n".join(_table(task, found) for task, found in kept.items()) + "\n"


def _table(task: str, found: dict[str, Any]) -> str:
    scores = [row["score"]["stealthy_displacement_m"]["value"] for row in found["seeds"]]
    before = [row["untrained_m"] for row in found["seeds"]]
    lines = [
        f"| {task}, `{found['detector']}` | stealthy displacement [m] | alarms [%] | over the ramp "
        "| over the blind optimum | untrained [m] |",
        "|---|---|---|---|---|---|",
    ]
    for name in RIVALS:
        lines.append(f"| {name} | {_cells(found['rivals'][name])} | | | |")
    for row in found["seeds"]:
        ratios = [interval(row["ratios"][name], 2) for name in ("ramp", "blind-optimum")]
        cells = [_cells(row["score"]), *ratios, f"{row['untrained_m']:.1f}"]
        lines.append(f"| PPO, seed {row['seed']} | " + " | ".join(cells) + " |")
    over = [median(row["ratios"][n]["value"] for row in found["seeds"]) for n in RIVALS[::2]]
    lines.append(
        f"| **PPO, median of {len(scores)} seeds** | **{median(scores):.1f}** | | {over[0]:.2f} | "
        f"{over[1]:.2f} | {median(before):.1f} |"
    )
    return "\n".join(lines)


def _cells(score: dict[str, Any]) -> str:
    keeps = score["within_budget"] and score["fit_within_budget"] is not False
    rate = 100.0 * score["alarm_rate"]["value"]
    return f"{interval(score['stealthy_displacement_m'])}{'' if keeps else '*'} | {rate:.1f}"


def main() -> None:
    """Take the results of the folders that are given, and write the page."""
    kept = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.is_file() else {}
    for folder in sys.argv[1:]:
        results = json.loads((Path(folder) / "results.json").read_text(encoding="utf-8"))
        task = json.loads((Path(folder) / "config.json").read_text(encoding="utf-8"))
        kept[task["arguments"]["task"]] = taken(results)
    write_file(KEPT, (json.dumps(kept, indent=1) + "\n").encode())
    put_between(PAGE, BEGIN, END, shown(kept))


if __name__ == "__main__":
    main()
