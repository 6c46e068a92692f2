"""Compiled loops of the environments."""

from __future__ import annotations

import math

import numpy as np

from ..core.compile import njit
from ..core.simd import flags_at, floats_at, integers_at, singles_at
from ..simulation._kernels import ALARMS, HOLDS, SCORE, displace, run_epochs


@njit
def time_fractions(epochs, onset, steps, out):
    """Parts of the command phase that are over, and left, at (B,) epochs: `out` (B, 2), written."""
    for b in range(out.shape[0]):
        since = (epochs[b] - onset[b]) / steps
        out[b, 0] = since
        out[b, 1] = 1.0 - since


@njit
def follow_rate(action, matrix, rules, rate, out):
    """Commands of actions, or of the wanted rates that they are; `out` (B, a), written.

    `action` (B, k) in [-1, 1]; `matrix` (B, a, k) parts of each in the command; `rules` (3,):
    factors on a wanted rate and on the rate so far, and 1 where there is one, so that the command
    is what takes the rate there, shortened to the length 1; all 0 where actions are added as they
    are; `rate` (B, a) so far [m/s].
    """
    axes = out.shape[1]
    for b in range(out.shape[0]):
        total = 0.0
        for i in range(axes):
            value = 0.0
            for j in range(action.shape[1]):
                value += matrix[b, i, j] * action[b, j]
            if rules[2] != 0.0:
                value = rules[0] * value - rules[1] * rate[b, i]
            out[b, i] = value
            total += value * value
        if rules[2] != 0.0 and total > 1.0:
            shorter = 1.0 / math.sqrt(total)
            for i in range(axes):
                out[b, i] *= shorter


@njit
def within(values, limit):
    good = True
    for value in values.flat:
        good = good and abs(value) <= limit
    return good


@njit
def own_command(displacement, rate, direction, north, east, per_displacement, per_rate, out):
    """Commanded displacement and rate (B, a), scaled, into the first 2 a columns of `out`. Where
    the columns `north` and `east` are given, not -1, their parts along the target direction
    `direction` (B, 2) come into the first two instead."""
    axes = displacement.shape[1]
    for b in range(displacement.shape[0]):
        if north >= 0:
            to_north, to_east = direction[b, 0], direction[b, 1]
            moved = displacement[b, north] * to_north + displacement[b, east] * to_east
            speed = rate[b, north] * to_north + rate[b, east] * to_east
            out[b, 0], out[b, 1] = moved * per_displacement, speed * per_rate[0]
            continue
        for i in range(axes):
            out[b, i] = displacement[b, i] * per_displacement
            out[b, axes + i] = rate[b, i] * per_rate[i]


@njit
def clip_columns(out, low, high, first, last):
    """Clip some columns; NaN stays NaN.  `out` (B, o), overwritten; `low`, `high` (o,) bounds."""
    for b in range(out.shape[0]):
        for i in range(first, last):
            if out[b, i] < low[i]:
                out[b, i] = low[i]
            elif out[b, i] > high[i]:
                out[b, i] = high[i]


# rows of what a step has brought, as `step_result` names them; parts of the reward come between
TIME, DISPLACEMENT, UNDETECTED, COST, STATISTIC, THRESHOLD = range(6)
PARTS = 6
GAIN, RETRACTION, REWARD = -3, -2, -1
ALARM, DETECTED, WARMUP_ALARM, COASTING, FIRST, FINISHED, TERMINATED, TRUNCATED = range(8)


@njit
def report_loudest(statistic, threshold, numbers):
    """Statistic and threshold of the channel whose ratio is largest, into their rows of `numbers`;
    `statistic`, `threshold` (B, c) of a verdict."""
    receivers = statistic.shape[0]
    for b in range(receivers):
        loudest, largest = 0, -math.inf
        for c in range(statistic.shape[1]):
            ratio = statistic[b, c] / threshold[b, c]
            if ratio > largest:
                loudest, largest = c, ratio
        numbers[STATISTIC * receivers + b] = statistic[b, loudest]
        numbers[THRESHOLD * receivers + b] = threshold[b, loudest]


