"""Kernels of a device, a thread a receiver: they call the library's functions, and have no physics.

Every function of the library gets a batch of one, whose arrays are views of the thread's receiver.
Arrays of receivers have their axis first, (B, ...), and lie in memory with it last, so that
neighbouring threads read neighbouring numbers.
"""

from collections import namedtuple

import numpy as np
from numba import cuda

from ..attacks._kernels import Commanded, displace_antenna, per_channel
from ..detectors.base import is_sound
from ..detectors.charts import find_largest_sizes, judge_channels
from ..detectors.cusum import advance_sums
from ..envs._kernels import (
    DISPLACEMENT,
    HOLD,
    STEPS,
    WORST,
    follow_rate,
    observe,
    report_loudest,
    score,
    score_late,
    settle,
    time_fractions,
)
from ..receiver._kernels import (
    MEASURE,
    PREDICT,
    SHOW,
    Arrays,
    divide_scratch,
    predict_group,
    update_group,
)
from ..receiver.kalman import square_all
from ..simulation._kernels import FALSE_POSITION, PER_CHANNEL, displace, local_motion
from ..simulation.simulator import FARTHEST
from ..truth.noise import threefry
from ..truth.run import EpochTruth

NEVER, EWMA, PASSIVE_EWMA, SHEWHART, CUSUM, SNAPSHOT = range(6)
ATTACKED, JUDGED, ALL = 1, 2, 3
UNSOUND, DIVERGED = 1, 2  # what a thread finds, in `faults`

# What lasts of every receiver:
# - `x` to `coasting`: of `ReceiverBuffers`, `sensors` to `authentic`: of `SensorBuffers`, of one
#   receiver each; `displacement`, `rate`, `target_error`: of an attack;
# - `innovation`, `variance`, `covariance`: views of `out`; `first`, `second`: memory of the
#   detector; `statistic` to `weights`: of its verdict;
# - `work`, `spans`: scratch memory of `receiver._kernels`; `faults` (B,) int64.
Receivers = namedtuple(
    "Receivers",
    "x assumed out visible coasting sensors constants keys epochs range_offset rate_offset "
    "authentic in_run signals displacement rate target_error innovation variance covariance first "
    "second statistic threshold alarm weights work spans faults",
)
# What all receivers share: truth and rules as in `Arrays`, then of attack and detector.
Shared = namedtuple(
    "Shared",
    "run epoch_time epoch_end satellites position_e velocity_e C_en axes_e captured slots "
    "attack_settings rules places mappings settings limits",
)
# Episodes, as in `SpoofCore`: `command` (B, a) is `action` where no `matrix` (B, a, k) makes it;
# `number` (B,) of the episode; `motion` (B, 6) and `time` (B, 2) are observed where they have rows.
Episodes = namedtuple(
    "Episodes",
    "action command matrix following onset direction origin warmup_alarm step_count undetected "
    "largest detected ended no_rows values marks rules per_rate table seen number picked motion "
    "scales time",
)


def judge(r, t, w, b, detector):
    """Judge an epoch of receiver b, and write what its verdict is."""
    e, n, s = b + 1, r.visible.shape[1], t.settings
    innovation, variance, visible = r.innovation[b:e], r.variance[b:e], r.visible[b:e]
    statistic, threshold, weights = r.statistic[b:e], r.threshold[b:e], r.weights[b:e]
    first, last = int(s[4]), int(s[5])
    if EWMA <= detector <= PASSIVE_EWMA:
        chart = r.first[b:e], r.second[b:e], statistic, threshold
        judge_channels(innovation, variance, visible, s[0], s[1], s[2], *chart, weights)
    elif detector == SHEWHART:
        find_largest_sizes(innovation, variance, visible, first, last, statistic)
    elif detector == CUSUM:
        sums = r.first[b:e], r.second[b:e]
        advance_sums(innovation, variance, visible, first, last, s[0], *sums, statistic)
    elif detector == SNAPSHOT:
        belief = r.covariance[b:e, first:last, first:last]
        square_all(innovation[:, first:last], belief, w.rest, r.statistic[b])
    seen = 0
    for j in range(n):
        seen += 1 if visible[0, j] else 0
    for c in range(statistic.shape[1]):
        if SHEWHART <= detector <= CUSUM:
            threshold[0, c] = s[1]
        elif detector == SNAPSHOT:
            threshold[0, c] = t.limits[seen]
    if not is_sound(statistic, threshold, weights):
        r.faults[b] |= UNSOUND
    for c in range(statistic.shape[1]):
        threshold[0, c] = s[3] * threshold[0, c]
        r.alarm[b, c] = statistic[0, c] > threshold[0, c]
    if detector == PASSIVE_EWMA:
        for k in range(weights.shape[1]):
            weights[0, k] = 1.0


