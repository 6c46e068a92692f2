r"""Two-sided cumulative sum of every satellite's normalized innovation.

What an innovation exceeds an allowance by is added up, in either direction, and forgotten as soon
as the sum falls below zero.  So the chart gathers a small shift over just the time since it began.
It judges every satellite for itself.

.. math:: C^+_k = \max(0, C^+_{k-1} + u_k - \kappa), \quad
    C^-_k = \max(0, C^-_{k-1} - u_k - \kappa), \quad u_k = z_{k,j} / \sqrt{S_{k,jj}}

with an alarm where the larger of the two exceeds h.  Symbols: z innovation, S innovation
covariance, :math:`\kappa` the allowance, half of the shift that is found soonest, h the limit.

Assumptions: innovations are white, normal and of the variance that the filter believes in; a
constant satellite bias above the allowance adds up without end: `bias_window_s`.

What is promised is no rate of one epoch, but a mean time between false alarms, by
`mean_epochs_between_alarms`: 8e5 epochs of one satellite by default, 1e5 of a receiver with eight.
The sum is not set back by an alarm: after an attack it takes the sum over :math:`\kappa` in epochs,
or more, to fall back.

Source: `page1954`; the mean time is from `siegmund1985`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .._jit import njit
from ..receiver.epoch import Epoch
from .base import DetectorContext, Verdict
from .innovation_test import InnovationTest
from .thresholds import run_length

FloatArray = NDArray[np.float64]


def mean_epochs_between_alarms(allowance: float, limit: float) -> float:
    r"""Mean time to a false alarm of one two-sided chart, from zero, in epochs.

    .. math:: \frac{e^{2 \kappa b} - 2 \kappa b - 1}{4 \kappa^2}, \qquad b = h + 1.166

    Notes
    -----
    `siegmund1985`; see `thresholds.run_length`.
    """
    return 0.5 * run_length(allowance, limit)


@njit
def advance_sums(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    judged: NDArray[np.bool_],
    first: int,
    last: int,
    allowance: float,
    above: FloatArray,
    below: FloatArray,
) -> FloatArray:
    """Advance all sums by one epoch. `innovation`, `innovation_variance` (B, 2n); `judged` (B, n)
    bool; the sums of the others start again; `above`, `below` (B, last - first) memory,
    overwritten; returns (B, n) largest sum of every satellite."""
    receivers, n = judged.shape
    out = np.zeros((receivers, n))
    for b in range(receivers):
        for r in range(first, last):
            i, j = r - first, r % n
            if not judged[b, j]:
                above[b, i] = below[b, i] = 0.0
                continue
            u = innovation[b, r] / math.sqrt(innovation_variance[b, r])
            above[b, i] = max(0.0, above[b, i] + u - allowance)
            below[b, i] = max(0.0, below[b, i] - u - allowance)
            out[b, j] = max(out[b, j], above[b, i], below[b, i])
    return out


@dataclass
class Cusum(InnovationTest):
    """Cumulative sum of every satellite's innovation; monitor only.

    Parameters
    ----------
    allowance : float
        Kappa, above 0 [standard deviations].
    limit : float
        h, above 0 [standard deviations].
    signals : {"pseudorange", "range_rate", "both"}
        Innovations to add up; of ``"both"`` a satellite's statistic is the larger sum.
    bias_window_s : float
        Length of the first window whose mean innovation is taken away from every channel, which is
        not judged before; 0 for none.
    """

    described_as = "Cusum"
    allowance: float = 0.5
    limit: float = 12.4
    signals: str = "pseudorange"
    bias_window_s: float = 0.0

    paper: ClassVar[str] = "page1954"
    scope: ClassVar[str] = "channel"
    drifts: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for name in ("allowance", "limit"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"`{name}` must be finite and > 0, got {value}")
        super().__post_init__()

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        first, last = self._rows
        for name in ("above", "below"):
            self.memory.declare(name, np.zeros((context.receivers, last - first)))

    def judge(self, epoch: Epoch) -> Verdict:
        """Judge one epoch: (B, n) sums, limits, alarms; no weights."""
        innovation, judged = self._without_bias(epoch)
        statistic = advance_sums(
            innovation,
            epoch.innovation_variance,
            judged,
            *self._rows,
            self.allowance,
            self.memory["above"],
            self.memory["below"],
        )
        threshold = np.full(statistic.shape, self.limit)
        return Verdict(statistic, threshold, statistic > threshold)
