"""Kernels of an augmented filter: what its further states are in the measurements and in motion."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..core.compile import njit
from .states import ACCEL_BIAS, CLOCK_BIAS, GYRO_BIAS, STATES

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
MATRICES = 27  # elements of M_f, M_w and G
CONSTANT, CORRELATED, IONOSPHERE, TROPOSPHERE, ORBIT_CLOCK, SMOOTHED, CARRIER = range(7)
KINDS = "constant", "correlated", "ionosphere", "troposphere", "orbit_clock", "smoothed", "carrier"
ENTRIES = 8  # at least the most states of the signals that a measurement depends on


@njit
def append_entry(place: int, value: float, size: int, at: IntArray, of: FloatArray) -> int:
    """Append the place and the value of what is not 0; returns how many there are with those
    before."""
    if value == 0.0:
        return size
    at[size], of[size] = place, value
    return size + 1


@njit
def append_signals(
    mapping: FloatArray,
    first: IntArray,
    smoothed: FloatArray,
    rate: float,
    row: int,
    behind: int,
    size: int,
    at: IntArray,
    of: FloatArray,
) -> int:
    """Append a row of the design matrix for the states of the signals, ascending in place.

    `mapping` (n, 6) as `compute_mappings` has it; `first` (7,) state of every kind, -1 for
    no state, and `behind` how many states come before; `smoothed` (4,) amplitudes of multipath and
    noise; `rate` 1 / interval; `row` of the code of a satellite, or behind all codes of its range
    rate. Places and values of what is not 0 are appended to `at`, `of`; returns how many there are
    with those before."""
    n = len(mapping)
    s, code = row % n, row < n
    see = mapping[s]
    for kind in (CONSTANT, CORRELATED):
        if code and first[kind] >= 0:
            size = append_entry(behind + first[kind] + s, 1.0, size, at, of)
    for kind, sign in ((IONOSPHERE, -1.0), (TROPOSPHERE, 1.0)):
        if first[kind] >= 0:
            j, column = behind + first[kind], 2 * (kind - IONOSPHERE)
            slant = see[column]
            if code:
                size = append_entry(j, slant, size, at, of)
            else:
                size = append_entry(j, sign * see[column + 1], size, at, of)
                size = append_entry(j + 1, sign * slant, size, at, of)
    if first[ORBIT_CLOCK] >= 0:
        place = behind + first[ORBIT_CLOCK] + (s if code else n + s)
        size = append_entry(place, 1.0, size, at, of)
    if code and first[SMOOTHED] >= 0:
        sd = math.hypot(smoothed[0] + smoothed[1] * see[4], smoothed[2] + smoothed[3] * see[5])
        size = append_entry(behind + first[SMOOTHED] + s, sd, size, at, of)
    if not code and first[CARRIER] >= 0:
        place = behind + first[CARRIER] + s
        size = append_entry(place, rate, size, at, of)
        size = append_entry(place + n, -rate, size, at, of)
    return size


@njit
def write_signal_rows(
    mapping: FloatArray,
    visible: NDArray[np.bool_],
    first: IntArray,
    smoothed: FloatArray,
    rate: float,
    H: FloatArray,
) -> None:
    """Write rows of visible satellites into `H` (B, 2n, q), 0 before; `mapping` (B, n, 6), others
    as of `append_signals`."""
    at, of = np.empty(ENTRIES, dtype=np.int64), np.empty(ENTRIES)
    n = visible.shape[1]
    for b in range(len(H)):
        for row in range(2 * n):
            if visible[b, row % n]:
                size = append_signals(mapping[b], first, smoothed, rate, row, 0, 0, at, of)
                for e in range(size):
                    H[b, row, at[e]] = of[e]


@njit
def couple_errors(
    transition: FloatArray, imu_delta: FloatArray, tau: FloatArray, top: FloatArray
) -> None:
    """Write rows of the transition of the 17 states, with columns of all inertial ones.

    `transition` (B, 17, 17); `imu_delta` (B, 6) velocity and angle increments over intervals `tau`
    (B,); `top` (B, 17, c), 0 before: the errors of scale, cross coupling and g-dependence move
    attitude and velocity as biases of the size of the motion would, and biases that wander, where
    there are states of them, as the constant ones do."""
    inertial = top.shape[2]
    for b in range(len(tau)):
        for i in range(STATES):
            for k in range(STATES):
                top[b, i, k] = transition[b, i, k]
        for i in range(3):
            for j in range(3):
                turned = transition[b, i, GYRO_BIAS + j]
                for k in range(3):
                    place = STATES + 3 * j + k
                    by_force = turned * (imu_delta[b, k] / tau[b])
                    top[b, 3 + i, place] = top[b, i, place + 18] = by_force
                    top[b, i, place + 9] = turned * (imu_delta[b, 3 + k] / tau[b])
        for i in range(ACCEL_BIAS if inertial > STATES + MATRICES else 0):
            for k in range(CLOCK_BIAS - ACCEL_BIAS):
                top[b, i, STATES + MATRICES + k] = transition[b, i, ACCEL_BIAS + k]
