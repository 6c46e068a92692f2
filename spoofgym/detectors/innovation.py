r"""Shared parts of innovation tests: whitening, thresholds, exclusion limits.

What tests of innovations have in common.

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

Limits of exclusion, so that robust weights can't lock satellites out for good.

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
from collections.abc import Sequence
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import special

from ..core.compile import inlined, njit
from ..core.memory import Memory
from ..receiver.epoch import Epoch
from .base import Detector, DetectorContext


def check_probability(name: str, value: float) -> None:
    """Raise unless a value is a probability between 0 and 1, both excluded."""
    if not 0.0 < value < 1.0:
        raise ValueError(f"`{name}` must lie between 0 and 1, both excluded, got {value}")


def check_epochs(name: str, value: int, most: int = 100_000) -> None:
    """Raise unless a length in epochs is a whole number in range."""
    if not 1 <= value <= most:
        raise ValueError(f"`{name}` must be 1 to {most} epochs, got {value}")
    if isinstance(value, bool) or int(value) != value:
        raise ValueError(f"`{name}` must be a whole number of epochs, got {value}")


def epochs_to_settle(smoothing: float) -> int:
    """Epochs until what an exponential average began with has fallen to a hundredth."""
    return 1 if smoothing >= 1.0 else math.ceil(math.log(0.01) / math.log(1.0 - smoothing))


def run_length(drift: float, threshold: float) -> float:
    r"""Mean number of epochs until a cumulative sum exceeds its threshold where nothing changes.

    .. math:: L = \frac{e^{2 \kappa b} - 2 \kappa b - 1}{2 \kappa^2}, \qquad b = h + 1.166

    `drift`, `threshold`: kappa, above 0, and h, of standard normal samples.

    Notes
    -----
    `siegmund1985`, by a Brownian motion whose limit is moved by the mean overshoot.
    """
    exponent = 2.0 * drift * (threshold + 1.166)
    return (math.exp(exponent) - exponent - 1.0) / (2.0 * drift * drift)


def two_sided_quantile(false_alarm: float) -> float:
    """Quantile that a standard normal deviate exceeds in size with a given probability.
    `false_alarm`: probability, in (0, 1)."""
    return float(-special.ndtri(0.5 * false_alarm))


def chi2_thresholds(false_alarm: float, most: int) -> FloatArray:
    """Chi-square thresholds by degrees of freedom. `false_alarm`: probability of exceeding it, in
    (0, 1); returns (most + 1,) threshold for 0 to `most` degrees; with 0 there is nothing to exceed
    it, and the entry is that of one degree, so that it stays finite."""
    return np.asarray(special.chdtri(np.maximum(np.arange(most + 1), 1), false_alarm))


def chi2_lower_thresholds(false_alarm: float, degrees: FloatArray) -> FloatArray:
    """Value below which chi-square falls with a given probability, by degrees of freedom.
    `false_alarm`: in (0, 1); `degrees`: any shape; below 1 as 1, so that it stays above 0."""
    return np.asarray(2.0 * special.gammaincinv(0.5 * np.maximum(degrees, 1.0), false_alarm))


def outside_ratio(
    statistic: FloatArray, lower: FloatArray, upper: FloatArray, judged: NDArray[np.bool_]
) -> FloatArray:
    r"""How far a statistic lies outside an interval, as a ratio that exceeds 1 there.

    .. math:: \max\left(\frac{q}{T_u}, \frac{T_l}{q}\right)

    All (B,); returns (B, 1), 0 where nothing is `judged`.
    """
    ratio = np.maximum(statistic / upper, lower / np.maximum(statistic, 1e-300))
    return np.asarray(np.where(judged, ratio, 0.0))[:, None]


@inlined
def igg3_weight(size: float, accept: float, reject: float) -> float:
    r"""IGG-III equivalent weight.

    .. math:: w = \begin{cases} 1 & |x| \le k_0 \\
        \frac{k_0}{|x|} \left(\frac{k_1 - |x|}{k_1 - k_0}\right)^2 & k_0 < |x| \le k_1 \\
        0 & |x| > k_1 \end{cases}

    Returns in [0, 1].

    Notes
    -----
    `yang2002` in references.bib.
    """
    if size <= accept:
        return 1.0
    if size > reject:
        return 0.0
    inside = (reject - size) / (reject - accept)
    return accept / size * inside * inside


@inlined
def ewma_threshold(sd: float, decay: float, smoothing: float, quantile: float) -> float:
    r"""Threshold of an EWMA chart after some epochs.

    .. math:: T = z \sigma \sqrt{\tfrac{\lambda}{2 - \lambda} (1 - (1 - \lambda)^{2k})}

    `sd`: standard deviation of the innovation [m]; returns T [m].

    Notes
    -----
    `roberts1959` in references.bib.
    """
    return quantile * sd * math.sqrt(smoothing / (2.0 - smoothing) * (1.0 - decay))


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
