"""Compiled loops of the game."""

from __future__ import annotations

import math

import numpy as np

from .._jit import njit


@njit
def displace(position_e, reference_e, rows, C_en, onset, heading, worst, origin, displacement):
    """Displacements along the target direction, in the local axes at the onset.

    `position_e`, `reference_e` (B, 3) estimated, and (K, 3) what it is compared to, ECEF [m];
    `C_en` (K, 3, 3) local axes at all epochs; `onset` (B,) epoch after which each receiver's attack
    begins; `heading` (B,) direction in which displacement counts, clockwise from north [rad];
    `origin` (B, 2) north and east difference at the onset, which does not count [m]; `displacement`
    (B,), written [m].
    """
    cosine, sine = 1.0, 0.0
    for b in range(displacement.shape[0]):
        if b == 0 or heading[b] != heading[b - 1]:
            cosine, sine = math.cos(heading[b]), math.sin(heading[b])
        north, east = -origin[b, 0], -origin[b, 1]
        axes = C_en[onset[b]]
        for i in range(3):
            apart = position_e[b, i] - reference_e[rows[b], i]
            north += apart * axes[i, 0]
            east += apart * axes[i, 1]
        if worst:
            displacement[b] = math.sqrt(north * north + east * east)
        else:
            displacement[b] = cosine * north + sine * east


@njit
def time_fractions(epochs, onset, steps, out):
    """Parts of the command phase that are over, and left.

    `epochs`, `onset` (B,) epoch that each receiver is at, and that of its onset; `out` (B, 2),
    written.
    """
    for b in range(out.shape[0]):
        since = (epochs[b] - onset[b]) / steps
        out[b, 0] = since
        out[b, 1] = 1.0 - since


@njit
def local_motion(position_e, velocity_e, C_en, epochs, onset, per_position, per_velocity, out):
    """Motion since the onset in the local axes there, scaled.

    `position_e`, `velocity_e` (K, 3) true, ECEF [m], [m/s]; `C_en` (K, 3, 3) local axes at all
    epochs; `epochs`, `onset` (B,) epoch that each receiver is at, and that of its onset; `out`
    (B, 6), written: position less that at the onset, and velocity; north, east, down.
    """
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
def within(values, limit):
    """Whether all values are finite, and at most as large as a limit."""
    good = True
    for value in values.flat:
        good = good and abs(value) <= limit
    return good


@njit
def own_command(displacement, rate, per_displacement, per_rate, out):
    """Commanded displacement and rate, scaled.

    `displacement`, `rate` (B, a) [m], [m/s]; `out` (B, o), whose first 2 a columns are written.
    """
    axes = displacement.shape[1]
    for b in range(displacement.shape[0]):
        for i in range(axes):
            out[b, i] = displacement[b, i] * per_displacement
            out[b, axes + i] = rate[b, i] * per_rate


@njit
def clip_columns(out, low, high, first, last):
    """Clip some columns; NaN stays NaN.  `out` (B, o), overwritten; `low`, `high` (o,) bounds."""
    for b in range(out.shape[0]):
        for i in range(first, last):
            if out[b, i] < low[i]:
                out[b, i] = low[i]
            elif out[b, i] > high[i]:
                out[b, i] = high[i]


# rows of what a step has brought, as `tally.Tally` names them; parts of the reward come between
TIME, DISPLACEMENT, UNDETECTED, COST = 0, 1, 2, 3
PARTS = 4
GAIN, RETRACTION, REWARD = -3, -2, -1
ALARM, DETECTED, WARMUP_ALARM, COASTING, FIRST, FINISHED, TERMINATED, TRUNCATED = range(8)


