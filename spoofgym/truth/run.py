"""All truth of one run, for each victim.

The world of a loosely coupled receiver: a flight, inertial sensors, GNSS positions.

Its measurement is a position, so that there are no satellites; all else is as in `World`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.compile import njit
from ..core.registry import check_choice
from ..earth.wgs84 import STANDARD_GRAVITY, dcm_e_from_n, ecef_to_geodetic, turning_of_local_axes
from ._kernels import fill_ranges
from .flight import Trajectory, trajectory_at
from .gnss_errors import gauss_markov_step
from .manoeuvres import FLIGHTS
from .noise import normals
from .satellites import Constellation

FloatArray = NDArray[np.float64]
CHANNELS = 12
MASK_DEG = 10.0


class EpochTruth(NamedTuple):
    """Truth of `World` at its epochs, as kernels take it."""

    epoch_time: FloatArray
    satellites: FloatArray
    position_e: FloatArray
    velocity_e: FloatArray


@dataclass(frozen=True, kw_only=True)
class World:
    """Truth at every inertial sample and at every GNSS epoch.

    Epoch 0 is at time zero; epoch k ends with sample ``epoch_end[k]`` (exclusive).  Channels are
    slots for satellites, the same for the whole run, ordered by satellite id.

    - `satellite_ids` (n,) id of each slot; ``""`` for a slot that stays empty;
    - `imu_time` (N+1,) start of the first sample and end of every sample [s];
    - `run` (8, N) true specific force [m/s^2] and angular rate [rad/s], body axes; length of every
      sample [s], and one over its square root [Hz^0.5];
    - `epoch_time` (K,) [s];
    - `epoch_end` (K,) int64, number of samples up to the epoch;
    - `satellites` (K, n, 8) satellite position and velocity, ECEF, true range [m] and range rate
      [m/s] without clocks; the range is 0 where the slot is not visible;
    - `visible` (K, n) bool, above the mask;
    - `elevation`, `azimuth` (K, n) [rad]; 0 for an empty slot;
    - `position_e`, `velocity_e` (K, 3) true antenna, ECEF [m], [m/s];
    - `C_eb` (K, 3, 3) true attitude;
    - `C_en` (K, 3, 3) to ECEF from the north-east-down axes at the true position;
    - `decimation`: as in `Trajectory`.
    """

    name: str
    satellite_ids: tuple[str, ...]
    imu_time: FloatArray
    run: FloatArray
    epoch_time: FloatArray
    epoch_end: NDArray[np.int64]
    satellites: FloatArray
    visible: NDArray[np.bool_]
    elevation: FloatArray
    azimuth: FloatArray
    position_e: FloatArray
    velocity_e: FloatArray
    C_eb: FloatArray
    C_en: FloatArray
    decimation: int = 1

    @property
    def epochs(self) -> int:
        return len(self.epoch_time)

    @property
    def channels(self) -> int:
        return len(self.satellite_ids)

    @property
    def most_samples(self) -> int:
        return int(np.diff(self.epoch_end).max())

    @property
    def first_elevation(self) -> FloatArray:
        """(n,) elevation of each slot when it is first visible [rad]; 90 deg where it never is."""
        first = np.argmax(self.visible, axis=0)
        seen = self.visible.any(axis=0)
        return np.where(seen, self.elevation[first, np.arange(self.channels)], np.pi / 2)

    @cached_property
    def axes_turning(self) -> FloatArray:
        """(K, 3, 3) rate of change of `C_en` [1/s], since the axes move with the true position."""
        return np.ascontiguousarray(turning_of_local_axes(self.position_e, self.velocity_e))

    @cached_property
    def epoch_truth(self) -> EpochTruth:
        return EpochTruth(*(getattr(self, name) for name in EpochTruth._fields))


def build_world(
    trajectory: Trajectory,
    constellation: Constellation,
    *,
    epoch_interval_s: float = 0.5,
    channels: int = CHANNELS,
    mask_deg: float = MASK_DEG,
) -> World:
    """Compute the truth of a run. `constellation`: satellites; where more rise above the mask than
    there are channels, those that stay longest are taken."""
    time = trajectory.time
    step = time[1] - time[0]
    per_epoch = round(epoch_interval_s / step)
    if per_epoch < 1 or abs(per_epoch * step - epoch_interval_s) > 1e-6 * step:
        raise ValueError(
            f"`epoch_interval_s` must be a multiple of the sample interval {step:g} s, "
            f"got {epoch_interval_s}"
        )
    if not 4 <= channels <= 32:
        raise ValueError(f"`channels` must be 4 to 32, got {channels}")
    if not 0.0 <= mask_deg <= 60.0:
        raise ValueError(f"`mask_deg` must be 0 to 60, got {mask_deg}")
    epoch_end = np.arange(0, len(time), per_epoch, dtype=np.int64)
    if len(epoch_end) < 2:
        raise ValueError(f"a run of {time[-1]:g} s holds no epoch of {epoch_interval_s:g} s")
    position_e = trajectory.position_e[epoch_end]
    velocity_e = trajectory.velocity_e[epoch_end]
    states = constellation.states(time[epoch_end])
    elevation, azimuth = _look(states.position_e, position_e)
    usable = np.isfinite(states.position_e).all(-1) & np.isfinite(states.velocity_e).all(-1)
    visible = usable & (elevation > np.radians(mask_deg))
    chosen = _choose(visible, channels)
    ids = tuple(constellation.satellite_ids[i] for i in chosen)
    ids += ("",) * (channels - len(chosen))

    seen = _in_slots(visible, chosen, channels).astype(np.bool_)
    if seen[0].sum() < 4:
        raise ValueError(
            f"only {seen[0].sum()} satellites are above {mask_deg:g} deg at time zero; "
            "a first fix needs 4"
        )
    satellites = np.zeros((len(epoch_end), channels, 8))
    satellites[:, :, :3] = _in_slots(states.position_e, chosen, channels)
    satellites[:, :, 3:6] = _in_slots(states.velocity_e, chosen, channels)
    fill_ranges(satellites, seen, position_e, velocity_e)
    return World(
        name=trajectory.name,
        satellite_ids=ids,
        imu_time=time.copy(),
        run=np.ascontiguousarray(  # stacked columns would lie as columns
            np.vstack(
                [
                    trajectory.specific_force_b.T,
                    trajectory.angular_rate_b.T,
                    np.diff(time),
                    1.0 / np.sqrt(np.diff(time)),
                ]
            )
        ),
        epoch_time=time[epoch_end].copy(),
        epoch_end=epoch_end,
        satellites=satellites,
        visible=seen,
        elevation=_in_slots(elevation, chosen, channels),
        azimuth=_in_slots(azimuth, chosen, channels),
        position_e=position_e.copy(),
        velocity_e=velocity_e.copy(),
        C_eb=trajectory.C_eb[epoch_end].copy(),
        C_en=np.ascontiguousarray(dcm_e_from_n(*ecef_to_geodetic(position_e)[:2])),
        decimation=trajectory.decimation,
    )


def _look(satellites: FloatArray, position_e: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Elevation and azimuth [rad], (K, n), of satellites (K, n, 3) seen from (K, 3)."""
    latitude, longitude, _ = ecef_to_geodetic(position_e)
    C_en = dcm_e_from_n(latitude, longitude)
    sight = np.einsum("kji,knj->kni", C_en, satellites - position_e[:, None, :])
    horizontal = np.hypot(sight[..., 0], sight[..., 1])
    return np.arctan2(-sight[..., 2], horizontal), np.arctan2(sight[..., 1], sight[..., 0])


