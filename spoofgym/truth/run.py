"""All truth of one run: `GroundTruth` of tightly coupled receivers, `LooseWorld` of loosely coupled
ones, which measure positions, and `Sky` of snapshot receivers, which have no inertial sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_number, setting, settings_record
from ..core.registry import check_choice, require
from ..earth.wgs84 import (
    DEGREE,
    MICRO_G,
    dcm_e_from_n,
    ecef_to_geodetic,
    geodetic_to_ecef,
    look_angles,
    turning_of_local_axes,
)
from ._kernels import fill_ranges
from .flight import Headings, Trajectory, split_rows
from .manoeuvres import FLIGHTS
from .satellites import Constellation, SatelliteStates

FloatArray = NDArray[np.float64]
Compute = Callable[["GroundTruth"], FloatArray]
CHANNELS = 12
FEWEST_CHANNELS, MOST_CHANNELS = 4, 32
MASK_DEG = 10.0
HIGHEST_MASK_DEG = 60.0
SKY_PLACE = 40.0, 116.0, 500.0  # latitude, longitude [deg] and height [m] of a snapshot receiver
SKY_MASK_DEG = 5.0  # least elevation of a satellite that a snapshot receiver uses [deg]


class EpochTruth(NamedTuple):
    """Truth of `GroundTruth` at its epochs, as kernels take it."""

    epoch_time: FloatArray
    satellites: FloatArray
    position_e: FloatArray
    velocity_e: FloatArray


@dataclass(frozen=True, kw_only=True)
class GroundTruth:
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
        return np.where(seen, np.diagonal(self.look(first)[0]), np.pi / 2)

    def look(self, epochs: NDArray[np.int64] | slice) -> tuple[FloatArray, FloatArray]:
        """Elevation and azimuth of every slot at some epochs, (b, n) [rad]; 0 for an empty slot."""
        places = self.satellites[epochs, :, :3]
        angles = look_angles(places, self.position_e[epochs], self.C_en[epochs])
        empty = ~places.any(axis=-1)
        for each in angles:
            each[empty] = 0.0
        return angles

    @property
    def elevation(self) -> FloatArray:
        """(K, n) at all epochs [rad], computed at every call."""
        return self.look(slice(None))[0]

    @property
    def nbytes(self) -> int:
        """Memory of all arrays."""
        return sum(x.nbytes for x in vars(self).values() if isinstance(x, np.ndarray))

    @property
    def in_view(self) -> NDArray[np.integer[Any]]:
        """(K,) number of visible slots."""
        return np.asarray(self.visible.sum(axis=1))

    @property
    def worlds(self) -> int:
        """How many there are, one after the other: 1, but for `Skies`."""
        return 1

    @property
    def at_hand(self) -> GroundTruth:
        """The same, for readers that look at epochs only once these have been built: see `Skies`;
        elsewhere there may be anything."""
        return self

    def build(self, worlds: Iterable[int]) -> None:
        """Build some of the worlds, unless they are there."""

    def build_epochs(self, first: NDArray[np.int64], last: NDArray[np.int64]) -> None:
        """Build the epochs from each of `first` to each of `last` of the same world, and one before
        and after, for rates of change, unless they are there."""

    def take(self, w: int) -> GroundTruth:
        """World w, as views."""
        return self

    def probe(self) -> tuple[NDArray[np.int64], FloatArray]:
        """Some epochs (E,) of a world, and (W, E, 4n) `see_geometry` there in every one, as far as
        it is known before they are built."""
        return np.zeros(0, dtype=np.int64), np.zeros((1, 0, 4 * self.channels))

    def list_first_elevations(self) -> FloatArray:
        """(W, n) `first_elevation` of every world."""
        return self.first_elevation[None]

    @cached_property
    def _tables(self) -> dict[Any, FloatArray]:
        return {}

    def tabulate(self, key: Any, shape: tuple[int, ...], compute: Compute) -> FloatArray:
        """(K, *shape) what `compute` makes of epochs, each by itself; made once for every `key`,
        and with `at_hand` valid where epochs have been built."""
        if key not in self._tables:
            self._tables[key] = np.ascontiguousarray(compute(self))
        return self._tables[key]

    @property
    def axes_turning(self) -> FloatArray:
        """(K, 3, 3) rate of change of `C_en` [1/s], since the axes move with the true position."""
        return self.tabulate("axes_turning", (3, 3), _turn_axes)

    @cached_property
    def epoch_truth(self) -> EpochTruth:
        return EpochTruth(*(getattr(self, name) for name in EpochTruth._fields))


def see_geometry(world: GroundTruth) -> FloatArray:
    """(K, 4n) line of sight to every slot in local axes, 0 if not visible, then whether it is."""
    table = np.empty((world.epochs, 4 * world.channels))
    for rows in split_rows(world.epochs):
        given = world.satellites[rows, :, :3], world.position_e[rows], world.C_en[rows]
        table[rows] = look_along(*given, world.visible[rows])
    return table


def look_along(
    places: FloatArray, position_e: FloatArray, C_en: FloatArray, seen: NDArray[np.bool_]
) -> FloatArray:
    sight = places - position_e[:, None, :]
    sight = sight / np.linalg.norm(sight, axis=-1, keepdims=True)
    sight = np.einsum("kji,knj->kni", C_en, sight) * seen[:, :, None]
    return np.hstack([sight.reshape(len(seen), -1), seen])


def _turn_axes(world: GroundTruth) -> FloatArray:
    turning = np.empty_like(world.C_en)
    for piece in split_rows(world.epochs):
        turning[piece] = turning_of_local_axes(world.position_e[piece], world.velocity_e[piece])
    return turning


def build_world(
    trajectory: Trajectory,
    constellation: Constellation,
    *,
    epoch_interval_s: float = 0.5,
    channels: int = CHANNELS,
    mask_deg: float = MASK_DEG,
) -> GroundTruth:
    """Compute the truth of a run. `constellation`: satellites; where more rise above the mask than
    there are channels, those that stay longest are taken."""
    time = trajectory.time
    epoch_end = find_epochs(time, epoch_interval_s)
    check_number("channels", channels, least=FEWEST_CHANNELS, most=MOST_CHANNELS, whole=True)
    check_number("mask_deg", mask_deg, least=0.0, most=HIGHEST_MASK_DEG)
    motion, at = follow_flight(trajectory, epoch_end), time[epoch_end]
    position_e = motion["position_e"]
    states = constellation.states(at)
    elevation, _ = look_angles(states.position_e, position_e, motion["C_en"])
    usable = np.isfinite(states.position_e).all(-1) & np.isfinite(states.velocity_e).all(-1)
    visible = usable & (elevation > np.radians(mask_deg))
    chosen, ids, seen = fill_slots(constellation, at, visible, channels, mask_deg)
    return GroundTruth(
        name=trajectory.name,
        satellite_ids=ids,
        imu_time=time.copy(),
        epoch_time=at,
        epoch_end=epoch_end,
        satellites=place_satellites(states, chosen, seen, position_e, motion["velocity_e"]),
        visible=seen,
        **motion,
        decimation=trajectory.decimation,
    )


def follow_flight(trajectory: Trajectory, epoch_end: NDArray[np.int64]) -> dict[str, FloatArray]:
    """`run`, and at epochs `position_e`, `velocity_e`, `C_eb` and `C_en`, of `GroundTruth`."""
    position_e, step = trajectory.position_e[epoch_end], np.diff(trajectory.time)
    rows = trajectory.specific_force_b.T, trajectory.angular_rate_b.T, step, 1.0 / np.sqrt(step)
    return {
        "run": np.ascontiguousarray(np.vstack(rows)),  # stacked columns would lie as columns
        "position_e": position_e,
        "velocity_e": trajectory.velocity_e[epoch_end],
        "C_eb": trajectory.C_eb[epoch_end],
        "C_en": np.ascontiguousarray(dcm_e_from_n(*ecef_to_geodetic(position_e)[:2])),
    }


def find_epochs(time: FloatArray, epoch_interval_s: float) -> NDArray[np.int64]:
    """(K,) number of samples up to each epoch, of samples that end at `time` (N+1,) [s]."""
    step = time[1] - time[0]
    per_epoch = round(epoch_interval_s / step)
    require(
        per_epoch >= 1 and abs(per_epoch * step - epoch_interval_s) <= 1e-6 * step,
        f"`epoch_interval_s` must be a multiple of the sample interval {step:g} s, "
        f"got {epoch_interval_s}",
    )
    epoch_end = np.arange(0, len(time), per_epoch, dtype=np.int64)
    require(
        len(epoch_end) >= 2, f"a run of {time[-1]:g} s holds no epoch of {epoch_interval_s:g} s"
    )
    return epoch_end


def place_satellites(
    states: SatelliteStates,
    chosen: Sequence[int],
    seen: NDArray[np.bool_],
    position_e: FloatArray,
    velocity_e: FloatArray,
) -> FloatArray:
    """`satellites` of `GroundTruth`: the `chosen` of some states in the first slots of `seen`."""
    satellites = np.zeros((*seen.shape, 8))
    satellites[:, :, :3] = _in_slots(states.position_e, chosen, seen.shape[1])
    satellites[:, :, 3:6] = _in_slots(states.velocity_e, chosen, seen.shape[1])
    fill_ranges(satellites, seen, position_e, velocity_e)
    return satellites


def fill_slots(
    constellation: Constellation,
    time: FloatArray,
    visible: NDArray[np.bool_],
    channels: int,
    mask_deg: float,
) -> tuple[list[int], tuple[str, ...], NDArray[np.bool_]]:
    """Satellites that get a slot, the ids of all slots, and (K, n) whether each is visible;
    `visible` (K, S) of all satellites. Fewer than 4 are refused at time zero, and at any time
    where the constellation can `explain_loss`: where its orbits are recorded, and may end."""
    epochs = visible.sum(axis=0)
    longest = np.argsort(-epochs, kind="stable")[:channels]
    chosen = sorted(int(i) for i in longest if epochs[i] > 0)
    ids = tuple(constellation.satellite_ids[i] for i in chosen)
    ids += ("",) * (channels - len(chosen))
    seen = _in_slots(visible, chosen, channels).astype(np.bool_)
    explain = getattr(constellation, "explain_loss", None)
    count = seen.sum(axis=1) if explain else seen[:1].sum(axis=1)
    if (few := np.flatnonzero(count < 4)).size:
        k = int(few[0])
        raise ValueError(
            f"a {'' if k else 'first '}fix needs 4 satellites above {mask_deg:g} deg, got "
            f"{count[k]} at {f'{time[k]:g} s' if k else 'time zero'}"
            + (explain(float(time[k])) if explain else "")
        )
    return chosen, ids, seen


def _in_slots(array: NDArray[Any], chosen: Sequence[int], channels: int) -> FloatArray:
    slots = np.zeros((len(array), channels, *array.shape[2:]))
    slots[:, : len(chosen)] = np.nan_to_num(array[:, chosen])
    return slots


SOURCES = 3  # of chance; each has a key of its own in every episode


@settings_record(frozen=True, kw_only=True)
class InertialErrors:
    """White noise and turn-on biases of the inertial sensors, and the errors of the alignment.

    All are standard deviations of what is drawn for every episode, except for the noise.

    The defaults are what the filter of `shadmehri2025` assumes of its sensors (section 4.2), before
    the factor of 3 of its initial covariance.
    """

    gyro_noise_deg_per_rth: float = setting(
        default=0.005, least=0.0, unit="deg/h^0.5", help="White noise of the gyros."
    )
    accel_noise_ug_per_rthz: float = setting(
        default=20.0, least=0.0, unit="ug/Hz^0.5", help="White noise of the accelerometers."
    )
    gyro_bias_deg_per_h: float = setting(
        default=0.01, least=0.0, unit="deg/h", help="Turn-on bias of every gyro."
    )
    accel_bias_ug: float = setting(
        default=100.0, least=0.0, unit="ug", help="Turn-on bias of every accelerometer."
    )
    tilt_arcsec: float = setting(
        default=20.0,
        least=0.0,
        unit="arcsec",
        help="Initial attitude about the two horizontal axes.",
    )
    heading_arcsec: float = setting(
        default=180.0, least=0.0, unit="arcsec", help="Initial attitude about the vertical axis."
    )
    velocity_mps: float = setting(
        default=0.1, least=0.0, unit="m/s", help="Initial velocity of every axis."
    )
    horizontal_m: float = setting(
        default=3.7, least=0.0, unit="m", help="Initial position to the east and to the north."
    )
    vertical_m: float = setting(default=6.0, least=0.0, unit="m", help="Initial position upwards.")

    @cached_property
    def noise(self) -> FloatArray:
        """(2,) root PSD of accelerometers and gyros [m/s^1.5], [rad/s^0.5]."""
        return np.array(
            [self.accel_noise_ug_per_rthz * MICRO_G, self.gyro_noise_deg_per_rth * DEGREE / 60.0]
        )

    @cached_property
    def initial_sd(self) -> FloatArray:
        """(15,) of the first state, east-north-up axes: `receiver.loose_states`; SI, radians."""
        arcsec = DEGREE / 3600.0
        return np.concatenate(
            [
                np.array([self.tilt_arcsec, self.tilt_arcsec, self.heading_arcsec]) * arcsec,
                np.full(3, self.velocity_mps),
                [self.horizontal_m, self.horizontal_m, self.vertical_m],
                np.full(3, self.gyro_bias_deg_per_h * DEGREE / 3600.0),
                np.full(3, self.accel_bias_ug * MICRO_G),
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
    require(
        each >= 1 and abs(each * step - interval_s) <= 1e-9,
        f"`interval_s` must be a multiple of the inertial sensors' {step:g} s, got {interval_s}",
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
    headings = Headings.sample(FLIGHTS[flight](), imu_rate_hz, interval_s)
    return loose_world(headings.trajectory(0.0), interval_s)


class Sky(NamedTuple):
    """Where vehicle and satellites are. `time`: (K,) [s]; `position_e`, `velocity_e`: (K, 3), (3,)
    of the vehicle, ECEF [m], [m/s]; `C_en`: (3, 3) to ECEF from north-east-down axes at the start;
    `satellite_position_e`, `satellite_velocity_e`: (K, n, 3) ECEF [m], [m/s]; `satellite_ids`: (n,)
    in the order of the slots."""

    time: FloatArray
    position_e: FloatArray
    velocity_e: FloatArray
    C_en: FloatArray
    satellite_position_e: FloatArray
    satellite_velocity_e: FloatArray
    satellite_ids: tuple[str, ...]


def make_sky(
    epochs: int,
    interval_s: float,
    satellites: int,
    constellation: Constellation,
    *,
    speed_mps: float = 0.0,
    heading_deg: float = 0.0,
) -> Sky:
    """Vehicle on a straight line that begins level at `SKY_PLACE`, and the satellites that are
    highest over all of its way, in the order of their ids."""
    time = interval_s * np.arange(epochs, dtype=np.float64)
    latitude, longitude, heading = (math.radians(x) for x in (*SKY_PLACE[:2], heading_deg))
    C_en = dcm_e_from_n(latitude, longitude)
    velocity = C_en @ (speed_mps * np.array([math.cos(heading), math.sin(heading), 0.0]))
    start = geodetic_to_ecef(latitude, longitude, SKY_PLACE[2])
    position = start + np.outer(time, velocity)
    states = constellation.states(time)
    apart = states.position_e - position[:, None]
    up = -(apart @ C_en[:, 2]) / np.linalg.norm(apart, axis=-1)
    least = np.degrees(np.arcsin(up.min(axis=0)))
    seen = int(np.sum(least > SKY_MASK_DEG))  # an unusable satellite has NaN
    require(
        seen >= satellites,
        f"`satellites` must be at most {seen}, as many as stay above {SKY_MASK_DEG:g} degrees, "
        f"got {satellites}",
    )
    chosen = np.sort(np.argsort(-least, kind="stable")[:satellites])
    return Sky(
        time,
        position,
        velocity,
        C_en,
        np.ascontiguousarray(states.position_e[:, chosen]),
        np.ascontiguousarray(states.velocity_e[:, chosen]),
        tuple(constellation.satellite_ids[j] for j in chosen),
    )


def chain_skies(skies: Sequence[Sky]) -> Sky:
    """Sky in which the epochs of some skies of one place and length follow one another. Times start
    again with each; `velocity_e` is that of the first. Satellites are named by their slots where
    they differ."""
    first = skies[0]
    if len(skies) == 1:
        return first
    if any(sky.satellite_ids != first.satellite_ids for sky in skies):
        first = first._replace(
            satellite_ids=tuple(f"slot{s:02d}" for s in range(len(first.satellite_ids)))
        )
    return first._replace(
        time=np.concatenate([sky.time for sky in skies]),
        position_e=np.concatenate([sky.position_e for sky in skies]),
        satellite_position_e=np.concatenate([sky.satellite_position_e for sky in skies]),
        satellite_velocity_e=np.concatenate([sky.satellite_velocity_e for sky in skies]),
    )
