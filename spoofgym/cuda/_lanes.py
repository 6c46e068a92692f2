"""What `core.simd` is to a thread of a device, which has one receiver: a thread is a lane."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import config, cuda

from ..core import simd
from ..truth import noise
from ..truth.noise import write_deviates

SIMULATED = bool(config.ENABLE_CUDASIM)
"""Whether numba's simulator stands for a device: Python for every thread, one after the other."""


def load(array: Any, row: int) -> Any:
    return array[row]


def store(array: Any, row: int, value: Any) -> None:
    array[row] = value


def lane(array: Any, row: int, index: int) -> Any:
    return array[row]


def set_lane(array: Any, row: int, index: int, value: Any) -> None:
    array[row] = value


def count_lanes(array: Any) -> int:
    return 1


def splat(value: Any, like: Any) -> Any:
    return value


def select(mask: Any, x: Any, y: Any) -> Any:
    return x if mask else y


def any_lane(mask: Any) -> Any:
    return mask


def rotate_left(x: Any, turn: int) -> Any:
    return (x << np.uint64(turn)) | (x >> np.uint64(64 - turn))


def to_float(x: Any) -> Any:
    return np.float64(x)


def sqrt(x: Any) -> Any:
    return math.sqrt(x)


def floor(x: Any) -> Any:
    return cuda.libdevice.floor(x)


def absolute(x: Any) -> Any:
    return math.fabs(x)


def view_bits(x: Any) -> Any:
    return np.uint64(cuda.libdevice.double_as_longlong(x))


def from_bits(x: Any) -> Any:
    return cuda.libdevice.longlong_as_double(np.int64(x))


def deviates(k0: Any, k1: Any, epoch: Any, size: int, count: int, out: Any) -> None:
    """`noise.deviates` by one counter after the other."""
    n = size // 4
    for q in range(min(n, count)):
        write_deviates(np.uint64(q), epoch, k0, k1, q, n, count > 2 * n, out)


_SAME = (load, store, lane, set_lane, count_lanes, splat, select, any_lane, rotate_left, to_float)
# The simulator has no functions of the device; those of NumPy have the same bits.
_OF_DEVICE = () if SIMULATED else (sqrt, floor, absolute, view_bits, from_bits)
REPLACED: dict[Any, Any] = {getattr(simd, each.__name__): each for each in (*_SAME, *_OF_DEVICE)}
"""Functions of one thread by those of the library that they replace, as plain Python."""
REPLACED[getattr(noise.deviates, "py_func", noise.deviates)] = deviates
