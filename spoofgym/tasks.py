r"""The tasks of `spoofgym-bench-v1`: environments whose settings never change, and their scores.

A task is an environment and an alarm budget.  What a spoofer scores is its mean undetected
displacement over the evaluation runs, by the rules of the benchmark, where it keeps the budget; and
the part of the way from the best ramp to the optimised profile that it goes,

.. math:: s = \frac{x - x_{ramp}}{x_{profile} - x_{ramp}}

so that 0 is a ramp, 1 is what an open-loop search finds, and more than 1 takes feedback.
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
"""How much more often than without attack an alarm may come, as a part of the runs."""


@dataclass(frozen=True)
class Task:
    """One task.

    - `title`: what it asks for, in a line;
    - `settings`: keyword arguments of `SpoofEnv`, JSON-able, but for the detector;
    - `detectors`: whom the spoofer meets, as `make_detector` takes them; more than one are a pool,
      from which every episode draws, and the spoofer does not know which it is;
    - `alert_limit_m`: error that the navigation must not exceed unnoticed, where the task names
      one.
    """

    key: str
    title: str
    settings: dict[str, Any]
    detectors: tuple[dict[str, Any], ...]
    alert_limit_m: float | None = None

    @property
    def env_id(self) -> str:
        """Id for `gymnasium.make`."""
        return f"spoofgym/Bench{self.key}-v1"

    @property
    def pooled(self) -> bool:
        """Whether there is more than one detector."""
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


NOMINAL = {"thresholds": "nominal"}
"""Thresholds of the papers, and at present those of the tasks."""
EWMA = {"name": "ewma", "smoothing": 0.1, "weight_scale": 0.3, **NOMINAL}
RANGE_RATES = {"name": "sequential-chi2", "signals": "range_rate", **NOMINAL}
EVERYTHING = {
    "start_s": [0.0, None],
    "turned_deg": [0.0, 360.0],
    "constellation_time_s": [0.0, 43_200.0],
    "worlds": 16,
    "imu": ["aviation", "tactical", "consumer"],
    "errors": ["zhong2025", "groves", "trolley"],
}

TASKS: dict[str, Task] = {
    task.key: task
    for task in (
        Task(
            "T1",
            "snapshot chi-square, ideal spoofer",
            {"scenario": "zhong2025", "attack": "false-position-ideal"},
            ({"name": "snapshot-chi2", **NOMINAL},),
        ),
        Task(
            "T2",
            "EWMA chart with weights, ideal spoofer",
            {"scenario": "zhong2025", "attack": "false-position-ideal"},
            (EWMA,),
        ),
        Task(
            "T3",
            "matched receiver, range rates tested, target tracked to 1 m",
            {"scenario": "trolley", "receiver": "matched", "attack": "tracking-1m"},
            # by default its tracking error alone would be seen in three runs of a hundred
            ({**RANGE_RATES, "false_alarm": 1e-7},),
        ),
        Task(
            "T4",
            "tactical sensors, half an hour, alert limit 556 m",
            {
                "scenario": {"name": "trolley-tactical", "flight": "airway"},
                "receiver": "matched",
                "attack": {"name": "tracking-1m", "rate_limit_mps": 50.0},
                "timeline": {"warmup_s": 200.0, "live_s": 180.0, "attack_s": 1800.0},
                "decision_interval_s": 10.0,
                "between": "linear",
            },
            (
                {
                    "name": "snapshot-chi2",
                    "signals": "range_rate",
                    "false_alarm": 1e-6,
                    **NOMINAL,
                },
            ),
            556.0,
        ),
        Task(
            "T5",
            "everything drawn again in every episode",
            {
                "scenario": "trolley",
                "receiver": "matched",
                "attack": "false-position-ideal",
                "domain": EVERYTHING,
                "target_heading_deg": "worst",
            },
            (RANGE_RATES,),
        ),
        Task(
            "T6",
            "a hidden pool of detectors",
            {"scenario": "zhong2025", "attack": "false-position-ideal"},
            (
                EWMA,
                {"name": "snapshot-chi2", **NOMINAL},
                {"name": "cusum", **NOMINAL},
                {"name": "innovation-rate", **NOMINAL},
                {"name": "aime", **NOMINAL},
            ),
        ),
    )
}
"""The tasks by their keys."""


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


def normalised(score: float, ramp: float, profile: float) -> float:
    """Part of the way from the best ramp to the optimised profile.

    `score`, `ramp`, `profile`: mean undetected displacements [m].
    """
    if not profile > ramp:
        raise ValueError(
            f"the profile must get farther than the ramp, got {profile:g} m and {ramp:g} m"
        )
    return (score - ramp) / (profile - ramp)


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
        {"scenario": "zhong2025", "attack": "paper-ideal", "detector": EWMA},
    ),
}
"""Environments of the papers' scenarios: id and keyword arguments, by the keys of the papers."""