@njit
def score(
    alarms,
    early,
    at_alarm,
    steps,
    hold,
    step_count,
    detected,
    ended,
    credited,
    largest,
    values,
    marks,
):
    """Keep the books of one epoch of every receiver.

    `alarms` (B, c) bool, of the verdict; `early` (B,) bool, whose last command this was, before the
    end of the window; `step_count` (B,) epochs before this one; one more after it; `detected` (B,)
    bool, whether there was an alarm before this epoch; with it after; `ended` (B,) bool, whose
    episode was over before this epoch; nothing counts for them; `credited` (B,) undetected
    displacement before this epoch, and after it [m]; `largest` (steps + 1, B) largest displacement
    so far after each epoch, this one's is written [m].
    """
    held = False
    for b in range(step_count.shape[0]):
        # a receiver whose episode is over may be stepped once more before it is reset
        step_count[b] += 1
        j = min(step_count[b], steps)
        before = largest[j - 1, b]
        now = max(before, values[DISPLACEMENT, b])
        largest[j, b] = now
        alarm = False
        for c in range(alarms.shape[1]):
            alarm = alarm or alarms[b, c]
        running = not ended[b]
        alarm = alarm and running
        first = alarm and not detected[b]
        finished = running and (step_count[b] == steps or early[b])
        values[GAIN, b] = now - before if running and not alarm and not detected[b] else 0.0
        values[RETRACTION, b] = largest[max(j - hold - 1, 0), b] - before if first else 0.0
        detected[b] = detected[b] or first
        credited[b] += values[GAIN, b]
        credited[b] += values[RETRACTION, b]
        over = finished or (at_alarm and detected[b])
        marks[ALARM, b], marks[FIRST, b], marks[FINISHED, b] = alarm, first, finished
        marks[TERMINATED, b] = over
        marks[TRUNCATED, b] = marks[TRUNCATED, b] and running and not over
        held = held or (finished and not detected[b])
    return held and hold > 0


@njit
def tell(
    detected,
    ended,
    credited,
    warmup_alarm,
    coasting,
    epoch_time,
    epochs,
    shares,
    values,
    marks,
):
    """Write what is told of a step, and its reward.

    `ended` (B,) bool, overwritten: with those whose episode this step has ended; `epoch_time` (K,)
    [s]; `epochs` (B,) the epoch that each receiver is at; `shares` (r, 4) of every term of the
    reward in gain, retraction, first alarm and alarm; `values`, `marks`: of `Tally`, whose
    remaining rows are written.
    """
    for b in range(detected.shape[0]):
        ended[b] = ended[b] or marks[TERMINATED, b] or marks[TRUNCATED, b]
        marks[DETECTED, b] = detected[b]
        marks[WARMUP_ALARM, b] = warmup_alarm[b]
        marks[COASTING, b] = coasting[b]
        values[TIME, b] = epoch_time[epochs[b]]
        values[UNDETECTED, b] = credited[b]
        values[COST, b] = 1.0 if marks[FIRST, b] else 0.0
        values[REWARD, b] = 0.0
    for r in range(shares.shape[0]):
        for b in range(detected.shape[0]):
            # a share of 0 leaves nothing to be rounded
            part = shares[r, 0] * values[GAIN, b] + shares[r, 1] * values[RETRACTION, b]
            part += shares[r, 2] if marks[FIRST, b] else 0.0
            part += shares[r, 3] if marks[ALARM, b] else 0.0
            values[PARTS + r, b] = part
    # apart from the loop above, so that the sum is one of rounded parts
    for r in range(shares.shape[0]):
        for b in range(detected.shape[0]):
            values[REWARD, b] += values[PARTS + r, b]


@njit
def look(table, epochs, displacement, rate, first, scales, out):
    """Observe what is tabled, and one's own command.

    `table` (K, o) float32, what is observed at every epoch; `epochs` (B,) the epoch that each
    receiver is at; `displacement`, `rate` (B, a) commanded [m], [m/s]; `scales` (4,) factors on
    displacement and rate, and bounds of both; `out` (B, o) float32, written.
    """
    for b in range(out.shape[0]):
        row = table[epochs[b]]
        for i in range(out.shape[1]):
            out[b, i] = row[i]
    if first >= 0:
        part = out[:, first : first + 2 * displacement.shape[1]]
        own_command(displacement, rate, scales[0], scales[1], part)
        least, most = np.float32(scales[2]), np.float32(scales[3])
        for b in range(part.shape[0]):
            for i in range(part.shape[1]):
                if part[b, i] < least:
                    part[b, i] = least
                elif part[b, i] > most:
                    part[b, i] = most


