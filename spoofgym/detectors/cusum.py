r"""Two-sided cumulative sums of every satellite's normalized innovation, about 0 or its own past.

What an innovation exceeds an allowance by is added up, in either direction, and forgotten as soon
as the sum falls below zero, so that the chart gathers a small shift over just the time since it
began.  An alarm is raised where the larger of the two sums exceeds h,

.. math::
    C^\pm_k = \max\left(0, C^\pm_{k-1} \pm (u_k - \bar u_k) - \kappa\right), \qquad
    u_k = z_{k,j} / \sqrt{S_{k,jj}}

Symbols: z innovation, S innovation covariance, :math:`\kappa` the allowance, half of the shift that
is found soonest, :math:`\bar u` the mean without an attack.

Assumptions: innovations are white, normal and of the variance that the filter believes in.

What is promised is no rate of one epoch, but a mean time between false alarms of one two-sided
chart (`siegmund1985`, by a Brownian motion whose limit is moved by the mean overshoot),

.. math:: \frac{e^{2 \kappa b} - 2 \kappa b - 1}{4 \kappa^2}, \qquad b = h + 1.166

An alarm does not set the sums back (`page1954` starts again): after an attack they take the sum
over :math:`\kappa` in epochs, or more, to fall, and cross the threshold several times.

**Cusum** has :math:`\bar u = 0`, so that a constant satellite bias above the allowance adds up
without end: `bias_window_s`.  By default it alarms once in 8e5 epochs of one satellite, 1e5 of a
receiver with eight.

**LagCusum** subtracts the mean of m older innovations, at least `lag` epochs back and at most
`baseline` of them, so that a constant bias does not count and an attack does not spoil the mean at
once; the lagged baseline is ours.  While few innovations are known, the lag is half of them, and
the drift covers five standard deviations of the mean's own error,
:math:`\max(\kappa, 5 / \sqrt{m})`.  The defaults give 4e-6 alarms an epoch for two sums of each of
8 satellites, the probability of `ke2022`; since sums go on after an alarm and the baseline errs,
with h = 6 alarms begin in 1.0 % of the epochs for 0.6 % where the receiver assumes the noise of its
world.  A satellite that sets and rises starts again.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from ..core.compile import njit
from ..core.declared import setting, settings_record
from ..receiver.epoch import Epoch
from .base import BoolArray, DetectorContext, FloatArray, IntArray, Verdict, compare
from .innovation import InnovationTest, first_window, signals_to_test, window_epochs


@njit
def advance_sums(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    judged: BoolArray,
    first: int,
    last: int,
    allowance: float,
    above: FloatArray,
    below: FloatArray,
    out: FloatArray,
) -> FloatArray:
    """Advance all sums by one epoch; those of satellites that are not judged start again. `above`,
    `below` (B, last - first) memory; `out` (B, n), written and returned: largest sum of every
    satellite."""
    receivers, n = judged.shape
    for b in range(receivers):
        for j in range(n):
            out[b, j] = 0.0
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


@settings_record
class Cusum(InnovationTest):
    """Cumulative sum of every satellite's innovation; monitor only."""

    allowance: float = setting(default=0.5, above=0.0, unit="standard deviations", help="Kappa.")
    limit: float = setting(default=12.4, above=0.0, unit="standard deviations", help="Limit h.")
    signals: str = signals_to_test(
        "pseudorange",
        'Innovations to add up; of ``"both"`` a satellite\'s statistic is the larger sum.',
    )
    bias_window_s: float = first_window()

    paper: ClassVar[str] = "page1954"
    scope: ClassVar[str] = "channel"
    drifts: ClassVar[bool] = True

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        first, last = self._rows
        shape = (context.receivers, last - first)
        self.memory.declare_all(above=np.zeros(shape), below=np.zeros(shape))

    def judge(self, epoch: Epoch) -> Verdict:
        innovation, judged = self._without_bias(epoch)
        settings = (*self._rows, self.allowance)
        sums = self.memory["above"], self.memory["below"]
        signal, out = (innovation, epoch.innovation_variance, judged), np.empty(judged.shape)
        statistic = advance_sums(*signal, *settings, *sums, out)
        return compare(statistic, self.limit)


BASELINE_SDS = 5.0
"""Standard deviations of the baseline's error that the drift covers at least."""


@njit
def sum_channels(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    visible: BoolArray,
    first_row: int,
    signals: int,
    lag: int,
    baseline: int,
    drift: float,
    ring: FloatArray,
    base: FloatArray,
    above: FloatArray,
    below: FloatArray,
    count: IntArray,
    statistic: FloatArray,
) -> None:
    """Advance all sums by one epoch. Memory: `ring` (B, signals * n, L) last values, `base`,
    `above`, `below` (B, signals * n) sum of the baseline and the two sums, `count` (B, n);
    `statistic` (B, n), written."""
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


@settings_record
class LagCusum(InnovationTest):
    """Two-sided cumulative sum of every innovation against its own past; monitor only."""

    drift: float = setting(
        default=0.5,
        above=0.0,
        unit="standard deviations",
        help="Kappa: half of the change that is looked for.",
    )
    threshold: float = setting(default=13.3, above=0.0, unit="standard deviations", help="Limit h.")
    lag: int = window_epochs(150, "How far back the baseline ends.")
    baseline: int = window_epochs(300, "Greatest length of the baseline.")
    signals: str = signals_to_test("pseudorange", "Innovations to sum.")

    paper: ClassVar[str] = "page1954"
    scope: ClassVar[str] = "channel"
    drifts: ClassVar[bool] = True

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        receivers, n = context.receivers, context.channels
        series = (receivers, self._per_satellite * n)
        self.memory_epochs = self.lag + self.baseline + 1
        self.memory.declare_all(
            ring=np.zeros((*series, self.memory_epochs)),
            base=np.zeros(series),
            above=np.zeros(series),
            below=np.zeros(series),
            count=np.zeros((receivers, n), dtype=np.int64),
        )

    def judge(self, epoch: Epoch) -> Verdict:
        statistic = np.empty(epoch.visible.shape)
        sum_channels(
            epoch.innovation,
            epoch.innovation_variance,
            epoch.visible,
            self._rows[0],
            self._per_satellite,
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
        return compare(statistic, self.threshold)
