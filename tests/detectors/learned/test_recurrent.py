"""Recurrent networks with declared states: the same in any batch, reset by rows, or refused."""

from __future__ import annotations

import json
import time

import numpy as np
import onnx
import pytest
from onnx import helper, numpy_helper

from spoofgym.detectors import LearnedDetector
from spoofgym.policies.load import OnnxDetector
from spoofgym.policies.onnx_file import MOST_OPERATORS, read_model
from spoofgym.policies.onnx_model import OnnxModel
from spoofgym.testing import check_detector
from spoofgym.testing.epochs import engine_script

from ...spoofers.policies import written
from .files import HIDDEN, edit_card, value, write_guard

TWO = {"hidden": 4, "slow": 2}


def bound(path, receivers=None):
    detector = LearnedDetector(str(path))
    script = engine_script()
    context = script.context
    detector.bind(context if receivers is None else context._replace(receivers=receivers))
    return detector, script


@pytest.mark.parametrize(("statistic", "weighs"), [("receiver", False), ("channel", True)])
def test_a_recurrent_detector_keeps_the_contract(tmp_path, statistic, weighs):
    path = write_guard(tmp_path, state=TWO, statistic=statistic, weighs=weighs)
    check_detector(str(path))


def test_states_are_handed_on_from_epoch_to_epoch(tmp_path):
    """The statistic is that of the network run by hand, with its state in our own hands."""
    import onnxruntime

    path = write_guard(tmp_path, state=TWO)
    detector, script = bound(path)
    session = onnxruntime.InferenceSession(path.read_bytes())
    states = {name: np.zeros((5, size), np.float32) for name, size in TWO.items()}
    statistics = []
    for epoch in script.epochs:
        statistic = detector.judge(epoch).statistic
        seen = detector.memory["observation"]
        action, *after = session.run(
            ["action", "next_hidden", "next_slow"], {"observation": seen, **states}
        )
        states = dict(zip(TWO, after, strict=True))
        np.testing.assert_allclose(statistic, 0.5 * (action + 1.0), atol=1e-6)
        statistics.append(statistic)
    alone = OnnxDetector(path).model
    forgetful, _ = alone.step(seen, [np.zeros((5, size), np.float32) for size in TWO.values()])
    assert np.abs(0.5 * (forgetful + 1.0) - statistics[-1]).max() > 1e-3


def without(what, name):
    def edit(model):
        values = getattr(model.graph, what)
        kept = [each for each in values if each.name != name]
        del values[:]
        values.extend(kept)

    return edit


def resized(name, size, batch="batch"):
    def edit(model):
        for values in (model.graph.input, model.graph.output):
            for each in values:
                if each.name == name:
                    each.CopyFrom(value(name, size, batch))

    return edit


SIGNATURES = {
    "no state output": (
        without("output", "next_hidden"),
        HIDDEN,
        r"has no output next_hidden of a state; the card has one output of float32 \(batch, 1\), "
        r"and next_hidden of float32 \(batch, 4\)",
    ),
    "undeclared": (
        None,
        None,
        r"has 2 inputs \(observation, hidden\); the card has one input of .*declared as `state`",
    ),
    "another name": (None, {"memory": 4}, r"has no input memory of a state; the card has one inp"),
    "another size": (
        None,
        {"hidden": 5},
        r"has the input hidden of float32 \(batch, 4\); .* and hidden of float32 \(batch, 5\)",
    ),
    "another output size": (
        resized("next_hidden", 3),
        HIDDEN,
        r"has the output next_hidden of float32 \(batch, 3\)",
    ),
    "fixed batch": (
        resized("hidden", 4, 1),
        HIDDEN,
        r"input hidden with a fixed batch of 1; ",
    ),
}


@pytest.mark.parametrize("case", SIGNATURES)
def test_a_state_that_does_not_fit_is_refused(case, tmp_path):
    edit, state, message = SIGNATURES[case]
    path = write_guard(tmp_path)
    states = None if state is None else [{"name": n, "size": s} for n, s in state.items()]
    if edit is not None:
        model = onnx.load(path)
        edit(model)
        path.write_bytes(written(model))
        relabel(path)
    edit_card(path, state=states or [])
    started = time.perf_counter()
    with pytest.raises(ValueError, match=message):
        LearnedDetector(str(path))
    assert time.perf_counter() - started < 1.0


def relabel(path):
    """Let the card have the digest of the file."""
    from spoofgym.policies.onnx_file import describe_file

    edit_card(path, file=describe_file(path.name, path.read_bytes()).model_dump())


@pytest.mark.parametrize(
    ("state", "message"),
    [
        ([{"name": "hidden", "size": 0}], r"`state\.0\.size`: .*greater than or equal to 1"),
        ([{"name": "next hidden", "size": 4}], r"`state\.0\.name`: "),
        ([{"name": "hidden", "size": 4}] * 2, "names of `state` must differ, got hidden, hidden"),
    ],
)
def test_damaged_states_of_a_card(state, message, tmp_path):
    path = write_guard(tmp_path)
    edit_card(path, state=state)
    with pytest.raises(ValueError, match=message):
        LearnedDetector(str(path))


