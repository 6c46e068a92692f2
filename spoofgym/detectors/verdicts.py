"""The one check of a verdict, where it enters a simulation.

The filter multiplies its gain with the weights in compiled code that looks at no bounds, so that
nothing but what `Verdict` promises may come as far as that.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._jit import njit
from ..receiver.epoch import Epoch, TracedEpoch
from .base import Detector, Verdict

FloatArray = NDArray[np.float64]
FLOAT, BOOL = np.dtype(np.float64), np.dtype(np.bool_)


def judged(detector: Detector, epoch: Epoch, rows: NDArray[np.intp] | None = None) -> Verdict:
    """Let a bound detector judge an epoch, and check its verdict as `checked` does. `rows`:
    `Detector.judged_rows`. A new victim asks its detector through this function alone. Where the
    detector fails, and reads a field that is None since it isn't declared, an
    `UndeclaredFieldError` says so."""
    detector.judged_rows = rows
    try:
        return checked(detector.judge(epoch), detector, epoch)
    except UndeclaredFieldError:  # of a detector in a pool
        raise
    except Exception as error:
        traced = TracedEpoch(*epoch)
        with suppress(Exception):
            detector.judge(traced)
        message = undeclared(detector, traced)
        if message:
            raise UndeclaredFieldError(message) from error
        raise
    finally:
        detector.judged_rows = None


class UndeclaredFieldError(TypeError):
    """A detector reads an optional field of an epoch that its `needs` doesn't name."""


def undeclared(detector: Detector, epoch: TracedEpoch) -> str:
    """Say which fields were read that are None, since they are not declared; "" for none."""
    absent = {name for name, array in epoch._asdict().items() if array is None}
    read = sorted(epoch.read & absent)
    if not read:
        return ""
    names = ", ".join(f"`epoch.{name}`" for name in read)
    needs = ", ".join(repr(name) for name in sorted(detector.needs.union(read)))
    return (
        f"{type(detector).__name__} reads {names}, None here, without declaring it; write `needs = "
        f"frozenset({{{needs}}})` into the class"
    )


def checked(verdict: Verdict, detector: Detector, epoch: Epoch) -> Verdict:
    """Check the verdict of a bound detector. A `TypeError` (no `Verdict`, a part that is no array
    of the right type) or `ValueError` (a wrong shape, a value not finite, a weight not within 0 and
    1) names the detector, the time of the epoch, the receiver, what came and what is valid."""
    # one compiled pass over what has the usual form; words are only looked for where it fails
    if type(verdict) is Verdict:
        statistic, threshold, alarm, weights = verdict
        b, m = epoch.innovation.shape
        shape = (b, (epoch.visible.shape[1] or m) if detector.scope == "channel" else 1)
        if (
            type(statistic) is type(threshold) is np.ndarray
            and type(alarm) is np.ndarray
            and statistic.shape == threshold.shape == alarm.shape == shape
            and statistic.dtype == threshold.dtype == FLOAT
            and alarm.dtype == BOOL
            and statistic.flags.carray
            and threshold.flags.carray
            and (
                weights is None
                or (
                    type(weights) is np.ndarray
                    and weights.shape == (b, m)
                    and weights.dtype == FLOAT
                    and weights.flags.carray
                )
            )
            and is_sound(statistic, threshold, weights)
        ):
            return verdict
    _examine(verdict, detector, epoch)
    return verdict


def checked_weights(weights: FloatArray, epoch: Epoch) -> FloatArray:
    """Check weights that come without a verdict; errors are those of `checked`."""
    _examine_part("an update", epoch, "weights", weights, epoch.innovation.shape, "")
    return weights


@njit
def is_sound(statistic: FloatArray, threshold: FloatArray, weights: FloatArray | None) -> bool:
    """Whether statistics and thresholds are finite, and weights, if any, within 0 and 1."""
    rows, columns = statistic.shape
    sound = True
    for b in range(rows):
        for c in range(columns):
            sound &= np.isfinite(statistic[b, c]) and np.isfinite(threshold[b, c])
    if weights is not None:
        for b in range(rows):
            for c in range(weights.shape[1]):
                sound &= 0.0 <= weights[b, c] <= 1.0
    return sound


def _examine(verdict: Verdict, detector: Detector, epoch: Epoch) -> None:
    """Raise unless a verdict is sound."""
    kind = type(detector).__name__
    if not isinstance(verdict, Verdict):
        raise TypeError(
            f"{_at(kind, epoch, 0)} `judge` must return a `Verdict`, got {type(verdict).__name__}; "
            "`from spoofgym.detectors import Verdict`"
        )
    (b, m), n = epoch.innovation.shape, epoch.visible.shape[1]
    columns = (n or m) if detector.scope == "channel" else 1
    measured = f"{n} channels" if n else f"a position of {m} coordinates"
    sizes = f" for {b} receivers with {measured} and scope {detector.scope!r}"
    for name, part in verdict._asdict().items():
        if part is not None or name != "weights":
            shape = (b, m if name == "weights" else columns)
            _examine_part(kind, epoch, name, part, shape, sizes)


def _examine_part(
    kind: str, epoch: Epoch, name: str, part: Any, shape: tuple[int, ...], sizes: str
) -> None:
    """Raise unless one array of a verdict is sound."""
    where = f"{_at(kind, epoch, 0)} `{name}`"
    if type(part) is not np.ndarray:
        raise TypeError(f"{where} must be an array, got {type(part).__name__}")
    if part.shape != shape:
        raise ValueError(f"{where} must have shape {shape}{sizes}, got {part.shape}")
    dtype = BOOL if name == "alarm" else FLOAT
    if part.dtype != dtype:
        raise TypeError(
            f"{where} must be of type {dtype}, got {part.dtype}; a comparison gives bool, "
            "`np.empty(shape)` float64"
        )
    if name == "weights":
        valid, bad = "lie within 0 and 1", ~((part >= 0.0) & (part <= 1.0))
    else:
        valid, bad = "be finite", ~np.isfinite(part)
    for row, column in np.argwhere(bad)[:1].tolist():
        raise ValueError(
            f"{_at(kind, epoch, row)} `{name}` must {valid}, got {part[row, column]} for "
            f"receiver {row} of {len(part)}, column {column}"
        )
    if name == "weights" and not part.flags.carray:
        raise ValueError(
            f"{where} must be a C-contiguous array that may be written to, since the kernels are "
            "compiled for such; `np.array(weights)` makes one"
        )


def _at(kind: str, epoch: Epoch, row: int) -> str:
    return f"{kind}, epoch at {epoch.time[row]:g} s:"
