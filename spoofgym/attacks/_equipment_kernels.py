"""Compiled loops of a spoofer's equipment.

The noise of epoch k belongs to the counters 2 k and 2 k + 1 of the attack's key: the first for what
moves, the second for what is drawn again.  An attack measures only epochs after its onset, so that
the first counter of the onset is free for what an episode starts with.
"""

from __future__ import annotations

import math

import numpy as np

from .._jit import njit
from ..sim.clock import advance_clock
from ..sim.noise import exponential, normals

MOVING = 64
"""Deviates of an epoch for what moves: three axes of two, and two of the clock."""


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
def delayed(k, delay, epoch_time, position_e, velocity_e, out):
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
def advance(
    keys,
    epochs,
    epoch_time,
    position_e,
    velocity_e,
    sd,
    beta,
    delay,
    phase_psd,
    frequency_psd,
    bias,
    C_en,
    axes_turning,
    wander,
    clock,
    target_error,
    lo,
    hi,
):
    """Error of the known position and clock of every spoofer at the coming epoch.

    `keys` (B, 2) of the attack's noise; `epochs` (B,) epoch that each receiver is at; `sd`, `beta`,
    `delay`: of the tracking error [m], [1/s], [s]; `bias` (3,) constant error in the local axes
    [m], which are `C_en`, `axes_turning` (K, 3, 3) at all epochs, with their rate of change;
    `wander` (B, 3, 2) wandering error and its rate, ECEF; advanced; `clock` (B, 2) offset [m] and
    drift [m/s]; advanced; `target_error` (B, 6), written: position [m] and velocity [m/s], ECEF.
    """
    noise = np.empty(MOVING)
    for b in range(lo, hi):
        k = epochs[b] + 1
        tau = epoch_time[k] - epoch_time[k - 1]
        normals(keys[b, 0], keys[b, 1], 2 * k, noise)
        error = target_error[b]
        if delay > 0.0:
            delayed(k, delay, epoch_time, position_e, velocity_e, error)
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
        clock[b, 0], clock[b, 1] = advance_clock(
            clock[b, 0], clock[b, 1], tau, phase_psd, frequency_psd, noise[6], noise[7]
        )


@njit
def transmit(
    keys,
    onsets,
    epochs,
    epoch_time,
    satellites,
    chosen,
    coherent,
    delay,
    alignment,
    clock,
    replaced,
    sds,
    blend,
    bias,
    size,
    captured,
    capture_time,
    authentic,
    d_range,
    d_rate,
    lo,
    hi,
):
    """Make of perfect offsets what the receivers get: captured or not, with clock and errors.

    `keys`, `onsets`, `epochs` (B, 2) of the attack's noise, (B,) epochs of the onset, (B,) of the
    receivers; `chosen` (n,) bool, channels that are counterfeited; `clock` (B, 2) of the spoofer;
    `sds` (2,) of noise of pseudoranges and range rates, below 0 for the receiver's own; `blend`:
    time in which the authentic errors fade [s]; `bias` (B, n) their constants [m]; `captured`,
    `capture_time` (B, n) bool, which channels follow the counterfeit signal, and since when [s];
    advanced; `authentic` (B, 2n), written: part of the authentic errors that stays, -1 where the
    receiver's own noise goes, too; `d_range`, `d_rate` (B, n), overwritten.
    """
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
