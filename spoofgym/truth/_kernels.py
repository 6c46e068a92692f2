"""Compiled loops of the authentic world; those of lane arrays take one group of receivers."""

import math

import numpy as np

from ..core.compile import inline_njit, njit
from ..core.lanes import first_rows
from ..core.simd import any_lane, floor, load, select, set_lane, splat, sqrt, store
from ..earth.wgs84 import EARTH_RATE, STILL, gravity, range_and_rate
from .clock import advance_clock
from .gnss_errors import gauss_markov_step
from .noise import BLOCK, deviates, exponential, normals
from .sensors import CONSTANTS, SOURCES, WANDERING, sensor_shapes
from .signal_errors import MAPPINGS, count_deviates, find_neighbours, signal_shapes

_ROWS = first_rows(sensor_shapes(1))
RESIDUAL, CLOCK = _ROWS["residual"], _ROWS["clock"]
_CONSTANTS = first_rows(CONSTANTS)
ACCEL_BIAS, ACCEL_MATRIX = _CONSTANTS["accel_bias"], _CONSTANTS["accel_matrix"]
GYRO_BIAS, GYRO_MATRIX = _CONSTANTS["gyro_bias"], _CONSTANTS["gyro_matrix"]
G_DEPENDENCE = _CONSTANTS["g_dependence"]
IMU_NOISE, CLOCK_PSD = _CONSTANTS["imu_noise"], _CONSTANTS["clock_psd"]
GNSS_NOISE, CORRELATED_NOISE = _CONSTANTS["gnss_noise"], _CONSTANTS["correlated_noise"]
CONSTANT_ROWS = CORRELATED_NOISE + 2
_WANDERING = first_rows(WANDERING)
BIAS, STEP = _WANDERING["bias"], _WANDERING["step"]
WANDERING_ROWS = STEP + 3
CHANNELS = _ROWS["satellite_bias"]  # first row of the biases; n rows later the correlated errors
IMU_KEY, CLOCK_KEY, GNSS_KEY, CORRELATED_KEY = (
    2 * SOURCES.index(source) for source in ("imu", "clock", "gnss", "correlated")
)
KEYS = 2 * len(SOURCES)
_SIGNALS = first_rows(signal_shapes(1))
PROCESSES, FADING, AMPLITUDES = _SIGNALS["processes"], _SIGNALS["fading"], _SIGNALS["amplitudes"]
CARRIER, CLOCK_STEP, LOSS = _SIGNALS["carrier"], _SIGNALS["clock_step"], _SIGNALS["loss"]
# First rows of what there is of every receiver's signals, and from `SIGNALS` on of each of them:
# arrivals of a front, errors of orbit and clock, their rates, multipath, noise, readings.
FRONT, ZENITH, SIGNALS = _SIGNALS["front"], _SIGNALS["zenith"], _SIGNALS["front_arrival"]
SIGNAL_ROWS = 6
DISTURBED = 4  # rows of each signal that `disturb` writes
# First counter of deviates of signals, under the key of the correlated errors, and of biases that
# wander, under that of the inertial sensors.
LATER = 1 << 40
CHUNK = 16  # samples whose truth is gathered at a time, so that it stays in the nearest cache
SKY = 8  # of a satellite: position, velocity, true range and range rate, 0 if invisible


@inline_njit
def load3(x, row):
    return load(x, row), load(x, row + 1), load(x, row + 2)


@inline_njit
def store3(x, row, values, step=1):
    store(x, row, values[0])
    store(x, row + step, values[1])
    store(x, row + 2 * step, values[2])


@inline_njit
def keep3(x, row, now, values):
    """Write three rows in the lanes of `now`."""
    a, b, c = load3(x, row)
    store3(
        x, row, (select(now, values[0], a), select(now, values[1], b), select(now, values[2], c))
    )


@njit
def fill_ranges(satellites, visible, position_e, velocity_e):
    """Write true range and range rate of all visible satellites into columns 6 and 7. `satellites`
    (K, n, 8) position, velocity, range, range rate; `visible` (K, n) bool; `position_e`,
    `velocity_e` (K, 3) antenna."""
    for k in range(satellites.shape[0]):
        r, v = position_e[k], velocity_e[k]
        for s in range(satellites.shape[1]):
            if visible[k, s]:
                p = satellites[k, s]
                rho, rate, _, _, _ = range_and_rate(p[:3], p[3:6], r, v)
                p[6] = rho
                p[7] = rate


@njit
def gather_sky(satellites, epochs, sky):
    """Put what is known of the satellites at each lane's epoch into rows ``8 s`` to ``8 s + 7``."""
    n = satellites.shape[1]
    for index in range(epochs.shape[0]):
        k = epochs[index]
        for s in range(n):
            for i in range(SKY):
                set_lane(sky, SKY * s + i, index, satellites[k, s, i])


