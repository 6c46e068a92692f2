"""The compiled halves of a receiver's epoch, over a slice of a batch of receivers."""

from __future__ import annotations

import numpy as np

from .._jit import njit
from ..earth.ranging import range_and_rate
from ..sim._kernels import gnss_epoch, imu_block
from ..sim.sensors import unpack_sensors
from .error_model import fill_transition, propagate_covariance
from .kalman import (
    accumulate,
    gain_solution,
    innovation_covariance,
    innovation_variance,
    solve_in_place,
)
from .state import unpack
from .strapdown import strapdown_step

L = 8  # state.LANES, as a constant that the compiler sees
_X = 31 * L
MEASURE, PREDICT, UPDATE, MODEL = 1, 2, 4, 8
"""What `run_epochs` does; with `MODEL`, the prediction writes design and innovation covariance."""


@njit
def mechanize(state, measured, block, samples, imu_interval, group, hi, work):
    """Run the samples of one interval through the strapdown, `L` receivers side by side.

    Lanes without a receiver repeat the last one, so that a receiver takes the same path in any
    batch.  Their number comes from the array: LLVM would unroll a loop of a known length instead of
    vectorizing it.  `work` is component by component: C_eb (9), velocity (3), position (3),
    accelerometer and gyro bias (6), sums of specific force and angular rate (6), last specific
    force (3), dt.
    """
    lanes, most = samples.shape[2] // 6, 0
    for lane in range(lanes):
        b = min(group * L + lane, hi - 1)
        most = max(most, block[1, b])
        for i in range(3):
            for j in range(3):
                work[(3 * i + j) * L + lane] = state.C_eb[b, i, j]
            work[(9 + i) * L + lane] = state.velocity_e[b, i]
            work[(12 + i) * L + lane] = state.position_e[b, i]
            work[(15 + i) * L + lane] = state.accel_bias_b[b, i]
            work[(18 + i) * L + lane] = state.gyro_bias_b[b, i]
        for i in range(21, 31):
            work[i * L + lane] = 0.0
    for i in range(most):
        m = samples[group, i]
        for lane in range(lanes):
            b = min(group * L + lane, hi - 1)
            inside = i < block[1, b]
            work[30 * L + lane] = imu_interval[block[0, b] + i] if inside else 0.0
        strapdown_lanes(work, m, lanes)
    for lane in range(lanes):
        b = group * L + lane
        if b >= hi:
            break
        for i in range(3):
            for j in range(3):
                state.C_eb[b, i, j] = work[(3 * i + j) * L + lane]
            state.velocity_e[b, i] = work[(9 + i) * L + lane]
            state.position_e[b, i] = work[(12 + i) * L + lane]
        for i in range(6):
            measured.imu_delta[b, i] = work[(21 + i) * L + lane]


@njit
def strapdown_lanes(x, m, lanes):
    """Advance one sample in all lanes; a sample of no length changes nothing."""
    for i in range(lanes):
        dt = x[30 * L + i]
        C = (
            x[i],
            x[L + i],
            x[2 * L + i],
            x[3 * L + i],
            x[4 * L + i],
            x[5 * L + i],
            x[6 * L + i],
            x[7 * L + i],
            x[8 * L + i],
        )
        v = (x[9 * L + i], x[10 * L + i], x[11 * L + i])
        r = (x[12 * L + i], x[13 * L + i], x[14 * L + i])
        fx, fy, fz = m[i] - x[15 * L + i], m[L + i] - x[16 * L + i], m[2 * L + i] - x[17 * L + i]
        wx = m[3 * L + i] - x[18 * L + i]
        wy = m[4 * L + i] - x[19 * L + i]
        wz = m[5 * L + i] - x[20 * L + i]
        C, v, r = strapdown_step(C, v, r, (fx, fy, fz), (wx, wy, wz), dt)
        x[i], x[L + i], x[2 * L + i] = C[0], C[1], C[2]
        x[3 * L + i], x[4 * L + i], x[5 * L + i] = C[3], C[4], C[5]
        x[6 * L + i], x[7 * L + i], x[8 * L + i] = C[6], C[7], C[8]
        x[9 * L + i], x[10 * L + i], x[11 * L + i] = v[0], v[1], v[2]
        x[12 * L + i], x[13 * L + i], x[14 * L + i] = r[0], r[1], r[2]
        x[21 * L + i] += fx * dt
        x[22 * L + i] += fy * dt
        x[23 * L + i] += fz * dt
        x[24 * L + i] += wx * dt
        x[25 * L + i] += wy * dt
        x[26 * L + i] += wz * dt
        keep = 1.0 if dt > 0.0 else 0.0
        x[27 * L + i] += keep * (fx - x[27 * L + i])
        x[28 * L + i] += keep * (fy - x[28 * L + i])
        x[29 * L + i] += keep * (fz - x[29 * L + i])


