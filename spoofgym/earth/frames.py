"""Frames: geodetic coordinates, ECEF (e) and the local north-east-down frame (n).

All functions broadcast over leading axes; angles are in radians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .wgs84 import ECCENTRICITY_SQUARED, EQUATORIAL_RADIUS


def geodetic_to_ecef(
    latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike
) -> NDArray[np.float64]:
    r"""Position in ECEF axes from geodetic coordinates.

    .. math::
        r = \begin{pmatrix}(R_E + h)\cos L\cos\lambda\\ (R_E + h)\cos L\sin\lambda\\
        ((1 - e^2) R_E + h)\sin L\end{pmatrix}

    `latitude`, `longitude`: geodetic latitude and longitude [rad], any shape S; `height`: height
    above the ellipsoid [m], broadcast against them; returns (S, 3) position, ECEF [m].

    Notes
    -----
    Groves (2013), eq. 2.112.
    """
    latitude, longitude, height = np.broadcast_arrays(latitude, longitude, height)
    sin_latitude = np.sin(latitude)
    transverse = EQUATORIAL_RADIUS / np.sqrt(1.0 - ECCENTRICITY_SQUARED * sin_latitude**2)
    horizontal = (transverse + height) * np.cos(latitude)
    return np.stack(
        [
            horizontal * np.cos(longitude),
            horizontal * np.sin(longitude),
            ((1.0 - ECCENTRICITY_SQUARED) * transverse + height) * sin_latitude,
        ],
        axis=-1,
    )


def ecef_to_geodetic(
    position_e: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Geodetic coordinates from a position in ECEF axes. Bowring's closed form followed by two
    fixed-point steps; exact to rounding between the surface and satellite orbits, poles included.
    `position_e` (..., 3) position, ECEF [m]; returns `latitude`, `longitude`, `height` [rad],
    [rad], [m]; shape of the leading axes."""
    x, y, z = np.moveaxis(np.asarray(position_e, dtype=np.float64), -1, 0)
    p = np.hypot(x, y)
    ratio = np.sqrt(1.0 - ECCENTRICITY_SQUARED)
    beta = np.arctan2(z, p * ratio)
    second = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED)
    for _ in range(3):
        latitude = np.arctan2(
            z + second * EQUATORIAL_RADIUS * ratio * np.sin(beta) ** 3,
            p - ECCENTRICITY_SQUARED * EQUATORIAL_RADIUS * np.cos(beta) ** 3,
        )
        beta = np.arctan2(ratio * np.sin(latitude), np.cos(latitude))
    sin_latitude, cos_latitude = np.sin(latitude), np.cos(latitude)
    w = np.sqrt(1.0 - ECCENTRICITY_SQUARED * sin_latitude**2)
    height = p * cos_latitude + z * sin_latitude - EQUATORIAL_RADIUS * w
    return latitude, np.arctan2(y, x), height


def dcm_e_from_n(latitude: ArrayLike, longitude: ArrayLike) -> NDArray[np.float64]:
    """Direction cosine matrix `C_en`, to ECEF from north-east-down axes. `latitude`, `longitude`:
    geodetic latitude and longitude [rad], any shape S; returns (S, 3, 3); its columns are the
    north, east and down unit vectors in ECEF axes. Transpose of Groves (2013), eq. 2.150."""
    latitude, longitude = np.broadcast_arrays(latitude, longitude)
    sl, cl = np.sin(latitude), np.cos(latitude)
    so, co = np.sin(longitude), np.cos(longitude)
    north = np.stack([-sl * co, -sl * so, cl], axis=-1)
    east = np.stack([-so, co, np.zeros_like(sl)], axis=-1)
    down = np.stack([-cl * co, -cl * so, -sl], axis=-1)
    return np.stack([north, east, down], axis=-1)


def turning_of_local_axes(position_e: ArrayLike, velocity_e: ArrayLike) -> NDArray[np.float64]:
    r"""Rate of change of the local axes of somebody who moves, `C_en` by time.

    .. math:: \dot C_{en} = C_{en} [\omega_{en}^n \times], \qquad \omega_{en}^n =
        \left(\tfrac{v_E}{R_E + h}, -\tfrac{v_N}{R_N + h},
        -\tfrac{v_E \tan L}{R_E + h}\right)

    `position_e`, `velocity_e` (..., 3) ECEF [m], [m/s]; returns (..., 3, 3) [1/s]; its columns are
    the rates of the north, east and down unit vectors.

    Notes
    -----
    Groves (2013), eqs. 5.43 and 5.44.
    """
    latitude, longitude, height = ecef_to_geodetic(position_e)
    C_en = dcm_e_from_n(latitude, longitude)
    speed = np.asarray(velocity_e, dtype=np.float64)
    north, east, _ = np.moveaxis(np.einsum("...ij,...i->...j", C_en, speed), -1, 0)
    w = 1.0 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2
    transverse = EQUATORIAL_RADIUS / np.sqrt(w)
    meridian = transverse * (1.0 - ECCENTRICITY_SQUARED) / w
    x, y = east / (transverse + height), -north / (meridian + height)
    z, none = -x * np.tan(latitude), np.zeros_like(x)
    cross = np.stack([none, -z, y, z, none, -x, -y, x, none], axis=-1)
    turning: NDArray[np.float64] = C_en @ cross.reshape(*x.shape, 3, 3)
    return turning
