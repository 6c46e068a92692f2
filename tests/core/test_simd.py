"""Explicit vectors: every operator and function against NumPy, in all four ways of running it."""

from __future__ import annotations

import operator

import numba
import numpy as np
import pytest
from numba.core.errors import TypingError

from spoofgym.core.compile import inline_njit, njit
from spoofgym.core.simd import (
    LANES,
    ArrayTable,
    absolute,
    any_lane,
    count_lanes,
    flags_at,
    floats_at,
    floor,
    from_bits,
    integers_at,
    lane,
    load,
    load_pair,
    pair_lanes,
    rotate_left,
    rows_at,
    select,
    set_lane,
    singles_at,
    splat,
    sqrt,
    store,
    to_float,
    view_bits,
    words_at,
)

REALS = np.array(
    [
        [0.0, -0.0, 1.5, -2.5, np.nan, np.inf, -np.inf, 5e-324],
        [-0.0, -0.0, 1.5, np.nan, np.nan, np.inf, 0.0, 1.7e308],
        [1.0 / 3.0, -1e308, 2.5, -0.5, 1e-320, -7.0, 2.0**53 + 2.0, -np.nan],
    ]
)
WORDS = np.array(
    [
        [0, 1, 2**64 - 1, 2**63, 0x0123456789ABCDEF, 2**53 + 1, 2**32 - 1, 3],
        [2**64 - 1, 1, 2**63, 2**63 - 1, 7, 2**53 + 1, 2**64 - 2, 0],
    ],
    dtype=np.uint64,
)
SHIFTS = np.array([0, 1, 63, 52, 32, 7, 30, 16], dtype=np.uint64)
REAL, WORD = -2.5, np.uint64(2**63 + 5)
COMPILED = not numba.config.DISABLE_JIT
WAYS = [(compiled, lanes) for compiled in (True, False) for lanes in (LANES, 1)]

pytestmark = pytest.mark.nojit


@pytest.fixture(params=WAYS, ids=lambda way: f"{'compiled' if way[0] else 'python'}-{way[1]}")
def way(request):
    return request.param


def run(way, kernel, rows, given, *more):
    """(rows, 8) reals that a kernel writes, all lanes at once or one after the other."""
    compiled, lanes = way
    kernel = kernel if compiled else getattr(kernel, "py_func", kernel)
    with np.errstate(all="ignore"):
        if lanes == LANES:
            out = np.full((rows, LANES), 99.0)
            kernel(*given, *more, out)
            return out
        columns = []
        for index in range(LANES):
            out = np.full(rows, 99.0)
            kernel(*(np.ascontiguousarray(array[:, index]) for array in given), *more, out)
            columns.append(out)
        return np.stack(columns, axis=1)


def same_bits(got, expected):
    """Equal, signs of zeros included; any NaN is as good as another."""
    expected = np.broadcast_to(np.asarray(expected, dtype=np.float64), got.shape)
    nan = np.isnan(expected)
    np.testing.assert_array_equal(np.isnan(got), nan)
    np.testing.assert_array_equal(got[~nan].view(np.uint64), expected[~nan].view(np.uint64))


def same_words(got, expected):
    np.testing.assert_array_equal(got.view(np.uint64), np.asarray(expected, dtype=np.uint64))


# --- operators -------------------------------------------------------------------------------


@njit
def arithmetic(x, k, out):
    a, b, c = load(x, 0), load(x, 1), load(x, 2)
    store(out, 0, a + b)
    store(out, 1, a - b)
    store(out, 2, a * b)
    store(out, 3, c / b)
    store(out, 4, -a)
    store(out, 5, c + k)
    store(out, 6, k + c)
    store(out, 7, c - k)
    store(out, 8, k - c)
    store(out, 9, c * k)
    store(out, 10, k * c)
    store(out, 11, c / k)
    store(out, 12, k / c)
    store(out, 13, 3 * c - 7)  # whole numbers, too
    d = c
    d += b
    store(out, 14, d)
    d = c
    d -= b
    store(out, 15, d)
    d = c
    d *= b
    store(out, 16, d)
    d = c
    d /= b
    store(out, 17, d)
    d = c
    d += k
    d -= 1.0
    d *= 2.0
    d /= k
    store(out, 18, d)
    store(out, 19, c)  # which none of these has changed


