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
values of an epoch hang together, so that `false_alarm` is a bound, not a rate; and in the papers'
receiver, which overstates its noise, alarms are rarer still.

Deviations: `willsky1976` knows how a filter answers to a jump, and tests for this answer.  Here the
change is taken to stay in the innovation as it is, which a filter that follows an offset slowly, or
not at all, comes near to.  A satellite that sets and rises begins anew.  Every onset of the window
is tried, at every epoch.

Source: `willsky1976`; the use as what `ke2022` lacks, a test that is not told the attack, is ours.
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
from .thresholds import check_probability, two_sided_quantile

FloatArray = NDArray[np.float64]
SIGNALS = ("pseudorange", "range_rate", "both")
LONGEST = 100_000


@inlined
def step_evidence(n: float, m: float, since: float, before: float) -> float:
    r"""Evidence of a step.

    .. math:: q = \frac{(m \sum y - n \sum x)^2}{n m (n + m)}

    Parameters
    ----------
    n, m : float
        Epochs since the onset, and of the baseline, at least 1.
    since, before : float
        Sums of their values.

    Returns
    -------
    float
        q.
    """
    difference = m * since - n * before
    return difference * difference / (n * m * (n + m))


@inlined
def ramp_evidence(n: float, m: float, moment: float, total: float) -> float:
    r"""Evidence of a ramp whose first epoch is 1.

    .. math:: q = \frac{(\sum_i i y_i - \bar r \sum z)^2}{\sum_i i^2 - (n + m) \bar r^2},
        \qquad \bar r = \frac{n (n + 1)}{2 (n + m)}

    Parameters
    ----------
    n, m : float
        Epochs since the onset, and of the baseline, at least 1.
    moment : float
        Sum of i times the i-th value since the onset.
    total : float
        Sum of all values.

    Returns
    -------
    float
        q.
    """
    area = 0.5 * n * (n + 1.0)
    # both sides times (n + m), so that one division is enough
    numerator = moment * (n + m) - area * total
    squares = area * (2.0 * n + 1.0) / 3.0
    return numerator * numerator / ((n + m) * (squares * (n + m) - area * area))


@inlined
def largest_evidence(
    ring: FloatArray, base: float, count: int, window: int, baseline: int, ramp: bool
) -> float:
    """Largest evidence over all onsets of the window.

    Parameters
    ----------
    ring : ndarray
        (L,) last values, value k at ``k % L``, L at least window + baseline.
    base : float
        Sum of the at most `baseline` values before the last one.
    count : int
        Values so far.
    window, baseline : int
        Longest time since the onset, and longest baseline, in epochs.
    ramp : bool
        Whether a ramp is looked for, else a step.

    Returns
    -------
    float
        The statistic; 0 with fewer than two values.
    """
    length = ring.shape[0]
    last = count - 1
    now = last % length
    first = last - baseline  # of the baseline of the newest onset
    old = first % length
    since = moment = best = 0.0
    before = base
    for n in range(1, min(window, last) + 1):
        value = ring[now]
        since += value
        moment += since  # every value since the onset counts once more
        m = min(baseline, count - n)
        if ramp:
            best = max(best, ramp_evidence(float(n), float(m), moment, since + before))
        else:
            best = max(best, step_evidence(float(n), float(m), since, before))
        now = now - 1 if now > 0 else length - 1
        old = old - 1 if old > 0 else length - 1
        before -= ring[now]
        if first - n >= 0:
            before += ring[old]
    return best


