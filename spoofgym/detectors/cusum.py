r"""Two-sided CUSUM and lagged CUSUM.

Two-sided cumulative sum of every satellite's normalized innovation.

What an innovation exceeds an allowance by is added up, in either direction, and forgotten as soon
as the sum falls below zero.  So the chart gathers a small shift over just the time since it began.
It judges every satellite for itself.

.. math:: C^+_k = \max(0, C^+_{k-1} + u_k - \kappa), \quad
    C^-_k = \max(0, C^-_{k-1} - u_k - \kappa), \quad u_k = z_{k,j} / \sqrt{S_{k,jj}}

with an alarm where the larger of the two exceeds h.  Symbols: z innovation, S innovation
covariance, :math:`\kappa` the allowance, half of the shift that is found soonest, h the limit.

Assumptions: innovations are white, normal and of the variance that the filter believes in; a
constant satellite bias above the allowance adds up without end: `bias_window_s`.

What is promised is no rate of one epoch, but a mean time between false alarms, by
`mean_epochs_between_alarms`: 8e5 epochs of one satellite by default, 1e5 of a receiver with eight.
The sum is not set back by an alarm: after an attack it takes the sum over :math:`\kappa` in epochs,
or more, to fall back.

Source: `page1954`; the mean time is from `siegmund1985`.

Cumulative sums of every satellite's innovation against its own past.

A sum that grows with every normalized innovation on one side of its mean finds small lasting
changes.  What is subtracted as the mean is that of older innovations, at least `lag` epochs back,
so that a satellite's constant bias does not count and an attack does not spoil it at once:

.. math::
    C^\pm_k = \max\left(0, C^\pm_{k-1} \pm (\omega_k - \bar\omega_k) - \kappa_m\right), \qquad
    \kappa_m = \max(\kappa, 5 / \sqrt{m}),

and an alarm is raised where the larger sum exceeds h.

Symbols: :math:`\omega` normalized innovation, :math:`\bar\omega_k` mean of m older ones, at most
`baseline`; :math:`\kappa` `drift`, h `threshold`.

While few innovations are known, the lag is half of them, and the drift is five standard deviations
of the mean's own error, so that a false mean does not make an alarm.

Assumptions: normalized innovations are independent and of variance 1 about their mean.  Then the
mean time between false alarms of one sum is Siegmund's, `thresholds.run_length`; for two sums of
each of 8 satellites the defaults 0.5 and 13.3 give 4e-6 alarms an epoch, the probability of
`ke2022`.  Sums that are not started again cross the threshold several times, and the baseline errs:
with h = 6 alarms begin in 1.0 % of the epochs for 0.6 % where the receiver assumes the noise of its
world.

Deviations: `page1954` knows the mean.  An alarm does not restart the sums: they fall again when
the change is over.  A satellite that sets and rises starts again.

Source: `page1954`; `siegmund1985` for the threshold; the lagged baseline is ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.compile import njit
from ..receiver.epoch import Epoch
from .base import Detector, DetectorContext, Verdict
from .innovation import InnovationTest, check_epochs, check_signals, run_length

FloatArray = NDArray[np.float64]


def mean_epochs_between_alarms(allowance: float, limit: float) -> float:
    r"""Mean time to a false alarm of one two-sided chart, from zero, in epochs.

    .. math:: \frac{e^{2 \kappa b} - 2 \kappa b - 1}{4 \kappa^2}, \qquad b = h + 1.166

    Notes
    -----
    `siegmund1985`; see `thresholds.run_length`.
    """
    return 0.5 * run_length(allowance, limit)


@njit
def advance_sums(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    judged: NDArray[np.bool_],
    first: int,
    last: int,
    allowance: float,
    above: FloatArray,
    below: FloatArray,
) -> FloatArray:
    """Advance all sums by one epoch. `innovation`, `innovation_variance` (B, 2n); `judged` (B, n)
    bool; the sums of the others start again; `above`, `below` (B, last - first) memory,
    overwritten; returns (B, n) largest sum of every satellite."""
    receivers, n = judged.shape
    out = np.zeros((receivers, n))
    for b in range(receivers):
        for r in range(first, last):
            i, j = r - first, r % n
            if not judged[b, j]:
                above[b, i] = below[b, i] = 0.0
                continue
            u = innovation[b, r] / math.sqrt(innovation_variance[b, r])
            above[b, i] = max(0.0, above[b, i] + u - allowance)
            below[b, i] = max(0.0, below[b, i] - u - allowance)
            out[b, j] = max(out[b, j], above[b, i], below[b, i])
    return out


@dataclass
class Cusum(InnovationTest):
    """Cumulative sum of every satellite's innovation; monitor only.

    Parameters
    ----------
    allowance : float
        Kappa, above 0 [standard deviations].
    limit : float
        h, above 0 [standard deviations].
    signals : {"pseudorange", "range_rate", "both"}
        Innovations to add up; of ``"both"`` a satellite's statistic is the larger sum.
    bias_window_s : float
        Length of the first window whose mean innovation is taken away from every channel, which is
        not judged before; 0 for none.
    """

    described_as = "Cusum"
    allowance: float = 0.5
    limit: float = 12.4
    signals: str = "pseudorange"
    bias_window_s: float = 0.0

    paper: ClassVar[str] = "page1954"
    scope: ClassVar[str] = "channel"
    drifts: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for name in ("allowance", "limit"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"`{name}` must be finite and > 0, got {value}")
        super().__post_init__()

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        first, last = self._rows
        for name in ("above", "below"):
            self.memory.declare(name, np.zeros((context.receivers, last - first)))

    def judge(self, epoch: Epoch) -> Verdict:
        """Judge one epoch: (B, n) sums, limits, alarms; no weights."""
        innovation, judged = self._without_bias(epoch)
        statistic = advance_sums(
            innovation,
            epoch.innovation_variance,
            judged,
            *self._rows,
            self.allowance,
            self.memory["above"],
            self.memory["below"],
        )
        threshold = np.full(statistic.shape, self.limit)
        return Verdict(statistic, threshold, statistic > threshold)


BASELINE_SDS = 5.0
"""Standard deviations of the baseline's error that the drift covers at least."""


