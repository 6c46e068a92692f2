"""Known scores of the tasks of `spoofgym-bench-v1`, and how they are read off a campaign."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

from ..tasks import TASKS, normalised
from .entries import detector_entry

FILE = "task_scores_v1.json"
"""Stored with this module."""
REFERENCES = {"ramp": ("accelerating-ramp", "ramp"), "profile": ("profile",)}
"""Kinds of spoofers of which the farthest one is a reference."""


def stored_scores() -> dict[str, dict[str, Any]]:
    """Scores by the keys of the tasks."""
    text = files(__package__).joinpath(FILE).read_text(encoding="utf-8")
    found: dict[str, dict[str, Any]] = json.loads(text)
    return found


def task_scores(key: str, report: dict[str, Any], ppo: str | None) -> dict[str, Any]:
    """Scores of a task by the report of a campaign that has played it."""
    cells = report["cells"]
    judges = list(dict.fromkeys(cell["detector"] for cell in cells))
    expected = detector_entry(TASKS[key].detector).label
    if judges != [expected]:
        raise ValueError(f"task {key} has the detector {expected}, the report {', '.join(judges)}")
    whom: dict[str, str | None] = {"none": "none"}
    for name, kinds in REFERENCES.items():
        group = [cell for cell in cells if cell["spoofer_settings"]["name"] in kinds]
        whom[name] = max(group, key=_displacement)["spoofer"] if group else None
    whom["ppo"] = ppo
    by_label = {cell["spoofer"]: cell for cell in cells}
    result: dict[str, Any] = {"runs": cells[0]["runs"], "spoofers": {expected: whom}}
    for measure in ("stealthy_displacement_m", "alarm_rate"):
        known = {
            name: by_label[label][measure] for name, label in whom.items() if label in by_label
        }
        result[measure] = {name: round(cell["value"], 4) for name, cell in known.items()}
    reached = result["stealthy_displacement_m"]
    if {"ramp", "profile", "ppo"} <= set(reached) and reached["profile"] > reached["ramp"]:
        result["normalised"] = round(
            normalised(reached["ppo"], reached["ramp"], reached["profile"]), 4
        )
    return result


def _displacement(cell: dict[str, Any]) -> float:
    return float(cell["stealthy_displacement_m"]["value"])
