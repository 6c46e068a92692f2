"""Training records: one line of JSON for every point of a learning curve."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from spoofgym.core.files import write_file
from spoofgym.core.reading import parse_json, read_lines

Point = dict[str, Any]


def write_record(path: Path, points: Sequence[Point]) -> None:
    """Write a training record, whole or not at all. `points`: each with ``step``, of all receivers
    so far, ``wall_s``, also of runs before a resumption, and what was measured; None where nothing
    was."""
    lines = (json.dumps(point, allow_nan=False, default=lambda x: x.item()) for point in points)
    write_file(path, "".join(f"{line}\n" for line in lines).encode())


def read_record(path: str | os.PathLike[str]) -> list[Point]:
    """Points of a training record."""
    path, points = Path(path), []
    for number, line in enumerate(read_lines(path).splitlines(), start=1):
        point = parse_json(line, f"{path}, line {number}", object)
        if not isinstance(point, dict) or not {"step", "wall_s"} <= point.keys():
            raise ValueError(f"{path}, line {number} must have `step` and `wall_s`, got {point!r}")
        points.append(point)
    return points
