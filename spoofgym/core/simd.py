"""Explicit vectors: eight receivers side by side, one in each lane of a vector.

A *lane array* is C-contiguous, with a row for every quantity.  One of shape (rows, 8) holds eight
receivers, and `load` gives a vector of its eight values; one of shape (rows,) holds a single
receiver, and `load` gives a number.  A function that is written with the operators and functions
below takes either, so that a formula is written once, and compiled for both.

In compiled code a vector is a value of LLVM's type ``<8 x double>``, ``<8 x i64>`` or ``<8 x i1>``
and every operation a single instruction of its intermediate code, lane by lane, without relaxed
rules of floating point: nothing depends on LLVM's vectorizer or on how many lanes the processor's
registers have, and lane i computes to the last bit what the function computes of plain numbers.
Without compilation (``NUMBA_DISABLE_JIT=1``) vectors are NumPy arrays of eight elements.

A *pair* holds two rows of a lane array, one after the other, in a vector of sixteen lanes.  What
follows from a pair is computed for both rows side by side, so that a processor has always something
to do while one of them waits for its last result.  Operators and functions take pairs, too.

Comparisons give masks, which ``&``, ``|`` and ``^`` combine.  An ``if`` can't test a mask: `select`
chooses lane by lane, and `any_lane` tests whether it holds anywhere.
"""

from __future__ import annotations

import inspect
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model
from numba.np.arrayobj import populate_array

LANES = 8
ALIGNMENT = 64  # bytes of a vector; lane arrays start at a multiple, so that none lies in two lines


# --- types -----------------------------------------------------------------------------------


class _Vector(types.Type):  # type: ignore[misc]
    """A vector of LANES elements of one of numba's types, or of twice as many."""

    def __init__(self, element: types.Type, lanes: int) -> None:
        self.element, self.lanes = element, lanes
        super().__init__(name=f"Vector({element} x {lanes})")

    def of(self, element: types.Type) -> _Vector:
        return _KINDS[element, self.lanes]


REAL, WORD, MASK = types.float64, types.uint64, types.boolean
_NUMBERS = {REAL: ir.DoubleType(), WORD: ir.IntType(64), MASK: ir.IntType(1)}
_KINDS = {
    (element, lanes): _Vector(element, lanes)
    for lanes in (LANES, 2 * LANES)
    for element in _NUMBERS
}
_LLVM = {kind: ir.VectorType(_NUMBERS[kind.element], kind.lanes) for kind in _KINDS.values()}
F8, U8 = _KINDS[REAL, LANES], _KINDS[WORD, LANES]
_INDEX = ir.IntType(32)


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: _Vector) -> None:
        super().__init__(manager, kind, _LLVM[kind])


def _splat(builder: Any, value: Any, kind: _Vector) -> Any:
    nothing = ir.Constant(_LLVM[kind], ir.Undefined)
    first = builder.insert_element(nothing, value, ir.Constant(_INDEX, 0))
    return builder.shuffle_vector(first, nothing, _indices([0] * kind.lanes))


def _indices(lanes: Sequence[int]) -> Any:
    return ir.Constant(ir.VectorType(_INDEX, len(lanes)), list(lanes))


def _cast(context: Any, builder: Any, value: Any, given: types.Type, wanted: types.Type) -> Any:
    if given == wanted:
        return value
    if not isinstance(wanted, _Vector):
        return context.cast(builder, value, given, wanted)
    number = context.cast(builder, value, given, wanted.element)
    if wanted.element is MASK:
        number = builder.trunc(number, ir.IntType(1)) if number.type.width > 1 else number
    return _splat(builder, number, wanted)


# --- how a function is compiled --------------------------------------------------------------


