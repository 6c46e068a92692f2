"""The picture of training records shows every record that was given, or says why not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("typer")

from matplotlib.image import imread
from typer.testing import CliRunner, Result

from agents.curve import _grouped, app, draw_curves, names_of
from agents.record import read_record, write_record


def written(path: Path, points: int = 3) -> Path:
    record = [
        {
            "step": step,
            "wall_s": 60.0 * step,
            "stealthy_m": 10.0 + step,
            "within_budget": step != 1,
            "amplitude": 0.5,
        }
        for step in range(points)
    ]
    write_record(path, record)
    return path


def call(*words: object) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def test_every_record_is_a_line_and_the_median_one_more(tmp_path: Path) -> None:
    records = {name: read_record(written(tmp_path / f"{name}.jsonl")) for name in ("a", "b")}
    draw_curves({"a": records["a"]}, tmp_path / "one.png")
    draw_curves(records, tmp_path / "new" / "two.png", {"ramp": 11.5})
    one, two = imread(tmp_path / "one.png"), imread(tmp_path / "new" / "two.png")
    assert one.shape == two.shape
    assert (one[..., :3] < 0.2).all(axis=-1).sum() < (two[..., :3] < 0.2).all(axis=-1).sum()
    assert list(tmp_path.rglob("*.part")) == []


def test_records_of_one_name_are_both_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = {}
    monkeypatch.setattr("agents.curve.draw_curves", lambda records, path: drawn.update(records))
    first = written(tmp_path / "seed0" / "blind" / "record.jsonl", points=2)
    second = written(tmp_path / "seed1" / "blind" / "record.jsonl", points=3)
    third = written(tmp_path / "other.jsonl", points=4)
    done = call(first, second, third, "--out", tmp_path / "curve.png")
    assert done.exit_code == 0, done.output
    lengths = {name: len(points) for name, points in drawn.items()}
    assert lengths == {str(first): 2, str(second): 3, "other": 4}


def test_a_record_is_named_by_its_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    paths = [Path("record.jsonl"), Path("runs/ewma-blind/record.jsonl"), Path("mine.jsonl")]
    assert names_of(paths) == [tmp_path.name, "ewma-blind", "mine"]


def test_a_record_given_twice_is_told(tmp_path: Path) -> None:
    path = written(tmp_path / "a.jsonl")
    done = call(path, path, "--out", tmp_path / "curve.png")
    assert (done.exit_code, f"{path} is given twice" in done.output) == (2, True)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "No such file"),
        (b"", "the record of bad has no points"),
        (b"no JSON\n", "bad.jsonl, line 1 is not JSON"),
        (b"\xff\xfe\n", "bad.jsonl, line 1 is not JSON"),
        (b'{"loss": 1.0}\n', "line 1 must have `step` and `wall_s`"),
        (
            json.dumps({"step": 7, "wall_s": 0.1, "stealthy_m": 1.0}).encode() + b"\n",
            "step 7 in the record of bad lacks 'within_budget'",
        ),
    ],
)
def test_a_record_that_cannot_be_drawn_is_told(
    content: bytes | None, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "bad.jsonl"
    if content is not None:
        path.write_bytes(content)
    done = call(written(tmp_path / "good.jsonl"), path, "--out", tmp_path / "curve.png")
    assert done.exit_code == 2
    assert "error: " in done.output
    assert message in done.output
    assert not (tmp_path / "curve.png").exists()


def test_levels_that_would_overlap_share_a_text() -> None:
    levels = {"ramp": 45.3, "optimum": 63.5, "accelerating": 44.9}
    assert _grouped(levels, 2.0) == [("accelerating, ramp", 45.3), ("optimum", 63.5)]
    assert _grouped(levels, 0.1) == [("accelerating", 44.9), ("ramp", 45.3), ("optimum", 63.5)]
