"""From a recorded track to a flight: a smoothing spline and coordinated turns.

Fixes of recorded tracks are sparse and late by up to a second, so they weigh little, and the
velocity reported with them much.  Body axes follow from the path: yaw along the velocity, pitch
is the flight-path angle, and the bank leaves no lateral specific force.  The flight is one that
an aircraft could have flown, near to the fixes; how near, is in the report.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from ..earth.wgs84 import STANDARD_GRAVITY
from .flight import Flight, flight_from_geodetic
from .smoothing import SmoothPath, metres_per_radian, smooth_path
from .track import Track
from .trajectory import inverse_kinematics

LOAD_LIMITS = (0.3, 2.5)
"""Normal load factors of a flight [g], the larger one of EASA CS-25.337."""
RATE_LIMIT = math.radians(20.0)
"""Largest body rate of a flight [rad/s]."""
SLOWEST = 15.0
"""Smallest horizontal speed [m/s]; below, the velocity doesn't give the heading."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class FitReport:
    """How near a fitted flight is to its track, and how it flies.

    - `start_utc`: time of the first sample, ISO 8601;
    - `duration_s`: duration [s];
    - `doubted`: fixes, speeds and courses further off than 3 standard deviations, which weigh less;
    - `position_rms_m`, `position_max_m`: horizontal distance of the fixes from the flight [m];
    - `height_rms_m`: difference in height [m];
    - `speed_rms_mps`: difference between reported and flown groundspeed [m/s], NaN without any
      report;
    - `course_rms_deg`: difference between accepted and flown course [deg], NaN without any;
    - `speed_min_mps`, `speed_max_mps`: horizontal speed [m/s];
    - `load_min_g`, `load_max_g`: normal load factor [g];
    - `bank_max_deg`: largest bank in either direction [deg];
    - `rate_max_degps`: largest body rate about any axis [deg/s].
    """

    name: str
    start_utc: str
    duration_s: float
    fixes: int
    doubted: int
    position_rms_m: float
    position_max_m: float
    height_rms_m: float
    speed_rms_mps: float
    course_rms_deg: float
    speed_min_mps: float
    speed_max_mps: float
    load_min_g: float
    load_max_g: float
    bank_max_deg: float
    rate_max_degps: float

    def as_dict(self) -> dict[str, str | int | float | None]:
        """All fields by name, for JSON; None where there is nothing to compare."""
        return {key: None if value != value else value for key, value in asdict(self).items()}

    def lines(self) -> list[str]:
        """Sentences for people."""
        return [
            f"{self.name}: {self.duration_s:.0f} s from {self.start_utc}, {self.fixes} fixes, "
            f"{self.doubted} measurements doubted",
            f"distance of the fixes: RMS {self.position_rms_m:.0f} m, largest "
            f"{self.position_max_m:.0f} m; {_residual('height', self.height_rms_m, 'm')}; "
            f"{_residual('speed', self.speed_rms_mps, 'm/s')}; "
            f"{_residual('course', self.course_rms_deg, 'deg')}",
            f"speed {self.speed_min_mps:.0f} to {self.speed_max_mps:.0f} m/s, "
            f"load {self.load_min_g:.2f} to {self.load_max_g:.2f} g, bank up to "
            f"{self.bank_max_deg:.0f} deg, body rates up to {self.rate_max_degps:.1f} deg/s",
        ]


def _residual(name: str, value: float, unit: str) -> str:
    """A residual in words; NaN where the track has no such column."""
    return f"{name} not reported" if math.isnan(value) else f"{name} RMS {value:.1f} {unit}"


def fit_track(track: Track, *, rate_hz: float = 100.0) -> tuple[Flight, FitReport]:
    """Fit a flight to a track.  `rate_hz`: samples a second of the flight [Hz]."""
    if not 0.0 < rate_hz < math.inf:
        raise ValueError(f"`rate_hz` must be positive and finite, got {rate_hz:g}")
    path = smooth_path(track)
    time = np.arange(int(track.duration * rate_hz + 1e-6) + 1) / rate_hz
    latitude, longitude, height = path.position(time)
    velocity_n = path.velocity(time)
    slowest = int(np.hypot(velocity_n[:, 0], velocity_n[:, 1]).argmin())
    speed = math.hypot(velocity_n[slowest, 0], velocity_n[slowest, 1])
    if speed < SLOWEST:
        raise ValueError(
            f"the speed must stay above {SLOWEST:g} m/s for a heading, got {speed:.1f} m/s "
            f"{time[slowest]:.0f} s into {track.name!r}"
        )
    roll, pitch, yaw = coordinated_attitude(velocity_n, path.acceleration(time))
    flight = flight_from_geodetic(
        track.name, latitude, longitude, height, velocity_n, roll, pitch, yaw, 1.0 / rate_hz
    )
    return flight, _report(track, path, flight)


