r"""Shared parts of innovation tests: rows, whitening, thresholds, limits of exclusion.

**Whitening.** With Cholesky's factor of the covariance of the rows that take part,
:math:`S = L L^T`, the whitened innovation :math:`y = L^{-1} z` has independent elements of variance
1 where the filter's belief is right, whatever S was at that epoch, so that sums of it over time
have a known distribution.

**First window.** A constant satellite bias shifts the mean of its innovations, which a test with a
long memory takes for an attack.  With `bias_window_s` that mean is measured over the first N epochs
of every channel and subtracted, :math:`z' = (z - \bar z) / \sqrt{1 + 1/N}`; the root keeps the
variance what it was, since the mean is uncertain, too.  The channel is not judged before.  An error
of the mean of :math:`\sigma / \sqrt{N}` stays, so that the window has to be several times longer
than the memory of the test; an attack within it is calibrated away.

**Limits of exclusion.** Weights that follow from innovations have a trap: a filter drifts away from
a satellite that it leaves out, by constant errors alone, so that the innovation grows and the
satellite stays out without an alarm, until only the inertial sensors are left.  Two rules open it:

1. A satellite that has had weight 0 without an alarm for longer than the *maximum exclusion time*
   gets weight 1, until it is trusted again by itself or alarms.  While it alarms it stays out.
2. When fewer satellites than the *minimum satellite count* have a weight above 0, those with the
   smallest ratio of statistic to threshold get weight 1, alarmed or not, until there are as many,
   or no more are in view.
"""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
from scipy import special

from ..core.compile import inline_njit, njit
from ..core.declared import setting
from ..receiver.epoch import Epoch
from .base import BoolArray, DetectorContext, FloatArray, IntArray, cholesky_of_rows
from .own_filter import FilterTest

SIGNALS = ("pseudorange", "range_rate", "both")
OF_ONE_SATELLITE = "Alpha: probability of an alarm of one satellite in one epoch."


def alarm_probability(
    default: float = 1e-5,
    help: str = "Probability of an alarm in one epoch where the filter's belief is right.",
) -> Any:
    return setting(default=default, above=0.0, below=1.0, help=help)


def signals_to_test(default: str, help: str = "Innovations to test.") -> Any:
    return setting(default=default, one_of=SIGNALS, help=help)


def first_window() -> Any:
    return setting(
        default=0.0,
        least=0.0,
        unit="s",
        help="Length of a window from the start of every channel, whose mean innovation is "
        "subtracted from later ones; the channel is not judged within it; 0 for none.",
    )


def both_sides(help: str = "") -> Any:
    return setting(
        default=False,
        omitted=True,
        help="Whether innovations that are too small alarm, too, each side with half of "
        "`false_alarm`: a counterfeit signal may have less noise than nature.  The statistic is "
        f"then the ratio to the limit that is nearer, and the threshold 1.{help}",
    )


def weight_limit(default: float | None, help: str) -> Any:
    return setting(default=default, above=0.0, most=1.0, help=help)


def longest_exclusion(default: float | None) -> Any:
    return setting(
        default=default,
        above=0.0,
        unit="s",
        help="Longest time that a satellite can have weight 0 without an alarm; None for no limit.",
    )


def fewest_weighed(default: int) -> Any:
    return setting(
        default=default,
        least=0,
        help="Fewest satellites that have a weight above 0, where as many are in view; 0 for none.",
    )


def average_smoothing(help: str = "Lambda.") -> Any:
    return setting(default=0.1, above=0.0, most=1.0, help=help)


def factor_on_alarm() -> Any:
    return setting(
        default=1.0,
        above=0.0,
        kw_only=True,
        omitted=True,
        help="Factor on the threshold of the alarm; weights go by the threshold without it.",
    )


def window_epochs(default: int, help: str, most: int = 100_000) -> Any:
    return setting(default=default, least=1, most=most, unit="epochs", help=help)


def count_epochs(length_s: float, context: DetectorContext) -> int:
    return max(1, round(length_s / context.epoch_interval_s))


def epochs_to_settle(smoothing: float) -> int:
    """Epochs until what an exponential average began with has fallen to a hundredth."""
    return 1 if smoothing >= 1.0 else math.ceil(math.log(0.01) / math.log(1.0 - smoothing))


def select_rows(signals: str, channels: int) -> tuple[int, int]:
    """First row of the innovation that is judged, and the one after the last."""
    first = channels if signals == "range_rate" else 0
    return first, channels if signals == "pseudorange" else 2 * channels


def two_sided_quantile(false_alarm: float) -> float:
    return float(-special.ndtri(0.5 * false_alarm))


def chi2_thresholds(false_alarm: float, most: int) -> FloatArray:
    """(most + 1,) chi-square thresholds for 0 to `most` degrees of freedom; with 0 there is nothing
    to exceed it, and the entry is that of one degree, so that it stays finite."""
    return np.asarray(special.chdtri(np.maximum(np.arange(most + 1), 1), false_alarm))


