"""Compiled loops of attacks and of a spoofer's equipment, over receivers lo to hi.

What they share: `commanded` as in `Commanded`; `epochs` (B,) that each receiver is at, the next one
being measured; `truth`: `GroundTruth.epoch_truth`; `captured` (n,) bool, which channels are the
spoofer's; `d_range`, `d_rate` (B, n), written: offsets [m], [m/s].

The noise of epoch k belongs to the counters 2 k and 2 k + 1 of the attack's key: the first for what
moves, the second for what is drawn again.  An attack measures only epochs after its onset, so that
the first counter of the onset is free for what an episode starts with.
"""

import math
from collections import namedtuple

import numpy as np

from ..core.compile import inline_njit, njit
from ..core.simd import LANES, count_lanes, lane, set_lane, store
from ..earth.wgs84 import range_and_rate
from ..truth._kernels import load3
from ..truth.clock import advance_clock
from ..truth.noise import exponential, normals

# An action (B, a) in [-1, 1], whether the rate is held instead, `Attack.kernel_settings`, and what
# is commanded so far, (B, a), overwritten [m], [m/s].
Commanded = namedtuple("Commanded", "action hold settings displacement rate")


@njit
def kinematic_step(action, hold, tau, vector, by_rate, unit_scale, rate_limit, displacement, rate):
    """Move the commanded offsets of one receiver to the end of an interval, in place. `action` (a,)
    in [-1, 1]; `tau`: length of the interval [s]; `displacement`, `rate` (a,), overwritten [m],
    [m/s]."""
    axes = displacement.shape[0]
    if hold:
        for i in range(axes):
            displacement[i] += tau * rate[i]
        return
    given = shrink(action, 0.0, action, 1.0) if vector else 1.0
    size = 1.0
    if vector and not by_rate:
        size = shrink(rate, given * unit_scale * tau, action, rate_limit)
    for i in range(axes):
        u = min(max(given * action[i], -1.0), 1.0)
        old = rate[i]
        if by_rate:
            new = unit_scale * u
            old = new
        else:
            new = old + unit_scale * u * tau
            new = size * new if vector else min(max(new, -rate_limit), rate_limit)
        displacement[i] += 0.5 * (old + new) * tau
        rate[i] = new


@inline_njit
def move(commanded, b, tau, vector):
    s, moved = commanded.settings, (commanded.displacement[b], commanded.rate[b])
    kinematic_step(commanded.action[b], commanded.hold, tau, vector, s[0] > 0.0, s[1], s[2], *moved)


@njit
def shrink(first, factor, second, limit):
    """Factor that shortens ``first + factor * second`` to a limit of its length."""
    total = 0.0
    for i in range(first.shape[0]):
        value = first[i] + factor * second[i]
        total += value * value
    length = math.sqrt(total)
    return limit / length if length > limit else 1.0


@njit
def add_displacement(shift, truth, k, captured, coherent, d_range, d_rate, work):
    """Add the offsets that make captured ranges those of an antenna displaced at epoch k.

    The true ranges come from the same operations; without displacement and rate the offset is
    exactly zero.  As many satellites are computed side by side as `work` has lanes.

    `shift` (6,) displacement and its rate, ECEF [m], [m/s]; `d_range`, `d_rate` (n,), added to;
    `work`: lane array of 8 rows, scratch memory.
    """
    still = True
    for i in range(6):
        still = still and shift[i] == 0.0
    if still:
        return
    satellites, p, v = truth.satellites[k], truth.position_e[k], truth.velocity_e[k]
    position = p[0] + shift[0], p[1] + shift[1], p[2] + shift[2]
    velocity = v[0] + shift[3], v[1] + shift[4], v[2] + shift[5]
    n, together = captured.shape[0], count_lanes(work)
    for first in range(0, n, together):
        for each in range(together):
            for i in range(6):
                set_lane(work, i, each, satellites[min(first + each, n - 1), i])
        rho, change, _, _, _ = range_and_rate(load3(work, 0), load3(work, 3), position, velocity)
        store(work, 6, rho)
        store(work, 7, change)
        for s in range(first, min(first + together, n)):
            if captured[s] and satellites[s, 6] != 0.0:
                d_range[s] += lane(work, 6, s - first) - satellites[s, 6]
                if coherent:
                    d_rate[s] += lane(work, 7, s - first) - satellites[s, 7]


