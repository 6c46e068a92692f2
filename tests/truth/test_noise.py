"""Random bits against published answers, deviates against the normal distribution."""

import math
from itertools import combinations

import numpy as np
import pytest
import scipy.stats
from hypothesis import example, given
from hypothesis import strategies as st

from spoofgym.core.compile import njit
from spoofgym.core.simd import LANES, from_bits, load, store
from spoofgym.truth.noise import (
    BLOCK,
    exponential,
    natural_log,
    normal_pair,
    normals,
    pad_count,
    threefry,
    to_integer,
)

from ..lanes import in_all_lanes

WORDS = st.integers(0, 2**64 - 1)


def draw(key, epoch, count=16 * BLOCK):
    out = np.empty(count)
    normals(np.uint64(key[0]), np.uint64(key[1]), epoch, out)
    return out


@pytest.mark.nojit
@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [
        ((0, 0), (0, 0), (0xC2B6E3A8C2C69865, 0x6F81ED42F350084D)),
        ((2**64 - 1,) * 2, (2**64 - 1,) * 2, (0xE02CB7C4D95D277A, 0xD06633D0893B8B68)),
        (
            (0x243F6A8885A308D3, 0x13198A2E03707344),
            (0xA4093822299F31D0, 0x082EFA98EC4E6C89),
            (0x263C7D30BB0F0AF1, 0x56BE8361D3311526),
        ),
    ],
)
def test_threefry_gives_the_known_answers(counter, key, answer):
    """The vectors of Random123, the authors' own library, for threefry2x64 with 20 rounds."""
    with np.errstate(over="ignore"):  # plain Python says when unsigned words wrap around
        words = threefry(*(np.uint64(word) for word in (*counter, *key)))
    assert tuple(map(int, words)) == answer


@pytest.mark.nojit
@given(st.floats(2.3e-308, 1.7e308), st.floats(-1e-3, 1e-3), st.integers(-32, 32))
def test_the_logarithm_is_right(x, y, power):
    for each in (x, 1.0 + y):
        assert natural_log(each) == pytest.approx(math.log(each), rel=1e-12, abs=1e-300)
    assert natural_log(2.0**power) == pytest.approx(power * math.log(2.0), rel=1e-15)


@given(WORDS)
@example(0)
@example(2**32 - 1)
@example(0xFFFFFFFF00000000)
@example(2**64 - 1)
def test_a_pair_is_that_of_box_and_muller(word):
    x, y = word & 0xFFFFFFFF, word >> 32
    radius = math.sqrt(-2.0 * math.log((x + 0.5) * 2.0**-32))
    fraction = ((y & 0x3FFFFFFF) + 0.5) * 2.0**-30
    angle = 0.5 * math.pi * ((y >> 30) + fraction - 0.5)
    expected = (radius * math.cos(angle), radius * math.sin(angle))
    assert normal_pair(np.uint64(word)) == pytest.approx(expected, rel=1e-11, abs=1e-11)


@pytest.fixture(scope="module")
def sample():
    return np.array([draw((1, 2), epoch) for epoch in range(256)])


def test_deviates_are_normal_and_independent_within_an_epoch_and_from_epoch_to_epoch(sample):
    assert scipy.stats.kstest(sample.ravel(), "norm").pvalue > 1e-3
    for part in np.split(sample, 4, axis=1):  # each of the four that one counter gives
        assert scipy.stats.kstest(part.ravel(), "norm").pvalue > 1e-3
    beyond = int((np.abs(sample) > 4.0).sum())
    expected = sample.size * 2.0 * scipy.stats.norm.sf(4.0)
    assert abs(beyond - expected) < 4.0 * math.sqrt(expected)
    for one, other in combinations(np.split(sample, 4, axis=1), 2):
        assert uncorrelated(one, other)
    for lag in (1, 2, 3, 64, 255):
        assert uncorrelated(sample[:, lag:], sample[:, :-lag])
    for lag in (1, 2, 128):
        assert uncorrelated(sample[lag:], sample[:-lag])
    for key in ((1, 3), (0, 2), (2, 1), (1 + 2**63, 2)):
        assert uncorrelated(sample, np.array([draw(key, epoch) for epoch in range(256)]))


