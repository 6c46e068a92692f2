"""Kernels of a device, a thread a receiver: they call the library's functions, and have no physics.

Every function of the library gets a batch of one, whose arrays are views of the thread's receiver.
Arrays of receivers have their axis first, (B, ...), and lie in memory with it last, so that
neighbouring threads read neighbouring numbers.
"""

from collections import namedtuple

import numpy as np
from numba import cuda

from ..attacks._kernels import Commanded, displace_antenna, per_channel
from ..attacks._offset_kernels import Capturing, command_axes, divide_offsets, list_slots
from ..detectors.base import is_sound
from ..detectors.charts import find_largest_sizes, judge_channels
from ..detectors.chi_square import window_sum
from ..detectors.cusum import advance_sums
from ..envs import _kernels as envs
from ..receiver import _kernels as receiver
from ..receiver.kalman import square_all
from ..simulation import _kernels as simulation
from ..simulation.simulator import FARTHEST
from ..simulation.tight import AFTER_ONSET
from ..truth.noise import threefry
from ..truth.run import EpochTruth
from ..truth.sensors import SOURCES

DOMAIN = 2 * SOURCES.index("domain")  # first word of its key
RENEWED = tuple(SOURCES.index(name) for name in AFTER_ONSET)  # at the onset
OFFSETS = 1 + max(simulation.FALSE_POSITION, simulation.PER_CHANNEL)
NEVER, EWMA, PASSIVE_EWMA, SHEWHART, CUSUM, SNAPSHOT, WINDOWED = range(7)
ATTACKED, JUDGED, ALL = 1, 2, 3
UNSOUND, DIVERGED = 1, 2  # what a thread finds, in `faults`

# What lasts of every receiver: `x` to `coasting` of `ReceiverBuffers`, `sensors` to `signals` of
# `SensorBuffers`, then of `PastPositions`, `displacement` to `residual` of an attack, `covariance`
# of innovations, a view of `out`, `first` to `judged` of the detector, `statistic` to `weights` of
# its verdict; then scratch memory of kernels, and what they have found.
Receivers = namedtuple(
    "Receivers",
    "x assumed out visible coasting sensors constants keys epochs range_offset rate_offset in_run "
    "signals past_position past_epochs displacement rate target_error requested taken orders bases "
    "residual covariance first second judged statistic threshold alarm weights work spans "
    "offset_work faults",
)
# What all receivers share: truth and rules as in `Arrays`, then of attack and detector.
Shared = namedtuple(
    "Shared",
    "run epoch_time epoch_end satellites position_e velocity_e C_en axes_e captured slots "
    "attack_settings rules places mappings settings limits",
)
# Episodes, as in `SpoofCore`: `action` and `before` (B, k), the last decisions, of which `now` is
# made and, by `matrix` (B, a, k), the `command` (B, a); `pace`: epochs of a decision, and whether
# it is linear between; `sums`: `values` of its earlier epochs; `number` (B,) of the episode;
# `motion` (B, 6), `time` (B, 2), `error` (B, 3), and, where there are any, what is `reported`
# (B, 3), offsets (B, S) and `action_mask` (B, a) are observed.
Episodes = namedtuple(
    "Episodes",
    "action before now command matrix following pace onset direction origin warmup_alarm "
    "step_count undetected largest detected ended no_rows values sums marks rules per_rate table "
    "seen number picked motion scales time error reported report_rules offsets_m "
    "requested_offsets_m action_mask",
)


