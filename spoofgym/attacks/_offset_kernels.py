"""Compiled loops of `Offsets`: commanded axes, and what they add to the measurements.

An axis is a slot of its own, or one of north, east, down, clock and residuals.  `orders` (B, S):
channel of every slot; `bases` (B, R): channels that give the residual axes their directions.
"""

import math
from collections import namedtuple

import numpy as np

from ..core.compile import njit
from ..core.simd import LANES
from ._kernels import add_displacement

SATELLITES, POSITION_CLOCK, ROTATED = range(3)
TINY = 1e-6  # shorter residuals of a unit vector have no direction
# `basis` by number, `by_offset`, limits of rate and acceleration, coherence, scales (a,) of 1.
Rules = namedtuple("Rules", "basis by_offset rate_limit acceleration_limit coherent scales")
# (B, a) what actions requested, without limits [m]; (B, n) captured channels, `orders`, `bases`,
# and (B, n) residual offsets of the epoch before [m].
Capturing = namedtuple("Capturing", "requested taken orders bases residual")
# What is computed of a receiver at an epoch, written over by the next: residual axes (R, n), the
# rows that they come from (4 + R, n), offsets (2, n), numbers by axis (a,) and a shift (6,);
# `lanes` is a lane array of 8 rows.
Scratch = namedtuple("Scratch", "axes rows out live wanted change shift lanes")


@njit
def name_rules(settings):
    """`Rules` of `Offsets.kernel_settings`."""
    numbers = settings[2], settings[3], settings[4] > 0.0, settings[5:]
    return Rules(int(settings[0]), settings[1] > 0.0, *numbers)


@njit
def measure_scratch(channels, axes, residuals):
    """Of the memory that `divide_offsets` takes; the last row is free for `lanes` of one."""
    return 2 * residuals + 11, max(channels, axes, 8)


@njit
def divide_offsets(work, channels, axes, residuals, lanes):
    """`Scratch` in memory of `measure_scratch`, and in a lane array."""
    r, n = 2 * residuals + 4, channels
    by_axis = work[r + 2, :axes], work[r + 3, :axes], work[r + 4, :axes]
    above = work[:residuals, :n], work[residuals:r, :n], work[r : r + 2, :n]
    return Scratch(*above, *by_axis, work[r + 5, :6], lanes)


@njit
def make_scratch(capturing):
    n, axes = capturing.taken.shape[1], capturing.requested.shape[1]
    residuals = capturing.bases.shape[1]
    work = np.zeros(measure_scratch(n, axes, residuals))
    return divide_offsets(work, n, axes, residuals, np.empty((8, LANES)))


@njit
def measure_size(vector, basis):
    """Bound of the size of every channel's part: the largest element of slots; else the length of
    the position, the clock, and the length of the residuals, together."""
    largest, position, residual = 0.0, 0.0, 0.0
    for i in range(vector.shape[0]):
        value = vector[i]
        largest = max(largest, abs(value))
        if i < 3:
            position += value * value
        elif i > 3:
            residual += value * value
    if basis == SATELLITES:
        return largest
    return math.sqrt(position) + abs(vector[3]) + math.sqrt(residual)


@njit
def find_axes(satellites, position, taken, base, axes, work):
    r"""Residual axes: unit vectors, orthogonal to the design matrix and to one another.

    With the unit vectors :math:`u_s` to the captured satellites in view, the columns of the design
    matrix are :math:`-u_s` and 1; each residual axis is what is left of the unit vector of one
    channel by the Gram-Schmidt process, twice for its rounding.

    `satellites` (n, 8), `position` (3,) of an epoch, ECEF [m]; `taken` (n,) bool; `base` (R,)
    channels; `axes` (R, n), written, 0 without one; `work` (4 + R, n), written over.
    """
    n = taken.shape[0]
    work[:] = 0.0
    for s in range(n):
        if taken[s] and satellites[s, 6] != 0.0:
            for i in range(3):
                work[i, s] = (position[i] - satellites[s, i]) / satellites[s, 6]
            work[3, s] = 1.0
    for row in range(work.shape[0]):
        if row >= 4:
            s = base[row - 4]
            work[row, s] = 1.0 if taken[s] and satellites[s, 6] != 0.0 else 0.0
        for _ in range(2):
            for before in range(row):
                along = 0.0
                for s in range(n):
                    along += work[before, s] * work[row, s]
                for s in range(n):
                    work[row, s] -= along * work[before, s]
        length = 0.0
        for s in range(n):
            length += work[row, s] * work[row, s]
        length = math.sqrt(length)
        for s in range(n):
            work[row, s] = work[row, s] / length if length > TINY else 0.0
    for row in range(axes.shape[0]):
        for s in range(n):
            axes[row, s] = work[4 + row, s]


