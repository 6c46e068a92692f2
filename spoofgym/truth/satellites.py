"""Satellites: what a constellation offers, and the circular six-plane model.

A constellation answers one question, where its satellites are and how they move at given times
of the simulation.  `CircularConstellation` is the analytic model of Groves (2013), "Principles of
GNSS, Inertial, and Multisensor Integrated Navigation Systems", whose MATLAB software ke2022 and
zhong2025 build on; `spoofgym.data.ephemerides` flies real broadcast ephemerides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.registry import require
from ..earth.wgs84 import EARTH_RATE, EQUATORIAL_RADIUS, GRAVITATIONAL_CONSTANT


class SatelliteStates(NamedTuple):
    """Positions and velocities of n satellites at K times, (K, n, 3) each, ECEF [m], [m/s]; NaN
    where a satellite has no usable ephemeris."""

    position_e: NDArray[np.float64]
    velocity_e: NDArray[np.float64]


class Constellation(Protocol):
    """Satellites whose motion is known at any time of the simulation."""

    @property
    def satellite_ids(self) -> tuple[str, ...]:
        """The n satellite ids in the order of the states' second axis, sorted: "G01", "G02"."""

    def states(self, time: ArrayLike) -> SatelliteStates:
        """Positions and velocities at (K,) times of the simulation [s]."""


def checked_time(time: ArrayLike) -> NDArray[np.float64]:
    """(K,) times of the simulation [s], finite."""
    times = np.asarray(time, dtype=np.float64)
    require(times.ndim == 1, f"`time` must have shape (K,), got {times.shape}")
    if not np.isfinite(times).all():
        raise ValueError(f"`time` must be finite, got {times[~np.isfinite(times)][0]}")
    return times


def ecef_from_orbit(
    radius: ArrayLike,
    radius_rate: ArrayLike,
    latitude_argument: ArrayLike,
    latitude_argument_rate: ArrayLike,
    node: ArrayLike,
    node_rate: ArrayLike,
    inclination: ArrayLike,
    inclination_rate: ArrayLike,
) -> SatelliteStates:
    r"""Position and velocity in ECEF axes from the instantaneous orbital plane.

    .. math::
        \mathbf r = \begin{pmatrix}
        x' \cos\Omega - y' \cos i \sin\Omega\\ x' \sin\Omega + y' \cos i \cos\Omega\\ y' \sin i
        \end{pmatrix}, \qquad x' = r \cos u, \quad y' = r \sin u

    and the velocity is its derivative; (S, 3) each. IS-GPS-200, table 20-IV; Groves (2013), section
    8.5.
    """
    su, cu = np.sin(latitude_argument), np.cos(latitude_argument)
    so, co = np.sin(node), np.cos(node)
    si, ci = np.sin(inclination), np.cos(inclination)
    x_o, y_o = np.multiply(radius, cu), np.multiply(radius, su)
    vx_o = np.multiply(radius_rate, cu) - y_o * latitude_argument_rate
    vy_o = np.multiply(radius_rate, su) + x_o * latitude_argument_rate
    x = x_o * co - y_o * ci * so
    y = x_o * so + y_o * ci * co
    tilt = y_o * si * inclination_rate
    velocity = (
        vx_o * co - vy_o * ci * so + tilt * so - y * node_rate,
        vx_o * so + vy_o * ci * co - tilt * co + x * node_rate,
        vy_o * si + y_o * ci * inclination_rate,
    )
    return SatelliteStates(
        np.stack(np.broadcast_arrays(x, y, y_o * si), axis=-1),
        np.stack(np.broadcast_arrays(*velocity), axis=-1),
    )


