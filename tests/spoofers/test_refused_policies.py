"""Policies in files that are refused: what they may not hold, and where they do not fit."""

import hashlib
import json
from itertools import pairwise

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from spoofgym.policies.onnx_file import LARGEST_BYTES, MOST_OPERATORS
from spoofgym.spoofers import OnnxPolicy, make_spoofer

from .policies import BLIND, behind, network, write_policy


def replaced(op_type, **changes):
    def edit(model):
        node = model.graph.node[-1]
        node.op_type = op_type
        for name, value in changes.items():
            setattr(node, name, value)

    return edit


def external(model):
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")


def last(model, kind, *inputs, tensors, **attributes):
    model.graph.node[-1].CopyFrom(helper.make_node(kind, inputs, ["action"], **attributes))
    for name, value in tensors.items():
        model.graph.initializer.append(numpy_helper.from_array(value, name))


def sparse_tensor(model):
    sparse = model.graph.sparse_initializer.add(dims=[2])
    sparse.values.name = "few"
    sparse.values.external_data.add(key="location", value="weights.bin")


def sparse_constant(model):
    """280 bytes that unpack to 16 GiB."""
    values = helper.make_tensor("few", TensorProto.FLOAT, [1], [1.0])
    places = helper.make_tensor("where", TensorProto.INT64, [1], [7])
    sparse = helper.make_sparse_tensor(values, places, [2**32])
    model.graph.node.insert(0, helper.make_node("Constant", [], ["c"], sparse_value=sparse))


def external_in_attribute(model):
    tensor = TensorProto(name="inside", data_type=TensorProto.FLOAT, dims=[1])
    tensor.external_data.add(key="location", value="weights.bin")
    model.graph.node.insert(0, helper.make_node("Constant", [], ["c"], value=tensor))


def custom_function(model):
    body = [helper.make_node("Identity", ["x"], ["y"])]
    opset = [helper.make_opsetid("", 18)]
    model.functions.append(helper.make_function("mine", "Copy", ["x"], ["y"], body, opset))
    model.opset_import.append(helper.make_opsetid("mine", 1))


def graph_within(model):
    body = helper.make_graph([helper.make_node("Identity", ["z2"], ["inner"])], "body", [], [])
    model.graph.node[-1].attribute.append(helper.make_attribute("body", body))


def second_input(model):
    model.graph.input.append(helper.make_tensor_value_info("more", TensorProto.FLOAT, ["batch", 1]))


def second_output(model):
    model.graph.output.append(helper.make_tensor_value_info("z2", TensorProto.FLOAT, ["batch", 2]))


def doubles(model):
    model.graph.input[0].type.tensor_type.elem_type = TensorProto.DOUBLE
    cast = helper.make_node("Cast", ["observation"], ["single"], to=TensorProto.FLOAT)
    model.graph.node.insert(0, cast)
    model.graph.node[1].input[0] = "single"


