r"""AIME: averages of the innovations over several windows, tested by chi-square.

A slow drift that no single innovation shows is visible in their average.  Innovations are whitened
by the covariance of their own epoch, and the average over a window of W epochs is normalized,

.. math:: q_W = \sum_j \frac{1}{N_j} \Big(\sum_{i=k-W+1}^{k} y_{i,j}\Big)^2 \sim \chi^2(d),
    \qquad y_i = L_i^{-1} z_i, \quad S_i = L_i L_i^T

for windows of several lengths, each with its share of the false-alarm probability.  Other than the
sum of squares of a sequential test the average keeps the sign, and its degrees of freedom do not
grow with the window.

Symbols: z innovation, S innovation covariance, j row of the innovation, :math:`N_j` epochs of the
window in which row j was judged, d rows that are judged now.

Assumptions: innovations are white, normal and of the covariance that the filter believes in.  A
constant satellite bias is averaged as an attack is, so that the long windows alarm in a receiver
with such biases: `bias_window_s`.

Deviations from `diesel1995`:

1. The average is that of the whitened innovations.  Where S stays the same it is the original's
   :math:`\bar z^T (\sum S^{-1}) \bar z`; where S changes, this form has the same distribution
   and needs no inverse matrices of past epochs.
2. The windows are those of the comparisons in the literature on spoofing, not 150 s to 30 min.
3. The statistic is the largest of the windows', at :math:`\alpha` divided by their number.

Source: `diesel1995`; as a baseline against spoofing `zhong2025`, section 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .._jit import njit
from ..receiver.epoch import Epoch
from .base import DetectorContext, Verdict
from .innovation_test import InnovationTest, checked_windows, epochs_of
from .thresholds import chi2_thresholds

FloatArray = NDArray[np.float64]


@njit
def largest_average(
    white: FloatArray,
    judged: NDArray[np.bool_],
    first: int,
    windows: NDArray[np.int64],
    sums: FloatArray,
    counts: NDArray[np.int64],
    place: NDArray[np.int64],
    statistic: FloatArray,
) -> None:
    """Remember an epoch, and average over all windows.

    `white` (B, r) whitened innovations; `judged` (B, n) bool; `sums`, `counts` (B, W + 1, r)
    memory, overwritten: running sums of the whitened innovations and of the epochs that were
    judged, as they stood after each of the last W + 1 epochs; `place` (B,) memory, overwritten:
    that of the last epoch; `statistic` (B,) written: largest q of the windows.
    """
    receivers, size = white.shape
    n, length = judged.shape[1], sums.shape[1]
    for b in range(receivers):
        last = place[b]
        place[b] = now = (last + 1) % length
        for r in range(size):
            sums[b, now, r] = sums[b, last, r] + white[b, r]
            counts[b, now, r] = counts[b, last, r] + judged[b, (first + r) % n]
        statistic[b] = 0.0
        for w in range(len(windows)):
            start = (now - windows[w]) % length
            q = 0.0
            for r in range(size):
                if judged[b, (first + r) % n]:
                    total = sums[b, now, r] - sums[b, start, r]
                    q += total * total / (counts[b, now, r] - counts[b, start, r])
            statistic[b] = max(statistic[b], q)


@dataclass
class Aime(InnovationTest):
    """Chi-square of the average innovation over several windows, for the whole receiver.

    Parameters
    ----------
    false_alarm : float
        Probability of an alarm in one epoch where the filter's belief is right, in (0, 1); shared
        out to the windows, so that the true one is somewhat smaller.
    windows_s : tuple of float
        Lengths of the windows, increasing.  While a run is younger than a window the test takes
        what there is.
    signals : {"pseudorange", "range_rate", "both"}
        Innovations to test.
    bias_window_s : float
        Length of the first window whose mean innovation is taken away from every channel, which is
        not judged before; 0 for none.
    """

    described_as = "Aime"
    false_alarm: float = 1e-5
    windows_s: tuple[float, ...] = (5.0, 25.0, 75.0)
    signals: str = "pseudorange"
    bias_window_s: float = 0.0

    paper: ClassVar[str] = "diesel1995"
    needs: ClassVar[frozenset[str]] = frozenset({"innovation_cov"})

    def __post_init__(self) -> None:
        self.windows_s = checked_windows(self.windows_s)
        super().__post_init__()

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        first, last = self._rows
        self._windows = np.array([epochs_of(w, context) for w in self.windows_s], dtype=np.int64)
        self.memory_epochs = self._bias_window + int(self._windows[-1])
        shape = (context.receivers, int(self._windows[-1]) + 1, last - first)
        self.memory.declare("sums", np.zeros(shape))
        self.memory.declare("counts", np.zeros(shape, dtype=np.int64))
        self.memory.declare("place", np.zeros(context.receivers, dtype=np.int64))
        share = self.false_alarm / len(self._windows)
        self._thresholds = chi2_thresholds(share, last - first)[:: self._per_satellite]

    def judge(self, epoch: Epoch) -> Verdict:
        """Test one epoch: (B, 1) statistic, threshold and alarm; no weights."""
        white, judged = self._whitened(epoch)
        first = self._rows[0]
        statistic = np.empty((len(judged), 1))
        ring = (self.memory["sums"], self.memory["counts"], self.memory["place"])
        largest_average(white, judged, first, self._windows, *ring, statistic[:, 0])
        threshold = self._thresholds[judged.sum(axis=1)][:, None]
        return Verdict(statistic, threshold, statistic > threshold)
