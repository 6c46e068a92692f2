r"""Averages and sums of innovations over windows: AIME, bank, moving average, clock monitor.

Symbols: z innovation, S its covariance, whitened :math:`y = L^{-1} z` with :math:`S = L L^T`, W
epochs of a window, :math:`\alpha` false-alarm probability of one epoch.

Assumptions: innovations are white, normal and of the covariance that the filter believes in.  A
constant satellite bias is averaged as an attack is, so that long windows alarm in a receiver with
such biases: `bias_window_s`.  A window that is not full yet takes what there is.

**AIME** (`diesel1995`; against spoofing `zhong2025`, section 1): a slow drift that no single
innovation shows is visible in their average, normalized,

.. math:: q_W = \sum_j \frac{1}{N_j} \Big(\sum_{i=k-W+1}^{k} y_{i,j}\Big)^2 \sim \chi^2(d)

with :math:`N_j` epochs of the window in which row j was judged, and d rows that are judged now.  It
keeps the sign, which a sum of squares does not, and its degrees of freedom do not grow with W.
Deviations:

1. The average is that of whitened innovations.  Where S stays the same it is the original's
   :math:`\bar z^T (\sum S^{-1}) \bar z`; where S changes, this form has the same distribution
   and needs no inverse matrices of past epochs.
2. The windows are those of comparisons in the literature on spoofing, not 150 s to 30 min.
3. The statistic is the largest of the windows', at :math:`\alpha` divided by their number.

**Cumulative bank** (`quartararo2022`, of which the abstract alone was at hand; against faults
`joerger2013`): a long sum of squares finds a slow fault, but reacts late, and adds up what is wrong
with the filter's model; a short one is quick, but sees only large faults.  The bank has L windows,
each with an equal share of :math:`\alpha`, and the largest ratio to a threshold counts,

.. math:: R_k = \max_l \frac{q_l}{T_l} > 1, \qquad
    q_l = \sum_{i=k-W_l+1}^{k} z_i^T S_i^{-1} z_i \sim \chi^2(d_l), \qquad
    T_l = F^{-1}_{\chi^2}\!\left(1 - \alpha / L; \, d_l\right)

with :math:`d_l` rows measured in a window.  The sums hang together, so that :math:`\alpha` is a
bound, not a rate.  The lengths, 5 s to 150 s, Bonferroni's shares and the common statistic are
ours, and thresholds have no margin for an error model that is uncertain; a calibration sets the
rate.

**Finite moving average** (`egearoca2018`): an attack has to be found within a time to alert.  Where
the probability of missing it for so long counts, and not the mean delay, a sum over just that time
is nearly the best test: a matched filter of what such an attack would look like, per satellite,

.. math:: F_{k,j} = \frac{\left|\sum_{i=1}^{W} c_i \, u_{k-W+i,\,j}\right|}
    {\sqrt{\sum_{i=1}^{W} c_i^2}} > z_{\alpha/2}, \qquad u_{k,j} = z_{k,j} / \sqrt{S_{k,jj}}

with :math:`c_i = 1` for a step of the innovation at the start of the window, :math:`c_i = i / W`
for a ramp, i = 1 the oldest epoch; epochs in which a satellite was not judged count in neither sum.
The innovation of a filter that follows an offset has these shapes in the first seconds only.
Deviations:

1. The paper sums log-likelihood ratios of a known change.  Here its size and sign are unknown, so
   that the sum of normal samples is tested on both sides.
2. The threshold is that of one epoch, not one of a bound on the probability of false alarms in any
   stretch of a given length; a calibration sets the rate.
3. With ``signals="both"`` a satellite's statistic is the larger of its two, and each is tested at
   :math:`\alpha/2`.

**Clock monitor** (`hwang2014`): a spoofer whose own clock differs in offset or rate from the
authentic system's moves all pseudoranges, or all range rates, by the same amount, and geometry
can't separate that from the receiver's clock.  A known oscillator can: its states are predicted,
and the correction that an epoch needs has to stay within the predicted spread.  The common part of
the innovations is that correction, the generalized least-squares estimate (`barshalom2001`),
normalized,

.. math:: n_k = M^{-1} A^T S_k^{-1} z_k \sim N(0, I), \qquad M M^T = A^T S_k^{-1} A

and averaged over the last W epochs, :math:`q_k = |\sum_i n_i|^2 / W \sim \chi^2(s)`, with A (m, s)
a column of ones for the rows of each of s signals, so that the first element of n is the clock
offset's and the second one what the clock drift shows beyond that.  The filter has to believe in
the clock that the receiver has, ``tuning="matched"``; that of the papers' tables
(``tuning="paper"``) takes one that is far worse, so that hardly any drift is out of the ordinary.
Deviation: the paper monitors the clock states over longer times by their Allan variance; the
monitor tests the filter's innovations, and needs no solution of its own.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, cast

import numpy as np

from ..core.compile import njit
from ..core.declared import setting, settings_record
from ..receiver.epoch import Epoch
from .base import (
    BoolArray,
    DetectorContext,
    FloatArray,
    IntArray,
    Verdict,
    cholesky_of_rows,
    compare,
)
from .innovation import (
    OF_ONE_SATELLITE,
    InnovationTest,
    alarm_probability,
    chi2_thresholds,
    count_epochs,
    first_window,
    remember_squares,
    signals_to_test,
    two_sided_quantile,
)
from .own_filter import filter_to_test

SHAPES = ("step", "ramp")


def window_lengths(*default_s: float) -> Any:
    return setting(
        default=default_s,
        above=0.0,
        increasing=True,
        unit="s",
        help="Lengths of the windows.  While a run is younger than a window the test takes what "
        "there is.",
    )


@settings_record
class WindowsTest(InnovationTest):
    """Base of tests over windows of several lengths, each with its share of false alarms."""

    false_alarm: float = alarm_probability(
        help="Probability of an alarm in one epoch where the filter's belief is right; shared "
        "out to the windows, so that the true one is somewhat smaller."
    )
    windows_s: tuple[float, ...] = window_lengths(5.0, 25.0, 75.0)

    needs: ClassVar[frozenset[str]] = frozenset({"innovation_cov"})

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        self._windows = np.array([count_epochs(w, context) for w in self.windows_s], dtype=np.int64)
        self._longest = int(self._windows[-1])
        self.memory_epochs = self._bias_window + self._longest

    def thresholds_to(self, most: int) -> FloatArray:
        """(most + 1,) thresholds of one window by degrees of freedom."""
        return chi2_thresholds(self.false_alarm / len(self.windows_s), most)


@njit
def largest_average(
    white: FloatArray,
    judged: BoolArray,
    first: int,
    windows: IntArray,
    sums: FloatArray,
    counts: IntArray,
    place: IntArray,
    statistic: FloatArray,
) -> None:
    """Remember an epoch of whitened innovations (B, r), and average over all windows. `sums`,
    `counts` (B, W + 1, r) memory: running sums of the innovations, and of the epochs that were
    judged, after each of the last W + 1 epochs; `place` (B,) memory: that of the last epoch;
    `statistic` (B,) written: largest q of the windows."""
    receivers, size = white.shape
    n, length = judged.shape[1], sums.shape[1]
    slots = (first + np.arange(size)) % n
    for b in range(receivers):
        last = place[b]
        place[b] = now = (last + 1) % length
        for r in range(size):
            sums[b, now, r] = sums[b, last, r] + white[b, r]
            counts[b, now, r] = counts[b, last, r] + judged[b, slots[r]]
        statistic[b] = 0.0
        for w in range(len(windows)):
            start = (now - windows[w]) % length
            q = 0.0
            for r in range(size):
                if judged[b, slots[r]]:
                    total = sums[b, now, r] - sums[b, start, r]
                    q += total * total / (counts[b, now, r] - counts[b, start, r])
            statistic[b] = max(statistic[b], q)


@settings_record
class Aime(WindowsTest):
    """Chi-square of the average innovation over several windows, for the whole receiver."""

    signals: str = signals_to_test("pseudorange")
    bias_window_s: float = first_window()

    paper: ClassVar[str] = "diesel1995"

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        first, last = self._rows
        shape = (context.receivers, self._longest + 1, last - first)
        self.memory.declare_all(
            sums=np.zeros(shape),
            counts=np.zeros(shape, dtype=np.int64),
            place=np.zeros(context.receivers, dtype=np.int64),
        )
        self._thresholds = self.thresholds_to(last - first)[:: self._per_satellite]

    def judge(self, epoch: Epoch) -> Verdict:
        white, judged = self._whiten_rows(epoch)
        statistic = np.empty((len(judged), 1))
        ring = (self.memory["sums"], self.memory["counts"], self.memory["place"])
        largest_average(white, judged, self._rows[0], self._windows, *ring, statistic[:, 0])
        return compare(statistic, self._thresholds[judged.sum(axis=1)][:, None])


@njit
def largest_ratio(
    white: FloatArray,
    judged: BoolArray,
    each: int,
    windows: IntArray,
    thresholds: FloatArray,
    squares: FloatArray,
    counts: FloatArray,
    place: IntArray,
    statistic: FloatArray,
) -> None:
    """Remember an epoch of whitened innovations (B, r), and compare the sums of all windows with
    their thresholds. `windows` (L,) epochs, increasing; `thresholds` by degrees of freedom; memory
    of `remember_squares`; `statistic` (B,) written: largest ratio, 0 where nothing was measured."""
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


@settings_record
class CumulativeBank(WindowsTest):
    """Chi-square of the innovations of windows of several lengths, for the whole receiver."""

    windows_s: tuple[float, ...] = window_lengths(5.0, 15.0, 30.0, 75.0, 150.0)
    signals: str = signals_to_test("both")
    bias_window_s: float = first_window()
    filter: str = filter_to_test()

    paper: ClassVar[str] = "quartararo2022"

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        first, last = self._rows
        self._thresholds = self.thresholds_to(self._longest * (last - first))
        self._declare_squares(context.receivers, self._longest)

    def judge(self, epoch: Epoch) -> Verdict:
        white, judged = self._whiten_rows(epoch)
        statistic = np.empty((len(judged), 1))
        sums = (self._per_satellite, self._windows, self._thresholds)
        largest_ratio(white, judged, *sums, *self._squares, statistic[:, 0])
        return compare(statistic, 1.0)


@njit
def largest_moving_sum(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    judged: BoolArray,
    first: int,
    last: int,
    shape: FloatArray,
    values: FloatArray,
    present: BoolArray,
    place: IntArray,
    statistic: FloatArray,
) -> None:
    """Remember an epoch, and sum every satellite's window up. `shape` (W,) weights, the newest
    epoch first; `values` (B, last - first, W), `present` (B, n, W) memory: normalized innovations
    of the last W epochs, and whether they were judged; `place` (B,) memory: where the next epoch
    goes; `statistic` (B, n) written: largest sum of a satellite's rows, 0 where it is not
    judged."""
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


@settings_record
class FiniteMovingAverage(InnovationTest):
    """Normalized sum of every satellite's innovations over a window; monitor only."""

    false_alarm: float = alarm_probability(help=OF_ONE_SATELLITE)
    window_s: float = setting(
        default=10.0,
        least=1e-3,
        unit="s",
        help="Length of the window: the time within which an attack is to be found.",
    )
    shape: str = setting(
        default="step", one_of=SHAPES, help="What of the innovation the window is matched to."
    )
    signals: str = signals_to_test("pseudorange")
    bias_window_s: float = first_window()

    paper: ClassVar[str] = "egearoca2018"
    scope: ClassVar[str] = "channel"

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        b, n, (first, last) = context.receivers, context.channels, self._rows
        window = count_epochs(self.window_s, context)
        self.memory_epochs = self._bias_window + window
        self._shape = self.compute_weights(window)
        self._quantile = two_sided_quantile(self.false_alarm / self._per_satellite)
        self.memory.declare_all(
            values=np.zeros((b, last - first, window)),
            present=np.zeros((b, n, window), dtype=np.bool_),
            place=np.zeros(b, dtype=np.int64),
        )

    def compute_weights(self, window: int) -> FloatArray:
        """(W,) weights of the epochs of a window, the newest first."""
        return np.arange(window, 0, -1) / window if self.shape == "ramp" else np.ones(window)

    def judge(self, epoch: Epoch) -> Verdict:
        innovation, judged = self._without_bias(epoch)
        statistic = np.empty(judged.shape)
        ring = (self.memory["values"], self.memory["present"], self.memory["place"])
        rows = (*self._rows, self._shape)
        largest_moving_sum(innovation, epoch.innovation_variance, judged, *rows, *ring, statistic)
        return compare(statistic, self._quantile)


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


@settings_record
class ClockDrift(InnovationTest):
    """Chi-square of the average common part of the innovations; monitor only."""

    false_alarm: float = alarm_probability()
    window_s: float = setting(
        default=10.0,
        above=0.0,
        unit="s",
        help="Length that the common part is averaged over.  While a run is younger the test "
        "takes what there is.",
    )
    signals: str = signals_to_test(
        "both", "Innovations to test: pseudoranges show the clock's offset, range rates its drift."
    )
    bias_window_s: float = first_window()

    paper: ClassVar[str] = "hwang2014"
    needs: ClassVar[frozenset[str]] = frozenset({"innovation_cov"})

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        signals = self._per_satellite
        self._threshold = float(chi2_thresholds(self.false_alarm, 2)[signals])
        b, window = context.receivers, count_epochs(self.window_s, context)
        self.memory_epochs = self._bias_window + window
        self.memory.declare_all(
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
