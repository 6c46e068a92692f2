r"""Finite moving average: a sum of the innovations over one short window, satellite by satellite.

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

from .._jit import njit
from .._registry import check_choice
from ..receiver.epoch import Epoch
from .base import DetectorContext, Verdict
from .innovation_test import InnovationTest, check_length, epochs_of
from .thresholds import two_sided_quantile

FloatArray = NDArray[np.float64]
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
