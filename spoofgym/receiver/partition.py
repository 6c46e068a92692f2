"""One epoch to be searched for groups of satellites, and the groups that were found."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .fits import PRODUCTS, tabulate
from .raim import MAX_SATELLITES, MIN_SATELLITES

FloatArray = NDArray[np.float64]


class Partition(NamedTuple):
    """Two groups of satellites, each consistent in itself.

    - `found`: whether a partition has passed all tests;
    - `group` (n,) int8: 1 and 2 for the groups, 0 for what has no finite offset, and for all where
      nothing was found.  Which one is authentic is not decided; 1 was found first;
    - `positionings`: fits that were computed or would have been, one by one.
    """

    found: bool
    group: NDArray[np.int8]
    positionings: int


class Rows(NamedTuple):
    """Rows of one epoch that have passed all checks.

    - `slots` (k,) which of the n satellites have a finite offset;
    - `lines` (k, 3) g;
    - `offsets` (k,) y minus its median [m];
    - `table` (k + 1, PRODUCTS) products, and their sum in the last row;
    - `squared_residual`: s^2 of all [m^2].
    """

    slots: NDArray[np.int64]
    lines: FloatArray
    offsets: FloatArray
    table: FloatArray
    squared_residual: float


def checked_rows(line_of_sight: ArrayLike, offset: ArrayLike) -> Rows:
    """Rows of one epoch, checked.

    `line_of_sight` (n, 3) unit vectors to the satellites; `offset` (n,) pseudorange minus predicted
    range [m]; what isn't finite is left out.
    """
    u, y = np.asarray(line_of_sight, dtype=np.float64), np.asarray(offset, dtype=np.float64)
    if y.ndim != 1 or u.shape != (len(y), 3):
        raise ValueError(
            f"`line_of_sight` must be (n, 3) and `offset` (n,), got {u.shape} and {y.shape}"
        )
    slots = np.flatnonzero(np.isfinite(y) & np.isfinite(u).all(axis=1))
    if not MIN_SATELLITES <= len(slots) <= MAX_SATELLITES:
        raise ValueError(
            f"a consistency test needs {MIN_SATELLITES} to {MAX_SATELLITES} satellites, "
            f"got {len(slots)}"
        )
    lines, offsets = -u[slots], y[slots]
    if not np.allclose(np.sum(lines**2, axis=1), 1.0, rtol=0.0, atol=1e-6):
        raise ValueError("`line_of_sight` must hold unit vectors")
    table = np.empty((len(slots) + 1, PRODUCTS))
    s2 = tabulate(len(slots), lines, offsets, table)
    if not math.isfinite(s2):
        raise ValueError("the geometry of the satellites is singular")
    return Rows(slots, lines, offsets, table, max(s2, 0.0))


def partition_of(rows: Rows, count: int, found: bool, mask: int, positionings: int) -> Partition:
    """Groups of a mask."""
    group = np.zeros(count, dtype=np.int8)
    if found:
        group[rows.slots] = np.where((mask >> np.arange(len(rows.slots))) & 1, 1, 2)
    return Partition(bool(found), group, int(positionings))
