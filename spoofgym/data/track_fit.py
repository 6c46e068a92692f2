r"""From a recorded track to a flight: a smoothing spline and coordinated turns.

The path is a penalised least squares with quintic splines.  Latitude and longitude, scaled to
metres near the first fix, and height are splines.  The misfit is weighed with the standard
deviations of fixes and reported velocities, the shape with densities of the jerk: changes of the
turn rate are cheap, changes of the acceleration along the path dear, since aircraft turn much
faster than they change speed.

.. math::
    \sum \rho\!\left(\frac{r - r_k}{\sigma_r}\right)
    + \sum \rho\!\left(\frac{e_k \cdot \dot r - v_k}{\sigma_v}\right)
    + \sum \rho\!\left(\frac{n_k \cdot \dot r}{\sigma_v}\right)
    + \int \frac{\ddot v^2}{q_v} + \frac{(n \cdot \dddot r)^2}{q_n}\,dt

with e and n along and across the course and :math:`\ddot v = e \cdot \dddot r + a_n^2 / v`, a_n
being the acceleration across.  The loss is Huber's: quadratic up to 3, linear beyond.

Fixes of recorded tracks are sparse and late by up to a second, so they weigh little, and the
velocity reported with them much.  Body axes follow from the path: yaw along the velocity, pitch
is the flight-path angle, and the bank leaves no lateral specific force.  The flight is one that
an aircraft could have flown, near to the fixes; how near, is in the report.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.sparse import block_diag, csc_array, csr_array, diags_array, hstack, vstack
from scipy.sparse.linalg import splu

from ..core.declared import check_number
from ..core.registry import require
from ..earth.wgs84 import ECCENTRICITY_SQUARED, EQUATORIAL_RADIUS, STANDARD_GRAVITY
from ..truth.flight import Flight, flight_from_geodetic, inverse_kinematics, settle_array

MINIMUM_FIXES = 6  # fewest fixes of a track; a quintic polynomial has as many coefficients
STEEPEST_LATITUDE = math.radians(89.0)  # closer to a pole, courses change too fast [rad]


@dataclass(frozen=True, eq=False)
class Track:
    """Distinct, airborne fixes without a gap.

    - `start_utc`: time of the first fix, with its time zone;
    - `time` (K,) time since `start_utc` [s], rising;
    - `latitude`, `longitude` (K,) geodetic [rad];
    - `height` (K,) height above the ellipsoid [m];
    - `groundspeed` (K,) speed over ground [m/s], NaN where none can be trusted;
    - `track_angle` (K,) course over ground, clockwise from north [rad], NaN likewise.
    """

    name: str
    start_utc: datetime
    time: NDArray[np.float64]
    latitude: NDArray[np.float64]
    longitude: NDArray[np.float64]
    height: NDArray[np.float64]
    groundspeed: NDArray[np.float64]
    track_angle: NDArray[np.float64]

    def __post_init__(self) -> None:
        require(
            self.start_utc.tzinfo is not None,
            f"`start_utc` must have a time zone, got {self.start_utc}",
        )
        count = np.size(self.time)
        require(
            count >= MINIMUM_FIXES, f"a track must have at least {MINIMUM_FIXES} fixes, got {count}"
        )
        for field in ("time", "latitude", "longitude", "height"):
            settle_array(self, field, (count,))
        for field in ("groundspeed", "track_angle"):
            settle_array(self, field, (count,), missing=True)
        require(
            self.time[0] == 0.0 and (np.diff(self.time) > 0.0).all(),
            "`time` must start at 0 s and rise from fix to fix",
        )
        if (worst := float(np.abs(self.latitude).max())) > STEEPEST_LATITUDE:
            raise ValueError(
                f"`latitude` must lie within {math.degrees(STEEPEST_LATITUDE):g} deg of the "
                f"equator, got {math.degrees(worst):g} deg"
            )

    @property
    def duration(self) -> float:
        return float(self.time[-1])


POSITION_SD = 100.0  # of a fix, north and east [m]: its time is late by up to a second
VELOCITY_SD = 2.0  # standard deviation of a reported velocity [m/s]: steps of 1 kt and 1 deg
LARGEST_RMS = 4.0 * POSITION_SD  # of the fixes around a flight [m]: more contradicts it
HEIGHT_SD = 10.0  # standard deviation of a height [m]: steps of 25 ft, and up to a second of climb
TURN_JERK_PSD = 0.2  # density of the jerk across the path [m^2/s^5]: 0.3 m/s^3 for 2 s
SPEED_JERK_PSD = 0.005  # density of the jerk along the path [m^2/s^5]: 0.05 m/s^3 for 2 s
CLIMB_JERK_PSD = 0.005  # spectral density of the vertical jerk [m^2/s^5]
HUBER_LIMIT = 3.0  # misfit in standard deviations beyond which a measurement is doubted
KNOT_INTERVAL = 3.0  # interval of the knots of the splines [s]
DEGREE = 5  # degree of the splines; from 4 upwards the body rates are continuous
PASSES = 30  # most passes of the least squares; directions and weights follow from the last one
PASS_STOP = 0.1  # change of the path between passes at which it is done [m]


@dataclass(frozen=True, eq=False)
class SmoothPath:
    """Splines of latitude and longitude, scaled to metres near the origin, and of height.

    - `origin`: latitude, longitude [rad] and height [m] of the first fix;
    - `north`, `east`: latitude and longitude relative to the origin, times the metres per radian
      there [m];
    - `height`: height above the ellipsoid [m];
    - `doubted`: number of measurements off by more than `HUBER_LIMIT` standard deviations.
    """

    origin: tuple[float, float, float]
    north: BSpline
    east: BSpline
    height: BSpline
    doubted: int

    def position(self, time: Floats) -> tuple[Floats, Floats, Floats]:
        """Latitude, longitude [rad] and height [m] at (n,) times [s]."""
        per_north, per_east = metres_per_radian(self.origin[0], self.origin[2])
        latitude = self.origin[0] + self.north(time) / per_north
        return latitude, self.origin[1] + self.east(time) / per_east, self.height(time)

    def velocity(self, time: Floats) -> Floats:
        """(n, 3) velocity, north-east-down [m/s], at (n,) times [s]."""
        return self._derivative(time, 1)

    def acceleration(self, time: Floats) -> Floats:
        """(n, 3) derivative of the velocity [m/s^2]; the turn of the local axes is left out."""
        return self._derivative(time, 2)

    def _derivative(self, time: Floats, order: int) -> Floats:
        latitude, _, height = self.position(time)
        per_north, per_east = metres_per_radian(self.origin[0], self.origin[2])
        here_north, here_east = metres_per_radian(latitude, height)
        north = self.north(time, order) * here_north / per_north
        east = self.east(time, order) * here_east / per_east
        return np.stack([north, east, -self.height(time, order)], axis=-1)


def smooth_path(track: Track) -> SmoothPath:
    edges = np.linspace(0.0, track.duration, max(2, round(track.duration / KNOT_INTERVAL)) + 1)
    knots = np.concatenate([np.zeros(DEGREE), edges, np.full(DEGREE, track.duration)])
    node, weight = _quadrature(edges)
    jerk = _scale_rows(_design(node, knots, 3), np.sqrt(weight / CLIMB_JERK_PSD))
    place = _design(track.time, knots, 0) / HEIGHT_SD
    height = _solve([place, jerk], [track.height / HEIGHT_SD, np.zeros(node.size)])
    north, east, doubted = _Plane(track, knots, node, weight).fit()
    origin = (float(track.latitude[0]), float(track.longitude[0]), float(track.height[0]))
    return SmoothPath(
        origin,
        BSpline(knots, north, DEGREE),
        BSpline(knots, east, DEGREE),
        BSpline(knots, height, DEGREE),
        doubted,
    )


def metres_per_radian(latitude: Floats | float, height: Floats | float) -> tuple[Floats, Floats]:
    """North and east distance per radian of latitude and longitude. `latitude`: geodetic [rad];
    `height`: above the ellipsoid [m]; returns `north`, `east`: R_N + h and (R_E + h) cos L [m]."""
    w = 1.0 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2
    transverse = EQUATORIAL_RADIUS / np.sqrt(w)
    meridian = transverse * (1.0 - ECCENTRICITY_SQUARED) / w
    return meridian + height, (transverse + height) * np.cos(latitude)


class _Plane:
    """The least squares of the horizontal path; coefficients north, then east."""

    def __init__(self, track: Track, knots: Floats, node: Floats, weight: Floats) -> None:
        per_north, per_east = metres_per_radian(track.latitude[0], track.height[0])
        here_north, here_east = metres_per_radian(track.latitude, track.height)
        stretch = here_north / per_north, here_east / per_east
        at_node = tuple(np.interp(node, track.time, value) for value in stretch)
        self.track = track
        self.weight = weight
        place = _design(track.time, knots, 0)
        self.place = csr_array(block_diag([place, place]))
        self.rate = _pair(_design(track.time, knots, 1), stretch)
        self.node_rate, self.node_acceleration, self.node_jerk = (
            _pair(_design(node, knots, order), at_node) for order in (1, 2, 3)
        )
        north = (track.latitude - track.latitude[0]) * per_north
        unwrapped = np.unwrap(track.longitude)
        self.fixes = np.concatenate([north, (unwrapped - unwrapped[0]) * per_east])

    def fit(self) -> tuple[Floats, Floats, int]:
        trust = np.ones(self.place.shape[0] + 2 * self.track.time.size)
        solution = self._first_pass()
        for _ in range(PASSES):
            before = solution
            rows, values = self._measurements(before)
            jerks, jerk_values = self._jerks(before)
            trusted = _scale_rows(rows, np.sqrt(trust))
            solution = _solve([trusted, jerks], [np.sqrt(trust) * values, jerk_values])
            trust = self._trust(rows @ solution - values)
            if np.abs(self.place @ (solution - before)).max() < PASS_STOP:
                break
        north, east = np.split(solution, 2)
        return north, east, int((trust[self.track.time.size :] < 1.0).sum())

    def _first_pass(self) -> Floats:
        scale = np.tile(np.sqrt(self.weight / TURN_JERK_PSD), 2)
        jerks = _scale_rows(vstack(self.node_jerk), scale)
        rows = [self.place / POSITION_SD, jerks]
        return _solve(rows, [self.fixes / POSITION_SD, np.zeros(jerks.shape[0])])

    def _measurements(self, solution: Floats) -> tuple[csr_array, Floats]:
        """Rows and values of all measurements over their standard deviation; 0 where missing. A
        groundspeed without a course weighs along the course of the pass before."""
        speed, course = self.track.groundspeed, self.track.track_angle
        reported = np.isfinite(course)
        flown = np.arctan2(self.rate[1] @ solution, self.rate[0] @ solution)
        along, across = _rotate_rows(self.rate, np.where(reported, course, flown))
        rows = vstack(
            [
                self.place / POSITION_SD,
                _scale_rows(along, np.isfinite(speed) / VELOCITY_SD),
                _scale_rows(across, reported / VELOCITY_SD),
            ]
        )
        values = [self.fixes / POSITION_SD, np.nan_to_num(speed) / VELOCITY_SD, 0.0 * course]
        return csr_array(rows), np.nan_to_num(np.concatenate(values))

    def _jerks(self, solution: Floats) -> tuple[csr_array, Floats]:
        north, east = (row @ solution for row in self.node_rate)
        speed = np.maximum(np.hypot(north, east), 1.0)
        north_rate, east_rate = (row @ solution for row in self.node_acceleration)
        lateral = (north * east_rate - east * north_rate) / speed
        along, across = _rotate_rows(self.node_jerk, np.arctan2(east, north))
        dear, cheap = (np.sqrt(self.weight / psd) for psd in (SPEED_JERK_PSD, TURN_JERK_PSD))
        rows = vstack([_scale_rows(along, dear), _scale_rows(across, cheap)])
        return csr_array(rows), np.concatenate([-dear * lateral**2 / speed, 0.0 * cheap])

    def _trust(self, misfit: Floats) -> Floats:
        """Huber's weights; both coordinates of a fix share one."""
        count = self.track.time.size
        distance = np.hypot(misfit[:count], misfit[count : 2 * count])
        size = np.concatenate([distance, distance, np.abs(misfit[2 * count :])])
        return np.asarray(HUBER_LIMIT / np.maximum(size, HUBER_LIMIT))