def test_arithmetic_of_reals(way):
    a, b, c = REALS
    k = REAL
    got = run(way, arithmetic, 20, [REALS], k)
    with np.errstate(all="ignore"):
        expected = [
            np.add(a, b),
            np.subtract(a, b),
            np.multiply(a, b),
            np.divide(c, b),
            np.negative(a),
            np.add(c, k),
            np.add(k, c),
            np.subtract(c, k),
            np.subtract(k, c),
            np.multiply(c, k),
            np.multiply(k, c),
            np.divide(c, k),
            np.divide(k, c),
            np.subtract(np.multiply(3, c), 7),
            np.add(c, b),
            np.subtract(c, b),
            np.multiply(c, b),
            np.divide(c, b),
            np.divide(np.multiply(np.subtract(np.add(c, k), 1.0), 2.0), k),
            c,
        ]
    same_bits(got, expected)


@njit
def comparisons(x, k, out):
    a, b = load(x, 0), load(x, 1)
    store(out, 0, select(a > b, 1.0, 0.0))
    store(out, 1, select(a >= b, 1.0, 0.0))
    store(out, 2, select(a < b, 1.0, 0.0))
    store(out, 3, select(a <= b, 1.0, 0.0))
    store(out, 4, select(a == b, 1.0, 0.0))
    store(out, 5, select(a != b, 1.0, 0.0))
    store(out, 6, select(a > k, 1.0, 0.0))
    store(out, 7, select(a >= k, 1.0, 0.0))
    store(out, 8, select(a < k, 1.0, 0.0))
    store(out, 9, select(a <= k, 1.0, 0.0))
    store(out, 10, select(a == k, 1.0, 0.0))
    store(out, 11, select(a != k, 1.0, 0.0))
    store(out, 12, select(k > a, 1.0, 0.0))
    store(out, 13, select(k >= a, 1.0, 0.0))
    store(out, 14, select(k < a, 1.0, 0.0))
    store(out, 15, select(k <= a, 1.0, 0.0))
    store(out, 16, select(k == a, 1.0, 0.0))
    store(out, 17, select(k != a, 1.0, 0.0))


COMPARED = [operator.gt, operator.ge, operator.lt, operator.le, operator.eq, operator.ne]


@pytest.mark.parametrize(
    ("given", "number"), [(REALS, REAL), (WORDS, WORD)], ids=["reals", "words"]
)
def test_comparisons(way, given, number):
    """None holds of NaN but !=; words have no sign."""
    pairs = [(given[0], given[1]), (given[0], number), (number, given[0])]
    expected = [compare(x, y).astype(float) for x, y in pairs for compare in COMPARED]
    same_bits(run(way, comparisons, 18, [given], number), expected)


@njit
def words(x, shifts, k, out):
    a, b, by = load(x, 0), load(x, 1), load(shifts, 0)
    store(out, 0, from_bits(a + b))
    store(out, 1, from_bits(a - b))
    store(out, 2, from_bits(a ^ b))
    store(out, 3, from_bits(a | b))
    store(out, 4, from_bits(a & b))
    store(out, 5, from_bits(a << by))
    store(out, 6, from_bits(a >> by))
    store(out, 7, from_bits(a + k))
    store(out, 8, from_bits(k - a))
    store(out, 9, from_bits(k ^ a))
    store(out, 10, from_bits(a | k))
    store(out, 11, from_bits(k & a))
    store(out, 12, from_bits(a << np.uint64(17)))
    store(out, 13, from_bits(k >> by))
    c = a
    c += b
    c ^= k
    store(out, 14, from_bits(c))
    c = a
    c -= k
    c |= b
    store(out, 15, from_bits(c))
    c = a
    c &= b
    store(out, 16, from_bits(c))
    store(out, 17, from_bits(a))


