"""Compiled loops of the simulators: displacement, motion of the target, response to an attack."""

import math

import numpy as np

from ..attacks._kernels import Commanded, false_position, per_channel
from ..core.compile import njit
from ..core.simd import count_lanes, flags_at, floats_at, integers_at
from ..detectors.base import is_sound
from ..detectors.charts import judge_channels
from ..receiver._kernels import (
    MEASURE,
    PREDICT,
    SHOW,
    UPDATE,
    Arrays,
    arrays_at,
    name_scratch,
    predict_group,
    update_group,
)
from ..truth.noise import threefry
from ..truth.run import EpochTruth

# Places in the table behind `Arrays`: of `GroundTruth`; channels that are the spoofer's; whether
# rates are commanded, what an action of 1 commands, the limit of the rate, whether range rates are
# coherent.
POSITION_E, VELOCITY_E, CAPTURED, SLOTS, ATTACK_SETTINGS = range(
    len(Arrays._fields), len(Arrays._fields) + 5
)
DISPLACEMENT, RATE, AXES_E, TARGET_ERROR, SETTINGS, AVERAGE, DECAY = range(7)
# Places in the table of what attack and detector remember, as they take it, and of a verdict; which
# receivers alarmed at each epoch.
STATISTIC, THRESHOLD, ALARMS, HISTORY = range(7, 11)
ATTACK, JUDGE, SCORE, REMEMBER = 16, 32, 64, 128
NO_FORM, FALSE_POSITION, PER_CHANNEL = range(3)
EWMA, PASSIVE_EWMA, NEVER = 1, 2, 3
ONE, NO_ALARM = np.zeros((1, 1)), np.zeros((1, 1), dtype=np.bool_)
NOTHING_REMEMBERED = (
    *(ONE, ONE, np.zeros(0), np.zeros(6), np.zeros(4), ONE, ONE),
    *(ONE, ONE, NO_ALARM, NO_ALARM),
)  # arrays of that table for a kernel without an attack and a detector of its own
# What a kernel finds in a slice: an invalid verdict; receivers that have to run the time to alert,
# if it scores them.
UNSOUND, HOLDS = 1, 2


