"""Delays of onset and end, as the paper counts them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .runs import EPOCH_S, FIRST_S

FloatArray = NDArray[np.float64]


def onset_delay(alarm: NDArray[np.bool_], first: int = 0, last: int = 300) -> FloatArray:
    """Delay of the first alarm within an attack, as the paper counts it.  `alarm`: (K, R) bool.
    Returns (R,) [s]; infinite where there is none."""
    inside = alarm[first:last]
    return np.where(inside.any(axis=0), inside.argmax(axis=0) * EPOCH_S + FIRST_S, np.inf)


def end_delay(
    alarm: NDArray[np.bool_], first: int = 0, last: int = 300, until: int | None = None
) -> FloatArray:
    """Delay of the first epoch without an alarm after an attack, as the paper counts it. `alarm`:
    (K, R) bool; `until`: epoch of the next attack; the end of the record by default. Returns (R,)
    [s]; negative where the last alarm of the attack was over before its end, and infinite where
    there was none, or no end of it."""
    inside, after = alarm[first:last], alarm[last:until]
    late = np.where(after.all(axis=0), np.inf, (~after).argmax(axis=0) * EPOCH_S)
    early = np.where(inside.any(axis=0), -inside[::-1].argmax(axis=0) * EPOCH_S, np.inf)
    return np.asarray(np.where(inside[-1], late, early) + FIRST_S)