@dataclass(frozen=True)
class CircularConstellation:
    r"""Circular orbits on six planes, the constellation of Groves' software.

    Satellite j = 1..N is at argument of latitude u on the plane of node \Omega:

    .. math::
        u = \frac{2\pi (j - 1)}{N} + \omega t, \qquad
        \Omega = \frac{2\pi\,(j \bmod M)}{M} - \omega_{ie} t, \qquad
        \omega = \sqrt{\mu / r^3}

    - `satellites`: number of satellites N, 1 to 99; their ids are "S01", "S02" and so on;
    - `radius_m`: orbital radius r [m], above the Earth's surface;
    - `inclination_deg`: inclination [deg], 0 to 180;
    - `time_offset_s`: added to the time of the simulation [s]: another geometry over the same
      place.  It moves the satellites and turns the Earth, while the offset of Groves' software
      moves the satellites alone;
    - `planes`: number of orbital planes M, 1 to 99;
    - `prefix`: one capital letter that the ids begin with.
    """

    described_as = "CircularConstellation"
    satellites: int = 30
    radius_m: float = 2.656175e7
    inclination_deg: float = 55.0
    time_offset_s: float = 0.0
    planes: int = 6
    prefix: str = "S"

    def __post_init__(self) -> None:
        for name, low, high in (
            ("planes", 1, 99),
            ("satellites", 1, 99),
            ("inclination_deg", 0, 180),
        ):
            if not low <= getattr(self, name) <= high:
                value = getattr(self, name)
                raise ValueError(f"`{name}` must be within {low}..{high}, got {value}")
        require(
            len(self.prefix) == 1 and "A" <= self.prefix <= "Z",
            f"`prefix` must be a capital letter, A to Z, got {self.prefix!r}",
        )
        require(
            EQUATORIAL_RADIUS < self.radius_m < math.inf,
            f"`radius_m` must be above {EQUATORIAL_RADIUS:.0f} m, got {self.radius_m}",
        )
        require(
            math.isfinite(self.time_offset_s),
            f"`time_offset_s` must be finite, got {self.time_offset_s}",
        )

    @property
    def satellite_ids(self) -> tuple[str, ...]:
        return tuple(f"{self.prefix}{j:02d}" for j in range(1, self.satellites + 1))

    @property
    def angular_rate(self) -> float:
        return math.sqrt(GRAVITATIONAL_CONSTANT / self.radius_m**3)

    def states(self, time: ArrayLike) -> SatelliteStates:
        t = checked_time(time)[:, None] + self.time_offset_s
        j = np.arange(1, self.satellites + 1)
        return ecef_from_orbit(
            radius=self.radius_m,
            radius_rate=0.0,
            latitude_argument=2.0 * np.pi * (j - 1) / self.satellites + self.angular_rate * t,
            latitude_argument_rate=self.angular_rate,
            node=2.0 * np.pi * (j % self.planes) / self.planes - EARTH_RATE * t,
            node_rate=-EARTH_RATE,
            inclination=math.radians(self.inclination_deg),
            inclination_rate=0.0,
        )


@dataclass(frozen=True)
class CombinedConstellation:
    """Several constellations as one, on one system time. `parts`: with different satellite ids; a
    receiver hears them all, and has one clock for them."""

    described_as = "CombinedConstellation"
    parts: tuple[Constellation, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", tuple(self.parts))
        require(self.parts, "`parts` must hold at least one constellation, got none")
        ids = [name for part in self.parts for name in part.satellite_ids]
        twice = sorted({name for name in ids if ids.count(name) > 1})
        if twice:
            raise ValueError(f"`parts` must have different satellite ids, got {twice[0]!r} twice")

    @property
    def _order(self) -> NDArray[np.intp]:
        return np.argsort([name for part in self.parts for name in part.satellite_ids])

    @property
    def satellite_ids(self) -> tuple[str, ...]:
        return tuple(sorted(name for part in self.parts for name in part.satellite_ids))

    def states(self, time: ArrayLike) -> SatelliteStates:
        states = [part.states(time) for part in self.parts]
        position, velocity = (np.concatenate(group, axis=1) for group in zip(*states, strict=True))
        return SatelliteStates(position[:, self._order], velocity[:, self._order])


TWO_CONSTELLATIONS = (
    CombinedConstellation(  # the book's, and planes as of Galileo (`galileo-os-sis-icd`)
        (
            CircularConstellation(),
            CircularConstellation(
                satellites=24, radius_m=2.96e7, inclination_deg=56.0, planes=3, prefix="E"
            ),
        )
    )
)
