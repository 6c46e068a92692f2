"""A campaign that takes seconds."""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.search.amplitude import Tuning
from spoofgym.envs import Observer, default_terms
from spoofgym.envs.spoofer_binding import spoofer_context
from spoofgym.policies import zoo
from spoofgym.policies.card import SpooferCard, describe_context
from spoofgym.simulation import Timeline
from spoofgym.spoofers import SpooferContext

from ..spoofers.policies import written

OPSET = 18
SHORT = Timeline(warmup_s=20.0, live_s=10.0, attack_s=20.0, time_to_alert_s=5.0)
QUICK = Tuning(runs=6, sift_runs=3, values=4, refined=2, budget=0.45)


def small_suite(**changes: Any) -> Suite:
    settings: dict[str, Any] = {
        "timeline": SHORT,
        "tuning": QUICK,
        "runs": 5,
        "detectors": ("snapshot-chi2", "ewma"),
        "spoofers": ("step", {"name": "ramp", "rate_mps": "tuned"}),
        **changes,
    }
    return Suite(**settings)


def use_zoo(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the files of a folder be the shipped ones."""
    monkeypatch.setattr(zoo, "ZOO_FOLDER", folder)


def write_zoo(folder: Path, suite: Suite, **changes: Any) -> None:
    """Shipped spoofers for a suite: `push` and `track`, learned, and the profile `curve`."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, knowledge, push in (("push", "blind", 0.02), ("track", "tracking", 0.01)):
        write_policy(folder / f"{name}.onnx", suite, knowledge, (0.0, push), **changes)
    curve = {"rates_mps": [0.0, 0.05, 0.2], "heading_deg": 90.0, "label": "curve"}
    settings = {**curve, "designed_on": "ewma, by hand"}
    make_card("curve", suite, settings=settings, **changes).save(folder / "curve.json")


def write_policy(
    path: Path, suite: Suite, knowledge: str, action: tuple[float, ...], **changes: Any
) -> None:
    """A policy that always acts alike, with its card."""
    context = context_of(suite, knowledge)
    content = constant_policy(len(context.observation_names), action)
    path.write_bytes(content)
    file = {
        "name": path.name,
        "sha256": hashlib.sha256(content).hexdigest(),
        "bytes": len(content),
        "opset": OPSET,
    }
    seen = describe_context(context)["observation"]
    learned = {"kind": "onnx-policy", "observation": seen, "file": file, "knowledge": knowledge}
    learned["env"] = {"action": "full-command"}
    make_card(path.stem, suite, **learned, **changes).save(path.with_suffix(".json"))


def context_of(suite: Suite, knowledge: str) -> SpooferContext:
    setup = suite.setup(suite.detector_players[0])
    return spoofer_context(setup, 1, Observer(default_terms(setup, knowledge), setup))


def make_card(
    name: str,
    suite: Suite,
    *,
    knowledge: str = "blind",
    kind: str = "profile",
    observation: dict[str, Any] | None = None,
    file: dict[str, Any] | None = None,
    settings: dict[str, Any] | None = None,
    env: dict[str, Any] | None = None,
    **conditions: Any,
) -> SpooferCard:
    fields = describe_context(context_of(suite, knowledge))
    score = {"undetected_displacement_m": 12.5, "low": 11.0, "high": 14.0, "runs": 5}
    rates = {"alarm_rate": 0.2, "clean_alarm_rate": 0.18, "budget": 0.05}
    world = {"detector": {"name": "ewma"}, "timeline": dataclasses.asdict(suite.timeline)}
    world |= suite.settings
    return SpooferCard(
        name=name,
        kind=kind,
        env_id="spoofgym/TightlyCoupled-v0",
        env_kwargs={**world, **(env or {})},
        observation=observation,
        action=fields["action"],
        conditions={**fields["conditions"], **conditions},
        knowledge={"run_time": knowledge, "design_time": "ewma, by hand"},
        training={"command": "python -m by.hand", "seed": 0},
        versions={"spoofgym": "0"},
        scores=[{"detector": "ewma", "split": "calibration", "entropy": 0, **score, **rates}],
        settings=settings or {},
        file=file,
    )


def constant_policy(observations: int, action: tuple[float, ...]) -> bytes:
    """ONNX file of a network that returns the same action whatever it sees."""
    weights = np.zeros((observations, len(action)), dtype=np.float32)
    graph = helper.make_graph(
        [helper.make_node("Gemm", ["observation", "weights", "bias"], ["action"])],
        "policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", observations])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", len(action)])],
        [
            numpy_helper.from_array(weights, "weights"),
            numpy_helper.from_array(np.array(action, dtype=np.float32), "bias"),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=10)
    return written(model)
