r"""The alarm budget: how much more often than without attack an alarm may come.

Runs are paired: the same seeds with and without attack.  Over R runs with alarms
:math:`a_r, c_r \in \{0, 1\}` the excess and its standard error are

.. math:: \bar\Delta = \frac1R \sum_r (a_r - c_r), \qquad
    s = \sqrt{\operatorname{var}(a_r - c_r) / R}

and who is chosen on these runs keeps the budget b with a margin of c standard errors,

.. math:: \bar\Delta + c s \le b,

so that other runs, most likely, keep it too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

BUDGET, MARGIN = 0.05, 2.0
"""Defaults: five points more runs with an alarm, with two standard errors of distance."""


class Excess(NamedTuple):
    """How much more often than without attack an alarm came.  `value`: as a part of the runs."""

    value: float
    error: float

    def keeps(self, budget: float, margin: float) -> bool:
        """Whether a budget is kept."""
        return self.value + margin * self.error <= budget + 1e-9


def excess_of(alarm: ArrayLike, clean_alarm: ArrayLike) -> Excess:
    """Excess of alarms over those without attack.

    `alarm`, `clean_alarm` (R,) bool, of the same runs.
    """
    paired = np.asarray(alarm, dtype=np.float64) - np.asarray(clean_alarm, dtype=np.float64)
    return Excess(float(paired.mean()), float(paired.std()) / math.sqrt(len(paired)))


def reach(budget: float, margin: float, error: float) -> float:
    """Excess that a search or a training aims at, so that what is chosen from it keeps the margin.

    `error`: standard error of an excess near the budget, on as many runs as the choice will be made
    on; returns at least a fifth of the budget, since there is nothing to find far below it.
    """
    return max(budget - margin * error, 0.2 * budget)


def largest_within(
    keeps: Callable[[float], bool],
    first: float,
    *,
    step: float = 1.15,
    walks: int = 4,
    halvings: int = 2,
) -> None:
    """Try factors on an attack around the largest one that keeps the budget.

    From the first factor it walks in steps, up while the budget is kept and down while it is not;
    the step over the edge is then halved.  Where alarms come the more often the larger the factor
    is, the edge lies within ``step ** (1 / 2 ** halvings)`` of the largest one that kept it.

    `first`: factor to begin at, above 0; `step`: ratio of neighbouring factors of the walk, above
    1.
    """
    within, at = keeps(first), first
    for _ in range(walks):
        there = at * step if within else at / step
        if keeps(there) != within:
            halve(keeps, min(at, there), max(at, there), halvings)
            return
        at = there


def halve(keeps: Callable[[float], bool], low: float, high: float, halvings: int) -> None:
    """Try factors between one that keeps the budget and one that does not, halving their ratio.

    `low`, `high`: the one that keeps it, above 0, and the one that does not.
    """
    for _ in range(halvings):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if keeps(middle) else (low, middle)