def test_operations_on_words(way):
    """They wrap around."""
    (a, b), k = WORDS, WORD
    got = run(way, words, 18, [WORDS, SHIFTS[None]], k)
    with np.errstate(over="ignore"):
        expected = [
            np.add(a, b),
            np.subtract(a, b),
            np.bitwise_xor(a, b),
            np.bitwise_or(a, b),
            np.bitwise_and(a, b),
            np.left_shift(a, SHIFTS),
            np.right_shift(a, SHIFTS),
            np.add(a, k),
            np.subtract(k, a),
            np.bitwise_xor(k, a),
            np.bitwise_or(a, k),
            np.bitwise_and(k, a),
            np.left_shift(a, np.uint64(17)),
            np.right_shift(k, SHIFTS),
            np.bitwise_xor(np.add(a, b), k),
            np.bitwise_or(np.subtract(a, k), b),
            np.bitwise_and(a, b),
            a,
        ]
    same_words(got, expected)


@njit
def masks(x, truth, out):
    a, b = load(x, 0) > 0.0, load(x, 1) > 0.0
    store(out, 0, select(a & b, 1.0, 0.0))
    store(out, 1, select(a | b, 1.0, 0.0))
    store(out, 2, select(a ^ b, 1.0, 0.0))
    store(out, 3, select(a & truth, 1.0, 0.0))
    store(out, 4, select(truth | a, 1.0, 0.0))
    store(out, 5, select(a ^ truth, 1.0, 0.0))
    c = a
    c &= b
    store(out, 6, select(c, 1.0, 0.0))
    c = a
    c |= b
    store(out, 7, select(c, 1.0, 0.0))
    c = a
    c ^= b
    store(out, 8, select(c, 1.0, 0.0))
    store(out, 9, 1.0 if any_lane(a) else 0.0)
    store(out, 10, 1.0 if any_lane(a & b) else 0.0)


@pytest.mark.parametrize("truth", [True, False])
@pytest.mark.parametrize("number", range(4))
def test_masks(way, truth, number):
    x = np.random.default_rng(number).choice([-1.0, 1.0, np.nan], (2, LANES))
    x[number % 2] = -1.0 if number < 2 else x[number % 2]  # one that holds nowhere
    a, b = x > 0.0
    expected = [a & b, a | b, a ^ b, a & truth, a | truth, a ^ truth, a & b, a | b, a ^ b]
    got = run(way, masks, 11, [x], truth)
    np.testing.assert_array_equal(got[:9], np.array(expected, dtype=float))
    for row, mask in ((9, a), (10, a & b)):
        alone = way[1] == 1  # every lane asks for itself
        np.testing.assert_array_equal(got[row], mask if alone else mask.any())


# --- pairs -----------------------------------------------------------------------------------


@inline_njit
def everything(a, b, u, v, by, k, word):
    """All that takes vectors."""
    moved, turned = a, u
    moved += b
    moved -= k
    moved *= 0.5
    moved /= 3.0
    turned ^= v
    turned |= word
    turned &= u + v
    high = (a > b) & (a >= k) | (u < v) ^ (k <= b)
    return (
        (a + b, a - b, a * b, a / b, -a, k - a, a / k),
        (moved, sqrt(a), floor(a), absolute(b), to_float(u), splat(k, a) + a),
        (from_bits(u + v), from_bits(u - v), from_bits(u << by), from_bits(v >> by)),
        (from_bits(turned), from_bits(rotate_left(u, 42)), from_bits(view_bits(a) ^ word)),
        (select(high, a, b), select(a == b, 1.0, 0.0), select(u != v, k, b)),
        (select(a != b, a, k), splat(1.0 if any_lane(a < b) else 0.0, a)),
    )


@njit
def in_pairs(x, w, k, word, out):
    given = load_pair(x, 0), load_pair(x, 2), load_pair(w, 0), load_pair(w, 2), load_pair(w, 4)
    first, second, third, fourth, fifth, sixth = everything(*given, k, word)
    row = 0
    for value in (*first, *second, *third, *fourth, *fifth, *sixth):
        store(out, row, value)
        row += 2


