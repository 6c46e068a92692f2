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

Comparisons give masks, which ``&``, ``|`` and ``^`` combine.  An ``if`` can't ask a mask: `select`
chooses lane by lane, and `any_lane` asks whether it holds anywhere.
"""

from __future__ import annotations

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
ALIGNMENT = 64
"""Bytes of a vector; a lane array starts at a multiple, so that no vector lies in two lines."""


# --- types -----------------------------------------------------------------------------------


class _Vector(types.Type):  # type: ignore[misc]
    """A vector of LANES elements of one of numba's types."""

    def __init__(self, element: types.Type) -> None:
        self.element = element
        super().__init__(name=f"Vector({element} x {LANES})")


F8 = _Vector(types.float64)
U8 = _Vector(types.uint64)
M8 = _Vector(types.boolean)
_LLVM = {
    F8: ir.VectorType(ir.DoubleType(), LANES),
    U8: ir.VectorType(ir.IntType(64), LANES),
    M8: ir.VectorType(ir.IntType(1), LANES),
}
_INDEX = ir.IntType(32)


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: _Vector) -> None:
        super().__init__(manager, kind, _LLVM[kind])


def _splat(builder: Any, value: Any, kind: _Vector) -> Any:
    """Vector whose lanes all hold a number."""
    nothing = ir.Constant(_LLVM[kind], ir.Undefined)
    first = builder.insert_element(nothing, value, ir.Constant(_INDEX, 0))
    zeros = ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES)
    return builder.shuffle_vector(first, nothing, zeros)


def _cast(context: Any, builder: Any, value: Any, given: types.Type, wanted: types.Type) -> Any:
    """Make a number, or a vector, one of a wanted type."""
    if given == wanted:
        return value
    if not isinstance(wanted, _Vector):
        return context.cast(builder, value, given, wanted)
    number = context.cast(builder, value, given, wanted.element)
    if wanted is M8:
        number = builder.trunc(number, ir.IntType(1)) if number.type.width > 1 else number
    return _splat(builder, number, wanted)


# --- how a function is compiled --------------------------------------------------------------


def _define(
    function: Callable[..., Any],
    result: Callable[..., types.Type | None],
    emit: Callable[..., Any],
    arity: int,
) -> None:
    """Compile calls of a function by `emit`, where `result` knows the type that comes out.

    ``result(*types)`` gives it, or None for arguments that are not for it; ``emit(context,
    builder, types, values)`` the LLVM value.
    """

    @infer_global(function)
    class _Template(AbstractTemplate):  # type: ignore[misc]
        key = function

        def generic(self, args: tuple[types.Type, ...], kws: dict[str, Any]) -> Any:
            kind = result(*args) if len(args) == arity and not kws else None
            return None if kind is None else signature(kind, *args)

    def lower(context: Any, builder: Any, sig: Any, args: tuple[Any, ...]) -> Any:
        return emit(context, builder, sig.args, args)

    vectors = function in _OPERATORS
    if not vectors:
        lower_builtin(function, *[types.Any] * arity)(lower)
        return
    kinds = [F8, U8, M8]
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
    if kind is U8:
        return isinstance(number, types.Integer) and not number.signed
    real = (types.Integer, types.Float)
    return isinstance(number, types.Boolean if kind is M8 else real)


def _binary(
    functions: tuple[Callable[..., Any], ...], emits: dict[_Vector, str], result: _Vector | None
) -> None:
    """Define an operator of two operands by the name of LLVM's instruction for each type."""

    def kind_of(x: types.Type, y: types.Type) -> types.Type | None:
        kind = _common(x, y)
        return None if kind is None or kind not in emits else (result or kind)

    def emit(context: Any, builder: Any, given: Any, values: Any) -> Any:
        kind: Any = _common(*given)
        operands = [_cast(context, builder, v, t, kind) for v, t in zip(values, given, strict=True)]
        name, _, predicate = emits[kind].partition(" ")
        method = getattr(builder, name)
        return method(predicate, *operands) if predicate else method(*operands)

    for function in functions:
        _define(function, kind_of, emit, 2)


