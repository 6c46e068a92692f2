"""Twelve satellites in view: skies of circular orbits, and random ones.

The paper prints none.  Its figures hardly depend on it, but for the residuals' own separation
(table 3) and the rows of one and eleven spoofed satellites; so several skies are averaged.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spoofgym.earth.wgs84 import dcm_e_from_n, geodetic_to_ecef
from spoofgym.truth.satellites import CircularConstellation

FloatArray = NDArray[np.float64]

SATELLITES = 12
STEP_S = 600.0
DAY_S = 86_400.0
GDOP = (1.3, 2.3)
"""What a sane sky of 12 satellites has."""


class Place(NamedTuple):
    """A sky to search for.

    - `orbits`: satellites of the circular model; 0 for a random sky;
    - `latitude_deg`, `longitude_deg`: where the receiver is;
    - `mask_deg`: least elevation;
    - `start_s`: when to begin to search; number of the sky for a random one.
    """

    orbits: int
    latitude_deg: float
    longitude_deg: float
    mask_deg: float
    start_s: float


PLACES = (
    Place(36, 40.0, 116.0, 10.0, 0.0),
    Place(30, 52.0, 5.0, 5.0, 0.0),
    Place(0, 40.0, 116.0, 10.0, 1.0),
    Place(36, 0.0, 20.0, 10.0, 20_000.0),
    Place(36, -35.0, 150.0, 10.0, 40_000.0),
    Place(32, 40.0, 116.0, 5.0, 0.0),
    Place(0, 40.0, 116.0, 5.0, 2.0),
    Place(36, 60.0, -20.0, 10.0, 60_000.0),
)
"""Skies of a full run; a quick one takes the first three."""


def gdop(lines: FloatArray) -> float:
    """Geometric dilution of precision. `lines`: (n, 3) rows of the geometry without the clock's
    column."""
    G = np.column_stack([lines, np.ones(len(lines))])
    return math.sqrt(np.trace(np.linalg.inv(G.T @ G)))


def sky(number: int) -> FloatArray:
    """Rows of one sky, minus the lines of sight. Returns (12, 3) in ECEF axes, as the paper's
    equation 2 has them."""
    place = PLACES[number]
    return _random_sky(place) if place.orbits == 0 else _orbits(place)


def _orbits(place: Place) -> FloatArray:
    """First time at which exactly 12 satellites are above the mask."""
    latitude, longitude = math.radians(place.latitude_deg), math.radians(place.longitude_deg)
    here, up = geodetic_to_ecef(latitude, longitude, 0.0), -dcm_e_from_n(latitude, longitude)[:, 2]
    time = place.start_s + np.arange(0.0, DAY_S, STEP_S)
    apart = CircularConstellation(satellites=place.orbits).states(time).position_e - here
    u = apart / np.linalg.norm(apart, axis=-1, keepdims=True)
    visible = u @ up > math.sin(math.radians(place.mask_deg))
    for k in np.flatnonzero(visible.sum(axis=1) == SATELLITES):
        lines = -u[k, visible[k]]
        if GDOP[0] <= gdop(lines) <= GDOP[1]:
            return np.ascontiguousarray(lines)
    raise ValueError(f"no sky of {SATELLITES} satellites within a day at {place}")


def _random_sky(place: Place) -> FloatArray:
    """Uniform over the sky above the mask."""
    rng = np.random.default_rng(int(place.start_s))
    C_en = dcm_e_from_n(math.radians(place.latitude_deg), math.radians(place.longitude_deg))
    while True:
        up = rng.uniform(math.sin(math.radians(place.mask_deg)), 1.0, SATELLITES)
        azimuth = rng.uniform(0.0, 2.0 * math.pi, SATELLITES)
        level = np.sqrt(1.0 - up**2)
        u_n = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), -up])
        lines = -u_n @ C_en.T
        if GDOP[0] <= gdop(lines) <= GDOP[1]:
            return np.ascontiguousarray(lines)
