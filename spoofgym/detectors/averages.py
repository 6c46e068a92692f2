r"""AIME, cumulative bank, finite moving average.

AIME: averages of the innovations over several windows, tested by chi-square.

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

A bank of cumulative innovation monitors of finite lengths.

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

Finite moving average: a sum of the innovations over one short window, satellite by satellite.

An attack has to be found within a time to alert, or it is too late.  Where the probability of
missing it for so long is what counts, and not the mean delay, a sum over just that time is nearly
the best test.  The statistic is the normalized sum, a matched filter of what an attack of this
length would look like,

.. math:: F_{k,j} = \frac{\left|\sum_{i=1}^{W} c_i \, u_{k-W+i,\,j}\right|}
    {\sqrt{\sum_{i=1}^{W} c_i^2}} > z_{\alpha/2}, \qquad u_{k,j} = z_{k,j} / \sqrt{S_{k,jj}}

with :math:`c_i = 1` for a step of the innovation at the start of the window, and
:math:`c_i = i / W` for a ramp that starts there.  Epochs in which a satellite was not judged count
in neither sum.

Symbols: z innovation, S innovation covariance, W epochs of the window, i epoch in it, 1 the oldest,
:math:`\alpha` false-alarm probability of one satellite in one epoch.

Assumptions: innovations are white, normal and of the variance that the filter believes in; a
constant satellite bias is summed up as an attack is: `bias_window_s`.  The innovation of a filter
that follows an offset is neither a step nor a ramp for long; the shapes are those of the first
seconds.

Deviations from `egearoca2018`, after which it is:

1. The paper sums log-likelihood ratios of a known change.  Here the size of the change and its sign
   are unknown, so that the sum of normal samples is tested on both sides.
2. The threshold is that of one epoch, not one of a bound on the probability of false alarms in any
   stretch of a given length; a calibration sets the rate.
3. A window that is not full yet takes what there is.
4. Each satellite has its own test.  With ``signals="both"`` a satellite's statistic is the larger
   of its two, and each is tested at :math:`\alpha/2`.

Source: `egearoca2018`.  Unlike `aime` it does not average over the receiver.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.compile import njit
from ..core.registry import check_choice
from ..receiver.epoch import Epoch
from .base import DetectorContext, Verdict
from .innovation import (
    InnovationTest,
    check_length,
    checked_windows,
    chi2_thresholds,
    epochs_of,
    remember_squares,
    two_sided_quantile,
)

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


SHAPES = ("step", "ramp")


@njit
def largest_moving_sum(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    judged: NDArray[np.bool_],
    first: int,
    last: int,
    shape: FloatArray,
    values: FloatArray,
    present: NDArray[np.bool_],
    place: NDArray[np.int64],
    statistic: FloatArray,
) -> None:
    """Remember an epoch, and sum every satellite's window up.

    `innovation`, `innovation_variance` (B, 2n); `judged` (B, n) bool; `shape` (W,) weights, the
    newest epoch first; `values` (B, last - first, W), `present` (B, n, W) memory, overwritten:
    normalized innovations of the last W epochs, and whether they were judged; `place` (B,) memory,
    overwritten: where the next epoch goes; `statistic` (B, n) written: largest normalized sum of a
    satellite's rows, 0 where it is not judged.
    """
    receivers, n = judged.shape
    window = shape.shape[0]
    for b in range(receivers):
        now = place[b]
        place[b] = (now + 1) % window
        for j in range(n):
            present[b, j, now] = judged[b, j]
            statistic[b, j] = 0.0
        for r in range(first, last):
            j, row = r % n, values[b, r - first]
            row[now] = 0.0
            if not judged[b, j]:
                continue
            row[now] = innovation[b, r] / math.sqrt(innovation_variance[b, r])
            total, squares = 0.0, 0.0
            for i in range(window):
                k = now - i if now >= i else now - i + window
                if present[b, j, k]:
                    total += shape[i] * row[k]
                    squares += shape[i] * shape[i]
            statistic[b, j] = max(statistic[b, j], abs(total) / math.sqrt(squares))


@dataclass
class FiniteMovingAverage(InnovationTest):
    """Normalized sum of every satellite's innovations over a window; monitor only.

    Parameters
    ----------
    false_alarm : float
        Probability of an alarm of one satellite in one epoch where the filter's belief is right, in
        (0, 1).
    window_s : float
        Length of the window, > 0: the time within which an attack is to be found.
    shape : {"step", "ramp"}
        What of the innovation the window is matched to.
    signals : {"pseudorange", "range_rate", "both"}
        Innovations to test.
    bias_window_s : float
        Length of the first window whose mean innovation is taken away from every channel, which is
        not judged before; 0 for none.
    """

    described_as = "FiniteMovingAverage"
    false_alarm: float = 1e-5
    window_s: float = 10.0
    shape: str = "step"
    signals: str = "pseudorange"
    bias_window_s: float = 0.0

    paper: ClassVar[str] = "egearoca2018"
    scope: ClassVar[str] = "channel"

    def __post_init__(self) -> None:
        check_length("window_s", self.window_s, least=1e-3)
        check_choice("shape", self.shape, SHAPES)
        super().__post_init__()

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        first, last = self._rows
        window = epochs_of(self.window_s, context)
        self.memory_epochs = self._bias_window + window
        self._shape = self.weights_of(window)
        self._quantile = two_sided_quantile(self.false_alarm / self._per_satellite)
        b, n = context.receivers, context.channels
        self.memory.declare("values", np.zeros((b, last - first, window)))
        self.memory.declare("present", np.zeros((b, n, window), dtype=np.bool_))
        self.memory.declare("place", np.zeros(b, dtype=np.int64))

    def weights_of(self, window: int) -> FloatArray:
        """(W,) weights of the epochs of a window, the newest first."""
        steps = np.arange(window, 0, -1) / window
        return steps if self.shape == "ramp" else np.ones(window)

    def judge(self, epoch: Epoch) -> Verdict:
        """Judge one epoch: (B, n) normalized sums, thresholds and alarms; no weights."""
        innovation, judged = self._without_bias(epoch)
        statistic = np.empty(judged.shape)
        ring = (self.memory["values"], self.memory["present"], self.memory["place"])
        rows = (*self._rows, self._shape)
        largest_moving_sum(innovation, epoch.innovation_variance, judged, *rows, *ring, statistic)
        threshold = np.full(statistic.shape, self._quantile)
        return Verdict(statistic, threshold, statistic > threshold)
