"""Explicit vectors: every operator and function against NumPy, in all four ways of running it."""

import types

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

pytestmark = pytest.mark.nojit


@inline_njit
def compared(a, b, k):
    first = (select(a > b, 1.0, 0.0), select(a >= b, 1.0, 0.0), select(a < b, 1.0, 0.0))
    second = (select(a <= b, 1.0, 0.0), select(a == b, 1.0, 0.0), select(a != b, 1.0, 0.0))
    third = (select(a > k, 1.0, 0.0), select(a >= k, 1.0, 0.0), select(a < k, 1.0, 0.0))
    fourth = (select(a <= k, 1.0, 0.0), select(a == k, 1.0, 0.0), select(a != k, 1.0, 0.0))
    fifth = (select(k > a, 1.0, 0.0), select(k >= a, 1.0, 0.0), select(k < a, 1.0, 0.0))
    sixth = (select(k <= a, 1.0, 0.0), select(k == a, 1.0, 0.0), select(k != a, 1.0, 0.0))
    return (*first, *second, *third, *fourth, *fifth, *sixth)


@inline_njit
def everything(a, b, c, u, v, by, k, word, truth):
    d, e, f, g, h = c, c, u, u, u
    d += b
    d -= k
    d *= b
    d /= k
    e += k
    e -= b
    e *= 2.0
    e /= b
    f ^= v
    f |= word
    f += v
    g &= v
    g -= word
    h |= v
    h ^= word
    p, q = a > b, b < c
    l, m, n = p, p, p
    l &= q
    m |= q
    n ^= q
    first = (a + b, a - b, a * b, c / b, -a, c + k, k + c, c - k, k - c, c * k, k * c, c / k, k / c)
    second = (3 * c - 7, d, e, sqrt(c), sqrt(b * b), floor(a), floor(c), absolute(b), absolute(c))
    third = (to_float(u), to_float(u >> np.uint64(11)), splat(k, a), splat(k, a) * c)
    fourth = (select(p, a, b), select(p, c, k), select(p, k, c), select(p, k, -k))
    fifth = (select(u > v, a, k), select(p & q, 1.0, 0.0), select(p | q, 1.0, 0.0))
    sixth = (select(p ^ q, 1.0, 0.0), select(p & truth, 1.0, 0.0), select(truth | p, 1.0, 0.0))
    last = (select(p ^ truth, 1.0, 0.0), select(l, 1.0, 0.0), select(m, 1.0, 0.0), select(n, k, b))
    reals = (*first, *second, *third, *fourth, *fifth, *sixth, *last)
    sums = (u + v, u - v, u ^ v, u | v, u & v, u << by, v >> by, u << np.uint64(17), word >> by)
    more = (u + word, word - u, word ^ u, u | word, word & u, f, g, h, splat(word, u))
    turned = (rotate_left(u, 1), rotate_left(v, 21), rotate_left(u, 63), view_bits(a))
    chosen = (view_bits(from_bits(u)), select(p, u, v), select(u > v, u, word))
    of_reals, of_words = compared(a, b, k), compared(u, v, word)
    return (*reals, *of_reals, *of_words), (*sums, *more, *turned, *chosen)


@njit
def in_pairs(x, w, k, word, truth, out, words_out):
    given = load_pair(x, 0), load_pair(x, 2), load_pair(x, 4), load_pair(w, 0), load_pair(w, 2)
    reals, words = everything(*given, load_pair(w, 4), k, word, truth)
    for row, value in enumerate(reals):
        store(out, 2 * row, value)
    for row, value in enumerate(words):
        store(words_out, 2 * row, value)


@njit
def in_rows(x, w, k, word, truth, out, words_out):
    for r in range(2):
        given = load(x, r), load(x, 2 + r), load(x, 4 + r), load(w, r), load(w, 2 + r)
        reals, words = everything(*given, load(w, 4 + r), k, word, truth)
        for row, value in enumerate(reals):
            store(out, 2 * row + r, value)
        for row, value in enumerate(words):
            store(words_out, 2 * row + r, value)


PLAIN = dict(globals())


def plain(function):
    return types.FunctionType(getattr(function, "py_func", function).__code__, PLAIN)


PLAIN |= {each.__name__: plain(each) for each in (compared, everything)}
each_way = pytest.mark.parametrize("called", [lambda kernel: kernel, plain], ids=["njit", "python"])


def played(kernel, x, w, truth):
    out = [np.full((200, *x.shape[1:]), 99, dtype=each.dtype) for each in (x, w)]
    with np.errstate(all="ignore"):
        kernel(x, w, REAL, WORD, truth, *out)
    return out


