r"""The strongest attack of a family that keeps to an alarm budget.

Every spoofer has one amplitude that is fitted: a ramp its rate, an accelerating ramp its
acceleration, any other a factor on all that it commands.  Of the runs that count (`scores`), as
many may alarm as the upper limit of their alarm rate allows (`budget`); within that, the value with
the largest stealthy displacement is chosen.  All of it is decided on training runs, which share no
noise with those that are scored.

1. A few runs sift log-spaced values of the whole range for the neighbourhood, by the rate itself.
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

from ...envs.spoofer_binding import tuning_range_of
from ...spoofers import make_spoofer
from ..runs.play import Runs, WarmStart, displacement_of, play
from ..runs.players import PlayerSpec
from ..scores.scores import Stealth, counted, stealth_of
from ..scores.statistics import halve
from .settings import Tuning, log_spaced, rounded_down

Tick = Callable[[float], None]
RESOLUTION = 1.02
"""Ratio of the smallest value known to be over the budget to the largest one known to keep it."""


@dataclass(frozen=True)
class Trial:
    """One value on the training runs.

    - `runs`: how many it was tried on; `counted`: how many of them count;
    - `alarm_rate`, `alarm_limit`: P(alarm | silent twin), and its upper 95 % limit;
    - `stealthy_displacement_m`: mean over the runs that count;
    - `within_budget`: by the limit where the value can be chosen, else by the rate.
    """

    value: float
    runs: int
    counted: int
    alarm_rate: float
    alarm_limit: float
    stealthy_displacement_m: float
    within_budget: bool

    @classmethod
    def of(cls, value: float, runs: int, found: Stealth, within_budget: bool) -> Trial:
        """Trial by what came of it; of no run that counts the rate is 1."""
        known = found.runs > 0
        rate, mean = (found.alarm_rate, found.displacement_m) if known else (1.0, 0.0)
        return cls(value, runs, found.runs, rate, found.alarm_limit, mean, within_budget)


@dataclass(frozen=True)
class TuningResult:
    """What a search found.

    - `within_budget`: whether there is any value within the budget; if not, the choice is the
      smallest;
    - `budget`: largest P(alarm | silent twin) that its upper limit may be;
    - `runs`, `counted`: training runs, and those among them that count;
    - `clean_alarm_rate`, `warmup_alarms`: part of them that alarms without attack, and how many
      alarm before it;
    - `trials`: all that was tried, by value; the choice is among those on all runs;
    - `found`: settings of a spoofer that was looked for besides its value, and how; or None.
    """

    detector: str
    spoofer: str
    setting: str
    value: float
    within_budget: bool
    budget: float
    runs: int
    counted: int
    clean_alarm_rate: float
    warmup_alarms: int
    trials: tuple[Trial, ...]
    found: dict[str, Any] | None = None

    @property
    def chosen(self) -> Trial:
        """The choice on all training runs."""
        return next(t for t in self.trials if t.value == self.value and t.runs == self.runs)

    @property
    def score(self) -> float:
        """Stealthy displacement of the choice [m]; 0 where nothing keeps the budget."""
        return self.chosen.stealthy_displacement_m if self.within_budget else 0.0

    def as_dict(self) -> dict[str, Any]:
        return {**asdict(self), "trials": [asdict(trial) for trial in self.trials]}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> TuningResult:
        """Inverse of `as_dict`."""
        trials = tuple(Trial(**trial) for trial in data["trials"])
        return cls(**{**data, "trials": trials})


class _Search:
    """Trials of one spoofer against one detector."""

    def __init__(
        self, start: WarmStart, clean: Runs, entry: PlayerSpec, settings: Tuning, tick: Tick | None
    ) -> None:
        self.start, self.clean, self.entry = start, clean, entry
        self.settings, self.tick = settings, tick
        self.counts = counted(start.warmup_alarm, clean.first_alarm)
        self.trials: list[Trial] = []

    def try_value(self, value: float, runs: int) -> Trial:
        everyone = runs >= self.start.receivers
        start = self.start if everyone else self.start.first(runs)
        advance = self.tick
        tick = None if advance is None else lambda part: advance(part * start.receivers)
        attacked = play(start, self.entry.with_value(value), drop_alarmed=True, tick=tick)
        moved = displacement_of(start.setup, attacked, self.clean.first(start.receivers))
        found = stealth_of(moved, attacked.first_alarm > 0, self.counts[: start.receivers])
        budget = self.settings.budget
        within = found.keeps(budget) if everyone else found.seems_to_keep(budget)
        self.trials.append(Trial.of(value, start.receivers, found, within))
        return self.trials[-1]

    def refine(self, grid: list[float], at: int, *, peak: bool) -> list[Trial]:
        """Try values next to the best one of the grid: around a peak, or up to the edge."""
        everyone, known = self.start.receivers, len(self.trials)
        if peak:
            ends = grid[max(at - 1, 0)], grid[at + 1]
            for value in log_spaced(*ends, self.settings.refined + 2)[1:-1]:
                self.try_value(value, everyone)
        elif at + 1 < len(grid):
            low, high = grid[at], grid[at + 1]
            halvings = math.ceil(math.log2(max(math.log(high / low) / math.log(RESOLUTION), 1.0)))
            halve(self._keeps, low, high, halvings)
        return self.trials[known:]

    def _keeps(self, value: float) -> bool:
        """Whether all runs together keep the budget at a value, once it is rounded."""
        return self.try_value(rounded_down(value), self.start.receivers).within_budget


def _best(trials: list[Trial]) -> Trial | None:
    """Most displacement within the budget; the smaller value where it is the same."""
    fitting = [trial for trial in trials if trial.within_budget]
    fitting.sort(key=lambda trial: (-trial.stealthy_displacement_m, trial.value))
    return fitting[0] if fitting else None


def tune(
    start: WarmStart,
    clean: Runs,
    entry: PlayerSpec,
    detector: str,
    settings: Tuning,
    *,
    tick: Tick | None = None,
) -> TuningResult:
    """Search for the value of a spoofer's tunable setting."""
    setting = entry.tuned
    if setting is None:
        raise ValueError(f"{entry.label!r} has no setting that is to be tuned")
    any_value = make_spoofer(entry.with_value(1.0))
    low, high = tuning_range_of(any_value, start.setup)
    high = high if entry.largest is None else entry.largest
    grid = log_spaced(low, high, settings.values)
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
        runs=everyone,
        counted=int(search.counts.sum()),
        clean_alarm_rate=float((clean.first_alarm > 0).mean()),
        warmup_alarms=int(start.warmup_alarm.sum()),
        trials=tuple(sorted(search.trials, key=lambda trial: (trial.value, trial.runs))),
    )
