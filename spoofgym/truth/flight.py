"""A flight: the true motion of the antenna, and the samples of perfect inertial sensors.

A vehicle is a point with axes: antenna and inertial sensors share one place.  Position is by
construction the trapezoid integral of velocity, which is how the strapdown mechanization of
the receiver integrates, so that noise-free inertial samples lead back to the flight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.registry import is_number, require
from ..earth.attitude import dcm_to_euler, euler_to_dcm
from ..earth.wgs84 import dcm_e_from_n, ecef_to_geodetic, geodetic_to_ecef
from ._kernels import invert_samples

DEFAULT_STEP = 0.01  # interval of the inertial samples [s], as in Groves' profiles (`groves2013`)
CLOSURE_TOLERANCE = 1e-5  # largest distance of a position from the integral of the velocity [m]
ORTHONORMALITY_TOLERANCE = 1e-9  # largest element of C C' - I
PIECE = 8192  # rows, of a table over time, that are computed at a time
_PICARD_STOP = 1e-6
_PICARD_LIMIT = 100


def settle_array(record: Any, field: str, shape: tuple[int, ...], *, missing: bool = False) -> None:
    """Make a field of a frozen record a float64 copy in C order, finite; `missing`: or NaN."""
    value = np.array(getattr(record, field), dtype=np.float64, order="C")
    require(value.shape == shape, f"`{field}` must have shape {shape}, got {value.shape}")
    if missing:
        require(not np.isinf(value).any(), f"`{field}` must be finite or NaN, got infinity")
    else:
        require(np.isfinite(value).all(), f"`{field}` must be finite, got NaN or infinity")
    object.__setattr__(record, field, value)


@dataclass(frozen=True, eq=False)
class Flight:
    """True motion of a vehicle, sampled with a uniform step from time 0.

    - `time` (N+1,) time [s], ``np.arange(N + 1) * step``;
    - `position_e` (N+1, 3) antenna, ECEF [m]: the trapezoid integral of `velocity_e` from its first
      row;
    - `velocity_e` (N+1, 3) velocity with respect to the Earth, ECEF [m/s];
    - `C_eb` (N+1, 3, 3) attitude, to ECEF from body axes (forward, right, down).

    The arrays are C-contiguous float64 copies and must not be written to. They aren't locked,
    because a compiled kernel is compiled again for read-only arrays.
    """

    name: str
    time: NDArray[np.float64]
    position_e: NDArray[np.float64]
    velocity_e: NDArray[np.float64]
    C_eb: NDArray[np.float64]

    def __post_init__(self) -> None:
        count = np.size(self.time)
        require(count >= 2, f"`time` must have at least 2 samples, got {count}")
        settle_array(self, "time", (count,))
        settle_array(self, "position_e", (count, 3))
        settle_array(self, "velocity_e", (count, 3))
        settle_array(self, "C_eb", (count, 3, 3))
        self._check_time()
        pieces = (self.C_eb[piece] for piece in split_rows(count))
        worst = max(float(np.abs(C @ C.swapaxes(1, 2) - np.eye(3)).max()) for C in pieces)
        if worst > ORTHONORMALITY_TOLERANCE:
            raise ValueError(
                f"`C_eb` must be orthonormal to {ORTHONORMALITY_TOLERANCE:g}, got an error of "
                f"{worst:.3g}"
            )
        closed = integrate_velocity(self.position_e[0], self.velocity_e, self.step)
        check_closure(self.position_e, closed, self.step, CLOSURE_TOLERANCE)

    def _check_time(self) -> None:
        if self.time[0] != 0.0:
            raise ValueError(f"`time` must start at 0 s, got {self.time[0]:g}")
        uneven = np.abs(self.time - np.arange(self.time.size) * self.step)
        require(
            self.step > 0.0 and uneven.max() < 1e-6 * self.step,
            "`time` must rise with a uniform step, like np.arange(N + 1) * step",
        )

    @property
    def step(self) -> float:
        """Interval of the samples [s]."""
        return float(self.time[-1]) / (self.time.size - 1)

    @property
    def duration(self) -> float:
        return float(self.time[-1])

    @cached_property
    def geodetic(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        return ecef_to_geodetic(self.position_e)

    @cached_property
    def C_ne(self) -> NDArray[np.float64]:
        """(N+1, 3, 3), to local north-east-down from ECEF axes."""
        latitude, longitude, _ = self.geodetic
        return np.swapaxes(dcm_e_from_n(latitude, longitude), 1, 2)

    @cached_property
    def velocity_n(self) -> NDArray[np.float64]:
        """(N+1, 3) velocity with respect to the Earth, north-east-down [m/s]."""
        return np.asarray(np.einsum("nij,nj->ni", self.C_ne, self.velocity_e))

    @cached_property
    def euler(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        return dcm_to_euler(self.C_ne @ self.C_eb)


def integrate_velocity(
    start_e: ArrayLike, velocity_e: NDArray[np.float64], step: float
) -> NDArray[np.float64]:
    r"""Position as the trapezoid integral of velocity.

    .. math::
        r_{i+1} = r_i + \tfrac12 \Delta t\,(v_i + v_{i+1})

    `start_e` (3,) [m], `velocity_e` (N+1, 3) [m/s], ECEF; `step` [s]; returns (N+1, 3) [m].
    """
    position = np.zeros_like(velocity_e)
    np.cumsum(0.5 * step * (velocity_e[:-1] + velocity_e[1:]), axis=0, out=position[1:])
    position += np.asarray(start_e, dtype=np.float64)
    return position


def check_closure(
    position_e: NDArray[np.float64], closed_e: NDArray[np.float64], step: float, tolerance: float
) -> None:
    """Raise where positions stray from the integral of the velocities, (N+1, 3) each, ECEF [m]."""
    distance = np.linalg.norm(position_e - closed_e, axis=1)
    worst = int(distance.argmax())
    if distance[worst] > tolerance:
        raise ValueError(
            f"positions must be the integral of the velocities to {tolerance:g} m, "
            f"got {distance[worst]:.3g} m at {worst * step:g} s"
        )


def flight_from_geodetic(
    name: str,
    latitude: ArrayLike,
    longitude: ArrayLike,
    height: ArrayLike,
    velocity_n: ArrayLike,
    roll: ArrayLike,
    pitch: ArrayLike,
    yaw: ArrayLike,
    step: float = DEFAULT_STEP,
    tolerance: float = 1.0,
) -> Flight:
    """Flight from geodetic positions, north-east-down velocities and Euler angles.

    The positions turn velocity and attitude to ECEF axes; of them, only the first one is used
    as it is, and the others follow from the velocities.

    `latitude`, `longitude`, `height` (N+1,) [rad, rad, m]; `velocity_n` (N+1, 3) north-east-down
    [m/s]; `roll`, `pitch`, `yaw` (N+1,) [rad]; `step` [s]; `tolerance`: largest distance between
    given and integrated position [m].
    """
    given = geodetic_to_ecef(latitude, longitude, height)
    C_en = dcm_e_from_n(latitude, longitude)
    velocity_n = np.asarray(velocity_n, dtype=np.float64)
    velocity_e: NDArray[np.float64] = np.einsum("nij,nj->ni", C_en, velocity_n)
    closed = integrate_velocity(given[0], velocity_e, step)
    check_closure(given, closed, step, tolerance)
    C_eb = C_en @ euler_to_dcm(roll, pitch, yaw)
    return Flight(name, np.arange(len(closed), dtype=np.float64) * step, closed, velocity_e, C_eb)


def flight_from_velocity(
    name: str,
    latitude: float,
    longitude: float,
    height: float,
    velocity_n: ArrayLike,
    roll: ArrayLike,
    pitch: ArrayLike,
    yaw: ArrayLike,
    step: float = DEFAULT_STEP,
) -> Flight:
    r"""Flight from a start and the histories of velocity and Euler angles.

    Solves :math:`\dot r = C_{en}(r)\,v_n` by Picard's iteration, each of whose passes integrates
    by trapezoids.

    `latitude`, `longitude`, `height`: start [rad, rad, m]; the others as in `flight_from_geodetic`.
    """
    velocity_n = np.asarray(velocity_n, dtype=np.float64)
    start = geodetic_to_ecef(latitude, longitude, height)
    position = np.broadcast_to(start, velocity_n.shape)
    velocity_e, pieces = np.empty_like(velocity_n), split_rows(len(velocity_n))
    C_en = np.empty((*velocity_n.shape, 3))
    for number in range(_PICARD_LIMIT):
        before = position
        for piece in pieces:
            if number == 0 and piece.start > 0:  # all are where it starts
                C_en[piece] = C_en[pieces[0]][: len(C_en[piece])]
            else:
                C_en[piece] = dcm_e_from_n(*ecef_to_geodetic(before[piece])[:2])
            np.einsum("nij,nj->ni", C_en[piece], velocity_n[piece], out=velocity_e[piece])
        position = integrate_velocity(start, velocity_e, step)
        if np.abs(position - before).max() < _PICARD_STOP:
            break
    C_eb, angles = C_en, np.broadcast_arrays(roll, pitch, yaw)  # in its place
    for piece in pieces:
        C_eb[piece] = C_en[piece] @ euler_to_dcm(*(angle[piece] for angle in angles))
    time = np.arange(len(position), dtype=np.float64) * step
    return Flight(name, time, position, velocity_e, C_eb)


def split_rows(count: int) -> list[slice]:
    """Slices of at most `PIECE` rows, which need no more memory than they do."""
    return [slice(first, first + PIECE) for first in range(0, count, PIECE)]


LARGEST_ROTATION = math.radians(90.0)  # over one sample [rad]; beyond, its direction is uncertain
LARGEST_DECIMATED = 1.0  # of a longer sample [rad]: up to it the series of the receiver are exact


@dataclass(frozen=True, eq=False)
class Trajectory(Flight):
    """True motion and true inertial samples.

    - `name`, `time`, `position_e`, `velocity_e`, `C_eb`: as in `Flight`, N+1 states;
    - `specific_force_b` (N, 3) average specific force over (t_i, t_i+1], body axes [m/s^2];
    - `angular_rate_b` (N, 3) average angular rate against inertial space over (t_i, t_i+1], body
      axes [rad/s];
    - `decimation`: samples of the sensors that are summed up in each one here.
    """

    specific_force_b: NDArray[np.float64]
    angular_rate_b: NDArray[np.float64]
    decimation: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        settle_array(self, "specific_force_b", (self.time.size - 1, 3))
        settle_array(self, "angular_rate_b", (self.time.size - 1, 3))


@dataclass(frozen=True, eq=False, kw_only=True)
class Headings:
    r"""A flight in several directions, turned as a whole about the vertical where it begins.

    .. math::
        v' = R v, \qquad C_{eb}' = R\, C_{eb}, \qquad R = C_{en} R_z(\psi)\, C_{en}^T

    with :math:`C_{en}` at the first position, and :math:`\psi` an `angle` clockwise seen from above
    [rad].  The Earth is no sphere, so that heights come out otherwise by decimetres over tens of
    kilometres.

    Inertial samples may come at another rate, None for that of the flight.  Velocity and attitude
    are those of the flight; the position is the integral of that velocity over the longer samples,
    as of any flight, and so differs by millimetres.  At a lower rate, the flight's other samples
    are left out.

    `step` of the flight [s], `start_e` (3,); `time` (M+1,), `velocity_e` and `C_eb` of every
    `count`-th state; `whole`: the flight, where that is all of them.
    """

    name: str
    step: float
    count: int
    start_e: NDArray[np.float64]
    time: NDArray[np.float64]
    velocity_e: NDArray[np.float64]
    C_eb: NDArray[np.float64]
    whole: Flight | None = None

    @classmethod
    def sample(cls, flight: Flight, imu_rate_hz: float | None, epoch_interval_s: float) -> Headings:
        count = 1
        if imu_rate_hz is not None:
            count = compute_decimation(flight.step, imu_rate_hz, epoch_interval_s)
        names = "time", "velocity_e", "C_eb"
        return cls(
            name=flight.name,
            step=flight.step,
            count=count,
            start_e=flight.position_e[0].copy(),
            **{name: np.ascontiguousarray(getattr(flight, name)[::count]) for name in names},
            whole=flight if count == 1 else None,
        )

    def _turn(self, angle: float) -> NDArray[np.float64]:
        latitude, longitude, _ = ecef_to_geodetic(self.start_e)
        C_en = dcm_e_from_n(latitude, longitude)
        return np.asarray(C_en @ euler_to_dcm(0.0, 0.0, angle) @ C_en.T)

    def _move(self, angle: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Position and velocity (M+1, 3), turned."""
        velocity_e = self.velocity_e
        if angle != 0.0:
            velocity_e = velocity_e @ self._turn(angle).T
        return integrate_velocity(self.start_e, velocity_e, self.count * self.step), velocity_e

    def fly(self, angle: float) -> Flight:
        if angle == 0.0 and self.whole is not None:
            return self.whole
        C_eb = self.C_eb if angle == 0.0 else self._turn(angle) @ self.C_eb
        return Flight(self.name, self.time, *self._move(angle), C_eb)

    def trajectory(self, angle: float) -> Trajectory:
        largest = LARGEST_DECIMATED if self.count > 1 else LARGEST_ROTATION
        return inverse_kinematics(self.fly(angle), decimation=self.count, largest=largest)

    def positions(self, angle: float) -> NDArray[np.float64]:
        """(M+1, 3) `position_e` of a trajectory, and nothing else of it."""
        if angle == 0.0 and self.whole is not None:
            return self.whole.position_e
        return self._move(angle)[0]


