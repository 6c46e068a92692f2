"""What counts of the running duels: as `Books`, with the time to alert epoch by epoch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Ledger:
    """Displacement that nobody noticed in time; the rules stand in `Game`.

    The time to alert after the last command is part of the episode here, since the detector agent
    has to be asked in it.

    - `steps`, `hold`: commands of an episode, and epochs of the time to alert;
    - `step_count` (B,) epochs since the onset;
    - `detected` (B,) bool, whether there has been an alarm since the onset;
    - `credited` (B,) undetected displacement so far [m].
    """

    def __init__(self, receivers: int, steps: int, hold: int) -> None:
        self.steps, self.hold = steps, hold
        self.step_count = np.zeros(receivers, dtype=np.int64)
        self.detected = np.zeros(receivers, dtype=np.bool_)
        self.credited = np.zeros(receivers)
        self._largest = np.zeros((receivers, steps + 1))
        self._rows = np.arange(receivers)

    def reset(self, rows: NDArray[np.intp]) -> None:
        """Begin new episodes."""
        self.step_count[rows] = 0
        self.detected[rows] = False
        self.credited[rows] = 0.0
        self._largest[rows] = 0.0

    @property
    def holding(self) -> NDArray[np.bool_]:
        """(B,) bool, whether all commands have been given."""
        return self.step_count >= self.steps

    def count(
        self, displacement: FloatArray, alarm: NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
        """Count one epoch of every receiver.

        `displacement` (B,) error along the target direction, less that at the onset [m]; returns
        `gain`, `retraction` (B,) as in `Outcome` [m]; `first`, `finished` (B,) bool, the first
        alarm; the last epoch.
        """
        rows, commanded = self._rows, ~self.holding
        self.step_count += 1
        j = np.minimum(self.step_count, self.steps)
        before = self._largest[rows, np.where(commanded, j - 1, j)]
        now = np.where(commanded, np.maximum(before, displacement), before)
        self._largest[rows, j] = now
        first = alarm & ~self.detected
        self.detected |= alarm
        gain = np.where(self.detected, 0.0, now - before)
        kept = np.clip(self.step_count - self.hold - 1, 0, self.steps)
        retraction = np.where(first, self._largest[rows, kept] - before, 0.0)
        self.credited += gain
        self.credited += retraction
        return gain, retraction, first, self.step_count >= self.steps + self.hold
