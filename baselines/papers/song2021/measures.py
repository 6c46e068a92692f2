"""The paper's figures of merit, and what they should have been."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

QUANTITIES = ("sigma east", "sigma north", "sigma", "max east", "max north", "max")
"""Columns of the paper's tables 3 to 5, all in metres."""
HONEST = ("rms", "95 %")
"""What a constant offset shows in, as it does not in a standard deviation."""


def accuracy(error: FloatArray) -> dict[str, FloatArray]:
    """Accuracy of every run, as the paper's tables have it.  Its sigma is the standard deviation of
    the horizontal error's length, not a root mean square: 20 m on each axis in half of the run give
    its 13.47 m. `error`: (K, B, 2) north, east [m].  Returns (B,) by `QUANTITIES` and `HONEST`
    [m]."""
    north, east = error[:, :, 0], error[:, :, 1]
    size = np.hypot(north, east)
    return {
        "sigma east": east.std(axis=0),
        "sigma north": north.std(axis=0),
        "sigma": size.std(axis=0),
        "max east": np.abs(east).max(axis=0),
        "max north": np.abs(north).max(axis=0),
        "max": size.max(axis=0),
        "rms": np.sqrt((size**2).mean(axis=0)),
        "95 %": np.quantile(size, 0.95, axis=0),
    }


def credibility(gamma: FloatArray, gamma_gnss: FloatArray) -> FloatArray:
    """Eq. 35.  `gamma`, `gamma_gnss`: deterioration of the algorithm and of GNSS.  Returns zeta
    [%]."""
    return 100.0 * (gamma_gnss - gamma) / gamma_gnss


def latency(alarm: BoolArray, window: NDArray[np.intp]) -> FloatArray:
    """Fixes from the first attacked one to the first alarm, both counted.  `alarm`: (K, B).
    Returns (B,) 1 for an alarm at once; NaN where there is none."""
    inside = alarm[window]
    return np.where(inside.any(axis=0), inside.argmax(axis=0) + 1.0, np.nan)


def recovery(alarm: BoolArray, window: NDArray[np.intp]) -> FloatArray:
    """Fixes after an attack until the first one that is believed again.  `alarm`: (K, B).  Returns
    (B,) 1 for the first one; NaN where there is none until the end of the run, or where no fix is
    left."""
    after = ~alarm[window[-1] + 1 :]
    if not len(after):
        return np.full(alarm.shape[1], np.nan)
    return np.where(after.any(axis=0), after.argmax(axis=0) + 1.0, np.nan)


def rates(alarm: BoolArray, attacked: BoolArray) -> dict[str, float]:
    """Rates over all runs, by their proper names.  The paper calls what is normal positive: its
    P_FA, eq. 13, is the share of attacked fixes that were not alarmed, its P_MD, eq. 14, the share
    of clean ones that were.  The sum is the same. `alarm`: (K, B); `attacked`: (K,).  Returns
    ``P_FA`` alarms on clean fixes, ``P_MD`` attacked fixes without an alarm, ``P_D`` fixes that
    were told right, eq. 12; the first two are 0 where there are no such fixes."""
    clean, hit = alarm[~attacked], alarm[attacked]
    return {
        "P_FA": float(clean.mean()) if clean.size else 0.0,
        "P_MD": float(1.0 - hit.mean()) if hit.size else 0.0,
        "P_D": float((alarm == attacked[:, None]).mean()),
    }


def retroactive(alarm: BoolArray, window: int) -> BoolArray:
    """Alarms that are also told of the fixes that led to them.  `alarm`: (K, B); `window`: fixes
    that an alarm speaks of, its own among them.  Returns (K, B)."""
    told = alarm.copy()
    for back in range(1, window):
        told[:-back] |= alarm[back:]
    return told