@njit
def sum_channels(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    visible: NDArray[np.bool_],
    first_row: int,
    signals: int,
    lag: int,
    baseline: int,
    drift: float,
    ring: FloatArray,
    base: FloatArray,
    above: FloatArray,
    below: FloatArray,
    count: NDArray[np.int64],
    statistic: FloatArray,
) -> None:
    """Advance all sums by one epoch. `ring`, `base`, `above`, `below` (B, signals * n, L) last
    values, (B, signals * n) sum of the baseline and the two sums; memory, overwritten; `count` (B,
    n) int64 memory, overwritten; `statistic` (B, n), written."""
    channels = visible.shape[1]
    length = ring.shape[2]
    for b in range(visible.shape[0]):
        for j in range(channels):
            statistic[b, j] = 0.0
            known = count[b, j]
            count[b, j] = known + 1 if visible[b, j] else 0
            end = max(known - lag, (known + 1) // 2)  # values before it are the baseline
            moved = known > 0 and end > max(known - 1 - lag, known // 2)
            for signal in range(signals):
                s = signal * channels + j
                if not visible[b, j]:
                    base[b, s] = above[b, s] = below[b, s] = 0.0
                    continue
                row = first_row + s
                value = innovation[b, row] / math.sqrt(innovation_variance[b, row])
                if moved:
                    base[b, s] += ring[b, s, (end - 1) % length]
                    if end > baseline:
                        base[b, s] -= ring[b, s, (end - 1 - baseline) % length]
                ring[b, s, known % length] = value
                if end == 0:
                    continue
                m = min(end, baseline)
                change = value - base[b, s] / m
                least = max(drift, BASELINE_SDS / math.sqrt(m))
                above[b, s] = max(0.0, above[b, s] + change - least)
                below[b, s] = max(0.0, below[b, s] - change - least)
                statistic[b, j] = max(statistic[b, j], max(above[b, s], below[b, s]))


@dataclass
class LagCusum(Detector):
    """Two-sided cumulative sum of every innovation against its own past; monitor only.

    Parameters
    ----------
    drift : float
        Kappa, above 0: half of the change, in standard deviations, that is looked for.
    threshold : float
        h, above 0.
    lag : int
        How far back the baseline ends, in epochs.
    baseline : int
        Its greatest length, in epochs.
    signals : {"pseudorange", "range_rate", "both"}
        Innovations to sum.
    """

    described_as = "LagCusum"
    drift: float = 0.5
    threshold: float = 13.3
    lag: int = 150
    baseline: int = 300
    signals: str = "pseudorange"

    paper: ClassVar[str] = "page1954"
    scope: ClassVar[str] = "channel"
    drifts: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for name in ("drift", "threshold"):
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise ValueError(f"`{name}` must be finite and > 0, got {value}")
        for name in ("lag", "baseline"):
            check_epochs(name, getattr(self, name))
        check_signals(self.signals)

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        receivers, n = context.receivers, context.channels
        self._first_row = n if self.signals == "range_rate" else 0
        self._signals = 2 if self.signals == "both" else 1
        series = (receivers, self._signals * n)
        self.memory_epochs = self.lag + self.baseline + 1
        self.memory.declare("ring", np.zeros((*series, self.memory_epochs)))
        for name in ("base", "above", "below"):
            self.memory.declare(name, np.zeros(series))
        self.memory.declare("count", np.zeros((receivers, n), dtype=np.int64))

    def judge(self, epoch: Epoch) -> Verdict:
        """Sum up one epoch: (B, n) larger sum of each satellite, threshold, alarms; no weights."""
        shape = epoch.visible.shape
        statistic = np.empty(shape)
        sum_channels(
            epoch.innovation,
            epoch.innovation_variance,
            epoch.visible,
            self._first_row,
            self._signals,
            self.lag,
            self.baseline,
            self.drift,
            self.memory["ring"],
            self.memory["base"],
            self.memory["above"],
            self.memory["below"],
            self.memory["count"],
            statistic,
        )
        return Verdict(statistic, np.full(shape, self.threshold), statistic > self.threshold)