# what comes first in the rules of `finish`, before shares of the reward and times of the epochs
(
    STEPS,
    HOLD,
    WINDOW,
    AT_ALARM,
    SHARES,
    WORST,
    COMMAND_COLUMN,
    PER_DISPLACEMENT,
    LEAST,
    MOST,
    NORTH,
    EAST,
) = range(12)
RULES = 12
# what a table holds of a score and of the simulator, for `play`
(
    STEP_COUNT,
    UNDETECTED_SO_FAR,
    LARGEST,
    DETECTED_SO_FAR,
    ENDED,
    NO_ROWS,
    ITS_RULES,
    PER_RATE,
    OBSERVED,
    ORIGIN,
    WARMUP,
    EPOCHS,
    IS_COASTING,
    COMMANDED,
    COMMANDED_RATE,
    POSITION_E,
    TRUE_POSITION_E,
    LOCAL_AXES,
    DIRECTION,
) = range(19)


@njit
def find_last_counted(first_alarm, hold, steps):
    """Last of `steps` epochs whose displacement counts; `first_alarm`: epoch, 0 without one."""
    return min(max(first_alarm - hold - 1, 0), steps) if first_alarm > 0 else steps


@njit
def select_undetected(largest, first_alarm, hold):
    """Undetected displacement: (R,) [m]. `largest` (K + 1, R) displacement so far, from the onset
    on, which may be NaN after an alarm [m]; `first_alarm` (R,) its epoch, from 1 on, 0 without
    one up to epoch K + `hold`."""
    out = np.empty(len(first_alarm))
    for r in range(len(out)):
        out[r] = largest[find_last_counted(first_alarm[r], hold, len(largest) - 1), r]
    return out


@njit
def score(
    alarms, early, rules, step_count, detected, ended, undetected, largest, values, marks, lo, hi
):
    """Score one epoch of receivers lo to hi; True where any has to run the time to alert.

    With M_j the largest displacement in steps 0 to j, the undetected displacement is M_N without an
    alarm, and M_(a-h-1) with the first alarm at epoch a, h being the epochs of the time to alert.
    After the last command nothing more is gained; where the `WINDOW` of an episode ends there,
    receivers without an alarm run the time to alert at once.

    `alarms` (B, c) of the verdict; `early` (B,) whether this was the last command before the end
    of the window; the others as in `DisplacementScore` and `StepResult`, of which displacement and
    truncation are read.
    """
    steps, hold, window = int(rules[STEPS]), int(rules[HOLD]), int(rules[WINDOW])
    held = False
    for b in range(lo, hi):
        # a receiver whose episode is over may be stepped once more before it is reset
        step_count[b] += 1
        count = step_count[b]
        commanded = count <= steps
        j = min(count, steps)
        before = largest[j - 1, b] if commanded else largest[j, b]
        now = max(before, values[DISPLACEMENT, b]) if commanded else before
        largest[j, b] = now
        alarm = False
        for c in range(alarms.shape[1]):
            alarm = alarm or alarms[b, c]
        running = not ended[b]
        alarm = alarm and running
        first = alarm and not detected[b]
        finished = running and (count == window or early[b])
        values[GAIN, b] = now - before if running and not alarm and not detected[b] else 0.0
        counted = largest[find_last_counted(count, hold, steps), b]
        values[RETRACTION, b] = counted - before if first else 0.0
        detected[b] = detected[b] or first
        undetected[b] += values[GAIN, b]
        undetected[b] += values[RETRACTION, b]
        over = finished or (rules[AT_ALARM] != 0.0 and detected[b])
        marks[ALARM, b], marks[FIRST, b], marks[FINISHED, b] = alarm, first, finished
        marks[TERMINATED, b] = over
        marks[TRUNCATED, b] = marks[TRUNCATED, b] and running and not over
        held = held or (finished and not detected[b])
    return held and hold > 0 and window == steps


@njit
def score_late(
    first_alarm, b, hold, steps, step_count, detected, undetected, largest, values, marks
):
    """Score the time to alert of receiver b, which had no alarm before. `first_alarm`: its epoch in
    that time, from 1 on, 0 without one; the others as in `score`."""
    last, alarmed = min(step_count[b], steps), first_alarm > 0
    counted = largest[find_last_counted(last + first_alarm, hold, steps), b]
    values[RETRACTION, b] = counted - largest[last, b] if alarmed else 0.0
    marks[FIRST, b] = alarmed
    marks[ALARM, b] = marks[ALARM, b] or alarmed
    detected[b] = alarmed
    undetected[b] += values[RETRACTION, b]


