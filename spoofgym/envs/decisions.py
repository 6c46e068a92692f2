"""Decisions of a spoofer, and what is commanded from one to the next."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..simulation.setup import Setup

FloatArray = NDArray[np.float64]
EVERYONE = slice(None)


class Decisions:
    """The last two decisions of B receivers.

    - `setup`: says how often a decision is due, and what is commanded on the way;
    - `size`: elements of an action.
    """

    def __init__(self, setup: Setup, receivers: int, size: int) -> None:
        self.setup = setup
        self._before, self._last = np.zeros((receivers, size)), np.zeros((receivers, size))

    def due(self, epoch: Any) -> Any:
        return epoch % self.setup.repeat == 0

    def take(self, action: FloatArray, rows: Any = EVERYONE) -> None:
        self._before[rows] = self._last[rows]
        self._last[rows] = action[rows]

    def action(self, epoch: int | NDArray[np.int64]) -> FloatArray:
        """Action (B, k) of an epoch, one or (B,) of them."""
        since = np.asarray(epoch)[..., None] % self.setup.repeat
        return self.setup.command(self._before, self._last, since)

    def forget(self, rows: Any) -> None:
        """Start new episodes of some receivers: nothing has been commanded yet."""
        self._before[rows] = self._last[rows] = 0.0

    def of(self, rows: NDArray[np.intp]) -> Decisions:
        part = Decisions(self.setup, len(rows), self._last.shape[1])
        part._before, part._last = self._before[rows], self._last[rows]
        return part
