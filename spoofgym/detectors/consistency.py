r"""Consistency of pseudoranges: the least-squares fit of any subset of satellites.

With G = (-u, 1) for lines of sight u, and y pseudorange minus predicted range, satellites that
measure the same position and clock leave only noise of a least-squares fit:

.. math:: s^2 = y^T \left(I - G (G^T G)^{-1} G^T\right) y \sim \sigma^2 \chi^2(n - 4)

A search computes this for many subsets, by the sums of `receiver.snapshot`.  The clock is one: with
several constellations, the offsets between their times are removed before.  Positions are
linearized about a predicted one, which is good to 0.3 m where it is 4 km away.

Source: `brown1992` for the test, `wu2024` for its use on subsets.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from ..core.compile import njit
from ..earth.wgs84 import STILL, range_and_rate
from ..receiver.snapshot import PRODUCTS, STATES, tabulate
from .base import BoolArray, FloatArray, IntArray

MIN_SATELLITES = 5
"""The least number of satellites that can disagree."""


class SearchData(NamedTuple):
    """Satellites of B receivers that a search divides into groups, and what it finds.

    - `slots` (B, n) which satellite each row is of;
    - `lines`, `offsets` (B, n, 3), (B, n) g, and y minus its median [m];
    - `table` (B, n + 1, PRODUCTS) products of every row, and their sum in the last one;
    - `rows` (B,) how many are in use;
    - `alarm` (B,) where there is something to search for;
    - `solved` (B,) whether a partition has passed all tests; `mask` (B,) bit i is set where row i
      is of the first group;
    - `positionings` (B,) fits of the search.
    """

    slots: IntArray
    lines: FloatArray
    offsets: FloatArray
    table: FloatArray
    rows: IntArray
    alarm: BoolArray
    solved: BoolArray
    mask: IntArray
    positionings: IntArray


def search_data(receivers: int, n: int) -> SearchData:
    return SearchData(
        slots=np.zeros((receivers, n), dtype=np.int64),
        lines=np.empty((receivers, n, 3)),
        offsets=np.empty((receivers, n)),
        table=np.empty((receivers, n + 1, PRODUCTS)),
        rows=np.full(receivers, n, dtype=np.int64),
        alarm=np.ones(receivers, dtype=np.bool_),
        solved=np.zeros(receivers, dtype=np.bool_),
        mask=np.zeros(receivers, dtype=np.int64),
        positionings=np.zeros(receivers, dtype=np.int64),
    )


@njit
def line_up(
    pseudorange: FloatArray,
    satellite_position: FloatArray,
    visible: BoolArray,
    position: FloatArray,
    axes: FloatArray,
    slots: IntArray,
    lines: FloatArray,
    offsets: FloatArray,
) -> int:
    """Rows of the satellites that one receiver can use; returns how many. `position` (3,)
    predicted, ECEF [m]; `axes` (3, 3) from the frame of the test to ECEF; `slots` (n,), `lines` (n,
    3), `offsets` (n,), written: slot of each row, g in the frame of the test, and y [m]."""
    count = 0
    for j in range(visible.shape[0]):
        if not visible[j]:
            continue
        place = satellite_position[j, 0], satellite_position[j, 1], satellite_position[j, 2]
        distance, _, ux, uy, uz = range_and_rate(place, STILL, position, STILL)
        offset = pseudorange[j] - distance
        if not abs(offset + ux + uy + uz) < np.inf:
            continue
        for i in range(3):
            lines[count, i] = -(axes[0, i] * ux + axes[1, i] * uy + axes[2, i] * uz)
        offsets[count] = offset
        slots[count] = j
        count += 1
    return count


@njit
def write_groups(
    data: SearchData, visible: BoolArray, group: NDArray[np.int8], weights: FloatArray
) -> None:
    """Write groups (B, n) int8, 0 unknown, 1 and 2 the groups, and weights (B, 2n), 0 for the
    second group and for visible satellites without a finite offset."""
    n = visible.shape[1]
    for b in range(visible.shape[0]):
        for j in range(n):
            group[b, j] = 0
            weights[b, j] = weights[b, n + j] = 0.0 if visible[b, j] else 1.0
        for i in range(data.rows[b]):
            j = data.slots[b, i]
            first = not data.solved[b] or (data.mask[b] >> i) & 1 == 1
            if data.solved[b]:
                group[b, j] = 1 if first else 2
            weights[b, j] = weights[b, n + j] = 1.0 if first else 0.0


@njit
def line_up_all(
    pseudorange: FloatArray,
    satellite_position: FloatArray,
    visible: BoolArray,
    position: FloatArray,
    axes: FloatArray,
    alarm_limit: FloatArray,
    data: SearchData,
    statistic: FloatArray,
    threshold: FloatArray,
    group: NDArray[np.int8],
    weights: FloatArray,
) -> None:
    """Test all satellites in view of every receiver. `axes` (B, 3, 3) from the frame of the search
    to ECEF; `alarm_limit` limit of s^2 [m^2] by number of satellites; `statistic`, `threshold` (B,
    1), written: SSE and its threshold [m]; with fewer than 5 satellites or a singular geometry, 0
    and that of 5; `group`, `weights` as `write_groups` writes them before a search."""
    for b in range(visible.shape[0]):
        lines, offsets, table = data.lines[b], data.offsets[b], data.table[b]
        count = line_up(
            pseudorange[b],
            satellite_position[b],
            visible[b],
            position[b],
            axes[b],
            data.slots[b],
            lines,
            offsets,
        )
        enough = max(count, MIN_SATELLITES)
        statistic[b, 0] = 0.0
        threshold[b, 0] = math.sqrt(alarm_limit[enough] / (enough - STATES))
        data.rows[b], data.mask[b] = count, (1 << count) - 1
        data.alarm[b] = data.solved[b] = False
        if count < MIN_SATELLITES:
            continue
        s2 = tabulate(count, lines, offsets, table)
        if s2 < np.inf:
            statistic[b, 0] = math.sqrt(max(s2, 0.0) / (count - STATES))
            data.alarm[b] = statistic[b, 0] > threshold[b, 0]
            data.solved[b] = not data.alarm[b]
    write_groups(data, visible, group, weights)


def fit_thresholds(sigma_m: float, false_alarm: float, most: int) -> FloatArray:
    r"""Limits of the squared residual by number of satellites.

    .. math:: \mathrm{TH}(n)^2 (n - 4) = \sigma^2 \chi^2_{1 - \alpha}(n - 4)

    `sigma_m`: noise of a pseudorange [m]; returns (most + 1,) limit of s^2 [m^2]; 0, which nothing
    passes, with fewer than 5.

    Examples
    --------
    >>> import numpy as np
    >>> from spoofgym.detectors.consistency import fit_thresholds
    >>> limit = fit_thresholds(4.0, 0.05, 12)
    >>> np.sqrt(limit[5:] / np.arange(1, 9)).round(3)
    array([7.84 , 6.923, 6.456, 6.16 , 5.952, 5.795, 5.67 , 5.569])
    """
    degrees = np.arange(most + 1) - STATES
    quantile = special.chdtri(np.maximum(degrees, 1), false_alarm)
    return np.asarray(np.where(degrees > 0, sigma_m**2 * quantile, 0.0))
