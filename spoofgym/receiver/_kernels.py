"""The compiled halves of a receiver's epoch, group by group of a batch of receivers."""

from collections import namedtuple

import numpy as np

from ..core.compile import inline_njit, njit
from ..core.lanes import first_rows
from ..core.simd import (
    any_lane,
    count_lanes,
    flags_at,
    floats_at,
    integers_at,
    lane,
    load,
    rows_at,
    select,
    set_lane,
    splat,
    store,
    words_at,
)
from ..earth.wgs84 import EARTH_RATE, range_and_rate
from ..truth import _kernels as world
from ..truth._kernels import SKY, keep3, load3, store3
from ..truth.noise import BLOCK, deviates, to_integer
from ..truth.signal_errors import MAPPINGS, OBLIQUITIES, count_deviates
from . import kalman
from .epoch import assumed_shapes, receiver_shapes
from .states import INDEX, TERMS, propagate_covariance, transition_terms
from .strapdown import strapdown_step

_ROWS = first_rows(receiver_shapes(1))
C_EB, VELOCITY, POSITION = _ROWS["C_eb"], _ROWS["velocity_e"], _ROWS["position_e"]
ACCEL_BIAS, GYRO_BIAS, CLOCK = _ROWS["accel_bias_b"], _ROWS["gyro_bias_b"], _ROWS["clock"]
IMU_DELTA, COVARIANCE = _ROWS["imu_delta"], _ROWS["packed_covariance"]
CHANNELS = _ROWS["innovation"]  # from here n times each of the following numbers of rows
INNOVATION, SIGHT, VISIBLE, ALL = 0, 2, 5, 6
_ASSUMED = first_rows(assumed_shapes(1))
NOISE_PSD, VARIANCE = _ASSUMED["noise_psd"], _ASSUMED["noise_variance"]
MEASURE, PREDICT, UPDATE, SHOW = 1, 2, 4, 8
PRODUCT_ROWS = 187


# places of what is seen of an epoch, as `epoch.SEEN`
(
    SEEN_INNOVATION,
    SEEN_VARIANCE,
    SEEN_S,
    SEEN_P,
    SEEN_H,
    SEEN_PHI,
    SEEN_DELTA,
    SEEN_RANGE,
    SEEN_RATE,
    SEEN_SATELLITE,
    SEEN_SATELLITE_VELOCITY,
) = range(11)


@inline_njit
def load_attitude(x, base):
    """C, row by row."""
    first = base + C_EB
    return load3(x, first) + load3(x, first + 3) + load3(x, first + 6)


@njit
def mechanize(x, base, samples, dt, count, active, force):
    """Run the samples of one interval through the strapdown, in the lanes that are `active`.
    `samples`: rows c count + i for sensor c and sample i; `dt`: lengths [s]; `active`: one row, 1
    or 0; `force`: three rows, written: last bias-corrected specific force, body axes [m/s^2]."""
    C, v, r = load_attitude(x, base), load3(x, base + VELOCITY), load3(x, base + POSITION)
    a, g = load3(x, base + ACCEL_BIAS), load3(x, base + GYRO_BIAS)
    zero = splat(0.0, x)
    f = zero, zero, zero
    moved, turned = f, f
    n = count
    for i in range(n):
        h = load(dt, i)
        f0, f1 = load(samples, i) - a[0], load(samples, n + i) - a[1]
        w0, w1 = load(samples, 3 * n + i) - g[0], load(samples, 4 * n + i) - g[1]
        f = f0, f1, load(samples, 2 * n + i) - a[2]
        w = w0, w1, load(samples, 5 * n + i) - g[2]
        C, v, r = strapdown_step(C, v, r, f, w, h)
        moved = moved[0] + f[0] * h, moved[1] + f[1] * h, moved[2] + f[2] * h
        turned = turned[0] + w[0] * h, turned[1] + w[1] * h, turned[2] + w[2] * h
    now = load(active, 0) > 0.0
    keep3(x, base + C_EB, now, C[:3])
    keep3(x, base + C_EB + 3, now, C[3:6])
    keep3(x, base + C_EB + 6, now, C[6:])
    keep3(x, base + VELOCITY, now, v)
    keep3(x, base + POSITION, now, r)
    keep3(x, base + IMU_DELTA, now, moved)
    keep3(x, base + IMU_DELTA + 3, now, turned)
    keep3(force, 0, now, f)


