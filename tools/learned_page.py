"""Tables and pictures of `docs/learned_spoofers.md`, from results of trainings.

    python -m tools.learned_page runs/ppo-T3 runs/ppo-T5 runs/plain-T3

takes the results of these folders into `docs/learned_spoofers.json`, those of `train.ppo_spoofer`
with their pictures and those of `train.plain_ppo`, and writes the tables of the page; without a
folder it writes the tables again.
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
PLAIN_BEGIN, PLAIN_END = "<!-- plain:begin -->", "<!-- plain:end -->"
RIVALS = ("ramp", "accelerating-ramp", "blind-optimum")
KINDS = {"plain": "five arguments", "defaults": "those of the library alone"}


def value_of(score: dict[str, Any] | None) -> float:
    """Stealthy displacement [m]; 0 where nothing kept the budget."""
    return float(score["stealthy_displacement_m"]["value"]) if score else 0.0


def taken(results: dict[str, Any]) -> dict[str, Any]:
    """What the page needs of the results of `train.ppo_spoofer`."""
    plain = ("command", "versions", "detector", "kept")
    seeds = [
        {
            **{name: row[name] for name in ("seed", "steps", "chosen_at", "diverged")},
            "untrained_m": value_of(row["untrained"]),
            "score": row["score"],
            "ratios": row.get("ratios", {}),
        }
        for row in results["seeds"]
    ]
    rivals = {name: results["rivals"][name] for name in RIVALS}
    return {**{name: results[name] for name in plain}, "rivals": rivals, "seeds": seeds}


def taken_of_plain(results: dict[str, Any]) -> dict[str, Any]:
    """What the page needs of the results of `train.plain_ppo`."""
    kinds = {
        kind: [
            {
                **{name: row[name] for name in ("seed", "curve", "score", "ratios")},
                "untrained_m": value_of(row["untrained"]),
            }
            for row in rows
        ]
        for kind, rows in results["kinds"].items()
    }
    return {"steps": results["steps"], "ramps": results["ramps"], "kinds": kinds}


def bar_of(found: dict[str, Any]) -> str:
    """The rival that gets farthest on the evaluation runs."""
    rivals = found["rivals"]
    return max(RIVALS, key=lambda name: value_of(rivals[name]) if _keeps(rivals[name]) else 0.0)


def ratio_to(row: dict[str, Any], rival: str) -> float:
    """How many times as far a seed gets; 0 where it found nothing."""
    return float(row["ratios"][rival]["value"]) if row["score"] else 0.0


def middle_of(found: dict[str, Any], rival: str) -> dict[str, Any]:
    """The seed whose ratio to a rival is the median one; the lower of two."""
    rows = sorted(found["seeds"], key=lambda row: ratio_to(row, rival))
    return dict(rows[(len(rows) - 1) // 2])


def shown(kept: dict[str, Any]) -> str:
    """Tables of the recipe: a line for each task, and all seeds."""
    lines = [
        "| task | detector | ramp [m] | accelerating ramp [m] | blind optimum [m] "
        "| PPO, median of the seeds [m] | of the best of the three | untrained [m] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for task, found in kept.items():
        scores = [value_of(row["score"]) for row in found["seeds"]]
        before = [row["untrained_m"] for row in found["seeds"]]
        bar = bar_of(found)
        middle = middle_of(found, bar)
        ratio = interval(middle["ratios"][bar], 2) if middle["score"] else "0"
        cells = (
            *(task, f"`{_short(found['detector'])}`"),
            *(_cell(found["rivals"][name]) for name in RIVALS),
            f"**{median(scores):.1f}** [{min(scores):.1f}, {max(scores):.1f}]",
            f"{ratio} {bar}",
            f"{min(before):.1f} to {max(before):.1f}",
        )
        lines.append("| " + " | ".join(cells) + " |")
    lines += ["", *_seeds(kept)]
    return "\n".join(lines) + "\n"


def _seeds(kept: dict[str, Any]) -> list[str]:
    """Every seed: displacement, times the ramp, and alarms."""
    seeds = sorted({row["seed"] for found in kept.values() for row in found["seeds"]})
    head = "| task | " + " | ".join(f"seed {seed}" for seed in seeds) + " |"
    lines = [head, "|" + "---|" * (len(seeds) + 1)]
    for task, found in kept.items():
        rows = {row["seed"]: row for row in found["seeds"]}
        cells = [_seed(rows[seed]) if seed in rows else "-" for seed in seeds]
        lines.append(f"| {task} | " + " | ".join(cells) + " |")
    return lines


def _seed(row: dict[str, Any]) -> str:
    if not row["score"]:
        return "none within the budget"
    rate = 100.0 * row["score"]["alarm_rate"]["value"]
    return f"{_cell(row['score'])} m, {interval(row['ratios']['ramp'], 2)} ramps, {rate:.1f} %"


def shown_of_plain(kept: dict[str, Any]) -> str:
    """Table of what five arguments and the defaults reach."""
    lines = [
        "| task | arguments | seeds | stealthy displacement, median and range [m] "
        "| over the best constant ramp, median seed | untrained [m] |",
        "|---|---|---|---|---|---|",
    ]
    for task, found in kept.items():
        ramp = value_of(found["ramps"]["ramp"])
        for kind, rows in found["kinds"].items():
            scores = [value_of(row["score"]) for row in rows]
            before = [row["untrained_m"] for row in rows]
            ratios = sorted((row["ratios"]["ramp"] for row in rows), key=lambda r: r["value"])
            middle = interval(ratios[(len(ratios) - 1) // 2], 2)
            cells = (
                *(task, KINDS[kind], str(len(rows))),
                f"{median(scores):.1f} [{min(scores):.1f}, {max(scores):.1f}]",
                f"{middle} of {ramp:.1f} m",
                f"{min(before):.1f} to {max(before):.1f}",
            )
            lines.append("| " + " | ".join(cells) + " |")
    lines += ["", "Medians of the learning curves, on training runs [m]:", ""]
    lines += ["| task | arguments | thousands of steps: stealthy displacement |", "|---|---|---|"]
    for task, found in kept.items():
        for kind, rows in found["kinds"].items():
            points = zip(*(row["curve"] for row in rows), strict=True)
            curve = ", ".join(
                f"{median(step for step, _ in each) / 1000:.0f}: {median(m for _, m in each):.1f}"
                for each in points
            )
            lines.append(f"| {task} | {KINDS[kind]} | {curve} |")
    return "\n".join(lines) + "\n"


def _short(label: str) -> str:
    """Label of a detector without its settings."""
    return label.partition("(")[0]


def _keeps(score: dict[str, Any]) -> bool:
    return bool(score["within_budget"]) and score["fit_within_budget"] is not False


def _cell(score: dict[str, Any]) -> str:
    """Displacement with its interval, `*` where it is over the budget."""
    return f"{interval(score['stealthy_displacement_m'])}{'' if _keeps(score) else '*'}"


def main() -> None:
    """Take the results of the folders that are given, and write the page."""
    kept = json.loads(KEPT.read_text(encoding="utf-8"))
    for folder in map(Path, sys.argv[1:]):
        results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        if "kinds" in results:
            kept["plain"][results["task"]] = taken_of_plain(results)
            continue
        config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
        task = config["arguments"]["task"]
        kept["recipe"][task] = taken(results)
        picture = (folder / "curve.png").read_bytes()
        write_file(DOCS / f"learning_{task.lower()}.png", picture)
    kept = {part: dict(sorted(found.items())) for part, found in kept.items()}
    write_file(KEPT, (json.dumps(kept, indent=1) + "\n").encode())
    put_between(PAGE, BEGIN, END, shown(kept["recipe"]))
    put_between(PAGE, PLAIN_BEGIN, PLAIN_END, shown_of_plain(kept["plain"]))


if __name__ == "__main__":
    main()
