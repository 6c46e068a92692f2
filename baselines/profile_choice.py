"""The choice at the end of a search: the fastest curve that keeps the alarm budget on other runs.

For every shape that the search offers, the factor on its rates is fitted on runs that the search
has not seen, by the upper limit of its alarm rate on those that count, as the benchmark tunes its
spoofers (`spoofgym.bench.scores.statistics`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofgym.bench.scores.scores import stealth_of
from spoofgym.bench.scores.statistics import largest_within
from spoofgym.spoofers import Profile

from .profile_search import ProfileSearch
from .runs import RunPool

FloatArray = NDArray[np.float64]
WIDE, NARROW = (1.1, 3), (1.03, 1)
"""Step and halvings of `largest_within`: for the first shape, and for the others, which begin at
its factor.  Both find the edge to about 2 %, as the tuning of the ramps does."""
WALKS = 6
"""Most steps."""


@dataclass(frozen=True)
class Fit:
    """A shape with one factor on all runs of the choice.

    - `scale`: factor on its rates;
    - `counted`: runs that count;
    - `stealthy_displacement_m`: mean over them;
    - `alarm_rate`: part of them with an alarm;
    - `alarm_limit`: its upper 95 % limit;
    - `within_budget`: whether the budget is kept by that limit.
    """

    shape: str
    scale: float
    counted: int
    stealthy_displacement_m: float
    alarm_rate: float
    alarm_limit: float
    within_budget: bool


@dataclass(frozen=True)
class Choice:
    """What is taken from a search.

    - `fit`: what it does on the runs of the choice;
    - `displacement_m`: (R',) of those of these runs that count.
    """

    profile: Profile
    fit: Fit
    displacement_m: FloatArray
    fits: tuple[Fit, ...]


_Tried = tuple[Fit, Profile, FloatArray]


def choose(search: ProfileSearch, pool: RunPool, budget: float) -> Choice:
    """The largest displacement within the budget among the shapes of a search. `budget`: largest
    P(alarm | silent twin), which its upper limit keeps."""
    tried: list[_Tried] = []
    at, (step, halvings) = 1.0, WIDE
    for name, point in search.shapes().items():
        fitting = _Fitting(search, pool, name, point, budget)
        largest_within(fitting.keeps, at, step=step, walks=WALKS, halvings=halvings)
        tried += fitting.tried
        at = max((item[0].scale for item in fitting.tried if item[0].within_budget), default=at)
        step, halvings = NARROW
    kept = [item for item in tried if item[0].within_budget]
    fits = tuple(item[0] for item in tried)
    if not kept:
        least = min(fits, key=lambda fit: fit.alarm_rate)
        raise ValueError(
            f"no profile of the search is within the alarm budget: the slowest one alarms in "
            f"{100 * least.alarm_rate:.1f} % of the {least.counted} runs that are silent without "
            f"attack, which may be {100 * least.alarm_limit:.1f} %; choose a larger budget or more "
            "runs"
        )
    fit, profile, displacement = max(kept, key=lambda item: item[0].stealthy_displacement_m)
    return Choice(profile, fit, displacement, fits)


class _Fitting:
    """Factors that are tried for one shape."""

    def __init__(
        self,
        search: ProfileSearch,
        pool: RunPool,
        name: str,
        point: FloatArray,
        budget: float,
    ) -> None:
        self.search, self.pool = search, pool
        self.name, self.point, self.budget = name, point, budget
        self.tried: list[_Tried] = []

    def keeps(self, scale: float) -> bool:
        """Try a factor."""
        profile = self.search.profile(self.point, scale)
        outcome = self.pool.play([profile])
        displacement, counts = outcome.displacement_m[0], outcome.counts
        found = stealth_of(displacement, outcome.alarm[0], counts)
        known = found.runs > 0
        fit = Fit(
            self.name,
            scale,
            found.runs,
            found.displacement_m if known else 0.0,
            found.alarm_rate if known else 1.0,
            found.alarm_limit,
            found.keeps(self.budget),
        )
        self.tried.append((fit, profile, displacement[counts]))
        return fit.within_budget