def _pair(rows: csr_array, stretch: tuple[Floats, ...]) -> tuple[csr_array, csr_array]:
    nothing = csr_array(rows.shape)
    north, east = (_scale_rows(rows, factor) for factor in stretch)
    return csr_array(hstack([north, nothing])), csr_array(hstack([nothing, east]))


def _rotate_rows(pair: tuple[csr_array, csr_array], course: Floats) -> tuple[csr_array, csr_array]:
    cosine, sine = np.cos(course), np.sin(course)
    along = _scale_rows(pair[0], cosine) + _scale_rows(pair[1], sine)
    return along, _scale_rows(pair[1], cosine) - _scale_rows(pair[0], sine)


def _scale_rows(rows: csr_array, factor: Floats) -> csr_array:
    return csr_array(diags_array(np.asarray(factor, dtype=np.float64)) @ rows)


def _design(time: Floats, knots: Floats, order: int) -> csr_array:
    """Matrix that turns coefficients into a derivative of the spline at (n,) times."""
    inner = knots[order : knots.size - order]
    matrix = csr_array(BSpline.design_matrix(time, inner, DEGREE - order))
    for degree in range(DEGREE - order + 1, DEGREE + 1):
        inner = knots[DEGREE - degree : knots.size - (DEGREE - degree)]
        count = inner.size - degree - 1
        scale = degree / (inner[degree + 1 : degree + count] - inner[1:count])
        difference = diags_array([-scale, scale], offsets=[0, 1], shape=(count - 1, count))
        matrix = csr_array(matrix @ difference)
    return matrix


