"""The world of a loosely coupled receiver: a flight, inertial sensors, GNSS positions.

Its measurement is a position, so that there are no satellites; all else is as in `world`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from .._jit import njit
from .._registry import check_choice
from ..earth.frames import dcm_e_from_n
from ..earth.wgs84 import STANDARD_GRAVITY
from .manoeuvres import FLIGHTS
from .noise import normals
from .position_error import gauss_markov_step
from .trajectory import Trajectory, trajectory_at

FloatArray = NDArray[np.float64]
_DEG = math.pi / 180.0
_UG = STANDARD_GRAVITY * 1e-6
_GRID = 1e-9
IMU, GNSS, INITIAL = 0, 1, 2
"""Sources of chance; each has a key of its own in every episode."""
SOURCES = 3


@dataclass(frozen=True, kw_only=True)
class InertialErrors:
    """White noise and turn-on biases of the inertial sensors, and the errors of the alignment.

    All are standard deviations of what is drawn for every episode, except for the noise.

    - `gyro_bias_deg_per_h`, `accel_bias_ug`: turn-on biases of every axis;
    - `tilt_arcsec`, `heading_arcsec`: initial attitude about the two horizontal axes, and about the
      vertical one;
    - `velocity_mps`: initial velocity of every axis;
    - `horizontal_m`, `vertical_m`: initial position to the east and north, and upwards.

    The defaults are what the filter of `shadmehri2025` assumes of its sensors (section 4.2), before
    the factor of 3 of its initial covariance.
    """

    described_as = "InertialErrors"
    gyro_noise_deg_per_rth: float = 0.005
    accel_noise_ug_per_rthz: float = 20.0
    gyro_bias_deg_per_h: float = 0.01
    accel_bias_ug: float = 100.0
    tilt_arcsec: float = 20.0
    heading_arcsec: float = 180.0
    velocity_mps: float = 0.1
    horizontal_m: float = 3.7
    vertical_m: float = 6.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"`{name}` must be finite and >= 0, got {value}")

    @cached_property
    def noise(self) -> FloatArray:
        """(2,) root PSD of accelerometers and gyros [m/s^1.5], [rad/s^0.5]."""
        return np.array(
            [self.accel_noise_ug_per_rthz * _UG, self.gyro_noise_deg_per_rth * _DEG / 60.0]
        )

    @cached_property
    def initial_sd(self) -> FloatArray:
        """(15,) of the first state, east-north-up axes: `receiver.loose_model`; SI, radians."""
        arcsec = _DEG / 3600.0
        return np.concatenate(
            [
                np.array([self.tilt_arcsec, self.tilt_arcsec, self.heading_arcsec]) * arcsec,
                np.full(3, self.velocity_mps),
                [self.horizontal_m, self.horizontal_m, self.vertical_m],
                np.full(3, self.gyro_bias_deg_per_h * _DEG / 3600.0),
                np.full(3, self.accel_bias_ug * _UG),
            ]
        )


@dataclass(frozen=True, kw_only=True)
class LooseWorld:
    """Truth at every inertial sample and at every GNSS epoch.

    - `imu_interval_s`: between samples; an epoch has a whole number of them;
    - `run` (N, 6) true specific force [m/s^2] and angular rate [rad/s], body axes;
    - `position_e`, `velocity_e` (K, 3) true antenna at the epochs, ECEF [m], [m/s];
    - `C_eb` (K, 3, 3) true attitude;
    - `C_el` (K, 3, 3) to ECEF from local east-north-up axes.
    """

    described_as = "LooseWorld"
    name: str
    interval_s: float
    imu_interval_s: float
    run: FloatArray
    position_e: FloatArray
    velocity_e: FloatArray
    C_eb: FloatArray
    C_el: FloatArray

    @property
    def epochs(self) -> int:
        """Number of epochs, K."""
        return len(self.position_e)

    @property
    def samples(self) -> int:
        """Inertial samples of an epoch."""
        return round(self.interval_s / self.imu_interval_s)


def loose_world(trajectory: Trajectory, interval_s: float) -> LooseWorld:
    step = trajectory.step
    each = round(interval_s / step)
    if each < 1 or abs(each * step - interval_s) > _GRID:
        raise ValueError(
            f"`interval_s` must be a multiple of the inertial sensors' {step:g} s, got {interval_s}"
        )
    latitude, longitude, _ = trajectory.geodetic
    north, east, down = np.moveaxis(dcm_e_from_n(latitude, longitude), -1, 0)[:, ::each]
    samples = np.hstack([trajectory.specific_force_b, trajectory.angular_rate_b])
    return LooseWorld(
        name=trajectory.name,
        interval_s=interval_s,
        imu_interval_s=step,
        run=np.ascontiguousarray(samples),
        position_e=np.ascontiguousarray(trajectory.position_e[::each]),
        velocity_e=np.ascontiguousarray(trajectory.velocity_e[::each]),
        C_eb=np.ascontiguousarray(trajectory.C_eb[::each]),
        C_el=np.ascontiguousarray(np.stack([east, north, -down], axis=-1)),
    )


@lru_cache(maxsize=4)
def flown_world(flight: str, interval_s: float, imu_rate_hz: float | None = None) -> LooseWorld:
    """World of a ready-made flight; `imu_rate_hz` as in `Scenario`."""
    check_choice("flight", flight, FLIGHTS)
    return loose_world(trajectory_at(FLIGHTS[flight](), imu_rate_hz, interval_s), interval_s)


@njit
def first_errors(
    keys: NDArray[np.uint64],
    initial_sd: FloatArray,
    position_sd: FloatArray,
    deviates: FloatArray,
    initial: FloatArray,
    error: FloatArray,
) -> None:
    """Draw what an episode starts with. `keys` (B, 3, 2) key of every source; `initial_sd`,
    `position_sd` (15,) and (3,), of the state and of the GNSS position; `deviates` (64,) scratch
    memory; `initial` (B, 15), written: errors of the first estimate, then sensor biases; `error`
    (B, 3), written: GNSS position errors, east, north, up [m]."""
    for b in range(keys.shape[0]):
        normals(keys[b, INITIAL, 0], keys[b, INITIAL, 1], 0, deviates)
        for i in range(15):
            initial[b, i] = initial_sd[i] * deviates[i]
        for i in range(3):
            error[b, i] = position_sd[i] * deviates[15 + i]


@njit
def measure(
    keys: NDArray[np.uint64],
    epoch: NDArray[np.int64],
    run: FloatArray,
    position_e: FloatArray,
    C_el: FloatArray,
    interval: float,
    noise: FloatArray,
    bias: FloatArray,
    decay: float,
    position_sd: FloatArray,
    displacement: FloatArray,
    deviates: FloatArray,
    error: FloatArray,
    samples: FloatArray,
    fix_e: FloatArray,
) -> None:
    """Move every receiver to its next epoch and measure everything on the way.

    `keys` (B, 3, 2) key of every source; `epoch` (B,) that each receiver is at; advanced; `noise`
    (2,) root PSD of accelerometers and gyros; `bias` (B, 6) of gyros [rad/s] and accelerometers
    [m/s^2]; `position_sd` (3,) of the position errors [m]; `displacement` (B, 3) what the attack
    adds to the position, east, north, up [m]; `deviates` (P,) scratch memory, P a multiple of 64
    and at least 6 times the samples of an epoch; `error` (B, 3) errors of the GNSS position [m];
    advanced; `samples` (B, S, 6), written: measured specific force and angular rate, body axes;
    `fix_e` (B, 3), written: GNSS position, ECEF [m].
    """
    count = samples.shape[1]
    root = 1.0 / math.sqrt(interval)
    for b in range(keys.shape[0]):
        k = epoch[b] + 1
        epoch[b] = k
        normals(keys[b, IMU, 0], keys[b, IMU, 1], k, deviates)
        first = (k - 1) * count
        for c in range(6):
            level = noise[c // 3] * root
            constant = bias[b, 3 + c if c < 3 else c - 3]
            for i in range(count):
                noisy = level * deviates[c * count + i]
                samples[b, i, c] = run[first + i, c] + (constant + noisy)
        few = deviates[:64]
        normals(keys[b, GNSS, 0], keys[b, GNSS, 1], k, few)
        for c in range(3):
            error[b, c] = gauss_markov_step(error[b, c], decay, position_sd[c], few[c])
        e0 = error[b, 0] + displacement[b, 0]
        e1 = error[b, 1] + displacement[b, 1]
        e2 = error[b, 2] + displacement[b, 2]
        C = C_el[k]
        for i in range(3):
            fix_e[b, i] = position_e[k, i] + (C[i, 0] * e0 + C[i, 1] * e1 + C[i, 2] * e2)
