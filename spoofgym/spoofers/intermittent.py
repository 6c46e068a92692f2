r"""Bursts with pauses: an offset that comes and goes, so that a detector has to see ends, too.

In a burst of length :math:`t_{on}` the offset grows at the rate :math:`s / t_{on}`, a ramp, or is
set to s as quickly as the attack's limits allow, a step.  In the pause after it, it goes back to
zero as quickly as the limits allow, and stays there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .._registry import check_finite
from .base import FloatArray, ScriptedSpoofer, SpooferContext
from .step import LARGEST, SMALLEST, fastest

SHAPES = ("ramp", "step")


@dataclass(kw_only=True)
class Intermittent(ScriptedSpoofer):
    """Ramps and steps of the displacement, one after the other, with pauses between them.

    Parameters
    ----------
    shapes : tuple of {"ramp", "step"}
        Shape of each burst; after the last one it starts again with the first one.
    sizes_m : tuple of float
        Displacement at the end of each burst, as many as shapes; negative against the heading, or
        to shorter ranges.
    on_s, off_s : float
        Lengths of a burst, above 0, and of a pause, at least 0; rounded to epochs, a burst to at
        least one.
    bursts : int or None
        How many bursts there are, at least 1; None for as many as the episode has time for.
    scale : float
        Factor of all sizes.
    heading_deg : float or "target"
        As in `ScriptedSpoofer`.
    """

    described_as = "Intermittent"
    shapes: tuple[str, ...] = ("ramp",)
    sizes_m: tuple[float, ...] = (20.0,)
    on_s: float = 40.0
    off_s: float = 10.0
    bursts: int | None = None
    scale: float = 1.0

    tunable: ClassVar[str | None] = "scale"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.shapes, self.sizes_m = tuple(self.shapes), tuple(self.sizes_m)
        for shape in self.shapes:
            if shape not in SHAPES:
                raise ValueError(
                    f"`shapes` must be among {', '.join(map(repr, SHAPES))}, got {shape!r}"
                )
        if not self.shapes or len(self.shapes) != len(self.sizes_m):
            raise ValueError(
                "`shapes` and `sizes_m` must be as many, at least one, got "
                f"{len(self.shapes)} and {len(self.sizes_m)}"
            )
        for size in self.sizes_m:
            check_finite("sizes_m", size)
        for name in ("on_s", "off_s", "scale"):
            check_finite(name, getattr(self, name))
        if self.on_s <= 0.0:
            raise ValueError(f"`on_s` must be > 0, got {self.on_s}")
        if self.off_s < 0.0:
            raise ValueError(f"`off_s` must be >= 0, got {self.off_s}")
        if self.bursts is not None and self.bursts < 1:
            raise ValueError(f"`bursts` must be at least 1 or None, got {self.bursts}")

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        self._on = max(1, round(self.on_s / context.interval_s))
        self._off = round(self.off_s / context.interval_s)
        self._sizes = self.scale * np.array(self.sizes_m)
        self._is_ramp = np.array([shape == "ramp" for shape in self.shapes])

    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        """Rate that is wanted at the end of the coming epoch. `step`, `rate`, `displacement` (B,)
        so far; returns (B,) of the ramp, or the largest from which the displacement that is wanted
        is not overshot [m/s]."""
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