@njit
def false_position(
    commanded, axes_e, target_error, epochs, truth, captured, d_range, d_rate, lo, hi
):
    """Command a displaced antenna, and write the offsets that make captured ranges its ranges.
    `axes_e` (K, a, 6) commanded axes at every epoch in ECEF axes, and their rates of change [1/s];
    `target_error` (B, 6) what the spoofer's idea of the true antenna is wrong by, ECEF [m], [m/s].
    """
    shift, work = np.empty(6), np.empty((8, LANES))
    for b in range(lo, hi):
        given = commanded, axes_e, target_error, epochs, truth, captured, d_range, d_rate
        displace_antenna(*given, b, shift, work)


@njit
def displace_antenna(
    commanded, axes_e, target_error, epochs, truth, captured, d_range, d_rate, b, shift, work
):
    """`false_position` of receiver b. `shift` (6,) and `work`: scratch memory, as in
    `add_displacement`."""
    k = epochs[b] + 1
    move(commanded, b, truth.epoch_time[k] - truth.epoch_time[k - 1], True)
    moved, rate = commanded.displacement[b], commanded.rate[b]
    for i in range(3):
        shift[i], shift[3 + i] = target_error[b, i], target_error[b, 3 + i]
        for axis in range(moved.shape[0]):
            shift[i] += moved[axis] * axes_e[k, axis, i]
            shift[3 + i] += rate[axis] * axes_e[k, axis, i]
            shift[3 + i] += moved[axis] * axes_e[k, axis, 3 + i]
    d_range[b], d_rate[b] = 0.0, 0.0
    coherent = commanded.settings[3] > 0.0
    add_displacement(shift, truth, k, captured, coherent, d_range[b], d_rate[b], work)


@njit
def per_channel(commanded, slots, epochs, truth, captured, d_range, d_rate, lo, hi):
    """Command the offset of every captured channel for itself; `slots` (a,) slot of each."""
    for b in range(lo, hi):
        k = epochs[b] + 1
        move(commanded, b, truth.epoch_time[k] - truth.epoch_time[k - 1], False)
        d_range[b], d_rate[b] = 0.0, 0.0
        for i in range(slots.shape[0]):
            d_range[b, slots[i]] = commanded.displacement[b, i]
            if commanded.settings[3] > 0.0:
                d_rate[b, slots[i]] = commanded.rate[b, i]


@njit
def displaced_ranges(shift, coherent, epochs, truth, captured, d_range, d_rate, lo, hi):
    """Add to all receivers' offsets those of antennas that are displaced from the true ones.
    `shift` (B, 6) displacement and its rate, ECEF [m], [m/s]; the offsets are added to."""
    work = np.empty((8, LANES))
    for b in range(lo, hi):
        k = epochs[b] + 1
        add_displacement(shift[b], truth, k, captured, coherent, d_range[b], d_rate[b], work)


@njit
def one_sided_step(commanded, b, tau):
    r"""Move the one commanded offset of receiver b that cannot fall below zero to the end of an
    interval, in place.

    As `kinematic_step`, but the rate stays above :math:`-w`, with which the offset can still come
    to rest at zero within the limit of acceleration a,

    .. math:: w = \sqrt{a^2 \tau^2 + 2 a \max(D + v \tau / 2, 0)} - a \tau

    or, where rates are commanded, :math:`w = D / \tau`.
    """
    hold, settings = commanded.hold, commanded.settings
    unit_scale, rate_limit = settings[1], settings[2]
    offset, old = commanded.displacement[b, 0], commanded.rate[b, 0]
    u = min(max(commanded.action[b, 0], -1.0), 1.0)
    if settings[0] > 0.0:
        new = old if hold else unit_scale * u
        new = max(new, -offset / tau)
        old = new
    else:
        step = unit_scale * tau
        new = old if hold else min(max(old + step * u, -rate_limit), rate_limit)
        ahead = max(offset + 0.5 * old * tau, 0.0)
        new = max(new, step - math.sqrt(step * step + 2.0 * unit_scale * ahead))
    commanded.displacement[b, 0] = max(offset + 0.5 * (old + new) * tau, 0.0)
    commanded.rate[b, 0] = new


