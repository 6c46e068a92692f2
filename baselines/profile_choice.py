r"""The choice at the end of a search: the fastest curve that keeps the alarm budget on other runs.

For every shape that the search offers, the factor on its rates is fitted on runs that the search
has not seen.  A curve keeps the budget b with a margin of c standard errors of the paired
difference of alarms over R runs,

.. math:: \bar\Delta + c \sqrt{\operatorname{var}(\Delta) / R} \le b

so that it also keeps it, most likely, on runs that decided nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofgym.bench.budget import excess_of, largest_within
from spoofgym.spoofers import Profile

from .profile_search import ProfileSearch
from .runs import RunPool

FloatArray = NDArray[np.float64]
WIDE, NARROW = (1.1, 3), (1.03, 1)
"""Step and halvings of `largest_within`: for the first shape, and for the others, which begin at
its factor.  Both find the edge to about 1.5 %, as the tuning of the ramps does."""
WALKS = 6
"""Most steps."""


@dataclass(frozen=True)
class Fit:
    """A shape with one factor on all runs of the choice.

    Parameters
    ----------
    shape : str
        Which one.
    scale : float
        Factor on its rates.
    undetected_displacement_m : float
        Mean over all runs.
    alarm_rate : float
        Part of the runs with an alarm.
    excess : float
        How much that is above the clean rate of the same runs.
    excess_error : float
        Standard error of the excess.
    within_budget : bool
        Whether the budget is kept, with the margin.
    """

    shape: str
    scale: float
    undetected_displacement_m: float
    alarm_rate: float
    excess: float
    excess_error: float
    within_budget: bool


@dataclass(frozen=True)
class Choice:
    """What is taken from a search.

    Parameters
    ----------
    profile : Profile
        The curve.
    fit : Fit
        What it does on the runs of the choice.
    displacement_m : ndarray
        (R,) of these runs.
    fits : tuple of Fit
        All that were tried.
    """

    profile: Profile
    fit: Fit
    displacement_m: FloatArray
    fits: tuple[Fit, ...]


_Tried = tuple[Fit, Profile, FloatArray]


def choose(search: ProfileSearch, pool: RunPool, budget: float, margin: float) -> Choice:
    """The largest displacement within the budget among the shapes of a search.

    Parameters
    ----------
    search : ProfileSearch
        With one generation at least.
    pool : RunPool
        Runs that it has not seen.
    budget : float
        How much more often than without attack an alarm may come.
    margin : float
        Distance that is kept from it, in standard errors, at least 0.

    Returns
    -------
    Choice
        Within the budget.

    Raises
    ------
    ValueError
        When no factor that was tried is within the budget.
    """
    if not (math.isfinite(margin) and margin >= 0.0):
        raise ValueError(f"`margin` must be finite and >= 0, got {margin}")
    tried: list[_Tried] = []
    at, (step, halvings) = 1.0, WIDE
    for name, point in search.shapes().items():
        fitting = _Fitting(search, pool, name, point, budget, margin)
        largest_within(fitting.keeps, at, step=step, walks=WALKS, halvings=halvings)
        tried += fitting.tried
        at = max((item[0].scale for item in fitting.tried if item[0].within_budget), default=at)
        step, halvings = NARROW
    kept = [item for item in tried if item[0].within_budget]
    fits = tuple(item[0] for item in tried)
    if not kept:
        least = min(fits, key=lambda fit: fit.excess)
        raise ValueError(
            f"no profile of the search is within the alarm budget: the slowest one alarms in "
            f"{100 * least.excess:.1f} % more of the runs than without attack, with a standard "
            f"error of {100 * least.excess_error:.1f} %; choose a larger budget or a smaller margin"
        )
    fit, profile, displacement = max(kept, key=lambda item: item[0].undetected_displacement_m)
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
        margin: float,
    ) -> None:
        self.search, self.pool = search, pool
        self.name, self.point, self.budget, self.margin = name, point, budget, margin
        self.tried: list[_Tried] = []

    def keeps(self, scale: float) -> bool:
        """Try a factor."""
        profile = self.search.profile(self.point, scale)
        outcome = self.pool.play([profile])
        displacement = outcome.displacement_m[0]
        excess = excess_of(outcome.alarm[0], outcome.clean_alarm)
        fit = Fit(
            self.name,
            scale,
            float(displacement.mean()),
            float(outcome.alarm[0].mean()),
            excess.value,
            excess.error,
            excess.keeps(self.budget, self.margin),
        )
        self.tried.append((fit, profile, displacement))
        return fit.within_budget
