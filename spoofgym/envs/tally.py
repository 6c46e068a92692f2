"""What a step of all receivers has brought, in two arrays with a row a quantity."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _kernels

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]
VALUE_NAMES = ("time_s", "displacement_m", "undetected_displacement_m", "cost")
"""Numbers that are told of every step, in the order of the rows."""
MARK_NAMES = ("alarm", "detected", "warmup_alarm", "coasting")
"""Flags that are told of every step, in the order of the rows."""


class Tally:
    """A `Turn` whose arrays lie one after the other, new for every step.

    The kernels write the rows, and nothing is taken out of them before it is asked for: with a
    batch of one, making the arrays would cost more than the kernels do.

    Parameters
    ----------
    receivers : int
        B.
    names : sequence of str
        `VALUE_NAMES`, and the keys of the parts of the reward that the kernels write.

    Attributes
    ----------
    values : ndarray
        (k + 3, B) numbers of `names`, then gain, retraction [m] and reward.
    marks : ndarray
        (8, B) bool, `MARK_NAMES`, then first alarm, last command, terminated and truncated.
    more : dict
        Arrays that are told beside them, by key.
    """

    def __init__(self, receivers: int, names: Sequence[str]) -> None:
        self._names = names
        self.values: FloatArray = np.empty((len(names) + 3, receivers))
        self.marks: Mask = np.zeros((8, receivers), dtype=np.bool_)
        self.more: dict[str, NDArray[Any]] = {}

    @cached_property
    def reward(self) -> FloatArray:
        """(B,) reward."""
        row: FloatArray = self.values[_kernels.REWARD]
        return row

    @cached_property
    def terminated(self) -> Mask:
        """(B,) bool, whose episode has come to its end."""
        row: Mask = self.marks[_kernels.TERMINATED]
        return row

    @cached_property
    def truncated(self) -> Mask:
        """(B,) bool, whose episode somebody outside has ended."""
        row: Mask = self.marks[_kernels.TRUNCATED]
        return row

    @cached_property
    def info(self) -> dict[str, NDArray[Any]]:
        """Arrays with a leading axis of receivers."""
        told: dict[str, NDArray[Any]] = dict(zip(self._names, self.values, strict=False))
        told.update(zip(MARK_NAMES, self.marks, strict=False))
        told.update(self.more)
        return told

    def alone(self) -> tuple[float, bool, bool, dict[str, Any]]:
        """Reward, ends and information of a batch of one, as plain numbers.

        Returns
        -------
        reward : float
            Of the only receiver.
        terminated, truncated : bool
            Whether its episode is over.
        info : dict
            By key.
        """
        values: list[float] = self.values.ravel().tolist()
        marks: list[bool] = self.marks.ravel().tolist()
        info: dict[str, Any] = dict(zip(self._names, values, strict=False))
        info.update(zip(MARK_NAMES, marks, strict=False))
        for name, array in self.more.items():
            info[name] = array.item()
        return (
            values[_kernels.REWARD],
            marks[_kernels.TERMINATED],
            marks[_kernels.TRUNCATED],
            info,
        )

    def add(self, earlier: Tally) -> None:
        """Count an earlier epoch of the same decision.

        Parameters
        ----------
        earlier : Tally
            An episode that was truncated then is not terminated now.
        """
        for row in (_kernels.GAIN, _kernels.RETRACTION):
            self.values[row] = earlier.values[row] + self.values[row]
        self.marks[_kernels.TERMINATED] &= ~earlier.marks[_kernels.TRUNCATED]
        for row in (
            _kernels.ALARM,
            _kernels.FIRST,
            _kernels.FINISHED,
            _kernels.TERMINATED,
            _kernels.TRUNCATED,
        ):
            self.marks[row] |= earlier.marks[row]
        for name, array in self.more.items():
            array |= earlier.more[name]
