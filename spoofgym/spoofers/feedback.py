"""Feedback: faster while the detector is calm, slower and back when its statistic rises."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .._registry import check_finite
from .base import FloatArray, ScriptedSpoofer, SpooferContext, check_limit
from .profile import check_fastest, checked_rates, sampled
from .ramp import Ramp

RATIO = "statistic_ratio"
"""Element of an observation that is the largest statistic over its threshold."""


@dataclass(kw_only=True)
class ByStatistic(ScriptedSpoofer):
    """Base of spoofers that see the detector's statistic, and nothing else of the victim.
    `heading_deg`: as in `ScriptedSpoofer`."""

    knowledge = "oracle"

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        if RATIO not in context.observation_names:
            raise ValueError(
                f"{type(self).__name__} needs {RATIO} among the observations: it is there with the "
                "knowledge 'oracle', and with the observation term {'name': 'statistic-ratio', "
                "'largest': True}"
            )
        self._column = context.observation_names.index(RATIO)

    def ratio(self, observation: NDArray[np.float32]) -> FloatArray:
        """(B,) largest statistic over its threshold at the last epoch."""
        return observation[:, self._column].astype(np.float64)


@dataclass(kw_only=True)
class AlongCurve(ByStatistic):
    """Base of those that have a curve of the rate for what they would do unseen. `rates_mps`: (n,)
    rate at equally spaced knots, as of a `Profile`; `heading_deg`: as in `ScriptedSpoofer`."""

    rates_mps: tuple[float, ...] = (0.24, 0.9)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.rates_mps = checked_rates("rates_mps", self.rates_mps)

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        check_fastest("`rates_mps`", np.abs(self.rates_mps).max(), *context.largest_rate)
        self._curve = sampled(self.rates_mps, context.steps)

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        """Rate of the curve at the end of the coming epoch. `step`, `rate`, `displacement` (B,) so
        far; returns (B,) [m/s]."""
        return np.asarray(self._curve[np.minimum(step.astype(np.int64), len(self._curve) - 1)])


@dataclass(kw_only=True)
class HeldBack(ByStatistic):
    r"""Base of those that multiply a rate by the room that the statistic leaves.

    With v the rate of `next_rate` and q the largest statistic over its threshold at the last epoch,
    the wanted rate is

    .. math:: w = v \, \mathrm{clip}\left(\frac{m_1 - q}{m_1 - m_0}, \beta, 1\right)

    and the rate follows within the attack's limits.

    Parameters
    ----------
    full_ratio, zero_ratio : float
        :math:`m_0` up to which nothing is held back, and :math:`m_1` at which the wanted rate is 0;
        the second one is above the first.
    back : float
        :math:`\beta`, how fast it goes back at most, in parts of the rate forward; -1 to 0.
    heading_deg : float or "target"
        As in `ScriptedSpoofer`.
    """

    full_ratio: float = 0.47
    zero_ratio: float = 1.03
    back: float = -0.79

    def __post_init__(self) -> None:
        super().__post_init__()
        check_finite("full_ratio", self.full_ratio, ">= 0")
        check_finite("zero_ratio", self.zero_ratio, "> 0")
        check_finite("back", self.back)
        if self.zero_ratio <= self.full_ratio:
            raise ValueError(
                f"`zero_ratio` must be above `full_ratio` = {self.full_ratio:g}, got "
                f"{self.zero_ratio:g}"
            )
        if not -1.0 <= self.back <= 0.0:
            raise ValueError(f"`back` must be in [-1, 0], got {self.back:g}")

    def wanted_rate(self, observation: NDArray[np.float32]) -> FloatArray:
        """(B,) rate that is wanted, by the room that the statistic leaves [m/s]."""
        room = (self.zero_ratio - self.ratio(observation)) / (self.zero_ratio - self.full_ratio)
        return super().wanted_rate(observation) * np.clip(room, self.back, 1.0)


@dataclass(kw_only=True)
class Feedback(HeldBack):
    r"""Pushes at a rate that grows with time, as far as the detector's statistic leaves room.

    With t the time since the onset and T the length of the attack window, the rate of which
    `HeldBack` leaves a part is

    .. math:: v = a \left(1 + (g - 1) \frac tT\right)

    Parameters
    ----------
    rate_mps : float
        a, rate at the onset while there is room; negative against the heading.
    growth : float
        g, how many times as fast it is at the end of the window, at least 0.
    full_ratio, zero_ratio, back : float
        As in `HeldBack`.
    heading_deg : float or "target"
        As in `ScriptedSpoofer`.
    """

    described_as = "Feedback"
    rate_mps: float = 0.24
    growth: float = 3.75

    tunable: ClassVar[str | None] = "rate_mps"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_finite("rate_mps", self.rate_mps)
        check_finite("growth", self.growth, ">= 0")

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        check_limit(self, "rate_mps", *context.largest_rate)

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        """Rate that is wanted at the end of the coming epoch while there is room. `step`, `rate`,
        `displacement` (B,) so far; returns (B,) [m/s]."""
        part = np.minimum(step / self.context.steps, 1.0)
        return np.asarray(self.rate_mps * (1.0 + (self.growth - 1.0) * part))

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        """As of a `Ramp`.  Returns `low`, `high` [m/s]."""
        return Ramp.tuning_range(context)


@dataclass(kw_only=True)
class FeedbackProfile(HeldBack, AlongCurve):
    """Pushes along a curve of the rate, as of a blind optimum, as far as the statistic leaves room.

    With `full_ratio` 1 it plays the curve as it is up to the first alarm, which is all that counts:
    fitted, it is no worse than the curve.

    Parameters
    ----------
    rates_mps : tuple of float
        (n,) rate at equally spaced knots, as of a `Profile`, of which `HeldBack` leaves a part.
    full_ratio, zero_ratio, back : float
        As in `HeldBack`.
    heading_deg : float or "target"
        As in `ScriptedSpoofer`.
    """

    described_as = "FeedbackProfile"