_OPERATORS = {
    operator.add, operator.iadd, operator.sub, operator.isub, operator.mul, operator.imul,
    operator.truediv, operator.itruediv, operator.neg, operator.xor, operator.ixor, operator.or_,
    operator.ior, operator.and_, operator.iand, operator.lshift, operator.rshift, operator.gt,
    operator.ge, operator.lt, operator.le, operator.eq, operator.ne,
}  # fmt: skip
_binary((operator.add, operator.iadd), {F8: "fadd", U8: "add"}, None)
_binary((operator.sub, operator.isub), {F8: "fsub", U8: "sub"}, None)
_binary((operator.mul, operator.imul), {F8: "fmul"}, None)
_binary((operator.truediv, operator.itruediv), {F8: "fdiv"}, None)
_binary((operator.xor, operator.ixor), {U8: "xor", M8: "xor"}, None)
_binary((operator.or_, operator.ior), {U8: "or_", M8: "or_"}, None)
_binary((operator.and_, operator.iand), {U8: "and_", M8: "and_"}, None)
_binary((operator.lshift,), {U8: "shl"}, None)
_binary((operator.rshift,), {U8: "lshr"}, None)
for _compare, _sign in (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="), ("eq", "==")):
    _words = {F8: f"fcmp_ordered {_sign}", U8: f"icmp_unsigned {_sign}"}
    _binary((getattr(operator, _compare),), _words, M8)
_binary((operator.ne,), {F8: "fcmp_unordered !=", U8: "icmp_unsigned !="}, M8)
_define(
    operator.neg,
    lambda x: x if x is F8 else None,
    lambda context, builder, given, values: builder.fneg(values[0]),
    1,
)


# --- rows of lane arrays ---------------------------------------------------------------------


def _row_kind(array: types.Type) -> types.Type | None:
    """Type of a row of a lane array."""
    if not isinstance(array, types.Array) or array.layout != "C" or array.ndim not in (1, 2):
        return None
    if array.ndim == 1:
        return array.dtype
    return {types.float64: F8, types.uint64: U8}.get(array.dtype)


def _data(context: Any, builder: Any, kind: types.Array, array: Any) -> Any:
    """Address of an array's elements: its field alone, which is much less code than the array."""
    position = context.data_model_manager[kind].get_field_position("data")
    return builder.extract_value(array, position)


def _row_address(context: Any, builder: Any, given: Any, values: Any) -> Any:
    """Address of a row."""
    data = _data(context, builder, given[0], values[0])
    row = context.cast(builder, values[1], given[1], types.intp)
    kind = _row_kind(given[0])
    if not isinstance(kind, _Vector):
        return builder.gep(data, [row])
    first = builder.mul(row, ir.Constant(ir.IntType(64), LANES))
    pointer = builder.gep(data, [first])
    return builder.bitcast(pointer, _LLVM[kind].as_pointer())


class _Lanes(np.ndarray):
    """A vector without compilation: like a number, none that ``+=`` changes in place."""

    __iadd__: Any = np.ndarray.__add__
    __isub__: Any = np.ndarray.__sub__
    __imul__: Any = np.ndarray.__mul__
    __itruediv__: Any = np.ndarray.__truediv__
    __iand__: Any = np.ndarray.__and__
    __ior__: Any = np.ndarray.__or__
    __ixor__: Any = np.ndarray.__xor__


def _python(values: Any) -> Any:
    """A number, or a vector without compilation."""
    return values[()] if values.ndim == 0 else values.view(_Lanes)


def load(array: Any, row: int) -> Any:
    """Row of a lane array: a vector, or a number where it holds a single receiver."""
    return array[row] if array.ndim == 1 else _python(array[row].copy())


def store(array: Any, row: int, value: Any) -> None:
    """Write a row of a lane array; a number goes to all lanes."""
    array[row] = value


def _emit_load(context: Any, builder: Any, given: Any, values: Any) -> Any:
    loaded = builder.load(_row_address(context, builder, given, values))
    loaded.align = 8
    return loaded


def _emit_store(context: Any, builder: Any, given: Any, values: Any) -> Any:
    address = _row_address(context, builder, given, values)
    value = _cast(context, builder, values[2], given[2], _row_kind(given[0]))
    stored = builder.store(value, address)
    stored.align = 8
    return context.get_dummy_value()


_define(
    load,
    lambda array, row: _row_kind(array) if isinstance(row, types.Integer) else None,
    _emit_load,
    2,
)
_define(
    store,
    lambda array, row, value: None if _row_kind(array) is None else types.none,
    _emit_store,
    3,
)


def splat(value: Any, like: Any) -> Any:
    """A number in all lanes, of as many lanes as `like` has: a lane array, vector or number."""
    if isinstance(like, _Lanes) or np.ndim(like) == 2:
        return _python(np.full(LANES, value))
    return value


def _splat_kind(value: types.Type, like: types.Type) -> types.Type | None:
    many = isinstance(like, _Vector) or (isinstance(like, types.Array) and like.ndim == 2)
    if not many or isinstance(value, _Vector):
        return value
    if isinstance(value, types.Float):
        return F8
    return U8 if isinstance(value, types.Integer) else None


_define(
    splat,
    _splat_kind,
    lambda context, builder, given, values: _cast(
        context, builder, values[0], given[0], _splat_kind(*given)
    ),
    2,
)


# --- functions lane by lane ------------------------------------------------------------------


def _unary(
    function: Callable[..., Any],
    given_kinds: dict[types.Type, types.Type],
    emit: Callable[[Any, Any, types.Type, types.Type], Any],
) -> None:
    """Define a function of one argument; `given_kinds` has the result for each type."""

    def lower(context: Any, builder: Any, given: Any, values: Any) -> Any:
        return emit(builder, values[0], given[0], given_kinds[given[0]])

    _define(function, given_kinds.get, lower, 1)


def _intrinsic(name: str) -> Callable[[Any, Any, types.Type, types.Type], Any]:
    """LLVM's intrinsic function of one number, or of all lanes."""

    def emit(builder: Any, value: Any, given: types.Type, result: types.Type) -> Any:
        suffix = f"v{LANES}f64" if given is F8 else "f64"
        kind = ir.FunctionType(value.type, [value.type])
        found = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.{suffix}")
        return builder.call(found, [value])

    return emit


def sqrt(x: Any) -> Any:
    """Square root; NaN below 0."""
    return np.sqrt(x)


def floor(x: Any) -> Any:
    """Largest whole number that is not above x."""
    return np.floor(x)


def absolute(x: Any) -> Any:
    """Size of x."""
    return np.abs(x)


_REALS = {F8: F8, types.float64: types.float64}
_unary(sqrt, _REALS, _intrinsic("sqrt"))
_unary(floor, _REALS, _intrinsic("floor"))
_unary(absolute, _REALS, _intrinsic("fabs"))


def to_float(x: Any) -> Any:
    """Nearest double of an unsigned integer."""
    return x.astype(np.float64) if isinstance(x, np.ndarray) else np.float64(x)


def bits_of(x: Any) -> Any:
    """The 64 bits of a double, as an unsigned integer."""
    return _python(np.asarray(x, dtype=np.float64).view(np.uint64))


def from_bits(x: Any) -> Any:
    """The double that has these bits."""
    return _python(np.asarray(x, dtype=np.uint64).view(np.float64))


def _bitcast(builder: Any, value: Any, given: types.Type, result: types.Type) -> Any:
    numbers = {types.float64: ir.DoubleType(), types.uint64: ir.IntType(64)}
    return builder.bitcast(value, _LLVM[result] if result in _LLVM else numbers[result])


def _convert(builder: Any, value: Any, given: types.Type, result: types.Type) -> Any:
    return builder.uitofp(value, _LLVM[F8] if result is F8 else ir.DoubleType())


_TO_REAL = {U8: F8, types.uint64: types.float64}
_unary(to_float, _TO_REAL, _convert)
_unary(from_bits, _TO_REAL, _bitcast)
_unary(bits_of, {real: bits for bits, real in _TO_REAL.items()}, _bitcast)


def select(mask: Any, x: Any, y: Any) -> Any:
    """X in the lanes where a mask holds, y in the others; both are computed."""
    return _python(np.where(mask, x, y))


def _select_kind(mask: types.Type, x: types.Type, y: types.Type) -> types.Type | None:
    if mask is M8:
        numbers = [each for each in (x, y) if not isinstance(each, _Vector)]
        if len(numbers) == 2:
            return F8 if isinstance(x, types.Float) and isinstance(y, types.Float) else None
        return _common(x, y)
    plain = isinstance(mask, types.Boolean) and not {F8, U8, M8} & {x, y}
    if not plain:
        return None
    real = _fits(x, F8) and _fits(y, F8) and any(isinstance(each, types.Float) for each in (x, y))
    return x if x == y else (types.float64 if real else None)


def _emit_select(context: Any, builder: Any, given: Any, values: Any) -> Any:
    kind = _select_kind(*given)
    x, y = (_cast(context, builder, v, t, kind) for v, t in zip(values[1:], given[1:], strict=True))
    mask = values[0]
    if given[0] is not M8 and mask.type.width > 1:
        mask = builder.trunc(mask, ir.IntType(1))
    return builder.select(mask, x, y)


_define(select, _select_kind, _emit_select, 3)


def any_lane(mask: Any) -> bool:
    """Whether a mask holds in any lane."""
    return bool(np.any(mask))


def _emit_any(context: Any, builder: Any, given: Any, values: Any) -> Any:
    if given[0] is not M8:
        return values[0]
    bits = builder.bitcast(values[0], ir.IntType(LANES))
    return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(LANES), 0))


