r"""Consistency of pseudoranges: the least-squares fit of any subset of satellites.

With G = (-u, 1) for lines of sight u, and y pseudorange minus predicted range, satellites that
measure the same position and clock leave only noise of a least-squares fit:

.. math:: s^2 = y^T \left(I - G (G^T G)^{-1} G^T\right) y \sim \sigma^2 \chi^2(n - 4)

A search asks this of many subsets, by the sums of `receiver.snapshot`.

The clock is one: with several constellations, the offsets between their times are removed before.
Positions are linearized about a predicted one, which is good to 0.3 m where it is 4 km away.

Source: `brown1992` for the test, `wu2024` for its use on subsets.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from ..core.compile import njit
from ..earth.wgs84 import STILL, dcm_e_from_n, ecef_to_geodetic, range_and_rate
from ..receiver.snapshot import PRODUCTS, STATES, tabulate

FloatArray = NDArray[np.float64]

MIN_SATELLITES = 5
"""The least number of satellites that can disagree."""
MAX_SATELLITES = 63
"""As many fit into a mask."""
FRAMES = ("ecef", "ned")


class SearchData(NamedTuple):
    """Satellites of B receivers that a search divides into groups, and what it finds.

    - `slots` (B, n) which satellite each row is of;
    - `lines`, `offsets` (B, n, 3), (B, n) g, and y minus its median [m];
    - `table` (B, n + 1, PRODUCTS) products of every row, and their sum in the last one;
    - `rows` (B,) how many are in use;
    - `alarm` (B,) where there is something to search for;
    - `found` (B,) whether a partition has passed all tests; `mask` (B,) bit i is set where row i is
      of the first group;
    - `positionings` (B,) fits of the search.
    """

    slots: NDArray[np.int64]
    lines: FloatArray
    offsets: FloatArray
    table: FloatArray
    rows: NDArray[np.int64]
    alarm: NDArray[np.bool_]
    found: NDArray[np.bool_]
    mask: NDArray[np.int64]
    positionings: NDArray[np.int64]


def search_data(receivers: int, n: int) -> SearchData:
    """Arrays for a number of receivers and satellites."""
    return SearchData(
        np.zeros((receivers, n), dtype=np.int64),
        np.empty((receivers, n, 3)),
        np.empty((receivers, n)),
        np.empty((receivers, n + 1, PRODUCTS)),
        np.full(receivers, n, dtype=np.int64),
        np.ones(receivers, dtype=np.bool_),
        np.zeros(receivers, dtype=np.bool_),
        np.zeros(receivers, dtype=np.int64),
        np.zeros(receivers, dtype=np.int64),
    )


@njit
def tabulate_cases(lines: FloatArray, offsets: FloatArray, data: SearchData) -> None:
    """Prepare the search of many sets of pseudoranges of one geometry, which isn't singular.
    `lines` (n, 3) g, minus the lines of sight; `offsets` (C, n) y [m], finite."""
    for c in range(offsets.shape[0]):
        data.lines[c], data.offsets[c] = lines, offsets[c]
        tabulate(offsets.shape[1], lines, data.offsets[c], data.table[c])


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


def checked_rows(line_of_sight: ArrayLike, offset: ArrayLike) -> tuple[SearchData, float]:
    """Rows of one epoch of one receiver, checked, and s^2 of all [m^2]. `line_of_sight` (n, 3) unit
    vectors to the satellites; `offset` (n,) pseudorange minus predicted range [m]; what isn't
    finite is left out."""
    u, y = np.asarray(line_of_sight, dtype=np.float64), np.asarray(offset, dtype=np.float64)
    if y.ndim != 1 or u.shape != (len(y), 3):
        raise ValueError(
            f"`line_of_sight` must be (n, 3) and `offset` (n,), got {u.shape} and {y.shape}"
        )
    slots = np.flatnonzero(np.isfinite(y) & np.isfinite(u).all(axis=1))
    n = len(slots)
    if not MIN_SATELLITES <= n <= MAX_SATELLITES:
        raise ValueError(
            f"a consistency test needs {MIN_SATELLITES} to {MAX_SATELLITES} satellites, got {n}"
        )
    if not np.allclose(np.sum(u[slots] ** 2, axis=1), 1.0, rtol=0.0, atol=1e-6):
        raise ValueError("`line_of_sight` must hold unit vectors")
    data = search_data(1, n)
    data.slots[0], data.lines[0], data.offsets[0] = slots, -u[slots], y[slots]
    s2 = tabulate(n, data.lines[0], data.offsets[0], data.table[0])
    if not math.isfinite(s2):
        raise ValueError("the geometry of the satellites is singular")
    return data, max(s2, 0.0)


def partition_of(data: SearchData, count: int) -> Partition:
    """Groups that a search of one receiver has found among `count` satellites."""
    group, slots = np.zeros(count, dtype=np.int8), data.slots[0]
    if data.found[0]:
        group[slots] = np.where((data.mask[0] >> np.arange(len(slots))) & 1, 1, 2)
    return Partition(bool(data.found[0]), group, int(data.positionings[0]))


@njit
def line_up(
    pseudorange: FloatArray,
    satellite_position: FloatArray,
    visible: NDArray[np.bool_],
    position: FloatArray,
    axes: FloatArray,
    slots: NDArray[np.int64],
    lines: FloatArray,
    offsets: FloatArray,
) -> int:
    """Rows of the satellites that one receiver can use. `pseudorange`, `satellite_position`,
    `visible` (n,), (n, 3), (n,) of an epoch; `position` (3,) predicted, ECEF [m]; `axes` (3, 3)
    from the frame of the test to ECEF; `slots` (n,), written: slot of each row; `lines`, `offsets`
    (n, 3), (n,), written: g in the frame of the test, and y [m]."""
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
    data: SearchData,
    visible: NDArray[np.bool_],
    group: NDArray[np.int8],
    weights: FloatArray,
) -> None:
    """Groups and weights of all receivers. `group` (B, n) int8, written: 0 unknown, 1 and 2 the
    groups; `weights` (B, 2n), written: 0 for the second group and for visible satellites without a
    finite offset."""
    n = visible.shape[1]
    for b in range(visible.shape[0]):
        for j in range(n):
            group[b, j] = 0
            weights[b, j] = weights[b, n + j] = 0.0 if visible[b, j] else 1.0
        for i in range(data.rows[b]):
            j = data.slots[b, i]
            first = not data.found[b] or (data.mask[b] >> i) & 1 == 1
            if data.found[b]:
                group[b, j] = 1 if first else 2
            weights[b, j] = weights[b, n + j] = 1.0 if first else 0.0


@njit
def line_up_all(
    pseudorange: FloatArray,
    satellite_position: FloatArray,
    visible: NDArray[np.bool_],
    position: FloatArray,
    axes: FloatArray,
    alarm_limit: FloatArray,
    data: SearchData,
    statistic: FloatArray,
    threshold: FloatArray,
    group: NDArray[np.int8],
    weights: FloatArray,
) -> None:
    """Test all satellites in view of every receiver.

    `axes` (B, 3, 3) from the frame of the search to ECEF; `alarm_limit` (most + 1,) limit of s^2
    [m^2] by number of satellites, `most` at least n and 5; `data`, written; `statistic`,
    `threshold` (B, 1), written: SSE and its threshold [m]; with fewer than 5 satellites or a
    singular geometry, 0 and that of 5; `group`, `weights` as `write_groups` writes them before a
    search.
    """
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
        data.alarm[b] = data.found[b] = False
        if count < MIN_SATELLITES:
            continue
        s2 = tabulate(count, lines, offsets, table)
        if s2 < np.inf:
            statistic[b, 0] = math.sqrt(max(s2, 0.0) / (count - STATES))
            data.alarm[b] = statistic[b, 0] > threshold[b, 0]
            data.found[b] = not data.alarm[b]
    write_groups(data, visible, group, weights)


def frame_axes(position_e: FloatArray) -> FloatArray:
    """Axes north, east, down at (B, 3) positions, ECEF [m]; returns (B, 3, 3) to ECEF."""
    latitude, longitude, _ = ecef_to_geodetic(position_e)
    return np.ascontiguousarray(dcm_e_from_n(latitude, longitude))


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


def noise_sd(sigma_m: float | None, epoch_sd: FloatArray, channels: int) -> float:
    """Noise of a pseudorange: a setting, or the largest that the receiver assumes of one epoch.
    `sigma_m`: the setting [m]; `epoch_sd` (m,) of the receiver, pseudoranges first [m]; returns
    Sigma [m]."""
    return float(epoch_sd[:channels].max()) if sigma_m is None else sigma_m


def check_test(sigma_m: float | None, confidence: float) -> None:
    """Raise unless the settings of a consistency test are valid. `sigma_m`: noise of a pseudorange
    [m]."""
    if sigma_m is not None and not (math.isfinite(sigma_m) and sigma_m > 0.0):
        raise ValueError(f"`sigma_m` must be finite and > 0, got {sigma_m}")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"`confidence` must lie between 0 and 1, both excluded, got {confidence}")


def check_channels(channels: int) -> None:
    """Raise unless a mask has room for all satellites."""
    if channels > MAX_SATELLITES:
        raise ValueError(f"at most {MAX_SATELLITES} channels can be searched, got {channels}")