@njit
def in_rows(x, w, k, word, out):
    for r in range(2):
        given = load(x, r), load(x, 2 + r), load(w, r), load(w, 2 + r), load(w, 4 + r)
        first, second, third, fourth, fifth, sixth = everything(*given, k, word)
        row = r
        for value in (*first, *second, *third, *fourth, *fifth, *sixth):
            store(out, row, value)
            row += 2


@pytest.mark.parametrize("compiled", [True, False])
def test_pairs_compute_what_both_rows_do(compiled, monkeypatch):
    """Every operator and function, to the last bit."""
    if not compiled:
        monkeypatch.setitem(globals(), "everything", getattr(everything, "py_func", everything))
    rng = np.random.default_rng(7)
    x = np.concatenate([REALS[:2], rng.standard_normal((2, LANES))])
    w = np.concatenate([WORDS, rng.integers(0, 2**63, (2, LANES)).astype(np.uint64)])
    w = np.concatenate([w, SHIFTS[None], SHIFTS[None, ::-1]])
    found = []
    for kernel in (in_pairs, in_rows):
        out = np.full((50, LANES), 99.0)
        with np.errstate(all="ignore"):
            (kernel if compiled else getattr(kernel, "py_func", kernel))(x, w, REAL, WORD, out)
        found.append(out)
    any_row = slice(48, 50)  # a pair asks for both of its rows
    assert (found[0][any_row] == found[1][any_row].max()).all()
    same_bits(found[0][:48], found[1][:48])
    assert not (found[0] == 99.0).all(axis=1).any()


@njit
def repeated(x, out):
    store(out, 0, pair_lanes(load(x, 0)))
    store(out, 2, load_pair(x, 1) + 1.0)
    store(out, 4, splat(2.0, load_pair(x, 0)))


def test_pairs_of_a_vector_and_of_two_rows():
    x = np.arange(3.0 * LANES).reshape(3, LANES)
    for kernel in (repeated, getattr(repeated, "py_func", repeated)):
        out = np.zeros((6, LANES))
        kernel(x, out)
        np.testing.assert_array_equal(
            out, [x[0], x[0], x[1] + 1.0, x[2] + 1.0, *np.full((2, 8), 2.0)]
        )


# --- functions -------------------------------------------------------------------------------


@njit
def functions(x, k, out):
    a, b, c = load(x, 0), load(x, 1), load(x, 2)
    store(out, 0, sqrt(c))
    store(out, 1, floor(c))
    store(out, 2, absolute(c))
    store(out, 3, sqrt(a))
    store(out, 4, floor(b))
    store(out, 5, absolute(a))
    store(out, 6, select(a > b, a, b))
    store(out, 7, select(a > b, c, k))
    store(out, 8, select(a > b, k, c))
    store(out, 9, select(a > b, k, -k))
    store(out, 10, sqrt(absolute(k)))
    store(out, 11, from_bits(view_bits(a)))
    store(out, 12, from_bits(view_bits(c) ^ np.uint64(2**63)))
    store(out, 13, splat(k, a))
    store(out, 14, splat(k, x))
    store(out, 15, sqrt(splat(2.0, a)))  # of a number in all lanes
    store(out, 16, splat(k, a) * c)


def test_functions_of_reals(way):
    (a, b, c), k = REALS, REAL
    got = run(way, functions, 17, [REALS], k)
    with np.errstate(all="ignore"):
        expected = [
            np.sqrt(c),
            np.floor(c),
            np.abs(c),
            np.sqrt(a),
            np.floor(b),
            np.abs(a),
            np.where(a > b, a, b),
            np.where(a > b, c, k),
            np.where(a > b, k, c),
            np.where(a > b, k, -k),
            np.full(LANES, np.sqrt(-k)),
            a,
            np.negative(c),
            np.full(LANES, k),
            np.full(LANES, k),
            np.full(LANES, np.sqrt(2.0)),
            k * c,
        ]
    same_bits(got, expected)


