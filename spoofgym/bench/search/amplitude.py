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
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from ...core.declared import setting, settings_record
from ...envs.spoofer_binding import get_tuning_range
from ...spoofers import make_spoofer
from ..runs.panel import Panel, PanelAttack, Search
from ..runs.players import PlayerSpec
from ..runs.record import compute_displacement
from ..scores.at_budget import AlarmCurve
from ..scores.scores import Stealth, score_stealth
from ..scores.statistics import BUDGET, build_log_grid, fewest_runs, rounded_down

RULES = UPPER_LIMIT, EXACT = "upper-limit", "exact"
"""How an amplitude is fitted to the alarm budget: by the upper 95 % limit of the alarm rate on
training runs, or to exactly the budget on the runs that are scored (`alarm_amplitude`)."""
EXACT_PLAYS = 10.0  # of each run that an exact search takes, roughly
CURVES = 5.25  # plays of an open-loop attack, which fits five curves, by those of one fit
RESOLUTION = 1.02
"""Ratio of the smallest value known to be over the budget to the largest one known to keep it."""


@settings_record(frozen=True, kw_only=True)
class Tuning:
    """How a spoofer's amplitude is searched for, within an alarm budget."""

    runs: int = setting(default=1024, least=2, help="Training runs.")
    sift_runs: int = setting(
        default=64, least=1, help="Training runs that are enough to find the neighbourhood."
    )
    values: int = setting(
        default=20, least=3, help="Log-spaced values over the whole range that are sifted."
    )
    refined: int = setting(
        default=5,
        least=2,
        help="Log-spaced values around a peak within the budget, tried on all training runs.",
    )
    budget: float = setting(
        default=BUDGET,
        above=0.0,
        below=1.0,
        help="Largest P(alarm | silent twin): of the runs whose clean twin raises no alarm, the "
        "share with an alarm under attack.",
    )
    rule: str = setting(
        default=UPPER_LIMIT,
        one_of=RULES,
        help="What has to keep to the budget: ``upper-limit``, the upper 95 % limit of the alarm "
        "rate on training runs; ``exact``, the alarm rate itself on the runs that are scored.",
    )
    quick: bool = setting(
        default=False,
        omitted=True,
        help="Whether the search for an open-loop attack takes 96 runs and aims at the budget "
        "alone, not at half of the runs alarming and at the alert limit, too.",
    )

    def as_dict(self) -> dict[str, Any]:
        """Settings, JSON-able; two of them where they are not the default, which is older."""
        left_out = {("rule", UPPER_LIMIT), ("quick", False)}
        return {key: x for key, x in asdict(self).items() if (key, x) not in left_out}

    @property
    def split(self) -> str:
        """Runs that an amplitude is fitted on."""
        return "evaluation" if self.rule == EXACT else "training"

    def __post_init__(self) -> None:
        if self.runs < fewest_runs(self.budget):
            raise ValueError(
                f"`runs` must be at least {fewest_runs(self.budget)} for a budget of "
                f"{self.budget:g}: with fewer, runs without any alarm do not show that "
                f"the budget is met; got {self.runs}"
            )


@dataclass(frozen=True)
class Trial:
    """One value on the training runs: of `runs` that it was tried on `counted` count; P(alarm |
    silent twin) with its upper 95 % limit; mean displacement over those that count. `within_budget`
    is by the limit where the value can be chosen, else by the rate."""

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
        rate, mean = (found.alarm_rate, found.displacement_m) if found.runs > 0 else (1.0, 0.0)
        return cls(value, runs, found.runs, rate, found.alarm_limit, mean, within_budget)


