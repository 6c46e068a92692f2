"""What a receiver has measured, as arrays that are checked."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.registry import require
from .strapdown import LARGEST_ROTATION

_SHAPES = {
    "imu_time": "N",
    "specific_force_b": "N3",
    "angular_rate_b": "N3",
    "gnss_time": "K",
    "pseudorange": "Kn",
    "range_rate": "Kn",
    "satellite_position_e": "Kn3",
    "satellite_velocity_e": "Kn3",
    "position_e": "K3",
    "velocity_e": "K3",
}
LONGEST_SAMPLE_S = 0.5
"""Of an inertial sensor; over a longer time the receiver's movement is unknown."""
SAME_TIME_S = 1e-6
"""By which an epoch may be off the end of its sample, as times of files are."""
IN_SAMPLES = "specific_force_b", "angular_rate_b"
MAY_BE_NAN = ("pseudorange", "range_rate", "satellite_position_e", "satellite_velocity_e")
SOLVED = "position_e", "velocity_e"  # of a receiver that measures these


@dataclass(frozen=True, kw_only=True)
class InertialRecording:
    """Inertial samples, and the epochs at which something else was measured."""

    imu_time: ArrayLike
    specific_force_b: ArrayLike
    angular_rate_b: ArrayLike
    gnss_time: ArrayLike

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {"3": 3}
        for field in fields(self):
            given = getattr(self, field.name)
            kind = np.asarray(given).dtype.kind
            require(
                kind in "iufO", f"`{field.name}` must be numbers, got {np.asarray(given).dtype}"
            )
            array = np.array(np.ma.filled(np.ma.array(given, dtype=np.float64), np.nan))
            letters = _SHAPES[field.name]
            require(
                array.ndim == len(letters),
                f"`{field.name}` must have shape ({', '.join(letters)}), got {array.shape}",
            )
            for letter, size in zip(letters, array.shape, strict=True):
                if sizes.setdefault(letter, size) != size:
                    raise ValueError(
                        f"`{field.name}` has shape {array.shape}, but {letter} is {sizes[letter]}"
                    )
            require(
                not np.isinf(array).any(), f"`{field.name}` must not be infinite; absent is NaN"
            )
            require(
                field.name in (*MAY_BE_NAN, *SOLVED) or np.isfinite(array).all(),
                f"`{field.name}` must be finite",
            )
            array.flags.writeable = False
            object.__setattr__(self, field.name, array)
        require(
            sizes["N"] != 0 and sizes["K"] != 0,
            "a recording needs at least one sample and one epoch",
        )
        for name in ("imu_time", "gnss_time"):
            steps = np.diff(getattr(self, name), prepend=0.0)
            if steps.min() <= 0.0:
                k = int(steps.argmin())
                raise ValueError(
                    f"`{name}` must increase from above 0, "
                    f"got {getattr(self, name)[k]} at index {k}"
                )
        lengths = np.diff(np.asarray(self.imu_time), prepend=0.0)
        if lengths.max() > LONGEST_SAMPLE_S:
            k = int(lengths.argmax())
            cause = (
                "is time zero the start of the first sample, also of `gnss_time`?"
                if k == 0
                else "are times in ms?"
                if np.median(lengths) > LONGEST_SAMPLE_S
                else "replay the parts before and after a gap one by one"
            )
            raise ValueError(
                f"a sample may last {LONGEST_SAMPLE_S:g} s at most, but that which ends at "
                f"{np.asarray(self.imu_time)[k]:g} s lasts {lengths[k]:g} s ({cause})"
            )
        turn = np.linalg.norm(np.asarray(self.angular_rate_b), axis=1) * lengths
        if turn.max() > LARGEST_ROTATION:
            k = int(turn.argmax())
            raise ValueError(
                f"`angular_rate_b` turns by {turn[k]:.3g} rad over the sample that ends at "
                f"{np.asarray(self.imu_time)[k]} s; at most {LARGEST_ROTATION:g} rad "
                "(are the rates in rad/s?)"
            )
        self._split_samples()
        self.epoch_samples()

    def _split_samples(self) -> None:
        """End a sample wherever an epoch lies in one."""
        ends, epochs = np.asarray(self.imu_time), np.asarray(self.gnss_time)
        near = np.abs(ends[np.searchsorted(0.5 * (ends[1:] + ends[:-1]), epochs)] - epochs)
        split = np.union1d(ends, epochs[(epochs < ends[-1]) & (near > SAME_TIME_S)])
        during = np.searchsorted(ends, split)
        for name, array in (
            ("imu_time", split),
            *((x, np.asarray(getattr(self, x))[during]) for x in IN_SAMPLES),
        ):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def epoch_samples(self) -> NDArray[np.int64]:
        """Match the epochs to the samples. Returns (K,) number of samples up to and including the
        one that ends at the epoch."""
        imu_time = np.asarray(self.imu_time)
        gnss_time = np.asarray(self.gnss_time)
        after = np.clip(np.searchsorted(imu_time, gnss_time), 0, len(imu_time) - 1)
        before = np.maximum(after - 1, 0)
        nearer = np.abs(imu_time[before] - gnss_time) < np.abs(imu_time[after] - gnss_time)
        found = np.where(nearer, before, after)
        sample = np.diff(imu_time, prepend=0.0)[found]
        off = np.abs(imu_time[found] - gnss_time)
        if (off > 0.5 * sample).any():
            k = int(np.argmax(off > 0.5 * sample))
            raise ValueError(
                f"no sample ends within half a sample of the epoch at {gnss_time[k]} s; "
                f"the nearest ends at {imu_time[found[k]]} s (is `gnss_time` counted from the "
                "start of the first sample, too?)"
            )
        if (np.diff(found) < 1).any():
            k = int(np.argmax(np.diff(found) < 1))
            raise ValueError(
                f"the epochs at {gnss_time[k]} and {gnss_time[k + 1]} s share a sample"
            )
        return found + 1


