"""A dash: nothing for most of the window, then as fast as allowed, to be away before the alert.

It has no alarm budget in mind.  What it gains lies between the alarm and the time to alert before
it: against a detector that needs long to be sure, that is far.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .._registry import check_finite
from .base import FloatArray, ScriptedSpoofer, SpooferContext
from .ramp import Ramp


@dataclass(kw_only=True)
class Dash(ScriptedSpoofer):
    """Waits, then pushes at a rate that it reaches at the largest acceleration.

    Parameters
    ----------
    rate_mps : float
        Rate of the dash; negative against the heading, or to shorter ranges.  More than the attack
        allows is cut to that.
    last_s : float
        How long before the end of the attack window it begins, above 0 [s]; from the onset on
        where the window is shorter.
    heading_deg : float or "target"
        As in `ScriptedSpoofer`.
    """

    described_as = "Dash"
    rate_mps: float = 10.0
    last_s: float = 30.0

    tunable: ClassVar[str | None] = "rate_mps"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_finite("rate_mps", self.rate_mps)
        check_finite("last_s", self.last_s, "> 0")

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        """Rate that is wanted at the end of the coming epoch. `step`, `rate`, `displacement` (B,)
        so far; returns (B,) 0 before the dash [m/s]."""
        begins = self.context.steps - round(self.last_s / self.context.interval_s)
        return np.where(step >= begins, self.rate_mps, 0.0)

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        """As of a ramp.  Returns `low`, `high` [m/s]."""
        return Ramp.tuning_range(context)