def _in_slots(array: NDArray[Any], chosen: list[int], channels: int) -> FloatArray:
    """Columns of the chosen satellites, then zeros up to the number of channels; NaN become 0."""
    slots = np.zeros((len(array), channels, *array.shape[2:]))
    slots[:, : len(chosen)] = np.nan_to_num(array[:, chosen])
    return slots


def _choose(visible: NDArray[np.bool_], channels: int) -> list[int]:
    epochs = visible.sum(axis=0)
    longest = np.argsort(-epochs, kind="stable")[:channels]
    return sorted(int(i) for i in longest if epochs[i] > 0)


_DEG = math.pi / 180.0
_UG = STANDARD_GRAVITY * 1e-6
_GRID = 1e-9
IMU, GNSS, INITIAL = 0, 1, 2  # sources of chance; each has a key of its own in every episode
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
        """(15,) of the first state, east-north-up axes: `receiver.loose_states`; SI, radians."""
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
        return len(self.position_e)

    @property
    def samples(self) -> int:
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


def chain_worlds(worlds: Sequence[World]) -> World:
    """World in which the epochs of some worlds follow one another. World w of K epochs each has the
    epochs ``w K`` to ``(w + 1) K - 1``. Times start again with each; nothing may cross from one to
    the next."""
    first = worlds[0]
    if len(worlds) == 1:
        return first
    for world in worlds:
        if world.channels != first.channels or not (
            np.array_equal(world.epoch_time, first.epoch_time)
            and np.array_equal(world.imu_time, first.imu_time)
        ):
            raise ValueError("worlds in a chain must have the same times and the same slots")
    same = all(world.satellite_ids == first.satellite_ids for world in worlds)
    samples = first.run.shape[1]
    ends = [world.epoch_end + w * samples for w, world in enumerate(worlds)]
    ids = first.satellite_ids if same else tuple(f"slot{s:02d}" for s in range(first.channels))

    def joined(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(world, name) for world in worlds])

    return replace(
        first,
        satellite_ids=ids,
        run=np.ascontiguousarray(np.concatenate([world.run for world in worlds], axis=1)),
        epoch_time=joined("epoch_time"),
        epoch_end=np.concatenate(ends),
        satellites=joined("satellites"),
        visible=joined("visible"),
        elevation=joined("elevation"),
        azimuth=joined("azimuth"),
        position_e=joined("position_e"),
        velocity_e=joined("velocity_e"),
        C_eb=joined("C_eb"),
        C_en=joined("C_en"),
    )
