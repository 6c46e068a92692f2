"""The strongest attack of a family that keeps to an alarm budget.

A run counts as alarmed when there is an alarm between the onset and the end of the hold.  The alarm
rate of a value may exceed that of the clean runs by the budget at most, less a margin for what is
not known of it (`budget`); within that, the value with the largest mean undetected displacement is
chosen.  All of it is decided on training runs, which share no noise with those that are scored.

1. A few runs sift log-spaced values of the whole range for the neighbourhood, without a margin.
2. All training runs try the best of these, then the next larger ones as long as that is better, or
   the next smaller ones until one is within the budget.
3. Where the next larger value is over the budget, they halve the ratio of the two until the edge is
   known to `RESOLUTION`, as for other spoofers.  Where it is within the budget too, and no better,
   they try log-spaced values between both neighbours.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from .budget import excess_of, halve
from .entries import Entry, build_spoofer
from .run import Runs, WarmStart, displacement_of, play
from .suite import Tuning, spoofer_context

Tick = Callable[[float], None]
RESOLUTION = 1.015
"""Ratio of the smallest value known to be over the budget to the largest one known to keep it."""


@dataclass(frozen=True)
class Trial:
    """One value on the training runs.

    - `alarm_rate`: part of the runs with an alarm;
    - `excess`, `excess_error`: of the alarm rate over that of the same runs without attack, and its
      standard error;
    - `within_budget`: whether the excess is, with the margin where the value can be chosen.
    """

    value: float
    runs: int
    alarm_rate: float
    undetected_displacement_m: float
    excess: float
    excess_error: float
    within_budget: bool


@dataclass(frozen=True)
class TuningResult:
    """What a search found.

    - `within_budget`: whether there is any value within the budget; if not, the choice is the
      smallest;
    - `budget`, `margin`: allowed excess over the clean alarm rate, and standard errors of distance
      from it;
    - `clean_alarm_rate`: of the training runs without attack;
    - `warmup_alarms`: how many of them had a false alarm before the attack; they count like all
      others;
    - `trials`: all that was tried, by value; the choice is among those on all runs.
    """

    detector: str
    spoofer: str
    setting: str
    value: float
    within_budget: bool
    budget: float
    margin: float
    clean_alarm_rate: float
    runs: int
    warmup_alarms: int
    trials: tuple[Trial, ...]

    @property
    def chosen(self) -> Trial:
        """The choice on all training runs."""
        return next(t for t in self.trials if t.value == self.value and t.runs == self.runs)

    def as_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return {**asdict(self), "trials": [asdict(trial) for trial in self.trials]}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> TuningResult:
        """Inverse of `as_dict`."""
        trials = tuple(Trial(**trial) for trial in data["trials"])
        return cls(**{**data, "trials": trials})


class _Search:
    """Trials of one spoofer against one detector."""

    def __init__(
        self, start: WarmStart, clean: Runs, entry: Entry, settings: Tuning, tick: Tick | None
    ) -> None:
        self.start, self.clean, self.entry = start, clean, entry
        self.settings, self.tick = settings, tick
        self.trials: list[Trial] = []

    def try_value(self, value: float, runs: int) -> Trial:
        """Let the spoofer attack with a value of its setting."""
        everyone = runs >= self.start.receivers
        start = self.start if everyone else self.start.first(runs)
        advance = self.tick
        tick = None if advance is None else lambda part: advance(part * start.receivers)
        attacked = play(start, self.entry.with_value(value), drop_alarmed=True, tick=tick)
        clean = self.clean.first(start.receivers)
        alarm = attacked.alarm.any(axis=0)
        excess = excess_of(alarm, clean.alarm.any(axis=0))
        trial = Trial(
            value=value,
            runs=start.receivers,
            alarm_rate=float(alarm.mean()),
            undetected_displacement_m=float(displacement_of(start.setup, attacked, clean).mean()),
            excess=excess.value,
            excess_error=excess.error,
            within_budget=excess.keeps(
                self.settings.budget, self.settings.margin if everyone else 0.0
            ),
        )
        self.trials.append(trial)
        return trial

    def refine(self, grid: list[float], at: int, *, peak: bool) -> list[Trial]:
        """Try values next to the best one of the grid: around a peak, or up to the edge."""
        everyone, known = self.start.receivers, len(self.trials)
        if peak:
            ends = grid[max(at - 1, 0)], grid[at + 1]
            for value in _log_spaced(*ends, self.settings.refined + 2)[1:-1]:
                self.try_value(value, everyone)
        elif at + 1 < len(grid):
            low, high = grid[at], grid[at + 1]
            halvings = math.ceil(math.log2(max(math.log(high / low) / math.log(RESOLUTION), 1.0)))
            halve(self._keeps, low, high, halvings)
        return self.trials[known:]

    def _keeps(self, value: float) -> bool:
        """Whether all runs together keep the budget at a value, once it is rounded."""
        return self.try_value(_rounded(value), self.start.receivers).within_budget


def _best(trials: list[Trial]) -> Trial | None:
    """Most displacement within the budget; the smaller value where it is the same."""
    fitting = [trial for trial in trials if trial.within_budget]
    fitting.sort(key=lambda trial: (-trial.undetected_displacement_m, trial.value))
    return fitting[0] if fitting else None


def tune(
    start: WarmStart,
    clean: Runs,
    entry: Entry,
    detector: str,
    settings: Tuning,
    *,
    tick: Tick | None = None,
) -> TuningResult:
    """Search for the value of a spoofer's tunable setting."""
    setting = entry.tuned
    if setting is None:
        raise ValueError(f"{entry.label!r} has no setting that is to be tuned")
    any_value = build_spoofer(entry.with_value(1.0))
    low, high = type(any_value).tuning_range(spoofer_context(start.setup))
    grid = _log_spaced(low, high, settings.values)
    everyone = start.receivers
    search = _Search(start, clean, entry, settings, tick)
    best = _best([search.try_value(value, settings.sift_runs) for value in grid])
    at = grid.index(best.value) if best else 0
    fine = {at: search.try_value(grid[at], everyone)}
    while not fine[at].within_budget and at > 0:
        at -= 1
        fine[at] = search.try_value(grid[at], everyone)
    while at + 1 < len(grid) and fine[at].within_budget:
        if at + 1 not in fine:
            fine[at + 1] = search.try_value(grid[at + 1], everyone)
        if _best([fine[at], fine[at + 1]]) is fine[at]:
            break
        at += 1
    trials = list(fine.values())
    if fine[at].within_budget:
        peak = at + 1 in fine and fine[at + 1].within_budget
        trials += search.refine(grid, at, peak=peak)
    chosen = _best(trials)
    return TuningResult(
        detector=detector,
        spoofer=entry.label,
        setting=setting,
        value=chosen.value if chosen else grid[0],
        within_budget=chosen is not None,
        budget=settings.budget,
        margin=settings.margin,
        clean_alarm_rate=float(clean.alarm.any(axis=0).mean()),
        runs=everyone,
        warmup_alarms=int(start.warmup_alarm.sum()),
        trials=tuple(sorted(search.trials, key=lambda trial: (trial.value, trial.runs))),
    )


def _log_spaced(low: float, high: float, count: int) -> list[float]:
    """Log-spaced values, rounded."""
    return [_rounded(value) for value in np.geomspace(low, high, count)]


def _rounded(value: float) -> float:
    """Number rounded down to four digits, so that a choice can be written down."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 3.0)
    return float(f"{math.floor(value / digit + 1e-6) * digit:.6g}")
