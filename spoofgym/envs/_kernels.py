"""Compiled loops of the game."""

from __future__ import annotations

import math

import numpy as np

from .._jit import njit


@njit
def displace(position_e, true_position_e, epochs, target_e, origin, displacement):
    """Displacements along the target direction.

    Parameters
    ----------
    position_e, true_position_e : ndarray
        (B, 3) estimated, and (K, 3) true, ECEF [m].
    epochs : ndarray
        (B,) the epoch that each receiver is at.
    target_e : ndarray
        (3,) direction in which displacement counts, ECEF.
    origin : ndarray
        (B,) projected error at the onset [m].
    displacement : ndarray
        (B,), written [m].
    """
    for b in range(displacement.shape[0]):
        k = epochs[b]
        total = 0.0
        for i in range(3):
            total += (position_e[b, i] - true_position_e[k, i]) * target_e[i]
        displacement[b] = total - origin[b]


@njit
def score(
    displacement,
    alarms,
    steps,
    hold,
    step_count,
    detected,
    largest,
    gain,
    retraction,
    alarm,
    first,
    finished,
):
    """Keep the books of one step of every receiver.

    Parameters
    ----------
    displacement : ndarray
        (B,) error along the target direction, less that at the onset [m].
    alarms : ndarray
        (B, c) bool, of the verdict.
    steps, hold : int
        Commands of an episode, and epochs of the time to alert.
    step_count : ndarray
        (B,) commands before this one; one more after it.
    detected : ndarray
        (B,) bool, whether there was an alarm before this step.
    largest : ndarray
        (B, steps + 1) largest displacement so far after each step, this one's is written [m].
    gain, retraction : ndarray
        (B,), written [m].
    alarm, first, finished : ndarray
        (B,) bool, written: any alarm, the first alarm, the last command.
    """
    for b in range(step_count.shape[0]):
        # a receiver whose episode is over may be stepped once more before it is reset
        step_count[b] += 1
        j = min(step_count[b], steps)
        before = largest[b, j - 1]
        now = max(before, displacement[b])
        largest[b, j] = now
        any_alarm = False
        for c in range(alarms.shape[1]):
            any_alarm = any_alarm or alarms[b, c]
        alarm[b] = any_alarm
        first[b] = any_alarm and not detected[b]
        quiet = not any_alarm and not detected[b]
        gain[b] = now - before if quiet else 0.0
        retraction[b] = largest[b, max(j - hold - 1, 0)] - before if first[b] else 0.0
        finished[b] = step_count[b] == steps


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

    Parameters
    ----------
    transition, design, predicted_cov, innovation_cov, visible
        Phi, H, P, S of `Epoch`.
    weights : ndarray
        (B, 2n) on the columns of the gain.
    min_satellites : int
        With fewer visible satellites there is no update.
    range_offset, rate_offset : ndarray
        (B, n) what the attack adds [m], [m/s].
    shift : ndarray
        (B, 17) of the filter's error, overwritten.
    divergence : ndarray
        (B,) [nats], added to.
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
        if m < 2 * min_satellites:
            continue
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
