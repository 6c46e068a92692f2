"""Recorded positions through the engine's loosely coupled receiver.

Positions alone are taken by the compiled update of the simulated victim.  Velocities add rows: with
the error states x, estimate minus truth in axes east, north, up, position and velocity are measured
less the estimate, so that :math:`z = -E x + n` with the choice E of their states.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.memory import Memory
from ..core.registry import require
from ._loose_kernels import LooseState, feed_back
from .loose import LooselyCoupled, LooseReceivers
from .loose_states import POSITION, STATES, VELOCITY, fill_local_axes, geodetic_point
from .recording import SOLVED, PositionRecording
from .tight import NavState, raise_attitude

Floats = NDArray[np.float64]
MEASURED = np.r_[POSITION : POSITION + 3, VELOCITY : VELOCITY + 3]
"""States of the six rows of a measurement."""


def list_solved(recording: PositionRecording) -> NDArray[np.bool_]:
    """(K, 6) what is measured, positions first."""
    there = [np.isfinite(getattr(recording, name)).all(axis=1) for name in SOLVED]
    return np.repeat(np.stack(there, axis=1), 3, axis=1)


def list_solved_noise(
    receiver: LooselyCoupled, measured: NDArray[np.bool_], variance: Any
) -> Floats:
    """(K, 6) noise variances; `variance`: as of `replay`, None for that of the receiver."""
    count, velocities = len(measured), bool(measured[:, 3:].any())
    require(
        not (receiver.tuning and (velocities or variance is not None)),
        "`self_tuning` finds the noise of positions: it takes neither velocities nor "
        "`noise_variance`",
    )
    if variance is None:
        require(
            not velocities,
            "a loosely coupled receiver assumes no noise of velocities: give `noise_variance`, "
            "(6,) or (K, 6), or a recording without them",
        )
        variance = receiver.noise_variance()
    found = np.asarray(variance, dtype=np.float64)
    width = found.shape[-1] if found.ndim else 0
    good = found.shape in {(width,), (count, width)} and width in ((6,) if velocities else (3, 6))
    require(
        good,
        f"`noise_variance` must be of shape (6,) or {(count, 6)}"
        f"{'' if velocities else ' or three wide'}, got shape {found.shape}",
    )
    return np.broadcast_to(
        np.concatenate([found, np.ones((*found.shape[:-1], 6 - width))], -1), (count, 6)
    )


def run_loose(
    recording: PositionRecording,
    receiver: LooselyCoupled,
    initial: NavState,
    variance: Floats,
    wanted: Collection[str] = (),
) -> tuple[dict[str, Any], Floats, Floats]:
    """Fields of the solution, (K,) mean square of the whitened innovations, -1 without any, and
    (K, 2) those of positions and velocities alone, by their variances."""
    measured, ends = list_solved(recording), recording.epoch_samples()
    position, velocity = (np.asarray(getattr(recording, name)) for name in SOLVED)
    samples = np.hstack([recording.specific_force_b, recording.angular_rate_b])
    lengths = np.diff(np.asarray(recording.imu_time), prepend=0.0)
    batch, first, count = _start_filter(receiver, initial, wanted), 0, len(ends)
    state, P = batch.state, batch.state.covariance[0]
    shown: dict[str, list[Floats]] = {name: [] for name in (*_SOLVED, "sd", *_SEEN, *wanted)}
    misfit, by_signal = np.full(count, -1.0), np.zeros((count, 2))
    for k, (end, here) in enumerate(zip(ends.tolist(), measured, strict=True)):
        batch.fix_e[0] = np.where(here[:3], position[k], 0.0)
        if receiver.tuning is None:
            state.measurement_cov[0] = np.diag(variance[k, :3])
        part, first = slice(first, end), end
        batch.predict_over(samples[None, part], lengths[part], float(lengths[part].sum()))
        z, S, R = _innovate(state, here, position[k], velocity[k], variance[k])
        epoch = batch.epoch(np.zeros(1))
        for name in wanted:
            design = name == "design"
            shown[name].append(_DESIGN * here[:, None] if design else getattr(epoch, name)[0])
        if here.any():
            misfit[k] = whitened_square(z, S) / here.sum()
            by_signal[k] = 2.0 * (z * z / np.diagonal(S)).reshape(2, 3).sum(axis=1) / here.sum()
        if here[0] and not here[3]:
            batch.update(None)
        elif here.any():
            _update(state, np.flatnonzero(here), z, S, R)
        with np.errstate(invalid="ignore"):  # a variance below 0 is NaN, which is flagged
            sd = np.sqrt(np.diagonal(P))
        if not (np.isfinite(sd).all() and np.isfinite(state.position_e).all()):
            misfit[k] = np.nan
        bias = state.bias[0]
        solved = *(getattr(state, x)[0] for x in _SOLVED[:3]), bias[3:], bias[:3]
        for name, array in zip((*_SOLVED, "sd", *_SEEN), (*solved, sd, z, S), strict=True):
            shown[name].append(array.copy())
    arrays = {name: np.array(rows) for name, rows in shown.items()}
    solution = {
        "time": np.array(recording.gnss_time),
        "clock_bias_m": np.full(count, np.nan),
        "clock_drift_mps": np.full(count, np.nan),
        "coasting": ~measured.any(axis=1),
        "measured": measured,
        "visible": measured.reshape(count, 2, 3).any(axis=1),
        "filter_fields": {name: arrays.pop(name) for name in wanted},
        **arrays,
    }
    return solution, misfit, by_signal


def _start_filter(
    receiver: LooselyCoupled, initial: NavState, wanted: Collection[str]
) -> LooseReceivers:
    batch = LooseReceivers(receiver, Memory(1), 0, 0.0, wanted)
    r, v, C = (np.asarray(x)[None] for x in (initial.position_e, initial.velocity_e, initial.C_eb))
    batch.start_episodes(r, v, C, np.zeros((1, STATES)))
    raise_attitude(batch.state.covariance[0], initial)
    return batch


def _innovate(
    state: LooseState, here: NDArray[np.bool_], position: Floats, velocity: Floats, variance: Floats
) -> tuple[Floats, Floats, Floats]:
    """Innovations (6,), their covariance, and R; 0 and the identity where nothing is measured. A
    velocity has the axes of the position that was measured with it, the estimate its own."""
    R = np.diag(variance)
    R[:3, :3] = state.measurement_cov[0]
    z, r = np.zeros(6), state.position_e[0]
    if here[0]:
        z[:3] = state.innovation[0]
    if here[3]:
        z[3:] = _resolve(position if here[0] else r, velocity) - _resolve(r, state.velocity_e[0])
    S = state.covariance[0][np.ix_(MEASURED, MEASURED)] + R
    return z, np.where(np.outer(here, here), S, np.eye(6)), R


def _resolve(r: Floats, v: Floats) -> Floats:
    """Velocity in east, north, up at a position."""
    C_el = np.empty((3, 3))
    latitude, longitude, _ = geodetic_point(*r)
    fill_local_axes(latitude, longitude, C_el)
    return np.asarray(v @ C_el)


def _update(state: LooseState, rows: NDArray[np.intp], z: Floats, S: Floats, R: Floats) -> None:
    """Correct by what is measured in some rows, with Joseph's form, and feed it back."""
    P, A, measured = state.covariance[0], np.eye(STATES), MEASURED[rows]
    try:
        G = np.linalg.solve(S[np.ix_(rows, rows)], P[measured]).T
    except np.linalg.LinAlgError:  # S is singular
        G = np.full((STATES, len(rows)), np.nan)
    A[:, measured] -= G
    updated = A @ P @ A.T + G @ R[np.ix_(rows, rows)] @ G.T
    P[:] = 0.5 * (updated + updated.T)
    feed_back(state, 0, -G @ z[rows], np.empty((3, 3)))


def whitened_square(innovation: Floats, S: Floats) -> float:
    """Z' S^-1 z; NaN where S is not positive definite."""
    try:
        return float(innovation @ np.linalg.solve(S, innovation))
    except np.linalg.LinAlgError:
        return np.nan


_SOLVED = "position_e", "velocity_e", "C_eb", "accel_bias_b", "gyro_bias_b"
_SEEN = "innovation", "innovation_cov"
_DESIGN = np.zeros((6, STATES))
_DESIGN[np.arange(6), MEASURED] = -1.0
