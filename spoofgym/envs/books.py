"""What counts of the running episodes: displacement that nobody noticed in time."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ._kernels import score as score_kernel

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


def joined(first: Score, then: Score) -> Score:
    """Two scores in a row as one.

    Parameters
    ----------
    first, then : Score
        Of the same receivers.

    Returns
    -------
    Score
        Sums, and whether either had an alarm or the end.
    """
    return Score(
        first.gain + then.gain,
        first.retraction + then.retraction,
        first.first | then.first,
        first.alarm | then.alarm,
        first.finished | then.finished,
    )


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
    detected : ndarray
        (B,) bool, whether the attack has raised an alarm.
    credited : ndarray
        (B,) undetected displacement so far [m].
    ended : ndarray
        (B,) bool, whose episode is over; the game sets it.  They count nothing more.
    """

    def __init__(self, receivers: int, steps: int, hold: int) -> None:
        self.steps, self.hold = steps, hold
        self.step_count = np.zeros(receivers, dtype=np.int64)
        self.detected = np.zeros(receivers, dtype=np.bool_)
        self.credited = np.zeros(receivers)
        self.ended = np.zeros(receivers, dtype=np.bool_)
        self._largest = np.zeros((receivers, steps + 1))

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
        self._largest[rows] = 0.0
        self.ended[rows] = False

    def score(
        self,
        displacement: FloatArray,
        alarms: NDArray[np.bool_],
        hold: Hold,
        early: NDArray[np.bool_] | None = None,
    ) -> Score:
        """Count one step of every receiver.

        Parameters
        ----------
        displacement : ndarray
            (B,) error along the target direction, less that at the onset [m].
        alarms : ndarray
            (B, c) bool.
        hold : callable
            Called with the receivers that have given their last command without an alarm.
        early : ndarray, optional
            (B,) bool, for whom this is the last command before the end of the window.

        Returns
        -------
        Score
            Of the step.
        """
        receivers = len(self.step_count)
        gain, retraction = np.empty((2, receivers))
        alarm, first, finished = np.empty((3, receivers), dtype=np.bool_)
        score_kernel(
            displacement,
            np.ascontiguousarray(alarms),
            self.steps,
            self.hold,
            self.step_count,
            self.detected,
            self._largest,
            gain,
            retraction,
            alarm,
            first,
            finished,
        )
        if early is not None:
            finished |= early
        if self.ended.any():
            # one whose episode is over may be stepped on until it is reset
            gain[self.ended] = retraction[self.ended] = 0.0
            for mask in (alarm, first, finished):
                mask[self.ended] = False
        if finished.any() and self.hold:
            rows = np.flatnonzero(finished & ~(self.detected | first))
            if len(rows):
                self._score_hold(rows, hold(rows), retraction, first, alarm)
        np.logical_or(self.detected, first, out=self.detected)
        self.credited += gain
        self.credited += retraction
        return Score(gain, retraction, first, alarm, finished)

    def _score_hold(
        self,
        rows: NDArray[np.intp],
        late: NDArray[np.bool_],
        retraction: FloatArray,
        first: NDArray[np.bool_],
        alarm: NDArray[np.bool_],
    ) -> None:
        """Write what alarms in the time to alert after the last command do."""
        alarmed = late.any(axis=0)
        last = np.minimum(self.step_count[rows], self.steps)
        # index of the last epoch that counts, with the first alarm at last + 1 + argmax
        kept = np.maximum(last + late.argmax(axis=0) - self.hold, 0)
        before = self._largest[rows, last]
        retraction[rows] = np.where(alarmed, self._largest[rows, kept] - before, 0.0)
        first[rows] = alarmed
        alarm[rows] |= alarmed

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
