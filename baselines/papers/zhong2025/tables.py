"""The paper's tables beside ours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from spoofgym.bench.intervals import spoofing_intervals

from ..frame import Row
from .bands import (
    END_S,
    LABELS,
    ONSET_S,
    PRINTED_END,
    PRINTED_ONSET,
    end_band,
    onset_band,
)
from .delays import end_delay, onset_delay
from .runs import EPOCH_S, FIRST_S, TABLED

Data = Mapping[str, Mapping[str, Any]]


def median_of(values: Any) -> float | None:
    """Median of some delays.

    Parameters
    ----------
    values : ndarray
        (R,) [s], infinite where a run was missed.

    Returns
    -------
    float or None
        None where half of the runs were missed, or more.
    """
    middle = round(float(np.median(values)), 3)
    return middle if np.isfinite(middle) else None


def alarms(found: Mapping[str, Any], method: str) -> Any:
    """Alarms of a method, (K, R); of M1 those on the side of the attack."""
    return found["upper_M1" if method == "M1" else f"alarm_{method}"]


def table_rows(data: Data) -> list[Row]:
    """Tables 4 and 5: onset, termination and interval of every method.

    Parameters
    ----------
    data : dict
        By part.

    Returns
    -------
    list of Row
        Attack by attack.
    """
    out = []
    for number, attack in enumerate(TABLED):
        found = data[attack]
        table = "Table 4" if number < 3 else "Table 5"
        for method in ("M1", "M2", "M3"):
            row = f"{LABELS[attack]}, {method}"
            alarm = alarms(found, method)
            delay = onset_delay(alarm)
            low, high, note = onset_band(method, number, delay)
            paper = PRINTED_ONSET[method][number]
            out.append(Row(table, row, "onset delay [s]", paper, median_of(delay), low, high, note))
            first, last, note_end = end_band(method, number)
            paper_end = PRINTED_END[method][number]
            ended = median_of(end_delay(alarm))
            out.append(Row(table, row, "end delay [s]", paper_end, ended, first, last, note_end))
            begun, over = interval(alarm)
            out += [
                Row(
                    table,
                    row,
                    "interval begins [s]",
                    ONSET_S + paper,
                    begun,
                    ONSET_S + low,
                    ONSET_S + high,
                    note,
                ),
                Row(
                    table,
                    row,
                    "interval ends [s]",
                    END_S + paper_end,
                    over,
                    END_S + first,
                    END_S + last,
                    note_end,
                ),
            ]
        out += _claims(table, LABELS[attack], found)
    return out


def interval(alarm: Any) -> tuple[float | None, float | None]:
    """Median begin and end of the spoofing intervals of all runs.

    Parameters
    ----------
    alarm : ndarray
        (K, R) bool.

    Returns
    -------
    begin, end : float or None
        First onset, and end of the last interval that began within the attack [s].
    """
    time = ONSET_S + FIRST_S + EPOCH_S * np.arange(len(alarm))
    begun = np.full(alarm.shape[1], np.inf)
    over = np.full(alarm.shape[1], np.inf)
    for one in spoofing_intervals(alarm[:, :, None], time):
        if one.onset_s < END_S:
            begun[one.receiver] = min(begun[one.receiver], one.onset_s)
            over[one.receiver] = one.end_s
    return median_of(begun), median_of(over)


def _claims(table: str, label: str, found: Mapping[str, Any]) -> list[Row]:
    """What the paper says of the methods beside its delays."""
    ended = end_delay(found["alarm_M3"])
    prompt = float(np.mean((ended > 0.0) & (ended <= FIRST_S + EPOCH_S)))
    same = onset_delay(found["alarm_M2"]) == onset_delay(found["alarm_M3"])
    after = found["alarm_M1"][300:].sum(axis=0)
    wrong = found["others_M3"].mean() / 7.0
    spared = found["others_production"].mean() / 7.0
    locked = "m = 0.1 locks satellites out; the notes found 5 to 9 %"
    return [
        Row(table, f"{label}, M3", "share of runs that end in time", 1.0, prompt, 0.95, 1.0),
        Row(table, f"{label}, M3", "share with M2's onset", 1.0, float(same.mean()), 1.0, 1.0),
        Row(
            table,
            f"{label}, M1",
            "alarms after the end [epochs]",
            None,
            float(after.mean()),
            None,
            None,
            "either limit; the notes found 0.7 (35 m), 13 (0.5 m/s), 29 (0.7 m/s)",
        ),
        Row(table, f"{label}, M3", "other satellites alarmed", 0.0, wrong, 0.0, 0.09, locked),
        Row(
            table,
            f"{label}, M3 with m = 0.3",
            "other satellites alarmed",
            0.0,
            spared,
            0.0,
            0.01,
            "defaults of `joint-chart`",
        ),
    ]
