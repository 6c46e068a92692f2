"""Training records: what was written before a kill is read after it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from agents.record import TrainingRecord, read_record


def written(path: Path, steps: range) -> None:
    with TrainingRecord(path) as record:
        for step in steps:
            record.append(step, step / 10.0, train_return=2.0 * step, eval_undetected_m=None)


def steps_of(path: Path) -> list[int]:
    return [point["step"] for point in read_record(path)]


def test_points_are_read_as_they_were_written(tmp_path: Path) -> None:
    path = tmp_path / "records" / "curve.jsonl"
    with TrainingRecord(path) as record:
        record.append(1, 0.1, train_return=np.float32(1.5), alarms=np.int64(3), note="begin")
        # each one is there at once
        assert read_record(path) == [
            {"step": 1, "wall_s": 0.1, "train_return": 1.5, "alarms": 3, "note": "begin"}
        ]
        record.append(2, 0.2, eval_undetected_m=None)
    assert read_record(path)[1] == {"step": 2, "wall_s": 0.2, "eval_undetected_m": None}


def test_a_record_is_gone_on_with(tmp_path: Path) -> None:
    path = tmp_path / "curve.jsonl"
    written(path, range(0, 3))
    written(path, range(3, 5))
    assert steps_of(path) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("kept", range(1, 30))
def test_a_torn_last_line_is_left_out_and_removed(kept: int, tmp_path: Path) -> None:
    path = tmp_path / "curve.jsonl"
    written(path, range(3))
    content = path.read_bytes()
    path.write_bytes(content[:-kept])
    assert steps_of(path) == [0, 1]
    written(path, range(2, 4))
    assert steps_of(path) == [0, 1, 2, 3]
    assert path.read_bytes().startswith(content)


def test_points_after_the_resumption_are_dropped(tmp_path: Path) -> None:
    path = tmp_path / "curve.jsonl"
    written(path, range(5))
    with TrainingRecord(path, last_step=2) as record:
        record.append(3, 9.0)
    assert [(p["step"], p["wall_s"]) for p in read_record(path)][2:] == [(2, 0.2), (3, 9.0)]


@pytest.mark.parametrize("value", [math.nan, math.inf, np.float32("nan")])
def test_what_is_not_finite_is_refused(value: float, tmp_path: Path) -> None:
    path = tmp_path / "curve.jsonl"
    with TrainingRecord(path) as record:
        with pytest.raises(ValueError, match=r"`loss` must be finite or None, got (nan|inf)"):
            record.append(1, 0.1, loss=value)
        record.append(2, 0.2, loss=1.0)
    assert steps_of(path) == [2]


def test_steps_do_not_go_back(tmp_path: Path) -> None:
    written(tmp_path / "curve.jsonl", range(5))
    with (
        TrainingRecord(tmp_path / "curve.jsonl") as record,
        pytest.raises(ValueError, match="`step` must be at least 4, got 3"),
    ):
        record.append(3, 0.3)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{broken", r"curve\.jsonl, line 2 is not JSON"),
        ('{"wall_s": 1.0}', r"line 2 must have `step` and `wall_s`, got"),
        ("[1]", r"line 2 must have `step`"),
    ],
)
def test_another_damaged_line_is_named(line: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "curve.jsonl"
    path.write_text(f'{{"step": 1, "wall_s": 0.5}}\n{line}\n{{"step": 2, "wall_s": 0.7}}\n')
    with pytest.raises(ValueError, match=message):
        read_record(path)
