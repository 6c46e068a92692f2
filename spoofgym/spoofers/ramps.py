r"""None, step, ramp, accelerating ramp, dash, intermittent.

A step accelerates and brakes at the attack's limit a.  In epochs of length :math:`\tau` a rate

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
from numpy.typing import NDArray

from ..core.declared import check_word, setting, settings_record
from .base import FloatArray, ScriptedSpoofer, Spoofer, SpooferContext, check_limit

SLOWEST = 1e-3  # slowest rate of a search, as a part of the attack's limit


@settings_record(kw_only=True)
class Ramp(ScriptedSpoofer):
    """Pushes at a constant rate, reached at the largest acceleration that the attack allows."""

    rate_mps: float = setting(
        default=0.5, unit="m/s", help="Rate; negative against the heading, or to shorter ranges."
    )

    tunable: ClassVar[str | None] = "rate_mps"

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        check_limit(self, "rate_mps", *context.largest_rate)

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        return np.full_like(rate, self.rate_mps)

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        """Up to the limit of the rate, or what the episode allows to reach [m/s]."""
        _, high = context.largest_rate
        if context.control != "rate":
            reached = context.acceleration_limit_mps2 * context.steps * context.interval_s
            high = min(high, reached)
        return SLOWEST * high, high


@settings_record(kw_only=True)
class AcceleratingRamp(ScriptedSpoofer):
    """Pushes ever faster, until the attack's limit of the rate."""

    acceleration_mps2: float = setting(
        default=0.005,
        unit="m/s^2",
        help="Acceleration; negative against the heading, or to shorter ranges.",
    )

    tunable: ClassVar[str | None] = "acceleration_mps2"

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        if context.control != "rate":
            limit = context.acceleration_limit_mps2
            check_limit(self, "acceleration_mps2", "acceleration_limit_mps2", limit)

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        return rate + self.acceleration_mps2 * self.context.interval_s

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        """Up to the limit of the acceleration; by rate, to its limit within ten epochs."""
        high = context.acceleration_limit_mps2
        if context.control == "rate":
            high = context.rate_limit_mps / (10.0 * context.interval_s)
        return SLOWEST * high, high


SMALLEST, LARGEST = 0.1, 1000.0  # range of a search [m]


@settings_record(kw_only=True)
class Step(ScriptedSpoofer):
    """Moves to a displacement as quickly as the attack allows, without overshoot, and holds it."""

    size_m: float = setting(
        default=100.0,
        unit="m",
        help="Displacement; negative against the heading, or to shorter ranges.",
    )

    tunable: ClassVar[str | None] = "size_m"

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        """The largest rate from which the displacement is not overshot."""
        interval = self.context.interval_s
        rest = self.size_m - displacement
        if self.context.control == "rate":
            return rest / interval
        side = np.sign(self.size_m)
        gain = self.context.acceleration_limit_mps2 * interval
        return np.asarray(side * fastest(side * rest, side * rate, gain, interval))

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        return SMALLEST, LARGEST


def fastest(rest: FloatArray, rate: FloatArray, gain: float, interval: float) -> FloatArray:
    """Largest rate at the end of an epoch from which the rest of a way suffices to brake [m/s], by
    the way left [m], below 0 by rounding counts as 0; the rate at the start [m/s]; gain, the
    largest change of the rate in an epoch [m/s]; and interval, its length [s]."""
    # way beyond the first half of the present epoch, in units of a tau^2
    way = np.maximum(rest - 0.5 * rate * interval, 0.0) / (gain * interval)
    full = np.floor(0.5 * (np.sqrt(1.0 + 8.0 * way) - 1.0))
    return np.asarray(gain * (way + 0.5 * full * (full + 1.0)) / (full + 1.0))


@settings_record(kw_only=True)
class Dash(ScriptedSpoofer):
    """Waits, then pushes at a rate that it reaches at the largest acceleration."""

    rate_mps: float = setting(
        default=10.0,
        unit="m/s",
        help="Rate of the dash; negative against the heading, or to shorter ranges.  More than the "
        "attack allows is cut to that.",
    )
    last_s: float = setting(
        default=30.0,
        above=0.0,
        unit="s",
        help="How long before the end of the attack window it begins; from the onset on where the "
        "window is shorter.",
    )

    tunable: ClassVar[str | None] = "rate_mps"

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        begins = self.context.steps - round(self.last_s / self.context.interval_s)
        return np.where(step >= begins, self.rate_mps, 0.0)

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        return Ramp.tuning_range(context)


SHAPES = ("ramp", "step")


@settings_record(kw_only=True)
class Intermittent(ScriptedSpoofer):
    """Ramps and steps of the displacement, one after the other, with pauses between them."""

    shapes: tuple[str, ...] = setting(
        default=("ramp",),
        help='Shape of each burst, ``"ramp"`` or ``"step"``; after the last one it starts again '
        "with the first one.",
    )
    sizes_m: tuple[float, ...] = setting(
        default=(20.0,),
        unit="m",
        help="Displacement at the end of each burst, as many as shapes; negative against the "
        "heading, or to shorter ranges.",
    )
    on_s: float = setting(
        default=40.0,
        above=0.0,
        unit="s",
        help="Length of a burst; rounded to epochs, to at least one.",
    )
    off_s: float = setting(
        default=10.0, least=0.0, unit="s", help="Length of a pause; rounded to epochs."
    )
    bursts: int | None = setting(
        default=None,
        least=1,
        help="How many bursts there are; None for as many as the episode has time for.",
    )
    scale: float = setting(default=1.0, help="Factor of all sizes.")

    tunable: ClassVar[str | None] = "scale"

    def __post_init__(self) -> None:
        self.shapes, self.sizes_m = tuple(self.shapes), tuple(self.sizes_m)
        for shape in self.shapes:
            check_word("shapes", shape, SHAPES)
        if not self.shapes or len(self.shapes) != len(self.sizes_m):
            raise ValueError(
                "`shapes` and `sizes_m` must be as many, at least one, got "
                f"{len(self.shapes)} and {len(self.sizes_m)}"
            )

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        self._on = max(1, round(self.on_s / context.interval_s))
        self._off = round(self.off_s / context.interval_s)
        self._sizes = self.scale * np.array(self.sizes_m)
        self._is_ramp = np.array([shape == "ramp" for shape in self.shapes])

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        burst, place = np.divmod(step.astype(np.int64), self._on + self._off)
        is_on = place < self._on
        if self.bursts is not None:
            is_on &= burst < self.bursts
        number = burst % len(self._sizes)
        wanted = np.where(is_on, self._sizes[number], 0.0)
        slope = self._sizes[number] / (self._on * self.context.interval_s)
        toward = self._toward(wanted, rate, displacement)
        return np.where(is_on & self._is_ramp[number], slope, toward)

    def _toward(self, wanted: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        interval = self.context.interval_s
        rest = wanted - displacement
        if self.context.control == "rate":
            return rest / interval
        side = np.where(rest == 0.0, -np.sign(rate), np.sign(rest))
        gain = self.context.acceleration_limit_mps2 * interval
        return np.asarray(side * fastest(side * rest, side * rate, gain, interval))

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        """Sizes from a decimetre to a kilometre, of a burst of 20 m."""
        usual = max(map(abs, cls.sizes_m))
        return SMALLEST / usual, LARGEST / usual


@dataclass
class NoSpoofer(Spoofer):
    """Commands zero; a benchmark leaves the measurements of its runs authentic."""

    knowledge = "blind"
    transmits = False

    def act(self, observation: NDArray[np.float32]) -> FloatArray:
        return np.zeros((self.context.receivers, len(self.context.action_names)))
