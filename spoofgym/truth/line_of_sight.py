"""A vehicle on a straight line under a fixed set of satellites, and the pseudoranges it measures.

For receivers that use one epoch at a time and no inertial sensors: no more of the motion matters
than where the antenna is.  All noise is white.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.compile import njit
from ..earth.wgs84 import dcm_e_from_n, geodetic_to_ecef, range_and_rate
from .noise import normals, padded
from .satellites import Constellation

FloatArray = NDArray[np.float64]

MASK_DEG = 5.0  # least elevation of a satellite that is used [deg]


class Sky(NamedTuple):
    """Where vehicle and satellites are. `time`: (K,) [s]; `position_e`, `velocity_e`: (K, 3), (3,)
    of the vehicle, ECEF [m], [m/s]; `C_en`: (3, 3) to ECEF from north-east-down axes at the start;
    `satellite_position_e`, `satellite_velocity_e`: (K, n, 3) ECEF [m], [m/s]; `satellite_ids`: (n,)
    in the order of the slots."""

    time: FloatArray
    position_e: FloatArray
    velocity_e: FloatArray
    C_en: FloatArray
    satellite_position_e: FloatArray
    satellite_velocity_e: FloatArray
    satellite_ids: tuple[str, ...]


def straight_line(
    time: FloatArray,
    latitude_deg: float,
    longitude_deg: float,
    height_m: float,
    speed_mps: float,
    heading_deg: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Straight line that begins level. `time` (K,) [s]; returns `position_e`, `velocity_e`, `C_en`
    (K, 3), (3,), (3, 3), as in `Sky`."""
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    start = geodetic_to_ecef(latitude, longitude, height_m)
    C_en = dcm_e_from_n(latitude, longitude)
    heading = math.radians(heading_deg)
    velocity = C_en @ (speed_mps * np.array([math.cos(heading), math.sin(heading), 0.0]))
    return start + np.outer(time, velocity), velocity, C_en


def make_sky(
    epochs: int,
    interval_s: float,
    satellites: int,
    constellation: Constellation,
    *,
    latitude_deg: float = 40.0,
    longitude_deg: float = 116.0,
    height_m: float = 500.0,
    speed_mps: float = 0.0,
    heading_deg: float = 0.0,
) -> Sky:
    """Vehicle and the satellites that are highest over all of its way. Returns slots in the order
    of the ids."""
    time = interval_s * np.arange(epochs, dtype=np.float64)
    position, velocity, C_en = straight_line(
        time, latitude_deg, longitude_deg, height_m, speed_mps, heading_deg
    )
    states = constellation.states(time)
    apart = states.position_e - position[:, None]
    up = -(apart @ C_en[:, 2]) / np.linalg.norm(apart, axis=-1)
    least = np.degrees(np.arcsin(up.min(axis=0)))
    seen = int(np.sum(least > MASK_DEG))  # an unusable satellite has NaN
    if seen < satellites:
        raise ValueError(
            f"`satellites` must be at most {seen}, as many as stay above {MASK_DEG:g} degrees, "
            f"got {satellites}"
        )
    chosen = np.sort(np.argsort(-least, kind="stable")[:satellites])
    return Sky(
        time,
        position,
        velocity,
        C_en,
        np.ascontiguousarray(states.position_e[:, chosen]),
        np.ascontiguousarray(states.velocity_e[:, chosen]),
        tuple(constellation.satellite_ids[j] for j in chosen),
    )


def chain_skies(skies: Sequence[Sky]) -> Sky:
    """Sky in which the epochs of some skies of one place and length follow one another. Times start
    again with each; `velocity_e` is that of the first. Satellites are named by their slots where
    they differ."""
    first = skies[0]
    if len(skies) == 1:
        return first
    if any(sky.satellite_ids != first.satellite_ids for sky in skies):
        first = first._replace(
            satellite_ids=tuple(f"slot{s:02d}" for s in range(len(first.satellite_ids)))
        )
    return first._replace(
        time=np.concatenate([sky.time for sky in skies]),
        position_e=np.concatenate([sky.position_e for sky in skies]),
        satellite_position_e=np.concatenate([sky.satellite_position_e for sky in skies]),
        satellite_velocity_e=np.concatenate([sky.satellite_velocity_e for sky in skies]),
    )


@njit
def measure(
    epoch: NDArray[np.int64],
    keys: NDArray[np.uint64],
    clock: FloatArray,
    displacement: FloatArray,
    spoofed: NDArray[np.bool_],
    time: FloatArray,
    position_e: FloatArray,
    C_en: FloatArray,
    satellite_position_e: FloatArray,
    noise_m: float,
    deviates: FloatArray,
    pseudorange: FloatArray,
    satellites: FloatArray,
) -> None:
    r"""Pseudoranges of one epoch, authentic or counterfeit.

    .. math:: \tilde\rho_j = |C r_j - r - C_{en} d_j| + c_0 + c_1 t + d_{4j} + w_j

    with the counterfeit displacement d and clock offset d_4, 0 for authentic satellites.  The
    white noise is that of the satellite, spoofed or not.

    `epoch` (B,) number of the epoch; `keys` (B, 2) key of the noise; `clock` (B, 2) offset and
    drift of the receiver's clock [m], [m/s]; `displacement` (B, 4) north, east, down and clock [m];
    `spoofed` (B, n) bool; `deviates` (N,) scratch, N a multiple of `noise.BLOCK` and at least n;
    `pseudorange` (B, n), written [m]; `satellites` (B, n, 3), written: where the satellites are,
    ECEF [m].
    """
    r = np.empty(3)
    for b in range(epoch.shape[0]):
        k = epoch[b]
        normals(keys[b, 0], keys[b, 1], k, deviates)
        bias = clock[b, 0] + clock[b, 1] * time[k]
        for j in range(spoofed.shape[1]):
            own = bias
            for i in range(3):
                r[i] = position_e[k, i]
                satellites[b, j, i] = satellite_position_e[k, j, i]
            if spoofed[b, j]:
                own += displacement[b, 3]
                for i in range(3):
                    for c in range(3):
                        r[i] += C_en[i, c] * displacement[b, c]
            distance, _, _, _, _ = range_and_rate(
                satellites[b, j, 0],
                satellites[b, j, 1],
                satellites[b, j, 2],
                0.0,
                0.0,
                0.0,
                r[0],
                r[1],
                r[2],
                0.0,
                0.0,
                0.0,
            )
            pseudorange[b, j] = distance + own + noise_m * deviates[j]


def scratch(satellites: int) -> FloatArray:
    return np.empty(padded(satellites))
