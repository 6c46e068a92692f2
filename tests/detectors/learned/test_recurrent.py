"""Recurrent networks with declared states: the same in any batch, reset by rows, or refused."""

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import numpy_helper

from spoofgym.detectors import LearnedDetector
from spoofgym.policies.load import OnnxDetector
from spoofgym.policies.onnx_file import describe_file
from spoofgym.policies.onnx_model import OnnxModel
from spoofgym.testing import check_detector
from spoofgym.testing.epochs import engine_script

from ...spoofers.policies import written
from .files import TERMS, edit_card, value, write_guard

TWO = {"hidden": 4, "slow": 2}


@pytest.mark.parametrize(("statistic", "weighs"), [("receiver", False), ("channel", True)])
def test_a_recurrent_detector_keeps_the_contract(tmp_path, statistic, weighs):
    terms = [*TERMS, {"name": "classic", "detector": "cusum"}]
    path = write_guard(tmp_path, state=TWO, terms=terms, statistic=statistic, weighs=weighs)
    check_detector(str(path))


def test_states_are_handed_on_from_epoch_to_epoch(tmp_path):
    path, script = write_guard(tmp_path, state=TWO), engine_script()
    detector = LearnedDetector(str(path))
    detector.bind(script.context)
    session = onnxruntime.InferenceSession(path.read_bytes())
    first = [np.zeros((5, size), np.float32) for size in TWO.values()]
    states = first
    for epoch in script.epochs:
        statistic = detector.judge(epoch).statistic
        seen = detector.memory["observation"]
        given = {"observation": seen, **dict(zip(TWO, states, strict=True))}
        action, *states = session.run(["action", "next_hidden", "next_slow"], given)
        np.testing.assert_allclose(statistic, 0.5 * (action + 1.0), atol=1e-6)
    forgetful, _ = OnnxDetector(path).model.step(seen, first)
    assert np.abs(0.5 * (forgetful + 1.0) - statistic).max() > 1e-3


def states(*sizes, name="hidden"):
    return [{"name": name, "size": size} for size in sizes]


def output_gone(model):
    kept = [each for each in model.graph.output if each.name != "next_hidden"]
    del model.graph.output[:]
    model.graph.output.extend(kept)


def resized(name, size, batch="batch"):
    def edit(model):
        for each in (*model.graph.input, *model.graph.output):
            if each.name == name:
                each.CopyFrom(value(name, size, batch))

    return edit


REFUSED = [
    (output_gone, states(4), r"no output next_hidden of a state; .* next_hidden of float32"),
    (None, [], r"has 2 inputs \(observation, hidden\); the card has one .*declared as `state`"),
    (None, states(5), r"hidden of float32 \(batch, 4\); .* and hidden of float32 \(batch, 5\)"),
    (resized("hidden", 4, 1), states(4), r"hidden with a fixed batch of 1; "),
    (None, states(4, name="next hidden"), r"`state\.0\.name`: "),
    (None, states(4, 4), "names of `state` must differ, got hidden, hidden"),
]


@pytest.mark.parametrize(("edit", "state", "message"), REFUSED)
def test_a_state_that_does_not_fit_is_refused(edit, state, message, tmp_path):
    path = write_guard(tmp_path)
    if edit is not None:
        model = onnx.load(path)
        edit(model)
        path.write_bytes(written(model))
        edit_card(path, file=describe_file(path.name, path.read_bytes()).model_dump())
    edit_card(path, state=state)
    with pytest.raises(ValueError, match=message):
        LearnedDetector(str(path))


def late(model):
    """The state grows by a third at each epoch, and is infinite after some hundred."""
    (tensor,) = (each for each in model.graph.initializer if each.name == "keep")
    tensor.CopyFrom(numpy_helper.from_array(np.float32([3.0]), "keep"))


def test_a_network_that_grows_or_answers_otherwise_when_asked_again_is_refused(
    tmp_path, monkeypatch
):
    path = write_guard(tmp_path, edit=late)
    with pytest.raises(ValueError, match="the state next_hidden with a value that is not finite"):
        LearnedDetector(str(path))
    path, asked, known = write_guard(tmp_path), [], OnnxModel.step

    def step(self, seen, states):
        action, after = known(self, seen, states)
        asked.append(len(seen))
        return action * (1.0 - 1e-6 * len(asked)), after

    monkeypatch.setattr(OnnxModel, "step", step)
    monkeypatch.setattr("spoofgym.policies.trial._passed", set())
    with pytest.raises(ValueError, match="the same observation differently the second time"):
        OnnxDetector(path)