def compute_decimation(step: float, rate_hz: float, epoch_interval_s: float) -> int:
    """Number of the flight's samples, `step` [s] each, in one sample at `rate_hz`; a ValueError
    unless every epoch ends with a sample."""
    per_epoch = max(round(epoch_interval_s / step), 1)
    valid = {count: 1.0 / (count * step) for count in range(1, per_epoch + 1)}
    valid = {count: rate for count, rate in valid.items() if per_epoch % count == 0}
    for count, rate in valid.items():
        if is_number(rate_hz) and abs(rate_hz - rate) <= 1e-6 * rate:
            return count
    raise ValueError(
        f"`imu_rate_hz` must divide the flight's {1.0 / step:g} Hz into whole samples between "
        f"epochs of {epoch_interval_s:g} s: {', '.join(f'{rate:g}' for rate in valid.values())}; "
        f"got {rate_hz!r}"
    )


def inverse_kinematics(
    flight: Flight, *, decimation: int = 1, largest: float = LARGEST_ROTATION
) -> Trajectory:
    r"""Inertial samples of a flight: the exact inverse of one strapdown step after another.

    .. math::
        C^+ &= R_z(a)\, C^- \left(I + \tfrac{\sin\alpha}{\alpha} A
               + \tfrac{1 - \cos\alpha}{\alpha^2} A^2\right) \\
        f_e &= \left(C^- \left[I + \tfrac{1 - \cos\alpha}{\alpha^2} A
               + \tfrac{1 - \sin\alpha/\alpha}{\alpha^2} A^2\right]
               - \tfrac12 [(0, 0, a) \times] C^-\right) f \\
        v^+ &= v^- + \Delta t\,(f_e + g(r^-) - 2 \omega_{ie} \times v^-) \\
        r^+ &= r^- + \tfrac12 \Delta t\,(v^- + v^+)

    with :math:`\alpha = \omega \Delta t`, :math:`A = [\alpha\times]`,
    :math:`a = \omega_{ie} \Delta t`, :math:`R_z(a)` the turn of the Earth, and :math:`I + A` and
    :math:`I` in place of the brackets for :math:`|\alpha| \le 10^{-8}`.

    `decimation`: as in `Trajectory`, done already; `largest`: rotation over a sample [rad]. Groves
    (2013), section 5.5, solved for the samples.
    """
    samples = np.empty((2, flight.time.size - 1, 3))
    motion = flight.position_e, flight.velocity_e, flight.C_eb
    turn = invert_samples(flight.step, *motion, *samples)
    require(
        turn <= largest,
        f"a flight must turn by at most {math.degrees(largest):g} deg in a sample, "
        f"got {math.degrees(turn):.3g} deg",
    )
    return Trajectory(flight.name, flight.time, *motion, samples[0], samples[1], decimation)
