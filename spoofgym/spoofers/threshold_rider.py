r"""Threshold rider: the largest rate that keeps the predicted statistic below its threshold.

A spoofer that sees the statistic but not the detector learns how the one follows from the other.
With q the largest statistic over its threshold, h a horizon and u the mean own rate over it, every
receiver fits, by recursive least squares (`ljung1999`, section 11.2) from the onset on,

.. math:: q_{k+h} = c + \rho\, q_k + b\, u + \text{noise of variance } \sigma^2

from the prior that q stays as it is.  The residuals of h epochs in a row overlap, and count as one.
What may be commanded is the largest rate between 0 and a curve v of the rate that keeps the
prediction and some standard deviations below m.

Certainty equivalence, b as it is found, switches between all and nothing with every noise of q,
and range rates show each switch.  So the prediction has to leave room by a band below m before the
whole rate is commanded, even where b is found to be small.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .._registry import check_finite
from .base import FloatArray, SpooferContext
from .feedback import AlongCurve

UNKNOWN = (0.1, 0.3, 1.0)
"""Prior standard deviations of c, rho and b [s/m]."""
DEVIATION = 0.1
"""Standard deviation of the prediction at first."""
MEAN_OF = 50
"""Epochs over which the variance of the prediction is averaged."""
LEAST, MOST = 0.1, 2.0
"""Range of a search for the margin."""


@dataclass(kw_only=True)
class ThresholdRider(AlongCurve):
    r"""Goes as fast as the predicted statistic allows, and no faster than a curve of the rate.

    With :math:`\hat q = c + \rho q` and v the curve, the wanted rate is

    .. math:: w = v\, \mathrm{clip}\left(
        \frac{m - \hat q - \kappa \sigma}{\max(b v, \beta m)}, 0, 1\right)

    It knows the victim's statistics (oracle), and nothing of the detector.

    Parameters
    ----------
    rates_mps : tuple of float
        (n,) rate at equally spaced knots, as of a `Profile`: the fastest that it ever goes.
    heading_deg : float or "target"
        As in `ScriptedSpoofer`.
    margin : float
        m, ratio of the statistic to its threshold below which the prediction stays.
    deviations : float
        :math:`\kappa`, standard deviations of the prediction that are kept in reserve.
    horizon_s : float
        How far it looks ahead, rounded to whole commands, at least one.
    band : float
        :math:`\beta`, part of m below which the whole rate is commanded at the latest.
    """

    described_as = "ThresholdRider"
    margin: float = 1.15
    deviations: float = 0.0
    horizon_s: float = 20.0
    band: float = 0.4

    tunable: ClassVar[str | None] = "margin"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("margin", "horizon_s", "band"):
            check_finite(name, getattr(self, name), "> 0")
        check_finite("deviations", self.deviations, ">= 0")

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        many, h = context.receivers, max(round(self.horizon_s / context.interval_s), 1)
        self.memory.declare("found", np.tile([0.0, 1.0, 0.0], (many, 1)))
        self.memory.declare("covariance", np.tile(np.diag(np.square(UNKNOWN)), (many, 1, 1)))
        self.memory.declare("variance", np.full(many, DEVIATION**2))
        self.memory.declare("past", np.zeros((many, h, 2)))

    def wanted_rate(self, observation: NDArray[np.float32]) -> FloatArray:
        """(B,) largest rate that the prediction allows [m/s]."""
        memory, ratio = self.memory, self.ratio(observation)
        self._learn(ratio)
        fastest = super().wanted_rate(observation)
        c, rho, b = memory["found"].T
        expected = c + np.clip(rho, 0.0, 1.0) * ratio
        room = self.margin - expected - self.deviations * np.sqrt(memory["variance"])
        needed = np.maximum(b * np.abs(fastest), self.band * self.margin)
        return np.asarray(fastest * np.clip(room / needed, 0.0, 1.0))

    def _learn(self, ratio: FloatArray) -> None:
        """Fit the prediction of a horizon ago to (B,) the ratios of now."""
        memory, past = self.memory, self.memory["past"].copy()
        rows, h = np.arange(len(ratio)), past.shape[1]
        place = memory["step"].astype(np.int64) % h
        before, displaced = past[rows, place].T
        moved = np.abs(memory["displacement"] - displaced) / (h * self.context.interval_s)
        seen = np.stack([np.ones_like(ratio), before, moved], axis=1)
        covariance, found = memory["covariance"], memory["found"]
        spread = (covariance * seen[:, None, :]).sum(axis=2)
        residual = ratio - (found * seen).sum(axis=1)
        gain = spread / (h * memory["variance"] + (spread * seen).sum(axis=1))[:, None]
        change = (residual**2 - memory["variance"]) / MEAN_OF
        known = memory["step"] >= h
        memory["found"] = found + np.where(known[:, None], gain * residual[:, None], 0.0)
        shrunk = gain[:, :, None] * spread[:, None, :]
        memory["covariance"] = covariance - np.where(known[:, None, None], shrunk, 0.0)
        memory["variance"] = memory["variance"] + np.where(known, change, 0.0)
        past[rows, place] = np.stack([ratio, memory["displacement"]], axis=1)
        memory["past"] = past

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        return LEAST, MOST
