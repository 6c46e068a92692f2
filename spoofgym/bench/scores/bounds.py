"""The bracket of a detector: its limits, and what was achieved between them.

1. The *floor* is what even a perfect detector would allow at the same rate of false alarms.
2. The *blind optimum* is the best open-loop attack that was found within the alarm budget.
3. The *zero-alarm bound* is what no attack exceeds in the mean without an alarm of its own doing.

The best attack below the floor says that the search has failed; its whole interval has to lie
there, so that chance alone does not say it.  A mean may lie above the zero-alarm bound, since the
budget pays for some alarms; it is marked where it does by more than two standard errors and 1 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

STEALTHY, HALF = "stealthy displacement", "exceeded in 50 %"
"""Scores that have a floor, as the marks name them."""
PURPOSES = {STEALTHY: "stealthy", HALF: "half"}  # which floor is each score's
ERRORS = 2.0  # standard errors by which a mean has to lie above a bound
FIRST_ORDER = 0.01
"""Part of a bound by which it has to do so, too: bounds are of first order, at one heading."""
NORMAL_95 = 1.96
SAME_RATE = 1e-6  # relative difference of two rates of false alarms that are the same one
Limits = dict[str, Any]
Row = dict[str, Any]


def bracket_of(
    point: Row,
    limits: Limits,
    cells: Sequence[Row],
    protection: Row | None,
    searches: Sequence[Row],
) -> Row:
    """Bracket of a detector, JSON-able.

    `point`: ``detector``, and the ``claimed`` rate and ``footing`` of `operating_point`; `limits`:
    of the campaign; `cells`, `protection`, `searches`: scores of the detector's cells, of its
    protection, and what was tuned against it.

    Returns ``floor_m`` by score, None where it has none; ``best_attack`` within the budget and
    ``blind_optimum``; ``zero_alarm``; ``search_failed``, scores below their floor; and
    ``above_zero_alarm``, attacks whose mean is above the bound.
    """
    floors = floors_of(point, limits["floor"])
    attacks = [cell for cell in cells if cell["spoofer"] != "none"]
    found = [_reached(cell) for cell in attacks]
    within = [each for each in found if each["within_budget"] and each["value"] is not None]
    best = max(within, key=lambda each: float(each["value"]), default=None)
    bound = bound_of(limits["zero_alarm"].get(point["detector"]))
    # where no setting of any spoofer is within the budget, nothing was achieved
    nothing = attacks and all(cell["tuned_within_budget"] is False for cell in attacks)
    achieved = {STEALTHY: {"high": 0.0} if nothing else best, HALF: headline(protection, 0.5)}
    return {
        "floor_m": floors,
        "best_attack": best,
        "blind_optimum": _optimum(cells, searches),
        "zero_alarm": bound,
        "search_failed": [
            score for score, reached in achieved.items() if _below(reached, floors[score])
        ],
        "above_zero_alarm": [each for each in within if _above(each, bound)],
    }


def floors_of(point: Row, floor: Row | None) -> dict[str, float | None]:
    """Floors at a detector's rate of false alarms; none at nominal thresholds or for a pool. A
    detector that never alarms has those of the others in its table, the first rate's."""
    nothing = dict.fromkeys(PURPOSES)
    if floor is None or "why" in floor:
        return nothing
    if point["claimed"] is None:
        if point["footing"] != "any":
            return nothing
        rate = floor["p_fa"]
    else:
        rate = point["claimed"]["per_run"]
    for each in floor["rates"]:
        if abs(each["p_fa"] - rate) <= SAME_RATE * rate:
            return {score: each["floor_m"][name]["value"] for score, name in PURPOSES.items()}
    return nothing


def headline(protection: Row | None, share: float, *, skies: bool = False) -> Row | None:
    """Row of the induced horizontal error that is exceeded in a share of the runs."""
    for row in [] if protection is None else protection["exceeded"]:
        wanted = ("undetected_displacement_m", share, skies)
        if (row["measure"], row["share"], row["worst_skies"]) == wanted:
            return dict(row)
    return None


def _reached(cell: Row) -> Row:
    tuned = cell["tuned_within_budget"]
    keeps = bool(cell["within_budget"]) and tuned is not False
    return {
        "spoofer": cell["spoofer"],
        **cell["stealthy_displacement_m"],
        "within_budget": keeps,
        "tuned_within_budget": tuned,
    }


def _optimum(cells: Sequence[Row], searches: Sequence[Row]) -> Row | None:
    curves = [cell for cell in cells if cell["spoofer_settings"]["name"] == "blind-optimum"]
    found = [each for each in map(_reached, curves) if each["value"] is not None]
    if not found:
        return None
    best = max(found, key=lambda each: (each["within_budget"], float(each["value"])))
    found_by = {each["spoofer"]: each["found"] or {} for each in searches}
    search = found_by.get(best["spoofer"], {})
    return {**best, "by": search.get("by"), "curve": search.get("played", {}).get("curve")}


def bound_of(found: Row | None) -> Row:
    """Zero-alarm bound of the attack within its limits where there is one, else of a free one."""
    if found is None:
        return {"value": None, "kind": "", "attacker": "", "why": "not computed"}
    attacker = "free" if found["restricted_m"] is None else "restricted"
    value = found[f"{attacker}_m"]
    if value is None:
        return {"value": None, "kind": "", "attacker": "", "why": found["why"]}
    return {"value": value, "kind": found["kind"], "attacker": attacker, "why": ""}


def _below(reached: Row | None, floor: float | None) -> bool:
    if reached is None or floor is None or reached["high"] is None:
        return False
    return float(reached["high"]) < floor


def _above(reached: Row, bound: Row) -> bool:
    value, ends = bound["value"], (reached["low"], reached["high"])
    if not isinstance(value, float | int) or None in ends:
        return False
    error = (float(ends[1]) - float(ends[0])) / (2.0 * NORMAL_95)
    return float(reached["value"]) - value > max(ERRORS * error, FIRST_ORDER * value)
