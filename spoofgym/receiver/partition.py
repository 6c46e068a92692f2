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

    Attributes
    ----------
    found : bool
        Whether a partition has passed all tests.
    group : ndarray
        (n,) int8: 1 and 2 for the groups, 0 for what has no finite offset, and for all where
        nothing was found.  Which one is authentic is not decided; 1 was found first.
    positionings : int
        Fits that were computed or would have been, one by one.
    """

    found: bool
    group: NDArray[np.int8]
    positionings: int


class Rows(NamedTuple):
    """Rows of one epoch that have passed all checks.

    Attributes
    ----------
    slots : ndarray
        (k,) which of the n satellites have a finite offset.
    lines : ndarray
        (k, 3) g.
    offsets : ndarray
        (k,) y minus its median [m].
    table : ndarray
        (k + 1, PRODUCTS) products, and their sum in the last row.
    squared_residual : float
        s^2 of all [m^2].
    """

    slots: NDArray[np.int64]
    lines: FloatArray
    offsets: FloatArray
    table: FloatArray
    squared_residual: float


def checked_rows(line_of_sight: ArrayLike, offset: ArrayLike) -> Rows:
    """Rows of one epoch, checked.

    Parameters
    ----------
    line_of_sight : array_like
        (n, 3) unit vectors to the satellites.
    offset : array_like
        (n,) pseudorange minus predicted range [m]; what isn't finite is left out.

    Returns
    -------
    Rows
        Ready for a search.

    Raises
    ------
    ValueError
        With fewer than 5 or more than 63 finite offsets, or a singular geometry.
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
    """Groups of a mask.

    Parameters
    ----------
    rows : Rows
        What was searched.
    count : int
        n, satellites before any was left out.
    found : bool
        Whether the search found something.
    mask : int
        Bit i for row i in the first group.
    positionings : int
        Number of fits.

    Returns
    -------
    Partition
        Of all n satellites.
    """
    group = np.zeros(count, dtype=np.int8)
    if found:
        group[rows.slots] = np.where((mask >> np.arange(len(rows.slots))) & 1, 1, 2)
    return Partition(bool(found), group, int(positionings))
