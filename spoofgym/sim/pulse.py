"""A pulse: a rate that rises, holds and falls without steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Pulse:
    """A rate that rises, holds and falls, with raised-cosine edges. `ramp`: duration of each edge
    [s]; `hold`: duration between them [s]."""

    described_as = "Pulse"
    peak: float
    ramp: float
    hold: float

    @classmethod
    def of_area(cls, area: float, peak: float, ramp: float) -> Pulse:
        """Pulse of a given integral; its peak is lowered when the edges alone are too much. `ramp`:
        duration of each edge [s]."""
        hold = max(0.0, abs(area) / peak - ramp)
        return cls(area / (ramp + hold), ramp, hold)

    @classmethod
    def idle(cls, duration: float) -> Pulse:
        """No rate at all for a duration [s]."""
        return cls(0.0, 0.0, duration)

    @property
    def duration(self) -> float:
        """Time from the beginning to the end [s]."""
        return 2.0 * self.ramp + self.hold

    def rate(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rate at times since the beginning [s]; 0 before and after."""
        inside = np.clip(np.minimum(time, self.duration - time), 0.0, self.ramp)
        return self.peak * 0.5 * (1.0 - np.cos(np.pi * inside / self.ramp))

    def total(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Integral of the rate up to times since the beginning [s]."""
        return self.peak * (self._edge(time) - self._edge(time - self.ramp - self.hold))

    def _edge(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Integral of a rise from 0 to 1 that stays there."""
        inside = np.clip(time, 0.0, self.ramp)
        swing = self.ramp / (2.0 * np.pi) * np.sin(np.pi * inside / self.ramp)
        return 0.5 * inside - swing + np.maximum(time - self.ramp, 0.0)
