"""Small networks of learned detectors in ONNX files, with their cards."""

import json

import numpy as np
from onnx import TensorProto, helper, numpy_helper

from spoofgym.detectors.learned import DetectorAgent, action_names, detector_card
from spoofgym.detectors.observation import DetectorObserver
from spoofgym.policies.load import card_path

CHANNELS = 12
TERMS = ("innovation", "in-view", "elapsed")
HIDDEN = {"hidden": 4}


def value(name, size, batch="batch"):
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, [batch, size])


def recurrent(inputs, outputs, states):
    """Leaky averages of tanh, one for each state, and actions that are linear in the first."""
    rng = np.random.default_rng(3)
    nodes, tensors = [], [numpy_helper.from_array(np.float32([0.7]), "keep")]

    def product(name, fan, out, source):
        weight = rng.normal(0.0, fan**-0.5, (out, fan)).astype(np.float32)
        bias = rng.normal(0.0, 0.1, out).astype(np.float32)
        tensors.extend([numpy_helper.from_array(weight, f"{name}_w")])
        tensors.extend([numpy_helper.from_array(bias, f"{name}_b")])
        nodes.append(helper.make_node("Gemm", [source, f"{name}_w", f"{name}_b"], [name], transB=1))

    for name, size in states.items():
        product(f"{name}_in", inputs, size, "observation")
        nodes.append(helper.make_node("Tanh", [f"{name}_in"], [f"{name}_new"]))
        nodes.append(helper.make_node("Mul", [name, "keep"], [f"{name}_old"]))
        nodes.append(helper.make_node("Add", [f"{name}_old", f"{name}_new"], [f"next_{name}"]))
    first, size = next(iter(states.items()))
    product("action_in", size, outputs, f"next_{first}")
    nodes.append(helper.make_node("Tanh", ["action_in"], ["action"]))
    graph = helper.make_graph(
        nodes,
        "policy",
        [value("observation", inputs), *(value(*each) for each in states.items())],
        [value("action", outputs), *(value(f"next_{n}", s) for n, s in states.items())],
        tensors,
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8)


def write_guard(
    folder,
    name="guard",
    *,
    terms=TERMS,
    state=HIDDEN,
    statistic="receiver",
    weighs=False,
    threshold=None,
    quiet_epochs=0,
    edit=None,
):
    """A detector of random weights, passive by default; `edit` changes the model or returns one."""
    from ...spoofers.policies import network, written

    agent = DetectorAgent(statistic, weighs, None, terms=terms)
    inputs = len(DetectorObserver(agent.observed_terms, CHANNELS).names)
    outputs = len(action_names(statistic, weighs, CHANNELS))
    model = recurrent(inputs, outputs, state) if state else network(inputs, outputs)
    if edit is not None:
        model = edit(model) or model
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.onnx"
    path.write_bytes(written(model))
    detector_card(
        agent,
        CHANNELS,
        path,
        name=name,
        interval_s=0.5,
        quiet_epochs=quiet_epochs,
        state=state,
        threshold=threshold,
    ).save(card_path(path))
    return path


def edit_card(path, **fields):
    """Change fields of a card, or remove those that are ``...``."""
    card = json.loads(path.with_suffix(".json").read_text())
    card.update(fields)
    kept = {name: value for name, value in card.items() if value is not ...}
    path.with_suffix(".json").write_text(json.dumps(kept))
