"""First position, velocity and attitude of a recording, from the recording itself.

Roll and pitch follow from the specific force less the acceleration, heading from the velocity: the
first axis of the sensor must look where the vehicle goes.
"""

from __future__ import annotations

import dataclasses
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.registry import require
from ..earth.wgs84 import DEGREE, dcm_e_from_n, ecef_to_geodetic, gravity
from .plausibility import RECEIVER_RADII
from .recording import MAY_BE_NAN, SOLVED, AnyRecording, PositionRecording, Recording
from .snapshot import least_squares_fix
from .tight import NavState

Floats = NDArray[np.float64]
MOVING_MPS = 1.0  # horizontal speed whose direction is a heading
LEVELLING_S = 1.0  # time before and after the start from which the first attitude follows
SLOPE_S, STRAIGHT_RAD = 5.0, 0.1  # the same of positions alone, and the most that turns meanwhile
ATTITUDE_SD = 2.0 * DEGREE  # of an attitude that is found so


def fix_epochs(
    pseudorange: Floats, range_rate: Floats, position: Floats, velocity: Floats
) -> Floats:
    """(K, 8) ECEF position and velocity, clock and its drift of every epoch [m], [m/s]; NaN where
    there is no fix. Ranges (K, n), satellites (K, n, 3)."""
    fixes, guess = np.full((len(pseudorange), 8), np.nan), np.zeros(3)
    for k, each in enumerate(zip(pseudorange, range_rate, position, velocity, strict=True)):
        with suppress(ValueError):  # too few satellites, or a singular geometry
            fix = least_squares_fix(*each, guess_e=guess)
            guess, clock = fix.position_e, (fix.clock_bias_m, fix.clock_drift_mps)
            fixes[k] = *fix.position_e, *fix.velocity_e, *clock
    return fixes


def find_start(
    time: Floats,
    fixes: Floats,
    imu_time: Floats,
    specific_force_b: Floats,
    fewest: int,
    *,
    still: bool = False,
    within_s: float = LEVELLING_S,
) -> tuple[int, NavState]:
    """First epoch with a fix whose velocity is a heading, `fewest` epochs before the last at least,
    and the state there. `fixes` (K, 8) as of `fix_epochs`; `still`: at rest, with level axes; the
    first attitude follows from the time `within_s` of the epoch."""
    fixed = np.flatnonzero(np.isfinite(fixes[:, :6]).all(axis=1))
    times, fastest = time[fixed], 0.0
    firsts = np.searchsorted(times, times - within_s)
    ends = np.searchsorted(times, times + within_s, side="right")
    for row, now, first, end in zip(fixed, times, firsts, ends, strict=True):
        if end - first < 2 or len(time) - row < fewest:
            continue
        position, clock = fixes[row, :3], fixes[row, 6:]
        around = fixes[fixed[first:end], 3:6]
        change, velocity = np.polyfit(times[first:end] - now, around, 1)
        C_eb = C_en = dcm_e_from_n(*ecef_to_geodetic(position)[:2])
        fastest = max(fastest, speed := float(np.hypot(*(velocity @ C_en)[:2])))
        if still:
            velocity = np.zeros(3)
        elif speed < MOVING_MPS:
            continue
        else:
            felt = specific_force_b[abs(imu_time - now) <= within_s].mean(axis=0)
            require(felt.any(), "`specific_force_b` is 0 there, which says nothing of the attitude")
            local = join_axes(change - gravity(*position), velocity)
            C_eb = local @ join_axes(felt, np.array([1.0, 0.0, 0.0])).T
        return int(row), NavState(
            position_e=position,
            velocity_e=velocity,
            C_eb=C_eb,
            clock_bias_m=clock[0],
            clock_drift_mps=clock[1],
            attitude_sd=0.0 if still else ATTITUDE_SD,
        )
    why = f"no fix moves at {MOVING_MPS:g} m/s, which a heading needs; the fastest moves at "
    raise ValueError(
        f"before the last {fewest} epochs "
        + (f"{why}{fastest:.2g} m/s" if fastest else "no two fixes follow one another")
    )


