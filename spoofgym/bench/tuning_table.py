"""Tables of a search for a setting: what was tried, and how far it was from the alarm budget."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

EXCESS_HEAD = ("above clean [points]", "with the margin [points]")


def excess_texts(tried: Mapping[str, Any], margin: float) -> tuple[str, str]:
    """Excess of alarms over the clean rate, and what is compared with the budget."""
    excess, error = 100 * tried["excess"], 100 * tried["excess_error"]
    return f"{excess:+.1f}", f"{excess + margin * error:+.1f}"


def tuning_head(search: dict[str, Any]) -> tuple[str, ...]:
    """Head of the table of a search."""
    rest = ("alarm rate [%]", *EXCESS_HEAD, "undetected displacement [m]", "within budget")
    return (search["setting"], "runs", *rest)


def tuning_rows(search: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table of a search, in the order of `tuning_head`.

    Returns text; a value that was tried on a few runs only is sifted without a margin.
    """
    rows: list[tuple[str, ...]] = []
    for trial in search["trials"]:
        everyone = trial["runs"] == search["runs"]
        chosen = everyone and trial["value"] == search["value"]
        rows.append(
            (
                f"{trial['value']:g}" + (" (chosen)" if chosen else ""),
                str(trial["runs"]),
                f"{100 * trial['alarm_rate']:.1f}",
                *excess_texts(trial, search["margin"] if everyone else 0.0),
                f"{trial['undetected_displacement_m']:.2f}",
                "yes" if trial["within_budget"] else "no",
            )
        )
    return rows
