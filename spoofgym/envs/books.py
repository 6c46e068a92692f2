"""What counts of the running episodes: displacement that nobody noticed in time."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ._kernels import score as score_kernel
from .rewards import Outcome

FloatArray = NDArray[np.float64]
Hold = Callable[[NDArray[np.intp]], NDArray[np.bool_]]
"""Lets receivers run the time to alert; (hold, b) alarms by epoch."""


class Score(NamedTuple):
    """What a step counts for.

    Attributes
    ----------
    outcome : Outcome
        What rewards are made of.
    alarm : ndarray
        (B,) bool, an alarm now, or in the time to alert after the last command.
    finished : ndarray
        (B,) bool, whether this was the last command.
    """

    outcome: Outcome
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
    a, b = first.outcome, then.outcome
    outcome = Outcome(a.gain + b.gain, a.retraction + b.retraction, a.detected | b.detected)
    return Score(outcome, first.alarm | then.alarm, first.finished | then.finished)


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
    """

    def __init__(self, receivers: int, steps: int, hold: int) -> None:
        self.steps, self.hold = steps, hold
        self.step_count = np.zeros(receivers, dtype=np.int64)
        self.detected = np.zeros(receivers, dtype=np.bool_)
        self.credited = np.zeros(receivers)
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
        if finished.any() and self.hold:
            rows = np.flatnonzero(finished & ~(self.detected | first))
            if len(rows):
                self._score_hold(rows, hold(rows), retraction, first, alarm)
        np.logical_or(self.detected, first, out=self.detected)
        self.credited += gain
        self.credited += retraction
        return Score(Outcome(gain, retraction, first), alarm, finished)

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
        # index of the last epoch that counts, with the first alarm at steps + 1 + argmax
        kept = np.maximum(self.steps + late.argmax(axis=0) - self.hold, 0)
        before = self._largest[rows, self.steps]
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