@dataclass(frozen=True, kw_only=True)
class Recording(InertialRecording):
    """Measurements of one receiver, from time zero on.

    Parameters
    ----------
    imu_time : array_like
        (N,) end of each sample's interval [s]; the first interval starts at 0.
    specific_force_b, angular_rate_b : array_like
        (N, 3) measured, body axes [m/s^2], [rad/s].
    gnss_time : array_like
        (K,) epochs [s], after 0, at most half a sample after the last one.  A sample in which one
        lies is split there: both parts have its values, and the record has one sample more.
    pseudorange, range_rate : array_like
        (K, n) [m], [m/s]; NaN in either where a channel has no measurement.  The rate is that at
        which the pseudorange grows, positive where the satellite moves away: minus the Doppler
        shift times the wavelength.  The satellite's clock is taken out of both; the receiver's
        clock stays in, and is estimated.
    satellite_position_e, satellite_velocity_e : array_like
        (K, n, 3) where the satellite is when the signal leaves it, in the ECEF axes of that time
        [m], [m/s]; NaN where absent.  The Earth's rotation while the signal travels (Sagnac) is
        the replay's part.

    Raises
    ------
    ValueError
        When shapes disagree, a time runs backwards, a sample is not finite, lasts longer than
        `LONGEST_SAMPLE_S` or turns by more than a radian, or an epoch is after the samples.
    """

    pseudorange: ArrayLike
    range_rate: ArrayLike
    satellite_position_e: ArrayLike
    satellite_velocity_e: ArrayLike


@dataclass(frozen=True, kw_only=True)
class PositionRecording(InertialRecording):
    """Positions and velocities of a receiver's own solution beside inertial samples.

    Parameters
    ----------
    imu_time, specific_force_b, angular_rate_b, gnss_time : array_like
        As in `Recording`.
    position_e : array_like
        (K, 3) ECEF [m]; a row with a NaN is an epoch without a position.
    velocity_e : array_like, optional
        (K, 3) with respect to the Earth, ECEF axes [m/s]; NaN where it is missing, as everywhere
        by default.

    Raises
    ------
    ValueError
        As of `Recording`.
    """

    position_e: ArrayLike
    velocity_e: ArrayLike | None = None

    def __post_init__(self) -> None:
        if self.velocity_e is None:
            none = np.full(np.shape(self.position_e), np.nan)
            object.__setattr__(self, "velocity_e", none)
        super().__post_init__()


AnyRecording = Recording | PositionRecording