def assert_same(found, expected):
    """To the last bit, signs of zeros included; but any NaN is as good as another."""
    for got, wanted in zip(found, expected, strict=True):
        nan = np.isnan(wanted)
        np.testing.assert_array_equal(np.isnan(got), nan)
        np.testing.assert_array_equal(got[~nan].view(np.uint64), wanted[~nan].view(np.uint64))


@each_way
def test_operators_and_functions_are_those_of_numpy_for_rows_pairs_and_single_receivers(called):
    rng = np.random.default_rng(7)
    for number in range(4):
        x = rng.standard_normal((6, LANES)) * 10.0 ** rng.integers(-300, 300, (6, LANES))
        x[3] = np.round(rng.normal(0.0, 1e3, LANES) * 2.0) / 2.0
        w = rng.integers(0, 2**64, (6, LANES), dtype=np.uint64)
        x[::2], w[:4:2], w[4], w[5] = REALS, WORDS, SHIFTS, SHIFTS[::-1]
        expected = played(plain(in_rows), x, w, bool(number % 2))
        for kernel in (in_rows, in_pairs):
            assert_same(played(called(kernel), x, w, bool(number % 2)), expected)
        for i in range(LANES):
            alone = played(called(in_rows), x[:, i].copy(), w[:, i].copy(), bool(number % 2))
            assert_same(alone, [each[:, i] for each in expected])


@njit
def in_vectors(x, out):
    store(out, 0, pair_lanes(load(x, 0)))
    store(out, 2, load_pair(x, 1) + 1.0)
    store(out, 4, splat(2.0, load_pair(x, 0)))
    store(out, 6, 1.0 if any_lane(load(x, 0) > 6.5) else 0.0)
    store(out, 7, 1.0 if any_lane(load(x, 0) > 7.0) else 0.0)
    store(out, 8, 1.0 if any_lane(load_pair(x, 0) > 14.5) else 0.0)
    store(out, 9, 1.0 if any_lane(load_pair(x, 0) > 15.0) else 0.0)


@njit
def rows_and_lanes(x, out):
    store(out, 0, load(x, 2))
    store(out, 1, 7.0)
    store(out, 2, 7)
    set_lane(out, 2, count_lanes(x) - 1, lane(x, 1, 0))
    for row in range(3, 5):
        for index in range(count_lanes(x)):
            set_lane(out, row, index, 2.0 * lane(x, row - 3, index))
    store(out, 5, float(count_lanes(out)))
    part = x[1:]  # part of a lane array is one
    store(out, 6, load(part, 0) + load(part, 1))
    store(out, 7, float(part.shape[0]))
    store(out, 8, splat(sqrt(absolute(-9.0)), x))
    store(out, 9, sqrt(splat(9.0, load(x, 0))))  # of a number in all lanes
    store(out, 10, 1.0 if any_lane(load(x, 0) == 3.0) else 0.0)


@njit
def keep_words(x, out):
    store(out, 0, load(x, 1) ^ load(x, 0))
    store(out, 1, np.uint64(2**64 - 1))
    for index in range(count_lanes(x)):
        set_lane(out, 2, index, lane(x, 0, index))
    store(out, 3, load(out, 2))


@njit
def splat_of(x, out):
    out[0] = 1.0
    store(out, 1, splat(2.0, x))


@each_way
def test_rows_of_reals_and_words_pairs_and_lanes(called):
    x, out = np.arange(3.0 * LANES).reshape(3, LANES), np.zeros((10, LANES))
    called(in_vectors)(x, out)
    expected = [x[0], x[0], x[1] + 1.0, x[2] + 1.0]
    expected += [np.full(LANES, each) for each in (2.0, 2.0, 1.0, 0.0, 1.0, 0.0)]
    np.testing.assert_array_equal(out, expected)
    x, out = np.arange(3.0 * LANES).reshape(3, LANES), np.zeros((11, LANES))
    called(rows_and_lanes)(x, out)
    numbers = [np.full(LANES, each) for each in (7.0, LANES, 2.0, 3.0, 1.0)]
    third = [*numbers[0][1:], x[1, 0]]
    expected = [x[2], numbers[0], third, 2 * x[0], 2 * x[1], numbers[1], x[1] + x[2], numbers[2]]
    np.testing.assert_array_equal(out, [*expected, numbers[3], numbers[3], numbers[4]])
    for i in range(LANES):
        out = np.zeros(11)
        called(rows_and_lanes)(x[:, i].copy(), out)
        a, b, c = x[:, i]
        np.testing.assert_array_equal(out, [c, 7, b, 2 * a, 2 * b, 1, b + c, 2, 3, 3, i == 3])
    for x in (WORDS, WORDS[:, 3].copy()):
        out = np.zeros((4, *x.shape[1:]), dtype=np.uint64)
        called(keep_words)(x, out)
        expected = [x[0] ^ x[1], np.full_like(x[0], 2**64 - 1), x[0], x[0]]
        np.testing.assert_array_equal(out, expected)
    for rows in (LANES - 1, LANES):
        out = np.zeros(2)
        called(splat_of)(np.zeros(rows), out)
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
    floats.reshape((2, 2))[1, 1] = 9.0


