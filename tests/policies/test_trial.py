"""Foreign networks are tried in a process of their own, with limits, once for each digest."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import platformdirs
import pytest
from onnx import helper, numpy_helper

from spoofgym.policies import trial
from spoofgym.spoofers import OnnxPolicy

from ..spoofers.policies import behind, less_the_mean, write_policy


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(platformdirs, "user_cache_dir", lambda _: str(tmp_path / "cache"))
    monkeypatch.setattr(trial, "_own", set())
    monkeypatch.setattr(trial, "_passed", set())
    monkeypatch.setattr("tests.spoofers.policies.trust", lambda _: None)
    return tmp_path / "cache" / "policies"


@pytest.fixture
def trials(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Commands that are started; the first is run, and its answer is that of the others."""
    started: list[list[str]] = []
    answers: list[Any] = []
    run = trial.subprocess.run

    def noted(words: list[str], **settings: Any) -> Any:
        started.append(words)
        if not answers:
            answers.append(run(words, **settings))
        return answers[0]

    monkeypatch.setattr(trial.subprocess, "run", noted)
    return started


WIDE = behind(  # a product of 128 KiB a row, 2 GiB in the largest batch
    helper.make_node("MatMul", ["observation", "wide"], ["q"]),
    helper.make_node("ReduceMean", ["q", "axis"], ["r"], keepdims=1),
    wide=np.zeros((6, 1 << 15), np.float32),
    axis=np.array([1]),
)


def otherwise_above(rows: int) -> Any:
    """Actions that are zero where a batch has more rows than so many."""

    def edit(model: onnx.ModelProto) -> None:
        for name, value in (("rows", np.array([rows])), ("zero", np.float32([0.0]))):
            model.graph.initializer.append(numpy_helper.from_array(value, name))
        del model.graph.node[-1]
        model.graph.node.extend(
            (
                helper.make_node("Shape", ["observation"], ["batch"], start=0, end=1),
                helper.make_node("Greater", ["batch", "rows"], ["many"]),
                helper.make_node("Where", ["many", "zero", "z2"], ["action"]),
            )
        )

    return edit


def endless(model: onnx.ModelProto) -> None:
    """A thousand products of matrices of 3000 by 3000, in a file of some kilobytes."""
    products = [helper.make_node("MatMul", [f"m{k}", "m0"], [f"m{k + 1}"]) for k in range(1000)]
    first = helper.make_node("ConstantOfShape", ["shape"], ["zeros"])
    noise = helper.make_node("Add", ["zeros", "seen"], ["m0"])
    seen = helper.make_node("ReduceMean", ["observation"], ["seen"], keepdims=0)
    last = helper.make_node("Identity", ["m1000"], ["r"])
    behind(first, seen, noise, *products, last, shape=np.array([3000, 3000], np.int64))(model)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (WIDE, r"tiny\.onnx needs more than 1 GiB of memory"),
        (otherwise_above(128), r"tiny\.onnx answers the same observation differently in another"),
        (otherwise_above(5000), r"tiny\.onnx answers the same observation differently in another"),
        pytest.param(
            endless,
            rf"tiny\.onnx needs more than {trial.TIME_S} s for 16 observations",
            marks=pytest.mark.nightly,  # which it takes
        ),
        (less_the_mean, r"tiny\.onnx answers the same observation differently in another batch"),
    ],
)
def test_what_a_trial_refuses(
    edit: Any, message: str, tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_policy(tmp_path, model=edit)

    def never(*_: Any) -> None:
        raise AssertionError("a foreign file is not run in this process")

    monkeypatch.setattr("spoofgym.policies.onnx_model.make_session", never)
    with pytest.raises(ValueError, match=message) as caught:
        OnnxPolicy(str(path))
    assert str(path) in str(caught.value)
    assert not cache.exists()  # it is refused again next time


def test_a_network_is_tried_once_for_each_digest(
    tmp_path: Path, cache: Path, trials: list[list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_policy(tmp_path)
    OnnxPolicy(str(path))
    assert len(trials) == 1
    monkeypatch.setattr(trial, "_passed", set())  # as in another process
    OnnxPolicy(str(path))
    assert len(trials) == 1
    assert len([*cache.iterdir()]) == 1
    card = json.loads(path.with_suffix(".json").read_text())
    card["observation"]["high"] = [50.0, *card["observation"]["high"][1:]]
    path.with_suffix(".json").write_text(json.dumps(card))
    OnnxPolicy(str(path))  # within other bounds
    assert len(trials) == 2


def test_what_this_process_exports_is_not_foreign(
    tmp_path: Path, cache: Path, trials: list[list[str]]
) -> None:
    path = write_policy(tmp_path)
    trial.trust(path.read_bytes())
    OnnxPolicy(str(path))
    assert trials == []
    assert not cache.exists()


def test_a_cache_that_cannot_be_written_costs_another_trial(
    tmp_path: Path, cache: Path, trials: list[list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    cache.parent.mkdir()
    cache.write_text("a file in place of the folder")
    path = write_policy(tmp_path)
    for count in (1, 2):
        monkeypatch.setattr(trial, "_passed", set())
        OnnxPolicy(str(path))
        assert len(trials) == count


def test_a_trial_that_dies_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial.sys, "executable", "/bin/false")
    with pytest.raises(ValueError, match=r"trial of .*tiny\.onnx ended with 1 \(nothing on"):
        OnnxPolicy(str(write_policy(tmp_path)))
