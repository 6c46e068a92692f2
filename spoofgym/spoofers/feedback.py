r"""Feedback spoofer and threshold rider.

Threshold rider: the largest rate that keeps the predicted statistic below its threshold.

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

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.declared import setting, settings_record
from .base import FloatArray, ScriptedSpoofer, SpooferContext, check_limit
from .profile import check_fastest, check_knots, sample_curve
from .ramps import Ramp

RATIO = "statistic_ratio"
"""Element of an observation that is the largest statistic over its threshold."""


@settings_record(kw_only=True)
class ByStatistic(ScriptedSpoofer):
    """Base of spoofers that see the detector's statistic, and nothing else of the victim."""

    knowledge = "oracle"

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        if RATIO not in context.observation_names:
            raise ValueError(
                f"{type(self).__name__} needs {RATIO} among the observations: add it by the "
                "knowledge 'oracle', or by the observation term {'name': 'statistic-ratio', "
                "'largest': True}"
            )
        self._column = context.observation_names.index(RATIO)

    def ratio(self, observation: NDArray[np.float32]) -> FloatArray:
        return observation[:, self._column].astype(np.float64)


@settings_record(kw_only=True)
class AlongCurve(ByStatistic):
    """Base of those that have a curve of the rate for what they would do unseen."""

    rates_mps: tuple[float, ...] = setting(
        default=(0.24, 0.9),
        unit="m/s",
        help="Rate (n,) at equally spaced knots, as of a `Profile`: the fastest that it ever goes.",
    )

    def __post_init__(self) -> None:
        check_knots("rates_mps", self.rates_mps)

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        check_fastest("`rates_mps`", np.abs(self.rates_mps).max(), *context.largest_rate)
        self._curve = sample_curve(self.rates_mps, context.steps)

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        return np.asarray(self._curve[np.minimum(step.astype(np.int64), len(self._curve) - 1)])


@settings_record(kw_only=True)
class HeldBack(ByStatistic):
    r"""Base of those that multiply a rate by the room that the statistic leaves.

    With v the rate of `next_rate` and q the largest statistic over its threshold at the last epoch,
    the wanted rate is

    .. math:: w = v \, \mathrm{clip}\left(\frac{m_1 - q}{m_1 - m_0}, \beta, 1\right)

    and the rate follows within the attack's limits.
    """

    full_ratio: float = setting(
        default=0.47, least=0.0, help="Ratio :math:`m_0` up to which nothing is held back."
    )
    zero_ratio: float = setting(
        default=1.03,
        above=0.0,
        help="Ratio :math:`m_1` at which the wanted rate is 0; above `full_ratio`.",
    )
    back: float = setting(
        default=-0.79,
        least=-1.0,
        most=0.0,
        help=r"Least factor on the rate v, :math:`\beta`; below 0 the spoofer moves back.",
    )

    def __post_init__(self) -> None:
        if self.zero_ratio <= self.full_ratio:
            raise ValueError(
                f"`zero_ratio` must be above `full_ratio` = {self.full_ratio:g}, got "
                f"{self.zero_ratio:g}"
            )

    def wanted_rate(self, observation: NDArray[np.float32]) -> FloatArray:
        room = (self.zero_ratio - self.ratio(observation)) / (self.zero_ratio - self.full_ratio)
        return super().wanted_rate(observation) * np.clip(room, self.back, 1.0)


@settings_record(kw_only=True)
class Feedback(HeldBack):
    r"""Pushes at a rate that grows with time, the slower the nearer the alarm.

    With t the time since the onset and T the length of the attack window, the rate that `HeldBack`
    then reduces is

    .. math:: v = a \left(1 + (g - 1) \frac tT\right)
    """

    rate_mps: float = setting(
        default=0.24,
        unit="m/s",
        help="Rate a at the onset, if nothing holds it back; negative: against the heading.",
    )
    growth: float = setting(
        default=3.75, least=0.0, help="How many times as fast it is at the end of the window, g."
    )

    tunable: ClassVar[str | None] = "rate_mps"

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        check_limit(self, "rate_mps", *context.largest_rate)

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        part = np.minimum(step / self.context.steps, 1.0)
        return np.asarray(self.rate_mps * (1.0 + (self.growth - 1.0) * part))

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        return Ramp.tuning_range(context)


@settings_record(kw_only=True)
class FeedbackProfile(HeldBack, AlongCurve):
    """Pushes along a curve, as of an open-loop attack, as far as the statistic leaves room.

    With `full_ratio` 1 it plays the curve as it is up to the first alarm, which is all that counts:
    fitted, it is no worse than the curve.
    """

    def __post_init__(self) -> None:
        HeldBack.__post_init__(self)
        AlongCurve.__post_init__(self)


UNKNOWN = (0.1, 0.3, 1.0)  # prior standard deviations of c, rho and b [s/m]
DEVIATION = 0.1  # standard deviation of the prediction at first
MEAN_OF = 50  # epochs over which the variance of the prediction is averaged
LEAST, MOST = 0.1, 2.0  # range of a search for the margin


@settings_record(kw_only=True)
class ThresholdRider(AlongCurve):
    r"""Goes as fast as the predicted statistic allows, and no faster than a curve of the rate.

    With :math:`\hat q = c + \rho q` and v the curve, the wanted rate is

    .. math:: w = v\, \mathrm{clip}\left(
        \frac{m - \hat q - \kappa \sigma}{\max(b v, \beta m)}, 0, 1\right)

    It knows the victim's statistics (oracle), and nothing of the detector.
    """

    margin: float = setting(
        default=1.15,
        above=0.0,
        help="Ratio m of the statistic to its threshold below which the prediction stays.",
    )
    deviations: float = setting(
        default=0.0,
        least=0.0,
        help=r"Standard deviations of the prediction held in reserve, :math:`\kappa`.",
    )
    horizon_s: float = setting(
        default=20.0,
        above=0.0,
        unit="s",
        help="How far it looks ahead, rounded to whole commands, at least one.",
    )
    band: float = setting(
        default=0.4,
        above=0.0,
        help=r"Room that always suffices for the whole rate, unless b v is larger, as a part "
        r":math:`\beta` of m.",
    )

    tunable: ClassVar[str | None] = "margin"

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        many, h = context.receivers, max(round(self.horizon_s / context.interval_s), 1)
        self.memory.declare("found", np.tile([0.0, 1.0, 0.0], (many, 1)))
        self.memory.declare("covariance", np.tile(np.diag(np.square(UNKNOWN)), (many, 1, 1)))
        self.memory.declare("variance", np.full(many, DEVIATION**2))
        self.memory.declare("past", np.zeros((many, h, 2)))

    def wanted_rate(self, observation: NDArray[np.float32]) -> FloatArray:
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