@njit
def propagate(x, base, assumed, first, force, tau, terms, product):
    """Propagate a group's covariance over one interval. `assumed`, `first`: lane array and first
    row of what the group assumes."""
    C, r, f = load_attitude(x, base), load3(x, base + POSITION), load3(force, 0)
    transition_terms(C, r, f, tau, terms)
    propagate_covariance(x, base + COVARIANCE, terms, tau, assumed, first + NOISE_PSD, product)


@njit
def innovate(x, base, n, tau, sky):
    """Propagate the clock, and write lines of sight, and innovations in place of measurements. All
    are 0 where a satellite is invisible."""
    drift = load(x, base + CLOCK + 1)
    clock = load(x, base + CLOCK) + drift * tau
    store(x, base + CLOCK, clock)
    r, v, none = load3(x, base + POSITION), load3(x, base + VELOCITY), (0.0, 0.0, 0.0)
    c = base + CHANNELS
    for s in range(n):
        visible = load(sky, SKY * s + 6) > 0.0
        store(x, c + VISIBLE * n + s, select(visible, 1.0, 0.0))
        z, u = c + INNOVATION * n + s, c + SIGHT * n + 3 * s
        if not any_lane(visible):
            store(x, z, 0.0)
            store(x, z + n, 0.0)
            store3(x, u, none)
            continue
        rho, rate, ux, uy, uz = range_and_rate(load3(sky, SKY * s), load3(sky, SKY * s + 3), r, v)
        store(x, z, select(visible, load(x, z) - (rho + clock), 0.0))
        store(x, z + n, select(visible, load(x, z + n) - (rate + drift), 0.0))
        store3(x, u, (select(visible, ux, 0.0), select(visible, uy, 0.0), select(visible, uz, 0.0)))


@njit
def correct(x, base, assumed, first, n, weights, rules, work, precision):
    """Update a group's state and covariance; lanes with too few satellites stay as they are.
    `assumed`, `first`: as in `propagate`; `weights`: 2 n rows; `rules`: covariance update, fewest
    satellites, and whether to re-orthonormalize; `work`, `precision`: scratch memory of
    `kalman.WORK` and 2 n rows; returns which lanes have satellites enough."""
    c = base + CHANNELS
    seen = splat(0.0, x)
    for s in range(n):
        seen += load(x, c + VISIBLE * n + s)
    enough = seen >= float(rules[1])
    for s in range(2 * n):
        used = (load(x, c + VISIBLE * n + s % n) > 0.0) & enough
        store(precision, s, select(used, 1.0 / load(assumed, first + VARIANCE + s), 0.0))
    u, z = c + SIGHT * n, c + INNOVATION * n
    for half in range(2):
        for power in range(1 if rules[0] == kalman.UNWEIGHTED else 3):
            kalman.information(x, u, z, precision, weights, half, n, power, work)
    kalman.update(x, base + COVARIANCE, rules[0], work)
    dx = kalman.X
    x0, x1, x2 = load3(work, dx)
    for j in range(base + C_EB, base + C_EB + 3):
        c0, c1, c2 = load(x, j), load(x, j + 3), load(x, j + 6)
        turned = c0 + x2 * c1 - x1 * c2, c1 - x2 * c0 + x0 * c2, c2 + x1 * c0 - x0 * c1
        store3(x, j, turned, 3)
    if rules[2]:
        _orthonormalize(x, base + C_EB, enough)
    for i in range(3):
        store(x, base + VELOCITY + i, load(x, base + VELOCITY + i) - load(work, dx + 3 + i))
        store(x, base + POSITION + i, load(x, base + POSITION + i) - load(work, dx + 6 + i))
    for i in range(3):
        store(x, base + ACCEL_BIAS + i, load(x, base + ACCEL_BIAS + i) + load(work, dx + 9 + i))
        store(x, base + GYRO_BIAS + i, load(x, base + GYRO_BIAS + i) + load(work, dx + 12 + i))
    for i in range(2):
        store(x, base + CLOCK + i, load(x, base + CLOCK + i) + load(work, dx + 15 + i))
    return seen


