r"""The alarm budget: how often a spoofer may be noticed where chance alone would be silent.

What counts are runs that are silent without the spoofer (`scores.counted`).  With k alarms in n of
them, the largest probability of an alarm that is not refuted at the level :math:`\alpha` is
(one-sided, `clopper1934`)

.. math:: \bar p = B_{1 - \alpha}(k + 1, n - k)

a quantile of the beta distribution, and who is chosen on these runs keeps the budget b where
:math:`\bar p \le b`, so that other runs, most likely, keep it too.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from scipy import special

BUDGET = 0.05
"""Default: an alarm in at most five of a hundred runs that are silent without the spoofer."""
LEVEL = 0.05
"""Probability with which the limit of an alarm rate is too low."""


def alarm_limit(alarms: int, runs: int) -> float:
    """Upper 95 % limit of the probability of an alarm; 1 where no run counts."""
    if alarms >= runs:
        return 1.0
    return float(special.betaincinv(alarms + 1.0, runs - alarms, 1.0 - LEVEL))


def keeps(alarms: int, runs: int, budget: float) -> bool:
    """Whether the limit is within a budget."""
    return alarm_limit(alarms, runs) <= budget + 1e-9


def fewest_runs(budget: float) -> int:
    """Runs without any alarm that it takes to keep a budget."""
    return math.ceil(math.log(LEVEL) / math.log1p(-budget) - 1e-9)


def most_alarms(runs: int, budget: float) -> int:
    """Alarms with which so many runs keep a budget; -1 where they are too few."""
    return next((k for k in range(runs, -1, -1) if keeps(k, runs, budget)), -1)


def aim(runs: int, budget: float) -> float:
    """Alarm rate that a search or a training aims at, so that its choice on so many runs keeps it.
    At least a fifth of the budget, since there is nothing to find far below it."""
    return max(most_alarms(runs, budget) / max(runs, 1), 0.2 * budget)


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
    `low`, `high`: the one that keeps it, above 0, and the one that does not."""
    for _ in range(halvings):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if keeps(middle) else (low, middle)
