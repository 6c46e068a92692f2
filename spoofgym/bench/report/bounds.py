"""The bracket of the detectors in words: cells of the tables, marks, and what the floor assumes."""

from __future__ import annotations

import re
from typing import Any

from ..scores.campaign import HALF, STEALTHY
from ..search.open_loop import FOUND

Row = dict[str, Any]
SEARCH_FAILED = "search failed"
ABOVE_BOUND = ", above the zero-alarm bound"
UNBOUNDED = "unbounded"
EXCEEDED = (
    "*Above the zero-alarm bound*: a mean that exceeds it by more than two standard errors and "
    "1 %. That is no contradiction. The bound holds for the mean of an attack that raises no alarm "
    "by its own doing, at a passive test with a convex no-alarm set and fixed gains, along the "
    "heading of the attack, over a few drawn worlds. An attack with an alarm budget raises some, "
    "and what it displaces before them counts; and the score takes the largest distance in any "
    "direction."
)


def size(value: float) -> str:
    """Metres, with as many digits as suit them."""
    return f"{value:.{0 if value >= 100.0 else 1 if value >= 1.0 else 2}f}"


def floor_cell(bracket: Row, score: str) -> str:
    """Floor of a score; ``-`` where it has none."""
    value = bracket["floor_m"][score]
    return "-" if value is None else size(value)


def bound_cell(bracket: Row) -> str:
    """Zero-alarm bound, ``<=`` before an upper one; ``none`` where none is known."""
    bound = bracket["zero_alarm"]
    if bound["value"] is None:
        return "none" if bound["why"] else "-"
    if bound["value"] == UNBOUNDED:
        return UNBOUNDED
    return ("<= " if bound["kind"] == "upper" else "") + size(bound["value"])


def bracket_marks(bracket: Row) -> list[str]:
    """What the bracket says of a detector's row."""
    marks = []
    if bracket["search_failed"]:
        marks.append(f"{SEARCH_FAILED}: {', '.join(bracket['search_failed'])}")
    if bracket["above_zero_alarm"]:
        names = ", ".join(each["spoofer"] for each in bracket["above_zero_alarm"])
        marks.append(f"above the zero-alarm bound: {names}")
    return marks


def floor_notes(summary: Row) -> list[str]:
    """What the floors are, and under which assumptions they hold; why there are none."""
    floor = summary["limits"]["floor"]
    if floor is None:
        return ["Floor: not computed yet."]
    if "why" in floor:
        return [f"Floor: none, since {floor['why']}."]
    budget = 100.0 * summary["budget"]
    asked = {
        "half": f"finds half of the attacks ({HALF})",
        "stealthy": f"may be alarmed in {budget:g} % more of the runs ({STEALTHY})",
    }
    lines = []
    for each in floor["rates"]:
        parts = [f"{_spread(each['floor_m'][name])} where it {x}" for name, x in asked.items()]
        lines.append(
            f"Floor, what even a perfect detector would allow at false alarms in "
            f"{100.0 * each['p_fa']:.3g} % of the runs, knowing all of the attack but its heading: "
            f"{'; '.join(parts)}. Median of {floor['worlds']} drawn worlds, in brackets 10 to "
            "90 %."
        )
    return [*lines, f"It assumes: {'; '.join(floor['assumptions'])}."]


def _spread(found: Row) -> str:
    """Floor over the worlds."""
    if found["value"] is None:
        return "no end"
    low, high = (UNBOUNDED if x is None else size(x) for x in (found["low"], found["high"]))
    return f"{size(found['value'])} m ({low} to {high})"


def bound_notes(summary: Row) -> list[str]:
    """Which detectors have no zero-alarm bound, and why; one line for each reason."""
    labels: dict[str, list[str]] = {}
    for row in summary["detectors"]:
        bound = row["bracket"]["zero_alarm"]
        if bound["value"] is None and bound["why"]:
            why = re.sub(r"^no zero-alarm bound for \w+: ", "", bound["why"])
            labels.setdefault(why, []).append(row["detector"])
    return [f"{', '.join(names)}: {why}" for why, names in labels.items()]


def bracket_section(summary: Row) -> list[str]:
    """Lines of the report on the bracket, Markdown."""
    lines = [
        "*Floor*, *blind optimum* and *zero-alarm bound* bracket what was achieved: what even a "
        "perfect detector would allow, the best open-loop attack that was found within the alarm "
        "budget, and what no attack exceeds in the mean without an alarm of its own doing. "
        "`<=` is an upper bound, without it the bound is exact. *Search failed*: the 95 % interval "
        f"of the best attack within the budget ({STEALTHY}), or of the worst one ({HALF}), lies "
        "below its floor, or nothing was found within the budget; that says nothing good of the "
        "detector: a better attack exists.",
        "",
        *(f"- {line}" for line in floor_notes(summary)),
        *(f"- No zero-alarm bound of {line}" for line in bound_notes(summary)),
        *_searches(summary),
        "",
    ]
    if any(row["bracket"]["above_zero_alarm"] for row in summary["detectors"]):
        lines += [EXCEEDED, ""]
    return lines


def _searches(summary: Row) -> list[str]:
    """By what the blind optima were found, and where another curve got farther once fitted."""
    labels: dict[str, list[str]] = {}
    for row in summary["detectors"]:
        optimum = row["bracket"]["blind_optimum"]
        if optimum is not None and optimum["by"] is not None:
            other = optimum["curve"] not in (None, FOUND)
            shape = f" ({optimum['curve']})" if other else ""
            labels.setdefault(optimum["by"], []).append(row["detector"] + shape)
    return [f"- Blind optimum by {by}: {', '.join(names)}" for by, names in labels.items()]
