"""What counts of the running episodes: displacement that nobody noticed in time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import _kernels
from .tally import Heads, Tally

FloatArray = NDArray[np.float64]
Hold = Callable[[NDArray[np.intp]], NDArray[np.bool_]]
"""Lets receivers run the time to alert; (hold, b) alarms by epoch."""


class Score(NamedTuple):
    """What a step counts for.

    - `gain`, `retraction` (B,) displacement gained, and taken back by an alarm [m];
    - `first` (B,) bool, whether this step brought the first alarm;
    - `alarm` (B,) bool, an alarm now, or in the time to alert after the last command;
    - `finished` (B,) bool, whether this was the last command, or the episode was ended early.
    """

    gain: FloatArray
    retraction: FloatArray
    first: NDArray[np.bool_]
    alarm: NDArray[np.bool_]
    finished: NDArray[np.bool_]


class Books:
    """Books of B receivers; the rules stand in `Game`.

    - `steps`, `hold`: commands of an episode, and epochs of the time to alert;
    - `raw` (bytes,) uint8, all of the following one after the other, as `unpack_books` names them;
    - `step_count` (B,) commands given in the running episodes;
    - `credited` (B,) undetected displacement so far [m];
    - `largest` (steps + 1, B) largest displacement so far after each command [m];
    - `detected` (B,) bool, whether the attack has raised an alarm;
    - `ended` (B,) bool, whose episode is over; the game sets it.  They count nothing more;
    - `nobody` (B,) bool, False.
    """

    step_count: NDArray[np.int64]
    credited: FloatArray
    largest: FloatArray
    detected: NDArray[np.bool_]
    ended: NDArray[np.bool_]
    nobody: NDArray[np.bool_]

    def __init__(self, receivers: int, steps: int, hold: int) -> None:
        self.receivers, self.steps, self.hold = receivers, steps, hold
        self._heads = Heads(receivers)
        self.raw = np.zeros(receivers * (8 * (steps + 3) + 3), dtype=np.uint8)
        self._name_arrays()

    def _name_arrays(self) -> None:
        (
            self.step_count,
            self.credited,
            self.largest,
            self.detected,
            self.ended,
            self.nobody,
        ) = _kernels.unpack_books(self.raw, self.receivers, self.steps)

    def __getstate__(self) -> dict[str, Any]:
        """All without the views, which a copy makes anew of its own bytes."""
        views = ("step_count", "credited", "largest", "detected", "ended", "nobody")
        return {name: value for name, value in self.__dict__.items() if name not in views}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the bytes, and name their arrays."""
        self.__dict__.update(state)
        self._name_arrays()

    def reset(self, rows: NDArray[np.intp]) -> None:
        """Begin new episodes."""
        self.step_count[rows] = 0
        self.detected[rows] = False
        self.credited[rows] = 0.0
        self.largest[:, rows] = 0.0
        self.ended[rows] = False

    def score(self, displacement: FloatArray, alarms: NDArray[np.bool_], hold: Hold) -> Score:
        """Count one step of every receiver.

        `displacement` (B,) error along the target direction, less that at the onset [m]; `alarms`
        (B, c) bool.
        """
        tally = Tally(self._heads)
        tally.values[_kernels.DISPLACEMENT] = displacement
        self.count(tally, alarms, self.nobody, False, hold)
        values, marks = tally.values, tally.marks
        return Score(
            values[_kernels.GAIN],
            values[_kernels.RETRACTION],
            marks[_kernels.FIRST],
            marks[_kernels.ALARM],
            marks[_kernels.FINISHED],
        )

    def count(
        self,
        tally: Tally,
        alarms: NDArray[np.bool_],
        early: NDArray[np.bool_],
        at_alarm: bool,
        hold: Hold,
    ) -> None:
        """Count an epoch whose displacement is known.

        `tally`: with displacement, and those who are to be truncated; the score is written;
        `alarms` (B, c) bool; `early` (B,) bool, for whom this is the last command before the end of
        the window.
        """
        if _kernels.score(
            np.ascontiguousarray(alarms),
            early,
            at_alarm,
            self.steps,
            self.hold,
            self.step_count,
            self.detected,
            self.ended,
            self.credited,
            self.largest,
            tally.values,
            tally.marks,
        ):
            self.score_hold(tally, hold)

    def score_hold(self, tally: Tally, hold: Hold) -> None:
        """Count what alarms in the time to alert after the last command do.

        `tally`: of the last command; retraction and alarms are written.
        """
        rows = np.flatnonzero(tally.marks[_kernels.FINISHED] & ~self.detected)
        late = hold(rows)
        alarmed = late.any(axis=0)
        last = np.minimum(self.step_count[rows], self.steps)
        # index of the last epoch that counts, with the first alarm at last + 1 + argmax
        kept = np.maximum(last + late.argmax(axis=0) - self.hold, 0)
        back = np.where(alarmed, self.largest[kept, rows] - self.largest[last, rows], 0.0)
        tally.values[_kernels.RETRACTION, rows] = back
        tally.marks[_kernels.FIRST, rows] = alarmed
        tally.marks[_kernels.ALARM, rows] |= alarmed
        self.detected[rows] = alarmed
        self.credited[rows] += back

    def over(self, finished: NDArray[np.bool_], end_at_alarm: bool) -> NDArray[np.bool_]:
        """Which episodes are over.

        `finished` (B,) bool, of the last score; returns (B,) bool, a new array.
        """
        return finished | self.detected if end_at_alarm else finished
