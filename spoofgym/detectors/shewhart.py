r"""Shewhart control chart of the innovations.

Every innovation is judged for itself, by the standard deviation that the filter believes it has,
so that the chart sees a jump at once and forgets it at once.  A drift to which the filter gets used
stays within the limits, and when an offset ends that the filter has followed, the innovations jump
to the other side and alarm although the attack is over.  The chart is the first half of zhong2025's
joint chart, and its method M1.

.. math:: |z_{k,j}| > z_{\alpha/2} \, \sigma_{k,j}, \qquad \sigma_{k,j}^2 = S_{k,jj}

Symbols: z innovation, S innovation covariance, :math:`\alpha` false-alarm probability of one
satellite in one epoch.

Assumptions: innovations are normal and of the variance that the filter believes in.

Deviations from `zhong2025`, whose method M1 this is:

1. The statistic is divided by :math:`\sigma`, and the threshold is :math:`z_{\alpha/2}`: the same
   alarms, and the same unit for pseudoranges and range rates.
2. The paper tests pseudoranges alone, which is the default.  With ``signals="both"`` a satellite's
   statistic is the larger of its two, and each is tested at :math:`\alpha/2`.
3. The paper's M1 has no weights; nor has this one by default.  `weight_scale` gives it those that
   M2 has, with limits of exclusion (`lockout`).

Source: `zhong2025`, eqs. 15 and 16; the chart is from `shewhart1931`.
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
from .lockout import check_limits, limit_exclusions, longest_exclusion
from .thresholds import igg3_weight, two_sided_quantile

FloatArray = NDArray[np.float64]


@njit
def largest_normalized(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    judged: NDArray[np.bool_],
    first: int,
    last: int,
) -> FloatArray:
    r"""Size of every satellite's innovation in standard deviations, the largest of its rows.

    .. math:: F_j = \max_r |z_r| / \sqrt{S_{rr}}

    `innovation`, `innovation_variance` (B, 2n); `judged` (B, n) bool, satellites to test;
    returns (B, n); 0 for the others.
    """
    receivers, n = judged.shape
    out = np.zeros((receivers, n))
    for b in range(receivers):
        for r in range(first, last):
            if judged[b, r % n]:
                size = abs(innovation[b, r]) / math.sqrt(innovation_variance[b, r])
                out[b, r % n] = max(out[b, r % n], size)
    return out


@njit
def snapshot_weights(statistic: FloatArray, reject: float) -> FloatArray:
    """IGG-III weights of the pseudoranges; 1 for the range rates. `statistic` (B, n); returns (B,
    2n)."""
    receivers, n = statistic.shape
    out = np.ones((receivers, 2 * n))
    for b in range(receivers):
        for j in range(n):
            out[b, j] = igg3_weight(statistic[b, j], 0.5 * reject, reject)
    return out


@dataclass
class Shewhart(InnovationTest):
    """Every satellite's innovation against its own standard deviation.

    Parameters
    ----------
    false_alarm : float
        Alpha, probability of an alarm of one satellite in one epoch, in (0, 1).
    weight_scale : float or None
        m, in (0, 1]: the pseudorange gets no weight from m times the threshold on, and less than 1
        from half of that.  None for a passive chart.
    signals : {"pseudorange", "range_rate", "both"}
        Innovations to test.
    bias_window_s : float
        Length of the first window whose mean innovation is taken away from every channel, which is
        not judged before; 0 for none.
    max_exclusion_s : float or None
        Longest time that a satellite can have weight 0 without an alarm, above 0; None for no
        limit.
    min_satellites : int
        Fewest satellites that keep a weight above 0, where as many are in view; 0 for none.
    """

    described_as = "Shewhart"
    false_alarm: float = 1e-5
    weight_scale: float | None = None
    signals: str = "pseudorange"
    bias_window_s: float = 0.0
    max_exclusion_s: float | None = 60.0
    min_satellites: int = 5

    paper: ClassVar[str] = "zhong2025"
    scope: ClassVar[str] = "channel"

    def __post_init__(self) -> None:
        if self.weight_scale is not None and not 0.0 < self.weight_scale <= 1.0:
            raise ValueError(f"`weight_scale` must be in (0, 1] or None, got {self.weight_scale}")
        super().__post_init__()
        check_limits(self.max_exclusion_s, self.min_satellites)

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        self._quantile = two_sided_quantile(self.false_alarm / self._per_satellite)
        shape = (context.receivers, context.channels)
        self.memory.declare("excluded", np.zeros(shape, dtype=np.int64))
        self._longest = longest_exclusion(self.max_exclusion_s, context.epoch_interval_s)

    def judge(self, epoch: Epoch) -> Verdict:
        """Judge one epoch. Returns (B, n) innovations in standard deviations, thresholds, alarms;
        (B, 2n) weights, 1 for range rates."""
        innovation, judged = self._without_bias(epoch)
        statistic = largest_normalized(innovation, epoch.innovation_variance, judged, *self._rows)
        threshold = np.full(statistic.shape, self._quantile)
        weights = None
        if self.weight_scale is not None:
            weights = snapshot_weights(statistic, self.weight_scale * self._quantile)
            limit_exclusions(
                statistic,
                threshold,
                epoch.visible,
                self._longest,
                self.min_satellites,
                self.memory["excluded"],
                weights,
            )
        return Verdict(statistic, threshold, statistic > threshold, weights)
