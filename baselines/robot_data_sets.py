r"""The data sets of `song2021`: what is added to the fixes of a robot, and when.

A jump adds an offset that is drawn at every fix, a slow change one that grows by a drawn step,
in north and in east alike:

.. math:: \Delta^J \sim N(20, 0.1), \qquad \Delta^S_k = \Delta^S_{k-1} + N(0.5, 0.05)

in metres, the second numbers being variances.  The printed largest errors are the root of the sum
of the squares of two axes, which shows that both axes are attacked.

Source: `song2021`, eqs. 28 and 29 and section 4.2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Window = tuple[float, float]

JUMP_MEAN, JUMP_VARIANCE = 20.0, 0.1
SLOW_MEAN, SLOW_VARIANCE = 0.5, 0.05


@dataclass(frozen=True, kw_only=True)
class RobotDataSet:
    """A run of the robot, and the attacks on it. `speed_mps`: 0 for a robot at rest; `jump_s`,
    `slow_s`: start (excluded) and end (included) of the jumps and of the slow changes."""

    speed_mps: float = 0.5
    jump_s: tuple[Window, ...] = ()
    slow_s: tuple[Window, ...] = ()
    duration_s: float = 300.0

    def __post_init__(self) -> None:
        """Check that the attacks lie within the run."""
        for begin, end in (*self.jump_s, *self.slow_s):
            if not 0.0 <= begin < end <= self.duration_s:
                raise ValueError(
                    f"an attack must begin before it ends, within 0 to {self.duration_s:g} s, got "
                    f"{begin:g} to {end:g}"
                )

    def epochs(self, window: Window, interval_s: float = 1.0) -> NDArray[np.intp]:
        """Fixes that lie in a window.  `window`: start (excluded) and end (included) [s]."""
        time = (np.arange(round(self.duration_s / interval_s)) + 1.0) * interval_s
        return np.flatnonzero((time > window[0]) & (time <= window[1]))

    def mark_attacked(self, interval_s: float = 1.0) -> NDArray[np.bool_]:
        """Which fixes are attacked."""
        attacked = np.zeros(round(self.duration_s / interval_s), dtype=np.bool_)
        for window in (*self.jump_s, *self.slow_s):
            attacked[self.epochs(window, interval_s)] = True
        return attacked

    def offsets(self, rngs: Sequence[np.random.Generator], interval_s: float = 1.0) -> FloatArray:
        """Draw what is added to the fixes. `interval_s`: time between fixes; the slow change is per
        second; returns (K, B, 2) north, east [m]."""
        offsets = np.zeros((round(self.duration_s / interval_s), len(rngs), 2))
        for b, rng in enumerate(rngs):
            for window in self.jump_s:
                rows = self.epochs(window, interval_s)
                drawn = rng.standard_normal((len(rows), 2))
                offsets[rows, b] += JUMP_MEAN + math.sqrt(JUMP_VARIANCE) * drawn
            for window in self.slow_s:
                rows = self.epochs(window, interval_s)
                drawn = rng.standard_normal((len(rows), 2))
                steps = SLOW_MEAN * interval_s + math.sqrt(SLOW_VARIANCE * interval_s) * drawn
                offsets[rows, b] += np.cumsum(steps, axis=0)
        return offsets


DATA_SETS: dict[str, RobotDataSet] = {
    "psi1": RobotDataSet(speed_mps=0.0),
    "psi2": RobotDataSet(),
    "jump": RobotDataSet(jump_s=((150.0, 300.0),)),
    "slow": RobotDataSet(slow_s=((150.0, 300.0),)),
    "both": RobotDataSet(jump_s=((50.0, 100.0),), slow_s=((150.0, 200.0),)),
}
"""By name: at rest and driving without an attack, then the paper's attacked sets 2, 3 and 4."""