@njit
def run_epochs(table, memories, action, weights, work, attack, hold, detector, what, count, lo, hi):
    """Do some of what an epoch is made of, for some epochs of receivers lo to hi, group by group.

    All that a tightly coupled simulator does between two commands: `ATTACK` moves the counterfeit,
    then come the halves of the receiver (`receiver._kernels`), and `JUDGE` between them, which
    needs `SHOW`; without it that shows the last epoch alone.  `REMEMBER` writes which receivers
    alarm.

    `table`: of `kernel_table`, with what is named above behind it; `memories`: table of what attack
    and detector remember, of the verdict, and of (`count`, B) alarms; `action` (B, a) in [-1, 1];
    `weights` (B, 2n) on the columns of the gain, written by `JUDGE` as the verdict is; `work`: lane
    array, scratch memory of the calling thread; `attack`, `detector`: their compiled forms, by
    number; `hold`: whether the attack holds its rate; returns 0, or `UNSOUND` as soon as a group
    has such a verdict: what comes after it has not been done then.
    """
    m = weights.shape[1]
    a = arrays_at(table, work, m // 2)
    receivers, epoch_count = a.visible.shape[0], a.epoch_time.shape[0]
    position_e = floats_at(table, POSITION_E).reshape((epoch_count, 3))
    velocity_e = floats_at(table, VELOCITY_E).reshape((epoch_count, 3))
    captured, slots = flags_at(table, CAPTURED), integers_at(table, SLOTS)
    attack_settings = floats_at(table, ATTACK_SETTINGS)
    displacement = floats_at(memories, DISPLACEMENT).reshape(action.shape)
    rate = floats_at(memories, RATE).reshape(action.shape)
    axes_e = floats_at(memories, AXES_E)
    axes_e = axes_e.reshape((epoch_count, axes_e.shape[0] // (6 * epoch_count), 6))
    target_error = floats_at(memories, TARGET_ERROR).reshape((action.shape[0], 6))
    settings, shape = floats_at(memories, SETTINGS), a.visible.shape
    average, decay = floats_at(memories, AVERAGE), floats_at(memories, DECAY)
    statistic, threshold = floats_at(memories, STATISTIC), floats_at(memories, THRESHOLD)
    alarm, history = flags_at(memories, ALARMS), flags_at(memories, HISTORY)
    commanded = Commanded(action, hold, attack_settings, displacement, rate)
    rest = a.epochs, EpochTruth(a.epoch_time, a.satellites, position_e, velocity_e), captured
    w = name_scratch(a, work)
    lanes = count_lanes(work)
    innovation = a.out[a.places[0] : a.places[0] + receivers * m].reshape((receivers, m))
    variance = a.out[a.places[1] : a.places[1] + receivers * m].reshape((receivers, m))
    for group in range(lo // lanes, -(-hi // lanes)):
        b, e = group * lanes, min((group + 1) * lanes, receivers)
        for k in range(count):
            if what & ATTACK and attack == FALSE_POSITION:
                offsets = a.range_offset, a.rate_offset, b, e
                false_position(commanded, axes_e, target_error, *rest, *offsets)
            elif what & ATTACK and attack == PER_CHANNEL:
                per_channel(commanded, slots, *rest, a.range_offset, a.rate_offset, b, e)
            if what & (MEASURE | PREDICT):
                shown = k == count - 1 or (what & JUDGE and detector != NEVER)
                predict_group(a, w, group, what if shown else what & ~SHOW)
            if what & JUDGE and detector != NEVER:
                now = statistic.reshape(shape)[b:e], threshold.reshape(shape)[b:e]
                seen = innovation[b:e], variance[b:e], a.visible[b:e]
                charts = average.reshape(shape)[b:e], decay.reshape(shape)[b:e]
                rules = settings[0], settings[1], settings[2]
                judge_channels(*seen, *rules, *charts, *now, weights[b:e])
                sound = is_sound(*now, weights[b:e])
                for i in range(b * shape[1], e * shape[1]):
                    threshold[i] = settings[3] * threshold[i]
                    alarm[i] = statistic[i] > threshold[i]
                if detector == PASSIVE_EWMA:
                    weights[b:e] = 1.0
                if not sound:
                    return UNSOUND
            if what & REMEMBER:
                for each in range(b, e):
                    alarmed = False
                    if detector != NEVER:
                        for i in range(each * shape[1], (each + 1) * shape[1]):
                            alarmed = alarmed or alarm[i]
                    history[k * receivers + each] = alarmed
            if what & UPDATE:
                update_group(a, w, group, weights)
    return 0


@njit
def find_diverged(position, farthest):
    """First receiver whose position (B, d) is not finite or further away than `farthest` [m]; -1
    without one."""
    for b in range(position.shape[0]):
        for i in range(position.shape[1]):
            if not abs(position[b, i]) <= farthest:
                return b
    return -1


@njit
def displace(
    position_e, reference_e, rows, C_en, epochs, direction, worst, origin, displacement, lo, hi
):
    """Displacements along the target direction, in the local axes of the epoch.

    What counts is horizontal, and along a bearing, where the target is: in axes of the onset, half
    an hour of flight lets a twentieth of the vertical error in, and turns east by four degrees.
    The commands of a counterfeit position have the same axes.

    `position_e`, `reference_e` (B, 3) estimated, and (K, 3) what it is compared to, ECEF [m];
    `rows` (B,) row of the reference for each receiver; `C_en` (K, 3, 3) local axes at all epochs;
    `epochs` (B,) epoch that each receiver is at; `direction` (B, 2) unit vector, north and east, in
    which displacement counts; `origin` (B, 2) north and east difference at the onset, in the axes
    there, which does not count [m]; `displacement` (B,), written from `lo` to `hi` [m].
    """
    for b in range(lo, hi):
        north, east = -origin[b, 0], -origin[b, 1]
        axes = C_en[epochs[b]]
        for i in range(3):
            apart = position_e[b, i] - reference_e[rows[b], i]
            north += apart * axes[i, 0]
            east += apart * axes[i, 1]
        if worst:
            displacement[b] = math.sqrt(north * north + east * east)
        else:
            displacement[b] = direction[b, 0] * north + direction[b, 1] * east


@njit
def local_motion(position_e, velocity_e, C_en, epochs, onset, per_position, per_velocity, out):
    """Motion since the onset in the local axes there, scaled. `position_e`, `velocity_e` (K, 3)
    true, ECEF [m], [m/s]; `C_en` (K, 3, 3) local axes at all epochs; `epochs`, `onset` (B,) epoch
    that each receiver is at, and that of its onset; `out` (B, 6), written: position less that at
    the onset, and velocity; north, east, down."""
    for b in range(out.shape[0]):
        k, first = epochs[b], onset[b]
        axes = C_en[first]
        for j in range(3):
            moved, speed = 0.0, 0.0
            for i in range(3):
                moved += (position_e[k, i] - position_e[first, i]) * axes[i, j]
                speed += velocity_e[k, i] * axes[i, j]
            out[b, j] = per_position * moved
            out[b, 3 + j] = per_velocity * speed


@njit
def shift_response(
    transition,
    design,
    predicted_cov,
    innovation_cov,
    visible,
    weights,
    min_satellites,
    range_offset,
    rate_offset,
    shift,
    divergence,
):
    """Move the attack's shift of the filter over one epoch, and add the divergence of it. `weights`
    (B, 2n) on the columns of the gain; `range_offset`, `rate_offset` (B, n) what the attack adds
    [m], [m/s]; `shift` (B, 17) of the filter's error, overwritten; `divergence` (B,) [nats], added
    to."""
    receivers, n = visible.shape
    states = shift.shape[1]
    before, used = np.empty(states), np.empty(2 * n, dtype=np.int64)
    S, rho, y, w = np.empty((2 * n, 2 * n)), np.empty(2 * n), np.empty(2 * n), np.empty(2 * n)
    for b in range(receivers):
        Phi, H, e = transition[b], design[b], shift[b]
        still, m = True, 0
        for i in range(states):
            before[i] = e[i]
            still = still and e[i] == 0.0
        for s in range(2 * n):
            if visible[b, s % n]:
                used[m] = s
                a = range_offset[b, s] if s < n else rate_offset[b, s - n]
                still = still and a == 0.0
                m += 1
        if still:
            continue
        for i in range(states):
            total = 0.0
            for j in range(states):
                total += Phi[i, j] * before[j]
            e[i] = total
        for i in range(m):
            s = used[i]
            total = range_offset[b, s] if s < n else rate_offset[b, s - n]
            for j in range(states):
                total += H[s, j] * e[j]
            rho[i], y[i], w[i] = total, total, weights[b, s] * total
            for j in range(i + 1):
                S[i, j] = innovation_cov[b, s, used[j]]
        # S = L L', y = L^-1 rho, w = S^-1 (W rho)
        for i in range(m):
            for j in range(i + 1):
                total = S[i, j]
                for k in range(j):
                    total -= S[i, k] * S[j, k]
                S[i, j] = math.sqrt(total) if i == j else total / S[j, j]
            for k in range(i):
                y[i] -= S[i, k] * y[k]
                w[i] -= S[i, k] * w[k]
            y[i] /= S[i, i]
            w[i] /= S[i, i]
            divergence[b] += 0.5 * y[i] * y[i]
        if m < 2 * min_satellites:
            continue
        for i in range(m - 1, -1, -1):
            for k in range(i + 1, m):
                w[i] -= S[k, i] * w[k]
            w[i] /= S[i, i]
        # e^- - P H' S^-1 W rho
        for j in range(states):
            before[j] = 0.0
            for i in range(m):
                before[j] += H[used[i], j] * w[i]
        for i in range(states):
            for j in range(states):
                e[i] -= predicted_cov[b, i, j] * before[j]


@njit
def part_along(position, reference, axes, axis):
    """Part of a difference of positions (d,) along one of the local `axes` (d, e)."""
    total = (position[0] - reference[0]) * axes[0, axis]
    for i in range(1, position.shape[0]):
        total += (position[i] - reference[i]) * axes[i, axis]
    return total


@njit
def local_error(position_e, true_position_e, C_en, epochs, out):
    """Errors of positions (B, 3) at `epochs` (B,) in the local axes there: `out` (B, 3), written.
    `true_position_e` (K, 3) and local axes `C_en` (K, 3, 3) at all epochs."""
    for b in range(out.shape[0]):
        k = epochs[b]
        for j in range(out.shape[1]):
            out[b, j] = part_along(position_e[b], true_position_e[k], C_en[k], j)


@njit
def remember_positions(position, epochs, past, past_epochs):
    """Write positions (B, d) at `epochs` (B,) to their places in the `past` (B, h, d), and which
    epochs these are of, (B, h)."""
    for b in range(epochs.shape[0]):
        place = epochs[b] % past_epochs.shape[1]
        past_epochs[b, place] = epochs[b]
        for i in range(position.shape[1]):
            past[b, place, i] = position[b, i]


REPORTS = 0xAD5B  # word of the counters from which latencies of reports are drawn


@njit
def read_reports(past, past_epochs, epochs, onset, keys, true_position, C_en, rules, out):
    """What the newest report says that has arrived by the `epochs` (B,): `out` (B, 3), written.

    A report is of every so many epochs counted from the `onset` (B,), before it, too; its latency
    is drawn by its epoch and the `keys` (B, 2) of the episode. `past`, `past_epochs` as
    `remember_positions` writes them; `true_position` (K, d) and local axes `C_en` (K, d, e) at all
    epochs; `rules`: epochs between reports and of the largest latency, duration of an epoch [s],
    distance that is written as 1, steps of the position [m], and whether the true position at the
    time of the report is taken off. `out`: north and east of the onset, and age [s]; all 0 where
    no report has arrived.
    """
    every, latency, interval_s = int(rules[0]), rules[1], rules[2]
    scale_m, step_m, less_true = rules[3], rules[4], rules[5] != 0.0
    for b in range(out.shape[0]):
        newest, first = epochs[b] - (epochs[b] - onset[b]) % every, onset[b]
        while True:
            counter = np.uint64(newest), np.uint64(REPORTS)
            word, _ = threefry(counter[0], counter[1], keys[b, 0], keys[b, 1])
            part = (word >> np.uint64(11)) * 2.0**-53
            if newest + part * latency <= epochs[b]:
                break
            newest -= every
        place = newest % past_epochs.shape[1]
        known = past_epochs[b, place] == newest
        for j in range(2):
            ground = 0.0
            if known:
                ground = part_along(past[b, place], true_position[first], C_en[first], j)
                if step_m > 0.0:  # zeros have signs, too
                    ground = math.copysign(step_m * round(abs(ground) / step_m), ground)
                if less_true:
                    true = true_position[newest], true_position[first], C_en[first]
                    ground -= part_along(*true, j)
            out[b, j] = ground / scale_m
        out[b, 2] = (epochs[b] - newest) * interval_s if known else 0.0


@njit
def turn(both, aim, runs, out):
    """Responses to the north and to the east, `both` (K, P, 2, x), along the aims (N, 2) of some
    runs, written to `out` (K, P, N, x)."""
    epochs, attacks, _, size = both.shape
    for k in range(epochs):
        for p in range(attacks):
            for n in runs:
                for x in range(size):
                    out[k, p, n, x] = aim[n, 0] * both[k, p, 0, x] + aim[n, 1] * both[k, p, 1, x]