_define(
    any_lane,
    lambda mask: types.boolean if mask is M8 or isinstance(mask, types.Boolean) else None,
    _emit_any,
    1,
)


def rotate_left(x: Any, turn: int) -> Any:
    """Bits of an unsigned integer, turned to the left by 1 to 63."""
    left, right = np.uint64(turn), np.uint64(64 - turn)
    return (x << left) | (x >> right)


def _emit_rotate(context: Any, builder: Any, given: Any, values: Any) -> Any:
    kind = given[0]
    word = _LLVM[U8] if kind is U8 else ir.IntType(64)
    suffix = f"v{LANES}i64" if kind is U8 else "i64"
    turn = _cast(context, builder, values[1], given[1], kind)
    found = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(word, [word, word, word]), f"llvm.fshl.{suffix}"
    )
    return builder.call(found, [values[0], values[0], turn])


_define(
    rotate_left,
    lambda x, turn: x if x in (U8, types.uint64) and isinstance(turn, types.Integer) else None,
    _emit_rotate,
    2,
)


# --- memory ----------------------------------------------------------------------------------


def lanes_of(array: Any) -> int:
    """Lanes of a lane array: 8, or 1 where it holds a single receiver."""
    return 1 if array.ndim == 1 else LANES


def lane(array: Any, row: int, index: int) -> Any:
    """One receiver's value in a row of a lane array."""
    return array[row] if array.ndim == 1 else array[row, index]


