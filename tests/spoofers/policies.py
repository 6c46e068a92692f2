"""Small ONNX policies with their cards."""

import hashlib
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from spoofgym.envs.context import spoofer_context
from spoofgym.envs.observer import Observer
from spoofgym.envs.terms.observation import default_terms
from spoofgym.policies.card import SpooferCard, describe_context
from spoofgym.policies.trial import trust
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.spoofers import SpooferContext

TIMELINE = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 5.0}
ENV = {"timeline": TIMELINE, "detector": "ewma"}
FULL = {"action": "full-command"}

BLIND = SpooferContext(
    receivers=3,
    interval_s=0.5,
    steps=30,
    control="acceleration",
    acceleration_limit_mps2=0.05,
    rate_limit_mps=5.0,
    action_names=("north_acceleration", "east_acceleration"),
    observation_names=(
        "own_displacement_north",
        "own_displacement_east",
        "own_rate_north",
        "own_rate_east",
        "time_since_onset",
        "time_left",
    ),
    observation_low=(-100.0, -100.0, -100.0, -100.0, 0.0, 0.0),
    observation_high=(100.0, 100.0, 100.0, 100.0, 1.0, 1.0),
)
"""What a blind spoofer that commands accelerations is told, with the timeline above."""


def context_of(receivers=3, knowledge="blind", env=None):
    kwargs = {**ENV, **(env or {})}
    setup = TightlyCoupledSetup(**kwargs)
    return spoofer_context(setup, receivers, Observer(default_terms(setup, knowledge), setup))


def network(inputs, outputs, *, batch="batch", width=16):
    rng = np.random.default_rng(7)
    nodes, tensors, name = [], [], "observation"
    for k, (fan, out) in enumerate(pairwise([inputs, width, width, outputs])):
        for letter, drawn in (
            ("w", rng.normal(0.0, fan**-0.5, (out, fan))),
            ("b", rng.normal(0.0, 0.1, out)),
        ):
            tensors.append(numpy_helper.from_array(drawn.astype(np.float32), f"{letter}{k}"))
        nodes.append(helper.make_node("Gemm", [name, f"w{k}", f"b{k}"], [f"z{k}"], transB=1))
        name = f"z{k}"
        if k < 2:
            nodes.append(helper.make_node("Tanh", [name], [f"h{k}"]))
            name = f"h{k}"
    nodes.append(helper.make_node("Identity", [name], ["action"]))
    ends = (
        [helper.make_tensor_value_info(end, TensorProto.FLOAT, [batch, size])]
        for end, size in (("observation", inputs), ("action", outputs))
    )
    graph = helper.make_graph(nodes, "policy", *ends, tensors)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8)


Edit = Callable[[onnx.ModelProto], onnx.ModelProto | None]


def behind(*nodes, **tensors):
    """The mean of a result ``r``, cut, added to the actions; all of `tensors` by their names."""

    def edit(model):
        for name, value in tensors.items():
            model.graph.initializer.append(numpy_helper.from_array(np.array(value), name))
        del model.graph.node[-1]
        model.graph.node.extend(nodes)
        model.graph.node.append(helper.make_node("ReduceMean", ["r"], ["mean"], keepdims=0))
        model.graph.node.append(helper.make_node("Clip", ["mean", "low", "high"], ["cut"]))
        model.graph.node.append(helper.make_node("Add", ["z2", "cut"], ["action"]))
        for name, bound in (("low", -0.1), ("high", 0.1)):
            tensor = numpy_helper.from_array(np.array(bound, np.float32), name)
            model.graph.initializer.append(tensor)

    return edit


def less_the_mean(model):
    """Centred over the batch, as a normalization in training mode does."""
    model.graph.initializer.append(numpy_helper.from_array(np.array([0]), "axes"))
    mean = helper.make_node("ReduceMean", ["z2", "axes"], ["mean"], keepdims=1)
    model.graph.node[-1].CopyFrom(mean)
    model.graph.node.append(helper.make_node("Sub", ["z2", "mean"], ["action"]))


def written(model):
    """File of a model, which is tried in this process, as what it has exported."""
    content = bytes(model.SerializeToString())
    trust(content)
    return content


def card_fields(name, content, context, knowledge, env):
    return {
        "format": 2,
        "side": "spoofer",
        "name": name,
        "kind": "onnx-policy",
        "env_id": "spoofgym/Zhong2025-v0",
        "env_kwargs": {**ENV, **FULL, "knowledge": knowledge, **env},
        **describe_context(context),
        "knowledge": {"run_time": knowledge, "design_time": "ewma, zhong2025"},
        "training": {"command": "none", "seed": 7},
        "versions": {"onnx": onnx.__version__},
        "scores": [],
        "rivals": [],
        "settings": {},
        "file": {
            "name": f"{name}.onnx",
            "sha256": hashlib.sha256(content).hexdigest(),
            "bytes": len(content),
            "opset": 18,
        },
    }


def write_policy(folder, name="tiny", *, knowledge="blind", env=None, model=None, card=None):
    """Write a policy and its card; the callables edit the model and the card's fields."""
    context = context_of(1, knowledge, env)
    made = network(len(context.observation_names), len(context.action_names))
    if model is not None:
        made = model(made) or made
    content = written(made)
    path = folder / f"{name}.onnx"
    path.write_bytes(content)
    fields = card_fields(name, content, context, knowledge, env or {})
    if card is not None:
        card(fields)
    SpooferCard(**fields).save(path.with_suffix(".json"))
    return path