def coordinated_attitude(
    velocity_n: Floats, acceleration_n: Floats
) -> tuple[Floats, Floats, Floats]:
    r"""Euler angles of a coordinated flight along its velocity.

    .. math::
        \psi = \operatorname{atan2}(v_E, v_N), \quad
        \theta = \operatorname{atan2}(-v_D, v_h), \quad
        \tan\phi = \frac{v_h \dot\psi}{(g - a_D)\cos\theta - \dot v_h \sin\theta}

    `velocity_n`, `acceleration_n` (n, 3) velocity [m/s] and its derivative [m/s^2],
    north-east-down; returns `roll`, `pitch`, `yaw` (n,) [rad]; the specific force has no component
    along the body's right axis, but for the small part that the Earth's rotation adds.
    """
    north, east, down = velocity_n.T
    horizontal = np.hypot(north, east)
    lateral = (north * acceleration_n[:, 1] - east * acceleration_n[:, 0]) / horizontal
    along = (north * acceleration_n[:, 0] + east * acceleration_n[:, 1]) / horizontal
    pitch = np.arctan2(-down, horizontal)
    lift = (STANDARD_GRAVITY - acceleration_n[:, 2]) * np.cos(pitch) - along * np.sin(pitch)
    return np.arctan2(lateral, lift), pitch, np.unwrap(np.arctan2(east, north))


def _report(track: Track, path: SmoothPath, flight: Flight) -> FitReport:
    """Distances from the track, and a check of what the flight asks of an aircraft."""
    trajectory = inverse_kinematics(flight)
    load = -trajectory.specific_force_b[:, 2] / STANDARD_GRAVITY
    rate = np.abs(trajectory.angular_rate_b).max(axis=1)
    for sample in (int(load.argmin()), int(load.argmax())):
        if not LOAD_LIMITS[0] <= load[sample] <= LOAD_LIMITS[1]:
            raise ValueError(
                f"a fitted flight must lie within {LOAD_LIMITS[0]:g} and {LOAD_LIMITS[1]:g} g, "
                f"got {load[sample]:.2f} g {flight.time[sample]:.1f} s into {track.name!r}"
            )
    if rate[sample := int(rate.argmax())] > RATE_LIMIT:
        raise ValueError(
            f"a fitted flight must turn by at most {math.degrees(RATE_LIMIT):g} deg/s, got "
            f"{math.degrees(rate[sample]):.1f} deg/s {flight.time[sample]:.1f} s into "
            f"{track.name!r}"
        )
    latitude, longitude, height = path.position(track.time)
    per_north, per_east = metres_per_radian(track.latitude, track.height)
    distance = np.hypot(
        (latitude - track.latitude) * per_north,
        _half_turn(longitude - track.longitude) * per_east,
    )
    velocity = path.velocity(track.time)
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    off_course = _half_turn(np.arctan2(velocity[:, 1], velocity[:, 0]) - track.track_angle)
    horizontal = np.hypot(flight.velocity_n[:, 0], flight.velocity_n[:, 1])
    return FitReport(
        name=track.name,
        start_utc=track.start_utc.isoformat(),
        duration_s=flight.duration,
        fixes=track.time.size,
        doubted=path.doubted,
        position_rms_m=_rms(distance),
        position_max_m=float(distance.max()),
        height_rms_m=_rms(height - track.height),
        speed_rms_mps=_rms(speed - track.groundspeed),
        course_rms_deg=math.degrees(_rms(off_course)),
        speed_min_mps=float(horizontal.min()),
        speed_max_mps=float(horizontal.max()),
        load_min_g=float(load.min()),
        load_max_g=float(load.max()),
        bank_max_deg=math.degrees(float(np.abs(flight.euler[0]).max())),
        rate_max_degps=math.degrees(float(rate.max())),
    )


def _half_turn(angle: Floats) -> Floats:
    """Angle in [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def _rms(value: Floats) -> float:
    """Root mean square of the finite values, NaN without any."""
    finite = value[np.isfinite(value)]
    return math.sqrt(float(np.mean(finite**2))) if finite.size else math.nan
