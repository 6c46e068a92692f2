r"""A bank of cumulative innovation monitors of finite lengths.

The normalized innovations squared of a window are added up, and compared with chi-square of as many
degrees of freedom as were measured in it.  A long sum finds a slow fault, but reacts late, and what
is wrong with the filter's model adds up in it, too; a short one is quick, but sees only large
faults.  The bank has a window of every length, each with an equal share of the false-alarm
probability, and its statistic is the largest ratio of a sum to its threshold,

.. math:: R_k = \max_l \frac{q_l}{T_l} > 1, \qquad
    q_l = \sum_{i=k-W_l+1}^{k} z_i^T S_i^{-1} z_i \sim \chi^2(d_l), \qquad
    T_l = F^{-1}_{\chi^2}\!\left(1 - \alpha / L; \, d_l\right)

Symbols: z innovation, S its covariance, :math:`W_l` epochs of a window, L number of windows,
:math:`d_l` rows measured in a window, :math:`\alpha` false-alarm probability of one epoch.

Assumptions: innovations are white, normal and of the covariance that the filter believes in.  The
sums of an epoch hang together, so that :math:`\alpha` is a bound, not a rate.

Deviations from `quartararo2022`, after which it is, with its abstract alone at hand:

1. The lengths are ours, 5 s to 150 s.
2. All sums slide with the epochs.  A window that is not full yet takes what there is, as
   `sequential-chi2` does, so that young windows of several lengths have the same sum.
3. The share of each window, Bonferroni's, and the common statistic are ours.
4. The thresholds are those of the filter's belief, with no margin for an error model that is
   uncertain; a calibration sets the rate.

Source: `quartararo2022`; a cumulative test of innovations against faults is from `joerger2013`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .._jit import njit
from ..receiver.epoch import Epoch
from .base import DetectorContext, Verdict
from .innovation_test import InnovationTest, checked_windows, epochs_of, remember_squares
from .thresholds import chi2_thresholds

FloatArray = NDArray[np.float64]


@njit
def largest_ratio(
    white: FloatArray,
    judged: NDArray[np.bool_],
    each: int,
    windows: NDArray[np.int64],
    thresholds: FloatArray,
    squares: FloatArray,
    counts: FloatArray,
    place: NDArray[np.int64],
    statistic: FloatArray,
) -> None:
    """Remember an epoch, and compare the sums of all windows with their thresholds. `white` (B, r)
    whitened innovations; `judged` (B, n) bool; `windows` (L,) epochs, increasing; `thresholds` by
    degrees of freedom; `squares`, `counts` (B, W), `place` (B,) memory of `remember_squares`;
    `statistic` (B,) written: largest ratio, 0 where nothing was measured."""
    length = squares.shape[1]
    remember_squares(white, judged, each, squares, counts, place)
    for b in range(white.shape[0]):
        total, degrees, done, k = 0.0, 0.0, 0, place[b]
        statistic[b] = 0.0
        for w in range(windows.shape[0]):
            for _ in range(done, windows[w]):
                k = k - 1 if k > 0 else length - 1
                total += squares[b, k]
                degrees += counts[b, k]
            done = windows[w]
            if degrees > 0.0:
                statistic[b] = max(statistic[b], total / thresholds[int(degrees)])


@dataclass
class CumulativeBank(InnovationTest):
    """Chi-square of the innovations of windows of several lengths, for the whole receiver.

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

    described_as = "CumulativeBank"
    false_alarm: float = 1e-5
    windows_s: tuple[float, ...] = (5.0, 15.0, 30.0, 75.0, 150.0)
    signals: str = "both"
    bias_window_s: float = 0.0

    paper: ClassVar[str] = "quartararo2022"
    needs: ClassVar[frozenset[str]] = frozenset({"innovation_cov"})

    def __post_init__(self) -> None:
        self.windows_s = checked_windows(self.windows_s)
        super().__post_init__()

    def bind(self, context: DetectorContext) -> None:
        """Prepare the windows, and the thresholds for every number of rows in one."""
        super().bind(context)
        first, last = self._rows
        self._windows = np.array([epochs_of(w, context) for w in self.windows_s], dtype=np.int64)
        longest = int(self._windows[-1])
        self.memory_epochs = self._bias_window + longest
        self._thresholds = self.thresholds_to(longest * (last - first))
        self.memory.declare("squares", np.zeros((context.receivers, longest)))
        self.memory.declare("counts", np.zeros((context.receivers, longest)))
        self.memory.declare("place", np.zeros(context.receivers, dtype=np.int64))

    def thresholds_to(self, most: int) -> FloatArray:
        """(most + 1,) thresholds of one window by degrees of freedom."""
        return chi2_thresholds(self.false_alarm / len(self.windows_s), most)

    def judge(self, epoch: Epoch) -> Verdict:
        """Test one epoch: (B, 1) largest ratio, threshold 1 and alarm; no weights."""
        white, judged = self._whitened(epoch)
        statistic = np.empty((len(judged), 1))
        ring = (self.memory["squares"], self.memory["counts"], self.memory["place"])
        sums = (self._per_satellite, self._windows, self._thresholds)
        largest_ratio(white, judged, *sums, *ring, statistic[:, 0])
        return Verdict(statistic, np.ones_like(statistic), statistic > 1.0)