@njit
def gather_truth(run, first, start, stop, truth):
    """Put the samples from `start` on, counted from each lane's `first`, into rows of eight."""
    lanes, same = first.shape[0], True
    for index in range(1, lanes):
        same = same and first[index] == first[0]
    for i in range(start, stop):
        for c in range(8):
            if same:
                store(truth, 8 * (i - start) + c, run[c, first[0] + i])
            else:
                for index in range(lanes):
                    set_lane(truth, 8 * (i - start) + c, index, run[c, first[index] + i])


@inline_njit
def _quantize(total, level, inverse):
    """The quantization level next to a running sum; itself where there is no quantization."""
    return select(level > 0.0, level * floor(total * inverse + 0.5), total)


@inline_njit
def _row(matrix, row, f):
    m = load(matrix, row) * f[0] + load(matrix, row + 1) * f[1]
    return m + load(matrix, row + 2) * f[2]


@njit
def sense(run, first, count, sensors, base, constants, fixed, samples, dt, truth, active):
    r"""Measure the samples of one interval, in place of the deviates that their noise is made of.

    .. math:: x_i &= b + \sqrt{S / \Delta t_i} \, n_i + M (f_i, w_i) \\
        m_i &= q \left(\left\lfloor \tfrac{c_i}{q} + \tfrac12 \right\rfloor
        - \left\lfloor \tfrac{c_{i-1}}{q} + \tfrac12 \right\rfloor\right), \qquad
        c_i = r + \sum_{j \le i} x_j

    what rounding to the quantization level q leaves over is carried on in r (`imu`).

    `run` (8, N) true samples, their lengths and root rates; `first` (lanes,) first sample of each
    lane's interval; `count`: samples of all of them; `sensors`, `base`: errors of the group, and
    its first row; `constants`, `fixed`: the same of what stays as it is; `samples`: lane array,
    rows c count + i for sensor c and sample i; `dt`: lane array, written: lengths [s]; `truth`:
    scratch memory of 8 `CHUNK` rows; `active`: one row, 1 or 0, which lanes keep what is carried
    on.
    """
    b, k = base, fixed
    level_a, level_g = load(constants, k + IMU_NOISE), load(constants, k + IMU_NOISE + 1)
    qa, qg = load(constants, k + IMU_NOISE + 2), load(constants, k + IMU_NOISE + 3)
    ia, ig = select(qa > 0.0, 1.0 / qa, 0.0), select(qg > 0.0, 1.0 / qg, 0.0)
    b += RESIDUAL
    c0, c1, c2 = load3(sensors, b)
    c3, c4, c5 = load3(sensors, b + 3)
    zero = splat(0.0, sensors)
    p0, p1, p2, p3, p4, p5 = zero, zero, zero, zero, zero, zero
    n = count
    for start in range(0, count, CHUNK):
        stop = min(start + CHUNK, count)
        gather_truth(run, first, start, stop, truth)
        for i in range(start, stop):
            t = 8 * (i - start)
            f, w = load3(truth, t), load3(truth, t + 3)
            store(dt, i, load(truth, t + 6))
            rate = load(truth, t + 7)
            a, g, d = k + ACCEL_BIAS, k + GYRO_BIAS, k + G_DEPENDENCE
            force, spin = k + ACCEL_MATRIX, k + GYRO_MATRIX
            x = load(constants, a) + level_a * load(samples, i) * rate
            c0 += x + _row(constants, force, f)
            x = load(constants, a + 1) + level_a * load(samples, n + i) * rate
            c1 += x + _row(constants, force + 3, f)
            x = load(constants, a + 2) + level_a * load(samples, 2 * n + i) * rate
            c2 += x + _row(constants, force + 6, f)
            x = load(constants, g) + level_g * load(samples, 3 * n + i) * rate
            c3 += x + _row(constants, d, f) + _row(constants, spin, w)
            x = load(constants, g + 1) + level_g * load(samples, 4 * n + i) * rate
            c4 += x + _row(constants, d + 3, f) + _row(constants, spin + 3, w)
            x = load(constants, g + 2) + level_g * load(samples, 5 * n + i) * rate
            c5 += x + _row(constants, d + 6, f) + _row(constants, spin + 6, w)
            m0, m1, m2 = _quantize(c0, qa, ia), _quantize(c1, qa, ia), _quantize(c2, qa, ia)
            m3, m4, m5 = _quantize(c3, qg, ig), _quantize(c4, qg, ig), _quantize(c5, qg, ig)
            store(samples, i, m0 - p0)
            store(samples, n + i, m1 - p1)
            store(samples, 2 * n + i, m2 - p2)
            store(samples, 3 * n + i, m3 - p3)
            store(samples, 4 * n + i, m4 - p4)
            store(samples, 5 * n + i, m5 - p5)
            p0, p1, p2, p3, p4, p5 = m0, m1, m2, m3, m4, m5
    now = load(active, 0) > 0.0
    keep3(sensors, b, now & (qa > 0.0), (c0 - p0, c1 - p1, c2 - p2))
    keep3(sensors, b + 3, now & (qg > 0.0), (c3 - p3, c4 - p4, c5 - p5))