@dataclass(frozen=True)
class TuningResult:
    """What a search found.

    - `within_budget`: whether any value is within the budget; if not, the choice is the smallest;
    - `budget`: largest P(alarm | silent twin) that its upper limit may be;
    - `runs`, `counted`: training runs, and those that count; `clean_alarm_rate`, `warmup_alarms`:
      part of them that alarms without attack, and how many alarm before it;
    - `trials`: all that was tried, by value; `found`: settings that were looked for besides it;
    - `at_budget`, `trace`: score at exactly the budget, and by what attacks are compared there.
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
    at_budget: dict[str, Any] | None = None
    trace: AlarmCurve | None = field(default=None, repr=False, compare=False)

    @property
    def chosen(self) -> Trial:
        """The choice on all training runs."""
        return next(t for t in self.trials if t.value == self.value and t.runs == self.runs)

    @property
    def score(self) -> float:
        """Stealthy displacement of the choice [m]; 0 where nothing keeps the budget."""
        return self.chosen.stealthy_displacement_m if self.within_budget else 0.0

    def as_dict(self) -> dict[str, Any]:
        left_out = {"trace"} if self.at_budget else {"trace", "at_budget"}
        named = asdict(replace(self, trace=None))
        named["trials"] = [asdict(trial) for trial in self.trials]
        return {key: x for key, x in named.items() if key not in left_out}

    def arrays(self) -> dict[str, Any]:
        """What `as_dict` leaves out."""
        return {} if self.trace is None else self.trace.parts()

    @classmethod
    def from_dict(
        cls, data: dict[str, Any], arrays: Mapping[str, Any] | None = None
    ) -> TuningResult:
        trials = tuple(Trial(**trial) for trial in data["trials"])
        trace = AlarmCurve.from_parts(arrays, data["value"]) if arrays else None
        return cls(**{**data, "trials": trials, "trace": trace})


class _Search:
    """Trials of one spoofer against one of a panel's detectors."""

    def __init__(self, panel: Panel, number: int, entry: PlayerSpec, settings: Tuning) -> None:
        self.panel, self.number, self.player, self.settings = panel, number, entry, settings
        self.counts = panel.counts[:, number]
        self.trials: list[Trial] = []

    def try_values(self, values: Sequence[float], runs: int) -> Search[list[Trial]]:
        count = min(runs, self.panel.runs)
        played = yield [PanelAttack(self.player.with_value(value), count) for value in values]
        twin, budget = self.panel.clean[self.number].first(count), self.settings.budget
        for value, attacked in zip(values, played, strict=True):
            moved = compute_displacement(self.panel.setup, attacked, twin)
            found = score_stealth(moved, attacked.first_alarm > 0, self.counts[:count])
            everyone = count == self.panel.runs
            within = found.keeps(budget) if everyone else found.seems_to_keep(budget)
            self.trials.append(Trial.of(value, count, found, within))
        return self.trials[len(self.trials) - len(values) :]

    def try_all_runs(self, value: float) -> Search[Trial]:
        (trial,) = yield from self.try_values([value], self.panel.runs)
        return trial

    def refine(self, grid: list[float], at: int, *, peak: bool) -> Search[list[Trial]]:
        """Try values next to the best one of the grid: around a peak, or up to the edge."""
        known = len(self.trials)
        if peak:
            ends = grid[max(at - 1, 0)], grid[at + 1]
            between = build_log_grid(*ends, self.settings.refined + 2)[1:-1]
            yield from self.try_values(between, self.panel.runs)
        elif at + 1 < len(grid):
            low, high = grid[at], grid[at + 1]
            halvings = math.ceil(math.log2(max(math.log(high / low) / math.log(RESOLUTION), 1.0)))
            for _ in range(halvings):
                middle = math.sqrt(low * high)
                trial = yield from self.try_all_runs(rounded_down(middle))
                low, high = (middle, high) if trial.within_budget else (low, middle)
        return self.trials[known:]


def _best(trials: list[Trial]) -> Trial | None:
    """Most displacement within the budget; the smaller value where it is the same."""
    fitting = [trial for trial in trials if trial.within_budget]
    fitting.sort(key=lambda trial: (-trial.stealthy_displacement_m, trial.value))
    return fitting[0] if fitting else None


def tune_amplitude(
    panel: Panel, number: int, entry: PlayerSpec, detector: str, settings: Tuning
) -> Search[TuningResult]:
    """Search for the value of a spoofer's tunable setting against one of a panel's detectors."""
    setting = entry.tuned
    if setting is None:
        raise ValueError(f"{entry.label!r} has no setting that is to be tuned")
    low, high = get_tuning_range(make_spoofer(entry.with_value(1.0)), panel.setup)
    high = high if entry.largest is None else entry.largest
    grid = build_log_grid(low, high, settings.values)
    search = _Search(panel, number, entry, settings)
    best = _best((yield from search.try_values(grid, settings.sift_runs)))
    at = grid.index(best.value) if best else 0
    fine = {at: (yield from search.try_all_runs(grid[at]))}
    while not fine[at].within_budget and at > 0:
        at -= 1
        fine[at] = yield from search.try_all_runs(grid[at])
    while at + 1 < len(grid) and fine[at].within_budget:
        if at + 1 not in fine:
            fine[at + 1] = yield from search.try_all_runs(grid[at + 1])
        if _best([fine[at], fine[at + 1]]) is fine[at]:
            break
        at += 1
    trials = list(fine.values())
    if fine[at].within_budget:
        peak = at + 1 in fine and fine[at + 1].within_budget
        trials += yield from search.refine(grid, at, peak=peak)
    chosen = _best(trials)
    return TuningResult(
        detector=detector,
        spoofer=entry.label,
        setting=setting,
        value=chosen.value if chosen else grid[0],
        within_budget=chosen is not None,
        budget=settings.budget,
        runs=panel.runs,
        counted=int(search.counts.sum()),
        clean_alarm_rate=float((panel.twin_alarm[:, number] > 0).mean()),
        warmup_alarms=int(panel.warmup_alarm[:, number].sum()),
        trials=tuple(sorted(search.trials, key=lambda trial: (trial.value, trial.runs))),
    )


def search_work(settings: Tuning, scored: int, *, curves: bool = False) -> float:
    """Runs that a search takes, roughly; `scored`: how many are scored, on which it is exact;
    `curves`: whether it is for curves, of which several are then fitted."""
    exact = EXACT_PLAYS * scored if settings.rule == EXACT else 0.0
    fitted = exact or (settings.refined + 2) * settings.runs
    return (CURVES if curves else 1.0) * (settings.values * settings.sift_runs + fitted)


def with_rates(entry: PlayerSpec, rates_mps: list[float]) -> PlayerSpec:
    return replace(entry, spec={**entry.spec, "rates_mps": rates_mps})
