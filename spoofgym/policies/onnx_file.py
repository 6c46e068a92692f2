"""What the ONNX file of a policy may hold; all else is refused before anything of it is run.

It is parsed first, nothing is unpickled, and nothing outside of it is read.  ``onnx`` takes a third
of a second to import, hence inside of functions.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .card import PolicyFile, State

if TYPE_CHECKING:
    from onnx import ModelProto, ValueInfoProto

SUFFIX = ".onnx"
DOMAINS = ("", "ai.onnx", "ai.onnx.ml")
"""Domains of the standard operators; the first two are the same."""
CHANCE = (
    "Bernoulli",
    "Dropout",
    "Multinomial",
    "RandomNormal",
    "RandomNormalLike",
    "RandomUniform",
    "RandomUniformLike",
)
"""Operators that a policy must not have: the same observation gives the same action."""
CONTROL_FLOW = frozenset({"If", "Loop", "Scan", "SequenceMap"})
LARGEST_BYTES, MOST_OPERATORS, MOST_PARTS = 32 << 20, 5_000, 50_000
"""Of a file; a policy is asked hundreds of times an episode.  Parts are operators, their settings,
tensors and types, in subgraphs, too."""
MOST_ELEMENTS, MOST_IN_ALL, MOST_PRODUCTS = 4 << 20, 1 << 25, 1 << 28
"""Of any tensor between two operators, of all of them together, and multiplications of all products
of matrices, convolutions, pools and recurrent operators, for the observations it is tried on."""
RECURRENT = ("GRU", "LSTM", "RNN")
GROWING = frozenset(
    {
        *("AffineGrid", "CenterCropPad", "Col2Im", "ConstantOfShape", "Expand", "MaxUnpool"),
        *("MelWeightMatrix", "OneHot", "Pad", "Range", "Resize", "Tile", "Upsample"),
        *("BlackmanWindow", "HammingWindow", "HannWindow"),
    }
)
"""Operators whose result is as large as some number says; that has to follow from the graph."""
UNBOUNDED = frozenset(
    {
        *("DFT", "DeformConv", "Det", "ImageDecoder", "LRN", "MaxRoiPool", "NonMaxSuppression"),
        *("RoiAlign", "STFT"),
    }
)
"""Operators whose cost does not follow from shapes; a policy needs none of them."""
POOLS = ("AveragePool", "LpPool", "MaxPool")
TRIED = 16
"""Observations that a network is tried on when it is loaded."""
NEXT = "next_"
"""Before the name of a state: the output that is the state of the next decision."""


def read_model(content: bytes, where: str) -> ModelProto:
    """Parse an ONNX file, and refuse what is not self-contained."""
    import onnx
    from google.protobuf.message import DecodeError

    try:
        model = onnx.load_model_from_string(content)
    except DecodeError as error:
        raise ValueError(f"{where} is no ONNX file, or cut off: {error}") from error
    if not model.graph.node or not model.opset_import:
        raise ValueError(f"{where} is no ONNX file: it has no graph of operators")
    if len(model.graph.node) > MOST_OPERATORS:
        raise ValueError(
            f"{where} has {len(model.graph.node):,} operators; a policy may have {MOST_OPERATORS:,}"
        )
    _check_parts(model, where)
    try:
        onnx.checker.check_model(model)
    except (onnx.checker.ValidationError, ValueError) as error:
        raise ValueError(f"{where} is no valid ONNX model: {error}") from error
    _check_work(model, where)
    return model


def _check_work(model: ModelProto, where: str) -> None:
    """Look at the sizes of all tensors, as far as they follow from the graph, before it is run."""
    import onnx

    try:
        inferred = onnx.shape_inference.infer_shapes(_with_batch(model), data_prop=True).graph
    except (onnx.shape_inference.InferenceError, ValueError) as error:
        raise ValueError(f"{where} is no valid ONNX model: {error}") from error
    _check_sizes_follow(inferred, where)
    shapes: dict[str, list[int]] = {
        tensor.name: list(tensor.dims) for tensor in inferred.initializer
    }
    for value in (*inferred.input, *inferred.value_info, *inferred.output):
        dims = value.type.tensor_type.shape.dim
        shapes[value.name] = [dim.dim_value if dim.HasField("dim_value") else TRIED for dim in dims]
    largest = max(map(_size, shapes.values()), default=0)
    results = [shapes[name] for node in inferred.node for name in node.output if name in shapes]
    products = sum(_products(node, shapes) for node in inferred.node)
    for word, found, most in (
        ("a tensor of {:,} elements", largest, MOST_ELEMENTS),
        ("results of {:,} elements", sum(map(_size, results)), MOST_IN_ALL),
        ("{:,} multiplications in products of matrices", products, MOST_PRODUCTS),
    ):
        if found > most:
            raise ValueError(
                f"{where} has {word.format(found)} for {TRIED} observations; a policy may have "
                f"{most:,}"
            )


def _with_batch(model: ModelProto) -> ModelProto:
    import onnx

    fixed = onnx.ModelProto()
    fixed.CopyFrom(model)
    del fixed.graph.value_info[:]  # all of it is inferred again
    for values, size in ((fixed.graph.input, TRIED), (fixed.graph.output, None)):
        for value in values:
            for dim in value.type.tensor_type.shape.dim:
                if not dim.HasField("dim_value"):
                    dim.Clear()
                    if size is not None:
                        dim.dim_value = size
    return fixed


def _check_sizes_follow(graph: Any, where: str) -> None:
    known = {
        value.name
        for value in (*graph.value_info, *graph.output)
        if value.type.tensor_type.HasField("shape")
        and all(dim.HasField("dim_value") for dim in value.type.tensor_type.shape.dim)
    }
    for node in graph.node:
        if node.op_type in UNBOUNDED:
            raise ValueError(
                f"{where} has the operator {node.op_type}, whose cost does not follow from its "
                "shapes"
            )
        if node.op_type in GROWING and not known.issuperset(filter(None, node.output)):
            raise ValueError(
                f"{where} has the operator {node.op_type} with a result whose size is only known "
                "when it is run; a policy may have none"
            )


def _products(node: Any, shapes: Mapping[str, Sequence[int]]) -> int:
    """Multiplications of an operator that has many for each element of its result."""
    first, *others = [shapes.get(name, []) for name in node.input] or [[]]
    results = _size(shapes.get(node.output[0], []))
    if node.op_type in POOLS:
        kernels = [each.ints for each in node.attribute if each.name == "kernel_shape"]
        return results * _size([size for kernel in kernels for size in kernel])
    if node.op_type == "Einsum":  # at most all elements of each with all of the others
        return int(np.prod([_size(each) for each in (first, *others)], dtype=object))
    if not first or not others:
        return 0
    if node.op_type in ("Gemm", "MatMul", "MatMulInteger", "QLinearMatMul"):
        return results * first[-1]
    if node.op_type in ("Conv", "ConvInteger", "ConvTranspose"):  # (results, channels of each, ...)
        return results * _size(others[0][1:])
    if node.op_type == "QLinearConv":  # behind scale and zero of the first
        return results * _size(others[2][1:])
    if node.op_type in RECURRENT:  # (length, batch, inputs), and its weights at every step
        return _size(first[:2]) * sum(map(_size, others[:2]))
    if node.op_type == "Attention":
        return _size(first) * _size(others[0])
    return 0


def _size(shape: Sequence[int]) -> int:
    return int(np.prod(shape, dtype=object)) if shape else 1


def _check_parts(model: ModelProto, where: str) -> None:
    from onnx import FunctionProto, NodeProto, TensorProto

    branching: set[str] = set()
    for part in _messages(model, where):
        if isinstance(part, TensorProto):
            if part.data_location == TensorProto.EXTERNAL or part.external_data:
                raise ValueError(
                    f"{where} keeps its tensor {part.name!r} in external data, outside of the "
                    "file; export it into a single file"
                )
        elif isinstance(part, NodeProto):
            if part.domain not in DOMAINS:
                raise ValueError(
                    f"{where} needs the custom operator {part.domain}::{part.op_type}; only those "
                    "of ai.onnx and ai.onnx.ml are run"
                )
            if part.op_type in CHANCE:
                raise ValueError(f"{where} draws random numbers by {part.op_type}")
            branching |= {part.op_type} & CONTROL_FLOW
        elif isinstance(part, FunctionProto) and part.domain not in DOMAINS:
            raise ValueError(
                f"{where} defines the custom operator {part.domain}::{part.name}; inline it"
            )
    if branching:
        raise ValueError(
            f"{where} has the control flow {', '.join(sorted(branching))}; export a network "
            "without branches and loops"
        )


def _messages(message: Any, where: str) -> Iterator[Any]:
    """All parts of a protocol buffer, itself first; a ValueError where there are too many."""
    open_, count = [message], 1
    while open_:
        part = open_.pop()
        yield part
        for descriptor, value in part.ListFields():
            if descriptor.message_type is not None:
                parts = [value] if hasattr(value, "ListFields") else value
                count += len(parts)
                if count > MOST_PARTS:
                    raise ValueError(
                        f"{where} has over {MOST_PARTS:,} parts (operators, their settings, "
                        "tensors, types); a policy may have no more"
                    )
                open_.extend(parts)


def file_of(name: str, content: bytes) -> PolicyFile:
    model = read_model(content, name)
    digest = hashlib.sha256(content).hexdigest()
    return PolicyFile(name=name, sha256=digest, bytes=len(content), opset=opset_of(model))


def checked_path(path: str | Path) -> Path:
    if Path(path).suffix != SUFFIX:
        raise ValueError(f"`path` must end in {SUFFIX}, got {path}")
    return Path(path)


def opset_of(model: ModelProto) -> int:
    return max(
        (item.version for item in model.opset_import if item.domain in DOMAINS[:2]), default=0
    )


def check_signature(
    model: ModelProto, observation: int, action: int, where: str, state: Sequence[State] = ()
) -> tuple[str, str]:
    constant = {tensor.name for tensor in model.graph.initializer}
    inputs = [value for value in model.graph.input if value.name not in constant]
    found = []
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
        found.append(own[0])
    return found[0], found[1]


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
