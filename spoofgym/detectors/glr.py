r"""Generalized likelihood-ratio tests for a change of every satellite's innovation.

The normalized innovations of a satellite are split at every possible onset of the last W epochs
into a baseline before it, of unknown mean, and the n epochs since.  For each split the evidence of
a change is, for a step and for a ramp of unknown size,

.. math::
    q_n = \frac{(\bar y - \bar x)^2}{1/n + 1/m}, \qquad
    q_n = \frac{\left(\sum_i i \, (y_i - \bar z)\right)^2}
        {\tfrac{n (n + 1) (2 n + 1)}{6} - \tfrac{n^2 (n + 1)^2}{4 (n + m)}},

each chi-square with one degree of freedom where nothing changes, and the statistic is the largest
over n.  An alarm is raised above the quantile of probability
:math:`P_{fa} / (W \cdot \text{series})`, Bonferroni's bound.

Symbols: x the m baseline epochs, at most `baseline`; y the n epochs since the onset; z all of them;
W `window`; series: visible satellites times signals.

The baseline takes out a satellite's constant bias, for which a CUSUM or an average alarms.

Assumptions: normalized innovations are independent and of variance 1 about their mean, and epochs
equally spaced.  The W values of an epoch hang together, so that `false_alarm` is a bound, not a
rate: for 5 % steps alarm in 1.1 % of the epochs and ramps in 0.3 % where the receiver assumes the
noise of its world; in the papers' receiver, which overstates its noise, alarms are rarer still.

Deviations: `willsky1976` tests for the filter's answer to a jump.  Here the change is taken to stay
in the innovation as it is, as in a filter that follows an offset slowly, or not at all.  A
satellite that sets and rises starts again.  Every onset of the window is tried, at every epoch.

Source: `willsky1976`; the use as what `ke2022` lacks, a test that is not given the attack, is ours.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from ..core.compile import inline_njit, njit
from ..core.declared import settings_record
from ..receiver.epoch import Epoch
from .base import BoolArray, DetectorContext, FloatArray, IntArray, Verdict
from .innovation import (
    InnovationTest,
    alarm_probability,
    signals_to_test,
    two_sided_quantile,
    window_epochs,
)


@njit
def split_factors(count: int, onsets: int, baseline: int, ramp: bool, factors: FloatArray) -> None:
    r"""What the evidence takes from the lengths n and m alone, for the newest onsets.

    For a step, and for a ramp whose first epoch is 1, with everything over one denominator,

    .. math::
        q &= \frac{(m \sum y - n \sum x)^2}{n m (n + m)}, \\
        q &= \frac{\left((n + m) \sum_i i \, y_i - a \sum z\right)^2}
            {(n + m) \left((n + m) \, a \, \tfrac{2 n + 1}{3} - a^2\right)},
            \qquad a = \frac{n (n + 1)}{2}

    `count`: values so far; `factors` (3, W), written up to `onsets`, the earliest first: both
    factors of the numerator, and one over the denominator.
    """
    for i in range(onsets):
        n = float(onsets - i)
        m = min(count - n, float(baseline))
        area = 0.5 * n * (n + 1.0)
        squares = area * (2.0 * n + 1.0) * (1.0 / 3.0)
        factors[0, i] = n + m if ramp else m
        factors[1, i] = area if ramp else n
        ramps = (n + m) * (squares * (n + m) - area * area)
        factors[2, i] = 1.0 / (ramps if ramp else n * m * (n + m))


@inline_njit
def latest(ring: FloatArray, last: int, count: int) -> FloatArray:
    """View of values ``last - count + 1`` to `last`, of a ring that is stored twice, end to end."""
    length = ring.shape[0] // 2
    end = length + last % length + 1
    return ring[end - count : end]


@inline_njit
def remember(ring: FloatArray, number: int, value: float) -> None:
    length = ring.shape[0] // 2
    ring[number % length] = value
    ring[length + number % length] = value


@inline_njit
def find_largest(values: FloatArray, other: FloatArray) -> float:
    """Largest of some values that are not negative; both arrays are overwritten. The halves are
    compared side by side until few are left: the processor takes several at a time, where a single
    largest value would wait for each comparison."""
    size = values.shape[0]
    while size > 8:
        half = size // 2
        left, right = values[:half], values[size - half : size]
        for i in range(half):
            x, y = left[i], right[i]
            other[i] = x if x > y else y
        if size - half > half:
            other[half] = values[half]
        values, other = other, values
        size -= half
    found = 0.0
    for i in range(size):
        found = max(found, values[i])
    return found


@inline_njit
def largest_evidence(
    sums: FloatArray,
    areas: FloatArray,
    known: int,
    onsets: int,
    baseline: int,
    ramp: bool,
    factors: FloatArray,
    scratch: FloatArray,
) -> float:
    r"""Largest evidence over the newest onsets, after the value of number `known`.

    With the running sums :math:`P_k = \sum_{j \le k} z_j` and :math:`A_k = \sum_{j < k} P_j`,

    .. math:: \sum y = P_k - P_{k-n}, \qquad \sum_i i \, y_i = n P_k - (A_k - A_{k-n})

    `sums` (2 L,) P, L = W + baseline + 1, value k at ``k % L`` and once more L later, 0 before it
    is stored; `areas` (2 W + 2,) A likewise, for a ramp; `factors` (3, W) of `split_factors`;
    `scratch` (2, W), overwritten.
    """
    first, second, inverse = factors[0], factors[1], factors[2]
    found, other = scratch[0, :onsets], scratch[1, :onsets]
    before, now = latest(sums, known - 1, onsets), latest(sums, known, 1)[0]
    if known > baseline:
        old = latest(sums, known - 1 - baseline, onsets)
    else:  # before the first value
        old = other
        for i in range(onsets):
            old[i] = 0.0
    if ramp:
        area, last = latest(areas, known - 1, onsets), latest(areas, known, 1)[0]
        for i in range(onsets):
            moment = (onsets - i) * now - (last - area[i])
            difference = first[i] * moment - second[i] * (now - old[i])
            found[i] = difference * difference * inverse[i]
    else:
        for i in range(onsets):
            difference = first[i] * (now - before[i]) - second[i] * (before[i] - old[i])
            found[i] = difference * difference * inverse[i]
    return find_largest(found, other)


@njit
def scan_channels(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    visible: BoolArray,
    first_row: int,
    signals: int,
    ramp: bool,
    window: int,
    quantiles: FloatArray,
    scratch: FloatArray,
    sums: FloatArray,
    areas: FloatArray,
    count: IntArray,
    statistic: FloatArray,
    threshold: FloatArray,
) -> None:
    """Take in one epoch, and look for changes. `quantiles` (n + 1,) thresholds by the number of
    visible satellites; `scratch` (5, W), overwritten; memory: `sums` (B, signals * n, 2 L), `areas`
    (B, signals * n, 2 W + 2), as of `largest_evidence`, `count` (B, n); `statistic`, `threshold`
    (B, n), written."""
    channels = visible.shape[1]
    baseline = sums.shape[2] // 2 - window - 1
    factors, scratch = scratch[:3], scratch[3:]
    factored = -1  # satellites that rose together have the same factors
    for b in range(visible.shape[0]):
        seen = 0
        for j in range(channels):
            seen += visible[b, j]
        for j in range(channels):
            statistic[b, j] = 0.0
            threshold[b, j] = quantiles[seen]
            known = count[b, j]
            count[b, j] = known + 1 if visible[b, j] else 0
            onsets = min(window, known)
            if visible[b, j] and known != factored:
                split_factors(known + 1, onsets, baseline, ramp, factors)
                factored = known
            for signal in range(signals):
                s = signal * channels + j
                P, A = sums[b, s], areas[b, s]
                if not visible[b, j]:
                    if known > 0:
                        P[:] = 0.0
                        A[:] = 0.0
                    continue
                row = first_row + s
                value = innovation[b, row] / math.sqrt(innovation_variance[b, row])
                before = latest(P, known - 1, 1)[0]
                remember(P, known, before + value)
                if ramp:
                    remember(A, known, latest(A, known - 1, 1)[0] + before)
                found = largest_evidence(P, A, known, onsets, baseline, ramp, factors, scratch)
                statistic[b, j] = max(statistic[b, j], found)


@settings_record
class _Glr(InnovationTest):
    false_alarm: float = alarm_probability(
        4e-6,
        "Bound on the probability of an alarm in one epoch of the receiver, where the filter's "
        "belief is right.",
    )
    window: int = window_epochs(150, "W: longest time since the onset.")
    baseline: int = window_epochs(
        300, "Most epochs before the onset that give the mean without attack."
    )
    signals: str = signals_to_test("pseudorange")

    scope: ClassVar[str] = "channel"
    paper: ClassVar[str] = "willsky1976"
    ramp: ClassVar[bool]

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        receivers, n = context.receivers, context.channels
        series = (receivers, self._per_satellite * n)
        self.memory_epochs = self.window + self.baseline
        self.memory.declare_all(
            sums=np.zeros((*series, 2 * (self.memory_epochs + 1))),
            areas=np.zeros((*series, 2 * (self.window + 1) if self.ramp else 1)),
            count=np.zeros((receivers, n), dtype=np.int64),
        )
        self._scratch = np.empty((5, self.window))
        tests = [self.window * self._per_satellite * max(seen, 1) for seen in range(n + 1)]
        self._quantiles = np.array([two_sided_quantile(self.false_alarm / k) ** 2 for k in tests])

    def judge(self, epoch: Epoch) -> Verdict:
        shape = epoch.visible.shape
        statistic, threshold = np.empty(shape), np.empty(shape)
        scan_channels(
            epoch.innovation,
            epoch.innovation_variance,
            epoch.visible,
            self._rows[0],
            self._per_satellite,
            self.ramp,
            self.window,
            self._quantiles,
            self._scratch,
            self.memory["sums"],
            self.memory["areas"],
            self.memory["count"],
            statistic,
            threshold,
        )
        return Verdict(statistic, threshold, statistic > threshold)


@settings_record
class GlrStep(_Glr):
    """Likelihood-ratio scan over all onsets for a step of every innovation; monitor only."""

    ramp: ClassVar[bool] = False


@settings_record
class GlrRamp(_Glr):
    """Likelihood-ratio scan over all onsets for a ramp of every innovation; monitor only."""

    ramp: ClassVar[bool] = True
