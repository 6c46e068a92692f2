r"""Traversal RAIM's search: all subsets are left out in turn, the smaller ones first.

The algorithm and our deviations are told in `spoofgym.detectors.traversal_raim`.

Source: `wu2024`, section 3.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._jit import njit
from .fits import PRODUCTS, add, squared_residual, squared_residual_of_both, tabulate
from .partition import Partition, checked_rows, partition_of
from .raim import MIN_SATELLITES, check_test, fit_thresholds

FloatArray = NDArray[np.float64]

LARGEST_GROUP = 6
"""Half of 12 satellites."""


@njit
def leave_out(
    n: int,
    size: int,
    table: FloatArray,
    limit: FloatArray,
    kept: FloatArray,
    left: FloatArray,
    after: FloatArray,
    chosen: NDArray[np.int64],
) -> tuple[bool, int, int]:
    """Leave out all subsets of one size, in lexicographic order.

    `table` (N + 1, PRODUCTS) products; `limit`: limit of s^2 by number of satellites [m^2]; `kept`,
    `left` (size + 1, PRODUCTS) scratch, a stack: in row d, sums of what is kept before the last of
    the first d that are left out, and of these d; `after` (n + 1, PRODUCTS) sums of the rows from i
    on, 0 in the last one; `chosen` (size,) scratch, rows that are left out.
    """
    tests = 2 if size >= MIN_SATELLITES else 1
    last_first = 0 if 2 * size == n else n - size
    fits, d = 0, 0
    chosen[0] = 0
    kept[:2] = 0.0
    left[0] = 0.0
    while d >= 0:
        i = chosen[d]
        if i <= (last_first if d == 0 else n - size + d):
            if d < size - 1:
                add(left, d, table, i, left, d + 1)
                d += 1
                chosen[d] = i + 1
                add(kept, d, after, n, kept, d + 1)
                continue
            fits += tests
            if squared_residual_of_both(kept, size, after, i + 1) < limit[n - size] and (
                tests == 1 or squared_residual_of_both(left, d, table, i) < limit[size]
            ):
                mask = (1 << n) - 1
                for k in range(size):
                    mask -= 1 << chosen[k]
                return True, mask, fits
        else:
            d -= 1
            if d < 0:
                break
        i = chosen[d]
        add(kept, d + 1, table, i, kept, d + 1)
        chosen[d] = i + 1
    return False, 0, fits


@njit
def search(
    n: int,
    table: FloatArray,
    limit: FloatArray,
    largest_group: int,
    after: FloatArray,
    stack: FloatArray,
    chosen: NDArray[np.int64],
) -> tuple[bool, int, int]:
    """Search the smallest subset to leave out.

    `n`: number of satellites, at least 5; `table` (N + 1, PRODUCTS) products; `limit`: limit of s^2
    by number of satellites [m^2]; `after` (N + 1, PRODUCTS) scratch; `stack` (2, largest_group + 1,
    PRODUCTS) scratch; `chosen` (largest_group,) scratch.
    """
    after[n] = 0.0
    for i in range(n - 1, -1, -1):
        add(after, i + 1, table, i, after, i)
    if squared_residual(after, 0) < limit[n]:
        return True, (1 << n) - 1, 1
    fits = 1
    for size in range(1, min(largest_group, n // 2, n - MIN_SATELLITES) + 1):
        found, mask, more = leave_out(n, size, table, limit, stack[0], stack[1], after, chosen)
        fits += more
        if found:
            return True, mask, fits
    return False, 0, fits


def traversal_raim(
    line_of_sight: ArrayLike,
    offset: ArrayLike,
    sigma_m: float,
    confidence: float = 0.95,
    largest_group: int = LARGEST_GROUP,
) -> Partition:
    """Two groups of satellites that each agree, the second one as small as can be.

    `line_of_sight` (n, 3) unit vectors to the satellites; `offset` (n,) pseudorange minus predicted
    range [m]; what isn't finite is left out; `sigma_m`: noise of a pseudorange [m]; `confidence`:
    probability that satellites that agree pass for it, in (0, 1).
    """
    check_test(sigma_m, confidence)
    check_largest_group(largest_group)
    rows = checked_rows(line_of_sight, offset)
    n = len(rows.slots)
    found = search(
        n,
        rows.table,
        fit_thresholds(sigma_m, 1.0 - confidence, n),
        largest_group,
        np.empty((n + 1, PRODUCTS)),
        np.empty((2, largest_group + 1, PRODUCTS)),
        np.empty(largest_group, dtype=np.int64),
    )
    return partition_of(rows, len(np.asarray(offset)), *found)


def check_largest_group(largest_group: int) -> None:
    """Raise unless at least one satellite may be left out."""
    if largest_group < 1:
        raise ValueError(f"`largest_group` must be at least 1, got {largest_group}")


@njit
def search_cases(
    lines: FloatArray,
    offsets: FloatArray,
    limit: FloatArray,
    largest_group: int,
    found: NDArray[np.bool_],
    mask: NDArray[np.int64],
    positionings: NDArray[np.int64],
) -> None:
    """Search many sets of pseudoranges of the same geometry, which isn't singular.

    `lines` (n, 3) g, minus the lines of sight; `offsets` (C, n) y [m], finite; overwritten with y
    minus its median; `limit` (n + 1,) limit of s^2 by number of satellites [m^2]; `found`, `mask`,
    `positionings` (C,), written, as by `search`.
    """
    n = offsets.shape[1]
    table, after = np.empty((n + 1, PRODUCTS)), np.empty((n + 1, PRODUCTS))
    stack = np.empty((2, largest_group + 1, PRODUCTS))
    chosen = np.empty(largest_group, dtype=np.int64)
    for c in range(offsets.shape[0]):
        tabulate(n, lines, offsets[c], table)
        found[c], mask[c], positionings[c] = search(
            n, table, limit, largest_group, after, stack, chosen
        )