@njit
def scan_channels(
    innovation: FloatArray,
    innovation_cov: FloatArray,
    visible: NDArray[np.bool_],
    first_row: int,
    signals: int,
    window: int,
    baseline: int,
    ramp: bool,
    quantiles: FloatArray,
    ring: FloatArray,
    base: FloatArray,
    count: NDArray[np.int64],
    statistic: FloatArray,
    threshold: FloatArray,
) -> None:
    """Take in one epoch, and look for changes.

    Parameters
    ----------
    innovation, innovation_cov, visible : ndarray
        Of the epoch.
    first_row, signals : int
        First innovation to look at, and how many signals, n rows each.
    window, baseline : int
        Longest time since the onset, and longest baseline, in epochs.
    ramp : bool
        Whether ramps are looked for, else steps.
    quantiles : ndarray
        (n+1,) thresholds by the number of visible satellites.
    ring, base : ndarray
        (B, signals * n, L), (B, signals * n) memory, overwritten.
    count : ndarray
        (B, n) int64 memory, overwritten.
    statistic, threshold : ndarray
        (B, n), written.
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
            for signal in range(signals):
                s = signal * channels + j
                if not visible[b, j]:
                    base[b, s] = 0.0
                    continue
                row = first_row + s
                values = ring[b, s]
                if known > 0:
                    base[b, s] += values[(known - 1) % length]
                if known > baseline:
                    base[b, s] -= values[(known - 1 - baseline) % length]
                values[known % length] = innovation[b, row] / math.sqrt(innovation_cov[b, row, row])
                found = largest_evidence(values, base[b, s], known + 1, window, baseline, ramp)
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
            value = getattr(self, name)
            if not 1 <= value <= LONGEST:
                raise ValueError(f"`{name}` must be 1 to {LONGEST} epochs, got {value}")
        if self.signals not in SIGNALS:
            raise ValueError(
                f"`signals` must be one of {', '.join(map(repr, SIGNALS))}, got {self.signals!r}"
            )

    def bind(self, context: DetectorContext) -> None:
        """Prepare the memory of the last values, and the thresholds.

        Parameters
        ----------
        context : DetectorContext
            Sizes.
        """
        super().bind(context)
        receivers, n = context.receivers, context.channels
        self._first_row = n if self.signals == "range_rate" else 0
        self._signals = 2 if self.signals == "both" else 1
        series = (receivers, self._signals * n)
        self.memory.declare("ring", np.zeros((*series, self.window + self.baseline)))
        self.memory.declare("base", np.zeros(series))
        self.memory.declare("count", np.zeros((receivers, n), dtype=np.int64))
        tests = self.window * self._signals
        self._quantiles = np.array(
            [
                two_sided_quantile(self.false_alarm / (tests * max(seen, 1))) ** 2
                for seen in range(n + 1)
            ]
        )

    def judge(self, epoch: Epoch) -> Verdict:
        """Look for a change before one epoch.

        Parameters
        ----------
        epoch : Epoch
            Read-only.

        Returns
        -------
        Verdict
            (B, n) largest evidence of each satellite, thresholds, alarms; no weights.
        """
        shape = epoch.visible.shape
        statistic, threshold = np.empty(shape), np.empty(shape)
        scan_channels(
            epoch.innovation,
            epoch.innovation_cov,
            epoch.visible,
            self._first_row,
            self._signals,
            self.window,
            self.baseline,
            self.ramp,
            self._quantiles,
            self.memory["ring"],
            self.memory["base"],
            self.memory["count"],
            statistic,
            threshold,
        )
        return Verdict(statistic, threshold, statistic > threshold)


@dataclass
class GlrStep(_Glr):
    """Likelihood-ratio scan over all onsets for a step of every innovation; it only watches.

    Parameters
    ----------
    false_alarm : float
        Bound on the probability of an alarm in one epoch of the receiver, in (0, 1), where the
        filter's belief is right.
    window : int
        W, longest time since the onset, in epochs.
    baseline : int
        Most epochs before the onset that tell the mean without attack.
    signals : {"pseudorange", "range_rate", "both"}
        Innovations to test.
    """

    ramp: ClassVar[bool] = False


@dataclass
class GlrRamp(_Glr):
    """Likelihood-ratio scan over all onsets for a ramp of every innovation; it only watches.

    Parameters
    ----------
    false_alarm : float
        Bound on the probability of an alarm in one epoch of the receiver, in (0, 1), where the
        filter's belief is right.
    window : int
        W, longest time since the onset, in epochs.
    baseline : int
        Most epochs before the onset that tell the mean without attack.
    signals : {"pseudorange", "range_rate", "both"}
        Innovations to test.
    """

    ramp: ClassVar[bool] = True
