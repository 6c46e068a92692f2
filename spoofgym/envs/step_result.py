"""What a step of all receivers has brought, in two arrays with a row a quantity."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import _kernels

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]
Info = dict[str, NDArray[Any]]
VALUE_NAMES = ("time_s", "displacement_m", "undetected_displacement_m", "cost")
"""Numbers in the information of every step, in the order of the rows."""
MARK_NAMES = ("alarm", "detected", "warmup_alarm", "coasting")
"""Flags in the information of every step, in the order of the rows."""
REWARD_KEY = "reward_"
"""Prefix of the keys of the parts of the reward."""
MARKS = 8
"""Rows of flags that the kernels know of."""


class InfoLayout:
    """Keys of the information of a step, one for each row of a `StepResult`.

    - `names`: `VALUE_NAMES` and the parts of the reward that kernels write, then `MARK_NAMES`;
    - `masked`: the same, then all of them with ``_`` before it, for the masks of a vector env;
    - `numbers`: how many of `names` are numbers;
    - `blank` ((8 + t) B,) bool, initial `StepResult.flags`.
    """

    def __init__(self, receivers: int, parts: Sequence[str] = ()) -> None:
        self.names = (*VALUE_NAMES, *parts, *MARK_NAMES)
        self.masked = (*self.names, *("_" + name for name in self.names))
        self.numbers = len(VALUE_NAMES) + len(parts)
        self.receivers = receivers
        self.blank: Mask = np.ones((MARKS + len(self.names)) * receivers, dtype=np.bool_)
        self.blank[: MARKS * receivers] = False


class PlainResult(NamedTuple):
    """Rewards and ends (B,), and information by key, of a step; `extra` is None."""

    reward: FloatArray
    terminated: Mask
    truncated: Mask
    info: Info
    extra: None = None

    def single(self) -> tuple[float, bool, bool, dict[str, Any]]:
        info = {name: array.item() for name, array in self.info.items()}
        return self.reward.item(), self.terminated.item(), self.truncated.item(), info


class StepResult:
    """Rewards, ends and information of a step, in arrays that are new for every step.

    The kernels write the rows, and nothing is taken out of them before it is asked for: with a
    batch of one, making the arrays would cost more than the kernels do.

    - `numbers` ((k + 3) B,) `values` in one row;
    - `flags` ((8 + t) B,) bool, `marks` in one row: those that the kernels name, then, for every
      key, that all receivers have it;
    - `displacement` (B,) row of `values`;
    - `extra`: information that kernels do not write, by key.
    """

    def __init__(self, layout: InfoLayout) -> None:
        self._layout = layout
        self.flags: Mask = layout.blank.copy()
        self.numbers: FloatArray = np.empty((layout.numbers + 3) * layout.receivers)
        self.extra: Info = {}
        b = layout.receivers
        self.displacement = self.numbers[
            _kernels.DISPLACEMENT * b : (_kernels.DISPLACEMENT + 1) * b
        ]

    def __reduce__(self) -> tuple[type[StepResult], tuple[InfoLayout]]:
        """A copy is blank: its rows are views of its own arrays."""
        return StepResult, (self._layout,)

    @property
    def values(self) -> FloatArray:
        """(k + 3, B) the numbers of the layout's names, then gain, retraction [m] and reward."""
        return self.numbers.reshape(-1, self._layout.receivers)

    @property
    def marks(self) -> Mask:
        """(8 + t, B) bool, those of `MARK_NAMES` first; the kernels name the others."""
        return self.flags.reshape(-1, self._layout.receivers)

    @property
    def reward(self) -> FloatArray:
        row: FloatArray = self.values[_kernels.REWARD]
        return row

    @property
    def terminated(self) -> Mask:
        """(B,) bool, whose episode has come to its end."""
        row: Mask = self.marks[_kernels.TERMINATED]
        return row

    @property
    def truncated(self) -> Mask:
        """(B,) bool, whose episode a limit from outside has ended."""
        row: Mask = self.marks[_kernels.TRUNCATED]
        return row

    @property
    def info(self) -> Info:
        rows = [*self.values[: _kernels.GAIN], *self.marks[: len(MARK_NAMES)]]
        info: Info = dict(zip(self._layout.names, rows, strict=True))
        info.update(self.extra)
        return info

    def masked(self) -> tuple[FloatArray, Mask, Mask, Info]:
        """Rewards, ends and information, with masks that every receiver has it; no `extra`."""
        layout, values, marks = self._layout, list(self.values), list(self.marks)
        rows = values[: _kernels.GAIN] + marks[: len(MARK_NAMES)] + marks[MARKS:]
        return (
            values[_kernels.REWARD],
            marks[_kernels.TERMINATED],
            marks[_kernels.TRUNCATED],
            dict(zip(layout.masked, rows, strict=True)),
        )

    def single(self) -> tuple[float, bool, bool, dict[str, Any]]:
        """Reward, ends and information of a batch of one, as plain numbers."""
        values: list[Any] = self.numbers.tolist()
        marks: list[Any] = self.flags.tolist()
        row = values[: _kernels.GAIN] + marks[: len(MARK_NAMES)]
        info: dict[str, Any] = dict(zip(self._layout.names, row))  # noqa: B905  (costs 1 us)
        if self.extra:
            info.update([(name, array.item()) for name, array in self.extra.items()])
        return (
            values[_kernels.REWARD],
            marks[_kernels.TERMINATED],
            marks[_kernels.TRUNCATED],
            info,
        )

    def add(self, earlier: StepResult, over: Mask) -> None:
        """Count the earlier epochs of the same decision; all there is of (B,) episodes `over`."""
        parts = slice(len(VALUE_NAMES), self._layout.numbers)
        for row in (_kernels.GAIN, _kernels.RETRACTION, _kernels.COST, parts):
            self.values[row] = earlier.values[row] + self.values[row]
        for row in (_kernels.ALARM, _kernels.FIRST, _kernels.FINISHED):
            self.marks[row] |= earlier.marks[row]
        for name, array in self.extra.items():
            before = earlier.extra[name]
            both = array | before if array.dtype == np.bool_ else before + array
            self.extra[name] = np.where(over, before, both)
        self.values[_kernels.REWARD] = self._sum_of_parts(parts)
        self.values[:, over] = earlier.values[:, over]
        self.marks[:, over] = earlier.marks[:, over]

    def _sum_of_parts(self, parts: slice) -> FloatArray:
        """(B,) parts of the reward, added in the order of the information."""
        own = [part for name, part in self.extra.items() if name.startswith(REWARD_KEY)]
        reward = np.zeros(self.marks.shape[1])
        for part in (*self.values[parts], *own):
            reward += part
        return reward
