"""What the ONNX file of a policy may hold; all else is refused before anything of it is run.

It is parsed first, nothing is unpickled, and nothing outside of it is read.  Operators are allowed
by name, and no tensor may be larger than in proportion to the batch; what a network needs of time
and memory, `trial` limits.  ``onnx`` takes a third of a second to import, hence inside of
functions.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.reading import name_file
from .card import PolicyFile, State

if TYPE_CHECKING:
    from onnx import GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto

SUFFIX = ".onnx"
DOMAINS = ("", "ai.onnx")
"""Domains of the standard operators, which are the same."""
OPERATORS = frozenset(
    """
    Abs Acos Acosh Add And ArgMax ArgMin Asin Asinh Atan Atanh AveragePool BatchNormalization
    Cast CastLike Ceil Celu Clip Concat Constant ConstantOfShape Conv Cos Cosh CumSum
    DequantizeLinear Div Einsum Elu Equal Erf Exp Expand Flatten Floor GRU Gather
    GatherElements GatherND Gelu Gemm GlobalAveragePool GlobalMaxPool Greater GreaterOrEqual
    GroupNormalization HardSigmoid HardSwish Identity InstanceNormalization IsInf IsNaN LSTM
    LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax MatMul MatMulInteger Max
    MaxPool Mean Min Mish Mod Mul Neg Not OneHot Or PRelu Pad Pow QuantizeLinear RNN Range
    Reciprocal ReduceL1 ReduceL2 ReduceLogSum ReduceLogSumExp ReduceMax ReduceMean ReduceMin
    ReduceProd ReduceSum ReduceSumSquare Relu Reshape Round Selu SequenceAt Shape Sigmoid Sign Sin
    Sinh Size Slice Softmax Softplus Softsign Split SplitToSequence Sqrt Squeeze Sub Sum Swish
    Tan Tanh ThresholdedRelu Tile TopK Transpose Trilu Unsqueeze Where Xor
    """.split()  # noqa: SIM905
)
"""Standard operators of a policy: no control flow, no random numbers, nothing of images."""
GROWING = frozenset(("ConstantOfShape", "Expand", "OneHot", "Pad", "Range", "Tile"))
"""Operators whose result is as large as some number says; that has to follow from the graph."""
SHAPES = {"ConstantOfShape": 0, "Expand": 1, "Reshape": 1, "Tile": 1}
"""Operators with a shape among their inputs, and which of them that is."""
LARGEST_TENSOR, MOST_DIMENSIONS = 1 << 24, 64
"""Elements of a tensor, for `BATCHES[0]` observations, and of a shape."""
LARGEST_BYTES, MOST_OPERATORS, MOST_TENSORS = 32 << 20, 5_000, 5_000
"""Of a file; a policy decides hundreds of times an episode.  Tensors are those that it stores."""
BATCHES = (16, 32)
"""Observations for which sizes of tensors are compared."""
NEXT = "next_"
"""Before the name of a state: the output that is the state of the next decision."""


def read_model(content: bytes, where: str) -> ModelProto:
    """Parse an ONNX file, and refuse what a policy may not hold."""
    with name_file(where):  # also where a name in it is no text
        return _read_model(content, where)


def _read_model(content: bytes, where: str) -> ModelProto:
    import onnx
    from google.protobuf.message import DecodeError

    try:
        model = onnx.load_model_from_string(content)
    except DecodeError as error:
        raise ValueError(f"{where} is no ONNX file, or cut off: {error}") from error
    if not model.graph.node or not model.opset_import:
        raise ValueError(f"{where} is no ONNX file: it has no graph of operators")
    for word, found, most in (
        ("operators", len(model.graph.node), MOST_OPERATORS),
        ("stored tensors", len(model.graph.initializer), MOST_TENSORS),
    ):
        if found > most:
            raise ValueError(f"{where} has {found:,} {word}; a policy may have {most:,}")
    if model.functions:
        raise ValueError(f"{where} defines the function {model.functions[0].name}; inline it")
    for node in model.graph.node:
        _check_operator(node, where)
    for tensor in _list_tensors(model.graph, where):
        if tensor.external_data or tensor.data_location:
            raise ValueError(
                f"{where} keeps its tensor {tensor.name!r} in external data, outside of the file; "
                "export it into a single file"
            )
    try:
        onnx.checker.check_model(model)
        _check_shapes(model, where)
    except (
        onnx.checker.ValidationError,
        onnx.shape_inference.InferenceError,
        MemoryError,
        TypeError,
    ) as error:
        raise ValueError(f"{where} is no valid ONNX model: {error}") from error
    return model


def _check_operator(node: NodeProto, where: str) -> None:
    if node.domain not in DOMAINS or node.op_type not in OPERATORS:
        name = f"{node.domain}::{node.op_type}" if node.domain else node.op_type
        raise ValueError(
            f"{where} has the operator {name}, which a policy may not have; "
            "spoofgym.policies.onnx_file.OPERATORS lists those that it may"
        )
    for attribute in node.attribute:
        if attribute.HasField("g") or attribute.graphs:
            raise ValueError(f"{where} has a graph within its operator {node.op_type}")


def _list_tensors(graph: GraphProto, where: str) -> Iterator[TensorProto]:
    """All tensors with values of their own; sparse ones, which unpack to any size, are refused."""
    yield from graph.initializer
    sparse = bool(graph.sparse_initializer)
    for node in graph.node:
        for attribute in node.attribute:
            yield from ([attribute.t] if attribute.HasField("t") else attribute.tensors)
            sparse |= attribute.HasField("sparse_tensor") or bool(attribute.sparse_tensors)
    if sparse:
        raise ValueError(f"{where} has a sparse tensor; a policy may have whole ones")


def _check_shapes(model: ModelProto, where: str) -> None:
    """Refuse a tensor that is not of a fixed size, or in proportion to the batch. Only where an
    operator can make a tensor larger, that has to follow from the graph."""
    small, large = (_inferred_sizes(model, batch) for batch in BATCHES)
    lengths = {each.name: math.prod(each.dims) for each in model.graph.initializer} | small
    for node in model.graph.node:
        shapes = node.input[SHAPES[node.op_type] :][:1] if node.op_type in SHAPES else ()
        largest = max((small.get(name, 0) for name in node.output), default=0)
        if largest > LARGEST_TENSOR or any(lengths.get(k, 0) > MOST_DIMENSIONS for k in shapes):
            raise ValueError(
                f"{where} has the operator {node.op_type} with a tensor that is too large: valid "
                f"are {LARGEST_TENSOR:,} elements and {MOST_DIMENSIONS} dimensions"
            )
        for name in filter(None, node.output):
            size, larger = small.get(name), large.get(name)
            if size is None:
                fixed = node.op_type not in GROWING
            else:
                fixed = larger in (size, size * BATCHES[1] // BATCHES[0])
            if not fixed:
                raise ValueError(
                    f"{where} has the operator {node.op_type} with a result whose size is neither "
                    "fixed nor in proportion to the batch"
                )


def _inferred_sizes(model: ModelProto, batch: int) -> dict[str, int]:
    """Elements of all tensors that follow from the graph, for so many observations."""
    import onnx

    fixed = onnx.ModelProto()
    fixed.CopyFrom(model)
    del fixed.graph.value_info[:]  # all of it is inferred again
    for values, size in ((fixed.graph.input, batch), (fixed.graph.output, None)):
        for value in values:
            for dim in value.type.tensor_type.shape.dim:
                if not dim.HasField("dim_value"):
                    dim.Clear()
                    if size is not None:
                        dim.dim_value = size
    graph = onnx.shape_inference.infer_shapes(fixed, data_prop=True).graph
    found = {}
    for value in (*graph.value_info, *graph.output):
        kind = value.type
        if kind.HasField("sequence_type"):  # of parts of a tensor, all of one size
            kind = kind.sequence_type.elem_type
        dims = kind.tensor_type.shape.dim
        if kind.tensor_type.HasField("shape") and all(dim.HasField("dim_value") for dim in dims):
            found[value.name] = int(np.prod([dim.dim_value for dim in dims], dtype=object))
    return found


def describe_file(name: str, content: bytes) -> PolicyFile:
    model = read_model(content, name)
    digest = hashlib.sha256(content).hexdigest()
    return PolicyFile(name=name, sha256=digest, bytes=len(content), opset=get_opset(model))


def checked_path(path: str | Path) -> Path:
    if Path(path).suffix != SUFFIX:
        raise ValueError(f"`path` must end in {SUFFIX}, got {path}")
    return Path(path)


def get_opset(model: ModelProto) -> int:
    return max((item.version for item in model.opset_import if item.domain in DOMAINS), default=0)


def check_signature(
    model: ModelProto, observation: int, action: int, where: str, state: Sequence[State] = ()
) -> None:
    constant = {tensor.name for tensor in model.graph.initializer}
    inputs = [value for value in model.graph.input if value.name not in constant]
    for word, values, size, before in (
        ("input", inputs, observation, ""),
        ("output", list(model.graph.output), action, NEXT),
    ):
        states = {f"{before}{each.name}": each.size for each in state}
        named = {value.name: value for value in values}
        further = "".join(
            f", and {name} of float32 (batch, {length})" for name, length in states.items()
        )
        wanted = f"the card has one {word} of float32 (batch, {size}){further}"
        own = [name for name in named if name not in states]
        missing = [name for name in states if name not in named]
        if missing:
            raise ValueError(f"{where} has no {word} {', '.join(missing)} of a state; {wanted}")
        if len(own) != 1:
            names = ", ".join(named) or "none"
            hint = (
                "; what a recurrent network hands on is declared as `state` on a detector's card, "
                "and a spoofer has none"
                if len(own) > 1
                else ""
            )
            raise ValueError(f"{where} has {len(named)} {word}s ({names}); {wanted}{hint}")
        for name, length in ((own[0], size), *states.items()):
            _check_value(named[name], length, f"{where} has the {word} {name}", wanted)


def _check_value(value: ValueInfoProto, size: int, what: str, wanted: str) -> None:
    kind, dims = _form(value)
    batch, *rest = dims or [0]
    if kind != "float32" or rest != [size] or len(dims) != 2:
        raise ValueError(f"{what} of {kind} ({', '.join(map(str, dims))}); {wanted}")
    if isinstance(batch, int):
        raise ValueError(
            f"{what} with a fixed batch of {batch}; {wanted}, of any size: export it with a "
            "dynamic first dimension"
        )


def _form(value: ValueInfoProto) -> tuple[str, list[int | str]]:
    from onnx import helper

    tensor = value.type.tensor_type
    if not tensor.elem_type:
        return "no tensor", []
    kind = str(helper.tensor_dtype_to_np_dtype(tensor.elem_type))
    return kind, [
        dim.dim_value if dim.HasField("dim_value") else dim.dim_param or "?"
        for dim in tensor.shape.dim
    ]
