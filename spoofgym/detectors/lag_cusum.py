r"""Cumulative sums of every satellite's innovation against its own past.

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

from .._jit import njit
from ..receiver.epoch import Epoch
from .base import Detector, DetectorContext, Verdict
from .innovation_test import check_signals
from .thresholds import check_epochs

FloatArray = NDArray[np.float64]
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
