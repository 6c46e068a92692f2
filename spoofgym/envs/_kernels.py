"""The compiled call that takes a batch of receivers to its next epoch's measurements."""

from __future__ import annotations

import numpy as np

from .._jit import njit
from ..earth.ranging import range_and_rate
from ..receiver._kernels import predict, update
from ..receiver.kalman import solve_in_place
from ..receiver.state import unpack
from ..sim._kernels import gnss_epoch, imu_block
from ..sim.sensors import unpack_sensors

L = 8  # receiver.state.LANES, as a constant that the compiler sees


@njit
def measure(
    sensor_floats,
    keys,
    epochs,
    floats,
    flags,
    block,
    samples,
    imu_truth,
    imu_root_rate,
    epoch_time,
    epoch_end,
    satellites,
    visible,
    receivers,
    channels,
    padded_imu,
    padded_gnss,
    advance,
    lo,
    hi,
):
    """Move every receiver to its next epoch and measure everything on the way.

    Parameters
    ----------
    sensor_floats, keys, epochs : ndarray
        Of `SensorBuffers`; advanced.
    floats, flags, block, samples : ndarray
        Of `ReceiverBuffers`; measurements are written.
    imu_truth, imu_root_rate, epoch_time, epoch_end, satellites, visible : ndarray
        Of `World`.
    receivers, channels : int
        B and n.
    padded_imu, padded_gnss : int
        Numbers of deviates to draw for the inertial samples and for GNSS.
    advance : int
        1 for the next epoch; 0 to measure the present one, without inertial samples.
    lo, hi : int
        Slice of receivers.
    """
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
                imu_truth[0, a:e],
                imu_truth[1, a:e],
                imu_truth[2, a:e],
                imu_truth[3, a:e],
                imu_truth[4, a:e],
                imu_truth[5, a:e],
            )
            imu_block(sensors, b, keys[0, b], k, truth, imu_root_rate[a:e], imu_noise, scratch)
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
            k,
            tau,
            satellites[k],
            gnss_noise,
            measured.pseudorange[b],
            measured.range_rate[b],
        )
        for s in range(n):
            measured.visible[b, s] = visible[k, s]
            if not visible[k, s]:
                measured.pseudorange[b, s] = 0.0
                measured.range_rate[b, s] = 0.0
            for i in range(3):
                measured.satellite_position[b, s, i] = satellites[k, s, i]
                measured.satellite_velocity[b, s, i] = satellites[k, s, 3 + i]


@njit
def first_fix(floats, flags, guess_e, receivers, channels, lo, hi):
    """Equally weighted least-squares fix of the present epoch, into the state.

    Three Gauss-Newton steps from a guess within a kilometre leave less than a micrometre.

    Parameters
    ----------
    floats, flags : ndarray
        Of `ReceiverBuffers`.
    guess_e : ndarray
        (3,) where to linearize first, ECEF [m].
    receivers, channels : int
        B and n.
    lo, hi : int
        Slice of receivers.
    """
    state, measured, _ = unpack(floats, flags, receivers, channels)
    M, x = np.empty((4, 4)), np.empty((4, 1))
    for b in range(lo, hi):
        r, v, clock = state.position_e[b], state.velocity_e[b], state.clock[b]
        for i in range(3):
            r[i], v[i] = guess_e[i], 0.0
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
def quiet(
    sensor_floats,
    keys,
    epochs,
    floats,
    flags,
    block,
    samples,
    imu_truth,
    imu_root_rate,
    imu_interval,
    epoch_time,
    epoch_end,
    satellites,
    visible,
    weights,
    receivers,
    channels,
    padded_imu,
    padded_gnss,
    covariance_update,
    min_satellites,
    orthonormalize,
    count,
    lo,
    hi,
):
    """Run clean epochs without a detector, by the three kernels that every step is made of.

    Parameters
    ----------
    sensor_floats, keys, epochs, floats, flags, block, samples, imu_truth, imu_root_rate
        As in `measure`.
    imu_interval : ndarray
        (N,) length of every sample [s].
    epoch_time, epoch_end, satellites, visible
        As in `measure`.
    weights : ndarray
        (B, 2n) ones.
    receivers, channels, padded_imu, padded_gnss
        As in `measure`.
    covariance_update, min_satellites, orthonormalize
        As in `receiver._kernels.update`.
    count : int
        Number of epochs.
    lo, hi : int
        Slice of receivers.
    """
    for _ in range(count):
        measure(
            sensor_floats,
            keys,
            epochs,
            floats,
            flags,
            block,
            samples,
            imu_truth,
            imu_root_rate,
            epoch_time,
            epoch_end,
            satellites,
            visible,
            receivers,
            channels,
            padded_imu,
            padded_gnss,
            1,
            lo,
            hi,
        )
        predict(floats, flags, block, samples, imu_interval, receivers, channels, lo, hi)
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
