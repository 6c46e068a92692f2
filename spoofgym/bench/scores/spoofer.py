"""What a spoofer is worth against one detector."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...spoofers.base import sees_statistics
from .scores import select_clusters
from .statistics import Estimate, FloatArray, draw_resamples, percent, percentiles


@dataclass(frozen=True)
class SpooferScore:
    """What a spoofer is worth against one detector; paired with every other one of the same runs.

    - `knowledge`: what it observes while it attacks; `setting`, `value`: what was fitted, or given,
      and to what; None where nothing can be;
    - `counted`: of the `runs`, those that are silent before the onset and without an attack, over
      which all else is taken but `clean_alarm_rate`;
    - `within_budget`: whether the `budget`, the largest `alarm_rate` allowed, is met on the
      evaluation runs by the rate itself, always at exactly the budget; `fit_within_budget`: on the
      training runs, by its upper 95 % limit; None where nothing was fitted;
    - (R,) of each run `displacement_m`, `alarmed`, `counts`, `sky`; `twins`: digest of the clean
      ones;
    - `at_budget`: where the amplitude was fitted to exactly the budget, the score there with total
      and vertical errors; its displacement is the stealthy one, with the interval of the fit.
    """

    task: str | None
    detector: str
    spoofer: str
    knowledge: str
    setting: str | None
    value: float | None
    runs: int
    counted: int
    stealthy_displacement_m: Estimate
    alarm_rate: Estimate
    clean_alarm_rate: float
    budget: float
    within_budget: bool
    fit_within_budget: bool | None
    displacement_m: FloatArray = field(repr=False, compare=False)
    alarmed: NDArray[np.bool_] = field(repr=False, compare=False)
    counts: NDArray[np.bool_] = field(repr=False, compare=False)
    sky: NDArray[np.int64] = field(repr=False, compare=False)
    twins: str = field(repr=False)
    world: str = ""
    at_budget: dict[str, Any] | None = field(default=None, repr=False, compare=False)

    @property
    def keeps_budget(self) -> bool:
        """Whether the displacement is a score: the budget is met wherever it was checked."""
        return self.within_budget and self.fit_within_budget is not False

    @property
    def oracle(self) -> bool:
        """Whether it sees the detector's statistics while it attacks, impossible in practice."""
        return sees_statistics(self.knowledge)

    def ratio_to(self, other: SpooferScore, *, oracles: bool = False) -> Estimate:
        """Displacement relative to another spoofer's on the same runs, paired, at the amplitudes
        that were found. A ValueError where runs differ, or one alone is an oracle and `oracles` is
        not set."""
        if self.oracle != other.oracle and not oracles:
            raise ValueError(
                f"{self.spoofer} ({self.knowledge}) can't be compared with {other.spoofer} "
                f"({other.knowledge}): one is an oracle, which sees the detector's statistics "
                "while it attacks; pass `oracles=True` to compare them, and say so with the result"
            )
        if (self.detector, self.twins) != (other.detector, other.twins):
            raise ValueError(
                f"{self.spoofer} and {other.spoofer} have not played the same runs: "
                f"{self.detector}, {self.runs} runs and {other.detector}, {other.runs}; detector, "
                "world, their number and `entropy` must be the same"
            )
        mine, theirs = self.displacement_m[self.counts], other.displacement_m[self.counts]
        samples = draw_resamples(select_clusters(self.sky)[self.counts])
        base = float(theirs.sum())
        with np.errstate(divide="ignore", invalid="ignore"):
            drawn = (samples @ mine) / (samples @ theirs)
        return percentiles(float(mine.sum()) / base if base else math.nan, drawn)

    def as_dict(self) -> dict[str, Any]:
        players = ("task", "world", "detector", "spoofer", "knowledge")
        plain = (*players, "setting", "value", "runs", "counted")
        return {
            **{name: getattr(self, name) for name in plain},
            "stealthy_displacement_m": self.stealthy_displacement_m.as_json(),
            "alarm_rate": self.alarm_rate.as_json(),
            "clean_alarm_rate": self.clean_alarm_rate,
            "budget": self.budget,
            "within_budget": self.within_budget,
            "fit_within_budget": self.fit_within_budget,
            **({} if self.at_budget is None else {"at_budget": self.at_budget}),
        }

    def __str__(self) -> str:
        where = f"{self.detector}, {self.world if self.task is None else self.task}"
        alarms = percent(self.alarm_rate.as_json())
        what = "" if self.value is None else f", {self.setting} {self.value:.4g}"
        over = "" if self.keeps_budget else f", over the budget of {100 * self.budget:g} %"
        exact, at = self.at_budget, ", alarms"
        if exact is not None and (exact["silent_share"] or 0.0) <= 1.0 - self.budget:
            at = f" at {100 * self.budget:g} % of alarms, interpolated; as played, alarms"
        return (
            f"{self.spoofer} ({self.knowledge}{what}) against {where}: "
            f"{self.stealthy_displacement_m} m{at} in {alarms} % of {self.counted} runs{over}"
        )
