"""One part of an epoch again and again, and the floor: loops over the package's lane functions."""

from __future__ import annotations

import numpy as np

from .._jit import njit
from .._simd import lanes_of, load, splat, store
from ..receiver import kalman
from ..receiver._kernels import (
    ALL,
    CHANNELS,
    COVARIANCE,
    PRODUCT_ROWS,
    SIGHT,
    VARIANCE,
    VISIBLE,
    correct,
    innovate,
    mechanize,
    propagate,
)
from ..receiver.error_model import TERMS
from ..sim._kernels import CHANNELS as SENSOR_CHANNELS
from ..sim._kernels import CHUNK, IMU_KEY, KEYS, SKY, gather_sky, measure, sense
from ..sim.noise import deviates, normal_pair, threefry

NOISE, SENSE, MECHANIZE, PROPAGATE, MEASURE, INNOVATE, COVARIANCE_S, UPDATE, FLOOR = range(9)


def work_rows(channels: int, imu_size: int, gnss_size: int) -> int:
    """Rows of scratch memory that `repeat` needs."""
    n, fixed = channels, 8 * CHUNK + TERMS + PRODUCT_ROWS + kalman.WORK + 6
    return fixed + imu_size + imu_size // 6 + gnss_size + (SKY + 8) * n + 4 * n * n


@njit
def noise_in_registers(k0, k1, epoch, size):
    """Sum the deviates of an epoch, which are written nowhere (`deviates`)."""
    total = splat(0.0, k0)
    for q in range(size // 4):
        x, y = threefry(splat(np.uint64(q), k0), epoch, k0, k1)
        a, b = normal_pair(x)
        c, d = normal_pair(y)
        total += (a + b) + (c + d)
    return total


@njit
def repeat(
    part,
    rounds,
    epoch,
    x,
    sensors,
    keys,
    run,
    epoch_time,
    epoch_end,
    satellites,
    rules,
    work,
    lo,
    hi,
):
    """Do a part of an epoch for groups lo to hi, `rounds` times; all receivers are at that epoch.

    The floor is noise, sensing, mechanization, propagation, measurement, innovation and update of
    one group, lo, as often as there are groups.  Its deviates stay in registers, and its samples
    are those of one chunk again and again, so that all that it touches stays in the nearest cache.

    The arguments are those of `receiver._kernels.run_epochs`; `work`: lane array of `work_rows`.
    """
    n, lanes = satellites.shape[1], lanes_of(x)
    size, gnss_size = rules[3], rules[4]
    rows, sensor_rows = CHANNELS + ALL * n, SENSOR_CHANNELS + 2 * n
    samples, work = work[:size], work[size:]
    dt, truth, work = work[: size // 6], work[size // 6 :], work[size // 6 + 8 * CHUNK :]
    terms, product, work = work[:TERMS], work[TERMS:], work[TERMS + PRODUCT_ROWS :]
    solution, force, work = work[: kalman.WORK], work[kalman.WORK :], work[kalman.WORK + 4 :]
    active, row, noise, work = work[:1], work[1:2], work[2:], work[2 + gnss_size :]
    noise, sky, work = noise[:gnss_size], work[: SKY * n], work[SKY * n :]
    added, weights, precision = work[: 4 * n], work[4 * n : 6 * n], work[6 * n : 8 * n]
    S = work[8 * n :]
    now, first = np.empty(lanes, np.int64), np.empty(lanes, np.int64)
    for each in range(lanes):
        now[each], first[each] = epoch, epoch_end[epoch - 1]
    count, tau = epoch_end[epoch] - epoch_end[epoch - 1], splat(0.0, x)
    tau += epoch_time[epoch] - epoch_time[epoch - 1]
    k = splat(np.uint64(epoch), keys)
    store(active, 0, 1.0)
    for s in range(2 * n):
        store(added, s, 0.0)
        store(added, 2 * n + s, 1.0)
        store(weights, s, 1.0)
    gather_sky(satellites, now, sky)
    for _ in range(rounds):
        for group in range(lo, hi):
            here = lo if part == FLOOR else group
            base, sensor_base, key_row = here * rows, here * sensor_rows, here * KEYS
            c = base + CHANNELS
            u, R, seen = c + SIGHT * n, c + VARIANCE * n, c + VISIBLE * n
            if part == NOISE:
                k0, k1 = load(keys, key_row + IMU_KEY), load(keys, key_row + IMU_KEY + 1)
                deviates(k0, k1, k, size, 6 * count, samples)
            if part == FLOOR:
                k0, k1 = load(keys, key_row + IMU_KEY), load(keys, key_row + IMU_KEY + 1)
                store(row, 0, noise_in_registers(k0, k1, k, size))
                for start in range(0, count, CHUNK):
                    some = min(CHUNK, count - start)
                    sense(run, first, some, sensors, sensor_base, samples, dt, truth, active)
                    mechanize(x, base, samples, dt, some, active, force)
            if part == SENSE:
                sense(run, first, count, sensors, sensor_base, samples, dt, truth, active)
            if part == MECHANIZE:
                mechanize(x, base, samples, dt, count, active, force)
            if part in (MEASURE, FLOOR):
                if part == MEASURE:
                    gather_sky(satellites, now, sky)
                measure(sensors, sensor_base, n, keys, key_row, k, tau, sky, noise, added, x, c)
            if part in (PROPAGATE, FLOOR):
                propagate(x, base, force, tau, terms, product)
            if part in (INNOVATE, FLOOR):
                innovate(x, base, n, tau, sky)
                kalman.innovation_variance(x, base + COVARIANCE, u, R, seen, n, precision)
            if part == COVARIANCE_S:
                P = base + COVARIANCE
                kalman.innovation_covariance(x, P, u, R, seen, n, S, product)
            if part in (UPDATE, FLOOR):
                correct(x, base, n, weights, rules, solution, precision)
