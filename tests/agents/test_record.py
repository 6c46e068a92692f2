"""Training records: what was written is read, and what is no record is named."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from agents.record import read_record, write_record


def test_points_are_read_as_they_were_written(tmp_path: Path) -> None:
    path = tmp_path / "records" / "curve.jsonl"
    first = {"step": 1, "wall_s": 0.1, "train_return": 1.5, "alarms": 3, "note": "begin"}
    last = {"step": 2, "wall_s": 0.2, "eval_undetected_m": None}
    numpy = {"train_return": np.float32(1.5), "alarms": np.int64(3)}
    write_record(path, [{**first, **numpy}, last])
    assert read_record(path) == [first, last]
    write_record(path, [first])
    assert read_record(path) == [first]


@pytest.mark.parametrize("value", [math.nan, math.inf, np.float32("nan")])
def test_what_is_not_finite_is_refused_and_leaves_what_was_there(
    value: float, tmp_path: Path
) -> None:
    path, point = tmp_path / "curve.jsonl", {"step": 1, "wall_s": 0.1}
    write_record(path, [point])
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_record(path, [point, {**point, "loss": value}])
    assert read_record(path) == [point]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{broken", r"curve\.jsonl, line 2 is not JSON"),
        ('{"wall_s": 1.0}', r"line 2 must have `step` and `wall_s`, got"),
        ("[1]", r"line 2 must have `step`"),
    ],
)
def test_a_damaged_line_is_named(line: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "curve.jsonl"
    path.write_text(f'{{"step": 1, "wall_s": 0.5}}\n{line}\n{{"step": 2, "wall_s": 0.7}}\n')
    with pytest.raises(ValueError, match=message):
        read_record(path)
