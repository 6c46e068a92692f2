"""What the paper prints, what a second program found, and the bands that follow from it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..frame import Band, Origin
from .origins import CHART, ONE_EPOCH, SATELLITES, SHEWHART
from .runs import EPOCH_S, FIRST_S, TABLED

LABELS = dict(zip(TABLED, ("15 m", "25 m", "35 m", "0.2 m/s", "0.5 m/s", "0.7 m/s"), strict=True))
ONSET_S, END_S = 200.0, 350.0
NOISES = (2.5, 5.0, 10.0)

PRINTED_ONSET = {
    "M1": (0.01, 0.01, 0.01, 98.51, 32.51, 26.01),
    "M2": (1.01, 0.51, 0.01, 21.01, 10.01, 8.51),
    "M3": (1.01, 0.51, 0.01, 21.01, 10.01, 8.51),
}
PRINTED_END = {
    "M1": (-92.51, 0.01, 0.01, 0.01, 0.01, 0.01),
    "M2": (8.51, 10.01, 12.01, 11.01, 16.01, 18.01),
    "M3": (0.01, 0.01, 0.01, 0.01, 0.01, 0.01),
}
CHART_ONSET = ((0.76, 0.5), (0.51, 0.3), (0.01, 0.2), (19.0, 6.8), (9.5, 3.1), (7.8, 2.3))
"""Median and standard deviation of the second program, M2 and M3 [s]."""
CHART_END = ((7.51, 2.8), (10.01, 2.8), (12.01, 2.9), (10.5, 3.0), (15.0, 3.0), (16.5, 2.9))
"""The same of M2's termination."""
SHEWHART_ONSET = (0.01, 0.01, 0.01, None, 28.0, 20.5)
"""Median of the second program, M1 [s]."""
SHEWHART_RANGES = {("onset", 3): (71.0, 128.0), ("end", 0): (-141.0, -38.0)}
"""What the second program found over eight satellites, where geometry decides [s]."""

COMPARATOR_ONSET = {
    "snapshot chi-square": (3.5, 0.0, 0.0, 84.5, 35.0, 24.0),
    "sequential, all history": (91.5, 22.5, 10.0, 119.5, 60.0, 46.5),
    "sequential, 15 s": (5.0, 1.5, 0.5, 56.0, 25.5, 20.0),
    "AIME, 5 s": (1.5, 1.0, 0.5, 30.5, 13.5, 10.0),
    "AIME, 25 s": (4.0, 2.0, 1.5, 25.0, 15.5, 13.0),
    "AIME, 75 s": (6.5, 3.5, 2.5, 33.5, 20.5, 17.0),
    "CUSUM 0.5, 12.4": (1.0, 0.5, 0.5, 22.5, 12.0, 9.5),
}
"""Medians of the second program's comparators, of 15 runs [s]."""

DEPENDS = "the paper's depends on a satellite that it does not name"
PROMPT = Band(FIRST_S, FIRST_S + EPOCH_S, ONE_EPOCH)
"""At once, as far as epochs can say."""


def around(middle: float, spread: float, origin: Origin) -> Band:
    """Band of a spread around a median; a delay is a whole number of epochs, and not negative. All
    in [s]."""
    allowed = max(spread, EPOCH_S)
    return Band(round(max(middle - allowed, FIRST_S), 2), round(middle + allowed, 2), origin)


def compute_spread(values: Any) -> float:
    """Standard deviation of the delays that are finite. `values`: (R,) [s]."""
    finite = values[np.isfinite(values)]
    return float(finite.std()) if finite.size else 0.0


def onset_band(method: str, number: int, values: Any) -> tuple[Band, str]:
    """Band of an onset's median delay.  `values`: (R,) our delays.  Returns `band` [s]."""
    if method != "M1":
        return around(*CHART_ONSET[number], CHART), ""
    if ("onset", number) in SHEWHART_RANGES:
        return Band(*SHEWHART_RANGES["onset", number], SATELLITES), ""
    middle = SHEWHART_ONSET[number]
    assert middle is not None
    return around(middle, compute_spread(values), SHEWHART), DEPENDS if number >= 4 else ""


def end_band(method: str, number: int) -> tuple[Band, str]:
    """Band of a termination's median delay. Returns `band` [s]."""
    if method == "M2":
        return around(*CHART_END[number], CHART), ""
    if method == "M1" and ("end", number) in SHEWHART_RANGES:
        return Band(*SHEWHART_RANGES["end", number], SATELLITES), "last alarm within the attack"
    if method == "M1":
        return PROMPT, "upper limit alone: after the end it alarms on the other side, see below"
    return PROMPT, ""
