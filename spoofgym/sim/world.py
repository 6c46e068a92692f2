"""The authentic world of one run: all truth, computed once and shared by all receivers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..earth.frames import dcm_e_from_n, ecef_to_geodetic, turning_of_local_axes
from ._kernels import fill_ranges
from .constellation import Constellation
from .trajectory import Trajectory

FloatArray = NDArray[np.float64]
CHANNELS = 12
MASK_DEG = 10.0


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
        """Number of epochs, K."""
        return len(self.epoch_time)

    @property
    def channels(self) -> int:
        """Number of slots, n."""
        return len(self.satellite_ids)

    @property
    def most_samples(self) -> int:
        """Most samples between two epochs, S."""
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

    def local_frame(self, epoch: int) -> FloatArray:
        """North-east-down axes at the true position of an epoch. Returns (3, 3) `C_en`, to ECEF
        from local axes."""
        C_en: FloatArray = self.C_en[epoch]
        return C_en


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
    """Satellites for the slots, in the order of their ids: those that are visible longest."""
    epochs = visible.sum(axis=0)
    longest = np.argsort(-epochs, kind="stable")[:channels]
    return sorted(int(i) for i in longest if epochs[i] > 0)
