r"""Generalized likelihood-ratio tests for a change of every satellite's innovation.

The normalized innovations of a satellite are split at every possible onset of the last W epochs
into a baseline before it, whose mean nobody knows, and the n epochs since.  For each split the
evidence of a change is, for a step and for a ramp of unknown size,

.. math::
    q_n = \frac{(\bar y - \bar x)^2}{1/n + 1/m}, \qquad
    q_n = \frac{\left(\sum_i i \, (y_i - \bar z)\right)^2}
        {\tfrac{n (n + 1) (2 n + 1)}{6} - \tfrac{n^2 (n + 1)^2}{4 (n + m)}},

each chi-square with one degree of freedom where nothing changes, and the statistic is the largest
over n.  An alarm is raised above the quantile of probability
:math:`P_{fa} / (W \cdot \text{series})`, Bonferroni's bound.

Symbols: x the m baseline epochs, at most `baseline`; y the n epochs since the onset; z all of them;
W `window`; series: visible satellites times signals.

The baseline takes out what a satellite's constant bias leaves in its innovations, for which a CUSUM
or an average of the innovations alarms.  The ramp test takes epochs for equally spaced.

Assumptions: normalized innovations are independent and of variance 1 about their mean.  The W
values of an epoch hang together, so that `false_alarm` is a bound, not a rate: for 5 % steps alarm
in 1.1 % of the epochs and ramps in 0.3 % where the receiver assumes the noise of its world; and in
the papers' receiver, which overstates its noise, alarms are rarer still.

Deviations: `willsky1976` knows how a filter answers to a jump, and tests for this answer.  Here the
change is taken to stay in the innovation as it is, which a filter that follows an offset slowly, or
not at all, comes near to.  A satellite that sets and rises starts again.  Every onset of the window
is tried, at every epoch.

Source: `willsky1976`; the use as what `ke2022` lacks, a test that is not given the attack, is ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .._jit import inlined, njit
from ..receiver.epoch import Epoch
from .base import Detector, DetectorContext, Verdict
from .innovation_test import check_signals
from .thresholds import check_epochs, check_probability, two_sided_quantile

FloatArray = NDArray[np.float64]


@inlined
def step_evidence(n: float, m: float, since: float, before: float) -> float:
    r"""Evidence of a step.

    .. math:: q = \frac{(m \sum y - n \sum x)^2}{n m (n + m)}

    `n`, `m`: epochs since the onset, and of the baseline, at least 1.
    """
    difference = m * since - n * before
    return difference * difference / (n * m * (n + m))


@inlined
def ramp_evidence(n: float, m: float, moment: float, total: float) -> float:
    r"""Evidence of a ramp whose first epoch is 1.

    .. math:: q = \frac{(\sum_i i y_i - \bar r \sum z)^2}{\sum_i i^2 - (n + m) \bar r^2},
        \qquad \bar r = \frac{n (n + 1)}{2 (n + m)}

    `n`, `m`: epochs since the onset, and of the baseline, at least 1; `moment`: sum of i times the
    i-th value since the onset.
    """
    area = 0.5 * n * (n + 1.0)
    # both sides times (n + m), so that one division is enough
    numerator = moment * (n + m) - area * total
    squares = area * (2.0 * n + 1.0) / 3.0
    return numerator * numerator / ((n + m) * (squares * (n + m) - area * area))


@inlined
def split_sums(
    ring: NDArray[np.float32],
    base: float,
    last: int,
    onsets: int,
    baseline: int,
    ramp: bool,
    scratch: FloatArray,
) -> None:
    """Sums on both sides of every onset, from the newest on.

    `ring` (L,) float32, last values, value k at ``k % L``, 0 where there is none yet; `base`: sum
    of the at most `baseline` values before the last one; `scratch` (2, W), written: the sum since
    the onset and that of the baseline; for a ramp the moment since the onset and the sum of all.
    """
    length = ring.shape[0]
    now, old = last % length, (last - baseline) % length
    since = moment = 0.0
    before = base + float(ring[now]) - float(ring[old])
    first, second = scratch[0], scratch[1]
    done = 0
    while done < onsets:
        # a stretch in which no index passes the end of the ring
        stretch = min(onsets - done, now + 1, old + 1)
        for i in range(stretch):
            value = float(ring[now - i])
            since += value
            moment += since  # every value since the onset counts once more
            before += float(ring[old - i]) - value
            first[done + i] = moment if ramp else since
            second[done + i] = since + before if ramp else before
        done += stretch
        now = now - stretch if now >= stretch else length - 1
        old = old - stretch if old >= stretch else length - 1


@inlined
def largest_evidence(
    ages: FloatArray, count: int, onsets: int, baseline: int, ramp: bool, scratch: FloatArray
) -> float:
    """Largest evidence over all onsets.

    `ages` (W,) epochs since each onset, 1, 2 and so on; `scratch` (2, W) as `split_sums` leaves it,
    overwritten.
    """
    longest, known = float(baseline), float(count)
    first, second = scratch[0], scratch[1]
    for i in range(onsets):  # apart from the next loop, so that it is vectorized
        n = ages[i]
        m = known - n
        m = longest if m > longest else m
        if ramp:
            first[i] = ramp_evidence(n, m, first[i], second[i])
        else:
            first[i] = step_evidence(n, m, first[i], second[i])
    a = b = c = d = 0.0
    for i in range(onsets % 4):
        a = max(a, first[i])
    for i in range(onsets % 4, onsets, 4):  # four side by side, since each waits for its last
        w, x, y, z = first[i], first[i + 1], first[i + 2], first[i + 3]
        a = w if w > a else a
        b = x if x > b else b
        c = y if y > c else c
        d = z if z > d else d
    return max(max(a, b), max(c, d))


@njit
def scan_channels(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    visible: NDArray[np.bool_],
    first_row: int,
    signals: int,
    baseline: int,
    ramp: bool,
    ages: FloatArray,
    quantiles: FloatArray,
    scratch: FloatArray,
    ring: NDArray[np.float32],
    base: FloatArray,
    count: NDArray[np.int64],
    statistic: FloatArray,
    threshold: FloatArray,
) -> None:
    """Take in one epoch, and look for changes.

    `ages` (W,) epochs since each onset, 1, 2 and so on; `quantiles` (n+1,) thresholds by the number
    of visible satellites; `scratch` (2, W), overwritten; `ring`, `base` (B, signals * n, L)
    float32, (B, signals * n) memory, overwritten; `count` (B, n) int64 memory, overwritten;
    `statistic`, `threshold` (B, n), written.
    """
    channels = visible.shape[1]
    length = ring.shape[2]
    for b in range(visible.shape[0]):
        seen = 0
        for j in range(channels):
            seen += visible[b, j]
        for j in range(channels):
            statistic[b, j] = 0.0
            threshold[b, j] = quantiles[seen]
            known = count[b, j]
            count[b, j] = known + 1 if visible[b, j] else 0
            onsets = min(ages.shape[0], known)
            for signal in range(signals):
                s = signal * channels + j
                values = ring[b, s]
                if not visible[b, j]:
                    base[b, s] = 0.0
                    if known > 0:
                        values[:] = 0.0
                    continue
                row = first_row + s
                if known > 0:
                    base[b, s] += float(values[(known - 1) % length])
                if known > baseline:
                    base[b, s] -= float(values[(known - 1 - baseline) % length])
                values[known % length] = innovation[b, row] / math.sqrt(innovation_variance[b, row])
                split_sums(values, base[b, s], known, onsets, baseline, ramp, scratch)
                found = largest_evidence(ages, known + 1, onsets, baseline, ramp, scratch)
                statistic[b, j] = max(statistic[b, j], found)


@dataclass
class _Glr(Detector):
    """What the two tests have in common."""

    false_alarm: float = 4e-6
    window: int = 150
    baseline: int = 300
    signals: str = "pseudorange"

    scope: ClassVar[str] = "channel"
    paper: ClassVar[str] = "willsky1976"
    ramp: ClassVar[bool]

    def __post_init__(self) -> None:
        """Check the settings."""
        check_probability("false_alarm", self.false_alarm)
        for name in ("window", "baseline"):
            check_epochs(name, getattr(self, name))
        check_signals(self.signals)

    def bind(self, context: DetectorContext) -> None:
        """Prepare the memory of the last values, and the thresholds."""
        super().bind(context)
        receivers, n = context.receivers, context.channels
        self._first_row = n if self.signals == "range_rate" else 0
        self._signals = 2 if self.signals == "both" else 1
        series = (receivers, self._signals * n)
        # single precision is enough for deviates, and half as much to go through at every epoch
        ring = np.zeros((*series, self.window + self.baseline), dtype=np.float32)
        self.memory.declare("ring", ring)
        self.memory_epochs = self.window + self.baseline
        self.memory.declare("base", np.zeros(series))
        self.memory.declare("count", np.zeros((receivers, n), dtype=np.int64))
        self._ages = np.arange(1.0, self.window + 1.0)
        self._scratch = np.empty((2, self.window))
        tests = self.window * self._signals
        self._quantiles = np.array(
            [
                two_sided_quantile(self.false_alarm / (tests * max(seen, 1))) ** 2
                for seen in range(n + 1)
            ]
        )

    def judge(self, epoch: Epoch) -> Verdict:
        """Look for a change before one epoch.

        Returns (B, n) largest evidence of each satellite, thresholds, alarms; no weights.
        """
        shape = epoch.visible.shape
        statistic, threshold = np.empty(shape), np.empty(shape)
        scan_channels(
            epoch.innovation,
            epoch.innovation_variance,
            epoch.visible,
            self._first_row,
            self._signals,
            self.baseline,
            self.ramp,
            self._ages,
            self._quantiles,
            self._scratch,
            self.memory["ring"],
            self.memory["base"],
            self.memory["count"],
            statistic,
            threshold,
        )
        return Verdict(statistic, threshold, statistic > threshold)


@dataclass
class GlrStep(_Glr):
    """Likelihood-ratio scan over all onsets for a step of every innovation; monitor only.

    Parameters
    ----------
    false_alarm : float
        Bound on the probability of an alarm in one epoch of the receiver, in (0, 1), where the
        filter's belief is right.
    window : int
        W, longest time since the onset, in epochs.
    baseline : int
        Most epochs before the onset that give the mean without attack.
    signals : {"pseudorange", "range_rate", "both"}
        Innovations to test.
    """

    ramp: ClassVar[bool] = False


@dataclass
class GlrRamp(_Glr):
    """Likelihood-ratio scan over all onsets for a ramp of every innovation; monitor only.

    Parameters
    ----------
    false_alarm : float
        Bound on the probability of an alarm in one epoch of the receiver, in (0, 1), where the
        filter's belief is right.
    window : int
        W, longest time since the onset, in epochs.
    baseline : int
        Most epochs before the onset that give the mean without attack.
    signals : {"pseudorange", "range_rate", "both"}
        Innovations to test.
    """

    ramp: ClassVar[bool] = True