def _quadrature(edges: Floats) -> tuple[Floats, Floats]:
    """Nodes and weights of Gauss' rule of 3 points between the edges, exact to degree 5."""
    node, weight = np.polynomial.legendre.leggauss(3)
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (1.0 + node)).ravel(), (half * weight).ravel()


def _solve(rows: list[csr_array], values: list[Floats]) -> Floats:
    stacked = csr_array(vstack(rows))
    normal = csc_array(stacked.T @ stacked)
    try:
        return np.asarray(splu(normal).solve(stacked.T @ np.concatenate(values)))
    except RuntimeError as error:  # of SuperLU
        raise ValueError(f"the fixes do not tell a path, check their times: {error}") from error


LOAD_LIMITS = (0.3, 2.5)  # normal load factors of a flight [g], the larger one of EASA CS-25.337
RATE_LIMIT = math.radians(20.0)  # largest body rate of a flight [rad/s]
ELSEWHERE = "; --from and --duration choose another part"
SLOWEST = 15.0  # smallest horizontal speed [m/s]; below, the velocity doesn't give the heading

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class FitReport:
    """How near a fitted flight is to its track, and how it flies.

    - `name` of the track, its `fixes`, `duration_s` [s], and `start_utc` of the first, ISO 8601;
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
        return {key: None if value != value else value for key, value in asdict(self).items()}

    def lines(self) -> list[str]:
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
    return f"{name} not reported" if math.isnan(value) else f"{name} RMS {value:.1f} {unit}"


def fit_track(track: Track, *, rate_hz: float = 100.0) -> tuple[Flight, FitReport]:
    check_number("rate_hz", rate_hz, above=0.0)
    path = smooth_path(track)
    time = np.arange(int(track.duration * rate_hz + 1e-6) + 1) / rate_hz
    latitude, longitude, height = path.position(time)
    velocity_n = path.velocity(time)
    slowest = int(np.hypot(velocity_n[:, 0], velocity_n[:, 1]).argmin())
    speed = math.hypot(velocity_n[slowest, 0], velocity_n[slowest, 1])
    if speed < SLOWEST:
        raise ValueError(
            f"the speed must stay above {SLOWEST:g} m/s for a heading, got {speed:.1f} m/s "
            f"{time[slowest]:.0f} s into {track.name!r}{ELSEWHERE}"
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
    trajectory = inverse_kinematics(flight)
    load = -trajectory.specific_force_b[:, 2] / STANDARD_GRAVITY
    rate = np.abs(trajectory.angular_rate_b).max(axis=1)
    for sample in (int(load.argmin()), int(load.argmax())):
        if not LOAD_LIMITS[0] <= load[sample] <= LOAD_LIMITS[1]:
            raise ValueError(
                f"a fitted flight must lie within {LOAD_LIMITS[0]:g} and {LOAD_LIMITS[1]:g} g, "
                f"got {load[sample]:.2f} g {flight.time[sample]:.1f} s into {track.name!r}"
                f"{ELSEWHERE}"
            )
    if rate[sample := int(rate.argmax())] > RATE_LIMIT:
        raise ValueError(
            f"a fitted flight must turn by at most {math.degrees(RATE_LIMIT):g} deg/s, got "
            f"{math.degrees(rate[sample]):.1f} deg/s {flight.time[sample]:.1f} s into "
            f"{track.name!r}{ELSEWHERE}"
        )
    latitude, longitude, height = path.position(track.time)
    per_north, per_east = metres_per_radian(track.latitude, track.height)
    distance = np.hypot(
        (latitude - track.latitude) * per_north, _half_turn(longitude - track.longitude) * per_east
    )
    if (rms := _rms(distance)) > LARGEST_RMS:
        raise ValueError(
            f"a fitted flight must stay near its fixes, within {LARGEST_RMS:g} m RMS, got "
            f"{rms:.0f} m for {track.name!r}: its groundspeeds, courses or times contradict its "
            "positions; check their units"
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
        position_rms_m=rms,
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
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def _rms(value: Floats) -> float:
    finite = value[np.isfinite(value)]
    return math.sqrt(float(np.mean(finite**2))) if finite.size else math.nan
