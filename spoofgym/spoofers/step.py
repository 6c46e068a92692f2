r"""A step: to a fixed displacement as quickly as the attack's limits allow, and there it stays.

Commanded by rate, it moves at the limit.  Commanded by acceleration, it accelerates and brakes at
the limit.  In epochs of length :math:`\tau`, with the limit a, a rate

.. math:: v = (m + r) \, a \tau, \qquad m = 0, 1, \dots, \quad 0 \le r < 1

is braked to zero, by m full epochs and a part of one, over at least

.. math:: b(v) = a \tau^2 \left[ (m + 1)(m + r) - \tfrac12 m (m + 1) \right] - \tfrac12 v \tau

so that the largest rate from which the rest R of the way still suffices follows from
:math:`\tfrac12 (v_0 + v) \tau + b(v) = R`, in which the braking distance is linear in v within
each m.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .._registry import check_finite
from .base import FloatArray, ScriptedSpoofer, SpooferContext

SMALLEST, LARGEST = 0.1, 1000.0
"""Range of a search [m]."""


@dataclass(kw_only=True)
class Step(ScriptedSpoofer):
    """Moves to a displacement as quickly as the attack allows, without overshoot, and holds it.

    Parameters
    ----------
    size_m : float
        Displacement; negative against the heading, or to shorter ranges.
    heading_deg : float or "target"
        As in `ScriptedSpoofer`.
    """

    described_as = "Step"
    size_m: float = 100.0

    tunable: ClassVar[str | None] = "size_m"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_finite("size_m", self.size_m)

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        """Rate that is wanted at the end of the coming epoch. `step`, `rate`, `displacement` (B,)
        so far; returns (B,) the largest from which the displacement is not overshot [m/s]."""
        interval = self.context.interval_s
        rest = self.size_m - displacement
        if self.context.control == "rate":
            return rest / interval
        side = np.sign(self.size_m)
        gain = self.context.acceleration_limit_mps2 * interval
        return np.asarray(side * fastest(side * rest, side * rate, gain, interval))

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        """From a decimetre to a kilometre.  Returns `low`, `high` [m]."""
        return SMALLEST, LARGEST


def fastest(rest: FloatArray, rate: FloatArray, gain: float, interval: float) -> FloatArray:
    """Largest rate at the end of an epoch from which the rest of a way suffices to brake. `rest`:
    way left [m]; what rounding made negative counts as 0; `rate`: rate at the start of the epoch
    [m/s], of the same shape; `gain`: largest change of the rate in an epoch [m/s]; `interval`:
    length of an epoch [s]; returns [m/s]."""
    # way beyond the first half of the present epoch, in units of a tau^2
    way = np.maximum(rest - 0.5 * rate * interval, 0.0) / (gain * interval)
    full = np.floor(0.5 * (np.sqrt(1.0 + 8.0 * way) - 1.0))
    return np.asarray(gain * (way + 0.5 * full * (full + 1.0)) / (full + 1.0))