@njit
def _orthonormalize(x, first, now):
    """One step towards the nearest rotation: C <- C (3 I - C' C) / 2, row by row."""
    c0, c1, c2 = load3(x, first)
    c3, c4, c5 = load3(x, first + 3)
    c6, c7, c8 = load3(x, first + 6)
    g00, g01 = c0 * c0 + c3 * c3 + c6 * c6, c0 * c1 + c3 * c4 + c6 * c7
    g11, g02 = c1 * c1 + c4 * c4 + c7 * c7, c0 * c2 + c3 * c5 + c6 * c8
    g22, g12 = c2 * c2 + c5 * c5 + c8 * c8, c1 * c2 + c4 * c5 + c7 * c8
    for i in range(first, first + 9, 3):
        a, b, c = load3(x, i)
        d, e = (3.0 - g00) * a - g01 * b - g02 * c, (3.0 - g11) * b - g01 * a - g12 * c
        keep3(x, i, now, (0.5 * d, 0.5 * e, 0.5 * ((3.0 - g22) * c - g02 * a - g12 * b)))


@njit
def scatter_lanes(x, row, count, out, place, first, lanes):
    for index in range(lanes):
        o = place + (first + index) * count
        for i in range(count):
            out[o + i] = lane(x, row + i, index)


@njit
def show_position(a, base, b, some):
    receivers = a.visible.shape[0]
    scatter_lanes(a.x, base + POSITION, 3, a.out, 2 * receivers, b, some)
    scatter_lanes(a.x, base + VELOCITY, 3, a.out, 5 * receivers, b, some)


@njit
def write_measured(a, row, b, some):
    n, places = a.visible.shape[1], a.places
    if places[SEEN_RANGE] >= 0:
        scatter_lanes(a.x, row, n, a.out, places[SEEN_RANGE], b, some)
    if places[SEEN_RATE] >= 0:
        scatter_lanes(a.x, row + n, n, a.out, places[SEEN_RATE], b, some)


