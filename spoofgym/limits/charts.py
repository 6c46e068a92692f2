"""No-alarm sets of tests of innovations as constraints, a function per statistic.

Every function takes the program and the variables y (K, r), -1 where a row is not judged, and
writes down the recursion of the detector's own kernel with its memory at the onset, which is 0
without a shift.  A maximum over windows, onsets or rows of convex functions is convex, and each has
its own constraint.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..detectors.base import BoolArray, FloatArray, IntArray
from ..detectors.innovation_rate import FIRST_COVARIANCE, filter_sample
from .convex import Program, SparseRows

FIRST_ONSETS = 8  # onsets of a scan whose rows are there from the start, spaced by factors of two
FARTHEST_SD = 1e5
"""Size of an innovation from which on a scan that never binds counts as unbounded [SD]."""
VIOLATED = 1e-7  # part of a limit by which a row must be violated to be added


def hold_size(program: Program, y: IntArray, limits: FloatArray) -> None:
    """Every row by itself below a limit (K, r) or (K, 1), a Shewhart chart."""
    judged = y >= 0
    sizes = program.variables(judged, -limits, limits)
    program.equal(np.column_stack([y[judged], sizes[judged]]), np.array([[1.0, -1.0]]))


def hold_norm(program: Program, y: IntArray, limits: FloatArray) -> None:
    """Squared norm of every epoch below a limit (K,), a snapshot chi-square test."""
    for row, limit in zip(y, limits, strict=True):
        program.ball(row, float(np.sqrt(limit)))


def hold_moving_sum(
    program: Program, y: IntArray, limits: FloatArray, judged: BoolArray, shape: FloatArray
) -> None:
    """Normalized sum of every row over a window below a limit (K, r), a finite moving average.
    `judged` (L + K, r): epochs that count, with the L before the onset; `shape` (W,): their
    weights, the newest first."""
    squares = np.apply_along_axis(np.convolve, 0, judged, shape * shape)
    before, window = len(judged) - len(y), len(shape)
    root = np.sqrt(squares[before : len(judged)])
    padded = np.vstack([np.full((window - 1, y.shape[1]), -1), y])
    summed = np.lib.stride_tricks.sliding_window_view(padded, window, axis=0)[y >= 0]
    total = program.variables(y >= 0, -limits, limits)[y >= 0]
    values = np.tile(shape[::-1], (len(total), 1)) / root[y >= 0][:, None]
    columns = np.column_stack([summed, total])
    program.equal(columns, np.column_stack([values, np.full(len(total), -1.0)]))


def hold_energies(program: Program, y: IntArray, limits: FloatArray, windows: IntArray) -> None:
    """Sums of the squared norms of windows of several lengths below their limits (K, L)."""
    shares = limits / np.minimum(windows, len(y))
    finite = shares[np.isfinite(shares)]
    unit = float(np.sqrt(np.median(finite))) if len(finite) else 1.0  # so that energies are near 1
    energy = program.variables(np.asarray((y >= 0).any(axis=1)), 0.0)
    for row, one in zip(y, energy, strict=True):
        if one >= 0:
            program.energy(row, int(one), unit)
    for k in range(len(y)):
        tightest: dict[int, float] = {}  # windows that reach back to the onset have the same sum
        for window, limit in zip(windows, limits[k], strict=True):
            first = max(k - int(window) + 1, 0)
            tightest[first] = min(tightest.get(first, np.inf), float(limit))
        for first, limit in tightest.items():
            summed = energy[first : k + 1]
            summed = summed[summed >= 0]
            if len(summed) and np.isfinite(limit):  # over the limit, so that rows are of size 1
                values = np.full((1, len(summed)), unit * unit / limit)
                program.below(summed[None], values, 1.0)


def hold_cusum(program: Program, y: IntArray, limits: FloatArray, drift: FloatArray) -> None:
    """Two-sided cumulative sum of every row below a limit (K, 1), with a drift (K, r)."""
    for sign in (1.0, -1.0):
        total = program.variables(y >= 0, 0.0, limits)
        for k in range(len(y)):
            before = total[k - 1] if k else np.full_like(total[k], -1)
            columns = np.column_stack([y[k], before, total[k]])[y[k] >= 0]
            values = np.array([[sign, 1.0, -1.0]])
            program.below(columns, values, drift[k][y[k] >= 0])


def running_sums(
    program: Program, y: IntArray, known: IntArray, added: IntArray | None = None
) -> IntArray:
    """(K, r) sums of every row, or of what is added, since it came into view, or the onset."""
    total, judged = program.variables(y >= 0), y >= 0
    parts = y if added is None else added, back(total, known, np.ones_like(known)), total
    columns = np.column_stack([each[judged] for each in parts])
    program.equal(columns, np.array([[1.0, 1.0, -1.0]]))
    return total


def back(ids: IntArray, known: IntArray, by: IntArray) -> IntArray:
    """Variables (K, r) of `by` (K, r) epochs ago, -1 before the row came into view or the run
    began; `known` (K, r): values before the present one."""
    k, j = np.indices(ids.shape)
    there = (by <= known) & (by <= k)
    return np.where(there, ids[np.where(there, k - by, 0), j], -1)


def hold_lag_cusum(
    program: Program,
    y: IntArray,
    limits: FloatArray,
    known: IntArray,
    lag: int,
    baseline: int,
    drift: float,
    sds: float,
) -> None:
    """Cumulative sums against a lagged mean; `known` (K, r), `sds` of the mean's own error."""
    total = running_sums(program, y, known)
    end = np.maximum(known - lag, (known + 1) // 2)
    m = np.maximum(np.minimum(end, baseline), 1)
    newest = back(total, known, known - end + 1)
    oldest = back(total, known, known - end + 1 + m)
    change = program.variables((y >= 0) & (end > 0))
    judged = change >= 0
    columns = np.column_stack([each[judged] for each in (y, newest, oldest, change)])
    share = 1.0 / m[judged]
    ones = np.ones_like(share)
    program.equal(columns, np.column_stack([ones, -share, share, -ones]))
    hold_cusum(program, change, limits, np.maximum(drift, sds / np.sqrt(m)))


def hold_averages(
    program: Program, y: IntArray, limits: FloatArray, past: IntArray, windows: IntArray
) -> None:
    """Squared norm of the normalized sum over each window below a limit (K,). `past` (r,): epochs
    before the onset in which each row was judged."""
    judged = y >= 0
    total = program.variables(np.ones(y.shape, dtype=np.bool_))
    before = np.vstack([np.full_like(total[:1], -1), total[:-1]])
    columns = np.column_stack([each.ravel() for each in (y, before, total)])
    program.equal(columns, np.array([[1.0, 1.0, -1.0]]))
    seen = np.cumsum(judged, axis=0)
    for window in windows:
        for k in range(len(y)):
            early = k < window
            count = seen[k] - (0 if early else seen[k - window])
            if early:  # epochs without a shift fill the rest of the window
                count = count + np.minimum(past, window - 1 - k)
            now = judged[k]
            oldest = np.full_like(total[k], -1) if early else total[k - window]
            root = np.sqrt(count[now])
            mean = program.variables(np.ones(int(now.sum()), dtype=np.bool_))
            columns = np.column_stack([total[k][now], oldest[now], mean])
            program.equal(columns, np.column_stack([1.0 / root, -1.0 / root, -np.ones(len(root))]))
            program.ball(mean, float(np.sqrt(limits[k])))


def hold_common(program: Program, y: IntArray, limits: FloatArray, past: int, window: int) -> None:
    """Squared norm of the normalized sum of a window of common parts below a limit (K,)."""
    taken = np.asarray((y >= 0).any(axis=1))
    for k in np.flatnonzero(taken):
        first = max(int(k) - window + 1, 0)
        count = int(taken[first : k + 1].sum()) + min(past, max(window - 1 - int(k), 0))
        total = program.variables(np.ones(y.shape[1], dtype=np.bool_))
        columns = np.column_stack([y[first : k + 1].T, total])
        ones = np.ones((len(total), k + 1 - first))
        program.equal(columns, np.column_stack([ones, -np.ones(len(total))]))
        program.ball(total, float(np.sqrt(limits[k] * count)))


def hold_scan(
    program: Program,
    y: IntArray,
    limits: FloatArray,
    known: IntArray,
    window: int,
    baseline: int,
    ramp: bool,
) -> None:
    """Evidence of a step or ramp since every onset below a limit (K, r); `known` (K, r). Each onset
    is a linear row of size at most the root of the limit; those that bind are added."""
    judged = y >= 0
    total = running_sums(program, y, known)
    area = total  # of a ramp, sums of the running sums before each epoch
    if ramp:
        area = running_sums(program, y, known, back(total, known, np.ones_like(known)))
    root = np.sqrt(limits)

    def row(n: int) -> tuple[IntArray, FloatArray, BoolArray]:
        """Columns, values (K, r, 5) and whether there is such an onset."""
        m = np.minimum(known + 1 - n, baseline)
        by = np.full_like(known, n)
        before, old = back(total, known, by), back(total, known, by + m)
        early, sides = back(area, known, by), np.maximum(m, 1)
        columns = np.stack([total, before, old, area, early], axis=2)
        values = np.stack(split(float(n), sides.astype(np.float64), ramp), axis=2)
        return columns, values, judged & (known >= n)

    def cut(point: FloatArray) -> SparseRows | None:
        worst = np.full(y.shape, 0.0)
        chosen = np.zeros((*y.shape, 5), dtype=np.int64), np.zeros((*y.shape, 5))
        for n in range(1, window + 1):
            columns, values, there = row(n)
            size = (point[columns] * values).sum(axis=2)
            larger = there & (np.abs(size) - root > VIOLATED * root) & (np.abs(size) > worst)
            worst[larger] = np.abs(size)[larger]
            chosen[0][larger] = columns[larger]
            chosen[1][larger] = (np.sign(size)[:, :, None] * values)[larger]
        found = worst > 0.0
        rows = SparseRows(chosen[0][found], chosen[1][found], root[found])
        return rows if found.any() else None

    for n in 2 ** np.arange(FIRST_ONSETS):
        if n <= window:
            columns, values, there = row(int(n))
            for sign in (1.0, -1.0):
                program.below(columns[there], sign * values[there], root[there])
    program.lazily(cut, y, FARTHEST_SD)


def split(n: float, m: FloatArray, ramp: bool) -> list[FloatArray]:
    """Factors of `hold_scan`'s sums now, before the onset and before the baseline, and of its area
    now and before the onset: with them they add up to the root of the evidence."""
    nothing = np.zeros_like(m)
    if not ramp:
        scale = 1.0 / np.sqrt(n * m * (n + m))
        return [m * scale, -(m + n) * scale, n * scale, nothing, nothing]
    area = 0.5 * n * (n + 1.0)
    ramps = (n + m) * (area * (2.0 * n + 1.0) / 3.0 * (n + m) - area * area)
    scale = 1.0 / np.sqrt(ramps)
    moment = (n + m) * scale
    return [moment * n - area * scale, nothing, area * scale, -moment, moment]


class RateFilter(NamedTuple):
    """Settings of the filter of the rate of an innovation, as `advance` takes them."""

    interval_s: float
    correlation: float
    noise: float
    growth: float

    def gains(self, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(3, 3) and (3,) x' = A x + b sample, by the detector's kernel; moves the covariance."""
        columns = []
        for start, sample in [*((row, 0.0) for row in np.eye(3)), (np.zeros(3), 1.0)]:
            state, P = start.copy(), covariance.copy()
            filter_sample(state, P, sample, *self)
            columns.append(state)
        covariance[:] = P
        return np.column_stack(columns[:3]), columns[3]


def hold_rate(
    program: Program,
    y: IntArray,
    limits: FloatArray,
    live: BoolArray,
    started: BoolArray,
    filtered: RateFilter,
) -> None:
    """Rate of every row below a limit (K, r). `live` (L, r): whether a row gave a sample in each
    epoch before the onset; `started` (K,): whether samples are taken."""
    for j in range(y.shape[1]):
        covariance = np.array(FIRST_COVARIANCE)
        for taken in live[:, j]:
            if taken:
                filtered.gains(covariance)
        least = min(1.0, float(limits[:, j].min()))
        unit = np.array([1.0, least, least])  # so that all states are near 1
        state = np.full(3, -1)
        for k in range(len(y)):
            if y[k, j] < 0:
                state, covariance = np.full(3, -1), np.array(FIRST_COVARIANCE)
                continue
            if started[k]:
                A, b = filtered.gains(covariance)
                A, b = A * unit / unit[:, None], b / unit
                top = np.array([np.inf, limits[k, j] / unit[1], np.inf])
                new = program.variables(np.ones(3, dtype=np.bool_), -top, top)
                columns = np.column_stack([np.tile(np.append(state, y[k, j]), (3, 1)), new])
                program.equal(columns, np.column_stack([A, b, -np.ones(3)]))
                state = new
