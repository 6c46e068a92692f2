"""A campaign that takes seconds, and shipped spoofers for it."""

import hashlib
from dataclasses import asdict, dataclass
from typing import ClassVar

import numpy as np
from onnx import numpy_helper

from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.runs.world import PLAIN_ID
from spoofgym.bench.search.amplitude import Tuning
from spoofgym.envs import Observer, default_terms
from spoofgym.envs.context import spoofer_context
from spoofgym.policies import zoo
from spoofgym.policies.card import SpooferCard, describe_context
from spoofgym.simulation import Timeline
from spoofgym.spoofers import Spoofer

from ..spoofers.policies import network, written

WORLD = {
    "scenario": "trolley",
    "receiver": "matched",
    "timeline": {"warmup_s": 40.0, "live_s": 5.0, "attack_s": 30.0, "time_to_alert_s": 2.0},
    "detector": {"name": "snapshot-chi2", "signals": "range_rate", "thresholds": "nominal"},
}
"""Of scores of one spoofer, at a rate test's nominal threshold."""
SHORT = Timeline(warmup_s=20.0, live_s=10.0, attack_s=20.0, time_to_alert_s=5.0)
QUICK = Tuning(runs=6, sift_runs=3, values=4, refined=2, budget=0.45)
RAMP = {"name": "ramp", "rate_mps": "tuned"}
LATE = {"decision_interval_s": 2.5, "between": "linear"}


def small_suite(**changes):
    settings = {
        "env": PLAIN_ID,
        "timeline": SHORT,
        "tuning": QUICK,
        "runs": 5,
        "detectors": ("snapshot-chi2", "ewma"),
        "spoofers": ("step", RAMP),
        **changes,
    }
    return Suite(**settings)


def use_zoo(folder, monkeypatch):
    monkeypatch.setattr(zoo, "ZOO_FOLDER", folder)


def write_zoo(folder, suite):
    """Shipped spoofers for a suite: `push` and `track`, learned, and the profile `curve`."""
    folder.mkdir(parents=True, exist_ok=True)
    write_policy(folder / "push.onnx", suite, "blind", (0.0, 0.02))
    write_policy(folder / "track.onnx", suite, "tracking", (0.0, 0.01))
    curve = {"rates_mps": [0.0, 0.05, 0.2], "heading_deg": 90.0, "label": "curve"}
    settings = {**curve, "designed_on": "ewma, by hand"}
    card = make_card("curve", suite, "blind", kind="profile", settings=settings)
    card.save(folder / "curve.json")


def write_policy(path, suite, knowledge, action, **conditions):
    context = context_of(suite, knowledge)
    model = network(len(context.observation_names), len(action))
    for tensor in model.graph.initializer:
        if tensor.name in ("w2", "b2"):
            value = np.array(action if tensor.name == "b2" else np.zeros(tensor.dims), np.float32)
            tensor.CopyFrom(numpy_helper.from_array(value, tensor.name))
    content = written(model)
    path.write_bytes(content)
    file = {"name": path.name, "sha256": hashlib.sha256(content).hexdigest()}
    learned = {
        "kind": "onnx-policy",
        "observation": describe_context(context)["observation"],
        "file": {**file, "bytes": len(content), "opset": 18},
        "env": {"action": "full-command"},
        **conditions,
    }
    make_card(path.stem, suite, knowledge, **learned).save(path.with_suffix(".json"))


def context_of(suite, knowledge):
    setup = suite.setup(suite.detector_players[0])
    return spoofer_context(setup, 1, Observer(default_terms(setup, knowledge), setup))


def make_card(
    name, suite, knowledge, *, kind, observation=None, file=None, settings=None, env=None, **changes
):
    fields = describe_context(context_of(suite, knowledge))
    score = {"undetected_displacement_m": 12.5, "low": 11.0, "high": 14.0, "runs": 5}
    rates = {"alarm_rate": 0.2, "clean_alarm_rate": 0.18, "budget": 0.05}
    world = {"detector": {"name": "ewma"}, "timeline": asdict(suite.timeline)}
    return SpooferCard(
        name=name,
        kind=kind,
        env_id="spoofgym/Zhong2025-v0",
        env_kwargs={**world, **suite.settings, **(env or {})},
        observation=observation,
        action=fields["action"],
        conditions={**fields["conditions"], **changes},
        knowledge={"run_time": knowledge, "design_time": "ewma, by hand"},
        training={"command": "python -m by.hand", "seed": 0},
        versions={"spoofgym": "0"},
        scores=[{"detector": "ewma", "split": "calibration", "entropy": 0, **score, **rates}],
        settings=settings or {},
        file=file,
    )


@dataclass
class Mirror(Spoofer):
    """Commands what it observes; all the bits of an observation show in its run."""

    decision_interval_s: float | None = None
    between: str = "hold"
    knowledge: ClassVar[str] = "oracle"

    def act(self, observation):
        a = len(self.context.action_names)
        return np.ascontiguousarray(np.clip(observation[:, -a:].astype(np.float64), -1.0, 1.0))
