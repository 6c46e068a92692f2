"""Tables of a search for a setting: what was tried, and how often it alarmed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

ALARMS_HEAD = ("P(alarm | silent twin) [%]", "its upper limit [%]")


def alarm_texts(tried: Mapping[str, Any]) -> tuple[str, str]:
    """Alarm rate of the runs that count, and the limit that is compared with the budget."""
    return f"{100 * tried['alarm_rate']:.1f}", f"{100 * tried['alarm_limit']:.1f}"


def tuning_head(search: dict[str, Any]) -> tuple[str, ...]:
    rest = ("counted", *ALARMS_HEAD, "stealthy displacement [m]", "within budget")
    return (search["setting"], "runs", *rest)


def tuning_rows(search: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table of a search, in the order of `tuning_head`. Returns text; a value that was
    tried on a few runs only is sifted by its rate."""
    rows: list[tuple[str, ...]] = []
    for trial in search["trials"]:
        everyone = trial["runs"] == search["runs"]
        chosen = everyone and trial["value"] == search["value"]
        rows.append(
            (
                f"{trial['value']:g}" + (" (chosen)" if chosen else ""),
                str(trial["runs"]),
                str(trial["counted"]),
                *alarm_texts(trial),
                f"{trial['stealthy_displacement_m']:.2f}",
                "yes" if trial["within_budget"] else "no",
            )
        )
    return rows