def run_receiver(r, t, b, command, hold, attack, detector, what):
    """An epoch of receiver b; `command` (1, a). Whether its detector alarms."""
    e = b + 1
    d_range, d_rate = r.range_offset[b:e], r.rate_offset[b:e]
    a = Arrays(
        r.x[b],
        r.assumed[b % r.assumed.shape[0]],
        r.out[b],
        t.places,
        r.visible[b:e],
        r.coasting[b:e],
        r.sensors[b],
        r.constants[b % r.constants.shape[0]],
        r.keys[b],
        r.epochs[b:e],
        d_range,
        d_rate,
        r.authentic[b:e],
        r.in_run[b],
        t.run,
        t.epoch_time,
        t.epoch_end,
        t.satellites,
        t.rules,
        r.signals[b],
        t.mappings,
    )
    w = divide_scratch(a, r.work[b], r.spans[b])
    if what & ATTACKED:
        moved = r.displacement[b:e], r.rate[b:e]
        commanded = Commanded(command, hold, t.attack_settings, *moved)
        truth = EpochTruth(t.epoch_time, t.satellites, t.position_e, t.velocity_e)
        if attack == FALSE_POSITION:
            rest = a.epochs, truth, t.captured, d_range, d_rate, 0
            scratch = w.solution[8:14], w.solution[:8]
            displace_antenna(commanded, t.axes_e, r.target_error[b:e], *rest, *scratch)
        elif attack == PER_CHANNEL:
            per_channel(commanded, t.slots, a.epochs, truth, t.captured, d_range, d_rate, 0, 1)
    predict_group(a, w, 0, MEASURE | PREDICT | SHOW)
    alarmed = False
    if what & JUDGED and detector != NEVER:
        judge(r, t, w, b, detector)
        for c in range(r.alarm.shape[1]):
            alarmed = alarmed or r.alarm[b, c]
    update_group(a, w, 0, r.weights[b:e])
    for i in range(3):  # `show_position` has written it
        if not abs(r.out[b, 2 + i]) <= FARTHEST:
            r.faults[b] |= DIVERGED
    return alarmed


def age(r, t, warmup_alarm, left, count, detector, what):
    """Run clean epochs of those receivers that have some `left` (B,), at most `count`."""
    b = cuda.grid(1)
    if b >= r.epochs.shape[0]:
        return
    for _ in range(min(count, left[b])):
        if run_receiver(r, t, b, r.displacement[b : b + 1], True, 0, detector, what):
            warmup_alarm[b] = True
        left[b] -= 1


def play_step(r, t, p, attack, detector):
    """A step of every receiver, as `envs._kernels.play_epoch` runs it, and its time to alert."""
    b = cuda.grid(1)
    if b >= r.epochs.shape[0]:
        return
    e = b + 1
    if p.matrix.shape[2] > 0:
        given = p.matrix[b:e], p.following, r.rate[b:e]
        follow_rate(p.action[b:e], *given, p.command[b:e])
    place = r.out[b : b + 1, 2:5]
    steps, count = int(p.rules[STEPS]), 1 + int(p.rules[HOLD])
    first, held = 0, False
    for k in range(count):
        if k > 0 and not held:
            break
        alarmed = run_receiver(r, t, b, p.command[b:e], k > 0, attack, detector, ALL)
        if k > 0:
            first = k if alarmed and first == 0 else first
            continue
        aim = r.epochs[b:e], p.direction[b:e], p.rules[WORST] > 0.0, p.origin[b:e]
        out = p.values[DISPLACEMENT, b:e]
        displace(place, t.position_e, r.epochs[b:e], t.C_en, *aim, out, 0, 1)
        progress = p.step_count, p.detected, p.ended, p.undetected, p.largest
        held = score(r.alarm, p.no_rows, p.rules, *progress, p.values, p.marks, b, e)
    if held:
        so_far = p.step_count, p.detected, p.undetected, p.largest
        score_late(first, b, count - 1, steps, *so_far, p.values, p.marks)
    progress = p.detected, p.ended, p.undetected, p.no_rows, p.warmup_alarm, r.coasting, r.epochs
    settle(p.rules, *progress, p.values, p.marks, b, e)
    report_loudest(r.statistic[b:e], r.threshold[b:e], p.values[:, b])


def look(r, t, p):
    """Write what is tabled, the own command, time and motion, as they are observed now."""
    b = cuda.grid(1)
    if b >= r.epochs.shape[0]:
        return
    e = b + 1
    now = r.epochs, r.displacement, r.rate, p.direction
    observe(p.rules, p.per_rate, p.table, *now, p.seen, b, e)
    if p.time.shape[0] > 0:
        time_fractions(r.epochs[b:e], p.onset[b:e], p.rules[STEPS], p.time[b:e])
    if p.motion.shape[0] > 0:
        known = t.position_e, t.velocity_e, t.C_en, r.epochs[b:e], p.onset[b:e]
        local_motion(*known, p.scales[0], p.scales[1], p.motion[b:e])


def pick(p, seed, pasts):
    """Choose a past by episode, receiver and seed, where one is over; -1 elsewhere."""
    b = cuda.grid(1)
    if b >= p.picked.shape[0]:
        return
    p.picked[b] = -1
    if p.ended[b]:
        p.number[b] += 1
        word, _ = threefry(np.uint64(p.number[b]), np.uint64(b), seed[0], seed[1])
        p.picked[b] = np.int64(word % np.uint64(pasts))
        p.step_count[b] = 0
        p.undetected[b] = p.largest[0, b] = 0.0
        p.detected[b] = p.ended[b] = False


def renew(p, keys, seed, sources):
    """Draw new noise, by `sources` the keys that change, for receivers that have picked a past."""
    b = cuda.grid(1)
    if b >= p.picked.shape[0] or p.picked[b] < 0:
        return
    k0, k1 = threefry(np.uint64(p.number[b]), np.uint64(b), seed[0], seed[1])
    for i in range(sources.shape[0]):
        source = sources[i]
        key = threefry(np.uint64(source), np.uint64(0), k0, k1)
        keys[b, 2 * source], keys[b, 2 * source + 1] = key[0], key[1]


def take(to, past, picked):
    """Copy rows of a past, (M, k), to the receivers that have picked one."""
    b = cuda.grid(1)
    if b < to.shape[0] and picked[b] >= 0:
        for i in range(to.shape[1]):
            to[b, i] = past[picked[b], i]
