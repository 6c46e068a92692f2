"""How well residual vectors of authentic and spoofed satellites are separated: tables 2, 3 and 4.

The number of hybrids along a direction v counts the authentic satellites that project below the
highest spoofed one, and the spoofed ones above the lowest authentic one: 0 where a plane separates
them, never 1.  The search over directions takes all 4094 sums of residual vectors; as these sum up
to 0, the complement of a set has the opposite direction, and half of them with both signs is
enough.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofgym.core.compile import inline_njit, njit
from spoofgym.detectors.raim import SEED, search_vectors

from .draws import displacements, offsets, subsets
from .geometry import SATELLITES, sky

FloatArray = NDArray[np.float64]

BINS = 5
"""Numbers of hybrids 0, 2, 3, 4 and more."""
SIZES = (12, 24, 40)
"""Of the sets S1, S2, S3."""


@inline_njit
def judge_direction(projection: FloatArray, spoofed: NDArray[np.bool_]) -> tuple[int, int, bool]:
    """What one direction and its opposite say.  `projection`: (n,) of the residual vectors;
    `spoofed`: (n,) bool, of which there are some, but not all.  Returns `forth`, `back` number of
    hybrids along the direction, and along its opposite; `seeded` whether the five largest or the
    five smallest are of one kind."""
    top_s = top_a = -np.inf
    low_s = low_a = np.inf
    for i in range(projection.shape[0]):
        p = projection[i]
        if spoofed[i]:
            top_s, low_s = max(top_s, p), min(low_s, p)
        else:
            top_a, low_a = max(top_a, p), min(low_a, p)
    forth = back = 0
    over_s = under_s = over_a = under_a = 0
    for i in range(projection.shape[0]):
        p = projection[i]
        if spoofed[i]:
            forth += p > low_a
            back += p < top_a
            over_s += p > top_a
            under_s += p < low_a
        else:
            forth += p < top_s
            back += p > low_s
            over_a += p > top_s
            under_a += p < low_s
    return forth, back, max(max(over_s, under_s), max(over_a, under_a)) >= SEED


@njit
def search_sums(
    gram: FloatArray, spoofed: NDArray[np.bool_], projection: FloatArray
) -> tuple[int, int]:
    """Search all directions of S0, until there is nothing more to find. `gram`: (n, n) inner
    products of the residual vectors; `spoofed`: (n,) bool; `projection`: (n,) scratch."""
    n = gram.shape[0]
    projection[:] = 0.0
    hybrids, seeded, held = n, 0, 0
    for count in range(1, 1 << (n - 1)):
        flipped = 0
        while not (count >> flipped) & 1:
            flipped += 1  # Gray's code: one residual vector comes or goes
        held ^= 1 << flipped
        sign = 1.0 if (held >> flipped) & 1 else -1.0
        for i in range(n):
            projection[i] += sign * gram[flipped, i]
        forth, back, seed = judge_direction(projection, spoofed)
        hybrids = min(hybrids, min(forth, back))
        seeded = max(seeded, int(seed))
        if hybrids == 0 and seeded == 1:
            break
    return hybrids, seeded


@njit
def separate_cases(
    lines: FloatArray,
    residual: FloatArray,
    spoofed: NDArray[np.bool_],
    vectors: FloatArray,
    hybrids: NDArray[np.int64],
    hybrids_clock: NDArray[np.int64],
    seeded: NDArray[np.int64],
) -> None:
    """Numbers of hybrids and seeds of many cases. `lines`: (n, 4) rows of the geometry; `residual`,
    `spoofed`: (C, n) [m] and bool; `vectors`: (V, 4) of S3; `hybrids`, `hybrids_clock`: (C,),
    written: least number over S0, and over the clock's axis and its opposite; `seeded`: (C, 2),
    written: whether S0 has a seed, and number of the first vector of S3 that has one, V where there
    is none."""
    n = residual.shape[1]
    gram, p = np.empty((n, n)), np.empty(n)
    inner, along = lines @ lines.T, vectors @ lines.T
    for c in range(residual.shape[0]):
        for i in range(n):
            for j in range(n):
                gram[i, j] = residual[c, i] * residual[c, j] * inner[i, j]
        hybrids[c], seeded[c, 0] = search_sums(gram, spoofed[c], p)
        forth, back, _ = judge_direction(residual[c], spoofed[c])
        hybrids_clock[c] = min(forth, back)
        seeded[c, 1] = vectors.shape[0]
        for v in range(vectors.shape[0]):
            for i in range(n):
                p[i] = residual[c, i] * along[v, i]
            _, _, seed = judge_direction(p, spoofed[c])
            if seed:
                seeded[c, 1] = v
                break


def separate(
    lines: FloatArray, spoofed: NDArray[np.bool_], displacement: FloatArray
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Numbers of hybrids and seeds of noise-free cases.  `lines`: (n, 3) rows of the geometry
    without the clock's column; `spoofed`, `displacement`: (C, n) bool, (C, 4) [m].  Returns
    `hybrids`, `hybrids_clock`, `seeded` (C,), (C,), (C, 2), as by `separate_cases`."""
    G = np.column_stack([lines, np.ones(len(lines))])
    y = offsets(lines, spoofed, displacement)
    residual = np.ascontiguousarray(y - y @ G @ np.linalg.inv(G.T @ G) @ G.T)
    cases = len(spoofed)
    hybrids, clock = np.empty(cases, dtype=np.int64), np.empty(cases, dtype=np.int64)
    seeded = np.empty((cases, 2), dtype=np.int64)
    separate_cases(G, residual, spoofed, search_vectors(), hybrids, clock, seeded)
    return hybrids, clock, seeded


def histogram(hybrids: NDArray[np.int64]) -> FloatArray:
    """Parts of the cases with 0, 2, 3, 4 and more hybrids.  `hybrids`: (C,) numbers of hybrids.
    Returns (5,) sums to 1."""
    bins = np.clip(hybrids - 1, 0, BINS - 1)
    return np.bincount(bins, minlength=BINS) / len(hybrids)


def run_separation(number: int, draws: int, seed: int) -> dict[str, Any]:
    """Tables 2, 3 and 4 in one sky.  `draws`: least number of cases for each number of spoofed
    satellites.  Returns (11, 5) parts by number of hybrids over S0 and along the clock's axis, (11,
    4) parts with a seed in S0 to S3, number of cases."""
    lines, rng = sky(number), np.random.default_rng([seed, number, 2])
    least, clock, seeds, cases = [], [], [], 0
    for count in range(1, SATELLITES):
        spoofed = subsets(SATELLITES, count, draws)
        hybrids, along_clock, seeded = separate(lines, spoofed, displacements(rng, lines, spoofed))
        least.append(histogram(hybrids))
        clock.append(histogram(along_clock))
        seeds.append([seeded[:, 0].mean(), *(np.mean(seeded[:, 1] < size) for size in SIZES)])
        cases += len(spoofed)
    return {
        "hybrids": np.array(least),
        "hybrids_clock": np.array(clock),
        "seeded": np.array(seeds),
        "cases": cases,
    }
