"""What an ONNX file must be like to be run as a policy: self-contained, standard, of a batch.

The file is parsed, never executed here, and nothing outside of it is read.  ``onnx`` takes a third
of a second to import, hence inside of functions.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from onnx import ModelProto, ValueInfoProto

DOMAINS = ("", "ai.onnx", "ai.onnx.ml")
"""Domains of the standard operators; the first two are the same."""
CHANCE = (
    "Bernoulli",
    "Multinomial",
    "RandomNormal",
    "RandomNormalLike",
    "RandomUniform",
    "RandomUniformLike",
)
"""Operators that a policy must not have: the same observation gives the same action."""


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
    _check_parts(model, where)
    try:
        onnx.checker.check_model(model)
    except (onnx.checker.ValidationError, ValueError) as error:
        raise ValueError(f"{where} is no valid ONNX model: {error}") from error
    return model


def _check_parts(model: ModelProto, where: str) -> None:
    """Look at every tensor, operator and function, in subgraphs and functions too."""
    from onnx import FunctionProto, NodeProto, TensorProto

    for part in _messages(model):
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
        elif isinstance(part, FunctionProto) and part.domain not in DOMAINS:
            raise ValueError(
                f"{where} defines the custom operator {part.domain}::{part.name}; inline it"
            )


def _messages(message: Any) -> Iterator[Any]:
    """All parts of a protocol buffer, itself first."""
    open_ = [message]
    while open_:
        part = open_.pop()
        yield part
        for descriptor, value in part.ListFields():
            if descriptor.message_type is not None:
                open_.extend([value] if hasattr(value, "ListFields") else value)


def opset_of(model: ModelProto) -> int:
    """Version of the standard operators."""
    return max(
        (item.version for item in model.opset_import if item.domain in DOMAINS[:2]), default=0
    )


def check_signature(model: ModelProto, observation: int, action: int, where: str) -> None:
    """Check input and output."""
    constant = {tensor.name for tensor in model.graph.initializer}
    inputs = [value for value in model.graph.input if value.name not in constant]
    for word, values, size in (
        ("input", inputs, observation),
        ("output", list(model.graph.output), action),
    ):
        wanted = f"the card says one {word} of float32 (batch, {size})"
        if len(values) != 1:
            names = ", ".join(value.name for value in values) or "none"
            raise ValueError(f"{where} has {len(values)} {word}s ({names}); {wanted}")
        found = _form(values[0])
        batch, *rest = found[1] or [0]
        if found[0] != "float32" or rest != [size] or len(found[1]) != 2:
            told = ", ".join(map(str, found[1]))
            raise ValueError(
                f"{where} has the {word} {values[0].name} of {found[0]} ({told}); {wanted}"
            )
        if isinstance(batch, int):
            raise ValueError(
                f"{where} has the {word} {values[0].name} with a fixed batch of {batch}; {wanted}, "
                "of any size: export it with a dynamic first dimension"
            )


def _form(value: ValueInfoProto) -> tuple[str, list[int | str]]:
    """Type and dimensions of an input or output; a dimension of any size by its name."""
    from onnx import helper

    tensor = value.type.tensor_type
    if not tensor.elem_type:
        return "no tensor", []
    kind = str(helper.tensor_dtype_to_np_dtype(tensor.elem_type))
    return kind, [
        dim.dim_value if dim.HasField("dim_value") else dim.dim_param or "?"
        for dim in tensor.shape.dim
    ]
