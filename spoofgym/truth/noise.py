"""Counter-based white noise: any part of a stream, without the parts before it.

Threefry-2x64-20 (`salmon2011` in references.bib) turns a key and a counter into random bits, the
transform of Box and Muller (`boxmuller1958`) turns these into normal deviates.  The key belongs to
one source of one receiver in one episode, the counter gives epoch and number, so that noise
depends neither on the size of a batch or of a block nor on what has been drawn before.  Logarithm,
sine and cosine are the project's own polynomials, which compilers vectorize, with relative errors
below 1e-12.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.compile import inline_njit, njit
from ..core.simd import (
    LANES,
    floor,
    from_bits,
    load_pair,
    pair_lanes,
    rotate_left,
    select,
    splat,
    sqrt,
    store,
    to_float,
    view_bits,
)

_PARITY = np.uint64(0x1BD11BDAA9FC1A22)
_SQRT2 = math.sqrt(2.0)
_LN2 = math.log(2.0)
_LN2_HIGH = 0.6931471803691238
_LN2_LOW = 1.9082149292705877e-10  # ln 2 in two parts; multiples of the first are exact
_DIVISORS = tuple(1.0 / k for k in range(11, 0, -1))
_MANTISSA = np.uint64(0x000FFFFFFFFFFFFF)
_ODD = np.uint64(1)
_UPPER = np.uint64(2)

COUNTERS_OF_ONE = np.arange(2 * LANES, dtype=np.uint64).reshape(2, LANES)
# Counters of the two rows of a pair: of a single receiver, and of eight.
COUNTERS_OF_EIGHT = np.repeat(np.arange(2, dtype=np.uint64), LANES).reshape(2, LANES)
BLOCK = 64  # deviates come in multiples of this many, so that a vectorized loop has no remainder


@inline_njit
def _mix(x: np.uint64, y: np.uint64, turn: int) -> tuple[np.uint64, np.uint64]:
    x = x + y
    return x, rotate_left(y, turn) ^ x


@inline_njit
def _mix_even(x: np.uint64, y: np.uint64) -> tuple[np.uint64, np.uint64]:
    x, y = _mix(x, y, 16)
    x, y = _mix(x, y, 42)
    x, y = _mix(x, y, 12)
    return _mix(x, y, 31)


@inline_njit
def _mix_odd(x: np.uint64, y: np.uint64) -> tuple[np.uint64, np.uint64]:
    x, y = _mix(x, y, 16)
    x, y = _mix(x, y, 32)
    x, y = _mix(x, y, 24)
    return _mix(x, y, 21)


@inline_njit
def threefry(
    x: np.uint64, y: np.uint64, k0: np.uint64, k1: np.uint64
) -> tuple[np.uint64, np.uint64]:
    """Threefry-2x64-20: 128 random bits of a counter under a key. Salmon et al. (2011), section
    3.3. The rounds are written out, since compilers vectorize only a loop without one in it."""
    k2 = k0 ^ k1 ^ _PARITY
    x, y = _mix_even(x + k0, y + k1)
    x, y = _mix_odd(x + k1, y + k2 + np.uint64(1))
    x, y = _mix_even(x + k2, y + k0 + np.uint64(2))
    x, y = _mix_odd(x + k0, y + k1 + np.uint64(3))
    x, y = _mix_even(x + k1, y + k2 + np.uint64(4))
    return x + k2, y + k0 + np.uint64(5)


@inline_njit
def natural_log(x: Any) -> Any:
    r"""Logarithm of a positive normal number.

    With :math:`x = 2^e m`, :math:`m \in [\sqrt{1/2}, \sqrt2)` and :math:`s = (m - 1)/(m + 1)`,

    .. math:: \ln x = e \ln 2 + 2 \sum_{k=0}^{8} \frac{s^{2k + 1}}{2k + 1}
    """
    bits = view_bits(x)
    e = to_float(bits >> np.uint64(52)) - 1023.0
    m = from_bits((bits & _MANTISSA) | np.uint64(0x3FF0000000000000))
    high = m > _SQRT2
    m = select(high, 0.5 * m, m)
    e = select(high, e + 1.0, e)
    s = (m - 1.0) / (m + 1.0)
    q = s * s
    p = 1.0 / 13.0 + q * (1.0 / 15.0 + q * (1.0 / 17.0))
    p = 1.0 / 7.0 + q * (1.0 / 9.0 + q * (1.0 / 11.0 + q * p))
    p = 1.0 + q * (1.0 / 3.0 + q * (1.0 / 5.0 + q * p))
    return e * _LN2 + 2.0 * s * p


@inline_njit
def normal_pair(word: np.uint64) -> tuple[float, float]:
    r"""Two independent standard normal deviates of 64 random bits.

    .. math:: \sqrt{-2 \ln u} \, (\cos 2\pi v, \sin 2\pi v)

    with u and v uniform on the middles of 2^32 intervals of (0, 1): Box and Muller (1958).
    """
    x, y = word & np.uint64(0xFFFFFFFF), word >> np.uint64(32)
    radius = sqrt(-2.0 * natural_log((to_float(x) + 0.5) * 2.0**-32))
    # the upper two bits of y choose the quadrant, the others an angle within +- pi/4 of its middle
    quadrant = y >> np.uint64(30)
    t = (to_float(y & np.uint64(0x3FFFFFFF)) + 0.5) * (0.5 * math.pi * 2.0**-30) - 0.25 * math.pi
    q = t * t
    sine = 1.0 / 5040.0 - q * (1.0 / 362880.0 - q * (1.0 / 39916800.0 - q * (1.0 / 6227020800.0)))
    sine = t * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0 - q * sine)))
    cosine = 1.0 / 40320.0 - q * (
        1.0 / 3628800.0 - q * (1.0 / 479001600.0 - q * (1.0 / 87178291200.0))
    )
    cosine = 1.0 - q * (0.5 - q * (1.0 / 24.0 - q * (1.0 / 720.0 - q * cosine)))
    odd = (quadrant & _ODD) == _ODD
    upper = (quadrant & _UPPER) == _UPPER
    a = select(odd, sine, cosine)
    b = select(odd, cosine, sine)
    signed_a = select(odd ^ upper, -radius, radius)
    return signed_a * a, select(upper, -radius, radius) * b


@inline_njit
def to_integer(x: Any) -> Any:
    """The unsigned integer that a whole number from 0 to 2^52 is."""
    return view_bits(x + 2.0**52) & _MANTISSA


@inline_njit
def write_deviates(
    counter: np.uint64,
    epoch: np.uint64,
    k0: np.uint64,
    k1: np.uint64,
    q: int,
    n: int,
    both: bool,
    out: NDArray[np.float64],
) -> None:
    """Write what one counter gives into the rows q and n + q, and where `both`, two more."""
    x, y = threefry(counter, epoch, k0, k1)
    a, b = normal_pair(x)
    store(out, q, a)
    store(out, n + q, b)
    if both:
        a, b = normal_pair(y)
        store(out, 2 * n + q, a)
        store(out, 3 * n + q, b)


@njit
def deviates(
    k0: np.uint64, k1: np.uint64, epoch: np.uint64, size: int, count: int, out: NDArray[np.float64]
) -> None:
    """Write the first standard normal deviates of one epoch into the rows of a lane array.

    `k0`, `k1`, `epoch`: key and counter, a number or a vector of one a lane; `size`: a multiple of
    `BLOCK`, how many the epoch has, which says where in the stream each lies; `count`: how many are
    wanted; rows behind them may be written, too.

    Counter q gives the deviates q, n + q, 2 n + q and 3 n + q, n = `size` / 4. Two rows of them are
    computed side by side; those of a single receiver have eight counters each.
    """
    n = size // 4
    both = count > 2 * n
    if out.ndim == 1:
        rows, each, ahead = out.reshape((out.shape[0] // LANES, LANES)), LANES, COUNTERS_OF_ONE
        k0, k1, epoch = splat(k0, rows), splat(k1, rows), splat(epoch, rows)
    else:
        rows, each, ahead = out, 1, COUNTERS_OF_EIGHT
    k0, k1, epoch = pair_lanes(k0), pair_lanes(k1), pair_lanes(epoch)
    counters, n = load_pair(ahead, 0), n // each
    for q in range(0, min(n, -(-count // each)), 2):
        write_deviates(counters + np.uint64(each * q), epoch, k0, k1, q, n, both, rows)


@njit
def normals(k0: np.uint64, k1: np.uint64, epoch: int, out: NDArray[np.float64]) -> None:
    """Fill an array with the standard normal deviates of one epoch. `out` (N,), N a multiple of
    `BLOCK`, written."""
    deviates(k0, k1, np.uint64(epoch), out.shape[0], out.shape[0], out)


@inline_njit
def exponential(x: Any) -> Any:
    r"""Exponential function of a number that is not above 0; 0 below -708.

    With :math:`x = k \ln 2 + r`, :math:`|r| \le \ln 2 / 2`: the Taylor series of :math:`e^r` up to
    the 13th power, and :math:`2^k` by its bits.  It has the same bits on any processor.
    """
    k = floor(x * (1.0 / _LN2) + 0.5)
    k = select(k > -1022.0, k, -1022.0)
    r = (x - k * _LN2_HIGH) - k * _LN2_LOW
    p = 1.0 + r * (1.0 / 12.0) * (1.0 + r * (1.0 / 13.0))
    for divisor in _DIVISORS:
        p = 1.0 + r * divisor * p
    power = from_bits(view_bits(k + (1023.0 + 2.0**52)) << np.uint64(52))
    return select(x > -708.0, p * power, 0.0)


def pad_count(count: int) -> int:
    return -(-count // BLOCK) * BLOCK