@each_way
@pytest.mark.parametrize("lanes", [LANES, 1])
def test_a_table_gives_the_arrays_themselves(called, lanes):
    floats, integers, flags = np.arange(4.0), np.array([3, -(2**40)]), np.array([False, True, True])
    rows = np.arange(3.0 * lanes).reshape((3, lanes) if lanes > 1 else 3)
    keys = np.full((2, lanes) if lanes > 1 else 2, 2**63 + 17, dtype=np.uint64)
    singles = np.array([1.0, 0.25, 2.0], dtype=np.float32)
    held = ArrayTable([floats, integers, flags, rows, keys, singles])
    like, out = np.zeros((1, LANES) if lanes > 1 else 1), np.zeros(13)
    called(read_table)(held.entries, like, out)
    np.testing.assert_array_equal(out, [4, 2, 2, -(2**40), 3, 1, 3, lanes, lanes, 2, 17, 3, 0.25])
    np.testing.assert_array_equal(singles, np.array([0.1, 0.25, 2.0], dtype=np.float32))
    np.testing.assert_array_equal(rows[0], rows[1] + 1.0)
    np.testing.assert_array_equal(floats, [5.0, 1.0, 2.0, 9.0])
    np.testing.assert_array_equal(integers, [-7, -(2**40)])
    assert flags.all()


def test_a_table_keeps_its_arrays_alive_and_refuses_what_it_could_not_read():
    array = np.zeros(100_000)
    address, held = array.ctypes.data, ArrayTable([array])
    del array
    assert held.arrays[0].ctypes.data == address == held.entries[0]
    square = np.zeros((4, 6))
    for array, said in (
        *((square[:, ::2], "C-contiguous"), (square.T, "C-contiguous")),
        *((np.zeros(3, dtype=kind), kind) for kind in ("float16", "int32", ">f8")),
    ):
        with pytest.raises(ValueError, match=said):
            ArrayTable([np.zeros(3), array])


WRONG = {
    "real + word": lambda x, w: load(x, 0) + load(w, 0),
    "word + real number": lambda x, w: load(w, 0) + 1.0,
    "real + truth": lambda x, w: load(x, 0) + True,
    "mask & real": lambda x, w: (load(x, 0) > 0.0) & load(x, 0),
    "real & real": lambda x, w: load(x, 0) & load(x, 1),
    "word * word": lambda x, w: load(w, 0) * load(w, 1),
    "real ** 2": lambda x, w: load(x, 0) ** 2,
    "real > word": lambda x, w: load(x, 0) > load(w, 0),
    "an if of a mask": lambda x, w: 1.0 if load(x, 0) > 0.0 else 2.0,
    "select of real and word": lambda x, w: select(load(x, 0) > 0.0, load(x, 0), load(w, 0)),
    "select by a real": lambda x, w: select(load(x, 0), 1.0, 0.0),
    "select by truth of vector and number": lambda x, w: select(True, load(x, 0), 0.0),
    "root of a word": lambda x, w: sqrt(load(w, 0)),
    "real of a real": lambda x, w: to_float(load(x, 0)),
    "bits of a word": lambda x, w: view_bits(load(w, 0)),
    "rotated real": lambda x, w: rotate_left(load(x, 0), 3),
    "any lane of a real": lambda x, w: any_lane(load(x, 0)),
    "truth in all lanes": lambda x, w: splat(True, load(x, 0)),
    "row by a real": lambda x, w: load(x, 0.0),
    "row of a Fortran array": lambda x, w: load(x.T, 0),
    "stored mask": lambda x, w: store(x, 0, load(x, 0) > 0.0),
    "stored real": lambda x, w: store(w, 0, load(x, 0)),
    "stored vector in single lanes": lambda x, w: store(np.zeros(2), 0, load(x, 0)),
    "vector in a lane": lambda x, w: set_lane(x, 0, 1, load(x, 0)),
    "too many arguments": lambda x, w: sqrt(load(x, 0), load(x, 1)),
    "row in single precision": lambda x, w: load(x.astype(np.float32), 0),
    "row of whole numbers": lambda x, w: load(x.astype(np.int64), 0),
    "row of truths": lambda x, w: load(x.astype(np.bool_), 0),
}


@pytest.mark.skipif(not COMPILED, reason="only the compiler knows types")
@pytest.mark.parametrize("name", WRONG)
def test_what_does_not_fit_is_no_valid_type(name):
    with pytest.raises(TypingError):
        numba.njit(WRONG[name])(np.zeros((2, LANES)), np.zeros((2, LANES), dtype=np.uint64))
