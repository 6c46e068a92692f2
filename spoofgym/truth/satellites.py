"""Satellites: what a constellation offers, and the circular six-plane model.

A constellation answers one question, where its satellites are and how they move at given times
of the simulation.  `CircularConstellation` is the analytic model of Groves (2013), "Principles of
GNSS, Inertial, and Multisensor Integrated Navigation Systems", whose MATLAB software ke2022 and
zhong2025 build on; `spoofgym.data.ephemerides` flies real broadcast ephemerides.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.declared import setting, settings_record
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


@settings_record(frozen=True)
class CircularConstellation:
    r"""Circular orbits on six planes, the constellation of Groves' software.

    Satellite j = 1..N is at argument of latitude u on the plane of node \Omega:

    .. math::
        u = \frac{2\pi (j - 1)}{N} + \omega t, \qquad
        \Omega = \frac{2\pi\,(j \bmod M)}{M} - \omega_{ie} t, \qquad
        \omega = \sqrt{\mu / r^3}
    """

    satellites: int = setting(
        default=30,
        least=1,
        most=99,
        help='Number of satellites N; their ids are "S01", "S02" and so on.',
    )
    radius_m: float = setting(
        default=2.656175e7, above=EQUATORIAL_RADIUS, unit="m", help="Orbital radius r."
    )
    inclination_deg: float = setting(
        default=55.0, least=0.0, most=180.0, unit="deg", help="Inclination."
    )
    time_offset_s: float = setting(
        default=0.0,
        unit="s",
        help="Added to the time of the simulation: another geometry over the same place.  It moves "
        "the satellites and turns the Earth, while the offset of Groves' software moves the "
        "satellites alone.",
    )
    planes: int = setting(default=6, least=1, most=99, help="Number of orbital planes M.")
    prefix: str = setting(
        default="S", help="Letter that the ids begin with, a capital one, A to Z."
    )

    def __post_init__(self) -> None:
        require(
            len(self.prefix) == 1 and "A" <= self.prefix <= "Z",
            f"`prefix` must be a capital letter, A to Z, got {self.prefix!r}",
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


@settings_record(frozen=True)
class CombinedConstellation:
    """Several constellations as one, on one system time: a receiver hears them all, and has one
    clock for them."""

    parts: tuple[Constellation, ...] = setting(help="Constellations with different satellite ids.")

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


_PLANES_OF_GALILEO = CircularConstellation(  # `galileo-os-sis-icd`
    satellites=24, radius_m=2.96e7, inclination_deg=56.0, planes=3, prefix="E"
)
TWO_CONSTELLATIONS = CombinedConstellation((CircularConstellation(), _PLANES_OF_GALILEO))