def judge(r, t, w, b, detector):
    """Judge an epoch of receiver b, and write what its verdict is."""
    e, n, s = b + 1, r.visible.shape[1], t.settings
    visible, at = r.visible[b:e], t.places
    innovation = r.out[b:e, at[0] : at[0] + 2 * n]
    variance = r.out[b:e, at[1] : at[1] + 2 * n]
    statistic, threshold, weights = r.statistic[b:e], r.threshold[b:e], r.weights[b:e]
    first, last, seen = int(s[4]), int(s[5]), 0
    for j in range(n):
        seen += 1 if visible[0, j] else 0
    if EWMA <= detector <= PASSIVE_EWMA:
        chart = r.first[b:e], r.second[b:e], statistic, threshold
        judge_channels(innovation, variance, visible, s[0], s[1], s[2], *chart, weights)
    elif detector == SHEWHART:
        find_largest_sizes(innovation, variance, visible, first, last, statistic)
    elif detector == CUSUM:
        sums = r.first[b:e], r.second[b:e]
        advance_sums(innovation, variance, visible, first, last, s[0], *sums, statistic)
    elif detector >= SNAPSHOT:
        belief = r.covariance[b:e, first:last, first:last]
        square_all(innovation[:, first:last], belief, w.rest, statistic[0])
        if detector == WINDOWED:
            threshold[0, 0] = s[1] * seen  # rows of the epoch, then those of the window
            past = r.first[b:e], r.second[b:e], r.judged[b:e]
            epoch = statistic[0], threshold[0]
            window_sum(*epoch, int(s[0]), *past, *epoch)
            seen = int(threshold[0, 0])
    for c in range(statistic.shape[1] if detector >= SHEWHART else 0):
        threshold[0, c] = t.limits[seen] if detector >= SNAPSHOT else s[1]
    if not is_sound(statistic, threshold, weights):
        r.faults[b] |= UNSOUND
    for c in range(statistic.shape[1]):
        threshold[0, c] = s[3] * threshold[0, c]
        r.alarm[b, c] = statistic[0, c] > threshold[0, c]
    if detector == PASSIVE_EWMA:
        weights[:] = 1.0


def name_offsets(r, b):
    """What an attack by offsets remembers of receiver b, and its scratch memory."""
    e, work, n = b + 1, r.offset_work[b], r.visible.shape[1]
    known = r.requested[b:e], r.taken[b:e], r.orders[b:e], r.bases[b:e], r.residual[b:e]
    sizes = n, r.requested.shape[1], r.bases.shape[1]
    return Capturing(*known), divide_offsets(work, *sizes, work[work.shape[0] - 1])


def move_attack(r, t, w, b, command, hold, attack):
    """Let the attack write what it adds to the coming epoch of receiver b."""
    e = b + 1
    offsets = r.range_offset[b:e], r.rate_offset[b:e]
    moved = r.displacement[b:e], r.rate[b:e]
    commanded, epochs = Commanded(command, hold, t.attack_settings, *moved), r.epochs[b:e]
    truth = EpochTruth(t.epoch_time, t.satellites, t.position_e, t.velocity_e)
    error = r.target_error[b:e]
    if attack == simulation.FALSE_POSITION:
        rest = epochs, truth, t.captured, *offsets, 0, w.solution[8:14], w.solution[:8]
        displace_antenna(commanded, t.axes_e, error, *rest)
    elif attack == simulation.PER_CHANNEL:
        per_channel(commanded, t.slots, epochs, truth, t.captured, *offsets, 0, 1)
    elif attack == OFFSETS:
        capturing, scratch = name_offsets(r, b)
        command_axes(commanded, capturing, t.axes_e, error, epochs, truth, *offsets, 0, scratch)


