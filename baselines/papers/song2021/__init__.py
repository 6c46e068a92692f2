"""Song et al. (2021): ACNA, RIO and a plain Kalman filter on a wheeled robot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..frame import Part, Row, Settings, fill_origins
from . import figures as pictures
from . import rows as tables
from .texts import CLAIMS, FINDINGS, READINGS
from .work import assumption_part, ramp_part, sweep_part, table_part, trace_part

__all__ = ["CLAIMS", "FINDINGS", "READINGS", "TITLE", "figures", "parts", "rows"]

TITLE = "Song et al. (2021)"

RUNS, QUICK_RUNS = 100, 30
RAMPS = [0.3, 0.2, 0.15, 0.1, 0.05]
JUMP_THRESHOLDS = [
    0.01,
    *np.arange(0.1, 2.05, 0.1),
    *np.arange(2.25, 4.1, 0.25),
    4.5,
    5.0,
    5.5,
    6.0,
]
SLOW_THRESHOLDS = [
    *(0.01, 0.1, 0.3, 0.5, 0.7),
    *np.arange(0.8, 2.05, 0.08),
    *np.arange(2.16, 4.1, 0.16),
    *(4.5, 5.0, 6.0, 8.0, 10.0),
]
QUICK_JUMP = [0.01, 0.5, 1.0, 1.3, 1.5, 2.0, 4.0, 6.0]
QUICK_SLOW = [0.01, 0.5, 0.9, 1.12, 1.2, 1.28, 1.4, 1.6, 2.4, 3.04, 6.0, 10.0]


def parts(settings: Settings) -> list[Part]:
    """Work of a run. Returns tables at three errors of the heading, sweeps by groups of windows,
    and the limits."""
    seed, quick = settings.seed, settings.quick
    runs = QUICK_RUNS if quick else RUNS
    common = {"seed": seed, "runs": runs}
    found = [
        Part(tables.table_name(iron), table_part, {**common, "hard_iron_deg": iron}, 7.0)
        for iron in tables.IRONS
    ]
    groups = [[1, 2, 5, 10, 20]] if quick else [list(range(i, i + 2)) for i in range(1, 20, 2)]
    for kind, few, many, weight in (
        ("jump", QUICK_JUMP, JUMP_THRESHOLDS, 0.2),
        ("slow", QUICK_SLOW, SLOW_THRESHOLDS, 0.1),
    ):
        thresholds = [round(float(value), 4) for value in (few if quick else many)]
        for windows in groups:
            own = {"kind": kind, "windows": windows, "thresholds": thresholds}
            name = f"{kind} sweep, windows {windows[0]} to {windows[-1]}"
            cost = weight * len(windows) * len(thresholds)
            found.append(Part(name, sweep_part, {**common, **own}, cost))
    found.append(Part("ramps", ramp_part, {**common, "ramp_rates": RAMPS}, 2.0))
    found.append(Part("assumptions", assumption_part, common, 1.0))
    found.append(Part("traces", trace_part, {"seed": seed}, 0.5))
    return found


def rows(data: dict[str, dict[str, Any]], settings: Settings) -> list[Row]:
    """Figures of the paper beside ours. Returns tables 3 to 7, figures 9 to 12, rates, shares of
    runs, limits."""
    made = [
        *tables.accuracy_rows(data),
        *tables.deterioration_rows(data),
        *tables.latency_rows(data),
        *tables.sweep_rows(data),
        *tables.rate_rows(data),
        *tables.share_rows(data),
        *tables.limit_rows(data),
    ]
    runs = QUICK_RUNS if settings.quick else RUNS
    return fill_origins(made, runs=runs, seed=settings.seed)


def figures(data: dict[str, dict[str, Any]], folder: Path) -> list[Path]:
    """Redraw figures 9 to 18 from our runs."""
    return pictures.draw(data, folder)
