"""Training records: what was written is read, and a picture shows all of it or says why not."""

import math

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("typer")

from matplotlib.image import imread
from typer.testing import CliRunner

from agents.curve import _group_levels, app, draw_curves, name_records
from agents.record import read_record, write_record


def written(path, points=3):
    step = {"stealthy_m": 10.0, "within_budget": True, "amplitude": 0.5}
    write_record(path, [{"step": k, "wall_s": 60.0 * k, **step} for k in range(points)])
    return path


def call(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def test_points_are_read_as_they_were_written(tmp_path):
    path = tmp_path / "records" / "curve.jsonl"
    first = {"step": 1, "wall_s": 0.1, "train_return": 1.5, "alarms": 3, "note": "begin"}
    last = {"step": 2, "wall_s": 0.2, "eval_undetected_m": None}
    numpy = {"train_return": np.float32(1.5), "alarms": np.int64(3)}
    write_record(path, [{**first, **numpy}, last])
    assert read_record(path) == [first, last]
    for value in (math.nan, np.float32("inf")):  # leaves what was there
        with pytest.raises(ValueError, match="not JSON compliant"):
            write_record(path, [first, {**first, "loss": value}])
    assert read_record(path) == [first, last]
    write_record(path, [first])
    assert read_record(path) == [first]


def test_every_record_is_a_line_and_the_median_one_more(tmp_path):
    records = {name: read_record(written(tmp_path / f"{name}.jsonl")) for name in ("a", "b")}
    draw_curves({"a": records["a"]}, tmp_path / "one.png")
    draw_curves(records, tmp_path / "new" / "two.png", {"ramp": 11.5})
    one, two = imread(tmp_path / "one.png"), imread(tmp_path / "new" / "two.png")
    assert one.shape == two.shape
    assert (one[..., :3] < 0.2).all(axis=-1).sum() < (two[..., :3] < 0.2).all(axis=-1).sum()
    assert list(tmp_path.rglob("*.part")) == []


def test_records_of_one_name_are_both_drawn(tmp_path, monkeypatch):
    drawn = {}
    monkeypatch.setattr("agents.curve.draw_curves", lambda records, path: drawn.update(records))
    names = ("seed0/blind/record.jsonl", "seed1/blind/record.jsonl", "other.jsonl")
    paths = [written(tmp_path / name, k) for k, name in enumerate(names, start=2)]
    done = call(*paths, "--out", tmp_path / "curve.png")
    assert done.exit_code == 0, done.output
    lengths = {name: len(points) for name, points in drawn.items()}
    assert lengths == {str(paths[0]): 2, str(paths[1]): 3, "other": 4}
    # one of that name alone is named by its folder
    assert name_records([paths[0], paths[2]]) == ["blind", "other"]
    with pytest.raises(ValueError, match="is given twice"):
        name_records([paths[0], paths[0]])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "No such file"),
        (b"", "the record of bad has no points"),
        (b'{"step": 1, "wall_s": 0.5}\nno JSON\n', "bad.jsonl, line 2 is not JSON"),
        (b"\xff\xfe\n", "bad.jsonl, line 1 is not JSON"),
        (b"[1]\n", "line 1 must have `step` and `wall_s`"),
        (b'{"step": 7, "wall_s": 0.1, "stealthy_m": 1.0}\n', "step 7 in the record of bad lacks"),
    ],
)
def test_a_record_that_cannot_be_drawn_is_named(content, message, tmp_path):
    path = tmp_path / "bad.jsonl"
    if content is not None:
        path.write_bytes(content)
    done = call(written(tmp_path / "good.jsonl"), path, "--out", tmp_path / "curve.png")
    assert done.exit_code == 2
    assert message in done.output
    assert not (tmp_path / "curve.png").exists()


def test_levels_that_would_overlap_share_a_text():
    levels = {"ramp": 45.3, "optimum": 63.5, "accelerating": 44.9}
    assert _group_levels(levels, 2.0) == [("accelerating, ramp", 45.3), ("optimum", 63.5)]
    assert _group_levels(levels, 0.1) == [("accelerating", 44.9), ("ramp", 45.3), ("optimum", 63.5)]
