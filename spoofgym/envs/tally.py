"""What a step of all receivers has brought, in two arrays with a row a quantity."""

from __future__ import annotations

from collections.abc import Sequence
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
REWARD_KEY = "reward_"
"""What the keys of the parts of the reward begin with."""
MARKS = 8
"""Rows of flags that the kernels know of."""


class Heads:
    """Keys of what is told of a step, which a `Tally` gives its rows.

    - `parts`: keys of the parts of the reward that the kernels write;
    - `told`: `VALUE_NAMES` and `parts`, then `MARK_NAMES`;
    - `masked`: the same, then all of them with ``_`` before it, for who has them;
    - `numbers`: how many of `told` are numbers;
    - `blank` ((8 + t) B,) bool, initial `Tally.flags`.
    """

    def __init__(self, receivers: int, parts: Sequence[str] = ()) -> None:
        self.told = (*VALUE_NAMES, *parts, *MARK_NAMES)
        self.masked = (*self.told, *("_" + name for name in self.told))
        self.numbers = len(VALUE_NAMES) + len(parts)
        self.receivers = receivers
        self.blank: Mask = np.ones((MARKS + len(self.told)) * receivers, dtype=np.bool_)
        self.blank[: MARKS * receivers] = False


class Tally:
    """A `Turn` whose arrays lie one after the other, new for every step.

    The kernels write the rows, and nothing is taken out of them before it is asked for: with a
    batch of one, making the arrays would cost more than the kernels do.

    - `numbers` ((k + 3) B,) `values` in one row;
    - `flags` ((8 + t) B,) bool, `marks` in one row: those that the kernels name, then, for every
      key, that all receivers have it;
    - `more`: arrays that are reported with them, by key.
    """

    def __init__(self, heads: Heads) -> None:
        self._heads = heads
        self.flags: Mask = heads.blank.copy()
        self.numbers: FloatArray = np.empty((heads.numbers + 3) * heads.receivers)
        self.more: dict[str, NDArray[Any]] = {}

    @property
    def values(self) -> FloatArray:
        """(k + 3, B) the numbers of ``heads.told``, then gain, retraction [m] and reward."""
        return self.numbers.reshape(-1, self._heads.receivers)

    @property
    def marks(self) -> Mask:
        """(8 + t, B) bool, those of `MARK_NAMES` first; the kernels name the others."""
        return self.flags.reshape(-1, self._heads.receivers)

    @property
    def reward(self) -> FloatArray:
        """(B,) reward."""
        row: FloatArray = self.values[_kernels.REWARD]
        return row

    @property
    def terminated(self) -> Mask:
        """(B,) bool, whose episode has come to its end."""
        row: Mask = self.marks[_kernels.TERMINATED]
        return row

    @property
    def truncated(self) -> Mask:
        """(B,) bool, whose episode somebody outside has ended."""
        row: Mask = self.marks[_kernels.TRUNCATED]
        return row

    @property
    def info(self) -> dict[str, NDArray[Any]]:
        """Arrays with a leading axis of receivers."""
        rows = [*self.values[: _kernels.GAIN], *self.marks[: len(MARK_NAMES)]]
        told: dict[str, NDArray[Any]] = dict(zip(self._heads.told, rows, strict=True))
        told.update(self.more)
        return told

    def masked(self) -> tuple[FloatArray, Mask, Mask, dict[str, NDArray[Any]]]:
        """Rewards, ends and information, and that every receiver has it; without `more`."""
        heads, values, marks = self._heads, list(self.values), list(self.marks)
        rows = values[: _kernels.GAIN] + marks[: len(MARK_NAMES)] + marks[MARKS:]
        return (
            values[_kernels.REWARD],
            marks[_kernels.TERMINATED],
            marks[_kernels.TRUNCATED],
            dict(zip(heads.masked, rows, strict=True)),
        )

    def alone(self) -> tuple[float, bool, bool, dict[str, Any]]:
        """Reward, ends and information of a batch of one, as plain numbers."""
        values: list[Any] = self.numbers.tolist()
        marks: list[Any] = self.flags.tolist()
        told = values[: _kernels.GAIN] + marks[: len(MARK_NAMES)]
        info: dict[str, Any] = dict(zip(self._heads.told, told))  # noqa: B905  (costs a microsecond)
        if self.more:
            info.update((name, array.item()) for name, array in self.more.items())
        return (
            values[_kernels.REWARD],
            marks[_kernels.TERMINATED],
            marks[_kernels.TRUNCATED],
            info,
        )

    def add(self, earlier: Tally, over: Mask) -> None:
        """Count the earlier epochs of the same decision; both are told.

        `over` (B,) bool, whose episode was over before this epoch, so that `earlier` is all of it.
        """
        parts = slice(len(VALUE_NAMES), self._heads.numbers)
        for row in (_kernels.GAIN, _kernels.RETRACTION, _kernels.COST, parts):
            self.values[row] = earlier.values[row] + self.values[row]
        for row in (_kernels.ALARM, _kernels.FIRST, _kernels.FINISHED):
            self.marks[row] |= earlier.marks[row]
        for name, array in self.more.items():
            before = earlier.more[name]
            both = array | before if array.dtype == np.bool_ else before + array
            self.more[name] = np.where(over, before, both)
        self.values[_kernels.REWARD] = self._sum_of_parts(parts)
        self.values[:, over] = earlier.values[:, over]
        self.marks[:, over] = earlier.marks[:, over]

    def _sum_of_parts(self, parts: slice) -> FloatArray:
        """(B,) parts of the reward, added in the order in which they are told."""
        own = [part for name, part in self.more.items() if name.startswith(REWARD_KEY)]
        reward = np.zeros(self.marks.shape[1])
        for part in (*self.values[parts], *own):
            reward += part
        return reward