def test_square_root_and_floor_are_rounded_correctly(way):
    """As NumPy's, which are exact to the last bit on any machine."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        x = rng.standard_normal((3, LANES)) * 10.0 ** rng.integers(-300, 300, (3, LANES))
        x[1] = np.round(rng.normal(0.0, 1e3, LANES) * 2.0) / 2.0
        got = run(way, functions, 17, [x], 1.0)
        with np.errstate(all="ignore"):
            same_bits(
                got[[0, 1, 3, 4]], [np.sqrt(x[2]), np.floor(x[2]), np.sqrt(x[0]), np.floor(x[1])]
            )


@njit
def conversions(x, k, out):
    a, b = load(x, 0), load(x, 1)
    store(out, 0, to_float(a))
    store(out, 1, to_float(b))
    store(out, 2, from_bits(rotate_left(a, 1)))
    store(out, 3, from_bits(rotate_left(a, 21)))
    store(out, 4, from_bits(rotate_left(b, 63)))
    store(out, 5, from_bits(select(a > b, a, b)))
    store(out, 6, from_bits(select(a > b, a, k)))
    store(out, 7, from_bits(splat(k, a)))
    store(out, 8, from_bits(splat(k, x) + a))
    store(out, 9, to_float(a >> np.uint64(11)))


def test_functions_of_words(way):
    (a, b), k = WORDS, WORD

    def turned(x, turn):
        return np.array(
            [(int(w) << turn | int(w) >> (64 - turn)) & (2**64 - 1) for w in x], dtype=np.uint64
        )

    got = run(way, conversions, 10, [WORDS], k)
    same_bits(got[:2], [a.astype(float), b.astype(float)])
    with np.errstate(over="ignore"):
        expected = [
            turned(a, 1),
            turned(a, 21),
            turned(b, 63),
            np.where(a > b, a, b),
            np.where(a > b, a, k),
            np.full(LANES, k),
            a + k,
        ]
    same_words(got[2:9], expected)
    same_bits(got[9], (a >> np.uint64(11)).astype(float))


# --- lane arrays -----------------------------------------------------------------------------


@njit
def rows_and_lanes(x, out):
    last = count_lanes(x) - 1
    store(out, 0, load(x, 2))
    store(out, 1, 7.0)
    store(out, 2, 7)
    set_lane(out, 2, last, lane(x, 1, 0))
    for row in range(3, 5):
        for index in range(count_lanes(x)):
            set_lane(out, row, index, 2.0 * lane(x, row - 3, index))
    store(out, 5, float(count_lanes(out)))
    part = x[1:]  # part of a lane array is one
    store(out, 6, load(part, 0) + load(part, 1))
    store(out, 7, float(part.shape[0]))


def test_rows_and_lanes(way):
    x = np.arange(3.0 * LANES).reshape(3, LANES)
    got = run(way, rows_and_lanes, 8, [x])
    third = np.full(LANES, 7.0)
    if way[1] == LANES:
        third[-1] = x[1, 0]
    else:
        third[:] = x[1]
    lanes = np.full(LANES, float(way[1]))
    expected = [x[2], np.full(LANES, 7.0), third, 2 * x[0], 2 * x[1], lanes, x[1] + x[2]]
    np.testing.assert_array_equal(got, [*expected, np.full(LANES, 2.0)])


@njit
def keep_words(x, out):
    store(out, 0, load(x, 1) ^ load(x, 0))
    store(out, 1, np.uint64(2**64 - 1))
    for index in range(count_lanes(x)):
        set_lane(out, 2, index, lane(x, 0, index))
    store(out, 3, load(out, 2))


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("lanes", [LANES, 1])
def test_rows_of_words(compiled, lanes):
    kernel = keep_words if compiled else getattr(keep_words, "py_func", keep_words)
    x = WORDS if lanes == LANES else WORDS[:, 3].copy()
    out = np.zeros((4, LANES) if lanes == LANES else 4, dtype=np.uint64)
    kernel(x, out)
    expected = [x[0] ^ x[1], np.full_like(x[0], 2**64 - 1), x[0], x[0]]
    np.testing.assert_array_equal(out, expected)


@njit
def splat_of(x, out):
    out[0] = 1.0
    store(out, 1, splat(2.0, x))


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("rows", [LANES - 1, LANES])
def test_a_single_receiver_with_eight_rows_is_no_vector(compiled, rows):
    kernel = splat_of if compiled else getattr(splat_of, "py_func", splat_of)
    out = np.zeros(2)
    kernel(np.zeros(rows), out)
    np.testing.assert_array_equal(out, [1.0, 2.0])


def test_a_loaded_row_does_not_follow_the_array():
    """A vector is a value; in Python, too, where it is an array."""
    x = np.arange(2.0 * LANES).reshape(2, LANES)
    row = load(x, 1)
    row += 1.0
    np.testing.assert_array_equal(x[1], np.arange(LANES, 2.0 * LANES))
    store(x, 0, row)
    row += 1.0
    np.testing.assert_array_equal(x[0], np.arange(LANES, 2.0 * LANES) + 1.0)


# --- many arrays as one argument -------------------------------------------------------------


@njit
def read_table(table, like, out):
    floats, integers, flags = floats_at(table, 0), integers_at(table, 1), flags_at(table, 2)
    rows, keys = rows_at(table, 3, like), words_at(table, 4, like)
    out[0], out[1] = floats.shape[0], floats[2]
    out[2], out[3] = integers.shape[0], integers[1]
    out[4], out[5] = flags.shape[0], 1.0 if flags[1] and not flags[0] else 0.0
    out[6], out[7], out[8] = rows.shape[0], lane(rows, 1, 0), count_lanes(rows)
    set_lane(keys, 0, 0, lane(keys, 0, 0) & np.uint64(2**32 - 1))
    out[9], out[10] = keys.shape[0], lane(keys, 0, 0)
    store(rows, 0, load(rows, 1) + 1.0)
    singles = singles_at(table, 5)
    out[11], out[12] = singles.shape[0], singles[1]
    singles[0] = 0.1
    floats[0] = 5.0
    integers[0] = -7
    flags[0] = True
    table_of_two = floats.reshape((2, 2))
    table_of_two[1, 1] = 9.0


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("lanes", [LANES, 1])
def test_a_table_gives_the_arrays_themselves(compiled, lanes):
    kernel = read_table if compiled else getattr(read_table, "py_func", read_table)
    floats, integers, flags = np.arange(4.0), np.array([3, -(2**40)]), np.array([False, True, True])
    rows = np.arange(3.0 * lanes).reshape((3, lanes) if lanes > 1 else 3)
    keys = np.full((2, lanes) if lanes > 1 else 2, 2**63 + 17, dtype=np.uint64)
    singles = np.array([1.0, 0.25, 2.0], dtype=np.float32)
    held = ArrayTable([floats, integers, flags, rows, keys, singles])
    like, out = np.zeros((1, LANES) if lanes > 1 else 1), np.zeros(13)
    kernel(held.entries, like, out)
    np.testing.assert_array_equal(out, [4, 2, 2, -(2**40), 3, 1, 3, lanes, lanes, 2, 17, 3, 0.25])
    np.testing.assert_array_equal(singles, np.array([0.1, 0.25, 2.0], dtype=np.float32))
    np.testing.assert_array_equal(rows[0], rows[1] + 1.0)
    np.testing.assert_array_equal(floats, [5.0, 1.0, 2.0, 9.0])
    np.testing.assert_array_equal(integers, [-7, -(2**40)])
    assert flags.all()


def test_a_table_keeps_its_arrays_alive():
    array = np.zeros(100_000)
    address, held = array.ctypes.data, ArrayTable([array])
    del array
    assert held.arrays[0].ctypes.data == address == held.entries[0]


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (np.zeros((4, 6))[:, ::2], "C-contiguous"),
        (np.zeros((4, 6)).T, "C-contiguous"),
        (np.zeros(3, dtype=np.float16), "float16"),
        (np.zeros(3, dtype=np.int32), "int32"),
        (np.zeros(3, dtype=">f8"), ">f8"),
    ],
)
def test_what_a_table_could_not_read_is_refused(array, said):
    with pytest.raises(ValueError, match=said):
        ArrayTable([np.zeros(3), array])


# --- what does not fit -----------------------------------------------------------------------

F, U = np.zeros((2, LANES)), np.zeros((2, LANES), dtype=np.uint64)
WRONG = {
    "real + word": lambda x, w: load(x, 0) + load(w, 0),
    "word + real number": lambda x, w: load(w, 0) + 1.0,
    "word + signed number": lambda x, w: load(w, 0) + 1,
    "real + truth": lambda x, w: load(x, 0) + True,
    "real + complex": lambda x, w: load(x, 0) + 1j,
    "mask + mask": lambda x, w: (load(x, 0) > 0.0) + (load(x, 1) > 0.0),
    "mask & real": lambda x, w: (load(x, 0) > 0.0) & load(x, 0),
    "mask & word": lambda x, w: (load(x, 0) > 0.0) & load(w, 0),
    "mask & whole number": lambda x, w: (load(x, 0) > 0.0) & 1,
    "real & real": lambda x, w: load(x, 0) & load(x, 1),
    "real << word": lambda x, w: load(x, 0) << load(w, 0),
    "word * word": lambda x, w: load(w, 0) * load(w, 1),
    "word / word": lambda x, w: load(w, 0) / load(w, 1),
    "-word": lambda x, w: -load(w, 0),
    "real // real": lambda x, w: load(x, 0) // load(x, 1),
    "real ** 2": lambda x, w: load(x, 0) ** 2,
    "real > word": lambda x, w: load(x, 0) > load(w, 0),
    "an if of a mask": lambda x, w: 1.0 if load(x, 0) > 0.0 else 2.0,
    "not mask": lambda x, w: not (load(x, 0) > 0.0),
    "select of real and word": lambda x, w: select(load(x, 0) > 0.0, load(x, 0), load(w, 0)),
    "select of whole numbers": lambda x, w: select(load(x, 0) > 0.0, 1, 0),
    "select of word and signed number": lambda x, w: select(x[0, 0] > 0.0, w[0, 0], 1),
    "select by a real": lambda x, w: select(load(x, 0), 1.0, 0.0),
    "select by truth of vector and number": lambda x, w: select(True, load(x, 0), 0.0),
    "root of a word": lambda x, w: sqrt(load(w, 0)),
    "real of a real": lambda x, w: to_float(load(x, 0)),
    "bits of a word": lambda x, w: view_bits(load(w, 0)),
    "real from a real's bits": lambda x, w: from_bits(load(x, 0)),
    "rotated real": lambda x, w: rotate_left(load(x, 0), 3),
    "rotated by a real": lambda x, w: rotate_left(load(w, 0), 3.0),
    "any lane of a real": lambda x, w: any_lane(load(x, 0)),
    "truth in all lanes": lambda x, w: splat(True, load(x, 0)),
    "row by a real": lambda x, w: load(x, 0.0),
    "row of a Fortran array": lambda x, w: load(x.T, 0),
    "row of three dimensions": lambda x, w: load(x.reshape((2, 2, 4)), 0),
    "stored mask": lambda x, w: store(x, 0, load(x, 0) > 0.0),
    "stored word": lambda x, w: store(x, 0, load(w, 0)),
    "stored real": lambda x, w: store(w, 0, load(x, 0)),
    "stored vector in single lanes": lambda x, w: store(np.zeros(2), 0, load(x, 0)),
    "vector in a lane": lambda x, w: set_lane(x, 0, 1, load(x, 0)),
    "too many arguments": lambda x, w: sqrt(load(x, 0), load(x, 1)),
}


@pytest.mark.skipif(not COMPILED, reason="only the compiler knows types")
@pytest.mark.parametrize("name", WRONG)
def test_what_does_not_fit_is_no_valid_type(name):
    with pytest.raises(TypingError):
        numba.njit(WRONG[name])(F, U)


@pytest.mark.skipif(not COMPILED, reason="only the compiler knows types")
@pytest.mark.parametrize("dtype", [np.float32, np.int64, np.bool_])
def test_lane_arrays_are_of_reals_or_words(dtype):
    with pytest.raises(TypingError):
        numba.njit(lambda x: load(x, 0))(np.zeros((2, LANES), dtype=dtype))
