"""Constant rate: the classic slow drift, which a filter gets used to while it is slow enough."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .._registry import check_finite
from .base import FloatArray, ScriptedSpoofer, SpooferContext, check_limit

SLOWEST = 1e-3
"""Slowest rate of a search, as a part of the attack's limit."""


@dataclass(kw_only=True)
class Ramp(ScriptedSpoofer):
    """Pushes at a constant rate, reached at the largest acceleration that the attack allows.

    Parameters
    ----------
    rate_mps : float
        Rate; negative against the heading, or to shorter ranges.
    heading_deg : float or "target"
        As in `ScriptedSpoofer`.
    """

    described_as = "Ramp"
    rate_mps: float = 0.5

    tunable: ClassVar[str | None] = "rate_mps"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_finite("rate_mps", self.rate_mps)

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        check_limit(self, "rate_mps", *context.largest_rate)

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        """Rate that is wanted at the end of the coming epoch. `step`, `rate`, `displacement` (B,)
        so far; returns (B,) the constant rate [m/s]."""
        return np.full_like(rate, self.rate_mps)

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        """Up to the limit of the rate, or what the episode allows to reach. Returns `low`, `high`
        [m/s]."""
        _, high = context.largest_rate
        if context.control != "rate":
            reached = context.acceleration_limit_mps2 * context.steps * context.interval_s
            high = min(high, reached)
        return SLOWEST * high, high