@njit
def meaconer(commanded, antenna, follows, onsets, epochs, truth, captured, d_range, d_rate, lo, hi):
    """Command the delay of a replay, and write the offsets of the meaconer's antenna and its delay.
    `antenna` (2, B, 3): from the target's to the meaconer's antenna, ECEF [m], and its rate [m/s],
    where it follows; where it was at the onset, and 0, where not; `onsets` (B,) epochs of the
    onset.
    """
    shift, work = np.zeros(6), np.empty((8, LANES))
    for b in range(lo, hi):
        k = epochs[b] + 1
        one_sided_step(commanded, b, truth.epoch_time[k] - truth.epoch_time[k - 1])
        square, closing = 0.0, 0.0
        for i in range(3):
            shift[i], shift[3 + i] = antenna[0][b, i], antenna[1][b, i]
            if not follows:
                shift[i] += truth.position_e[onsets[b], i] - truth.position_e[k, i]
                shift[3 + i] = -truth.velocity_e[k, i]
            square += shift[i] * shift[i]
            closing += shift[i] * shift[3 + i]
        way = math.sqrt(square)
        delay = commanded.displacement[b, 0] + way
        change = commanded.rate[b, 0] + (closing / way if way > 0.0 else 0.0)
        coherent = commanded.settings[3] > 0.0
        for s in range(captured.shape[0]):
            d_range[b, s] = delay if captured[s] else 0.0
            d_rate[b, s] = change if captured[s] and coherent else 0.0
        add_displacement(shift, truth, k, captured, coherent, d_range[b], d_rate[b], work)


MOVING = 64  # deviates of an epoch for what moves: three axes of two, and two of the clock


@njit
def first_deviates(keys, onsets, size, drawn):
    """Deviates of the start of some episodes. `keys` (b, 2) of the attack's noise; `onsets` (b,)
    epochs; `drawn` (b, d), written, d at most `size`."""
    noise = np.empty(size)
    for b in range(keys.shape[0]):
        normals(keys[b, 0], keys[b, 1], 2 * onsets[b], noise)
        for i in range(drawn.shape[1]):
            drawn[b, i] = noise[i]


@njit
def wander_step(state, sd, beta, tau, first, second):
    r"""Critically damped second-order Gauss-Markov process over one interval, exactly.

    .. math:: \Phi = e^{-x} \begin{pmatrix} 1 + x & \tau\\
        -\beta^2 \tau & 1 - x \end{pmatrix}, \qquad
        Q = P - \Phi P \Phi^T, \qquad P = \sigma^2\, \mathrm{diag}(1, \beta^2)

    with :math:`x = \beta \tau`; Q enters by its Cholesky factor.

    `state` (2,) value and rate, overwritten; `tau`: interval [s].
    """
    x = beta * tau
    a = exponential(-x)
    a2 = a * a
    q11 = sd * sd * (1.0 - a2 * ((1.0 + x) * (1.0 + x) + x * x))
    q12 = 2.0 * sd * sd * beta * a2 * x * x
    q22 = sd * sd * beta * beta * (1.0 - a2 * (x * x + (1.0 - x) * (1.0 - x)))
    l11 = math.sqrt(max(q11, 0.0))
    l21 = q12 / l11 if l11 > 0.0 else 0.0
    l22 = math.sqrt(max(q22 - l21 * l21, 0.0))
    value, rate = state[0], state[1]
    state[0] = a * ((1.0 + x) * value + tau * rate) + l11 * first
    state[1] = a * ((1.0 - x) * rate - beta * x * value) + l21 * first + l22 * second


@njit
def compute_delay_error(k, delay, epoch_time, position_e, velocity_e, out):
    """Position and velocity some time ago, less those of an epoch. Between epochs the position is
    the cubic that fits position and velocity at both ends; before the first epoch of the run it
    moves straight on. `delay`: how long ago [s]; `out` (6,), written."""
    time = epoch_time[k] - delay
    j = k
    while epoch_time[j] > time and j > 0 and epoch_time[j - 1] < epoch_time[j]:
        j -= 1
    since = time - epoch_time[j]
    for i in range(3):
        r0, v0 = position_e[j, i], velocity_e[j, i]
        if since <= 0.0 or j == k:
            value, rate = r0 + since * v0, v0
        else:
            h = epoch_time[j + 1] - epoch_time[j]
            s = since / h
            gap = (position_e[j + 1, i] - r0) / h
            v1 = velocity_e[j + 1, i]
            c2, c3 = 3.0 * gap - 2.0 * v0 - v1, v0 + v1 - 2.0 * gap
            value = r0 + since * (v0 + s * (c2 + s * c3))
            rate = v0 + s * (2.0 * c2 + 3.0 * s * c3)
        out[i] = value - position_e[k, i]
        out[3 + i] = rate - velocity_e[k, i]


