"""From alarms to spoofing intervals: when an attack began and when it ended, by a detector."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Interval(NamedTuple):
    """One stretch of alarms without a gap.

    - `receiver`, `channel`: whose; channel 0 of a test of the whole receiver;
    - `onset_s`: time of the first epoch with an alarm;
    - `end_s`: time of the first epoch without one; infinite where the record ends before.
    """

    receiver: int
    channel: int
    onset_s: float
    end_s: float

    @property
    def duration_s(self) -> float:
        """Length; infinite where the end is not known."""
        return self.end_s - self.onset_s


def spoofing_intervals(
    alarm: NDArray[np.bool_], time_s: ArrayLike, *, bridge_s: float = 0.0
) -> list[Interval]:
    """Spoofing intervals of every receiver and channel.

    `alarm` (K, B, c) bool, alarms of K epochs, as verdicts have them; `time_s` (K,) time of every
    epoch, increasing.

    Examples
    --------
    >>> import numpy as np
    >>> from spoofgym.bench.intervals import spoofing_intervals
    >>> alarm = np.array([0, 1, 1, 0, 0, 1], dtype=bool)[:, None, None]
    >>> for interval in spoofing_intervals(alarm, 0.5 * np.arange(6)):
    ...     print(interval.onset_s, interval.end_s)
    0.5 1.5
    2.5 inf
    """
    time = np.asarray(time_s, dtype=np.float64)
    alarm = np.asarray(alarm, dtype=np.bool_)
    if alarm.ndim != 3 or time.shape != alarm.shape[:1]:
        raise ValueError(
            "`alarm` must have shape (K, B, c) and `time_s` shape (K,), got "
            f"{alarm.shape} and {time.shape}"
        )
    if not (np.diff(time) > 0.0).all():
        raise ValueError("`time_s` must increase from epoch to epoch")
    if not bridge_s >= 0.0:
        raise ValueError(f"`bridge_s` must be >= 0, got {bridge_s}")
    quiet = np.zeros((1, *alarm.shape[1:]), dtype=np.int8)
    change = np.diff(alarm.astype(np.int8), axis=0, prepend=quiet, append=quiet)
    found: list[Interval] = []
    for b in range(alarm.shape[1]):
        for j in range(alarm.shape[2]):
            onsets = np.flatnonzero(change[:, b, j] == 1)
            ends = np.flatnonzero(change[:, b, j] == -1)
            found += _joined(b, j, time[onsets], np.append(time, math.inf)[ends], bridge_s)
    return found


def _joined(
    receiver: int,
    channel: int,
    onsets: NDArray[np.float64],
    ends: NDArray[np.float64],
    bridge_s: float,
) -> list[Interval]:
    found: list[Interval] = []
    for onset, end in zip(onsets.tolist(), ends.tolist(), strict=True):
        if found and bridge_s > 0.0 and onset - found[-1].end_s <= bridge_s:
            found[-1] = found[-1]._replace(end_s=end)
        else:
            found.append(Interval(receiver, channel, onset, end))
    return found
