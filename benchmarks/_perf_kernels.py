"""One part of an epoch again and again, and the floor: loops over the library's lane functions."""

from __future__ import annotations

import numpy as np

from spoofgym.attacks._kernels import false_position
from spoofgym.core.compile import njit
from spoofgym.core.simd import LANES, count_lanes, load, load_pair, pair_lanes, splat, store
from spoofgym.detectors.charts import judge_channels
from spoofgym.receiver import _kernels as filters
from spoofgym.receiver import kalman
from spoofgym.receiver.states import TERMS
from spoofgym.truth import _kernels as world
from spoofgym.truth.noise import COUNTERS_OF_EIGHT, deviates, normal_pair, threefry

NOISE, SENSE, MECHANIZE, PROPAGATE, MEASURE, INNOVATE, COVARIANCE_S, UPDATE, FLOOR = range(9)
PRODUCT = filters.PRODUCT_ROWS
TRUTH = 8 * world.CHUNK


def work_rows(channels: int, imu_size: int, gnss_size: int) -> int:
    """Rows of scratch memory that `repeat` needs."""
    n, fixed = channels, TRUTH + TERMS + PRODUCT + kalman.WORK + 6
    return fixed + imu_size + imu_size // 6 + gnss_size + (world.SKY + 8) * n + 4 * n * n


@njit
def noise_in_registers(k0, k1, epoch, size, out):
    """Write the sums of the deviates of an epoch, which are not written themselves (`deviates`)."""
    rows, counters = out.reshape((out.size // LANES, LANES)), load_pair(COUNTERS_OF_EIGHT, 0)
    k0, k1, epoch = splat(k0, rows), splat(k1, rows), splat(epoch, rows)
    k0, k1, epoch = pair_lanes(k0), pair_lanes(k1), pair_lanes(epoch)
    total = splat(0.0, k0)
    for q in range(0, size // 4, 2):
        x, y = threefry(counters + np.uint64(q), epoch, k0, k1)
        a, b = normal_pair(x)
        c, d = normal_pair(y)
        total += (a + b) + (c + d)
    store(rows, 0, total)


@njit
def repeat(part, rounds, epoch, lanes, truth, rules, work, lo, hi):
    """Do a part of an epoch of receivers lo to hi, whole groups, `rounds` times.

    The floor is noise, sensing, mechanization, propagation, measurement, innovation and update of
    the first group, as often as there are groups.  Its deviates stay in registers, and it takes
    the first half of the samples twice, so that what it touches stays in the nearest cache.

    `epoch`: of all receivers; `lanes`: x, assumed, sensors, constants and keys; `truth`: run,
    epoch_time, epoch_end and satellites, and `rules`, as in `receiver._kernels.Arrays`; `work`:
    lane array of `work_rows`.
    """
    x, assumed, sensors, constants, keys = lanes
    run, epoch_time, epoch_end, satellites = truth
    n, size, gnss_size = satellites.shape[1], rules[3], rules[4]
    rows, sensor_rows = filters.CHANNELS + filters.ALL * n, world.CHANNELS + 2 * n
    samples, work = work[:size], work[size:]
    dt, work = work[: size // 6], work[size // 6 :]
    gathered, terms, work = work[:TRUTH], work[TRUTH:], work[TRUTH + TERMS :]
    product, solution, work = work[:PRODUCT], work[PRODUCT:], work[PRODUCT + kalman.WORK :]
    force, active, work = work[:4], work[4:5], work[6:]
    noise, sky, work = work[:gnss_size], work[gnss_size:], work[gnss_size + world.SKY * n :]
    added, weights, precision, S = work[: 4 * n], work[4 * n :], work[6 * n :], work[8 * n :]
    now, first = np.empty(count_lanes(x), np.int64), np.empty(count_lanes(x), np.int64)
    for each in range(count_lanes(x)):
        now[each], first[each] = epoch, epoch_end[epoch - 1]
    count = epoch_end[epoch] - epoch_end[epoch - 1]
    tau = splat(epoch_time[epoch] - epoch_time[epoch - 1], x)
    k, half = splat(np.uint64(epoch), keys), (count + 1) // 2
    store(active, 0, 1.0)
    for s in range(2 * n):
        store(added, s, 0.0)
        store(added, 2 * n + s, 1.0)
        store(weights, s, 1.0)
    world.gather_sky(satellites, now, sky)
    leader = lo // count_lanes(x)
    for _ in range(rounds):
        for group in range(leader, -(-hi // count_lanes(x))):
            here = leader if part == FLOOR else group
            base, sensor_base, key = here * rows, here * sensor_rows, here * world.KEYS
            fixed = here * world.CONSTANT_ROWS % constants.shape[0]
            of_sensors = sensors, sensor_base, constants, fixed
            c, P = base + filters.CHANNELS, base + filters.COVARIANCE
            u, seen = c + filters.SIGHT * n, c + filters.VISIBLE * n
            believed = here * (filters.VARIANCE + 2 * n) % assumed.shape[0]
            R = believed + filters.VARIANCE
            if part in (NOISE, FLOOR):
                k0, k1 = load(keys, key + world.IMU_KEY), load(keys, key + world.IMU_KEY + 1)
                if part == NOISE or count_lanes(x) == 1:  # which makes vectors of one lane
                    deviates(k0, k1, k, size, 6 * count, samples)
                else:
                    noise_in_registers(k0, k1, k, size, samples)
            if part == FLOOR:
                for some in (half, count - half):
                    world.sense(run, first, some, *of_sensors, samples, dt, gathered, active)
                    filters.mechanize(x, base, samples, dt, some, active, force)
            if part == SENSE:
                world.sense(run, first, count, *of_sensors, samples, dt, gathered, active)
            if part == MECHANIZE:
                filters.mechanize(x, base, samples, dt, count, active, force)
            if part == MEASURE:
                world.gather_sky(satellites, now, sky)
            if part in (MEASURE, FLOOR):
                world.measure(of_sensors, n, keys, key, k, tau, sky, noise, added, added[:0], x, c)
            if part in (PROPAGATE, FLOOR):
                filters.propagate(x, base, assumed, believed, force, tau, terms, product)
            if part in (INNOVATE, FLOOR):
                filters.innovate(x, base, n, tau, sky)
                kalman.innovation_variance(x, P, u, assumed, R, seen, n, precision)
            if part == COVARIANCE_S:
                kalman.innovation_covariance(x, P, u, assumed, R, seen, n, S, product)
            if part in (UPDATE, FLOOR):
                given = assumed, believed, n, weights, rules
                filters.correct(x, base, *given, solution, precision)


@njit
def repeat_attack(rounds, given, lo, hi):
    """Command receivers lo to hi so often, by `false_position`."""
    for _ in range(rounds):
        false_position(*given, lo, hi)


@njit
def repeat_judge(rounds, given, memory, out, lo, hi):
    """Let the charts of receivers lo to hi judge the same epoch so often (`judge_channels`).

    `given`: innovations, variances, visibility, and the three settings; `memory`: averages and
    decays; `out`: statistics, thresholds and weights.
    """
    (z, variance, visible, a, b, c), (average, decay), (size, limit, weights) = given, memory, out
    for _ in range(rounds):
        judge_channels(
            z[lo:hi],
            variance[lo:hi],
            visible[lo:hi],
            a,
            b,
            c,
            average[lo:hi],
            decay[lo:hi],
            size[lo:hi],
            limit[lo:hi],
            weights[lo:hi],
        )