@njit
def advance_spoofer_errors(
    keys, epochs, truth, tracking, psd, bias, axes, wander, clock, target_error, lo, hi
):
    """Error of the known position and clock of every spoofer at the coming epoch.

    `keys` (B, 2) of the attack's noise; `tracking`: sd [m], beta [1/s] and delay [s] of the error;
    `psd`: of the clock's phase and frequency; `bias` (3,) constant error in the local axes [m],
    which are `axes`, (K, 3, 3) `C_en` and its rate of change; `wander` (B, 3, 2) wandering error
    and its rate, ECEF; advanced; `clock` (B, 2) offset [m] and drift [m/s]; advanced;
    `target_error` (B, 6), written: position [m] and velocity [m/s], ECEF.
    """
    (sd, beta, delay), (C_en, axes_turning) = tracking, axes
    noise = np.empty(MOVING)
    for b in range(lo, hi):
        k = epochs[b] + 1
        tau = truth.epoch_time[k] - truth.epoch_time[k - 1]
        normals(keys[b, 0], keys[b, 1], 2 * k, noise)
        error = target_error[b]
        if delay > 0.0:
            compute_delay_error(
                k, delay, truth.epoch_time, truth.position_e, truth.velocity_e, error
            )
        else:
            error[:] = 0.0
        for i in range(3):
            wander_step(wander[b, i], sd, beta, tau, noise[2 * i], noise[2 * i + 1])
            constant, turning = 0.0, 0.0
            for j in range(3):
                constant += C_en[k, i, j] * bias[j]
                turning += axes_turning[k, i, j] * bias[j]
            error[i] += constant + wander[b, i, 0]
            error[3 + i] += turning + wander[b, i, 1]
        driven = tau, psd[0], psd[1], noise[6], noise[7]
        clock[b, 0], clock[b, 1] = advance_clock(clock[b, 0], clock[b, 1], *driven)


@njit
def transmit(keys, onsets, epochs, truth, chosen, rules, errors, memory, d_range, d_rate, lo, hi):
    """Make of perfect offsets what the receivers get: captured or not, with clock and errors.

    `keys` (B, 2) of the attack's noise; `onsets` (B,) epochs; `chosen` (n,) bool, channels that are
    counterfeited; `rules`: whether rates are coherent and errors replaced, deviates of an epoch,
    delay [s] and alignment [m] of the capture; `errors`: (2,) of noise of pseudoranges and range
    rates, below 0 for the receiver's own, and time in which the authentic errors fade [s];
    `memory`: `clock` (B, 2) of the spoofer; `bias` (B, n) its constants [m]; `captured`,
    `capture_time` (B, n) which channels follow the counterfeit signal, and since when [s];
    advanced; `authentic` (B, 2n), written: part of the authentic errors that stays, -1 where the
    receiver's own noise goes, too.
    """
    coherent, replaced, size, delay, alignment = rules
    sds, blend = errors
    clock, bias, captured, capture_time, authentic = memory
    epoch_time, satellites = truth.epoch_time, truth.satellites
    noise = np.zeros(size)
    n = chosen.shape[0]
    for b in range(lo, hi):
        k = epochs[b] + 1
        due = epoch_time[k] - epoch_time[onsets[b]] >= delay
        if replaced:
            normals(keys[b, 0], keys[b, 1], 2 * k + 1, noise)
        for s in range(n):
            present = chosen[s] and satellites[k, s, 6] > 0.0
            offset = d_range[b, s] + clock[b, 0]
            if due and present and abs(offset) <= alignment:
                if not captured[b, s]:
                    capture_time[b, s] = epoch_time[k]
                captured[b, s] = True
            taken = present and captured[b, s]
            stays = 1.0
            if taken and replaced:
                age = epoch_time[k] - capture_time[b, s]
                stays = 1.0 - age / blend if age < blend else 0.0
            authentic[b, s] = -1.0 if taken and replaced and sds[0] >= 0.0 else stays
            authentic[b, n + s] = 1.0
            if coherent:
                authentic[b, n + s] = -1.0 if taken and replaced and sds[1] >= 0.0 else stays
            if not taken:
                d_range[b, s] = 0.0
                d_rate[b, s] = 0.0
                continue
            d_range[b, s] = offset
            if coherent:
                d_rate[b, s] += clock[b, 1]
            if replaced:
                d_range[b, s] += (1.0 - stays) * bias[b, s] + max(sds[0], 0.0) * noise[s]
                if coherent:
                    d_rate[b, s] += max(sds[1], 0.0) * noise[n + s]
