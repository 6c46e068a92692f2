r"""Clock monitor: what all innovations have in common, which is what moves the clock states.

A spoofer whose own clock differs in offset or rate from the authentic system's moves all
pseudoranges, or all range rates, by the same amount, and geometry can't separate that from the
receiver's clock.  A known oscillator can: its states are predicted, and the correction that an
epoch asks for has to stay within the predicted spread.  The common part of the innovations is that
correction, the generalized least-squares estimate (`barshalom2001`), normalized,

.. math:: n_k = M^{-1} A^T S_k^{-1} z_k \sim N(0, I), \qquad M M^T = A^T S_k^{-1} A

and averaged over the last W epochs, :math:`q_k = |\sum_i n_i|^2 / W \sim \chi^2(s)`.

Symbols: z innovation, S innovation covariance, A (m, s) a column of ones for the rows of each
signal, so that the first element of n is the clock offset's and the second one what the clock drift
shows beyond that; s signals.

Assumptions: the filter believes in the clock that the receiver has, ``tuning="matched"``.  The
filter of the papers' tables (``tuning="paper"``) takes one that is far worse, so that hardly any
drift is out of the ordinary.

Deviations from `hwang2014`, which monitors the clock states over longer times by their Allan
variance: the monitor tests the filter's innovations, and needs no solution of its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, cast

import numpy as np

from ..core.compile import njit
from ..core.registry import check_finite
from ..receiver.epoch import Epoch
from .base import BoolArray, DetectorContext, FloatArray, IntArray, Verdict, compare
from .innovation import InnovationTest, chi2_thresholds, cholesky_of_rows, epochs_of


@njit
def normalized_projection(white: FloatArray, count: int, out: FloatArray) -> None:
    """Coordinates of a whitened innovation along orthonormal directions of its common parts.
    `white` (r, 1 + s) whitened innovation, then the whitened columns of A; `out` (s,) written."""
    projected, norm, other, cross, far = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        projected += white[i, 1] * white[i, 0]
        norm += white[i, 1] * white[i, 1]
        if out.shape[0] > 1:
            other += white[i, 2] * white[i, 0]
            cross += white[i, 1] * white[i, 2]
            far += white[i, 2] * white[i, 2]
    out[0] = projected / math.sqrt(norm)
    if out.shape[0] > 1:
        share = cross / norm
        out[1] = (other - share * projected) / math.sqrt(far - share * cross)


@njit
def common_part(
    innovation: FloatArray,
    innovation_cov: FloatArray,
    judged: BoolArray,
    first: int,
    last: int,
    out: FloatArray,
) -> None:
    """Normalized common part n of the innovations of every signal. `judged` (B, n) satellites that
    take part; `out` (B, s) written; 0 where nothing is judged, infinite where S is not positive
    definite."""
    receivers, n = judged.shape
    size = last - first
    signals = size // n
    rows = np.empty(size, dtype=np.int64)
    factor = np.empty((size, size))
    white = np.empty((size, signals + 1))  # innovation, then the columns of A
    for b in range(receivers):
        out[b] = 0.0
        count = cholesky_of_rows(innovation_cov[b], judged[b], first, last, rows, factor)
        if count < 0:
            out[b, 0] = np.inf
        if count <= 0:
            continue
        for i in range(count):
            for c in range(signals + 1):
                value = innovation[b, rows[i]]
                if c > 0:
                    value = 1.0 if (rows[i] - first) // n == c - 1 else 0.0
                for k in range(i):
                    value -= factor[i, k] * white[k, c]
                white[i, c] = value * factor[i, i]
        normalized_projection(white, count, out[b])


@njit
def window_average(
    part: FloatArray,
    judged: BoolArray,
    past: FloatArray,
    taken: BoolArray,
    place: IntArray,
    statistic: FloatArray,
) -> None:
    """Remember an epoch, and test the average over the window. `part` (B, s) n; `past` (B, W, s),
    `taken` (B, W) memory: n, and epochs in which anything was judged; `place` (B,) memory: where
    the next epoch goes; `statistic` (B,) written; 0 where nothing is judged now."""
    window = taken.shape[1]
    for b in range(part.shape[0]):
        k = place[b]
        place[b] = (k + 1) % window
        past[b, k] = part[b]
        taken[b, k] = judged[b].any()
        statistic[b] = 0.0
        if not taken[b, k]:
            continue
        count = 0.0
        for i in range(window):
            count += taken[b, i]
        for c in range(part.shape[1]):
            total = 0.0
            for i in range(window):
                total += past[b, i, c]
            statistic[b] += total * total / count


@dataclass
class ClockDrift(InnovationTest):
    """Chi-square of the average common part of the innovations; monitor only.

    Parameters
    ----------
    window_s : float
        Length that the common part is averaged over, above 0.  While a run is younger the test
        takes what there is.
    signals : {"both", "pseudorange", "range_rate"}
        Innovations to test: pseudoranges show the clock's offset, range rates its drift.
    false_alarm, bias_window_s
        As in `SnapshotChi2`.
    """

    described_as = "ClockDrift"
    false_alarm: float = 1e-5
    window_s: float = 10.0
    signals: str = "both"
    bias_window_s: float = 0.0

    paper: ClassVar[str] = "hwang2014"
    needs: ClassVar[frozenset[str]] = frozenset({"innovation_cov"})

    def __post_init__(self) -> None:
        check_finite("window_s", self.window_s, "> 0")
        super().__post_init__()

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        signals = self._per_satellite
        self._threshold = float(chi2_thresholds(self.false_alarm, 2)[signals])
        b, window = context.receivers, epochs_of(self.window_s, context)
        self.memory_epochs = self._bias_window + window
        self._declare(
            past=np.zeros((b, window, signals)),
            taken=np.zeros((b, window), dtype=np.bool_),
            place=np.zeros(b, dtype=np.int64),
        )

    def judge(self, epoch: Epoch) -> Verdict:
        innovation, judged = self._without_bias(epoch)
        part = np.empty((len(judged), self._per_satellite))
        belief = cast(FloatArray, epoch.innovation_cov)
        common_part(innovation, belief, judged, *self._rows, part)
        statistic = np.empty((len(judged), 1))
        ring = (self.memory["past"], self.memory["taken"], self.memory["place"])
        window_average(part, judged, *ring, statistic[:, 0])
        return compare(statistic, self._threshold)
