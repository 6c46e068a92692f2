r"""Sequential innovation test: chi-square of all innovations so far, or of a window of them.

The normalized innovations squared of many epochs are added up, and so are their degrees of freedom,

.. math:: q_k = \sum_i z_i^T S_i^{-1} z_i \sim \chi^2\Big(\sum_i d_i\Big)

where i runs over all epochs so far, or over the last ones.  Innovations of a filter whose belief is
right are white, so that the sum has this distribution at every epoch.  The longer the sum, the less
a short attack shows in it: the test that takes all history goes blind with time.

Symbols: z innovation, S innovation covariance, d rows that take part, :math:`\alpha` false-alarm
probability of one epoch.

Assumptions: innovations are white, normal and of the covariance that the filter believes in.

Alarms of neighbouring epochs are those of nearly the same sum, so that a run has fewer but longer
alarms than an independent test of the same :math:`\alpha`.

Source: `mehra1971`; as a baseline against spoofing `zhong2025`, section 2.3.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import special

from .._describe import OMITTED
from .._jit import njit
from ..receiver.epoch import Epoch
from .base import DetectorContext, Verdict
from .innovation_test import InnovationTest, epochs_of, remember_squares
from .thresholds import chi2_lower_thresholds, outside_ratio

FloatArray = NDArray[np.float64]


@njit
def add_to_sums(
    white: FloatArray, judged: NDArray[np.bool_], each: int, total: FloatArray, degrees: FloatArray
) -> None:
    """Add the squares of an epoch to the sums of all history. `white` (B, r) whitened innovations;
    `judged` (B, n) bool; `total`, `degrees` (B,) memory, overwritten: sum of squares, and degrees
    of freedom."""
    for b in range(white.shape[0]):
        for r in range(white.shape[1]):
            total[b] += white[b, r] * white[b, r]
        for j in range(judged.shape[1]):
            if judged[b, j]:
                degrees[b] += each


@njit
def add_to_window(
    white: FloatArray,
    judged: NDArray[np.bool_],
    each: int,
    squares: FloatArray,
    counts: FloatArray,
    place: NDArray[np.int64],
    total: FloatArray,
    degrees: FloatArray,
) -> None:
    """Add the squares of an epoch to a window, and sum the window up. `white` (B, r) whitened
    innovations; `judged` (B, n) bool; `squares`, `counts` (B, W), `place` (B,) memory of
    `remember_squares`; `total`, `degrees` (B,) written: sums over the window."""
    remember_squares(white, judged, each, squares, counts, place)
    for b in range(white.shape[0]):
        total[b] = degrees[b] = 0.0
        for i in range(squares.shape[1]):
            total[b] += squares[b, i]
            degrees[b] += counts[b, i]


@dataclass
class SequentialChi2(InnovationTest):
    """Chi-square of all innovations so far, or of a window, for the whole receiver.

    Parameters
    ----------
    false_alarm : float
        Probability of an alarm in one epoch where the filter's belief is right, in (0, 1).
    window_s : float or None
        Length of the window; None for all history.  While a run is younger than its window the
        test takes what there is.
    signals : {"pseudorange", "range_rate", "both"}
        Innovations to test.
    bias_window_s : float
        Length of the first window whose mean innovation is taken away from every channel, which is
        not judged before; 0 for none.
    two_sided : bool
        Whether innovations that are too small alarm, too, each side with half of `false_alarm`: a
        counterfeit signal may have less noise than nature.  The statistic is then the ratio to the
        limit that is nearer, and the threshold 1.
    """

    described_as = "SequentialChi2"
    false_alarm: float = 1e-5
    window_s: float | None = None
    signals: str = "pseudorange"
    bias_window_s: float = 0.0
    two_sided: bool = field(default=False, metadata=OMITTED)

    paper: ClassVar[str] = "mehra1971"
    needs: ClassVar[frozenset[str]] = frozenset({"innovation_cov"})

    def __post_init__(self) -> None:
        if self.window_s is not None and not (np.isfinite(self.window_s) and self.window_s > 0.0):
            raise ValueError(f"`window_s` must be finite and > 0, or None, got {self.window_s}")
        super().__post_init__()

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        b = context.receivers
        if self.window_s is None:
            self.memory.declare("total", np.zeros(b))
            self.memory.declare("degrees", np.zeros(b))
        else:
            window = epochs_of(self.window_s, context)
            self.memory_epochs = self._bias_window + window
            self.memory.declare("squares", np.zeros((b, window)))
            self.memory.declare("counts", np.zeros((b, window)))
            self.memory.declare("place", np.zeros(b, dtype=np.int64))

    def judge(self, epoch: Epoch) -> Verdict:
        """Test one epoch: (B, 1) statistic, threshold and alarm; no weights."""
        white, judged = self._whitened(epoch)
        statistic, degrees = self._sums(white, judged)
        if self.two_sided:
            each_side, some = 0.5 * self.false_alarm, np.maximum(degrees, 1.0)
            limits = chi2_lower_thresholds(each_side, some), special.chdtri(some, each_side)
            ratio = outside_ratio(statistic, *limits, degrees > 0.0)
            return Verdict(ratio, np.ones_like(ratio), ratio > 1.0)
        threshold = special.chdtri(np.maximum(degrees, 1.0), self.false_alarm)[:, None]
        return Verdict(statistic[:, None], threshold, statistic[:, None] > threshold)

    def _sums(self, white: FloatArray, judged: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
        """Sum of squares and degrees of freedom, with the present epoch."""
        memory, each = self.memory, self._per_satellite
        if self.window_s is None:
            add_to_sums(white, judged, each, memory["total"], memory["degrees"])
            return memory["total"].copy(), memory["degrees"].copy()
        total, degrees = np.empty(len(white)), np.empty(len(white))
        ring = (memory["squares"], memory["counts"], memory["place"])
        add_to_window(white, judged, each, *ring, total, degrees)
        return total, degrees