def set_lane(array: Any, row: int, index: int, value: Any) -> None:
    """Write one receiver's value in a row of a lane array."""
    if array.ndim == 1:
        array[row] = value
    else:
        array[row, index] = value


def _lane_count(array: types.Type) -> int:
    return 1 if array.ndim == 1 else LANES


def _lane_address(context: Any, builder: Any, given: Any, values: Any) -> Any:
    data = _data(context, builder, given[0], values[0])
    row, index = (context.cast(builder, values[k], given[k], types.intp) for k in (1, 2))
    first = builder.mul(row, ir.Constant(ir.IntType(64), _lane_count(given[0])))
    return builder.gep(data, [builder.add(first, index)])


def _emit_set_lane(context: Any, builder: Any, given: Any, values: Any) -> Any:
    value = context.cast(builder, values[3], given[3], given[0].dtype)
    builder.store(value, _lane_address(context, builder, given, values))
    return context.get_dummy_value()


_define(
    lanes_of,
    lambda array: types.intp if isinstance(array, types.Array) else None,
    lambda context, builder, given, values: ir.Constant(ir.IntType(64), _lane_count(given[0])),
    1,
)
_define(
    lane,
    lambda array, row, index: None if _row_kind(array) is None else array.dtype,
    lambda *lowering: lowering[1].load(_lane_address(*lowering)),
    3,
)
_define(
    set_lane,
    lambda array, row, index, value: None if _row_kind(array) is None else types.none,
    _emit_set_lane,
    4,
)


# --- many arrays as one argument -------------------------------------------------------------


_READ = tuple(
    np.dtype(each).str for each in (np.float64, np.float32, np.int64, np.uint64, np.bool_)
)
"""Types of elements that the functions below read."""


class ArrayTable:
    """Addresses and sizes of C-contiguous arrays, which a kernel takes as one argument.

    To hand an array to compiled code costs as much as some hundred operations; `floats_at` and the
    others make it of its address there.  The table keeps the arrays alive; each has to stay where
    it is.

    `entries` (2 k,) int64, address and number of elements of each.
    """

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
    """Array of a table, (N,) float64."""
    return _array(entries, index, np.float64)


def singles_at(entries: Any, index: int) -> Any:
    """Array of a table, (N,) float32."""
    return _array(entries, index, np.float32)


def integers_at(entries: Any, index: int) -> Any:
    """Array of a table, (N,) int64."""
    return _array(entries, index, np.int64)


def flags_at(entries: Any, index: int) -> Any:
    """Array of a table, (N,) bool."""
    return _array(entries, index, np.bool_)


def rows_at(entries: Any, index: int, like: Any) -> Any:
    """Lane array of a table, float64, as wide as `like`."""
    return _array(entries, index, np.float64, like.ndim == 2)


def words_at(entries: Any, index: int, like: Any) -> Any:
    """Lane array of a table, uint64, as wide as `like`."""
    return _array(entries, index, np.uint64, like.ndim == 2)


def _define_reader(function: Callable[..., Any], element: types.Type, arity: int) -> None:
    def kind_of(*given: types.Type) -> types.Array:
        return types.Array(element, given[2].ndim if arity == 3 else 1, "C")

    def emit(context: Any, builder: Any, given: Any, values: Any) -> Any:
        def number(value: int) -> Any:
            return ir.Constant(ir.IntType(64), value)

        kind = kind_of(*given)
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

    _define(function, kind_of, emit, arity)


_define_reader(floats_at, types.float64, 2)
_define_reader(singles_at, types.float32, 2)
_define_reader(integers_at, types.int64, 2)
_define_reader(flags_at, types.boolean, 2)
_define_reader(rows_at, types.float64, 3)
_define_reader(words_at, types.uint64, 3)
