r"""SRV-RAIM: two groups of satellites, separated by the directions of their residual vectors.

Residuals of the fit to all satellites are made vectors along the rows of the geometry.  Those of
authentic and of spoofed satellites point to different sides of space, so that along one of 40
directions the five largest or the five smallest are likely of one kind; five that agree are a
seed, which takes in whatever agrees with it, and what is left over has to agree, too.  Some 20 fits
are enough, where a search of all subsets takes thousands.

.. math:: \mathrm{SRV}_i = r_i g_i, \qquad p_i(v) = v^T \mathrm{SRV}_i, \qquad
    \mathrm{SSE}(S) = \sqrt{\frac{r_S^T r_S}{|S| - 4}} < \mathrm{TH}(|S|) =
    \sigma \sqrt{\frac{\chi^2_p(|S| - 4)}{|S| - 4}}

Symbols: r residuals of the fit to all satellites, g rows (-u, 1) of the geometry, v search vectors,
r_S residuals of a fit to the subset S, :math:`\sigma` noise of a pseudorange, p confidence.

Assumptions: spoofed satellites agree on one position and clock; noise is white and Gaussian.  Which
group is authentic is not decided: the first one is that which was found first.  It was made for 12
satellites; with uniformly drawn subsets and errors of the paper it is right in some 80 % of the
cases with 10 satellites and in half with 8, and with fewer than 10 a second group of less than 5
is accepted untested.

Deviations from `wu2024`:

1. The growth of the seed (steps 12 to 19 of the printed algorithm) is repeated until a pass adds
   nothing; the printed single pass gives nearly twice the false separations of the paper's table 5
   with one spoofed satellite.
2. The detector searches only after an alarm of all satellites in view, with a false-alarm
   probability of its own; ``false_alarm = 0.05`` is the paper's confidence.
3. Step 39, whether the groups stay consistent for some seconds, is left out, as in the paper.
4. With fewer than 5 satellites, or a singular geometry, there is no verdict: statistic 0.

The search vectors belong to axes: groups found in ECEF and in north-east-down axes may differ, and
the latter serve for any local frame, whose axes are the same but for order and sign.

Source: `wu2024`, algorithm 1, eqs. 9, 15, 20 to 23.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._jit import njit
from ..._registry import check_choice
from ...receiver.least_squares import (
    PRODUCTS,
    add,
    solve,
    squared_residual,
    squared_residual_of_both,
)
from .base import ConsistencyTest
from .consistency import (
    FRAMES,
    MIN_SATELLITES,
    Partition,
    SearchData,
    check_test,
    checked_rows,
    fit_thresholds,
    partition_of,
)

FloatArray = NDArray[np.float64]

SEED = 5
"""Satellites of a seed: the least number that can disagree."""


def search_vectors() -> FloatArray:
    r"""The 40 vectors of S3, in the order of the paper: S1 are the first 12, S2 the first 24.

    Returns (40, 4) all vectors of :math:`\{-1, 0, 1\}^4` but 0, one of every pair v, -v.

    Examples
    --------
    >>> from spoofgym.detectors.raim.residual_vectors import search_vectors
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


SEARCH_VECTORS = search_vectors()


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
    """Projections of the residual vectors, and their order. `lines`, `residual` (N, 3), (N,) g and
    r [m]; `vectors` (V, 4) search vectors; `projection` (N,), written [m]; `order` (N,), written:
    rows by falling projection, equal ones by index."""
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
    """Test a seed, let it grow, and test what is left. `table` (N + 1, PRODUCTS) products; `limit`:
    limit of s^2 by number of satellites [m^2]; `order` (N,) rows by projection; `sums` (1,
    PRODUCTS) scratch."""
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
    """Search two groups that agree. `n`: number of satellites, at least 5, of a geometry that isn't
    singular; `limit` (N + 1,) limit of s^2 by number of satellites [m^2]; `vectors` (V, 4) search
    vectors; `order` (N,) scratch; `scratch` (3, at least N and PRODUCTS) scratch; returns
    `positionings`: number of fits, that of all in view included."""
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


@njit
def search_all(data: SearchData, limit: FloatArray, vectors: FloatArray) -> None:
    """Search in all receivers with an alarm, as `search` does."""
    n = data.slots.shape[1]
    order, scratch = np.empty(n, dtype=np.int64), np.empty((3, max(n, PRODUCTS)))
    for b in range(data.alarm.shape[0]):
        if data.alarm[b]:
            data.found[b], data.mask[b], data.positionings[b] = search(
                data.rows[b],
                data.lines[b],
                data.offsets[b],
                data.table[b],
                limit,
                vectors,
                order,
                scratch,
            )


def srv_raim(
    line_of_sight: ArrayLike, offset: ArrayLike, sigma_m: float, confidence: float = 0.95
) -> Partition:
    """Two groups of satellites that each agree, by their residual vectors. `line_of_sight` (n, 3)
    unit vectors to the satellites, in the axes that the search vectors belong to; `offset` (n,)
    pseudorange minus predicted range [m]; what isn't finite is left out; `sigma_m`: noise of a
    pseudorange [m]; `confidence`: probability that satellites that agree pass for it, in (0, 1)."""
    check_test(sigma_m, confidence)
    data, _ = checked_rows(line_of_sight, offset)
    limit = fit_thresholds(sigma_m, 1.0 - confidence, data.slots.shape[1])
    search_all(data, limit, SEARCH_VECTORS)
    return partition_of(data, len(np.asarray(offset)))


@dataclass
class SrvRaim(ConsistencyTest):
    """Residual test of all satellites in view; after an alarm, two groups by residual vectors.

    Parameters
    ----------
    sigma_m : float or None
        Noise of a pseudorange [m]; None takes what the receiver assumes.
    confidence : float
        Probability that satellites that agree pass for it in the search, in (0, 1).
    false_alarm : float
        Probability of an alarm in one epoch, in (0, 1).
    frame : {"ned", "ecef"}
        Axes of the search vectors.
    exclude : bool
        Give the second group weights 0, pseudoranges and range rates, as long as the alarm lasts.
        It may be the authentic one.

    Notes
    -----
    ``memory["group"]`` is (B, n): 1 and 2 for the groups, all 1 without an alarm, and 0 for what
    is not known: no verdict, or nothing found.
    """

    described_as = "SrvRaim"
    sigma_m: float | None = None
    confidence: float = 0.95
    false_alarm: float = 1e-5
    frame: str = "ned"
    exclude: bool = False

    paper: ClassVar[str] = "wu2024"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("frame", self.frame, FRAMES)

    def search(self, data: SearchData) -> None:
        search_all(data, self._limit, SEARCH_VECTORS)
