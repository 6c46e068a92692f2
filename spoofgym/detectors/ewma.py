r"""EWMA control chart of the innovations, with robust weights in the loop.

The pseudorange innovations of every satellite are averaged with weights that fall off
exponentially,

.. math:: \Lambda_k = \lambda z_k + (1 - \lambda) \Lambda_{k-1}, \qquad \Lambda_0 = 0,

and an alarm is raised where

.. math:: |\Lambda_k| > T_k = z_{\alpha/2} \, \sigma_k
    \sqrt{\tfrac{\lambda}{2 - \lambda} \left(1 - (1 - \lambda)^{2k}\right)}, \qquad
    \sigma_k^2 = S_{k,jj}.

The same statistic weighs the satellite's column of the Kalman gain by IGG-III between
:math:`T_{d0} = T_{d1} / 2` and :math:`T_{d1} = m T_k`, so that the filter does not get used to
an offset, and an offset of one satellite does not reach the others.

Symbols: z innovation of pseudorange j [m], S innovation covariance, :math:`\lambda` smoothing
factor, :math:`\alpha` false-alarm probability of one epoch, m scale of the weight thresholds.

Assumptions: innovations are white and of the variance that the filter believes in.  In the papers'
receiver they are smaller, and correlated by constant satellite biases.

Deviations from `zhong2025`, whose method M2 this is:

1. The paper writes the case limits of the weights for :math:`\Lambda`; as the chart is two-sided
   they are taken for its size.
2. :math:`\lambda` is not printed; 0.1 reproduces its delays.
3. m = 0.1 as printed locks satellites out for good; the default is 0.3.
4. The range rates keep weight 1, and the covariance update with the unweighted gain is the
   receiver's default (``covariance_update="unweighted"``), without which the delays are not met.
5. A satellite that sets and rises starts again.
6. Exclusion can be limited in time and in number (`lockout`).  It is not by default, so that the
   chart stays the one that the shipped spoofers were trained against.

Source: `zhong2025`, eqs. 11 to 14; the chart is from `roberts1959`, the weights from `yang2002`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .._jit import njit
from ..receiver.epoch import Epoch
from .base import Detector, DetectorContext, Verdict
from .lockout import check_limits, limit_exclusions, longest_exclusion
from .thresholds import (
    check_probability,
    epochs_to_settle,
    ewma_threshold,
    igg3_weight,
    two_sided_quantile,
)

FloatArray = NDArray[np.float64]


@njit
def judge_channels(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    visible: NDArray[np.bool_],
    smoothing: float,
    quantile: float,
    weight_scale: float,
    average: FloatArray,
    decay: FloatArray,
    size: FloatArray,
    threshold: FloatArray,
    weights: FloatArray,
) -> None:
    """Advance all charts by one epoch. `innovation`, `innovation_variance`, `visible` (B, 2n), (B,
    2n), (B, n), of the epoch; `average`, `decay` (B, n) memory, overwritten; `size`, `threshold`
    (B, n), written: statistic and threshold [m]; `weights` (B, 2n), written: IGG-III for
    pseudoranges, 1 for range rates."""
    for b in range(visible.shape[0]):
        for j in range(visible.shape[1]):
            if visible[b, j]:
                decay[b, j] *= (1.0 - smoothing) * (1.0 - smoothing)
                average[b, j] += smoothing * (innovation[b, j] - average[b, j])
            else:
                decay[b, j], average[b, j] = 1.0, 0.0
            sd = math.sqrt(innovation_variance[b, j])
            first = (1.0 - smoothing) * (1.0 - smoothing)
            limit = ewma_threshold(sd, min(decay[b, j], first), smoothing, quantile)
            size[b, j] = abs(average[b, j])
            threshold[b, j] = limit
            reject = weight_scale * limit
            weights[b, j] = igg3_weight(size[b, j], 0.5 * reject, reject)
            weights[b, visible.shape[1] + j] = 1.0


@dataclass
class Ewma(Detector):
    """EWMA chart of every satellite's pseudorange innovation, with robust weights in the loop.

    Parameters
    ----------
    smoothing : float
        Lambda, in (0, 1].
    false_alarm : float
        Alpha, probability of an alarm of one satellite in one epoch, in (0, 1).
    weight_scale : float or None
        m, in (0, 1]: the weight thresholds are m T and m T / 2.  None for a passive
        chart.
    max_exclusion_s : float or None
        Longest time that a satellite can have weight 0 without an alarm, above 0; None for no
        limit.
    min_satellites : int
        Fewest satellites that keep a weight above 0, where as many are in view; 0 for none.
    """

    described_as = "Ewma"
    smoothing: float = 0.1
    false_alarm: float = 1e-5
    weight_scale: float | None = 0.3
    max_exclusion_s: float | None = None
    min_satellites: int = 0

    paper: ClassVar[str] = "zhong2025"
    scope: ClassVar[str] = "channel"

    def __post_init__(self) -> None:
        if not 0.0 < self.smoothing <= 1.0:
            raise ValueError(f"`smoothing` must be in (0, 1], got {self.smoothing}")
        check_probability("false_alarm", self.false_alarm)
        if self.weight_scale is not None and not 0.0 < self.weight_scale <= 1.0:
            raise ValueError(f"`weight_scale` must be in (0, 1] or None, got {self.weight_scale}")
        check_limits(self.max_exclusion_s, self.min_satellites)

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        shape = (context.receivers, context.channels)
        self.memory_epochs = epochs_to_settle(self.smoothing)
        self.memory.declare("average", np.zeros(shape))
        self.memory.declare("decay", np.ones(shape))
        self._quantile = two_sided_quantile(self.false_alarm)
        self._longest = longest_exclusion(self.max_exclusion_s, context.epoch_interval_s)
        limited = self.max_exclusion_s is not None or self.min_satellites > 0
        self.limits_exclusions = limited and self.weight_scale is not None
        if self.limits_exclusions:
            self.memory.declare("excluded", np.zeros(shape, dtype=np.int64))
        scale = 1.0 if self.weight_scale is None else self.weight_scale
        self.kernel_settings = np.array([self.smoothing, self._quantile, scale])

    def judge(self, epoch: Epoch) -> Verdict:
        """Judge one epoch. Returns (B, n) size of the averages, thresholds, alarms; (B, 2n)
        weights, 1 for range rates."""
        shape = epoch.visible.shape
        size, threshold = np.empty(shape), np.empty(shape)
        weights = np.empty(epoch.innovation.shape)
        smoothing, quantile, scale = self.kernel_settings.tolist()
        judge_channels(
            epoch.innovation,
            epoch.innovation_variance,
            epoch.visible,
            smoothing,
            quantile,
            scale,
            self.memory["average"],
            self.memory["decay"],
            size,
            threshold,
            weights,
        )
        in_loop = None if self.weight_scale is None else weights
        if self.limits_exclusions:
            limit_exclusions(
                size,
                threshold,
                epoch.visible,
                self._longest,
                self.min_satellites,
                self.memory["excluded"],
                weights,
            )
        return Verdict(size, threshold, size > threshold, in_loop)

    def settling_epochs(self, offset: float, threshold: float) -> float:
        r"""Epochs until the chart falls below the threshold after a constant offset has ended.

        .. math:: n = \frac{\ln(T / b)}{\ln(1 - \lambda)}

        `offset`: b, what the chart had settled on [m]; `threshold`: T [m].
        """
        return math.log(threshold / offset) / math.log(1.0 - self.smoothing)
