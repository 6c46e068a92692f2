"""What counts of the running episodes: displacement that nobody noticed in time."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import _kernels
from .tally import Heads, Tally

FloatArray = NDArray[np.float64]
Hold = Callable[[NDArray[np.intp]], NDArray[np.bool_]]
"""Lets receivers run the time to alert; (hold, b) alarms by epoch."""


class Score(NamedTuple):
    """What a step counts for.

    Attributes
    ----------
    gain, retraction : ndarray
        (B,) displacement gained, and taken back by an alarm [m].
    first : ndarray
        (B,) bool, whether this step brought the first alarm.
    alarm : ndarray
        (B,) bool, an alarm now, or in the time to alert after the last command.
    finished : ndarray
        (B,) bool, whether this was the last command, or the episode was ended early.
    """

    gain: FloatArray
    retraction: FloatArray
    first: NDArray[np.bool_]
    alarm: NDArray[np.bool_]
    finished: NDArray[np.bool_]


class Books:
    """Books of B receivers; the rules stand in `Game`.

    Parameters
    ----------
    receivers : int
        B.
    steps, hold : int
        Commands of an episode, and epochs of the time to alert.

    Attributes
    ----------
    step_count : ndarray
        (B,) commands given in the running episodes.
    flags : ndarray
        (3, B) bool: `detected`, `ended`, `nobody`.
    amounts : ndarray
        (B + B (steps + 1),) `credited`, then `largest`, as `play` takes them [m].
    """

    def __init__(self, receivers: int, steps: int, hold: int) -> None:
        self.steps, self.hold, self._receivers = steps, hold, receivers
        self._heads = Heads(receivers)
        self.step_count = np.zeros(receivers, dtype=np.int64)
        self.flags = np.zeros((3, receivers), dtype=np.bool_)
        self.amounts = np.zeros(receivers * (steps + 2))

    @property
    def detected(self) -> NDArray[np.bool_]:
        """(B,) bool, whether the attack has raised an alarm."""
        row: NDArray[np.bool_] = self.flags[0]
        return row

    @property
    def ended(self) -> NDArray[np.bool_]:
        """(B,) bool, whose episode is over; the game sets it.  They count nothing more."""
        row: NDArray[np.bool_] = self.flags[1]
        return row

    @property
    def nobody(self) -> NDArray[np.bool_]:
        """(B,) bool, False."""
        row: NDArray[np.bool_] = self.flags[2]
        return row

    @property
    def credited(self) -> FloatArray:
        """(B,) undetected displacement so far [m]."""
        return self.amounts[: self._receivers]

    @property
    def largest(self) -> FloatArray:
        """(steps + 1, B) largest displacement so far after each command [m]."""
        return self.amounts[self._receivers :].reshape(self.steps + 1, self._receivers)

    def reset(self, rows: NDArray[np.intp]) -> None:
        """Begin new episodes.

        Parameters
        ----------
        rows : ndarray
            Which receivers.
        """
        self.step_count[rows] = 0
        self.detected[rows] = False
        self.credited[rows] = 0.0
        self.largest[:, rows] = 0.0
        self.ended[rows] = False

    def score(self, displacement: FloatArray, alarms: NDArray[np.bool_], hold: Hold) -> Score:
        """Count one step of every receiver.

        Parameters
        ----------
        displacement : ndarray
            (B,) error along the target direction, less that at the onset [m].
        alarms : ndarray
            (B, c) bool.
        hold : callable
            Called with the receivers that have given their last command without an alarm.

        Returns
        -------
        Score
            Of the step.
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

        Parameters
        ----------
        tally : Tally
            With displacement, and those who are to be truncated; the score is written.
        alarms : ndarray
            (B, c) bool.
        early : ndarray
            (B,) bool, for whom this is the last command before the end of the window.
        at_alarm : bool
            Whether an alarm ends an episode.
        hold : callable
            Called with the receivers that have given their last command without an alarm.
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

        Parameters
        ----------
        tally : Tally
            Of the last command; retraction and alarms are written.
        hold : callable
            Called with the receivers that have given it without an alarm.
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

        Parameters
        ----------
        finished : ndarray
            (B,) bool, of the last score.
        end_at_alarm : bool
            Whether an alarm ends an episode.

        Returns
        -------
        ndarray
            (B,) bool, a new array.
        """
        return finished | self.detected if end_at_alarm else finished