def run_receiver(r, t, b, command, hold, attack, detector, what):
    """An epoch of receiver b; `command` (1, a). Whether its detector alarms."""
    e = b + 1
    assumed, constants = r.assumed[b % r.assumed.shape[0]], r.constants[b % r.constants.shape[0]]
    shown = assumed, r.out[b], t.places, r.visible[b:e], r.coasting[b:e]
    measured = r.sensors[b], constants, r.keys[b], r.epochs[b:e]
    authentic = r.out[:0, : r.weights.shape[1]]  # all of them
    added = r.range_offset[b:e], r.rate_offset[b:e], authentic, r.in_run[b]
    known = t.run, t.epoch_time, t.epoch_end, t.satellites, t.rules, r.signals[b], t.mappings
    a = receiver.Arrays(r.x[b], *shown, *measured, *added, *known)
    w = receiver.divide_scratch(a, r.work[b], r.spans[b])
    if what & ATTACKED:
        move_attack(r, t, w, b, command, hold, attack)
    receiver.predict_group(a, w, 0, receiver.MEASURE | receiver.PREDICT | receiver.SHOW)
    alarmed = False
    if what & JUDGED and detector != NEVER:
        judge(r, t, w, b, detector)
        for c in range(r.alarm.shape[1]):
            alarmed = alarmed or r.alarm[b, c]
    receiver.update_group(a, w, 0, r.weights[b:e])
    position, past = r.out[b:e, 2:5], (r.past_position[b:e], r.past_epochs[b:e])
    if simulation.find_diverged(position, FARTHEST) >= 0:
        r.faults[b] |= DIVERGED
    if what & JUDGED and past[1].shape[1] > 0:
        simulation.remember_positions(position, r.epochs[b:e], *past)
    return alarmed


def age(r, t, alarmed, ratio, left, command, count, hold, attack, detector, what):
    """Run the epochs that are `left` (B,), at most `count`, attacked or not; `command` (B, a);
    `alarmed`, `ratio` (B,): alarms, and the largest ratio of statistic to threshold, so far."""
    b = cuda.grid(1)
    for _ in range(min(count, left[b]) if b < left.shape[0] else 0):
        if run_receiver(r, t, b, command[b : b + 1], hold, attack, detector, what):
            alarmed[b] = True
        for c in range(r.statistic.shape[1] if what & JUDGED else 0):
            ratio[b] = max(ratio[b], r.statistic[b, c] / r.threshold[b, c])
        left[b] -= 1


def play_step(r, t, p, attack, detector):
    """A decision of every receiver, up to the end of its episode, as `SpoofCore` runs it."""
    b = cuda.grid(1)
    if b >= r.epochs.shape[0]:
        return
    repeat, alarmed, e = p.pace[0], False, b + 1
    for k in range(repeat):
        if p.ended[b]:
            break
        for i in range(p.now.shape[1]):
            action, before = p.action[b, i], p.before[b, i]
            linear = p.pace[1] > 0 and k + 1 < repeat
            way = (k + 1) / repeat * (action - before)
            p.now[b, i] = p.command[b, i] = before + way if linear else action
        if p.matrix.shape[2] > 0:
            given = p.matrix[b:e], p.following, r.rate[b:e]
            envs.follow_rate(p.now[b:e], *given, p.command[b:e])
        play_scored(r, t, p, b, attack, detector)
        if k > 0:
            add_earlier(p.values, p.sums, b)
        p.marks[envs.ALARM, b] = alarmed = alarmed or p.marks[envs.ALARM, b]
        for row in range(p.values.shape[0]):
            p.sums[row, b] = p.values[row, b]
    envs.report_loudest(r.statistic[b:e], r.threshold[b:e], p.values[:, b])


def add_earlier(values, sums, b):
    """Count the earlier epochs of a decision, as `StepResult.add` does."""
    last = values.shape[0]
    values[envs.COST, b] = sums[envs.COST, b] + values[envs.COST, b]
    for row in range(envs.PARTS, last + envs.REWARD):
        values[row, b] = sums[row, b] + values[row, b]
    values[last + envs.REWARD, b] = 0.0
    for row in range(envs.PARTS, last + envs.GAIN):
        values[last + envs.REWARD, b] += values[row, b]


