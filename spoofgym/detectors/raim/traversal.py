r"""Traversal RAIM: the smallest set of satellites without which all others agree.

All subsets are left out in turn, the smaller ones first; the first one that leaves satellites that
agree, and agrees itself where it is large enough to disagree, is the second group.  It finds
whatever the test of consistency can find, and takes thousands of fits where half of the satellites
are spoofed.

.. math:: \mathrm{SSE}(S) = \sqrt{\frac{r_S^T r_S}{|S| - 4}} < \mathrm{TH}(|S|) =
    \sigma \sqrt{\frac{\chi^2_p(|S| - 4)}{|S| - 4}}

for S the satellites that are kept, and for those left out where there are 5 or more.

Symbols: r_S residuals of a fit to the subset S, :math:`\sigma` noise of a pseudorange, p
confidence.

Assumptions: spoofed satellites agree on one position and clock; noise is white and Gaussian.  Which
group is authentic is not decided, and the larger one is kept.

Deviations from `wu2024`, where it is the method to compare with:

1. Nothing left out comes first, "no spoofing"; it costs one fit, which the paper's counts for one
   spoofed satellite seem to lack.
2. The detector searches only after an alarm of all satellites in view, with a false-alarm
   probability of its own; ``false_alarm = 0.05`` is the paper's confidence.
3. The second group has at most `largest_group` satellites: 6 is all there is with 12 in view, while
   20 would take half a million fits without it.
4. With fewer than 5 satellites, or a singular geometry, there is no verdict: statistic 0.

Source: `wu2024`, section 3, tables 7 and 8.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._jit import njit
from ...receiver.least_squares import PRODUCTS, add, squared_residual, squared_residual_of_both
from .base import ConsistencyTest
from .consistency import (
    MIN_SATELLITES,
    Partition,
    SearchData,
    check_test,
    checked_rows,
    fit_thresholds,
    partition_of,
)

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
    """Search the smallest subset to leave out. `n`: number of satellites, at least 5; `table` (N +
    1, PRODUCTS) products; `limit`: limit of s^2 by number of satellites [m^2]; `after` (N + 1,
    PRODUCTS) scratch; `stack` (2, largest_group + 1, PRODUCTS) scratch; `chosen` (largest_group,)
    scratch."""
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


@njit
def search_all(data: SearchData, limit: FloatArray, largest_group: int) -> None:
    """Search in all receivers with an alarm, as `search` does."""
    n = data.slots.shape[1]
    after, stack = np.empty((n + 1, PRODUCTS)), np.empty((2, largest_group + 1, PRODUCTS))
    chosen = np.empty(largest_group, dtype=np.int64)
    for b in range(data.alarm.shape[0]):
        if data.alarm[b]:
            data.found[b], data.mask[b], data.positionings[b] = search(
                data.rows[b], data.table[b], limit, largest_group, after, stack, chosen
            )


def traversal_raim(
    line_of_sight: ArrayLike,
    offset: ArrayLike,
    sigma_m: float,
    confidence: float = 0.95,
    largest_group: int = LARGEST_GROUP,
) -> Partition:
    """Two groups of satellites that each agree, the second one as small as can be. `line_of_sight`
    (n, 3) unit vectors to the satellites; `offset` (n,) pseudorange minus predicted range [m]; what
    isn't finite is left out; `sigma_m`: noise of a pseudorange [m]; `confidence`: probability that
    satellites that agree pass for it, in (0, 1)."""
    check_test(sigma_m, confidence)
    check_largest_group(largest_group)
    data, _ = checked_rows(line_of_sight, offset)
    search_all(data, fit_thresholds(sigma_m, 1.0 - confidence, data.slots.shape[1]), largest_group)
    return partition_of(data, len(np.asarray(offset)))


def check_largest_group(largest_group: int) -> None:
    """Raise unless at least one satellite may be left out."""
    if largest_group < 1:
        raise ValueError(f"`largest_group` must be at least 1, got {largest_group}")


@dataclass
class TraversalRaim(ConsistencyTest):
    """Residual test of all satellites in view; after an alarm, the smallest group to leave out.

    Parameters
    ----------
    sigma_m : float or None
        Noise of a pseudorange [m]; None takes what the receiver assumes.
    confidence : float
        Probability that satellites that agree pass for it in the search, in (0, 1).
    false_alarm : float
        Probability of an alarm in one epoch, in (0, 1).
    largest_group : int
        Most satellites to leave out.
    exclude : bool
        Give the second group weights 0, pseudoranges and range rates, as long as the alarm lasts.
        It may be the authentic one.

    Notes
    -----
    ``memory["group"]`` is (B, n): 1 for satellites that are kept, all without an alarm, 2 for those
    left out, and 0 for what is not known: no verdict, or nothing found.
    """

    described_as = "TraversalRaim"
    sigma_m: float | None = None
    confidence: float = 0.95
    false_alarm: float = 1e-5
    largest_group: int = LARGEST_GROUP
    exclude: bool = False

    paper: ClassVar[str] = "wu2024"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_largest_group(self.largest_group)

    def search(self, data: SearchData) -> None:
        search_all(data, self._limit, self.largest_group)
