"""Tasks of the benchmark: environments whose settings never change.

`v2` has those to compare with: S1 to S3 for spoofers, D1 to D3 for detectors.  `v1` has the first
ones, T1 to T6 and v1/D1 to v1/D4, which stay playable; what was wrong with them is said there.
"""

from __future__ import annotations

from typing import Any

from ..core.registry import check_choice
from . import v1, v2
from .base import (
    ALARM_PRICE,
    ANTENNA_PARTS,
    CANDIDATES,
    EVENTS,
    NEAR_ALARM_S,
    ONSETS,
    RANGE_RATE_TESTS,
    SWITCH_WITHIN_S,
    TURNING_DEGPS,
    AttackFamily,
    DetectorTask,
    Task,
)

__all__ = [
    "ALARM_PRICE",
    "ANTENNA_PARTS",
    "CANDIDATES",
    "DEFAULT_TASK",
    "DETECTOR_TASKS",
    "EVENTS",
    "NEAR_ALARM_S",
    "ONSETS",
    "PAPERS",
    "RANGE_RATE_TESTS",
    "SWITCH_WITHIN_S",
    "TASKS",
    "TURNING_DEGPS",
    "AttackFamily",
    "DetectorTask",
    "Task",
    "get_detector_task",
    "get_task",
]

DEFAULT_TASK = "S1"
"""Whose world and detector everything has that names no other: the environment by its plain id, the
benchmark, the duel and the command line."""
TASKS: dict[str, Task] = {**v2.TASKS, **v1.TASKS}
"""Tasks for spoofers by their keys, those of the youngest suite first."""
DETECTOR_TASKS: dict[str, DetectorTask] = {**v2.DETECTOR_TASKS, **v1.DETECTOR_TASKS}
"""Tasks for detectors by their keys, those of the youngest suite first."""

NOMINAL = {"thresholds": "nominal"}  # thresholds of the papers, as their own environments have them
PAPERS: dict[str, tuple[str, dict[str, Any]]] = {
    "ke2022": (
        "spoofgym/Zhong2025-v0",
        {
            "scenario": "ke2022",
            "attack": "paper-ideal",
            "detector": {"name": "innovation-rate", **NOMINAL},
            "timeline": {"warmup_s": 350.0, "live_s": 150.0, "attack_s": 200.0},
        },
    ),
    "shadmehri2025": (
        "spoofgym/LooselyCoupled-v0",
        {
            "detector": {
                "name": "windowed-chi2",
                "window": 1,
                "covariance": "estimated",
                "covariance_window": 100,
                **NOMINAL,
            }
        },
    ),
    "song2021": (
        "spoofgym/WheeledRobot-v0",
        {"detector": {"name": "acna", "variant": "production", **NOMINAL}},
    ),
    "wu2024": ("spoofgym/Snapshot-v0", {"detector": {"name": "srv-raim", **NOMINAL}}),
    "zhong2025": (
        "spoofgym/Zhong2025-v0",
        {"scenario": "zhong2025", "attack": "paper-ideal", "detector": {**v1.EWMA, **NOMINAL}},
    ),
}
"""Environments of the papers' scenarios: id and keyword arguments, by the keys of the papers."""


def get_task(key: str) -> Task:
    """Task by its key.

    Parameters
    ----------
    key : str
        ``"S1"`` to ``"S3"``, or ``"T1"`` to ``"T6"`` of the first suite.

    Returns
    -------
    Task
        The task.

    Raises
    ------
    ValueError
        Without such a task; the valid ones are listed.

    Examples
    --------
    >>> from spoofgym.tasks import get_task
    >>> get_task("S3").alert_limit_m
    556.0
    """
    check_choice("task", key, TASKS)
    return TASKS[key]


def get_detector_task(key: str) -> DetectorTask:
    """Task for detectors by its key.

    Parameters
    ----------
    key : str
        ``"D1"`` to ``"D3"``, or ``"v1/D1"`` to ``"v1/D4"`` of the first suite.

    Returns
    -------
    DetectorTask
        The task.

    Raises
    ------
    ValueError
        Without such a task; the valid ones are listed.
    """
    check_choice("task for detectors", key, DETECTOR_TASKS)
    return DETECTOR_TASKS[key]