def uncorrelated(a, b):
    bound = 4.5 / math.sqrt(a.size)
    return all(
        abs(np.corrcoef(f(a).ravel(), f(b).ravel())[0, 1]) < bound for f in (np.asarray, np.square)
    )


def test_a_shorter_draw_uses_the_same_words():
    longer, shorter = draw((5, 6), 7, 4 * BLOCK), draw((5, 6), 7, BLOCK)
    n, m = BLOCK, BLOCK // 4
    for part in range(4):
        np.testing.assert_array_equal(
            shorter[part * m : (part + 1) * m], longer[part * n : part * n + m]
        )


@pytest.mark.nojit
@given(st.floats(-707.9, 0.0))
@example(-999.0 * math.log(2.0))
def test_the_exponential_function_is_right(x):
    """To the rounding of k ln 2, which is exact, and of thirteen terms."""
    assert exponential(x) == pytest.approx(math.exp(x), rel=4e-16)


@pytest.mark.nojit
def test_the_exponential_function_at_its_ends():
    assert exponential(0.0) == exponential(-0.0) == exponential(-1e-300) == 1.0
    with np.errstate(all="ignore"):
        for x in (-708.001, -1e300, -math.inf):
            assert exponential(np.float64(x)) == 0.0


@njit
def functions_of(numbers, words, out):
    x, y = threefry(load(words, 0), load(words, 1), load(words, 2), load(words, 3))
    store(out, 0, from_bits(x))
    store(out, 1, from_bits(y))
    a, b = normal_pair(load(words, 0))
    store(out, 2, a)
    store(out, 3, b)
    store(out, 4, natural_log(load(numbers, 0)))
    store(out, 5, exponential(load(numbers, 1)))


@pytest.mark.nojit
def test_functions_are_the_same_in_any_lane():
    rng = np.random.default_rng(0)
    edges = np.array([0, 1, 2**32 - 1, 2**32, 2**63, 2**64 - 1, 2**30, 3 << 30], dtype=np.uint64)
    with np.errstate(over="ignore"):
        for part in range(20):
            words = rng.integers(0, 2**64, (4, LANES), dtype=np.uint64, endpoint=False)
            words[0] = edges if part == 0 else words[0]
            numbers = np.stack([10.0 ** rng.uniform(-300, 300, LANES), rng.uniform(-800.0, 0.0, 8)])
            numbers[1, :3] = (0.0, -0.0, -1e-9) if part == 0 else numbers[1, :3]
            out = np.full((6, LANES), np.nan)
            in_all_lanes(functions_of, numbers, words, out)
            for i in range(LANES):
                x, y = threefry(*words[:, i])
                want = [np.uint64(x).view(np.float64), np.uint64(y).view(np.float64)]
                want += [*normal_pair(words[0, i]), natural_log(numbers[0, i])]
                want.append(exponential(numbers[1, i]))
                assert out[:, i].tobytes() == np.array(want).tobytes()


@njit
def words_of(numbers, out):
    store(out, 0, from_bits(to_integer(load(numbers, 0))))


@pytest.mark.nojit
@given(st.lists(st.integers(0, 2**52 - 1), min_size=LANES, max_size=LANES))
def test_whole_numbers_become_words(given):
    numbers, out = np.array([given], dtype=np.float64), np.zeros((1, LANES))
    in_all_lanes(words_of, numbers, out)
    assert out[0].view(np.uint64).tolist() == given


@given(st.integers(0, 10_000))
def test_draws_are_padded_to_blocks(count):
    length = pad_count(count)
    assert length % BLOCK == 0
    assert count <= length < count + BLOCK