def play_scored(r, t, p, b, attack, detector):
    """An epoch of receiver b, as `envs._kernels.play_epoch` runs it, and its time to alert."""
    e, count, first, held = b + 1, 1 + int(p.rules[envs.HOLD]), 0, False
    for k in range(count):
        if k > 0 and not held:
            break
        alarmed = run_receiver(r, t, b, p.command[b:e], k > 0, attack, detector, ALL)
        if k > 0:
            first = k if alarmed and first == 0 else first
            continue
        aim = r.epochs[b:e], p.direction[b:e], p.rules[envs.WORST] > 0.0, p.origin[b:e]
        out = p.values[envs.DISPLACEMENT, b:e]
        simulation.displace(r.out[b:e, 2:5], t.position_e, r.epochs[b:e], t.C_en, *aim, out, 0, 1)
        progress = p.step_count, p.detected, p.ended, p.undetected, p.largest
        held = envs.score(r.alarm, p.no_rows, p.rules, *progress, p.values, p.marks, b, e)
    if held:
        so_far = p.step_count, p.detected, p.undetected, p.largest
        envs.score_late(first, b, count - 1, int(p.rules[envs.STEPS]), *so_far, p.values, p.marks)
    progress = p.detected, p.ended, p.undetected, p.no_rows, p.warmup_alarm, r.coasting, r.epochs
    envs.settle(p.rules, *progress, p.values, p.marks, b, e)


def look(r, t, p):
    """Write what terms observe now, but for what is at hand."""
    b = cuda.grid(1)
    if b >= r.epochs.shape[0]:
        return
    e = b + 1
    now, at = (r.epochs, r.displacement, r.rate, p.direction), (r.epochs[b:e], p.onset[b:e])
    envs.observe(p.rules, p.per_rate, p.table, *now, p.seen, b, e)
    envs.time_fractions(*at, p.rules[envs.STEPS], p.time[b:e])
    true = t.position_e, t.velocity_e, t.C_en
    simulation.local_motion(*true, *at, p.scales[0], p.scales[1], p.motion[b:e])
    simulation.local_error(r.out[b:e, 2:5], t.position_e, t.C_en, at[0], p.error[b:e])
    if p.report_rules.shape[0] > 0:
        past, key = (r.past_position[b:e], r.past_epochs[b:e]), r.keys[b:e, DOMAIN : DOMAIN + 2]
        rest = key, t.position_e, t.C_en, p.report_rules, p.reported[b:e]
        simulation.read_reports(*past, *at, *rest)
    if p.action_mask.shape[0] > 0:
        capturing, w = name_offsets(r, b)
        truth = EpochTruth(t.epoch_time, t.satellites, t.position_e, t.velocity_e)
        rest = t.axes_e, r.target_error[b:e], r.epochs[b:e], truth
        known, coming = (t.attack_settings, capturing, *rest), p.action_mask[b:e]
        list_slots(r.displacement[b:e], *known, p.offsets_m[b:e], coming, 0, w)
        list_slots(r.requested[b:e], *known, p.requested_offsets_m[b:e], coming, 0, w)


def pick(p, keys, pasts, seed):
    """Choose a past by episode, receiver and seed, where one is over, -1 elsewhere, and draw the
    keys of noise that goes on; the others are those of the `pasts` (M, k)."""
    b = cuda.grid(1)
    if b >= p.picked.shape[0]:
        return
    p.picked[b] = -1
    if not p.ended[b]:
        return
    p.number[b] += 1
    k0, k1 = threefry(np.uint64(p.number[b]), np.uint64(b), seed[0], seed[1])
    past = np.int64(k0 % np.uint64(pasts.shape[0]))
    for i in range(keys.shape[1]):
        keys[b, i] = pasts[past, i]
    for source in RENEWED:
        key = threefry(np.uint64(source), np.uint64(0), k0, k1)
        keys[b, 2 * source], keys[b, 2 * source + 1] = key[0], key[1]
    for i in range(p.action.shape[1]):
        p.action[b, i] = p.before[b, i] = 0.0
    p.picked[b], p.step_count[b] = past, 0
    p.undetected[b] = p.largest[0, b] = 0.0
    p.detected[b] = p.ended[b] = False


def take(to, past, picked):
    """Copy rows of a past, (M, k), to the receivers that have picked one."""
    b = cuda.grid(1)
    if b < to.shape[0] and picked[b] >= 0:
        for i in range(to.shape[1]):
            to[b, i] = past[picked[b], i]
