r"""SRV-RAIM's search: seeds along 40 directions of the residual vectors, and what agrees with them.

The algorithm, its symbols and our deviations are told in `spoofgym.detectors.srv_raim`.

Source: `wu2024`, algorithm 1.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._jit import njit
from .fits import (
    PRODUCTS,
    add,
    solve,
    squared_residual,
    squared_residual_of_both,
    tabulate,
)
from .partition import Partition, checked_rows, partition_of
from .raim import MIN_SATELLITES, check_test, fit_thresholds

FloatArray = NDArray[np.float64]

SEED = 5
"""Satellites of a seed: the least number that can disagree."""


def search_vectors() -> FloatArray:
    r"""The 40 vectors of S3, in the order of the paper: S1 are the first 12, S2 the first 24.

    Returns (40, 4) all vectors of :math:`\{-1, 0, 1\}^4` but 0, one of every pair v, -v.

    Examples
    --------
    >>> from spoofgym.receiver.srv_raim import search_vectors
    >>> search_vectors()[[0, 4, 12, 24]]
    array([[1., 0., 0., 0.],
           [1., 1., 1., 1.],
           [1., 1., 0., 0.],
           [1., 1., 1., 0.]])
    """
    pairs = [(0, 1), (1, 2), (2, 3), (0, 2), (1, 3), (0, 3)]
    triples = [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]
    vectors = [np.eye(4)]
    for places in [(0, 1, 2, 3), *pairs, *triples]:
        signs = np.array(list(product((1.0, -1.0), repeat=len(places) - 1)))[:, ::-1]
        block = np.zeros((len(signs), 4))
        block[:, places[0]] = 1.0
        block[:, places[1:]] = signs
        vectors.append(block)
    return np.concatenate(vectors)


@njit
def project(
    n: int,
    lines: FloatArray,
    residual: FloatArray,
    vectors: FloatArray,
    v: int,
    projection: FloatArray,
    order: NDArray[np.int64],
) -> None:
    """Projections of the residual vectors, and their order.

    `lines`, `residual` (N, 3), (N,) g and r [m]; `vectors` (V, 4) search vectors; `projection`
    (N,), written [m]; `order` (N,), written: rows by falling projection, equal ones by index.
    """
    for i in range(n):
        along = vectors[v, 3]
        for j in range(3):
            along += vectors[v, j] * lines[i, j]
        value = along * residual[i]
        projection[i] = value
        k = i
        while k > 0 and projection[order[k - 1]] < value:
            order[k] = order[k - 1]
            k -= 1
        order[k] = i


@njit
def grow(
    n: int,
    table: FloatArray,
    limit: FloatArray,
    order: NDArray[np.int64],
    first: int,
    sums: FloatArray,
) -> tuple[bool, int, int]:
    """Test a seed, let it grow, and test what is left.

    `table` (N + 1, PRODUCTS) products; `limit`: limit of s^2 by number of satellites [m^2]; `order`
    (N,) rows by projection; `sums` (1, PRODUCTS) scratch.
    """
    sums[:] = 0.0
    mask = 0
    for k in range(first, first + SEED):
        mask |= 1 << order[k]
        add(sums, 0, table, order[k], sums, 0)
    if not squared_residual(sums, 0) < limit[SEED]:
        return False, mask, 1
    fits, size, grown = 1, SEED, True
    while grown:
        grown = False
        for k in range(n):
            i = order[k]
            if (mask >> i) & 1:
                continue
            fits += 1
            if squared_residual_of_both(sums, 0, table, i) < limit[size + 1]:
                add(sums, 0, table, i, sums, 0)
                mask |= 1 << i
                size += 1
                grown = True
    if n - size < MIN_SATELLITES:
        return True, mask, fits
    sums[:] = 0.0
    for i in range(n):
        if not (mask >> i) & 1:
            add(sums, 0, table, i, sums, 0)
    return squared_residual(sums, 0) < limit[n - size], mask, fits + 1


@njit
def search(
    n: int,
    lines: FloatArray,
    offsets: FloatArray,
    table: FloatArray,
    limit: FloatArray,
    vectors: FloatArray,
    order: NDArray[np.int64],
    scratch: FloatArray,
) -> tuple[bool, int, int]:
    """Search two groups that agree.

    `n`: number of satellites, at least 5, of a geometry that isn't singular; `limit` (N + 1,) limit
    of s^2 by number of satellites [m^2]; `vectors` (V, 4) search vectors; `order` (N,) scratch;
    `scratch` (3, at least N and PRODUCTS) scratch; returns `positionings`: number of fits, that of
    all in view included.
    """
    projection, solution, sums = scratch[0], scratch[1], scratch[2:]
    solve(table, table.shape[0] - 1, solution)
    for i in range(n):
        offsets[i] -= solution[3]
        for j in range(3):
            offsets[i] -= lines[i, j] * solution[j]
    fits = 1
    for v in range(vectors.shape[0]):
        project(n, lines, offsets, vectors, v, projection, order)
        for side in range(2):
            accepted, mask, more = grow(n, table, limit, order, side * (n - SEED), sums)
            fits += more
            if accepted:
                return True, mask, fits
    return False, 0, fits


def srv_raim(
    line_of_sight: ArrayLike,
    offset: ArrayLike,
    sigma_m: float,
    confidence: float = 0.95,
    vectors: FloatArray | None = None,
) -> Partition:
    """Two groups of satellites that each agree, by their residual vectors.

    `line_of_sight` (n, 3) unit vectors to the satellites, in the axes that the search vectors
    belong to; `offset` (n,) pseudorange minus predicted range [m]; what isn't finite is left out;
    `sigma_m`: noise of a pseudorange [m]; `confidence`: probability that satellites that agree pass
    for it, in (0, 1); `vectors` (V, 4) search vectors, `search_vectors` by default.
    """
    check_test(sigma_m, confidence)
    rows = checked_rows(line_of_sight, offset)
    n = len(rows.slots)
    found = search(
        n,
        rows.lines,
        rows.offsets,
        rows.table,
        fit_thresholds(sigma_m, 1.0 - confidence, n),
        search_vectors() if vectors is None else np.ascontiguousarray(vectors, dtype=np.float64),
        np.empty(n, dtype=np.int64),
        np.empty((3, max(n, PRODUCTS))),
    )
    return partition_of(rows, len(np.asarray(offset)), *found)


@njit
def search_cases(
    lines: FloatArray,
    offsets: FloatArray,
    limit: FloatArray,
    vectors: FloatArray,
    found: NDArray[np.bool_],
    mask: NDArray[np.int64],
    positionings: NDArray[np.int64],
) -> None:
    """Search many sets of pseudoranges of the same geometry, which isn't singular.

    `lines` (n, 3) g, minus the lines of sight; `offsets` (C, n) y [m], finite; overwritten with
    residuals; `limit` (n + 1,) limit of s^2 by number of satellites [m^2]; `vectors` (V, 4) search
    vectors; `found`, `mask`, `positionings` (C,), written, as by `search`.
    """
    n = offsets.shape[1]
    order, scratch = np.empty(n, dtype=np.int64), np.empty((3, max(n, PRODUCTS)))
    table = np.empty((n + 1, PRODUCTS))
    for c in range(offsets.shape[0]):
        tabulate(n, lines, offsets[c], table)
        found[c], mask[c], positionings[c] = search(
            n, lines, offsets[c], table, limit, vectors, order, scratch
        )
