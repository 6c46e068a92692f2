r"""What tests of innovations have in common.

Rows are chosen by signal, constant parts are taken away, and rows are whitened.  With Cholesky's
factor of the innovation covariance of the rows that take part, :math:`S = L L^T`, the whitened
innovation :math:`y = L^{-1} z` has independent elements of variance 1 where the filter's belief is
right, whatever S was at that epoch, so that sums of it over time have a known distribution.

A satellite bias that stays the same for a run shifts the mean of its innovations, which a test
with a long memory takes for an attack.  `without_bias` measures that mean over the first N epochs
of every channel and subtracts it, :math:`z' = (z - \bar z) / \sqrt{1 + 1/N}`; the root keeps the
variance what it was, since the mean is uncertain, too.  The channel is not judged before.  What is
left of the mean has a standard deviation of :math:`\sigma / \sqrt{N}` and stays, so that the window
has to be several times longer than the memory of the test.  An attack within the window is
calibrated away: the option trusts the first epochs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray

from .._jit import njit
from .._memory import Memory
from ..receiver.epoch import Epoch
from .base import Detector, DetectorContext
from .thresholds import check_probability

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
SIGNALS = ("pseudorange", "range_rate", "both")


def check_signals(signals: str) -> None:
    if signals not in SIGNALS:
        raise ValueError(
            f"`signals` must be one of {', '.join(map(repr, SIGNALS))}, got {signals!r}"
        )


def rows_of(signals: str, channels: int) -> tuple[int, int]:
    first = channels if signals == "range_rate" else 0
    return first, channels if signals == "pseudorange" else 2 * channels


def check_length(name: str, value: float, least: float = 0.0) -> None:
    """Raise unless a length of time is finite and large enough.

    `value`: what was given [s]; `least`: smallest one that is allowed; 0 itself only if `least` is
    0.
    """
    if not (math.isfinite(value) and value >= least):
        raise ValueError(f"`{name}` must be finite and >= {least:g}, got {value}")


def checked_windows(windows_s: Sequence[float]) -> tuple[float, ...]:
    """Lengths of several windows [s]; a ValueError unless they are positive and increase."""
    if isinstance(windows_s, int | float | str):
        raise ValueError(f"`windows_s` must be a list of lengths, got {windows_s!r}")
    windows = tuple(windows_s)
    increasing = all(a < b for a, b in pairwise(windows))
    above = all(math.isfinite(w) and w > 0.0 for w in windows)
    if not (windows and increasing and above):
        raise ValueError(f"`windows_s` must be lengths > 0 in increasing order, got {windows}")
    return windows


def epochs_of(length_s: float, context: DetectorContext) -> int:
    return max(1, round(length_s / context.epoch_interval_s))


def declare_bias(memory: Memory, context: DetectorContext) -> None:
    """Prepare the memory for `without_bias`."""
    b, n = context.receivers, context.channels
    memory.declare("bias_epochs", np.zeros((b, n)))
    memory.declare("bias_sum", np.zeros((b, 2 * n)))


def without_bias(epoch: Epoch, memory: Memory, window: int) -> tuple[FloatArray, BoolArray]:
    """Innovations less their mean over a first window. `memory`: prepared by `declare_bias`, if
    `window` is above 0; returns `innovation` (B, 2n); 0 where a channel is not to be judged;
    `judged` (B, n) bool, channels that are visible and calibrated."""
    if window == 0:
        return epoch.innovation, epoch.visible
    innovation = np.empty(epoch.innovation.shape)
    judged = np.empty(epoch.visible.shape, dtype=np.bool_)
    _remove_mean(
        epoch.innovation,
        epoch.visible,
        window,
        memory["bias_epochs"],
        memory["bias_sum"],
        innovation,
        judged,
    )
    return innovation, judged


@njit
def _remove_mean(
    innovation: FloatArray,
    visible: BoolArray,
    window: int,
    epochs: FloatArray,
    total: FloatArray,
    out: FloatArray,
    judged: BoolArray,
) -> None:
    """Learn the mean of every row, or subtract it; a channel keeps it while it is not visible."""
    n = visible.shape[1]
    scale = 1.0 / math.sqrt(1.0 + 1.0 / window)
    for b in range(visible.shape[0]):
        for j in range(n):
            ready = epochs[b, j] >= window
            judged[b, j] = visible[b, j] and ready
            if visible[b, j] and not ready:
                epochs[b, j] += 1.0
            for r in (j, n + j):
                out[b, r] = 0.0
                if judged[b, j]:
                    out[b, r] = (innovation[b, r] - total[b, r] / window) * scale
                elif visible[b, j]:
                    total[b, r] += innovation[b, r]


@njit
def cholesky_of_rows(
    innovation_cov: FloatArray,
    judged: BoolArray,
    first: int,
    last: int,
    rows: NDArray[np.int64],
    factor: FloatArray,
) -> int:
    """Cholesky's factor of the rows of one receiver that take part, with inverted diagonal.
    `innovation_cov` (2n, 2n) S; `rows` (last - first,) written: rows that take part, in their
    order; `factor` (last - first, last - first), written in its first rows and columns; returns how
    many rows take part; -1 where S is not positive definite."""
    n = judged.shape[0]
    count = 0
    for r in range(first, last):
        if judged[r % n]:
            rows[count] = r
            count += 1
    for i in range(count):
        for j in range(i + 1):
            value = innovation_cov[rows[i], rows[j]]
            for k in range(j):
                value -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = value * factor[j, j]
            elif value > 0.0:
                factor[i, i] = 1.0 / math.sqrt(value)
            else:
                return -1
    return count


@njit
def whiten(
    innovation: FloatArray,
    innovation_cov: FloatArray,
    judged: BoolArray,
    first: int,
    last: int,
    out: FloatArray,
) -> None:
    r"""Whitened innovations of a range of rows.

    .. math:: y = L^{-1} z, \qquad S = L L^T

    `innovation`, `innovation_cov` (B, 2n), (B, 2n, 2n); `judged` (B, n) bool, channels that take
    part; `out` (B, last - first), written; 0 for rows that take no part.  Where S is not positive
    definite they are infinite, so that every test alarms.
    """
    size = last - first
    rows = np.empty(size, dtype=np.int64)
    factor = np.empty((size, size))
    y = np.empty(size)
    for b in range(judged.shape[0]):
        count = cholesky_of_rows(innovation_cov[b], judged[b], first, last, rows, factor)
        for i in range(size):
            out[b, i] = np.inf if count < 0 and judged[b, (first + i) % judged.shape[1]] else 0.0
        for i in range(count):
            value = innovation[b, rows[i]]
            for k in range(i):
                value -= factor[i, k] * y[k]
            y[i] = value * factor[i, i]
            out[b, rows[i] - first] = y[i]


@njit
def remember_squares(
    white: FloatArray,
    judged: BoolArray,
    each: int,
    squares: FloatArray,
    counts: FloatArray,
    place: NDArray[np.int64],
) -> None:
    """Write the sum of squares of an epoch into a ring of the last W epochs. `white` (B, r)
    whitened innovations; `judged` (B, n) bool; `each`: rows of a satellite; `squares`, `counts` (B,
    W) memory, overwritten: sums of squares, and rows in them; `place` (B,) memory, overwritten:
    where the next epoch goes."""
    window = squares.shape[1]
    for b in range(white.shape[0]):
        k = place[b]
        place[b] = (k + 1) % window
        squares[b, k] = counts[b, k] = 0.0
        for r in range(white.shape[1]):
            squares[b, k] += white[b, r] * white[b, r]
        for j in range(judged.shape[1]):
            if judged[b, j]:
                counts[b, k] += each


class InnovationTest(Detector):
    """Base of the tests of innovations less their mean over a first window. A subclass is a
    dataclass with the settings below, and with `false_alarm` where it has one."""

    signals: str
    bias_window_s: float

    def __post_init__(self) -> None:
        if hasattr(self, "false_alarm"):
            check_probability("false_alarm", self.false_alarm)
        check_signals(self.signals)
        check_length("bias_window_s", self.bias_window_s)

    def bind(self, context: DetectorContext) -> None:
        """Choose the rows, and prepare the window of the mean."""
        super().bind(context)
        self._rows = rows_of(self.signals, context.channels)
        self._per_satellite = 2 if self.signals == "both" else 1
        self._bias_window = 0
        if self.bias_window_s > 0.0:
            self._bias_window = epochs_of(self.bias_window_s, context)
            self.silent_epochs = self.memory_epochs = self._bias_window
            declare_bias(self.memory, context)

    def _without_bias(self, epoch: Epoch) -> tuple[FloatArray, BoolArray]:
        """Innovations and the channels to judge; once per epoch."""
        return without_bias(epoch, self.memory, self._bias_window)

    def _whitened(self, epoch: Epoch) -> tuple[FloatArray, BoolArray]:
        """Whitened innovations of the rows (B, last - first) and the channels to judge. The test
        needs ``"innovation_cov"``."""
        innovation, judged = self._without_bias(epoch)
        first, last = self._rows
        white = np.empty((len(judged), last - first))
        whiten(innovation, cast(FloatArray, epoch.innovation_cov), judged, first, last, white)
        return white, judged