@njit
def advance_biases(in_run, base, constants, fixed, key0, key1, epoch, noise, out):
    r"""Write a group's constants as they are up to an epoch, with what their biases have wandered
    by, and advance that: first-order Gauss-Markov.

    .. math:: b^+ = \alpha b + \sigma \sqrt{1 - \alpha^2}\, w, \qquad \alpha = e^{-\tau / T}

    `in_run`, `base`: of `WANDERING`, and its first row; `constants`, `fixed`: as in `sense`;
    `epoch`: of each lane, as a word; `noise`: scratch memory of `BLOCK` rows; `out`: lane array,
    written, what `sense` takes for `constants` then.
    """
    deviates(key0, key1, epoch + np.uint64(LATER), BLOCK, 6, noise)
    for row in range(CONSTANT_ROWS):
        store(out, row, load(constants, fixed + row))
    alpha = load(in_run, base + STEP)
    for i in range(6):
        row = ACCEL_BIAS + i if i < 3 else GYRO_BIAS + i - 3
        bias, driving = load(in_run, base + BIAS + i), load(in_run, base + STEP + 1 + i // 3)
        store(out, row, load(out, row) + bias)
        store(in_run, base + BIAS + i, alpha * bias + driving * load(noise, i))


@njit
def replay_samples(run, first, count, samples, dt):
    """Take the samples of one interval as `run` has them, measured; the others as in `sense`."""
    for index in range(first.shape[0]):
        for i in range(count):
            for c in range(6):
                set_lane(samples, c * count + i, index, run[c, first[index] + i])
            set_lane(dt, i, index, run[6, first[index] + i])


@njit
def advance_correlated(sensors, base, channels, sd, time, key0, key1, epoch, tau, noise):
    r"""Correlated code errors at the next epoch: first-order Gauss-Markov.

    .. math:: c^+ = \alpha c + \sigma \sqrt{1 - \alpha^2}\, w, \qquad \alpha = e^{-\tau / T}

    which is exact for any interval, and stationary since it begins with :math:`\sigma w`.

    `sd`, `time`: :math:`\sigma` [m] and T [s]; `tau`: time since the epoch before [s]; 0 for the
    first epoch; `noise`: scratch memory.
    """
    alpha = select(tau > 0.0, exponential(-tau / time), 0.0)
    driving = sd * sqrt(1.0 - alpha * alpha)
    deviates(key0, key1, epoch, noise.shape[0], channels, noise)
    for s in range(channels):
        row = base + CHANNELS + channels + s
        store(sensors, row, alpha * load(sensors, row) + driving * load(noise, s))


@inline_njit
def _advance_process(x, row, value, rate, moves, first, second):
    v, w = load(x, value), load(x, rate)
    new = load(x, row) * v + load(x, row + 1) * w + load(x, row + 4) * first
    speed = load(x, row + 2) * v + load(x, row + 3) * w
    speed = speed + load(x, row + 5) * first + load(x, row + 6) * second
    v, w = select(moves, new, v), select(moves, speed, w)
    store(x, value, v)
    store(x, rate, w)
    return v, w


@njit
def gather_mappings(table, time, epochs, out):
    """Put what `compute_mappings` has at each lane's epoch into rows ``6 s`` to ``6 s + 5``."""
    for index in range(epochs.shape[0]):
        k = epochs[index]
        before, after = find_neighbours(time, k)
        span = time[after] - time[before]
        for s in range(table.shape[1]):
            row = MAPPINGS * s
            for i in range(2):
                change = table[after, s, i] - table[before, s, i]
                set_lane(out, row + 2 * i, index, table[k, s, i])
                set_lane(out, row + 2 * i + 1, index, change / span)
                set_lane(out, row + 4 + i, index, table[k, s, 2 + i])


@njit
def disturb(signals, base, n, key0, key1, number, epoch, tau, mapping, noise, sky, out):
    """Advance what a group's signals pick up, and write it, `DISTURBED` rows of n each.

    Errors of the paths of codes [m] and of carriers [m/s], which a counterfeit signal does not
    have, then noise of the receiver in codes and range rates.  A satellite that is lost is taken
    out of the sky.

    `number`, `epoch`: of each lane, as a float and as a word; `mapping`: of `gather_mappings`;
    `noise`: scratch memory, the size of an epoch's deviates; returns the step of the clock [m].
    """
    b, moves, count = base, tau > 0.0, count_deviates(n)
    deviates(key0, key1, epoch + np.uint64(LATER), noise.shape[0], count, noise)
    ionosphere, ionosphere_rate = _advance_process(
        signals, b + PROCESSES, b + ZENITH, b + ZENITH + 1, moves, load(noise, 0), load(noise, 1)
    )
    row, of_zenith = b + PROCESSES + 7, b + ZENITH + 2
    troposphere, troposphere_rate = _advance_process(
        signals, row, of_zenith, of_zenith + 1, moves, load(noise, 2), load(noise, 3)
    )
    alpha, driving = load(signals, b + FADING), load(signals, b + FADING + 1)
    per_time, growth = load(signals, b + CARRIER + 1), load(signals, b + FRONT)
    highest = load(signals, b + FRONT + 1)
    lost = (number >= load(signals, b + LOSS + 1)) & (number < load(signals, b + LOSS + 2))
    each = b + SIGNALS
    for s in range(n):
        k, row = 4 + s, each + n + s
        orbit, orbit_rate = _advance_process(
            signals, b + PROCESSES + 14, row, row + n, moves, load(noise, k), load(noise, k + n)
        )
        row += 2 * n
        reflected = load(signals, row)
        fresh = alpha * reflected + driving * load(noise, k + 2 * n)
        reflected = select(moves, fresh, reflected)
        store(signals, row, reflected)
        thermal = load(signals, row + n)
        thermal = select(moves, alpha * thermal + driving * load(noise, k + 3 * n), thermal)
        store(signals, row + n, thermal)
        reading = load(signals, b + CARRIER) * load(noise, k + 4 * n)
        change = (reading - load(signals, row + 2 * n)) * per_time
        store(signals, row + 2 * n, reading)
        m = MAPPINGS * s
        slant, slant_rate = load(mapping, m), load(mapping, m + 1)
        thick, thick_rate = load(mapping, m + 2), load(mapping, m + 3)
        # behind a front the delay grows up to its largest value
        behind = (number - load(signals, each + s)) * growth
        inside = (behind > 0.0) & (behind < highest)
        front = select(behind > 0.0, select(behind < highest, behind, highest), 0.0)
        front_rate = select(inside, growth * per_time, 0.0)
        delay = slant * ionosphere + front
        delay_rate = slant * ionosphere_rate + slant_rate * ionosphere + front_rate
        others = thick * troposphere + orbit
        others_rate = thick * troposphere_rate + thick_rate * troposphere + orbit_rate
        a = b + AMPLITUDES
        size = load(signals, a) + load(signals, a + 1) * load(mapping, m + 4)
        store(out, s, delay + others + size * reflected)
        store(out, n + s, others_rate - delay_rate)
        size = load(signals, a + 2) + load(signals, a + 3) * load(mapping, m + 5)
        store(out, 2 * n + s, size * thermal)
        store(out, 3 * n + s, change)
        gone = lost & (load(signals, b + LOSS) == float(s))
        store(sky, SKY * s + 6, select(gone, 0.0, load(sky, SKY * s + 6)))
    return select(number == load(signals, b + CLOCK_STEP), load(signals, b + CLOCK_STEP + 1), 0.0)


@njit
def measure(
    of_sensors, channels, keys, key_row, epoch, tau, sky, noise, replaced, picked_up, out, first
):
    """Measure a group's pseudoranges and range rates at one epoch.

    `of_sensors`: `sensors`, `base`, `constants` and `fixed` of `sense`; `epoch`, `tau`: of each
    lane, and time since the epoch before [s]; 0 leaves the clock alone; `sky`: of `gather_sky`;
    `noise`: scratch memory for the deviates; `replaced`: lane array of 4 n rows, what an attack
    adds to pseudoranges and range rates, and what stays of their authentic errors
    (`SensorBuffers`); `picked_up`: lane array of what `disturb` wrote, or of no row; `out`: lane
    array; its 2 n rows from `first` on are written, 0 where invisible.
    """
    sensors, b, constants, fixed = of_sensors
    n, k = channels, key_row
    phase, frequency = load(constants, fixed + CLOCK_PSD), load(constants, fixed + CLOCK_PSD + 1)
    a, w = splat(0.0, sensors), splat(0.0, sensors)
    if any_lane((phase > 0.0) | (frequency > 0.0)):
        key0, key1 = load(keys, k + CLOCK_KEY), load(keys, k + CLOCK_KEY + 1)
        deviates(key0, key1, epoch, noise.shape[0], 2, noise)
        a, w = load(noise, 0), load(noise, 1)
    bias, drift = advance_clock(
        load(sensors, b + CLOCK), load(sensors, b + CLOCK + 1), tau, phase, frequency, a, w
    )
    store(sensors, b + CLOCK, bias)
    store(sensors, b + CLOCK + 1, drift)
    row = fixed + CORRELATED_NOISE
    sd, time = load(constants, row), load(constants, row + 1)
    if any_lane(sd > 0.0):
        key0, key1 = load(keys, k + CORRELATED_KEY), load(keys, k + CORRELATED_KEY + 1)
        advance_correlated(sensors, b, n, sd, time, key0, key1, epoch, tau, noise)
    key0, key1 = load(keys, k + GNSS_KEY), load(keys, k + GNSS_KEY + 1)
    deviates(key0, key1, epoch, noise.shape[0], 2 * n, noise)
    code_sd, rate_sd = load(constants, fixed + GNSS_NOISE), load(constants, fixed + GNSS_NOISE + 1)
    for s in range(n):
        true_range = load(sky, SKY * s + 6)
        visible = true_range > 0.0
        constant = load(sensors, b + CHANNELS + s)
        code_error = code_sd * load(noise, s)
        rate_error = rate_sd * load(noise, n + s)
        correlated = load(sensors, b + CHANNELS + n + s)
        path_rate = splat(0.0, sensors)
        if picked_up.shape[0] > 0:
            correlated += load(picked_up, s)
            path_rate = load(picked_up, n + s)
            code_error += load(picked_up, 2 * n + s)
            rate_error += load(picked_up, 3 * n + s)
        rho = (true_range + constant + bias) + code_error + load(replaced, s) + correlated
        rate = load(sky, SKY * s + 7) + drift + rate_error + load(replaced, n + s)
        rate += path_rate
        # a counterfeit signal may bring errors of its own
        stays, rate_stays = load(replaced, 2 * n + s), load(replaced, 3 * n + s)
        rho -= (1.0 - select(stays > 0.0, stays, 0.0)) * (constant + correlated)
        rho -= select(stays < 0.0, code_error, 0.0)
        rate -= (1.0 - select(rate_stays > 0.0, rate_stays, 0.0)) * path_rate
        rate -= select(rate_stays < 0.0, rate_error, 0.0)
        store(out, first + s, select(visible, rho, 0.0))
        store(out, first + n + s, select(visible, rate, 0.0))


OF_SAMPLES, OF_POSITION, OF_START = range(3)  # keys of a loosely coupled receiver's sources


@njit
def first_errors(keys, initial_sd, position_sd, deviates, initial, error):
    """Draw what episodes of loosely coupled receivers start with. `keys` (B, 3, 2) of every source;
    `initial_sd`, `position_sd` (15,) and (3,), of the state and of the GNSS position; `deviates`
    (64,) scratch memory; `initial` (B, 15), written: errors of the first estimate, then sensor
    biases; `error` (B, 3), written: GNSS position errors, east, north, up [m]."""
    for b in range(keys.shape[0]):
        normals(keys[b, OF_START, 0], keys[b, OF_START, 1], 0, deviates)
        for i in range(15):
            initial[b, i] = initial_sd[i] * deviates[i]
        for i in range(3):
            error[b, i] = position_sd[i] * deviates[15 + i]


@njit
def measure_loose(
    keys,
    epoch,
    run,
    position_e,
    C_el,
    interval,
    noise,
    bias,
    decay,
    position_sd,
    displacement,
    deviates,
    error,
    samples,
    fix_e,
):
    """Move every loosely coupled receiver to its next epoch, and measure on the way.

    `keys` (B, 3, 2) key of every source; `epoch` (B,) that each receiver is at; advanced; `noise`
    (2,) root PSD of accelerometers and gyros; `bias` (B, 6) of gyros [rad/s] and accelerometers
    [m/s^2]; `position_sd` (3,) of the position errors [m]; `displacement` (B, 3) what the attack
    adds to the position, east, north, up [m]; `deviates` (P,) scratch memory, P a multiple of 64
    and at least 6 times the samples of an epoch; `error` (B, 3) errors of the GNSS position [m];
    advanced; `samples` (B, S, 6), written: measured specific force and angular rate, body axes;
    `fix_e` (B, 3), written: GNSS position, ECEF [m].
    """
    count = samples.shape[1]
    root = 1.0 / math.sqrt(interval)
    for b in range(keys.shape[0]):
        k = epoch[b] + 1
        epoch[b] = k
        normals(keys[b, OF_SAMPLES, 0], keys[b, OF_SAMPLES, 1], k, deviates)
        first = (k - 1) * count
        for c in range(6):
            level = noise[c // 3] * root
            constant = bias[b, 3 + c if c < 3 else c - 3]
            for i in range(count):
                noisy = level * deviates[c * count + i]
                samples[b, i, c] = run[first + i, c] + (constant + noisy)
        few = deviates[:64]
        normals(keys[b, OF_POSITION, 0], keys[b, OF_POSITION, 1], k, few)
        for c in range(3):
            error[b, c] = gauss_markov_step(error[b, c], decay, position_sd[c], few[c])
        e0 = error[b, 0] + displacement[b, 0]
        e1 = error[b, 1] + displacement[b, 1]
        e2 = error[b, 2] + displacement[b, 2]
        C = C_el[k]
        for i in range(3):
            fix_e[b, i] = position_e[k, i] + (C[i, 0] * e0 + C[i, 1] * e1 + C[i, 2] * e2)


@njit
def measure_snapshot(
    epoch,
    keys,
    clock,
    displacement,
    spoofed,
    time,
    position_e,
    C_en,
    satellite_position_e,
    noise_m,
    deviates,
    pseudorange,
    satellites,
):
    r"""Pseudoranges of one epoch, authentic or counterfeit.

    .. math:: \tilde\rho_j = |C r_j - r - C_{en} d_j| + c_0 + c_1 t + d_{4j} + w_j

    with the counterfeit displacement d and clock offset d_4, 0 for authentic satellites.  A
    satellite has the same white noise w whether it is spoofed or not.

    `epoch` (B,) number of the epoch; `keys` (B, 2) key of the noise; `clock` (B, 2) offset and
    drift of the receiver's clock [m], [m/s]; `displacement` (B, 4) north, east, down and clock [m];
    `spoofed` (B, n) bool; `deviates` (N,) scratch, N a multiple of `noise.BLOCK` and at least n;
    `pseudorange` (B, n), written [m]; `satellites` (B, n, 3), written: where the satellites are,
    ECEF [m].
    """
    r = np.empty(3)
    for b in range(epoch.shape[0]):
        k = epoch[b]
        normals(keys[b, 0], keys[b, 1], k, deviates)
        bias = clock[b, 0] + clock[b, 1] * time[k]
        for j in range(spoofed.shape[1]):
            own = bias
            for i in range(3):
                r[i] = position_e[k, i]
                satellites[b, j, i] = satellite_position_e[k, j, i]
            if spoofed[b, j]:
                own += displacement[b, 3]
                for i in range(3):
                    for c in range(3):
                        r[i] += C_en[i, c] * displacement[b, c]
            place = satellites[b, j, 0], satellites[b, j, 1], satellites[b, j, 2]
            distance, _, _, _, _ = range_and_rate(place, STILL, (r[0], r[1], r[2]), STILL)
            pseudorange[b, j] = distance + own + noise_m * deviates[j]


@njit
def measure_odometry(
    keys, epoch, first, left, right, yaw, samples, count_m, iron, yaw_sd, phase, noise, last, moved
):
    """Dead reckoning since the last epoch.

    `keys` (B, 2, 2) of each of `SOURCES`; `epoch`, `first` (B,) the epoch that is measured, and
    that at which the episode starts; `left`, `right`, `yaw` (N+1,) way of the wheels [m] and true
    heading [rad] at every sample; `phase` (B, 2) phases of the encoders; `noise` (`BLOCK`,), work
    space; `last` (B,) measured heading of the last sample [rad], overwritten; `moved` (B, 2) north
    and east [m], written; 0 at the start.
    """
    for b in range(epoch.shape[0]):
        k = epoch[b]
        normals(keys[b, 0, 0], keys[b, 0, 1], k, noise)
        north, east = 0.0, 0.0
        before = last[b]
        if k == first[b]:
            now = yaw[k * samples]
            before = now - iron * math.sin(now) + yaw_sd * noise[0]
        else:
            for s in range(samples):
                i = (k - 1) * samples + s
                now = yaw[i + 1] - iron * math.sin(yaw[i + 1]) + yaw_sd * noise[s]
                counts = math.floor(left[i + 1] / count_m + phase[b, 0])
                counts -= math.floor(left[i] / count_m + phase[b, 0])
                counts += math.floor(right[i + 1] / count_m + phase[b, 1])
                counts -= math.floor(right[i] / count_m + phase[b, 1])
                way, mid = 0.5 * count_m * counts, 0.5 * (before + now)
                north += way * math.cos(mid)
                east += way * math.sin(mid)
                before = now
        last[b] = before
        moved[b, 0], moved[b, 1] = north, east


@njit
def measure_fix(
    keys, epoch, first, position_ne, available, sd, decay, white_sd, offset, noise, correlated, fix
):
    r"""GNSS positions.

    .. math:: g_k = p_k + c_k + w_k + d_k, \qquad
        c_k = \beta c_{k-1} + \sqrt{1 - \beta^2} \, \sigma_c \, \epsilon_k

    `keys` (B, 2, 2) of each of `SOURCES`; `epoch`, `first` (B,) the epoch that is measured, and
    that at which the episode starts; `position_ne` (K, 2) true position at every epoch [m];
    `available` (L,) whether there is a fix at all, from the start on; `sd` of the correlated error
    [m]; `offset` (B, 2) what the spoofer adds [m]; `noise` (`BLOCK`,), work space; `correlated` (B,
    2) Gauss-Markov error [m], overwritten; `fix` (B, 2) north and east [m], written; NaN
    without a fix.
    """
    drive = math.sqrt(1.0 - decay * decay)
    for b in range(epoch.shape[0]):
        k = epoch[b]
        normals(keys[b, 1, 0], keys[b, 1, 1], k, noise)
        for axis in range(2):
            if k == first[b]:
                correlated[b, axis] = sd * noise[axis]
            else:
                fresh = drive * sd * noise[axis]
                correlated[b, axis] = decay * correlated[b, axis] + fresh
            error = correlated[b, axis] + white_sd * noise[2 + axis]
            fix[b, axis] = position_ne[k, axis] + error + offset[b, axis]
            if not available[k - first[b]]:
                fix[b, axis] = math.nan


SMALL_ANGLE = 1e-8  # rotation of a sample [rad] up to which the mechanization takes I + A and I
SERIES_ANGLE = 0.1  # rotation [rad] up to which (1 - sin(a) / a) / a^2 is taken from its series


@njit
def velocity_coefficients(angle):
    r"""Coefficients of the specific-force transformation.

    .. math::
        c = \frac{1 - \cos a}{a^2}, \qquad d = \frac{1 - \sin a / a}{a^2}

    `angle`: a [rad].

    c cancels on purpose: at 1e-6 rad it is off by up to 1e-4 of itself, just as in the forward
    step of the reference software, and only the same error leads back to the flight (0.3 instead
    of 3 micrometres over 418 s).  d cancels harmlessly, but has a series.
    """
    if angle <= SMALL_ANGLE:
        return 0.0, 0.0
    x = angle * angle
    c = (1.0 - math.cos(angle)) / x
    if angle <= SERIES_ANGLE:
        return c, (1.0 - x / 20.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0))) / 6.0
    return c, (1.0 - math.sin(angle) / angle) / x


