"""The tasks of `spoofgym-bench-v1`: environments whose settings never change.

A task is an environment, whose detectors have a stated rate of false alarms, and an alarm budget.
What a spoofer scores is its stealthy displacement by the rules of the benchmark; it is read
together with what ramps and the blind optimum get there, and with the task's floor and zero-alarm
bound.  T1 and T2 are historical: the world of the papers.  T3 to T6 had to pass the admission test
of `docs/tasks.md`.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

from ._registry import check_choice

SUITE = "spoofgym-bench-v1"
"""Name of the tasks together; a change of any of them makes another one."""
ALARM_PRICE = 1.5
"""What an alarm costs in the reward of the environments, as by default elsewhere, in lengths."""
BUDGET = 0.05
"""Largest P(alarm | silent twin) of a spoofer that scores."""


@dataclass(frozen=True)
class Task:
    """One task.

    - `title`: what it asks for, in a line;
    - `settings`: keyword arguments of `SpoofEnv`, JSON-able, but for the detector;
    - `detectors`: whom the spoofer meets, as `make_detector` takes them; more than one are a pool,
      from which every episode draws, and the spoofer does not know which it is;
    - `alert_limit_m`: error that the navigation must not exceed unnoticed, where the task names
      one;
    - `historical`: whether it is kept for what was published on its world, and is solved there.
    """

    key: str
    title: str
    settings: dict[str, Any]
    detectors: tuple[dict[str, Any], ...]
    alert_limit_m: float | None = None
    historical: bool = False

    @property
    def env_id(self) -> str:
        """Id for `gymnasium.make`."""
        return f"spoofgym/Bench{self.key}-v1"

    @property
    def pooled(self) -> bool:
        return len(self.detectors) > 1

    @property
    def detector(self) -> dict[str, Any]:
        """Whom the spoofer meets, as one detector, as `make_detector` takes it; a copy."""
        whom = {"name": "pool", "members": list(self.detectors)}
        return copy.deepcopy(whom if self.pooled else self.detectors[0])

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """Keyword arguments of the environment; a copy."""
        length = {} if self.alert_limit_m is None else {"length_m": self.alert_limit_m}
        if not self.pooled:
            return {**self.world_kwargs, **length, "detector": self.detector}
        # a view pays no alarm penalty unless it is set to, and all tasks are paid alike
        pool = {"pool": list(self.detectors), "alarm_price": ALARM_PRICE}
        return copy.deepcopy({**self.settings, **length, **pool})

    @property
    def world_kwargs(self) -> dict[str, Any]:
        """All settings but whom the spoofer meets; a copy."""
        return copy.deepcopy(self.settings)

    @property
    def suite_kwargs(self) -> dict[str, Any]:
        """Keyword arguments of a benchmark's `Suite`; a copy."""
        limit = {} if self.alert_limit_m is None else {"alert_limit_m": self.alert_limit_m}
        return {**self.world_kwargs, "detectors": (self.detector,), **limit}


RATE = {"false_alarms_per_hour": 0.2}
"""Of every detector of the tasks, but for the hidden ones of T6."""
NOMINAL = {"thresholds": "nominal"}
"""Thresholds of the papers, as their own environments have them."""
EWMA = {"name": "ewma", "smoothing": 0.1, "weight_scale": 0.3}
DRAWN = {
    "start_s": [0.0, None],
    "turned_deg": [0.0, 360.0],
    "constellation_time_s": [0.0, 86_400.0],
    "worlds": 32,
    "turn_on": "drawn",
}
"""What every headline draws: onset, heading, sky and the turn-on constants of the sensors."""
RANGE_RATES = {"signals": "range_rate"}
LONG_SEPARATION = {"name": "solution-separation", "longest_s": 360.0, "spacing_s": 60.0}
"""A bank of coasting solutions that covers an attack of 325 s."""

TASKS: dict[str, Task] = {
    task.key: task
    for task in (
        Task(
            "T1",
            "the papers' world, snapshot chi-square",
            {"scenario": "zhong2025", "attack": "false-position-ideal"},
            ({"name": "snapshot-chi2", **RATE},),
            historical=True,
        ),
        Task(
            "T2",
            "the papers' world, EWMA chart with weights",
            {"scenario": "zhong2025", "attack": "false-position-ideal"},
            ({**EWMA, **RATE},),
            historical=True,
        ),
        Task(
            "T3",
            "drawn worlds, matched receiver, solution separation, alert limit 20 m",
            {"scenario": "trolley", "receiver": "matched", "domain": DRAWN},
            ({"name": "solution-separation", **RATE},),
            20.0,
        ),
        Task(
            "T4",
            "tactical sensors, five minutes along an airway, alert limit 556 m",
            {
                "scenario": {"name": "trolley-tactical", "flight": "airway"},
                "receiver": "matched",
                "timeline": {"warmup_s": 500.0, "live_s": 420.0, "attack_s": 325.0},
                "domain": DRAWN,
            },
            ({**LONG_SEPARATION, **RATE},),
            556.0,
        ),
        Task(
            "T5",
            "drawn worlds, a counterfeit that is quieter than nature, alert limit 20 m",
            {"scenario": "trolley", "receiver": "matched", "attack": "quiet", "domain": DRAWN},
            ({"name": "solution-separation", **RATE},),
            20.0,
        ),
        Task(
            "T6",
            "one of eight hidden detectors, whose thresholds differ, alert limit 40 m",
            {"scenario": "trolley", "receiver": "matched", "domain": DRAWN},
            tuple(
                {**whom, "false_alarms_per_hour": rate}
                for whom in (
                    {"name": "solution-separation"},
                    {"name": "aime", **RANGE_RATES},
                    {"name": "sequential-chi2", **RANGE_RATES},
                    {"name": "cumulative-bank", **RANGE_RATES},
                )
                for rate in (0.1, 0.4)
            ),
            40.0,
        ),
    )
}
"""The tasks by their keys."""
RANGE_RATE_TESTS: tuple[dict[str, Any], ...] = tuple(
    {"name": name, **RANGE_RATES}
    for name in (
        "aime",
        "cumulative-bank",
        "cusum",
        "fma",
        "sequential-chi2",
        "shewhart",
        "snapshot-chi2",
        "windowed-chi2",
    )
)
"""Detectors that test range rates alone, where their defaults test pseudoranges, or both."""


def task_of(key: str) -> Task:
    """Task by its key.

    Parameters
    ----------
    key : str
        ``"T1"`` to ``"T6"``.

    Returns
    -------
    Task
        The task.

    Raises
    ------
    ValueError
        When there is none; the valid ones are listed.

    Examples
    --------
    >>> from spoofgym.tasks import task_of
    >>> task_of("T4").alert_limit_m
    556.0
    """
    check_choice("task", key, TASKS)
    return TASKS[key]


PAPERS: dict[str, tuple[str, dict[str, Any]]] = {
    "ke2022": (
        "spoofgym/TightlyCoupled-v0",
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
        "spoofgym/TightlyCoupled-v0",
        {"scenario": "zhong2025", "attack": "paper-ideal", "detector": {**EWMA, **NOMINAL}},
    ),
}
"""Environments of the papers' scenarios: id and keyword arguments, by the keys of the papers."""
