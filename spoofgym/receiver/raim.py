r"""Consistency of pseudoranges: the least-squares fit of any subset of satellites.

With G = (-u, 1) for lines of sight u, and y pseudorange minus predicted range, satellites that
measure the same position and clock leave only noise of a least-squares fit:

.. math:: s^2 = y^T \left(I - G (G^T G)^{-1} G^T\right) y \sim \sigma^2 \chi^2(n - 4)

A search asks this of many subsets, by the sums of `fits`.

The clock is one: with several constellations, the offsets between their times are removed before.
Positions are linearized about a predicted one, which is good to 0.3 m where it is 4 km away.

Source: `brown1992` for the test, `wu2024` for its use on subsets.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

from .._jit import njit
from ..earth.frames import dcm_e_from_n, ecef_to_geodetic
from ..earth.ranging import range_and_rate
from .fits import tabulate

FloatArray = NDArray[np.float64]

STATES = 4
"""Position and clock."""
MIN_SATELLITES = 5
"""The least number of satellites that can disagree."""
MAX_SATELLITES = 63
"""As many fit into a mask."""
FRAMES = ("ecef", "ned")


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
    """Rows of the satellites that one receiver can use.

    `pseudorange`, `satellite_position`, `visible` (n,), (n, 3), (n,) of an epoch; `position` (3,)
    predicted, ECEF [m]; `axes` (3, 3) from the frame of the test to ECEF; `slots` (n,), written:
    slot of each row; `lines`, `offsets` (n, 3), (n,), written: g in the frame of the test, and y
    [m].
    """
    count = 0
    for j in range(visible.shape[0]):
        if not visible[j]:
            continue
        distance, _, ux, uy, uz = range_and_rate(
            satellite_position[j, 0],
            satellite_position[j, 1],
            satellite_position[j, 2],
            0.0,
            0.0,
            0.0,
            position[0],
            position[1],
            position[2],
            0.0,
            0.0,
            0.0,
        )
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
def test_all(
    pseudorange: FloatArray,
    satellite_position: FloatArray,
    visible: NDArray[np.bool_],
    position: FloatArray,
    axes: FloatArray,
    alarm_limit: FloatArray,
    slots: NDArray[np.int64],
    lines: FloatArray,
    offsets: FloatArray,
    table: FloatArray,
    statistic: FloatArray,
    threshold: FloatArray,
) -> tuple[int, int]:
    """Test all satellites in view of one receiver.

    `alarm_limit` (most + 1,) limit of s^2 [m^2] by number of satellites, `most` at least n and 5;
    `slots`, `lines`, `offsets`, `table` (n,), (n, 3), (n,), (n + 1, PRODUCTS), written, as by
    `line_up` and `tabulate`; `statistic`, `threshold` (1,), written: SSE and its threshold [m];
    with fewer than 5 satellites or a singular geometry, 0 and that of 5.
    """
    count = line_up(pseudorange, satellite_position, visible, position, axes, slots, lines, offsets)
    enough = max(count, MIN_SATELLITES)
    statistic[0] = 0.0
    threshold[0] = math.sqrt(alarm_limit[enough] / (enough - STATES))
    if count < MIN_SATELLITES:
        return count, 0
    s2 = tabulate(count, lines, offsets, table)
    if not s2 < np.inf:
        return count, 0
    statistic[0] = math.sqrt(max(s2, 0.0) / (count - STATES))
    return count, 2 if statistic[0] > threshold[0] else 1


def frame_axes(frame: str, position_e: FloatArray) -> FloatArray:
    """Axes of the frame that a test works in.

    `position_e` (B, 3) ECEF [m]; returns (B, 3, 3) to ECEF from this frame.
    """
    if frame == "ecef":
        return np.tile(np.eye(3), (len(position_e), 1, 1))
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
    >>> from spoofgym.receiver.raim import fit_thresholds
    >>> limit = fit_thresholds(4.0, 0.05, 12)
    >>> np.sqrt(limit[5:] / np.arange(1, 9)).round(3)
    array([7.84 , 6.923, 6.456, 6.16 , 5.952, 5.795, 5.67 , 5.569])
    """
    degrees = np.arange(most + 1) - STATES
    quantile = special.chdtri(np.maximum(degrees, 1), false_alarm)
    return np.asarray(np.where(degrees > 0, sigma_m**2 * quantile, 0.0))


def noise_sd(sigma_m: float | None, noise_variance: FloatArray, channels: int) -> float:
    """Noise of a pseudorange: a setting, or what the receiver assumes.

    `sigma_m`: the setting [m]; `noise_variance` (m,) of the receiver, pseudoranges first [m^2];
    returns Sigma [m].
    """
    if sigma_m is not None:
        return sigma_m
    assumed = noise_variance[:channels]
    if not (assumed == assumed[0]).all():
        raise ValueError(
            "the receiver's pseudoranges differ in their noise, "
            f"{np.sqrt(assumed.min()):g} to {np.sqrt(assumed.max()):g} m; set `sigma_m`"
        )
    return math.sqrt(assumed[0])


def check_test(sigma_m: float | None, confidence: float) -> None:
    """Raise unless the settings of a consistency test are valid.

    `sigma_m`: noise of a pseudorange [m].
    """
    if sigma_m is not None and not (math.isfinite(sigma_m) and sigma_m > 0.0):
        raise ValueError(f"`sigma_m` must be finite and > 0, got {sigma_m}")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"`confidence` must lie between 0 and 1, both excluded, got {confidence}")


def check_channels(channels: int) -> None:
    """Raise unless a mask has room for all satellites."""
    if channels > MAX_SATELLITES:
        raise ValueError(f"at most {MAX_SATELLITES} channels can be searched, got {channels}")


@njit
def write_groups(
    found: bool,
    mask: int,
    count: int,
    slots: NDArray[np.int64],
    visible: NDArray[np.bool_],
    group: NDArray[np.int8],
    weights: FloatArray,
) -> None:
    """Groups and weights of one receiver.

    `slots` (n,) slot of each row; `group` (n,) int8, written: 0 unknown, 1 and 2 the groups;
    `weights` (2n,), written: 0 for the second group and for visible satellites without a finite
    offset.
    """
    n = visible.shape[0]
    for j in range(n):
        group[j] = 0
        weights[j] = weights[n + j] = 0.0 if visible[j] else 1.0
    for i in range(count):
        j = slots[i]
        first = not found or (mask >> i) & 1 == 1
        if found:
            group[j] = 1 if first else 2
        weights[j] = weights[n + j] = 1.0 if first else 0.0