@njit
def score_late_alarms(first_alarms, rows, *score):
    for i in range(rows.shape[0]):
        score_late(first_alarms[i], rows[i], *score)


@njit
def settle(
    rules,
    detected,
    ended,
    undetected,
    twin_alarmed,
    warmup_alarm,
    coasting,
    epochs,
    values,
    marks,
    lo,
    hi,
):
    """Write what is reported of a step whose score is settled, and its reward; lo to hi. `rules`
    end with (r, 4) shares of every term of the reward in gain, retraction, cost and alarm, and (K,)
    times of the epochs [s]; `ended` (B,) is set where the episode is over now."""
    terms = int(rules[SHARES])
    shares = rules[RULES : RULES + 4 * terms].reshape((terms, 4))
    time = rules[RULES + 4 * terms :]
    for b in range(lo, hi):
        ended[b] = ended[b] or marks[TERMINATED, b] or marks[TRUNCATED, b]
        marks[DETECTED, b] = detected[b]
        marks[WARMUP_ALARM, b] = warmup_alarm[b]
        marks[COASTING, b] = coasting[b]
        values[TIME, b] = time[epochs[b]]
        values[UNDETECTED, b] = undetected[b]
        values[COST, b] = 1.0 if marks[FIRST, b] and not twin_alarmed[b] else 0.0
        values[REWARD, b] = 0.0
    for r in range(terms):
        for b in range(lo, hi):
            # a share of 0 leaves nothing to be rounded
            part = shares[r, 0] * values[GAIN, b] + shares[r, 1] * values[RETRACTION, b]
            part += shares[r, 2] if values[COST, b] > 0.0 else 0.0
            part += shares[r, 3] if marks[ALARM, b] else 0.0
            values[PARTS + r, b] = part
    # apart from the loop above, so that the sum is one of rounded parts
    for r in range(terms):
        for b in range(lo, hi):
            values[REWARD, b] += values[PARTS + r, b]


@njit
def observe(rules, per_rate, table, epochs, displacement, rate, direction, out, lo, hi):
    """Observe what is tabled, and one's own command, of receivers lo to hi.

    `table` (K, o) float32, what is observed at every epoch; `displacement`, `rate` (B, a)
    commanded, and `per_rate` (a,) factor on the rate; `direction` (B, 2) of the target; the factor
    on the displacement, bounds, axes north and east of what is observed along the target, and first
    column of the command, -1 where it is not observed, are in `rules`; `out` (B, o).
    """
    for b in range(lo, hi):
        row = table[epochs[b]]
        for i in range(out.shape[1]):
            out[b, i] = row[i]
    first = int(rules[COMMAND_COLUMN])
    if first >= 0:
        north, east = int(rules[NORTH]), int(rules[EAST])
        axes = 1 if north >= 0 else displacement.shape[1]
        part = out[lo:hi, first : first + 2 * axes]
        moved = displacement[lo:hi], rate[lo:hi], direction[lo:hi]
        own_command(*moved, north, east, rules[PER_DISPLACEMENT], per_rate, part)
        least, most = np.float32(rules[LEAST]), np.float32(rules[MOST])
        for b in range(part.shape[0]):
            for i in range(part.shape[1]):
                if part[b, i] < least:
                    part[b, i] = least
                elif part[b, i] > most:
                    part[b, i] = most


@njit
def unpack_score(raw, receivers, steps):
    """Name the arrays of a `DisplacementScore`: views of its bytes."""
    b, o = receivers, 8 * receivers
    step_count = raw[:o].view(np.int64)
    undetected = raw[o : 2 * o].view(np.float64)
    last = (steps + 3) * o
    largest = raw[2 * o : last].view(np.float64).reshape((steps + 1, b))
    detected = raw[last : last + b].view(np.bool_)
    ended = raw[last + b : last + 2 * b].view(np.bool_)
    no_rows = raw[last + 2 * b : last + 3 * b].view(np.bool_)
    twin_alarmed = raw[last + 3 * b :].view(np.bool_)
    return step_count, undetected, largest, detected, ended, no_rows, twin_alarmed