@njit
def predict(floats, flags, block, samples, imu_interval, receivers, channels, lo, hi, model=True):
    """Mechanize one block of samples, propagate, and form innovation and variance.

    `imu_interval` (N,) length of every sample of the run [s]; `model`: whether to write the design
    and the innovation covariance, which only some detectors look at.
    """
    state, measured, noise_psd = unpack(floats, flags, receivers, channels)
    covariance_work, row_work = np.empty(289), np.empty(17)
    lane_work = np.empty(_X + L)  # aligned below, or every vector of 64 bytes lies in two lines
    aligned = (64 - lane_work.ctypes.data % 64) // 8
    lane_work = lane_work[aligned : aligned + _X]
    n = channels
    for b in range(lo, hi):
        if b % L == 0:
            mechanize(state, measured, block, samples, imu_interval, b // L, hi, lane_work)
        C, v, r = state.C_eb[b], state.velocity_e[b], state.position_e[b]
        fx, fy, fz = (
            lane_work[27 * L + b % L],
            lane_work[28 * L + b % L],
            lane_work[29 * L + b % L],
        )
        # ---- errors and clock
        tau = measured.interval[b]
        Phi = measured.transition[b]
        fill_transition(Phi, C, r, fx, fy, fz, tau)
        P = state.covariance[b].reshape(289)
        propagate_covariance(P, Phi, noise_psd[b], tau, covariance_work)
        state.clock[b, 0] += state.clock[b, 1] * tau
        # ---- innovation
        H, z, u = measured.design[b], measured.innovation[b], measured.line_of_sight[b]
        for s in range(n):
            if measured.visible[b, s]:
                p, q = measured.satellite_position[b, s], measured.satellite_velocity[b, s]
                rho, rate, ux, uy, uz = range_and_rate(
                    p[0], p[1], p[2], q[0], q[1], q[2], r[0], r[1], r[2], v[0], v[1], v[2]
                )
                z[s] = measured.pseudorange[b, s] - (rho + state.clock[b, 0])
                z[n + s] = measured.range_rate[b, s] - (rate + state.clock[b, 1])
                u[s, 0], u[s, 1], u[s, 2] = ux, uy, uz
                one = 1.0
            else:
                z[s], z[n + s] = 0.0, 0.0
                u[s, 0], u[s, 1], u[s, 2] = 0.0, 0.0, 0.0
                one = 0.0
            if not model:
                continue
            for i in range(3):
                H[s, 6 + i] = u[s, i]
                H[n + s, 3 + i] = u[s, i]
            H[s, 15] = one
            H[n + s, 16] = one
        R, seen = measured.noise_variance[b], measured.visible[b]
        innovation_variance(P, u, R, seen, measured.innovation_variance[b])
        if model:
            innovation_covariance(P, u, R, seen, row_work, measured.innovation_cov[b])


@njit
def update(
    floats,
    flags,
    weights,
    receivers,
    channels,
    covariance_update,
    min_satellites,
    orthonormalize,
    lo,
    hi,
):
    """Correct the predicted state with the weighted gain, and feed it back.

    `floats`, `flags`: of `ReceiverBuffers`, after `predict`; corrected in place; `weights` (B, 2n)
    weights on the columns of the gain.
    """
    state, measured, _ = unpack(floats, flags, receivers, channels)
    A, A1, A2 = np.empty((8, 8)), np.empty((8, 8)), np.empty((8, 8))
    F, M, V = np.empty((8, 8)), np.empty((8, 8)), np.empty(64)
    Pc, Q = np.empty(136), np.empty(136)
    y, x = np.empty(8), np.empty(17)
    n = channels
    for b in range(lo, hi):
        seen = 0
        for s in range(n):
            if measured.visible[b, s]:
                seen += 1
        measured.coasting[b] = seen < min_satellites
        if seen < min_satellites:
            continue
        accumulate(
            measured.line_of_sight[b],
            measured.innovation[b],
            measured.noise_variance[b],
            weights[b],
            measured.visible[b],
            covariance_update,
            A,
            A1,
            A2,
            y,
        )
        gain_solution(
            state.covariance[b].reshape(289), A, A1, A2, y, covariance_update, F, M, V, Pc, Q, x
        )
        C = state.C_eb[b]
        for j in range(3):
            c0, c1, c2 = C[0, j], C[1, j], C[2, j]
            C[0, j] = c0 + x[2] * c1 - x[1] * c2
            C[1, j] = c1 - x[2] * c0 + x[0] * c2
            C[2, j] = c2 + x[1] * c0 - x[0] * c1
        if orthonormalize:
            _orthonormalize(C)
        for i in range(3):
            state.velocity_e[b, i] -= x[3 + i]
            state.position_e[b, i] -= x[6 + i]
            state.accel_bias_b[b, i] += x[9 + i]
            state.gyro_bias_b[b, i] += x[12 + i]
        state.clock[b, 0] += x[15]
        state.clock[b, 1] += x[16]


@njit
def _orthonormalize(C):
    """One step towards the nearest rotation: C <- C (3 I - C' C) / 2, row by row."""
    g00 = C[0, 0] * C[0, 0] + C[1, 0] * C[1, 0] + C[2, 0] * C[2, 0]
    g11 = C[0, 1] * C[0, 1] + C[1, 1] * C[1, 1] + C[2, 1] * C[2, 1]
    g22 = C[0, 2] * C[0, 2] + C[1, 2] * C[1, 2] + C[2, 2] * C[2, 2]
    g01 = C[0, 0] * C[0, 1] + C[1, 0] * C[1, 1] + C[2, 0] * C[2, 1]
    g02 = C[0, 0] * C[0, 2] + C[1, 0] * C[1, 2] + C[2, 0] * C[2, 2]
    g12 = C[0, 1] * C[0, 2] + C[1, 1] * C[1, 2] + C[2, 1] * C[2, 2]
    for i in range(3):
        a, b, c = C[i, 0], C[i, 1], C[i, 2]
        C[i, 0] = 0.5 * ((3.0 - g00) * a - g01 * b - g02 * c)
        C[i, 1] = 0.5 * ((3.0 - g11) * b - g01 * a - g12 * c)
        C[i, 2] = 0.5 * ((3.0 - g22) * c - g02 * a - g12 * b)


@njit
def measure(
    sensor_floats,
    keys,
    epochs,
    floats,
    flags,
    block,
    samples,
    run,
    epoch_time,
    epoch_end,
    satellites,
    receivers,
    channels,
    padded_imu,
    padded_gnss,
    advance,
    lo,
    hi,
):
    """Move every receiver to its next epoch and measure everything on the way."""
    sensors = unpack_sensors(sensor_floats, receivers, channels)
    _, measured, _ = unpack(floats, flags, receivers, channels)
    imu_noise, gnss_noise = np.empty(padded_imu), np.empty(padded_gnss)
    scratch = np.empty((6, samples.shape[1]))
    n = channels
    for b in range(lo, hi):
        k = epochs[b] + advance
        epochs[b] = k
        tau = 0.0
        if advance:
            tau = epoch_time[k] - epoch_time[k - 1]
            a, e = epoch_end[k - 1], epoch_end[k]
            block[0, b], block[1, b] = a, e - a
            truth = (
                run[0, a:e],
                run[1, a:e],
                run[2, a:e],
                run[3, a:e],
                run[4, a:e],
                run[5, a:e],
            )
            imu_block(sensors, b, keys[0, b], k, truth, run[7, a:e], imu_noise, scratch)
            group, lane = b // L, b % L
            for i in range(e - a):
                for c in range(6):
                    samples[group, i, c * L + lane] = scratch[c, i]
        measured.time[b] = epoch_time[k]
        measured.interval[b] = tau
        gnss_epoch(
            sensors,
            b,
            keys[2, b],
            keys[1, b],
            keys[7, b],
            k,
            tau,
            satellites[k],
            gnss_noise,
            measured.pseudorange[b],
            measured.range_rate[b],
        )
        for s in range(n):
            measured.visible[b, s] = satellites[k, s, 6] > 0.0
            if not measured.visible[b, s]:
                measured.pseudorange[b, s] = 0.0
                measured.range_rate[b, s] = 0.0
            for i in range(3):
                measured.satellite_position[b, s, i] = satellites[k, s, i]
                measured.satellite_velocity[b, s, i] = satellites[k, s, 3 + i]


@njit
def first_fix(floats, flags, guess_e, receivers, channels, lo, hi):
    """Equally weighted least-squares fix of the present epoch, into the state.

    Three Gauss-Newton steps from a guess within a kilometre leave less than a micrometre.

    `guess_e` (B, 3) where to linearize first, ECEF [m].
    """
    state, measured, _ = unpack(floats, flags, receivers, channels)
    M, x = np.empty((4, 4)), np.empty((4, 1))
    for b in range(lo, hi):
        r, v, clock = state.position_e[b], state.velocity_e[b], state.clock[b]
        for i in range(3):
            r[i], v[i] = guess_e[b, i], 0.0
        clock[0], clock[1] = 0.0, 0.0
        for step in range(4):
            rates = step == 3
            M[:] = 0.0
            x[:] = 0.0
            for s in range(channels):
                if not measured.visible[b, s]:
                    continue
                p, q = measured.satellite_position[b, s], measured.satellite_velocity[b, s]
                rho, rate, ux, uy, uz = range_and_rate(
                    p[0], p[1], p[2], q[0], q[1], q[2], r[0], r[1], r[2], v[0], v[1], v[2]
                )
                z = measured.pseudorange[b, s] - rho - clock[0]
                if rates:
                    z = measured.range_rate[b, s] - rate
                h = (-ux, -uy, -uz, 1.0)
                for i in range(4):
                    x[i, 0] += h[i] * z
                    for j in range(4):
                        M[i, j] += h[i] * h[j]
            solve_in_place(M, x, 1)
            for i in range(3):
                if rates:
                    v[i] += x[i, 0]
                else:
                    r[i] += x[i, 0]
            clock[1 if rates else 0] += x[3, 0]


@njit
def run_epochs(
    floats,
    flags,
    block,
    samples,
    weights,
    sensor_floats,
    keys,
    epochs,
    run,
    epoch_time,
    epoch_end,
    satellites,
    receivers,
    channels,
    padded_imu,
    padded_gnss,
    covariance_update,
    min_satellites,
    orthonormalize,
    what,
    count,
    lo,
    hi,
):
    """Do some of what an epoch is made of, for some epochs.

    The engine and the replay of recordings call this and nothing else, since the bits of a compiled
    function depend on what it is compiled into.

    `weights` (B, 2n) weights on the columns of the gain; `run` (8, N) true samples, their lengths
    and root rates, as `World.run`; only the lengths are needed without `MEASURE`.
    """
    for _ in range(count):
        advance = what & MEASURE  # no literal 1, for which `measure` would be compiled once more
        if advance:
            measure(
                sensor_floats,
                keys,
                epochs,
                floats,
                flags,
                block,
                samples,
                run,
                epoch_time,
                epoch_end,
                satellites,
                receivers,
                channels,
                padded_imu,
                padded_gnss,
                advance,
                lo,
                hi,
            )
        if what & PREDICT:
            model = what & MODEL != 0
            predict(floats, flags, block, samples, run[6], receivers, channels, lo, hi, model)
        if what & UPDATE:
            update(
                floats,
                flags,
                weights,
                receivers,
                channels,
                covariance_update,
                min_satellites,
                orthonormalize,
                lo,
                hi,
            )
