"""Recorded measurements through the engine's own kernels."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.registry import check_choice, require
from ..truth.noise import pad_count
from ..truth.sensors import SensorBuffers
from . import _kernels
from .epoch import FILTER, ReceiverBuffers, kernel_table
from .loose import LooselyCoupled
from .loose_replay import list_solved, list_solved_noise, run_loose, whitened_square
from .plausibility import (
    ImplausibleWarning,
    check_measured,
    check_recording,
    explain_flags,
    flag_epochs,
)
from .recording import MAY_BE_NAN, PositionRecording, Recording
from .start import start_recording
from .tight import NavState, TightlyCoupled, raise_attitude

_SOLVED = ("position_e", "velocity_e", "C_eb", "accel_bias_b", "gyro_bias_b", "clock")


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
        (K,); NaN of a loosely coupled receiver.
    sd : ndarray
        (K, 17) standard deviations: attitude (ECEF axes), velocity, position, accelerometer bias,
        gyro bias, clock; of a loosely coupled receiver (K, 15): attitude, velocity, position (axes
        east, north, up), gyro bias, accelerometer bias.
    coasting : ndarray
        (K,) bool, whether the update was left out for want of satellites or of a solution.
    innovation : ndarray
        (K, 2n) before the update, pseudoranges first; 0 where absent.  Of a loosely coupled
        receiver the n are east, north and up, positions first.
    innovation_cov : ndarray
        (K, 2n, 2n) S; row and column of the identity where absent.
    measured : ndarray
        (K, 2n) bool, which of them are there.
    visible : ndarray
        (K, n) bool, which channels are measured.
    filter_fields : mapping
        Those of `receiver.epoch.FILTER` that were requested, (K, ...) each.
    flag : ndarray
        (K,) str: "" where nothing is wrong; "innovations" where they are far beyond their
        covariance; "sd" where the standard deviations have not fitted for a while; "not finite".
    remark : str
        How many epochs are flagged, and the likeliest cause; "" where none is.
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
    innovation_cov: NDArray[np.float64]
    measured: NDArray[np.bool_]
    visible: NDArray[np.bool_]
    filter_fields: Mapping[str, NDArray[np.float64]]
    flag: NDArray[np.str_]
    remark: str


def load_initial(buffers: ReceiverBuffers, receiver: TightlyCoupled, initial: NavState) -> None:
    fields = buffers.fields
    fields["position_e"], fields["velocity_e"] = initial.position_e, initial.velocity_e
    fields["C_eb"] = initial.C_eb
    fields["accel_bias_b"] = fields["gyro_bias_b"] = 0.0
    fields["clock"] = initial.clock_bias_m, initial.clock_drift_mps
    P = receiver.initial_covariance()
    raise_attitude(P, initial)
    buffers.put_covariance(np.arange(buffers.receivers), P)


def replay(
    recording: Recording | PositionRecording,
    receiver: TightlyCoupled | LooselyCoupled,
    *,
    initial: NavState | None = None,
    noise_variance: ArrayLike | None = None,
    fields: Collection[str] = (),
) -> Solution:
    """Run a receiver over recorded measurements.

    Parameters
    ----------
    recording : Recording or PositionRecording
        Measurements from time zero on: ranges of a tightly coupled receiver, positions of a loosely
        coupled one.
    receiver : TightlyCoupled or LooselyCoupled
        Settings of the receiver.
    initial : NavState, optional
        Navigation solution at time zero.  By default it is found at the first epoch that has a fix
        and moves at 1 m/s: roll and pitch from the specific force, heading from the velocity, where
        the first axis of the sensor looks.  The solution then has the epochs after that one.
    noise_variance : array_like, optional
        (K, 2n) measurement noise variances R [m^2, m^2/s^2], pseudoranges first; those of
        ``receiver.noise_model`` by default.  Of a loosely coupled receiver (K, 6) or (6,), of the
        positions east, north, up and then of the velocities; without velocities those of the
        receiver by default.
    fields : collection of str
        Which of ``predicted_cov``, ``design``, ``transition`` and ``imu_delta`` are wanted of every
        epoch, for detectors that need them.

    Returns
    -------
    Solution
        Estimates and standard deviations after every epoch's update, and flags.

    Raises
    ------
    ValueError
        When measurements, initial state or noise can't be (`plausibility`), no initial state is
        found, or the receiver is ``tuning="matched"`` with nothing to match.

    Warns
    -----
    ImplausibleWarning
        The `remark` of the solution, where epochs are flagged.

    Examples
    --------
    >>> from spoofgym.receiver import NavState, Recording, TightlyCoupled, replay
    >>> import numpy as np
    >>> n = 100
    >>> recording = Recording(
    ...     imu_time=np.arange(1, n + 1) * 0.01,
    ...     specific_force_b=np.tile([9.8, 0.0, 0.0], (n, 1)),
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
    for name in fields:
        check_choice("field of a filter", name, FILTER)
    time = np.asarray(recording.gnss_time)
    run: Any
    if isinstance(recording, PositionRecording) and isinstance(receiver, LooselyCoupled):
        measured, run = list_solved(recording), run_loose
        variance = list_solved_noise(receiver, measured, noise_variance)
    elif isinstance(recording, Recording) and isinstance(receiver, TightlyCoupled):
        visible, run = _list_measured(recording), _run
        measured = np.hstack([visible, visible])
        variance = _list_noise(receiver, measured, noise_variance)
    else:
        raise ValueError(
            "a tightly coupled receiver takes a Recording, a loosely coupled one a "
            f"PositionRecording, got {type(receiver).__name__} and {type(recording).__name__}"
        )
    check_measured(recording, measured, variance)
    zero = 0.0
    if initial is None:
        recording, initial, row = start_recording(recording)
        measured, variance = measured[row + 1 :], variance[row + 1 :]
        zero = float(time[row])
    check_recording(recording, initial, measured)

    def misfit_with(part: Recording | PositionRecording, start: NavState) -> NDArray[np.float64]:
        return np.asarray(run(part, receiver, start, variance)[1])

    solution, misfit, by_signal = run(recording, receiver, initial, variance, fields)
    flag = flag_epochs(misfit)
    remark = ""
    if flag.any():
        remark = explain_flags(misfit_with, recording, initial, flag, misfit, by_signal)
        remark += f" (times are those after the start at {zero:g} s)" if zero else ""
        warnings.warn(remark, ImplausibleWarning, stacklevel=2)
    solution["time"] += zero
    return Solution(**solution, flag=flag, remark=remark)


def _list_noise(
    receiver: TightlyCoupled, measured: NDArray[np.bool_], noise_variance: ArrayLike | None
) -> NDArray[np.float64]:
    """(K, 2n) noise variances of ranges and rates."""
    epochs, n = len(measured), measured.shape[1] // 2
    require(
        receiver.tuning != "augmented",
        "a replay knows no world for a receiver with `tuning` 'augmented'",
    )
    if receiver.tuning == "matched" and receiver.noise is None and noise_variance is None:
        raise ValueError(
            "a replay knows no world to match: give `noise` to the receiver or `noise_variance`"
        )
    model = receiver.noise_model
    variance: NDArray[np.float64]
    if noise_variance is None:
        one = np.repeat([model.pseudorange_sd**2, model.range_rate_sd**2], n)
        variance = np.tile(one, (epochs, 1))
    else:
        variance = np.asarray(noise_variance, dtype=np.float64)
        require(
            variance.shape == (epochs, 2 * n),
            f"`noise_variance` must be of shape {(epochs, 2 * n)}, got {variance.shape}",
        )
    return variance


def _list_measured(recording: Recording) -> NDArray[np.bool_]:
    range_, rate, position, velocity = (np.asarray(getattr(recording, n)) for n in MAY_BE_NAN)
    visible = np.isfinite(range_) & np.isfinite(rate)
    known = np.isfinite(position).all(axis=-1) & np.isfinite(velocity).all(axis=-1)
    return np.asarray(visible & known)


def _run(
    recording: Recording,
    receiver: TightlyCoupled,
    initial: NavState,
    variance: NDArray[np.float64],
    wanted: Collection[str] = (),
) -> tuple[dict[str, Any], NDArray[np.float64], NDArray[np.float64]]:
    """Fields of the solution, (K,) mean square of the whitened innovations, -1 without any, and
    (K, 2) those of pseudoranges and range rates alone, by their variances."""
    range_, rate, position, velocity = (np.asarray(getattr(recording, n)) for n in MAY_BE_NAN)
    (epochs, n), visible = range_.shape, _list_measured(recording)
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

    shown = {"innovation_cov", *wanted}
    buffers = ReceiverBuffers(1, n, shown)
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
    misfit, by_signal = np.full(epochs, -1.0), np.zeros((epochs, 2))
    coasting = np.zeros(epochs, dtype=np.bool_)
    seen: dict[str, list[NDArray[np.float64]]] = {name: [] for name in sorted(shown)}
    fields = buffers.fields
    for k in range(epochs):
        fields["innovation"], buffers.assumed["noise_variance"] = measured[k], variance[k]
        _kernels.run_epoch(*given, _kernels.PREDICT + _kernels.SHOW)
        innovation = buffers.seen["innovation"][0].copy()
        for name, rows in seen.items():
            rows.append(buffers.seen[name][0].copy())
        if visible[k].any():
            count = 2 * visible[k].sum()
            S = buffers.seen["innovation_cov"][0]
            with np.errstate(over="ignore", invalid="ignore"):  # which are flagged
                misfit[k] = whitened_square(innovation, S) / count
                part = innovation**2 / np.diagonal(S)
                by_signal[k] = 2.0 * part.reshape(2, n).sum(axis=1) / count
        _kernels.run_epoch(*given, _kernels.UPDATE)
        with np.errstate(invalid="ignore"):  # a variance below 0 is NaN, which is flagged
            sd = np.sqrt(np.diagonal(buffers.covariance[0]))
        if not (np.isfinite(sd).all() and np.isfinite(fields["position_e"]).all()):
            misfit[k] = np.nan
        solutions.append((*(fields[name][0] for name in _SOLVED), sd, innovation))
        coasting[k] = buffers.coasting[0]
    *solved, clock, sds, innovations = (np.array(each) for each in zip(*solutions, strict=True))
    solution = {
        "time": np.array(recording.gnss_time),
        "clock_bias_m": clock[:, 0].copy(),
        "clock_drift_mps": clock[:, 1].copy(),
        "coasting": coasting,
        "sd": sds,
        "innovation": innovations,
        "innovation_cov": np.array(seen.pop("innovation_cov")),
        "measured": np.hstack([visible, visible]),
        "visible": visible,
        "filter_fields": {name: np.array(rows) for name, rows in seen.items()},
        **dict(zip(_SOLVED, solved, strict=False)),
    }
    return solution, misfit, by_signal
