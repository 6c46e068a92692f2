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


def _load(array: Any, row: int) -> Any:
    return array[row]


def _store(array: Any, row: int, value: Any) -> None:
    array[row] = value


def _lane(array: Any, row: int, index: int) -> Any:
    return array[row]


def _set_lane(array: Any, row: int, index: int, value: Any) -> None:
    array[row] = value


def _count_lanes(array: Any) -> int:
    return 1


def _splat(value: Any, like: Any) -> Any:
    return value


def _select(mask: Any, x: Any, y: Any) -> Any:
    return x if mask else y


def _any_lane(mask: Any) -> Any:
    return mask


def _rotate_left(x: Any, turn: int) -> Any:
    return (x << np.uint64(turn)) | (x >> np.uint64(64 - turn))


def _to_float(x: Any) -> Any:
    return np.float64(x)


def _sqrt(x: Any) -> Any:
    return math.sqrt(x)


def _floor(x: Any) -> Any:
    return cuda.libdevice.floor(x)


def _absolute(x: Any) -> Any:
    return math.fabs(x)


def _view_bits(x: Any) -> Any:
    return np.uint64(cuda.libdevice.double_as_longlong(x))


def _from_bits(x: Any) -> Any:
    return cuda.libdevice.longlong_as_double(np.int64(x))


def _deviates(k0: Any, k1: Any, epoch: Any, size: int, count: int, out: Any) -> None:
    """`noise.deviates` by one counter after the other."""
    n = size // 4
    for q in range(min(n, count)):
        write_deviates(np.uint64(q), epoch, k0, k1, q, n, count > 2 * n, out)


_SAME = (
    *(_load, _store, _lane, _set_lane, _count_lanes),
    *(_splat, _select, _any_lane, _rotate_left, _to_float),
)
# The simulator has no functions of the device; those of NumPy have the same bits.
_OF_DEVICE = () if SIMULATED else (_sqrt, _floor, _absolute, _view_bits, _from_bits)
REPLACED: dict[Any, Any] = {
    getattr(simd, each.__name__.removeprefix("_")): each for each in (*_SAME, *_OF_DEVICE)
}
"""Functions of one thread by those of the library that they replace, as plain Python."""
REPLACED[getattr(noise.deviates, "py_func", noise.deviates)] = _deviates
