"""Constant acceleration: slow at first, when the filter is most alert, and fast at the end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from .._registry import check_finite
from .base import FloatArray, ScriptedSpoofer, SpooferContext, check_limit

SLOWEST = 1e-3
"""Smallest acceleration of a search, as a part of the largest."""


@dataclass(kw_only=True)
class AcceleratingRamp(ScriptedSpoofer):
    """Pushes ever faster, until the attack's limit of the rate.

    Parameters
    ----------
    acceleration_mps2 : float
        Acceleration; negative against the heading, or to shorter ranges.
    heading_deg : float or "target"
        As in `ScriptedSpoofer`.
    """

    described_as = "AcceleratingRamp"
    acceleration_mps2: float = 0.005

    tunable: ClassVar[str | None] = "acceleration_mps2"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_finite("acceleration_mps2", self.acceleration_mps2)

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        if context.control != "rate":
            limit = context.acceleration_limit_mps2
            check_limit(self, "acceleration_mps2", "acceleration_limit_mps2", limit)

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        """Rate that is wanted at the end of the coming epoch. `step`, `rate`, `displacement` (B,)
        so far; returns (B,) the rate so far, and what an epoch's acceleration adds [m/s]."""
        return rate + self.acceleration_mps2 * self.context.interval_s

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        """Up to the limit of the acceleration; by rate, to its limit within ten epochs. Returns
        `low`, `high` [m/s^2]."""
        high = context.acceleration_limit_mps2
        if context.control == "rate":
            high = context.rate_limit_mps / (10.0 * context.interval_s)
        return SLOWEST * high, high