@njit
def find_live(basis, order, taken, satellites, axes, live):
    """Which axes change a measurement at an epoch; `live` (a,), written."""
    for i in range(live.shape[0]):
        live[i] = basis != SATELLITES and i < 4
        if basis == SATELLITES:
            live[i] = taken[order[i]] and satellites[order[i], 6] != 0.0
        elif i >= 4:
            for s in range(axes.shape[1]):
                live[i] = live[i] or axes[i - 4, s] != 0.0


@njit
def follow(action, hold, tau, rules, displacement, rate, requested, w):
    r"""Move the amplitudes of one receiver to the end of an interval, in place.

    A wanted rate w is an action times its scale.  A wanted offset :math:`D^*` gives it by the
    difference over the interval, and a braking law for the distance e that limits have left: the
    largest rate from which n intervals of the largest deceleration a come to rest there,

    .. math:: w = \frac{D^* - D^*_-}{\tau} + \frac{e}{|e|}
        \left(\frac{|e|}{n \tau} + \frac{n - 1}{2} a \tau\right), \qquad
        n = \left\lceil \tfrac12 \sqrt{1 + \frac{8 |e|}{a \tau^2}} - \tfrac12 \right\rceil

    with :math:`e = D^*_- - D`.  The whole vector w is shortened to the limit of the rate, then its
    change to that of the acceleration, and :math:`D^+ = D + v^+ \tau`.
    """
    count, wanted, change = displacement.shape[0], w.wanted, w.change
    if hold:
        for i in range(count):
            displacement[i] += tau * rate[i]
            requested[i] += tau * rate[i]
        return
    for i in range(count):
        wanted[i] = change[i] = 0.0
        value = rules.scales[i] * min(max(action[i], -1.0), 1.0)
        if not w.live[i]:
            rate[i], requested[i] = 0.0, displacement[i]
        elif rules.by_offset:
            wanted[i], change[i] = (value - requested[i]) / tau, requested[i] - displacement[i]
            requested[i] = value
        else:
            wanted[i] = value
            requested[i] += tau * value
    step = rules.acceleration_limit * tau
    if rules.by_offset:
        left = measure_size(change, rules.basis)
        if left > 0.0:
            n = math.ceil(0.5 * math.sqrt(1.0 + 8.0 * left / (step * tau)) - 0.5)
            n = max(n, 1.0)
            for i in range(count):
                wanted[i] += change[i] * (1.0 / (n * tau) + 0.5 * (n - 1.0) * step / left)
    size = measure_size(wanted, rules.basis)
    shorter = rules.rate_limit / size if size > rules.rate_limit else 1.0
    for i in range(count):
        wanted[i] *= shorter
        change[i] = wanted[i] - rate[i]
    size = measure_size(change, rules.basis)
    for i in range(count):
        rate[i] = wanted[i] if size <= step else rate[i] + step / size * change[i]
        displacement[i] += tau * rate[i]


@njit
def add_axes(basis, order, taken, axes_e, target_error, truth, k, coherent, moved, rate, w):
    """Write what amplitudes `moved` (a,) and their rates add at epoch k, but for the rate of the
    residual axes, to ``w.out``; `axes_e` (K, 3, 6) as in `false_position`; `target_error` (6,)."""
    shift, out = w.shift, w.out
    for i in range(6):
        shift[i] = target_error[i]
    out[:] = 0.0
    if basis != SATELLITES:
        for i in range(3):
            for axis in range(3):
                shift[i] += moved[axis] * axes_e[k, axis, i]
                shift[3 + i] += rate[axis] * axes_e[k, axis, i]
                shift[3 + i] += moved[axis] * axes_e[k, axis, 3 + i]
    add_displacement(shift, truth, k, taken, coherent, out[0], out[1], w.lanes)
    if basis == SATELLITES:
        for i in range(order.shape[0]):
            s = order[i]
            if taken[s] and truth.satellites[k, s, 6] != 0.0:
                out[0, s] += moved[i]
                out[1, s] += rate[i] if coherent else 0.0
        return
    for s in range(taken.shape[0]):
        if taken[s] and truth.satellites[k, s, 6] != 0.0:
            out[0, s] += moved[3]
            out[1, s] += rate[3] if coherent else 0.0
            for r in range(w.axes.shape[0]):
                out[0, s] += w.axes[r, s] * moved[4 + r]


