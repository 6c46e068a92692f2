"""Known scores of the tasks of `spoofgym-bench-v1`, and how they are read off a campaign."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

from ..tasks import TASKS, normalised

FILE = "task_scores_v1.json"
"""Stored beside this module."""


def stored_scores() -> dict[str, dict[str, Any]]:
    """Scores by the keys of the tasks.

    Returns
    -------
    dict
        For every task that has been scored: ``undetected_displacement_m`` and ``alarm_excess`` of
        ``none``, ``ramp``, ``profile`` and ``ppo``, ``normalised`` of the last, ``runs``, and
        ``spoofers``, which ones they are.
    """
    text = files(__package__).joinpath(FILE).read_text(encoding="utf-8")
    found: dict[str, dict[str, Any]] = json.loads(text)
    return found


def task_scores(key: str, report: dict[str, Any], ppo: str | None) -> dict[str, Any]:
    """Scores of a task by the report of a campaign that has played it.

    Parameters
    ----------
    key : str
        Of the task.
    report : dict
        What ``spoofgym bench --task KEY --json`` prints.
    ppo : str or None
        Label of the learned spoofer in it.

    Returns
    -------
    dict
        As in `stored_scores`; means over the detectors where the task has several.

    Raises
    ------
    ValueError
        When the report is of other detectors.
    """
    cells = report["cells"]
    judges = list(dict.fromkeys(cell["detector"] for cell in cells))
    if len(judges) != len(TASKS[key].detectors):
        raise ValueError(
            f"task {key} has {len(TASKS[key].detectors)} detectors, the report {len(judges)}"
        )
    whom: dict[str, dict[str, str | None]] = {judge: {"none": "none"} for judge in judges}
    for group in report["rivals"]:
        best = whom[group["detector"]]
        for name in ("ramp", "profile"):
            found = group[f"best_{name}"]
            best[name] = None if found is None else found["spoofer"]
    by_label = {(cell["detector"], cell["spoofer"]): cell for cell in cells}
    result: dict[str, Any] = {"runs": cells[0]["runs"], "spoofers": whom}
    for judge in judges:
        whom[judge]["ppo"] = ppo
    for measure in ("undetected_displacement_m", "alarm_excess"):
        result[measure] = {}
        for name in ("none", "ramp", "profile", "ppo"):
            labels = [(judge, whom[judge].get(name)) for judge in judges]
            known = [by_label[pair] for pair in labels if pair in by_label]
            if len(known) == len(judges):
                values = [cell[measure]["value"] if cell[measure] else 0.0 for cell in known]
                result[measure][name] = round(sum(values) / len(values), 4)
    reached = result["undetected_displacement_m"]
    if {"ramp", "profile", "ppo"} <= set(reached) and reached["profile"] > reached["ramp"]:
        result["normalised"] = round(
            normalised(reached["ppo"], reached["ramp"], reached["profile"]), 4
        )
    return result
