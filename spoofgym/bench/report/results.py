"""Calibrations and hold-outs, and data sets as tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import attrgetter
from typing import Any

from ...calibration.holdouts import HoldOut
from .table import Table


def _scale(point: dict[str, Any]) -> str | None:
    if point["scale"] is None:
        return None
    return f"{point['scale']:.6g}{' (fitted tail)' if point['extrapolated'] else ''}"


CALIBRATIONS = Table(
    ("detector", "detector"),
    ("runs", "runs"),
    ("scale", _scale),
    ("per hour", lambda point: point.get("false_alarms_per_hour"), "{:g}".format),
    ("per run", lambda point: point.get("per_run"), lambda x: f"{100 * x:.3g} %"),
    ("warm-up alarms", lambda point: point.get("warmup_alarms"), lambda x: f"{100 * x:.2g} %"),
    ("file", "file"),
)
"""Rows: operating points with ``detector`` and ``file``; without one ``scale`` is None."""


def _rate(per_hour: float) -> str:
    return f"{per_hour:.3g}" if math.isfinite(per_hour) else "every run"


HOLD_OUTS = Table(
    ("detector", attrgetter("name")),
    ("runs", attrgetter("runs")),
    ("alarms", attrgetter("alarms")),
    ("predicted", lambda one: None if one.holds is None else f"{one.low} to {one.high}"),
    ("holds", attrgetter("holds"), lambda holds: "yes" if holds else "NO"),
    ("per hour", attrgetter("per_hour"), _rate),
    ("promised", attrgetter("promised"), lambda x: f"{100 * x:.3g} % of runs"),
)
WORST_WORLD = (
    "worst world per hour (by chance)",
    attrgetter("worst_world"),
    lambda rates: f"{_rate(rates[0])} ({_rate(rates[1])})",
)
BY_AGE = (
    "per hour by age",
    attrgetter("per_hour_by_age"),
    lambda rates: ", ".join(f"{_rate(x)} from {age / 60:g} min" for age, x in rates.items()),
)


def print_hold_outs(title: str, found: Sequence[HoldOut]) -> None:
    """Print counted alarms; the worst world and the ages too where several were drawn."""
    more = [WORST_WORLD] if any(one.worst_world for one in found) else []
    more += [BY_AGE] if any(one.ages for one in found) else []
    Table(*HOLD_OUTS.columns, *more).print(title, found)


DATASET = Table(
    *((name, name) for name in ("split", "runs", "episodes", "clean")),
    (
        "attacks by family",
        lambda row: ", ".join(f"{name} {count}" for name, count in row["families"].items()),
    ),
    ("shards", "shards"),
    ("MB", lambda row: f"{row['bytes'] / 1e6:.1f}"),
)
"""Its rows are the splits of a data set."""