@njit
def command_offsets(
    commanded, capturing, axes_e, target_error, epochs, truth, _, d_range, d_rate, lo, hi
):
    """Command the axes of receivers lo to hi, and write what they add to the coming epoch."""
    w = make_scratch(capturing)
    for b in range(lo, hi):
        given = commanded, capturing, axes_e, target_error, epochs, truth, d_range, d_rate
        command_axes(*given, b, w)


@njit
def command_axes(commanded, capturing, axes_e, target_error, epochs, truth, d_range, d_rate, b, w):
    """`command_offsets` of receiver b.

    The range rates of the residual axes are the differences of their offsets over the interval;
    where the satellites in view change, so do the axes, and only the amplitudes' rates count.
    """
    rules, axes, n = name_rules(commanded.settings), w.axes, d_range.shape[1]
    k, taken, order = epochs[b] + 1, capturing.taken[b], capturing.orders[b]
    satellites, tau = truth.satellites[k], truth.epoch_time[k] - truth.epoch_time[k - 1]
    residuals = axes.shape[0]
    if residuals > 0:
        find_axes(satellites, truth.position_e[k], taken, capturing.bases[b], axes, w.rows)
    find_live(rules.basis, order, taken, satellites, axes, w.live)
    displacement, rate = commanded.displacement[b], commanded.rate[b]
    moved = displacement, rate, capturing.requested[b]
    follow(commanded.action[b], commanded.hold, tau, rules, *moved, w)
    known = order, taken, axes_e, target_error[b], truth, k, rules.coherent
    add_axes(rules.basis, *known, displacement, rate, w)
    for s in range(n):
        d_range[b, s], d_rate[b, s] = w.out[0, s], w.out[1, s]
    if residuals == 0 or not rules.coherent:
        return
    before, same = capturing.residual[b], True
    for s in range(n):
        seen = taken[s] and satellites[s, 6] != 0.0
        same = same and seen == (not math.isnan(before[s]))
    for s in range(n):
        seen, offset, part = taken[s] and satellites[s, 6] != 0.0, 0.0, 0.0
        for r in range(residuals):
            offset += axes[r, s] * displacement[4 + r]
            part += axes[r, s] * rate[4 + r]
        if seen:
            d_rate[b, s] += (offset - before[s]) / tau if same else part
        before[s] = offset if seen else math.nan


@njit
def list_offsets(
    amplitudes, settings, capturing, axes_e, target_error, epochs, truth, offsets, coming
):
    """Offsets of every slot by some amplitudes, at the epochs that receivers are at, and which axes
    are live at the next. `amplitudes` (B, a) [m]; `settings` of the attack; `offsets` (B, S) [m]
    and `coming` (B, a) bool, written."""
    w = make_scratch(capturing)
    for b in range(amplitudes.shape[0]):
        given = amplitudes, settings, capturing, axes_e, target_error, epochs, truth
        list_slots(*given, offsets, coming, b, w)


@njit
def list_slots(
    amplitudes, settings, capturing, axes_e, target_error, epochs, truth, offsets, coming, b, w
):
    """`list_offsets` of receiver b."""
    taken, order, base = capturing.taken[b], capturing.orders[b], capturing.bases[b]
    rules, last = name_rules(settings), truth.epoch_time.shape[0] - 1
    for ahead in range(2):
        k = min(epochs[b] + ahead, last)
        satellites = truth.satellites[k]
        if base.shape[0] > 0:
            find_axes(satellites, truth.position_e[k], taken, base, w.axes, w.rows)
        if ahead == 1:
            find_live(rules.basis, order, taken, satellites, w.axes, coming[b])
            continue
        w.wanted[:] = 0.0  # held still
        known = order, taken, axes_e, target_error[b], truth, k, False
        add_axes(rules.basis, *known, amplitudes[b], w.wanted, w)
        for i in range(order.shape[0]):
            offsets[b, i] = w.out[0, order[i]]