def join_axes(first: Floats, second: Floats) -> Floats:
    """(3, 3) axes as columns: along `first`, and `second` in the plane of the first two."""
    x, z = first, np.cross(first, second)
    axes = np.stack([x, np.cross(z, x), z], axis=1)
    return np.asarray(axes / np.linalg.norm(axes, axis=0))


def start_recording(recording: AnyRecording) -> tuple[AnyRecording, NavState, int]:
    """What is left of a recording from the first epoch on at which its state is found; this state;
    number of the epoch."""
    time = np.asarray(recording.gnss_time)
    imu = np.asarray(recording.imu_time), np.asarray(recording.specific_force_b)
    within_s, far = LEVELLING_S, ""
    if isinstance(recording, Recording):
        fixes = fix_epochs(*(np.asarray(getattr(recording, name)) for name in MAY_BE_NAN))
        radius = np.linalg.norm(fixes[:, :3], axis=1)
        if (off := (radius < RECEIVER_RADII[0]) | (radius > RECEIVER_RADII[1])).any():
            far = f"; {off.sum()} fixes are {np.median(radius[off]):.3g} m from the Earth's centre "
            far += "(do ranges, satellites and their times belong together?)"
            fixes[off] = np.nan
    else:
        position, velocity = (np.asarray(getattr(recording, name)) for name in SOLVED)
        if not np.isfinite(velocity).any():
            within_s, velocity = SLOPE_S, _fit_velocities(recording)
        fixes = np.hstack([position, velocity, np.zeros((len(time), 2))])
    try:
        row, initial = find_start(time, fixes, *imu, 2, within_s=within_s)
    except ValueError as error:
        raise ValueError(
            f"`initial` is not found from the recording, so give it: {error}{far}"
        ) from error
    return _cut_before(recording, row), initial, row


def _fit_velocities(recording: PositionRecording) -> Floats:
    """(K, 3) slopes of the positions, where the sensor does not turn meanwhile; NaN elsewhere."""
    time, position = np.asarray(recording.gnss_time), np.asarray(recording.position_e)
    ends, rate = np.asarray(recording.imu_time), np.asarray(recording.angular_rate_b)
    lengths = np.diff(ends, prepend=0.0)
    turned = np.cumsum(rate * lengths[:, None], axis=0)
    found = np.full(position.shape, np.nan)
    for k in np.flatnonzero(np.isfinite(position).all(axis=1)):
        near = np.isfinite(position).all(axis=1) & (abs(time - time[k]) <= SLOPE_S)
        angle = turned[abs(ends - time[k]) <= SLOPE_S]
        if near.sum() > 3 and np.linalg.norm(np.ptp(angle, axis=0)) < STRAIGHT_RAD:
            found[k] = np.polyfit(time[near] - time[k], position[near] - position[k], 2)[1]
    return found


def _cut_before(recording: AnyRecording, row: int) -> AnyRecording:
    """Samples and epochs after that of a row, with its time as zero."""
    time, first = np.asarray(recording.gnss_time)[row], int(recording.epoch_samples()[row])
    sizes: dict[str, Any] = {field.name: row + 1 for field in dataclasses.fields(recording)}
    sizes |= dict.fromkeys(("imu_time", "specific_force_b", "angular_rate_b"), first)
    cut: dict[str, Any] = {
        name: np.asarray(getattr(recording, name))[size:] for name, size in sizes.items()
    }
    zero = np.asarray(recording.imu_time)[first - 1]
    require(len(cut["gnss_time"]) > 0, f"no epoch is left after the start at {time:g} s")
    times: dict[str, Any] = {name: cut[name] - zero for name in ("imu_time", "gnss_time")}
    return dataclasses.replace(recording, **cut | times)
