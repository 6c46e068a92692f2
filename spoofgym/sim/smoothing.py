r"""Smooth paths through tracks: penalised least squares with quintic splines.

Latitude and longitude, scaled to metres near the first fix, and height are splines.  The misfit
is weighed with the standard deviations of fixes and reported velocities, the shape with
densities of the jerk: changes of the turn rate are cheap, changes of the acceleration along the
path dear, since aircraft turn much faster than they change speed.

.. math::
    \sum \rho\!\left(\frac{r - r_k}{\sigma_r}\right)
    + \sum \rho\!\left(\frac{e_k \cdot \dot r - v_k}{\sigma_v}\right)
    + \sum \rho\!\left(\frac{n_k \cdot \dot r}{\sigma_v}\right)
    + \int \frac{\ddot v^2}{q_v} + \frac{(n \cdot \dddot r)^2}{q_n}\,dt

with e and n along and across the course and :math:`\ddot v = e \cdot \dddot r + a_n^2 / v`, a_n
being the acceleration across.  The loss is Huber's: quadratic up to 3, linear beyond.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.sparse import block_diag, csc_array, csr_array, diags_array, hstack, vstack
from scipy.sparse.linalg import splu

from ..earth.wgs84 import ECCENTRICITY_SQUARED, EQUATORIAL_RADIUS
from .track import Track

POSITION_SD = 100.0
"""Standard deviation of a fix, north and east [m]: its time is late by up to a second."""
VELOCITY_SD = 2.0
"""Standard deviation of a reported velocity [m/s]: steps of 1 kt and 1 deg."""
HEIGHT_SD = 10.0
"""Standard deviation of a height [m]: steps of 25 ft, and up to a second of climb."""
TURN_JERK_PSD = 0.2
"""Spectral density of the jerk across the path [m^2/s^5]: 0.3 m/s^3 kept up for 2 s."""
SPEED_JERK_PSD = 0.005
"""Spectral density of the jerk along the path [m^2/s^5]: 0.05 m/s^3 kept up for 2 s."""
CLIMB_JERK_PSD = 0.005
"""Spectral density of the vertical jerk [m^2/s^5]."""
HUBER_LIMIT = 3.0
"""Misfit in standard deviations beyond which a measurement is doubted."""
KNOT_INTERVAL = 3.0
"""Interval of the knots of the splines [s]."""
DEGREE = 5
"""Degree of the splines; from 4 upwards the body rates are continuous."""
PASSES = 30
"""Most passes of the least squares, whose directions and weights follow from the last one."""
PASS_STOP = 0.1
"""Change of the path between passes at which it is done [m]."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SmoothPath:
    """Splines of latitude and longitude, scaled to metres near the origin, and of height.

    - `origin`: latitude, longitude [rad] and height [m] of the first fix;
    - `north`, `east`: distance from the origin, as latitude and longitude times what a radian of
      them measures there [m];
    - `height`: height above the ellipsoid [m];
    - `doubted`: measurements that lie further off than `HUBER_LIMIT` standard deviations.
    """

    described_as = "SmoothPath"
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
    intervals = max(2, round(track.duration / KNOT_INTERVAL))
    edges = np.linspace(0.0, track.duration, intervals + 1)
    knots = np.concatenate([np.zeros(DEGREE), edges, np.full(DEGREE, track.duration)])
    node, weight = _quadrature(edges)
    jerk = _scaled(_design(node, knots, 3), np.sqrt(weight / CLIMB_JERK_PSD))
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
        """Coefficients north and east, and the number of measurements doubted."""
        count = self.place.shape[0] + 2 * self.track.time.size
        trust = np.ones(count)
        solution = self._first_pass()
        for _ in range(PASSES):
            before = solution
            rows, values = self._measurements(before)
            jerks, jerk_values = self._jerks(before)
            trusted = _scaled(rows, np.sqrt(trust))
            solution = _solve([trusted, jerks], [np.sqrt(trust) * values, jerk_values])
            trust = self._trust(rows @ solution - values)
            if np.abs(self.place @ (solution - before)).max() < PASS_STOP:
                break
        north, east = np.split(solution, 2)
        half = self.track.time.size
        return north, east, int((trust[half:] < 1.0).sum())

    def _first_pass(self) -> Floats:
        """Fit to the fixes alone, without a difference between along and across."""
        scale = np.tile(np.sqrt(self.weight / TURN_JERK_PSD), 2)
        jerks = _scaled(vstack(self.node_jerk), scale)
        rows = [self.place / POSITION_SD, jerks]
        return _solve(rows, [self.fixes / POSITION_SD, np.zeros(jerks.shape[0])])

    def _measurements(self, solution: Floats) -> tuple[csr_array, Floats]:
        """Rows and values of all measurements over their standard deviation; 0 where missing. A
        groundspeed without a course weighs along the course of the pass before."""
        speed, course = self.track.groundspeed, self.track.track_angle
        reported = np.isfinite(course)
        flown = np.arctan2(self.rate[1] @ solution, self.rate[0] @ solution)
        along, across = _turned(self.rate, np.where(reported, course, flown))
        rows = vstack(
            [
                self.place / POSITION_SD,
                _scaled(along, np.isfinite(speed) / VELOCITY_SD),
                _scaled(across, reported / VELOCITY_SD),
            ]
        )
        values = [self.fixes / POSITION_SD, np.nan_to_num(speed) / VELOCITY_SD, 0.0 * course]
        return csr_array(rows), np.nan_to_num(np.concatenate(values))

    def _jerks(self, solution: Floats) -> tuple[csr_array, Floats]:
        """Rows and values of the jerk along and across the path of the pass before."""
        north, east = (row @ solution for row in self.node_rate)
        speed = np.maximum(np.hypot(north, east), 1.0)
        north_rate, east_rate = (row @ solution for row in self.node_acceleration)
        lateral = (north * east_rate - east * north_rate) / speed
        along, across = _turned(self.node_jerk, np.arctan2(east, north))
        dear, cheap = (np.sqrt(self.weight / psd) for psd in (SPEED_JERK_PSD, TURN_JERK_PSD))
        rows = vstack([_scaled(along, dear), _scaled(across, cheap)])
        return csr_array(rows), np.concatenate([-dear * lateral**2 / speed, 0.0 * cheap])

    def _trust(self, misfit: Floats) -> Floats:
        """Huber's weights; both coordinates of a fix share one."""
        count = self.track.time.size
        distance = np.hypot(misfit[:count], misfit[count : 2 * count])
        size = np.concatenate([distance, distance, np.abs(misfit[2 * count :])])
        return np.asarray(HUBER_LIMIT / np.maximum(size, HUBER_LIMIT))


def _pair(rows: csr_array, stretch: tuple[Floats, ...]) -> tuple[csr_array, csr_array]:
    """Rows north and east, acting on the coefficients of both splines."""
    nothing = csr_array(rows.shape)
    north, east = (_scaled(rows, factor) for factor in stretch)
    return csr_array(hstack([north, nothing])), csr_array(hstack([nothing, east]))


def _turned(pair: tuple[csr_array, csr_array], course: Floats) -> tuple[csr_array, csr_array]:
    """Rows along and across a course, from rows north and east."""
    cosine, sine = np.cos(course), np.sin(course)
    along = _scaled(pair[0], cosine) + _scaled(pair[1], sine)
    return along, _scaled(pair[1], cosine) - _scaled(pair[0], sine)


def _scaled(rows: csr_array, factor: Floats) -> csr_array:
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
    """Least squares by the normal equations."""
    stacked = csr_array(vstack(rows))
    normal = csc_array(stacked.T @ stacked)
    solution: Floats = splu(normal).solve(stacked.T @ np.concatenate(values))
    return solution