def _define(
    function: Callable[..., Any],
    result: Callable[..., types.Type | None],
    emit: Callable[..., Any],
    *,
    of_vectors: bool = False,
) -> None:
    """Compile calls of a function by `emit`, where `result` knows the type that comes out.
    ``result(*types)`` gives it, or None for arguments that are not for it; ``emit(context, builder,
    types, values)`` the LLVM value. Operators are defined `of_vectors` alone."""
    arity = len(inspect.signature(function).parameters)

    @infer_global(function)
    class _Template(AbstractTemplate):  # type: ignore[misc]
        key = function

        def generic(self, args: tuple[types.Type, ...], kws: dict[str, Any]) -> Any:
            kind = result(*args) if len(args) == arity and not kws else None
            return None if kind is None else signature(kind, *args)

    def lower(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        return emit(context, builder, sig.args, args)

    if not of_vectors:
        lower_builtin(function, *[types.Any] * arity)(lower)
        return
    kinds = list(_KINDS.values())
    if arity == 1:
        for kind in kinds:
            lower_builtin(function, kind)(lower)
        return
    for kind in kinds:
        for number in (types.Number, types.Boolean):
            lower_builtin(function, kind, number)(lower)
            lower_builtin(function, number, kind)(lower)
        lower_builtin(function, kind, kind)(lower)


def _common(*given: types.Type) -> _Vector | None:
    """Type of the vectors among some arguments, if the others are numbers that fit."""
    kinds = {each for each in given if isinstance(each, _Vector)}
    if len(kinds) != 1:
        return None
    (kind,) = kinds
    others = (each for each in given if not isinstance(each, _Vector))
    return kind if all(_fits(each, kind) for each in others) else None


def _fits(number: types.Type, kind: _Vector) -> bool:
    """Whether a number with a vector gives what it gives with a number, as numba types that."""
    if kind.element is WORD:
        return isinstance(number, types.Integer) and not number.signed
    real = (types.Integer, types.Float)
    return isinstance(number, types.Boolean if kind.element is MASK else real)


def _binary(
    functions: tuple[Callable[..., Any], ...],
    emits: dict[types.Type, str],
    result: types.Type | None,
) -> None:
    """Define an operator of two operands by the name of LLVM's instruction for each element."""

    def infer_kind(x: types.Type, y: types.Type) -> types.Type | None:
        kind = _common(x, y)
        if kind is None or kind.element not in emits:
            return None
        return kind.of(result or kind.element)

    def emit(context: Any, builder: Any, given: Any, values: Any) -> Any:
        kind: Any = _common(*given)
        operands = [_cast(context, builder, v, t, kind) for v, t in zip(values, given, strict=True)]
        name, _, predicate = emits[kind.element].partition(" ")
        method = getattr(builder, name)
        return method(predicate, *operands) if predicate else method(*operands)

    for function in functions:
        _define(function, infer_kind, emit, of_vectors=True)


for _name, _emits in {
    "add": {REAL: "fadd", WORD: "add"},
    "sub": {REAL: "fsub", WORD: "sub"},
    "mul": {REAL: "fmul"},
    "truediv": {REAL: "fdiv"},
    "xor": {WORD: "xor", MASK: "xor"},
    "or_": {WORD: "or_", MASK: "or_"},
    "and_": {WORD: "and_", MASK: "and_"},
}.items():
    _in_place = getattr(operator, f"i{_name.rstrip('_')}")
    _binary((getattr(operator, _name), _in_place), _emits, None)
_binary((operator.lshift,), {WORD: "shl"}, None)
_binary((operator.rshift,), {WORD: "lshr"}, None)
for _compare, _sign in (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="), ("eq", "==")):
    _words = {REAL: f"fcmp_ordered {_sign}", WORD: f"icmp_unsigned {_sign}"}
    _binary((getattr(operator, _compare),), _words, MASK)
_binary((operator.ne,), {REAL: "fcmp_unordered !=", WORD: "icmp_unsigned !="}, MASK)
_define(
    operator.neg,
    lambda x: x if isinstance(x, _Vector) and x.element is REAL else None,
    lambda context, builder, given, values: builder.fneg(values[0]),
    of_vectors=True,
)


# --- rows of lane arrays ---------------------------------------------------------------------


def _row_kind(array: types.Type) -> types.Type | None:
    if not isinstance(array, types.Array) or array.layout != "C" or array.ndim not in (1, 2):
        return None
    if array.ndim == 1:
        return array.dtype
    return {types.float64: F8, types.uint64: U8}.get(array.dtype)


def _data(context: Any, builder: Any, kind: types.Array, array: Any) -> Any:
    """Address of an array's elements: its field alone, which is much less code than the array."""
    position = context.data_model_manager[kind].get_field_position("data")
    return builder.extract_value(array, position)


def _row_address(
    context: Any, builder: Any, given: Any, values: Any, kind: types.Type | None = None
) -> Any:
    data = _data(context, builder, given[0], values[0])
    row = context.cast(builder, values[1], given[1], types.intp)
    kind = kind or _row_kind(given[0])
    if not isinstance(kind, _Vector):
        return builder.gep(data, [row])
    first = builder.mul(row, ir.Constant(ir.IntType(64), LANES))
    pointer = builder.gep(data, [first])
    return builder.bitcast(pointer, _LLVM[kind].as_pointer())


class _Lanes(np.ndarray):
    """A vector without compilation: like a number, none that ``+=`` changes in place."""


for _name in ("add", "sub", "mul", "truediv", "and", "or", "xor"):
    setattr(_Lanes, f"__i{_name}__", getattr(np.ndarray, f"__{_name}__"))


def _python(values: Any) -> Any:
    return values[()] if values.ndim == 0 else values.view(_Lanes)


def load(array: Any, row: int) -> Any:
    """Row of a lane array: a vector, or a number where it holds a single receiver."""
    return array[row] if array.ndim == 1 else _python(array[row].copy())


def store(array: Any, row: int, value: Any) -> None:
    """Write a row of a lane array, or with a pair two; a number goes to all lanes."""
    if np.size(value) > LANES:
        array[row : row + 2] = value.reshape(2, LANES)
    else:
        array[row] = value


def load_pair(array: Any, row: int) -> Any:
    return _python(array[row : row + 2].reshape(-1).copy())


def pair_lanes(vector: Any) -> Any:
    return _python(np.concatenate([vector, vector]))


def _is_pair(kind: types.Type) -> bool:
    return isinstance(kind, _Vector) and kind.lanes == 2 * LANES


def _pair_kind(array: types.Type, row: types.Type) -> types.Type | None:
    kind = _row_kind(array)
    return _KINDS[kind.element, 2 * LANES] if isinstance(kind, _Vector) else None


def _emit_load(
    context: Any, builder: Any, given: Any, values: Any, kind: types.Type | None = None
) -> Any:
    loaded = builder.load(_row_address(context, builder, given, values, kind))
    loaded.align = 8
    return loaded


def _can_store(array: types.Type, value: types.Type) -> bool:
    return _row_kind(array) is not None and not (_is_pair(value) and array.ndim == 1)


def _emit_store(context: Any, builder: Any, given: Any, values: Any) -> Any:
    kind = given[2] if _is_pair(given[2]) else _row_kind(given[0])
    address = _row_address(context, builder, given, values, kind)
    value = _cast(context, builder, values[2], given[2], kind)
    stored = builder.store(value, address)
    stored.align = 8
    return context.get_dummy_value()


_define(
    load,
    lambda array, row: _row_kind(array) if isinstance(row, types.Integer) else None,
    _emit_load,
)
_define(
    store,
    lambda array, row, value: types.none if _can_store(array, value) else None,
    _emit_store,
)
_define(
    load_pair,
    _pair_kind,
    lambda context, builder, given, values: _emit_load(
        context, builder, given, values, _pair_kind(*given)
    ),
)
_define(
    pair_lanes,
    lambda vector: _KINDS[vector.element, 2 * LANES] if isinstance(vector, _Vector) else None,
    lambda context, builder, given, values: builder.shuffle_vector(
        values[0], values[0], _indices([*range(LANES), *range(LANES)])
    ),
)


def splat(value: Any, like: Any) -> Any:
    """A number in all lanes, of as many lanes as `like` has: a lane array, vector or number."""
    if isinstance(like, _Lanes) or np.ndim(like) == 2:
        return _python(np.full(len(like) if isinstance(like, _Lanes) else LANES, value))
    return value


def _splat_kind(value: types.Type, like: types.Type) -> types.Type | None:
    many = isinstance(like, _Vector) or (isinstance(like, types.Array) and like.ndim == 2)
    if not many or isinstance(value, _Vector):
        return value
    as_many = like if isinstance(like, _Vector) else F8
    if isinstance(value, types.Float):
        return as_many.of(REAL)
    return as_many.of(WORD) if isinstance(value, types.Integer) else None


_define(
    splat,
    _splat_kind,
    lambda context, builder, given, values: _cast(
        context, builder, values[0], given[0], _splat_kind(*given)
    ),
)


# --- functions lane by lane ------------------------------------------------------------------


def _unary(
    function: Callable[..., Any],
    given_kinds: dict[types.Type, types.Type],
    emit: Callable[[Any, Any, types.Type, types.Type], Any],
) -> None:

    def lower(context: Any, builder: Any, given: Any, values: Any) -> Any:
        return emit(builder, values[0], given[0], given_kinds[given[0]])

    _define(function, given_kinds.get, lower)


def _intrinsic(name: str) -> Callable[[Any, Any, types.Type, types.Type], Any]:

    def emit(builder: Any, value: Any, given: types.Type, result: types.Type) -> Any:
        suffix = f"v{given.lanes}f64" if isinstance(given, _Vector) else "f64"
        kind = ir.FunctionType(value.type, [value.type])
        found = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.{suffix}")
        return builder.call(found, [value])

    return emit


def sqrt(x: Any) -> Any:
    return np.sqrt(x)


def floor(x: Any) -> Any:
    return np.floor(x)


def absolute(x: Any) -> Any:
    return np.abs(x)


_REALS = {REAL: REAL} | {kind: kind for kind in _KINDS.values() if kind.element is REAL}
for _function, _name in ((sqrt, "sqrt"), (floor, "floor"), (absolute, "fabs")):
    _unary(_function, _REALS, _intrinsic(_name))


def to_float(x: Any) -> Any:
    return x.astype(np.float64) if isinstance(x, np.ndarray) else np.float64(x)


def view_bits(x: Any) -> Any:
    return _python(np.asarray(x, dtype=np.float64).view(np.uint64))


def from_bits(x: Any) -> Any:
    return _python(np.asarray(x, dtype=np.uint64).view(np.float64))


def _bitcast(builder: Any, value: Any, given: types.Type, result: types.Type) -> Any:
    return builder.bitcast(value, _as_llvm(result))


def _convert(builder: Any, value: Any, given: types.Type, result: types.Type) -> Any:
    return builder.uitofp(value, _as_llvm(result))


def _as_llvm(kind: types.Type) -> Any:
    return _LLVM[kind] if isinstance(kind, _Vector) else _NUMBERS[kind]


_TO_REAL = {(kind.of(WORD) if isinstance(kind, _Vector) else WORD): kind for kind in _REALS}
_unary(to_float, _TO_REAL, _convert)
_unary(from_bits, _TO_REAL, _bitcast)
_unary(view_bits, {real: bits for bits, real in _TO_REAL.items()}, _bitcast)


def select(mask: Any, x: Any, y: Any) -> Any:
    """X in the lanes where a mask holds, y in the others; both are computed."""
    return _python(np.where(mask, x, y))


def _select_kind(mask: types.Type, x: types.Type, y: types.Type) -> types.Type | None:
    if isinstance(mask, _Vector):
        if not isinstance(x, _Vector) and not isinstance(y, _Vector):
            reals = isinstance(x, types.Float) and isinstance(y, types.Float)
            return mask.of(REAL) if reals and mask.element is MASK else None
        kind = _common(x, y)
        return kind if kind and mask is kind.of(MASK) else None
    vectors = isinstance(x, _Vector) or isinstance(y, _Vector)
    plain = isinstance(mask, types.Boolean) and not vectors
    if not plain:
        return None
    real = _fits(x, F8) and _fits(y, F8) and any(isinstance(each, types.Float) for each in (x, y))
    return x if x == y else (types.float64 if real else None)


def _emit_select(context: Any, builder: Any, given: Any, values: Any) -> Any:
    kind = _select_kind(*given)
    x, y = (_cast(context, builder, v, t, kind) for v, t in zip(values[1:], given[1:], strict=True))
    mask = values[0]
    if not isinstance(given[0], _Vector) and mask.type.width > 1:
        mask = builder.trunc(mask, ir.IntType(1))
    return builder.select(mask, x, y)


_define(select, _select_kind, _emit_select)


def any_lane(mask: Any) -> bool:
    return bool(np.any(mask))


def _emit_any(context: Any, builder: Any, given: Any, values: Any) -> Any:
    if not isinstance(given[0], _Vector):
        return values[0]
    bits = ir.IntType(given[0].lanes)
    return builder.icmp_unsigned("!=", builder.bitcast(values[0], bits), ir.Constant(bits, 0))


def _is_mask(kind: types.Type) -> bool:
    return isinstance(kind, types.Boolean) or (isinstance(kind, _Vector) and kind.element is MASK)


_define(any_lane, lambda mask: types.boolean if _is_mask(mask) else None, _emit_any)


def rotate_left(x: Any, turn: int) -> Any:
    left, right = np.uint64(turn), np.uint64(64 - turn)
    return (x << left) | (x >> right)


def _emit_rotate(context: Any, builder: Any, given: Any, values: Any) -> Any:
    kind = given[0]
    word = _as_llvm(kind)
    suffix = f"v{kind.lanes}i64" if isinstance(kind, _Vector) else "i64"
    turn = _cast(context, builder, values[1], given[1], kind)
    found = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(word, [word, word, word]), f"llvm.fshl.{suffix}"
    )
    return builder.call(found, [values[0], values[0], turn])


_define(
    rotate_left,
    lambda x, turn: x if x in _TO_REAL and isinstance(turn, types.Integer) else None,
    _emit_rotate,
)


# --- memory ----------------------------------------------------------------------------------


def count_lanes(array: Any) -> int:
    """Lanes of a lane array: 8, or 1 where it holds a single receiver."""
    return 1 if array.ndim == 1 else LANES


def lane(array: Any, row: int, index: int) -> Any:
    return array[row] if array.ndim == 1 else array[row, index]


def set_lane(array: Any, row: int, index: int, value: Any) -> None:
    if array.ndim == 1:
        array[row] = value
    else:
        array[row, index] = value


def _lane_address(context: Any, builder: Any, given: Any, values: Any) -> Any:
    data = _data(context, builder, given[0], values[0])
    row, index = (context.cast(builder, values[k], given[k], types.intp) for k in (1, 2))
    first = builder.mul(row, ir.Constant(ir.IntType(64), count_lanes(given[0])))
    return builder.gep(data, [builder.add(first, index)])


def _emit_set_lane(context: Any, builder: Any, given: Any, values: Any) -> Any:
    value = context.cast(builder, values[3], given[3], given[0].dtype)
    builder.store(value, _lane_address(context, builder, given, values))
    return context.get_dummy_value()


_define(
    count_lanes,
    lambda array: types.intp if isinstance(array, types.Array) else None,
    lambda context, builder, given, values: ir.Constant(ir.IntType(64), count_lanes(given[0])),
)
_define(
    lane,
    lambda array, row, index: None if _row_kind(array) is None else array.dtype,
    lambda *lowering: lowering[1].load(_lane_address(*lowering)),
)
_define(
    set_lane,
    lambda array, row, index, value: None if _row_kind(array) is None else types.none,
    _emit_set_lane,
)


# --- many arrays as one argument -------------------------------------------------------------


_READ = tuple(  # types of elements that the functions below read
    np.dtype(each).str for each in (np.float64, np.float32, np.int64, np.uint64, np.bool_)
)


class ArrayTable:
    """Addresses and sizes of C-contiguous arrays, which a kernel takes as one argument. To hand an
    array to compiled code costs as much as some hundred operations; `floats_at` and the others,
    each for one type of elements, make it of its address there. The table keeps the arrays alive;
    each has to stay where it is. `entries` (2 k,) int64, address and number of elements of each."""

    def __init__(self, arrays: Sequence[np.ndarray[Any, Any]]) -> None:
        for array in arrays:
            if not array.flags.c_contiguous or array.dtype.str not in _READ:
                raise ValueError(
                    f"the arrays of a table must be C-contiguous and of type {', '.join(_READ)}; "
                    f"got {array.dtype.name} {array.dtype.str} with strides {array.strides}"
                )
        self.arrays = tuple(arrays)
        pairs = [(array.ctypes.data, array.size) for array in arrays]
        self.entries = np.array(pairs, dtype=np.int64).ravel()


def _array(entries: Any, index: int, dtype: type, many: bool = False) -> Any:
    size, kind = int(entries[2 * index + 1]), np.ctypeslib.as_ctypes_type(dtype)
    flat = np.ctypeslib.as_array((kind * size).from_address(int(entries[2 * index])))
    return flat.reshape(-1, LANES) if many else flat


def floats_at(entries: Any, index: int) -> Any:
    return _array(entries, index, np.float64)


def singles_at(entries: Any, index: int) -> Any:
    return _array(entries, index, np.float32)


def integers_at(entries: Any, index: int) -> Any:
    return _array(entries, index, np.int64)


def flags_at(entries: Any, index: int) -> Any:
    return _array(entries, index, np.bool_)


def rows_at(entries: Any, index: int, like: Any) -> Any:
    return _array(entries, index, np.float64, like.ndim == 2)


def words_at(entries: Any, index: int, like: Any) -> Any:
    return _array(entries, index, np.uint64, like.ndim == 2)


def _define_reader(function: Callable[..., Any], element: types.Type) -> None:
    def infer_kind(*given: types.Type) -> types.Array:
        return types.Array(element, given[2].ndim if len(given) == 3 else 1, "C")

    def emit(context: Any, builder: Any, given: Any, values: Any) -> Any:
        def number(value: int) -> Any:
            return ir.Constant(ir.IntType(64), value)

        kind = infer_kind(*given)
        data = _data(context, builder, given[0], values[0])
        index = context.cast(builder, values[1], given[1], types.intp)
        place = builder.mul(index, number(2))
        address = builder.load(builder.gep(data, [place]))
        size = builder.load(builder.gep(data, [builder.add(place, number(1))]))
        item = context.get_data_type(element)
        width = number(context.get_abi_sizeof(item))
        shape, strides = [size], [width]
        if kind.ndim == 2:
            lanes = number(LANES)
            shape, strides = [builder.udiv(size, lanes), lanes], [builder.mul(width, lanes), width]
        array = context.make_array(kind)(context, builder)
        populate_array(
            array,
            data=builder.inttoptr(address, item.as_pointer()),
            shape=cgutils.pack_array(builder, shape),
            strides=cgutils.pack_array(builder, strides),
            itemsize=width,
            meminfo=None,
        )
        return array._getvalue()

    _define(function, infer_kind, emit)


for _reader, _element in (
    (floats_at, types.float64),
    (singles_at, types.float32),
    (integers_at, types.int64),
    (flags_at, types.boolean),
    (rows_at, types.float64),
    (words_at, types.uint64),
):
    _define_reader(_reader, _element)