@njit
def finish(
    scored,
    raw,
    rules,
    per_rate,
    table,
    alarms,
    early,
    warmup_alarm,
    epochs,
    coasting,
    displacement,
    rate,
    direction,
    numbers,
    flags,
    seen,
):
    """Score an epoch unless `scored`, settle it and observe; True if nothing is settled yet. To
    hand over an array costs as much as all that this does for one receiver, so most of them come
    several in one: `raw` of `DisplacementScore`, `rules` of `FusedStep`, `numbers` and `flags` of
    `StepResult`; `seen` (B o,) float32 is written, or has no element where nothing is observed."""
    receivers = epochs.shape[0]
    values = numbers.reshape((numbers.shape[0] // receivers, receivers))
    marks = flags.reshape((flags.shape[0] // receivers, receivers))
    step_count, undetected, largest, detected, ended, _, twin_alarmed = unpack_score(
        raw, receivers, int(rules[STEPS])
    )
    progress, written = (detected, ended, undetected), (values, marks, 0, receivers)
    held = not scored and score(alarms, early, rules, step_count, *progress, largest, *written)
    if not held:
        settle(rules, *progress, twin_alarmed, warmup_alarm, coasting, epochs, *written)
        if seen.shape[0] > 0:
            out = seen.reshape((receivers, table.shape[1]))
            moved = displacement, rate, direction
            observe(rules, per_rate, table, epochs, *moved, out, 0, receivers)
    return held


@njit
def play_epoch(
    entries,
    numbers,
    flags,
    seen,
    table,
    memories,
    action,
    weights,
    work,
    attack,
    hold,
    detector,
    what,
    count,
    lo,
    hi,
):
    """An epoch of receivers lo to hi, and all that follows it: displacement, score, observation.
    `entries`: table of what is named above; `numbers`, `flags`, `seen` as in `finish`, written; all
    others as `run_epochs` takes them, which does it all without `SCORE`; returns what it found, or
    `HOLDS` where receivers have to run the time to alert before their step is settled."""
    found = run_epochs(
        table, memories, action, weights, work, attack, hold, detector, what, count, lo, hi
    )
    if found or not what & SCORE:
        return found
    rules, epochs = floats_at(entries, ITS_RULES), integers_at(entries, EPOCHS)
    receivers, axes = epochs.shape[0], action.shape[1]
    values = numbers.reshape((numbers.shape[0] // receivers, receivers))
    marks = flags.reshape((flags.shape[0] // receivers, receivers))
    true_position = floats_at(entries, TRUE_POSITION_E)
    samples = true_position.shape[0] // 3
    displace(
        floats_at(entries, POSITION_E).reshape((receivers, 3)),
        true_position.reshape((samples, 3)),
        epochs,
        floats_at(entries, LOCAL_AXES).reshape((samples, 3, 3)),
        epochs,
        floats_at(entries, DIRECTION).reshape((receivers, 2)),
        rules[WORST] > 0.0,
        floats_at(entries, ORIGIN).reshape((receivers, 2)),
        values[DISPLACEMENT],
        lo,
        hi,
    )
    step_count, detected = integers_at(entries, STEP_COUNT), flags_at(entries, DETECTED_SO_FAR)
    ended, undetected = flags_at(entries, ENDED), floats_at(entries, UNDETECTED_SO_FAR)
    progress, written = (detected, ended, undetected), (values, marks, lo, hi)
    largest, alarms = floats_at(entries, LARGEST), flags_at(memories, ALARMS)
    largest = largest.reshape((largest.shape[0] // receivers, receivers))
    alarms = alarms.reshape((receivers, alarms.shape[0] // receivers))
    no_rows = flags_at(entries, NO_ROWS)
    if score(alarms, no_rows, rules, step_count, *progress, largest, *written):
        return HOLDS
    known = flags_at(entries, WARMUP), flags_at(entries, IS_COASTING), epochs
    settle(rules, *progress, no_rows, *known, *written)
    if seen.shape[0] > 0:
        width, tabled = seen.shape[0] // receivers, singles_at(entries, OBSERVED)
        observe(
            rules,
            floats_at(entries, PER_RATE),
            tabled.reshape((tabled.shape[0] // width, width)),
            epochs,
            floats_at(entries, COMMANDED).reshape((receivers, axes)),
            floats_at(entries, COMMANDED_RATE).reshape((receivers, axes)),
            floats_at(entries, DIRECTION).reshape((receivers, 2)),
            seen.reshape((receivers, width)),
            lo,
            hi,
        )
    return 0
