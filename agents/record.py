"""Training records: one line of JSON for every point of a learning curve."""

from __future__ import annotations

import json
import math
import os
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from spoofgym.core.files import write_file

Point = dict[str, Any]


class TrainingRecord(AbstractContextManager["TrainingRecord"]):
    """Writes a training record, each point as soon as it is known.

    - `path`: a JSON lines file; one that is there is gone on with, and a line that was torn off
      when its writer was killed is removed;
    - `last_step`: where training goes on from; points after it are dropped, to be written again.
      By default all are kept.
    """

    def __init__(self, path: str | os.PathLike[str], *, last_step: int | None = None) -> None:
        self.path = Path(path)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        kept = read_record(self.path) if self.path.exists() else []
        if last_step is not None:
            kept = [point for point in kept if point["step"] <= last_step]
        write_file(self.path, "".join(_line(point) for point in kept).encode())
        self._last = kept[-1]["step"] if kept else -1
        self._file = self.path.open("a", encoding="utf-8", newline="\n")

    def append(self, step: int, wall_s: float, **values: float | str | bool | None) -> None:
        """Write a point. `step`: steps of all receivers so far; never less than in the point
        before; `wall_s`: wall time so far, also of runs before a resumption; `**values`: what was
        measured, such as ``train_return``, ``train_alarm_rate``, ``eval_undetected_m``,
        ``eval_alarm_rate`` and ``alarm_penalty_m``; None where nothing was."""
        if step < self._last:
            raise ValueError(f"`step` must be at least {self._last}, got {step}")
        given: Point = {"step": step, "wall_s": wall_s, **values}
        point = {k: v.item() if isinstance(v, np.generic) else v for k, v in given.items()}
        for name, value in point.items():
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"`{name}` must be finite or None, got {value}")
        self._file.write(_line(point))
        self._file.flush()
        self._last = step

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self.close()


def read_record(path: str | os.PathLike[str]) -> list[Point]:
    """Points of a training record. Returns each with ``step`` and ``wall_s``; a last line that is
    torn off is left out."""
    path = Path(path)
    lines = path.read_bytes().split(b"\n")[:-1]  # what has no end of line is torn off
    points = []
    for number, line in enumerate(lines, start=1):
        try:
            point = json.loads(line)
        except ValueError as error:
            raise ValueError(f"{path}, line {number} is not JSON: {error}") from error
        if not isinstance(point, dict) or not {"step", "wall_s"} <= point.keys():
            raise ValueError(f"{path}, line {number} must have `step` and `wall_s`, got {point!r}")
        points.append(point)
    return points


def _line(point: Point) -> str:
    return json.dumps(point, allow_nan=False) + "\n"
