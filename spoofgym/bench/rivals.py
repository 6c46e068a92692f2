"""Spoofers compared on equal footing: what one achieves over the best ramp and the best profile.

Two spoofers are comparable where both keep the alarm budget: at most so many more of the runs with
an alarm than without attack, by the same detector.  Whether they do is seen on the evaluation runs.

The reference among the ramps is the one with the larger mean undetected displacement, on these
very runs, among those whose search found a value within the budget.  It is not known beforehand
which one that will be, so that the choice favours the ramps.  The reference among the profiles is
the best one by the same measure among those that were made for this detector, receiver, scenario,
timeline and attack, which kept the budget on the runs of their search.  As a ramp, it stays the
reference where it is over the budget here, and is marked.  Where no profile was made for all this,
it is the best one that keeps the budget on these runs.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .cells import Cell
from .metrics import NOTHING, Estimate, bootstrap_mean, percentiles, wilson

PROFILE = "profile"
RAMPS = ("accelerating-ramp", "ramp")
SCRIPTED = ("none", "step", *RAMPS)
"""Spoofers that are references only; all others are compared with them."""


def excess_alarms(cell: Cell, clean: Cell, samples: NDArray[np.int64]) -> Estimate:
    """How many more of the runs alarm under attack than without, run by run.

    `samples` (S, R) bootstrap samples of the runs.
    """
    return bootstrap_mean(cell.alarmed.astype(np.float64) - clean.alarmed, samples)


def bootstrap_ratio(values: ArrayLike, others: ArrayLike, samples: NDArray[np.int64]) -> Estimate:
    """Ratio of two means over the same runs, with its percentile interval.

    `values`, `others` (R,) above and below the line, one of each run; `samples` (S, R) bootstrap
    samples of the runs; returns unknown where the mean below the line is 0.
    """
    x, y = (np.asarray(v, dtype=np.float64) for v in (values, others))
    if not y.mean():
        return NOTHING
    above, below = x[samples].mean(axis=1), y[samples].mean(axis=1)
    drawn = np.divide(above, below, out=np.full_like(above, np.nan), where=below > 0.0)
    return percentiles(float(x.mean() / y.mean()), drawn)


def footing(
    cell: Cell, clean: Cell | None, budget: float, samples: NDArray[np.int64]
) -> dict[str, Any]:
    """Alarm rate of a cell, and whether it keeps the budget.

    `clean`: the ``none`` cell of the same detector; None while it is not finished; `samples` (S, R)
    bootstrap samples of the runs; returns ``alarm_rate``; ``alarm_excess`` over the clean rate,
    paired; ``within_budget`` by the excess itself, not its interval.  Both None without clean runs.
    """
    found: dict[str, Any] = {"alarm_rate": wilson(int(cell.alarmed.sum()), cell.runs).as_json()}
    if clean is None:
        return {**found, "alarm_excess": None, "within_budget": None}
    excess = excess_alarms(cell, clean, samples)
    within = bool(excess.value <= budget + 1e-9)
    return {**found, "alarm_excess": excess.as_json(), "within_budget": within}


def compare_rivals(
    cells: Iterable[Cell], budget: float, samples: NDArray[np.int64]
) -> list[dict[str, Any]]:
    """Every spoofer that is not scripted, against the best ramp and the best profile.

    `samples` (S, R) bootstrap samples of the runs, the same for all; returns for every detector
    that has such a spoofer: ``detector``; ``best_ramp`` and ``best_profile`` with their scores,
    None where there is none, and ``made_for_it``, whether they were made for all that the campaign
    is about; ``comparisons`` with ``ratio`` and ``difference_m`` ``over_ramp`` and
    ``over_profile``.
    """
    by_detector: dict[str, list[Cell]] = {}
    for cell in cells:
        by_detector.setdefault(cell.detector, []).append(cell)
    found = []
    for detector, group in by_detector.items():
        clean = next((cell for cell in group if cell.spoofer == "none"), None)
        rivals = [cell for cell in group if _kind(cell) not in SCRIPTED]
        if clean is None or not rivals:
            continue
        feet = {cell.spoofer: footing(cell, clean, budget, samples) for cell in group}
        ramp = _best(cell for cell in group if _is_fair_ramp(cell))
        profiles = [cell for cell in group if _kind(cell) == PROFILE]
        profile = _best(filter(_made_for_it, profiles)) or _best(
            cell for cell in profiles if feet[cell.spoofer]["within_budget"]
        )
        found.append(
            {
                "detector": detector,
                "best_ramp": _scored(ramp, feet, samples),
                "best_profile": _scored(profile, feet, samples),
                "comparisons": [
                    {
                        "spoofer": cell.spoofer,
                        **feet[cell.spoofer],
                        "over_ramp": _over(cell, ramp, samples),
                        "over_profile": _over(cell, profile, samples),
                    }
                    for cell in rivals
                ],
            }
        )
    return found


def _kind(cell: Cell) -> str:
    return str(cell.head["spoofer_settings"]["name"])


def _is_fair_ramp(cell: Cell) -> bool:
    """Whether it is a ramp whose search found a value within the budget."""
    return _kind(cell) in RAMPS and cell.head["tuned_within_budget"] is True


def _made_for_it(cell: Cell) -> bool:
    """Whether it was tuned or optimised for all that it plays in and against."""
    knowledge = cell.head["knowledge"]
    return knowledge["detector"] is not None and not knowledge["transfer"]


def _displacement(cell: Cell) -> NDArray[np.float64]:
    return np.asarray(cell.records["undetected_displacement_m"], dtype=np.float64)


def _best(cells: Iterable[Cell]) -> Cell | None:
    return max(cells, key=lambda cell: float(_displacement(cell).mean()), default=None)


def _scored(
    reference: Cell | None, feet: dict[str, dict[str, Any]], samples: NDArray[np.int64]
) -> dict[str, Any] | None:
    """A reference with its scores."""
    if reference is None:
        return None
    mean = bootstrap_mean(_displacement(reference), samples).as_json()
    name, made = reference.spoofer, _made_for_it(reference)
    scores = {"spoofer": name, "made_for_it": made, "undetected_displacement_m": mean}
    return {**scores, **feet[name]}


def _over(cell: Cell, reference: Cell | None, samples: NDArray[np.int64]) -> dict[str, Any] | None:
    """What a spoofer achieves over a reference; None where that is itself."""
    if reference is None or reference is cell:
        return None
    mine, other = _displacement(cell), _displacement(reference)
    return {
        "ratio": bootstrap_ratio(mine, other, samples).as_json(),
        "difference_m": bootstrap_mean(mine - other, samples).as_json(),
    }