@njit
def show(a, w, base, b, some):
    """Write what is looked at of a group's predicted epoch, receiver by receiver (`epoch.SEEN`)."""
    (receivers, n), x, out, places = a.visible.shape, a.x, a.out, a.places
    c, m = base + CHANNELS, 2 * n
    P, u, seen = base + COVARIANCE, c + SIGHT * n, c + VISIBLE * n
    R = assumed_row(a, b // count_lanes(x)) + VARIANCE
    for each in range(some):
        out[b + each] = a.epoch_time[w.spans[0, each]]
        out[receivers + b + each] = lane(w.tau, 0, each)
        for s in range(n):
            a.visible[b + each, s] = lane(x, seen + s, each) > 0.0
    show_position(a, base, b, some)
    scatter_lanes(x, c + INNOVATION * n, m, out, places[SEEN_INNOVATION], b, some)
    kalman.innovation_variance(x, P, u, a.assumed, R, seen, n, w.added)
    scatter_lanes(w.added, 0, m, out, places[SEEN_VARIANCE], b, some)
    if places[SEEN_DELTA] >= 0:
        scatter_lanes(x, base + IMU_DELTA, 6, out, places[SEEN_DELTA], b, some)
    if places[SEEN_S] >= 0:
        kalman.innovation_covariance(x, P, u, a.assumed, R, seen, n, w.rest, w.product)
    for each in range(some):
        r = b + each
        if places[SEEN_SATELLITE] >= 0:
            show_satellites(w.sky, 0, each, n, out, places[SEEN_SATELLITE] + 3 * n * r)
        if places[SEEN_SATELLITE_VELOCITY] >= 0:
            show_satellites(w.sky, 3, each, n, out, places[SEEN_SATELLITE_VELOCITY] + 3 * n * r)
        if places[SEEN_S] >= 0:
            o = places[SEEN_S] + m * m * r
            for k in range(m):
                for j in range(k, m):
                    out[o + k * m + j] = out[o + j * m + k] = lane(w.rest, k * m + j, each)
        if places[SEEN_P] >= 0:
            o = places[SEEN_P] + 289 * r
            for i in range(17):
                for j in range(17):
                    out[o + 17 * i + j] = lane(x, P + INDEX[i, j], each)
        if places[SEEN_H] >= 0:
            o = places[SEEN_H] + 17 * m * r
            show_design(x, u, seen, each, n, out[o : o + 17 * m])
        if places[SEEN_PHI] >= 0:
            o = places[SEEN_PHI] + 289 * r
            show_transition(w.terms, lane(w.tau, 0, each), each, out[o : o + 289])


@njit
def show_satellites(sky, column, each, n, out, first):
    for s in range(n):
        for i in range(3):
            out[first + 3 * s + i] = lane(sky, SKY * s + column + i, each)


@njit
def show_design(x, u, seen, each, n, H):
    for s in range(n):
        for i in range(3):
            H[17 * s + 6 + i] = H[17 * (n + s) + 3 + i] = lane(x, u + 3 * s + i, each)
        H[17 * s + 15] = H[17 * (n + s) + 16] = lane(x, seen + s, each)


@njit
def show_transition(terms, tau, index, Phi):
    w = EARTH_RATE * tau
    for i in range(17):
        Phi[18 * i] = 1.0
    Phi[1], Phi[17] = w, -w
    Phi[17 * 3 + 4], Phi[17 * 4 + 3] = 2.0 * w, -2.0 * w
    ex, ey, ez = lane(terms, 9, index), lane(terms, 10, index), lane(terms, 11, index)
    Phi[17 * 3 + 1], Phi[17 * 3 + 2] = ez, -ey
    Phi[17 * 4], Phi[17 * 4 + 2] = -ez, ex
    Phi[17 * 5], Phi[17 * 5 + 1] = ey, -ex
    for i in range(3):
        for j in range(3):
            Phi[17 * i + 12 + j] = lane(terms, 3 * i + j, index)
            Phi[17 * (3 + i) + 9 + j] = lane(terms, 3 * i + j, index)
            Phi[17 * (3 + i) + 6 + j] = lane(terms, 12 + 3 * i + j, index)
        Phi[17 * (6 + i) + 3 + i] = tau
    Phi[17 * 15 + 16] = tau


@njit
def sample(a, w, group, epoch, measured, base):
    """Measure a group's inertial samples of one interval, and mechanize them. Rows 1 and 2 of
    `w.spans` say where in `run` each lane's interval begins, and how many samples it has; lanes
    with as many go together. Where `measured`, `run` has what the sensors gave."""
    first, counts, start = w.spans[1], w.spans[2], w.spans[3]
    lanes, size = counts.shape[0], a.rules[3]
    sensor_base, key_row = group * (world.CHANNELS + 2 * a.visible.shape[1]), group * world.KEYS
    keys = load(a.keys, key_row + world.IMU_KEY), load(a.keys, key_row + world.IMU_KEY + 1)
    constants, fixed = a.constants, constant_row(a, group)
    if a.in_run.shape[0] and not measured:
        own = w.product[: world.CONSTANT_ROWS]
        wandering = a.in_run, group * world.WANDERING_ROWS
        world.advance_biases(*wandering, constants, fixed, keys[0], keys[1], epoch, w.noise, own)
        constants, fixed = own, 0
    sensors = a.sensors, sensor_base, constants, fixed
    samples, work = w.rest[:size], w.rest[size:]
    dt, truth, active = work[: size // 6], work[size // 6 :], w.force[3:4]
    for leader in range(lanes):
        count, done = counts[leader], False
        for other in range(leader):
            done = done or counts[other] == count
        if done:
            continue
        for each in range(lanes):
            together = counts[each] == count
            set_lane(active, 0, each, 1.0 if together else 0.0)
            start[each] = first[each] if together else first[leader]
        if measured:
            world.replay_samples(a.run, start, count, samples, dt)
        else:
            deviates(keys[0], keys[1], epoch, size, 6 * count, samples)
            world.sense(a.run, start, count, *sensors, samples, dt, truth, active)
        mechanize(a.x, base, samples, dt, count, active, w.force)


# What a batch of receivers reads and writes at an epoch, as kernels pass it on:
# - `x`, `assumed`, `sensors`, `constants`, `keys`: lane arrays of `receiver_shapes`,
#   `assumed_shapes`, `sensor_shapes`, `CONSTANTS` and `SOURCES`; `assumed` and `constants` may be
#   of one group, for all of them;
# - `out`, `places`: `seen_floats` and `places` of `ReceiverBuffers`;
# - `visible`, `coasting`: (B, n) and (B,) bool; `epochs` (B,) that each receiver is at;
# - `range_offset`, `rate_offset`, `authentic`: of `SensorBuffers`;
# - `in_run`: lane array of `WANDERING`; empty where biases are constant;
# - `run` (8, N) true samples, their lengths and root rates, as `GroundTruth.run`, or measured ones;
# - `epoch_time`, `epoch_end`, `satellites`: of `World`;
# - `rules`: covariance update, fewest satellites, whether to re-orthonormalize, deviates of an
#   epoch for inertial sensors and for GNSS;
# - `signals`, `mappings`: lane array of `signal_shapes`, and (K, n, 4) `stack_obliquities` of the
#   lines of sight; both empty where no signal has such errors.
Arrays = namedtuple(
    "Arrays",
    "x assumed out places visible coasting sensors constants keys epochs range_offset rate_offset "
    "authentic in_run run epoch_time epoch_end satellites rules signals mappings",
)
# Scratch memory of a thread, in lane arrays; `spans` (4, lanes) int64.
Scratch = namedtuple(
    "Scratch", "terms product solution force tau epoch noise sky added precision rest spans"
)


def work_rows(channels: int, imu_size: int, gnss_size: int) -> int:
    """Rows of scratch memory of a thread; S and the samples share theirs."""
    n, fixed = channels, TERMS + PRODUCT_ROWS + kalman.WORK + 6
    return (
        fixed
        + gnss_size
        + (SKY + 6) * n
        + max(imu_size + imu_size // 6 + 8 * world.CHUNK, 4 * n * n)
    )


@njit
def name_scratch(a, work):
    return divide_scratch(a, work, np.empty((4, count_lanes(a.x)), np.int64))


@njit
def divide_scratch(a, work, spans):
    n = a.visible.shape[1]
    terms, work = work[:TERMS], work[TERMS:]
    product, work = work[:PRODUCT_ROWS], work[PRODUCT_ROWS:]
    solution, work = work[: kalman.WORK], work[kalman.WORK :]
    force, tau, epoch, work = work[:4], work[4:5], work[5:6], work[6:]
    noise, work = work[: a.rules[4]], work[a.rules[4] :]
    sky, work = work[: SKY * n], work[SKY * n :]
    added, precision, work = work[: 4 * n], work[4 * n : 6 * n], work[6 * n :]
    return Scratch(
        terms, product, solution, force, tau, epoch, noise, sky, added, precision, work, spans
    )


@inline_njit
def assumed_row(a, group):
    return group * (VARIANCE + 2 * a.visible.shape[1]) % a.assumed.shape[0]


@inline_njit
def constant_row(a, group):
    return group * world.CONSTANT_ROWS % a.constants.shape[0]


@njit
def predict_group(a, w, group, what):
    """First half of an epoch of one group: measure, mechanize, propagate, innovate. With `PREDICT`
    the group moves on to its next epoch, `MEASURE` alone measures where it is, and without
    `MEASURE` `run` and the receivers have what has been measured; with `SHOW` the epoch is written
    to where detectors look at it."""
    receivers, n = a.visible.shape
    lanes, x = count_lanes(a.x), a.x
    base, c = group * (CHANNELS + ALL * n), group * (CHANNELS + ALL * n) + CHANNELS
    sensor_base, key_row = group * (world.CHANNELS + 2 * n), group * world.KEYS
    b, some = group * lanes, min(lanes, receivers - group * lanes)
    moves = 1 if what & PREDICT else 0
    for each in range(lanes):  # lanes without a receiver follow the last one
        k = a.epochs[min(b + each, receivers - 1)] + moves
        w.spans[0, each] = k
        w.spans[1, each] = a.epoch_end[k - moves]
        w.spans[2, each] = a.epoch_end[k] - a.epoch_end[k - moves]
        set_lane(w.epoch, 0, each, float(k))
        set_lane(w.tau, 0, each, a.epoch_time[k] - a.epoch_time[k - moves])
    for each in range(some):
        a.epochs[b + each] = w.spans[0, each]
    world.gather_sky(a.satellites, w.spans[0], w.sky)
    tau, epoch = load(w.tau, 0), to_integer(load(w.epoch, 0))
    if what & MEASURE:
        for each in range(lanes):
            follows = min(b + each, receivers - 1)
            for s in range(n):
                set_lane(w.added, s, each, a.range_offset[follows, s])
                set_lane(w.added, n + s, each, a.rate_offset[follows, s])
            for s in range(2 * n):
                stays = a.authentic[follows, s] if a.authentic.shape[0] else 1.0
                set_lane(w.added, 2 * n + s, each, stays)
        picked_up = w.rest[: world.DISTURBED * n if a.signals.shape[0] else 0]
        if a.signals.shape[0]:
            disturb_group(a, w, group, sensor_base, key_row, epoch, tau, picked_up)
        sensors, drawn = (
            (a.sensors, sensor_base, a.constants, constant_row(a, group)),
            (a.keys, key_row),
        )
        world.measure(sensors, n, *drawn, epoch, tau, w.sky, w.noise, w.added, picked_up, x, c)
    if what & SHOW:
        write_measured(a, c + INNOVATION * n, b, some)
    if what & PREDICT:
        sample(a, w, group, epoch, what & MEASURE == 0, base)
        propagate(x, base, a.assumed, assumed_row(a, group), w.force, tau, w.terms, w.product)
        innovate(x, base, n, tau, w.sky)
    if what & SHOW:
        show(a, w, base, b, some)


@njit
def disturb_group(a, w, group, sensor_base, key_row, epoch, tau, picked_up):
    n, rest = a.visible.shape[1], w.rest[picked_up.shape[0] :]
    mapping, rest = rest[: MAPPINGS * n], rest[MAPPINGS * n :]
    world.gather_mappings(a.mappings, a.epoch_time, w.spans[0], mapping)
    key0 = load(a.keys, key_row + world.CORRELATED_KEY)
    key1 = load(a.keys, key_row + world.CORRELATED_KEY + 1)
    size = -(-count_deviates(n) // BLOCK) * BLOCK
    base, noise = group * (world.SIGNALS + world.SIGNAL_ROWS * n), rest[:size]
    number = load(w.epoch, 0)
    step = world.disturb(
        a.signals, base, n, key0, key1, number, epoch, tau, mapping, noise, w.sky, picked_up
    )
    store(a.sensors, sensor_base + world.CLOCK, load(a.sensors, sensor_base + world.CLOCK) + step)


@njit
def update_group(a, w, group, weights):
    receivers, n = a.visible.shape
    lanes, base = count_lanes(a.x), group * (CHANNELS + ALL * n)
    b, some = group * lanes, min(lanes, receivers - group * lanes)
    for each in range(lanes):
        for s in range(2 * n):
            set_lane(w.added, s, each, weights[min(b + each, receivers - 1), s])
    given = a.assumed, assumed_row(a, group), n, w.added, a.rules
    store(w.tau, 0, correct(a.x, base, *given, w.solution, w.precision))
    for each in range(some):
        a.coasting[b + each] = lane(w.tau, 0, each) < a.rules[1]
    show_position(a, base, b, some)


@njit
def arrays_at(table, work, channels):
    n, epochs, epoch_time = channels, integers_at(table, 9), floats_at(table, 15)
    receivers, run = epochs.shape[0], floats_at(table, 14)
    authentic, mappings = floats_at(table, 12), floats_at(table, 20)
    return Arrays(
        rows_at(table, 0, work),
        rows_at(table, 1, work),
        floats_at(table, 2),
        integers_at(table, 3),
        flags_at(table, 4).reshape((receivers, n)),
        flags_at(table, 5),
        rows_at(table, 6, work),
        rows_at(table, 7, work),
        words_at(table, 8, work),
        epochs,
        floats_at(table, 10).reshape((receivers, n)),
        floats_at(table, 11).reshape((receivers, n)),
        authentic.reshape((authentic.shape[0] // (2 * n), 2 * n)),
        rows_at(table, 13, work),
        run.reshape((8, run.shape[0] // 8)),
        epoch_time,
        integers_at(table, 16),
        floats_at(table, 17).reshape((epoch_time.shape[0], n, SKY)),
        integers_at(table, 18),
        rows_at(table, 19, work),
        mappings.reshape((mappings.shape[0] // (OBLIQUITIES * n), n, OBLIQUITIES)),
    )


@njit
def run_epoch(table, work, weights, what):
    """Run one half of an epoch, or both, of a single group, as a replay does (`arrays_at`)."""
    a = arrays_at(table, work, weights.shape[1] // 2)
    w = name_scratch(a, work)
    if what & PREDICT:
        predict_group(a, w, 0, what)
    if what & UPDATE:
        update_group(a, w, 0, weights)


@njit
def first_fix(measured, satellites, epochs, guess_e, position_e, velocity_e, clock):
    """Equally weighted least-squares fix of all visible satellites of an epoch.

    Three Gauss-Newton steps from a guess within a kilometre leave less than a micrometre.

    `measured` (B, 2, n) pseudoranges and range rates; `satellites` (K, n, 8) and `epochs` (B,) as
    in `run_epochs`; `guess_e` (B, 3) where to linearize first, ECEF [m]; `position_e`,
    `velocity_e` (B, 3), `clock` (B, 2): written [m], [m/s].
    """
    M, x = np.empty((4, 4)), np.empty(4)
    for b in range(len(epochs)):
        r, v, sky = position_e[b], velocity_e[b], satellites[epochs[b]]
        for i in range(3):
            r[i], v[i] = guess_e[b, i], 0.0
        clock[b, 0], clock[b, 1] = 0.0, 0.0
        for step in range(4):
            rates = step == 3
            M[:] = 0.0
            x[:] = 0.0
            for s in range(sky.shape[0]):
                p = sky[s]
                if p[6] == 0.0:
                    continue
                rho, rate, ux, uy, uz = range_and_rate(p[:3], p[3:6], r, v)
                z = measured[b, 0, s] - rho - clock[b, 0]
                if rates:
                    z = measured[b, 1, s] - rate
                h = (-ux, -uy, -uz, 1.0)
                for i in range(4):
                    x[i] += h[i] * z
                    for j in range(4):
                        M[i, j] += h[i] * h[j]
            solve_in_place(M, x)
            for i in range(3):
                if rates:
                    v[i] += x[i]
                else:
                    r[i] += x[i]
            clock[b, 1 if rates else 0] += x[3]


@njit
def solve_in_place(M, x):
    """Solve ``M y = x`` by elimination with partial pivoting; `x` becomes y, `M` is destroyed."""
    k = x.shape[0]
    for p in range(k):
        best = p
        for i in range(p + 1, k):
            if abs(M[i, p]) > abs(M[best, p]):
                best = i
        if best != p:
            for j in range(p, k):
                M[p, j], M[best, j] = M[best, j], M[p, j]
            x[p], x[best] = x[best], x[p]
        inverse = 1.0 / M[p, p]
        for i in range(p + 1, k):
            f = M[i, p] * inverse
            if f != 0.0:
                for j in range(p + 1, k):
                    M[i, j] -= f * M[p, j]
                x[i] -= f * x[p]
    for p in range(k - 1, -1, -1):
        total = x[p]
        for i in range(p + 1, k):
            total -= M[p, i] * x[i]
        x[p] = total * (1.0 / M[p, p])
