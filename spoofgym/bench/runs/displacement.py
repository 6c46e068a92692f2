"""The number that a run is scored by, and which runs count."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...envs import _kernels

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]


def undetected_displacement(
    error: ArrayLike, first_alarm: ArrayLike, time_to_alert: int
) -> FloatArray:
    r"""Largest error with no alarm up to the time to alert after it.

    .. math:: D_u = \max_{0 \le k < a - h} e_k, \qquad e_0 = 0

    with the first alarm at epoch a and h epochs to alert: what was induced within h epochs before
    the alarm, or at it, does not count.

    `error` (K, R) at the epochs 1 to K after the onset [m]; what comes after the alarm may be NaN;
    `first_alarm` (R,) epoch of the first alarm after the onset, from 1 on; 0 where there is none up
    to epoch K + h; returns (R,) [m].
    """
    e = np.asarray(error, dtype=np.float64)
    largest = np.maximum.accumulate(np.concatenate([np.zeros((1, e.shape[1])), e]))
    return np.asarray(
        _kernels.undetected_displacement(largest, np.asarray(first_alarm), time_to_alert)
    )


def counted(warmup_alarm: ArrayLike, twin_alarm: ArrayLike) -> Mask:
    """Which runs count: silent before the onset, with a silent twin. (R,) bool each. `twin_alarm`:
    whether the clean twin alarms in the judged window, or the epoch at which it does."""
    return ~(np.asarray(warmup_alarm, dtype=np.bool_) | np.asarray(twin_alarm, dtype=np.bool_))


def exceeded(displacement: ArrayLike, share: float) -> float:
    """Largest displacement that is reached in at least such a share of the runs; NaN without runs.
    `displacement` (R,) [m]; `share` in (0, 1]."""
    x = np.sort(np.asarray(displacement, dtype=np.float64))[::-1]
    if not len(x):
        return math.nan
    return float(x[max(math.ceil(share * len(x) - 1e-9), 1) - 1])