def chi2_lower_thresholds(false_alarm: float, degrees: FloatArray) -> FloatArray:
    """Value below which chi-square falls with a probability in (0, 1), by degrees of freedom of any
    shape; below 1 as 1, so that it stays above 0."""
    return np.asarray(2.0 * special.gammaincinv(0.5 * np.maximum(degrees, 1.0), false_alarm))


@inline_njit
def igg3_weight(size: float, accept: float, reject: float) -> float:
    r"""IGG-III equivalent weight, `yang2002`.

    .. math:: w = \begin{cases} 1 & |x| \le k_0 \\
        \frac{k_0}{|x|} \left(\frac{k_1 - |x|}{k_1 - k_0}\right)^2 & k_0 < |x| \le k_1 \\
        0 & |x| > k_1 \end{cases}
    """
    if size <= accept:
        return 1.0
    if size > reject:
        return 0.0
    inside = (reject - size) / (reject - accept)
    return accept / size * inside * inside


@inline_njit
def ewma_threshold(sd: float, decay: float, smoothing: float, quantile: float) -> float:
    r"""Threshold [m] of an EWMA chart after k epochs, `roberts1959`.

    .. math:: T = z \sigma \sqrt{\tfrac{\lambda}{2 - \lambda} (1 - (1 - \lambda)^{2k})}
    """
    return quantile * sd * math.sqrt(smoothing / (2.0 - smoothing) * (1.0 - decay))


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
def whiten(
    innovation: FloatArray,
    innovation_cov: FloatArray,
    judged: BoolArray,
    first: int,
    last: int,
    out: FloatArray,
) -> None:
    """Whitened innovations (B, last - first) of a range of rows, written to `out`; 0 for rows that
    take no part. `innovation_cov` (B, 2n, 2n); where it is not positive definite they are infinite,
    so that every test alarms."""
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
    place: IntArray,
) -> None:
    """Write the sum of squares of an epoch into a ring of the last W epochs. `white` (B, r)
    whitened innovations; `each`: rows of a satellite; `squares`, `counts` (B, W) memory: sums of
    squares, and rows in them; `place` (B,) memory: where the next epoch goes."""
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


class InnovationTest(FilterTest):
    """Base of the tests of innovations, less their mean over a first window if there is one. A
    subclass is a dataclass with the settings below, and with `false_alarm` where it has one."""

    signals: str
    bias_window_s: float = 0.0

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        b, n = context.receivers, context.channels
        self._rows = select_rows(self.signals, n)
        self._per_satellite = 2 if self.signals == "both" else 1
        self._bias_window = 0
        if self.bias_window_s > 0.0:
            self._bias_window = count_epochs(self.bias_window_s, context)
            self.silent_epochs = self.memory_epochs = self._bias_window
            self.memory.declare_all(bias_epochs=np.zeros((b, n)), bias_sum=np.zeros((b, 2 * n)))

    def _without_bias(self, epoch: Epoch) -> tuple[FloatArray, BoolArray]:
        """Innovations (B, 2n), and the channels (B, n) to judge; once per epoch."""
        if self._bias_window == 0:
            return epoch.innovation, epoch.visible
        innovation = np.empty(epoch.innovation.shape)
        judged = np.empty(epoch.visible.shape, dtype=np.bool_)
        sums = self.memory["bias_epochs"], self.memory["bias_sum"]
        _remove_mean(epoch.innovation, epoch.visible, self._bias_window, *sums, innovation, judged)
        return innovation, judged

    def _whiten_rows(self, epoch: Epoch) -> tuple[FloatArray, BoolArray]:
        """Whitened innovations of the rows (B, last - first) and the channels to judge. The test
        needs ``"innovation_cov"``."""
        epoch = self.filter_epoch(epoch)
        innovation, judged = self._without_bias(epoch)
        first, last = self._rows
        white = np.empty((len(judged), last - first))
        whiten(innovation, cast(FloatArray, epoch.innovation_cov), judged, first, last, white)
        return white, judged

    def _declare_squares(self, receivers: int, window: int) -> None:
        """Declare the memory of `remember_squares`, which is `_squares`."""
        self.memory.declare_all(
            squares=np.zeros((receivers, window)),
            counts=np.zeros((receivers, window)),
            place=np.zeros(receivers, dtype=np.int64),
        )

    @property
    def _squares(self) -> tuple[FloatArray, FloatArray, IntArray]:
        return self.memory["squares"], self.memory["counts"], self.memory["place"]


@njit
def readmit_nearest(
    statistic: FloatArray,
    threshold: FloatArray,
    visible: BoolArray,
    missing: int,
    weights: FloatArray,
) -> None:
    """Give weight 1 to as many of the excluded satellites of a receiver as are missing: those with
    the smallest ratio of statistic to threshold. `weights` (2n,), overwritten."""
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
    excluded: IntArray,
    weights: FloatArray,
) -> None:
    """Readmit satellites whose pseudoranges have been left out for too long, or are too few.
    `longest`: maximum exclusion time [epochs]; `excluded` (B, n) memory: epochs that each satellite
    has had weight 0 without an alarm; `weights` (B, 2n), pseudoranges first, overwritten."""
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
