"""Displacement that nobody noticed in time, and the epoch that is scored in one kernel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..simulators.base import Simulator
from . import _kernels
from .step_result import InfoLayout, StepResult

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]
Hold = Callable[[NDArray[np.intp]], Mask]
"""Lets receivers run the time to alert; (hold, b) alarms by epoch."""
_VIEWS = ("step_count", "undetected", "largest", "detected", "ended", "nobody")


class DisplacementScore:
    """Undetected displacement of B receivers; `_kernels.score` has the rule.

    - `raw` uint8, all of the following one after the other, as `unpack_score` names them;
    - `step_count` (B,) epochs under attack in the running episodes;
    - `undetected` (B,) undetected displacement so far [m];
    - `largest` (steps + 1, B) largest displacement so far after each epoch [m];
    - `detected` (B,) bool, whether the attack has raised an alarm;
    - `ended` (B,) bool, whose episode is over, so that nothing more counts;
    - `nobody` (B,) bool, False.
    """

    step_count: NDArray[np.int64]
    undetected: FloatArray
    largest: FloatArray
    detected: Mask
    ended: Mask
    nobody: Mask

    def __init__(self, receivers: int, steps: int, hold: int) -> None:
        self.receivers, self.steps, self.hold = receivers, steps, hold
        self.raw = np.zeros(receivers * (8 * (steps + 3) + 3), dtype=np.uint8)
        self._name_arrays()

    def _name_arrays(self) -> None:
        views = _kernels.unpack_score(self.raw, self.receivers, self.steps)
        for name, view in zip(_VIEWS, views, strict=True):
            setattr(self, name, view)

    def __getstate__(self) -> dict[str, Any]:
        """All without the views, which a copy makes of its own bytes."""
        return {name: value for name, value in self.__dict__.items() if name not in _VIEWS}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the bytes, and name their arrays."""
        self.__dict__.update(state)
        self._name_arrays()

    def reset(self, rows: NDArray[np.intp]) -> None:
        """Start new episodes."""
        self.step_count[rows] = 0
        self.detected[rows] = False
        self.undetected[rows] = 0.0
        self.largest[:, rows] = 0.0
        self.ended[rows] = False

    def score_hold(self, result: StepResult, hold: Hold) -> None:
        """Score the alarms in the time to alert, of those that come to it without one."""
        values, marks = result.values, result.marks
        rows = np.flatnonzero(marks[_kernels.FINISHED] & ~self.detected)
        late = hold(rows)
        alarmed = late.any(axis=0)
        last = np.minimum(self.step_count[rows], self.steps)
        first = last + 1 + late.argmax(axis=0)
        counted = _kernels.undetected_displacement(
            np.take(self.largest, rows, axis=1), first, self.hold
        )
        back = np.where(alarmed, counted - self.largest[last, rows], 0.0)
        values[_kernels.RETRACTION, rows] = back
        marks[_kernels.FIRST, rows] = alarmed
        marks[_kernels.ALARM, rows] |= alarmed
        self.detected[rows] = alarmed
        self.undetected[rows] += back


class FusedStep:
    """An epoch's score, information, reward and simple observation in one kernel.

    `parts` are the keys of the rewards that `shares` (r, 4) give as in `reward.shares_of`; `table`,
    `command` and `per_rate` are those of `Observer`; an episode ends after `window` epochs.
    """

    def __init__(
        self,
        score: DisplacementScore,
        epoch_time: FloatArray,
        *,
        at_alarm: bool,
        window: int | None = None,
        parts: tuple[str, ...] = (),
        shares: FloatArray | None = None,
        table: NDArray[np.float32] | None = None,
        command: tuple[float, float, float, float] = (-1.0, 0.0, 0.0, 0.0),
        per_rate: FloatArray | None = None,
    ) -> None:
        self.score = score
        self.layout = InfoLayout(score.receivers, parts)
        shares = np.zeros((0, 4)) if shares is None else shares
        table = np.zeros((1, 0), dtype=np.float32) if table is None else table
        per_rate = np.zeros(0) if per_rate is None else per_rate
        window = score.steps if window is None else window
        lengths = (score.steps, score.hold, window, at_alarm, len(shares), *command)
        rules = np.concatenate([np.array(lengths, dtype=np.float64), shares.ravel(), epoch_time])
        self._fixed = (score.raw, rules, per_rate, table)

    def __call__(
        self,
        simulator: Simulator,
        alarm: Mask,
        early: Mask,
        warmup_alarm: Mask,
        result: StepResult,
        seen: NDArray[np.float32],
        hold: Hold,
    ) -> None:
        """Score an epoch whose displacement is in `result`, and write all that is reported of it.

        `alarm` (B, c) of the verdict; `early` (B,) bool, for whom this was the last command before
        the end of the window; `seen` (B o,) is observed, unless it has no element; `hold` runs the
        time to alert of those that have given the last command without an alarm.
        """
        given = (
            *self._fixed,
            np.ascontiguousarray(alarm),
            early,
            warmup_alarm,
            *simulator.step_arrays(),
            result.numbers,
            result.flags,
            seen,
        )
        if _kernels.finish(False, *given):
            self.score.score_hold(result, hold)
            # the time to alert has moved the receivers, and with them their arrays
            now = (*given[:7], *simulator.step_arrays(), *given[11:])
            _kernels.finish(True, *now)
