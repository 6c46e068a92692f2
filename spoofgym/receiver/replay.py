"""Recorded measurements through the engine's own kernels."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.registry import require
from ..truth.noise import pad_count
from ..truth.sensors import SensorBuffers
from . import _kernels
from .epoch import ReceiverBuffers, kernel_table
from .strapdown import LARGEST_ROTATION
from .tight import NavState, TightlyCoupled

_SHAPES = {
    "imu_time": "N",
    "specific_force_b": "N3",
    "angular_rate_b": "N3",
    "gnss_time": "K",
    "pseudorange": "Kn",
    "range_rate": "Kn",
    "satellite_position_e": "Kn3",
    "satellite_velocity_e": "Kn3",
}
_SOLVED = ("position_e", "velocity_e", "C_eb", "accel_bias_b", "gyro_bias_b", "clock")
MAY_BE_NAN = ("pseudorange", "range_rate", "satellite_position_e", "satellite_velocity_e")


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Measurements of one receiver, from time zero on.

    Parameters
    ----------
    imu_time : array_like
        (N,) end of each sample's interval [s]; the first interval starts at 0.
    specific_force_b, angular_rate_b : array_like
        (N, 3) measured, body axes [m/s^2], [rad/s].
    gnss_time : array_like
        (K,) epochs [s], after 0, each within half a sample of the end of a sample.
    pseudorange, range_rate : array_like
        (K, n) [m], [m/s]; NaN in either where a channel has no measurement.
    satellite_position_e, satellite_velocity_e : array_like
        (K, n, 3) ECEF [m], [m/s]; NaN where absent.

    Raises
    ------
    ValueError
        When shapes disagree, a time runs backwards, a sample is not finite or turns by more than
        a radian, or an epoch has no sample that ends with it.
    """

    imu_time: ArrayLike
    specific_force_b: ArrayLike
    angular_rate_b: ArrayLike
    gnss_time: ArrayLike
    pseudorange: ArrayLike
    range_rate: ArrayLike
    satellite_position_e: ArrayLike
    satellite_velocity_e: ArrayLike

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {"3": 3}
        for field in fields(self):
            array = np.array(getattr(self, field.name), dtype=np.float64)
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
                field.name in MAY_BE_NAN or np.isfinite(array).all(),
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
        turn = np.linalg.norm(np.asarray(self.angular_rate_b), axis=1) * np.diff(
            np.asarray(self.imu_time), prepend=0.0
        )
        if turn.max() > LARGEST_ROTATION:
            k = int(turn.argmax())
            raise ValueError(
                f"`angular_rate_b` turns by {turn[k]:.3g} rad over the sample that ends at "
                f"{np.asarray(self.imu_time)[k]} s; at most {LARGEST_ROTATION:g} rad "
                "(are the rates in rad/s?)"
            )
        self.epoch_samples()

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
                f"the nearest ends at {imu_time[found[k]]} s"
            )
        if (np.diff(found) < 1).any():
            k = int(np.argmax(np.diff(found) < 1))
            raise ValueError(
                f"the epochs at {gnss_time[k]} and {gnss_time[k + 1]} s share a sample"
            )
        return found + 1


@dataclass(frozen=True, kw_only=True)
class Solution:
    """What a replayed receiver estimated, after the update of each epoch.

    Parameters
    ----------
    time : ndarray
        (K,) [s].
    position_e, velocity_e : ndarray
        (K, 3) ECEF [m], [m/s].
    C_eb : ndarray
        (K, 3, 3).
    accel_bias_b, gyro_bias_b : ndarray
        (K, 3) [m/s^2], [rad/s].
    clock_bias_m, clock_drift_mps : ndarray
        (K,).
    sd : ndarray
        (K, 17) standard deviations: attitude (ECEF axes), velocity, position, accelerometer bias,
        gyro bias, clock.
    coasting : ndarray
        (K,) bool, whether the update was left out for want of satellites.
    innovation : ndarray
        (K, 2n) before the update, pseudoranges first; 0 where absent.
    """

    time: NDArray[np.float64]
    position_e: NDArray[np.float64]
    velocity_e: NDArray[np.float64]
    C_eb: NDArray[np.float64]
    accel_bias_b: NDArray[np.float64]
    gyro_bias_b: NDArray[np.float64]
    clock_bias_m: NDArray[np.float64]
    clock_drift_mps: NDArray[np.float64]
    sd: NDArray[np.float64]
    coasting: NDArray[np.bool_]
    innovation: NDArray[np.float64]


def load_initial(buffers: ReceiverBuffers, receiver: TightlyCoupled, initial: NavState) -> None:
    fields = buffers.fields
    fields["position_e"], fields["velocity_e"] = initial.position_e, initial.velocity_e
    fields["C_eb"] = initial.C_eb
    fields["accel_bias_b"] = fields["gyro_bias_b"] = 0.0
    fields["clock"] = initial.clock_bias_m, initial.clock_drift_mps
    buffers.put_covariance(np.arange(buffers.receivers), receiver.initial_covariance())


