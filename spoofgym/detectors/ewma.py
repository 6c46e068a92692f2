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

Symbols: z innovation of pseudorange j [m], S innovation covariance, :math:`\lambda` smoothing factor,
:math:`\alpha` false-alarm probability of one epoch, m scale of the weight thresholds.

Assumptions: innovations are white and of the variance that the filter believes in.  In the papers'
receiver they are smaller, and correlated by constant satellite biases.

Deviations from `zhong2025`, whose method M2 this is:

1. The paper writes the case limits of the weights for :math:`\Lambda`; as the chart is two-sided they
   are taken for its size.
2. :math:`\lambda` is not printed; 0.1 reproduces its delays.
3. m = 0.1 as printed locks satellites out for good; the default is 0.3.
4. The range rates keep weight 1, and the covariance update with the unweighted gain is the
   receiver's default (``covariance_update="unweighted"``), without which the delays are not met.
5. A satellite that sets and rises begins anew.

Source: `zhong2025`, eqs. 11 to 14; the chart is from `roberts1959`, the weights from `yang2002`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..receiver.epoch import Epoch
from .base import Detector, DetectorContext, Verdict
from .thresholds import check_probability, igg3_weights, two_sided_quantile

FloatArray = NDArray[np.float64]


def ewma_threshold(
    sd: FloatArray, count: FloatArray, smoothing: float, quantile: float
) -> FloatArray:
    r"""Threshold of the chart after some epochs.

    .. math:: T = z \sigma \sqrt{\tfrac{\lambda}{2 - \lambda} (1 - (1 - \lambda)^{2k})}

    Parameters
    ----------
    sd : ndarray
        Standard deviation of the innovation [m].
    count : ndarray
        Epochs averaged so far, k.
    smoothing : float
        Lambda.
    quantile : float
        z.

    Returns
    -------
    ndarray
        T [m].
    """
    widening = 1.0 - (1.0 - smoothing) ** (2.0 * count)
    return quantile * sd * np.sqrt(smoothing / (2.0 - smoothing) * widening)


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
        m, in (0, 1]: the weight thresholds are m T and m T / 2.  None for a chart that only
        watches.
    """

    smoothing: float = 0.1
    false_alarm: float = 1e-5
    weight_scale: float | None = 0.3

    paper: ClassVar[str] = "zhong2025"

    def __post_init__(self) -> None:
        """Check the settings."""
        if not 0.0 < self.smoothing <= 1.0:
            raise ValueError(f"`smoothing` must be in (0, 1], got {self.smoothing}")
        check_probability("false_alarm", self.false_alarm)
        if self.weight_scale is not None and not 0.0 < self.weight_scale <= 1.0:
            raise ValueError(f"`weight_scale` must be in (0, 1] or None, got {self.weight_scale}")

    def bind(self, context: DetectorContext) -> None:
        """Begin the charts of all satellites.

        Parameters
        ----------
        context : DetectorContext
            Sizes.
        """
        super().bind(context)
        shape = (context.receivers, context.channels)
        self.memory.declare("average", np.zeros(shape))
        self.memory.declare("count", np.zeros(shape))
        self._quantile = two_sided_quantile(self.false_alarm)

    def judge(self, epoch: Epoch) -> Verdict:
        """Judge one epoch.

        Parameters
        ----------
        epoch : Epoch
            Read-only.

        Returns
        -------
        Verdict
            (B, n) size of the averages, thresholds, alarms; (B, 2n) weights, 1 for range rates.
        """
        visible = epoch.visible
        n = visible.shape[1]
        z = epoch.innovation[:, :n]
        average = self.memory["average"]
        average = np.where(visible, average + self.smoothing * (z - average), 0.0)
        count = np.where(visible, self.memory["count"] + 1.0, 0.0)
        self.memory["average"], self.memory["count"] = average, count
        variance = np.diagonal(epoch.innovation_cov, axis1=1, axis2=2)[:, :n]
        threshold = ewma_threshold(
            np.sqrt(variance), np.maximum(count, 1.0), self.smoothing, self._quantile
        )
        size = np.abs(average)
        if self.weight_scale is None:
            return Verdict(size, threshold, size > threshold)
        weights = np.ones((len(z), 2 * n))
        reject = self.weight_scale * threshold
        weights[:, :n] = igg3_weights(size, 0.5 * reject, reject)
        return Verdict(size, threshold, size > threshold, weights)

    def settling_epochs(self, offset: float, threshold: float) -> float:
        r"""Epochs until the chart falls below the threshold after a constant offset has ended.

        .. math:: n = \frac{\ln(T / b)}{\ln(1 - \lambda)}

        Parameters
        ----------
        offset : float
            b, what the chart had settled on [m].
        threshold : float
            T [m].

        Returns
        -------
        float
            n.
        """
        return math.log(threshold / offset) / math.log(1.0 - self.smoothing)
