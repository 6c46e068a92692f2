"""Limits of exclusion, so that robust weights can't lock satellites out for good.

Weights that follow from innovations have a trap.  A filter that leaves a satellite out drifts away
from it, by constant errors alone, so that the innovation grows and the satellite stays out, though
nothing was ever alarmed; and when all satellites are out, nothing but the inertial sensors is left
to show that.  Two rules open the trap:

1. A satellite that has had weight 0 without an alarm for longer than the *maximum exclusion time*
   gets weight 1, until it is trusted again by itself or alarms.  While it alarms it stays out: that
   is what the alarm means.
2. When fewer satellites than the *minimum satellite count* have a weight above 0, the ones with
   the smallest ratio of statistic to threshold get weight 1, alarmed or not, until there are as
   many, or no more are in view.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .._jit import njit

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
NEVER = np.iinfo(np.int64).max
"""Longest exclusion in epochs, where there is no limit."""


def check_limits(max_exclusion_s: float | None, min_satellites: int) -> None:
    """Raise unless the limits are in range."""
    if max_exclusion_s is not None and not (math.isfinite(max_exclusion_s) and max_exclusion_s > 0):
        raise ValueError(
            f"`max_exclusion_s` must be finite and > 0, or None, got {max_exclusion_s}"
        )
    if isinstance(min_satellites, bool) or int(min_satellites) != min_satellites:
        raise ValueError(f"`min_satellites` must be a whole number, got {min_satellites!r}")
    if min_satellites < 0:
        raise ValueError(f"`min_satellites` must be at least 0, got {min_satellites}")


def longest_exclusion(max_exclusion_s: float | None, epoch_interval_s: float) -> int:
    if max_exclusion_s is None:
        return int(NEVER)
    return max(1, round(max_exclusion_s / epoch_interval_s))


@njit
def readmit_nearest(
    statistic: FloatArray,
    threshold: FloatArray,
    visible: BoolArray,
    missing: int,
    weights: FloatArray,
) -> None:
    """Give weight 1 to the excluded satellites with the smallest ratio of statistic to threshold.
    `statistic`, `threshold`, `visible` (n,) of one receiver; `missing`: how many to readmit, if
    there are as many; `weights` (2n,), overwritten."""
    for _ in range(missing):
        best, least = -1, np.inf
        for j in range(visible.shape[0]):
            if visible[j] and weights[j] == 0.0 and statistic[j] / threshold[j] < least:
                best, least = j, statistic[j] / threshold[j]
        if best < 0:
            return
        weights[best] = 1.0


@njit
def limit_exclusions(
    statistic: FloatArray,
    threshold: FloatArray,
    visible: BoolArray,
    longest: int,
    fewest: int,
    excluded: NDArray[np.int64],
    weights: FloatArray,
) -> None:
    """Readmit satellites whose pseudoranges have been left out for too long, or are too few.
    `statistic`, `threshold` (B, n) of the epoch; `visible` (B, n) bool; `longest`: maximum
    exclusion time [epochs]; `excluded` (B, n) memory: epochs that each satellite has had weight 0
    without an alarm; overwritten; `weights` (B, 2n), pseudoranges first, overwritten."""
    n = visible.shape[1]
    for b in range(visible.shape[0]):
        used = 0
        for j in range(n):
            alarmed = statistic[b, j] > threshold[b, j]
            if not visible[b, j] or alarmed or weights[b, j] > 0.0:
                excluded[b, j] = 0
            else:
                excluded[b, j] += 1
                if excluded[b, j] > longest:
                    weights[b, j] = 1.0
            if visible[b, j] and weights[b, j] > 0.0:
                used += 1
        readmit_nearest(statistic[b], threshold[b], visible[b], fewest - used, weights[b])