@njit
def unpack_books(raw, receivers, steps):
    """Name the arrays of the books: views of their bytes.  `raw` (B (8 (steps + 3) + 3),) uint8."""
    b, o = receivers, 8 * receivers
    step_count = raw[:o].view(np.int64)
    credited = raw[o : 2 * o].view(np.float64)
    last = (steps + 3) * o
    largest = raw[2 * o : last].view(np.float64).reshape((steps + 1, b))
    detected = raw[last : last + b].view(np.bool_)
    ended = raw[last + b : last + 2 * b].view(np.bool_)
    nobody = raw[last + 2 * b :].view(np.bool_)
    return step_count, credited, largest, detected, ended, nobody


@njit
def play(
    floats,
    flags,
    twin_floats,
    epochs,
    books,
    rules,
    table,
    begun,
    alarms,
    displacement,
    rate,
    numbers,
    flags_told,
    seen,
):
    """Displace, keep the books, tell and observe, where nothing comes between.

    To hand over an array costs as much as all that this does for one receiver, so most of them
    come several in one.

    `epochs` (B,) the epoch that each receiver is at; `rules` (11 + 4 r + 13 K,) of `rules_of`;
    `table` (K, o) as in `look`; `begun` (5 B,) onset, heading and `origin` as in `displace`,
    `warmup_alarm` as in `tell`; `numbers`, `flags_told`, `seen`: of `Tally`, and `out` of `look` in
    one row; written.
    """
    receivers, K = epochs.shape[0], table.shape[0]
    channels, steps, hold, first = int(rules[0]), int(rules[4]), int(rules[5]), int(rules[6])
    end = rules.shape[0] - 13 * K
    shares, truth = rules[11:end].reshape(((end - 11) // 4, 4)), rules[end:]
    values = numbers.reshape((numbers.shape[0] // receivers, receivers))
    marks = flags_told.reshape((flags_told.shape[0] // receivers, receivers))
    # the positions come first in `unpack`, which would name many more
    position_e = floats[: 3 * receivers].reshape((receivers, 3))
    coasting = flags[channels * receivers :]
    step_count, credited, largest, detected, ended, nobody = unpack_books(books, receivers, steps)
    if rules[1] != 0.0:
        reference_e = twin_floats[: 3 * receivers].reshape((receivers, 3))
        rows = np.arange(receivers)
    else:
        reference_e, rows = truth[: 3 * K].reshape((K, 3)), epochs
    displace(
        position_e,
        reference_e,
        rows,
        truth[3 * K : 12 * K].reshape((K, 3, 3)),
        begun[:receivers].astype(np.int64),
        begun[receivers : 2 * receivers],
        rules[2] != 0.0,
        begun[2 * receivers : 4 * receivers].reshape((receivers, 2)),
        values[DISPLACEMENT],
    )
    held = score(
        alarms,
        nobody,
        rules[3] != 0.0,
        steps,
        hold,
        step_count,
        detected,
        ended,
        credited,
        largest,
        values,
        marks,
    )
    if not held:
        tell(
            detected,
            ended,
            credited,
            begun[4 * receivers :] != 0.0,
            coasting,
            truth[12 * K :],
            epochs,
            shares,
            values,
            marks,
        )
        out = seen.reshape((receivers, table.shape[1]))
        look(table, epochs, displacement, rate, first, rules[7:11], out)
    return held


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
    """Move the attack's shift of the filter over one epoch, and add the divergence of it.

    `weights` (B, 2n) on the columns of the gain; `range_offset`, `rate_offset` (B, n) what the
    attack adds [m], [m/s]; `shift` (B, 17) of the filter's error, overwritten; `divergence` (B,)
    [nats], added to.
    """
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