@njit
def invert_samples(step, position_e, velocity_e, C_eb, specific_force_b, angular_rate_b):
    r"""Fill the inertial samples between consecutive states.

    With a = omega_ie dt, the rotation of the body over a sample is
    :math:`M = C^{-\prime} R_z(a)' C^+ = I + \sin|\alpha| / |\alpha|\,A + ...`, whose antisymmetric
    part holds :math:`\alpha \sin|\alpha| / |\alpha|` without cancellation.

    `step`: interval of the samples [s]; `position_e`, `velocity_e` (N+1, 3) ECEF [m] and [m/s];
    `C_eb` (N+1, 3, 3), to ECEF from body axes; `specific_force_b`, `angular_rate_b` (N, 3) outputs,
    body axes [m/s^2] and [rad/s]; returns largest rotation of a sample [rad].
    """
    a = EARTH_RATE * step
    sin_a, cos_a = math.sin(a), math.cos(a)
    largest = 0.0
    for i in range(position_e.shape[0] - 1):
        c00, c01, c02 = C_eb[i, 0, 0], C_eb[i, 0, 1], C_eb[i, 0, 2]
        c10, c11, c12 = C_eb[i, 1, 0], C_eb[i, 1, 1], C_eb[i, 1, 2]
        c20, c21, c22 = C_eb[i, 2, 0], C_eb[i, 2, 1], C_eb[i, 2, 2]

        # new attitude with the turn of the Earth taken back: R_z(a)' C+
        n00 = cos_a * C_eb[i + 1, 0, 0] - sin_a * C_eb[i + 1, 1, 0]
        n01 = cos_a * C_eb[i + 1, 0, 1] - sin_a * C_eb[i + 1, 1, 1]
        n02 = cos_a * C_eb[i + 1, 0, 2] - sin_a * C_eb[i + 1, 1, 2]
        n10 = sin_a * C_eb[i + 1, 0, 0] + cos_a * C_eb[i + 1, 1, 0]
        n11 = sin_a * C_eb[i + 1, 0, 1] + cos_a * C_eb[i + 1, 1, 1]
        n12 = sin_a * C_eb[i + 1, 0, 2] + cos_a * C_eb[i + 1, 1, 2]
        n20, n21, n22 = C_eb[i + 1, 2, 0], C_eb[i + 1, 2, 1], C_eb[i + 1, 2, 2]

        # M = C-' N: twice its antisymmetric part, and its trace
        px = c02 * n01 + c12 * n11 + c22 * n21 - (c01 * n02 + c11 * n12 + c21 * n22)
        py = c00 * n02 + c10 * n12 + c20 * n22 - (c02 * n00 + c12 * n10 + c22 * n20)
        pz = c01 * n00 + c11 * n10 + c21 * n20 - (c00 * n01 + c10 * n11 + c20 * n21)
        trace = c00 * n00 + c10 * n10 + c20 * n20 + c01 * n01 + c11 * n11 + c21 * n21
        trace += c02 * n02 + c12 * n12 + c22 * n22
        sine = 0.5 * math.sqrt(px * px + py * py + pz * pz)
        angle = math.atan2(sine, 0.5 * (trace - 1.0))
        scale = 0.5 if sine <= SMALL_ANGLE else 0.5 * angle / sine
        ax, ay, az = scale * px, scale * py, scale * pz
        largest = max(largest, angle)

        # specific force in ECEF axes that brings about the change of velocity
        rx, ry, rz = position_e[i, 0], position_e[i, 1], position_e[i, 2]
        vx, vy, vz = velocity_e[i, 0], velocity_e[i, 1], velocity_e[i, 2]
        gx, gy, gz = gravity(rx, ry, rz)
        ex = (velocity_e[i + 1, 0] - vx) / step - gx - 2.0 * EARTH_RATE * vy
        ey = (velocity_e[i + 1, 1] - vy) / step - gy + 2.0 * EARTH_RATE * vx
        ez = (velocity_e[i + 1, 2] - vz) / step - gz

        # average attitude T = C- (I + c A + d A^2) - [(0, 0, a / 2) x] C-
        c, d = velocity_coefficients(math.sqrt(ax * ax + ay * ay + az * az))
        xx, yy, zz, xy, xz, yz = ax * ax, ay * ay, az * az, ax * ay, ax * az, ay * az
        g00, g01, g02 = 1.0 - d * (yy + zz), d * xy - c * az, d * xz + c * ay
        g10, g11, g12 = d * xy + c * az, 1.0 - d * (xx + zz), d * yz - c * ax
        g20, g21, g22 = d * xz - c * ay, d * yz + c * ax, 1.0 - d * (xx + yy)
        half = 0.5 * a
        t00 = c00 * g00 + c01 * g10 + c02 * g20 + half * c10
        t01 = c00 * g01 + c01 * g11 + c02 * g21 + half * c11
        t02 = c00 * g02 + c01 * g12 + c02 * g22 + half * c12
        t10 = c10 * g00 + c11 * g10 + c12 * g20 - half * c00
        t11 = c10 * g01 + c11 * g11 + c12 * g21 - half * c01
        t12 = c10 * g02 + c11 * g12 + c12 * g22 - half * c02
        t20 = c20 * g00 + c21 * g10 + c22 * g20
        t21 = c20 * g01 + c21 * g11 + c22 * g21
        t22 = c20 * g02 + c21 * g12 + c22 * g22

        # T f = e by Cramer's rule; T is a rotation but for 1 + O(angle^2)
        k00, k01, k02 = t11 * t22 - t12 * t21, t02 * t21 - t01 * t22, t01 * t12 - t02 * t11
        k10, k11, k12 = t12 * t20 - t10 * t22, t00 * t22 - t02 * t20, t02 * t10 - t00 * t12
        k20, k21, k22 = t10 * t21 - t11 * t20, t01 * t20 - t00 * t21, t00 * t11 - t01 * t10
        determinant = t00 * k00 + t01 * k10 + t02 * k20
        specific_force_b[i, 0] = (k00 * ex + k01 * ey + k02 * ez) / determinant
        specific_force_b[i, 1] = (k10 * ex + k11 * ey + k12 * ez) / determinant
        specific_force_b[i, 2] = (k20 * ex + k21 * ey + k22 * ez) / determinant
        rate = angular_rate_b[i]
        rate[0], rate[1], rate[2] = ax / step, ay / step, az / step
    return largest