def mixing(model):
    """The next state depends on the other receivers."""
    (node,) = (each for each in model.graph.node if each.output[0] == "next_hidden")
    node.output[0] = "apart"
    mean = helper.make_node("ReduceMean", ["apart", "axes"], ["level"], keepdims=1)
    model.graph.initializer.append(numpy_helper.from_array(np.int64([0]), "axes"))
    at = list(model.graph.node).index(node)
    model.graph.node.insert(at + 1, mean)
    model.graph.node.insert(at + 2, helper.make_node("Add", ["apart", "level"], ["next_hidden"]))


def late(model):
    """The state grows by a third at each epoch, and is infinite after some hundred."""
    (tensor,) = (each for each in model.graph.initializer if each.name == "keep")
    tensor.CopyFrom(numpy_helper.from_array(np.float32([3.0]), "keep"))


def mixing_late(model):
    """The next state depends on the other receivers, once it has grown for some epochs."""
    mixing(model)
    for node in model.graph.node:
        if node.output[0] == "hidden_new":
            node.op_type = "Sigmoid"  # which only grows
    (mean,) = (each for each in model.graph.node if each.op_type == "ReduceMean")
    mean.output[0] = "all_levels"
    bounds = {"keep": 1.0, "shift": -4.0, "least": 0.0, "most": 0.1}
    kept = [each for each in model.graph.initializer if each.name != "keep"]
    del model.graph.initializer[:]
    model.graph.initializer.extend(kept)
    model.graph.initializer.extend(
        numpy_helper.from_array(np.float32(number), name) for name, number in bounds.items()
    )
    at = list(model.graph.node).index(mean)
    model.graph.node.insert(at + 1, helper.make_node("Add", ["all_levels", "shift"], ["shifted"]))
    cut = helper.make_node("Clip", ["shifted", "least", "most"], ["level"])
    model.graph.node.insert(at + 2, cut)


def dropout(model):
    """Leaves out one observation in two thousand, by chance."""
    model.graph.initializer.append(numpy_helper.from_array(np.float32(5e-4), "ratio"))
    model.graph.initializer.append(numpy_helper.from_array(np.bool_(True), "training"))
    for node in model.graph.node:
        for k, name in enumerate(node.input):
            if name == "observation":
                node.input[k] = "kept"
    model.graph.node.insert(
        0, helper.make_node("Dropout", ["observation", "ratio", "training"], ["kept"])
    )


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (late, "returned the state next_hidden with a value that is not finite for receiver"),
        (mixing_late, "answers the same observation otherwise in another batch"),
    ],
)
def test_a_state_is_tried_when_the_file_is_loaded(edit, message, tmp_path):
    path = write_guard(tmp_path, edit=edit)
    with pytest.raises(ValueError, match=message):
        LearnedDetector(str(path))


def test_chance_is_refused(tmp_path):
    with pytest.raises(ValueError, match="has the operator Dropout, which a policy may not have"):
        write_guard(tmp_path, edit=dropout)


def test_too_many_operators_are_refused_at_once():
    many = [helper.make_node("Identity", ["x"], [f"y{k}"]) for k in range(MOST_OPERATORS + 1)]
    graph = helper.make_graph(many, "policy", [value("x", 1)], [value("y0", 1)])
    message = f"{MOST_OPERATORS + 1:,} operators; a policy may have {MOST_OPERATORS:,}"
    with pytest.raises(ValueError, match=message):
        read_model(helper.make_model(graph).SerializeToString(), "guard.onnx")


def test_a_network_that_answers_otherwise_when_asked_again_is_refused(tmp_path, monkeypatch):
    path, asked = write_guard(tmp_path), []

    def step(self, seen, states):
        action, after = known(self, seen, states)
        asked.append(len(seen))
        return action * (1.0 - 1e-6 * len(asked)), after

    known = OnnxModel.step
    monkeypatch.setattr(OnnxModel, "step", step)
    monkeypatch.setattr("spoofgym.policies.trial._passed", set())
    with pytest.raises(ValueError, match="the same observation differently the second time"):
        OnnxDetector(path)


def test_other_bounds_are_tried_again(tmp_path):
    """What passes within narrow bounds on a card need not within wide ones."""

    def roots(model):
        for node in model.graph.node:
            for k, name in enumerate(node.input):
                if name == "observation":
                    node.input[k] = "root"
        model.graph.initializer.append(numpy_helper.from_array(np.float32([0.5]), "half"))
        model.graph.node.insert(0, helper.make_node("Add", ["observation", "half"], ["above"]))
        model.graph.node.insert(1, helper.make_node("Sqrt", ["above"], ["root"]))

    path = write_guard(tmp_path, edit=roots)
    content = json.loads(path.with_suffix(".json").read_text())
    narrow = {**content["observation"]}
    narrow["low"] = [0.0] * len(narrow["low"])

    edit_card(path, observation=narrow)
    OnnxDetector(path)
    edit_card(path, observation=content["observation"])
    with pytest.raises(ValueError, match="tried within the bounds on its card"):
        OnnxDetector(path)
