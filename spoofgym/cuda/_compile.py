"""The library's own functions, compiled again for one thread of a device: no formula is repeated.

A thread has one receiver, so that what `core.simd` has for lanes is replaced by plain numbers.
Multiplications and additions are not contracted, so that IEEE arithmetic in double precision gives
the bits of the processor: every compilation by NVVM has that option.
"""

from __future__ import annotations

import math
import types
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numba import cuda

from ..core import simd
from ..core.devices import SIMULATED
from ..truth import noise
from ..truth.noise import write_deviates


def _store(array: Any, row: int, value: Any) -> None:
    array[row] = value


def _set_lane(array: Any, row: int, index: int, value: Any) -> None:
    array[row] = value


def _deviates(k0: Any, k1: Any, epoch: Any, size: int, count: int, out: Any) -> None:
    """`noise.deviates` by one counter after the other."""
    n = size // 4
    for q in range(min(n, count)):
        write_deviates(np.uint64(q), epoch, k0, k1, q, n, count > 2 * n, out)


REPLACED: dict[Any, Any] = {
    simd.load: lambda array, row: array[row],
    simd.store: _store,
    simd.lane: lambda array, row, index: array[row],
    simd.set_lane: _set_lane,
    simd.count_lanes: lambda array: 1,
    simd.splat: lambda value, like: value,
    simd.select: lambda mask, x, y: x if mask else y,
    simd.any_lane: lambda mask: mask,
    simd.rotate_left: lambda x, turn: (x << np.uint64(turn)) | (x >> np.uint64(64 - turn)),
    simd.to_float: lambda x: np.float64(x),
    getattr(noise.deviates, "py_func", noise.deviates): _deviates,
}
"""Functions of one thread by those of the library that they replace, as plain Python."""
if not SIMULATED:  # which has no functions of the device; those of NumPy have the same bits
    REPLACED |= {
        simd.sqrt: lambda x: math.sqrt(x),
        simd.floor: lambda x: cuda.libdevice.floor(x),
        simd.absolute: lambda x: math.fabs(x),
        simd.view_bits: lambda x: np.uint64(cuda.libdevice.double_as_longlong(x)),
        simd.from_bits: lambda x: cuda.libdevice.longlong_as_double(np.int64(x)),
    }
_compiled: dict[Any, Any] = {}


def on_device(function: Any) -> Any:
    """The same function for one thread; what it calls is replaced likewise."""
    source = getattr(function, "py_func", function)
    if source not in _compiled:
        copy = _make_bare(REPLACED.get(source, source))
        inline = bool(getattr(function, "targetoptions", {}).get("forceinline"))
        of_thread = copy if SIMULATED else cuda.jit(copy, device=True, forceinline=inline)
        _compiled[source] = of_thread  # before it is filled, since functions may call each other
        _fill(copy, REPLACED.get(source, source))
    return _compiled[source]


@cache
def compile_kernel(function: Callable[..., None]) -> Any:
    """A kernel that calls the library's functions as they are for a thread."""
    if not SIMULATED:
        forbid_contraction()
    copy = _make_bare(function)
    _fill(copy, function)
    return cuda.jit(copy)


def _make_bare(source: Any) -> Any:
    """A function without globals."""
    own = {"__name__": source.__module__, "__builtins__": source.__globals__["__builtins__"]}
    return types.FunctionType(source.__code__, own, source.__name__, source.__defaults__)


def _fill(copy: Any, source: Any) -> None:
    """Give a bare function the globals of its source, as they are for a thread."""
    used, known = source.__code__.co_names, source.__globals__
    replaced = {name: _replace(known[name], used) for name in used if name in known}
    copy.__globals__.update(replaced)


def _replace(value: Any, used: tuple[str, ...]) -> Any:
    if isinstance(value, types.ModuleType) and value.__name__.startswith("spoofgym."):
        parts = {name: getattr(value, name) for name in used if hasattr(value, name)}
        some = types.ModuleType(value.__name__)
        vars(some).update({name: _replace(part, ()) for name, part in parts.items()})
        return some
    plain = isinstance(value, types.FunctionType) and value.__module__.startswith("spoofgym.")
    return on_device(value) if plain or hasattr(value, "py_func") else value


@cache
def forbid_contraction() -> None:
    """Let NVVM fuse no multiplication and addition from now on, but where fast math is chosen."""
    from numba.cuda.cudadrv import nvvm

    compile_ir = nvvm.compile_ir

    def compile_exactly(llvmir: Any, **options: Any) -> Any:
        exact = {} if options.get("fastmath") else {"fma": False}
        return compile_ir(llvmir, **exact | options)

    nvvm.compile_ir = compile_exactly