NODE = helper.make_node
REFUSED = {
    "external": (external, r"keeps its tensor 'w0' in external data"),
    "sparse": (sparse_tensor, r"has a sparse tensor"),
    "sparse constant": (sparse_constant, r"has a sparse tensor"),
    "shape of many dimensions": (
        behind(NODE("Reshape", ["observation", "long"], ["r"]), long=np.ones(10_000, np.int64)),
        r"the operator Reshape with a tensor that is too large",
    ),
    "result of 4 GiB elements": (
        behind(NODE("Expand", ["one", "wide"], ["r"]), one=np.float32(1.0), wide=np.array([2**32])),
        r"the operator Expand with a tensor that is too large",
    ),
    "external in an attribute": (external_in_attribute, r"tensor 'inside' in external data"),
    "custom": (replaced("Spy", domain="evil"), r"has the operator evil::Spy, which a policy may"),
    "custom function": (custom_function, r"defines the function Copy; inline it"),
    "chance": (replaced("RandomNormalLike"), r"operator RandomNormalLike, which .*; .*OPERATORS"),
    "graph of an allowed operator": (graph_within, r"has a graph within its operator Identity"),
    "two inputs": (second_input, r"has 2 inputs \(observation, more\); the card has one input"),
    "two outputs": (second_output, r"has 2 outputs \(action, z2\); the card has one output"),
    "double input": (doubles, r"input observation of float64 \(batch, 6\); the card has .*float32"),
    "other input": (lambda _: network(5, 2), r"of float32 \(batch, 5\); the card has .*batch, 6"),
    "other output": (lambda _: network(6, 3), r"of float32 \(batch, 3\); the card has .*batch, 2"),
    "fixed batch": (lambda _: network(6, 2, batch=4), r"with a fixed batch of 4; .*any"),
    "no graph": (lambda _: onnx.ModelProto(ir_version=8), r"has no graph of operators"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_file_that_is_none_of_ours_is_refused(case, tmp_path, monkeypatch):
    def no_session(*_, **__):
        raise AssertionError("it must be refused before it is loaded")

    monkeypatch.setattr("spoofgym.policies.onnx_model.make_session", no_session)
    edit, message = REFUSED[case]
    path = write_policy(tmp_path, model=edit)
    with pytest.raises(ValueError, match=message) as caught:
        OnnxPolicy(str(path))
    assert str(path) in str(caught.value)


def test_a_truncated_or_changed_file_is_refused(tmp_path):
    path = write_policy(tmp_path)
    with pytest.raises(ValueError, match=r"has the SHA-256 \w+; `sha256` must be 0000"):
        make_spoofer({"name": "onnx-policy", "file": str(path), "sha256": "0" * 64})
    content = bytearray(path.read_bytes())
    half = len(content) // 2
    content[half] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"has the SHA-256 [0-9a-f]{64}; its card has"):
        OnnxPolicy(str(path))
    path.write_bytes(content[:half])
    with pytest.raises(ValueError, match=rf"has {half} bytes, and {len(content)} on its card"):
        OnnxPolicy(str(path))
    for junk in (content[:half], b"\x80\x04\x95pickled"):
        path.write_bytes(junk)
        card = json.loads(path.with_suffix(".json").read_text())
        card["file"] |= {"bytes": len(junk), "sha256": hashlib.sha256(junk).hexdigest()}
        path.with_suffix(".json").write_text(json.dumps(card))
        with pytest.raises(ValueError, match=r"tiny\.onnx is no ONNX file, or cut off"):
            OnnxPolicy(str(path))


def test_missing_files_and_other_things_on_the_card_are_named(tmp_path):
    path = write_policy(tmp_path, card=lambda card: card["file"].update(opset=17))
    with pytest.raises(ValueError, match="is of opset 18, and 17 on its card"):
        OnnxPolicy(str(path))
    change = {"kind": "profile", "file": None, "observation": None}
    path = write_policy(tmp_path, card=lambda card: card.update(change))
    with pytest.raises(ValueError, match="has the card of a profile, not of an onnx-policy"):
        OnnxPolicy(str(path))
    card = json.loads(path.with_suffix(".json").read_text())
    path.with_suffix(".json").write_text(json.dumps({**card, "colour": "red"}))
    with pytest.raises(ValueError, match=r"card .*tiny\.json: `colour`: Extra inputs"):
        OnnxPolicy(str(path))
    path = write_policy(tmp_path)
    path.with_suffix(".json").unlink()
    with pytest.raises(ValueError, match=r"tiny\.onnx has no card: there is no .*tiny\.json"):
        OnnxPolicy(str(path))
    path.unlink()
    with pytest.raises(ValueError, match=r"there is no ONNX file .*tiny\.onnx"):
        OnnxPolicy(str(path))
    with pytest.raises(ValueError, match=r"`file` must be the path of an \.onnx file or the name"):
        OnnxPolicy("tiny.zip")
    with pytest.raises(ValueError, match="spoofer 'onnx-policy' needs the setting 'file'"):
        make_spoofer("onnx-policy")


def test_another_attack_is_refused(tmp_path):
    policy = OnnxPolicy(str(write_policy(tmp_path)))
    unlike = BLIND._replace(control="rate", interval_s=1.0, action_names=("G01_acceleration",))
    said = r"tiny\.onnx does not fit this attack: .*action: G01_accel.* only here"
    with pytest.raises(ValueError, match=said) as told:
        policy.bind(unlike)
    assert "interval_s: 0.5 on the card, 1.0 here" in str(told.value)
    assert "control: 'acceleration' on the card, 'rate' here" in str(told.value)
    policy.bind(BLIND)


def nothing_by_nothing(model):
    """0 / 0 at the observation of zeros alone, as at the start of an attack."""
    sums = helper.make_node("ReduceSum", ["observation"], ["sum"], keepdims=1)
    model.graph.node.insert(0, helper.make_node("Div", ["sum", "sum"], ["one"]))
    model.graph.node.insert(0, sums)
    last(model, "Mul", "z2", "one", tensors={})


def long(model):
    del model.graph.node[-1]
    names = ["z2", *(f"c{k}" for k in range(MOST_OPERATORS)), "action"]
    for pair in pairwise(names):
        model.graph.node.append(helper.make_node("Identity", pair[:1], pair[1:]))


def heavy(model):
    """A tensor that nothing needs, larger than a policy may be."""
    weight = np.zeros(LARGEST_BYTES // 4 + 1, dtype=np.float32)
    model.graph.initializer.append(numpy_helper.from_array(weight, "ballast"))


INFINITE = {"inf": np.float32([np.inf] * 2)}
LOADED = {
    "of what is negative": (replaced("Log"), r"within the bounds on its card: .* NaN for receiver"),
    "nothing by nothing": (nothing_by_nothing, "tried within the bounds on its card"),
    "infinite": (
        lambda model: last(model, "Add", "z2", "inf", tensors=INFINITE),
        r"tiny\.onnx, tried within the bounds on its card: .* inf for receiver \d",
    ),
    "another shape than is declared, which the checker can't see": (
        lambda model: last(model, "Reshape", "z2", "shape", tensors={"shape": np.array([1, -1])}),
        r"tiny\.onnx returned actions of shape \(1, 32\), not \(16, 2\)",
    ),
    "a batch that is declared free, and fixed inside": (
        lambda model: last(model, "Reshape", "z2", "shape", tensors={"shape": np.array([7, 2])}),
        r"tiny\.onnx can't be run: .*",
    ),
    "grown": (
        behind(
            NODE("ReduceMax", ["observation"], ["most"], keepdims=0),
            NODE("Mul", ["most", "zero"], ["none"]),
            NODE("Add", ["none", "many"], ["length"]),
            NODE("Range", ["zero", "length", "one"], ["r"]),
            many=np.float32(2e9),
            zero=np.float32(0.0),
            one=np.float32(1.0),
        ),
        "the operator Range with a result whose size is neither fixed nor in proportion",
    ),
    "filled": (
        behind(
            NODE("Pow", ["side", "two"], ["shape"]),
            NODE("ConstantOfShape", ["shape"], ["r"]),
            side=np.array([30_000], np.int64),
            two=np.array([2], np.int64),
        ),
        "the operator ConstantOfShape with a result whose size is neither fixed nor in",
    ),
    "paired": (
        behind(
            NODE("ReduceSum", ["observation", "last"], ["column"], keepdims=1),
            NODE("Transpose", ["column"], ["row"]),
            NODE("MatMul", ["column", "row"], ["r"]),
            last=np.array([1], np.int64),
        ),
        "the operator MatMul with a result whose size is neither fixed nor in proportion",
    ),
    "long": (long, r"tiny\.onnx has 5,00\d operators; a policy may have 5,000"),
    "heavy": (heavy, r"tiny\.onnx has 32.0 MiB; a policy may have 32 MiB"),
}


@pytest.mark.parametrize("case", LOADED)
def test_what_is_too_large_or_fails_when_it_is_tried_is_refused(case, tmp_path):
    edit, message = LOADED[case]
    with pytest.raises(ValueError, match=message):
        OnnxPolicy(str(write_policy(tmp_path, model=edit)))


def test_a_result_of_a_known_size_is_welcome(tmp_path):
    ramp = helper.make_node("Range", ["zero", "many", "one"], ["r"])
    lengths = {"zero": np.float32(0.0), "many": np.float32(5.0), "one": np.float32(1.0)}
    policy = OnnxPolicy(str(write_policy(tmp_path, model=behind(ramp, **lengths))))
    assert policy.model.act(np.zeros((2, 6), np.float32)).shape == (2, 2)