def replay(
    recording: Recording,
    receiver: TightlyCoupled,
    *,
    initial: NavState,
    noise_variance: ArrayLike | None = None,
) -> Solution:
    """Run a tightly coupled receiver over recorded measurements.

    Parameters
    ----------
    recording : Recording
        Measurements from time zero on.
    receiver : TightlyCoupled
        Settings of the receiver.
    initial : NavState
        Navigation solution at time zero.
    noise_variance : array_like, optional
        (K, 2n) measurement noise variances R [m^2, m^2/s^2], pseudoranges first; those of
        ``receiver.noise_model`` by default.

    Returns
    -------
    Solution
        Estimates and standard deviations after every epoch's update.

    Raises
    ------
    ValueError
        When `noise_variance` has the wrong shape or is not positive, or when the receiver is
        ``tuning="matched"`` with nothing to match.

    Examples
    --------
    >>> from spoofgym.receiver import NavState, Recording, TightlyCoupled, replay
    >>> import numpy as np
    >>> n = 100
    >>> recording = Recording(
    ...     imu_time=np.arange(1, n + 1) * 0.01,
    ...     specific_force_b=np.tile([0.0, 0.0, -9.8], (n, 1)),
    ...     angular_rate_b=np.zeros((n, 3)),
    ...     gnss_time=[1.0],
    ...     pseudorange=np.full((1, 8), np.nan),
    ...     range_rate=np.full((1, 8), np.nan),
    ...     satellite_position_e=np.full((1, 8, 3), np.nan),
    ...     satellite_velocity_e=np.full((1, 8, 3), np.nan),
    ... )
    >>> initial = NavState(
    ...     position_e=[6378137.0, 0.0, 0.0],
    ...     velocity_e=[0.0, 0.0, 0.0],
    ...     C_eb=np.eye(3),
    ...     clock_bias_m=0.0,
    ...     clock_drift_mps=0.0,
    ... )
    >>> bool(replay(recording, TightlyCoupled(), initial=initial).coasting[0])
    True
    """
    range_, rate, position, velocity = (np.asarray(getattr(recording, n)) for n in MAY_BE_NAN)
    epochs, n = range_.shape
    require(
        receiver.tuning != "augmented",
        "a replay knows no world for a receiver with `tuning` 'augmented'",
    )
    if receiver.tuning == "matched" and receiver.noise is None and noise_variance is None:
        raise ValueError(
            "a replay knows no world to match: give `noise` to the receiver or `noise_variance`"
        )
    visible = np.isfinite(range_) & np.isfinite(rate)
    visible &= np.isfinite(position).all(axis=-1) & np.isfinite(velocity).all(axis=-1)
    model = receiver.noise_model
    variance: NDArray[np.float64]
    if noise_variance is None:
        one = np.repeat([model.pseudorange_sd**2, model.range_rate_sd**2], n)
        variance = np.tile(one, (epochs, 1))
    else:
        variance = np.asarray(noise_variance, dtype=np.float64)
        require(
            variance.shape == (epochs, 2 * n) and (variance > 0.0).all(),
            f"`noise_variance` must be positive and of shape {(epochs, 2 * n)}, "
            f"got shape {variance.shape}",
        )
    ends = recording.epoch_samples()
    imu_time = np.asarray(recording.imu_time)
    samples = [recording.specific_force_b, recording.angular_rate_b]
    lengths = np.diff(imu_time, prepend=0.0)
    run = np.ascontiguousarray(np.vstack([np.hstack(samples).T, lengths, lengths**-0.5]))
    # epoch 0 is time zero, where nothing is measured; range and range rate are in what is measured
    satellites = np.zeros((epochs + 1, n, 8))
    satellites[1:, :, :3] = np.where(visible[:, :, None], position, 0.0)
    satellites[1:, :, 3:6] = np.where(visible[:, :, None], velocity, 0.0)
    satellites[1:, :, 6] = visible
    measured = np.where(np.hstack([visible, visible]), np.hstack([range_, rate]), 0.0)

    buffers = ReceiverBuffers(1, n)
    load_initial(buffers, receiver, initial)
    buffers.assumed["noise_psd"] = receiver.noise_psd()
    sensors = SensorBuffers(1, n)
    sizes = pad_count(6 * int(np.diff(ends, prepend=0).max())), pad_count(2 * n)
    code, fewest = receiver.covariance_code, receiver.min_satellites
    rules = np.array([code, fewest, receiver.orthonormalize, *sizes])
    times = np.concatenate([[0.0], np.asarray(recording.gnss_time)])
    truth = run, times, np.concatenate([[0], ends]), satellites
    table = kernel_table(buffers, sensors, *truth, rules, sensors.signals.data, np.zeros(0))
    work = buffers.fields.scratch(_kernels.work_rows(n, *rules[3:].tolist()))
    given = table.entries, work, np.ones((1, 2 * n))
    solutions: list[tuple[NDArray[np.float64], ...]] = []
    coasting = np.zeros(epochs, dtype=np.bool_)
    fields = buffers.fields
    for k in range(epochs):
        fields["innovation"], buffers.assumed["noise_variance"] = measured[k], variance[k]
        _kernels.run_epoch(*given, _kernels.PREDICT + _kernels.SHOW)
        innovation = buffers.seen["innovation"][0].copy()
        _kernels.run_epoch(*given, _kernels.UPDATE)
        sd = np.sqrt(np.diagonal(buffers.covariance[0]))
        solutions.append((*(fields[name][0] for name in _SOLVED), sd, innovation))
        coasting[k] = buffers.coasting[0]
    *solved, clock, sds, innovations = (np.array(each) for each in zip(*solutions, strict=True))
    return Solution(
        time=np.array(recording.gnss_time),
        clock_bias_m=clock[:, 0].copy(),
        clock_drift_mps=clock[:, 1].copy(),
        coasting=coasting,
        sd=sds,
        innovation=innovations,
        **dict(zip(_SOLVED, solved, strict=False)),
    )
