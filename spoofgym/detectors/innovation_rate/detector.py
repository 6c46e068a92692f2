r"""Rate of every satellite's innovation, with robust weights in the loop if wanted.

A constant offset of an innovation, such as a satellite bias leaves, is no sign of an attack; that
it changes is.  A small Kalman filter (`rate_filter`) estimates the rate v of the normalized
pseudorange innovation, and an alarm is raised where

.. math:: |v_k| > z_{a_0 / 2} \sqrt{P_{v,k}}, \qquad a_0 = 1 - (1 - P_{fa})^{1/n},
    \qquad \omega_k = r_k / \sqrt{S_{k,jj}},

which is the paper's method M1.  With `weight_scale` the same statistic weighs the satellite's
column of the Kalman gain by IGG-III, its method M2.

Symbols: r innovation of pseudorange j [m], S innovation covariance, :math:`P_v` variance of v,
:math:`P_{fa}` false-alarm probability of an epoch of the receiver, n visible satellites, m
`weight_scale`; the weights fall off between m T / 2 and m T, T the threshold.

Assumptions: normalized innovations are white and of variance 1 about a constant.  In the paper's
receiver they are smaller, so that alarms are rarer than stated; and so they are in the first
samples, when the filter still allows for a first level and rate that are not there.  In a receiver
that assumes the noise of its world (``tuning="matched"``) the rate is the stated one: 4.7 % for 5 %
in 256 runs of the flight of `ke2022`; with a memory of 100 s it is 0.1 %.

A filter without a memory span fits one line to all samples since it began: :math:`P_v` falls as
12 / N^3 and its gain as 6 / N^2, so that the longer it has run the later it sees an onset.
`memory_s` forgets the past exponentially; the filter's own variance is then larger than the true
one, and the test the stricter.

Deviations from `ke2022`:

1. The threshold follows the filter's own variance.  The printed constant 0.0029517 is this
   threshold for 8 satellites and 4e-6 after about 330 samples; `threshold` takes it.
2. The test is two-sided, as the quantile in its eq. 25 is.
3. `start_s` and `settled_s` are not given by the paper, by which nothing can be detected before
   convergence; with the constant threshold 20 s and 200 s come closest.
4. A satellite whose weight has been zero for `max_exclusion_s` is let in again and its filter
   starts again, and the `min_satellites` least suspicious ones always have a weight; otherwise
   errors that persist would lock satellites out for good.  The paper has no such guard; with
   ``max_exclusion_s=None, min_satellites=0`` there is none.
5. The range rates keep weight 1.
6. A satellite that sets and rises starts again.

Source: `ke2022`, eqs. 14 and 24 to 29; the filter is from `bhatti2012`, the weights from
`yang1999`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..._describe import OMITTED
from ..._jit import njit
from ..._registry import check_finite
from ...receiver.epoch import Epoch
from ...sim.noise import exponential
from ..base import Detector, DetectorContext, Verdict
from ..lockout import check_limits, readmit_nearest
from ..thresholds import check_probability, igg3_weight, two_sided_quantile
from .rate_filter import FIRST_COVARIANCE, advance, restart

FloatArray = NDArray[np.float64]


def channel_quantiles(false_alarm: float, channels: int) -> FloatArray:
    r"""Quantiles of one channel for a false-alarm probability of all, by the number of channels.

    .. math:: z_{a_0 / 2}, \qquad a_0 = 1 - (1 - P_{fa})^{1/n}

    `false_alarm`: P_fa, in (0, 1); returns (channels + 1,); the entry of no channel is that of one.
    """
    shares = [-math.expm1(math.log1p(-false_alarm) / max(n, 1)) for n in range(channels + 1)]
    return np.array([two_sided_quantile(share) for share in shares])


@njit
def judge_rates(
    time: FloatArray,
    interval: FloatArray,
    innovation: FloatArray,
    innovation_variance: FloatArray,
    visible: NDArray[np.bool_],
    added: FloatArray,
    quantiles: FloatArray,
    fixed_threshold: float,
    correlation: float,
    noise: float,
    memory_s: float,
    start_s: float,
    settled_s: float,
    weight_scale: float,
    alarm_scale: float,
    state: FloatArray,
    covariance: FloatArray,
    size: FloatArray,
    threshold: FloatArray,
    weights: FloatArray,
    alarm: NDArray[np.bool_],
) -> None:
    """Advance all filters by one epoch.

    `added` (B, n) what is added to the pseudorange innovations [m]; `quantiles` (n+1,) z by the
    number of visible satellites; `state`, `covariance` (B, n, 3), (B, n, 6) memory, overwritten;
    `size`, `threshold` (B, n), written: statistic and threshold [1/s], without `alarm_scale`, which
    the alarm's is multiplied by; `weights` (B, 2n), written:
    IGG-III for pseudoranges, 1 for range rates; `alarm` (B, n), written.
    """
    channels = visible.shape[1]
    for b in range(visible.shape[0]):
        seen = 0
        for j in range(channels):
            seen += visible[b, j]
        growth = 1.0 / exponential(-interval[b] / memory_s)
        for j in range(channels):
            x, P = state[b, j], covariance[b, j]
            if not visible[b, j]:
                restart(x, P)
            elif time[b] >= start_s:
                sample = (innovation[b, j] + added[b, j]) / math.sqrt(innovation_variance[b, j])
                advance(x, P, sample, interval[b], correlation, noise, growth)
            size[b, j] = abs(x[1])
            limit = fixed_threshold if fixed_threshold > 0.0 else quantiles[seen] * math.sqrt(P[3])
            threshold[b, j] = limit
            settled = time[b] >= settled_s
            alarm[b, j] = settled and size[b, j] > alarm_scale * limit
            weights[b, j] = weights[b, channels + j] = 1.0
            if settled and weight_scale > 0.0:
                reject = weight_scale * limit
                weights[b, j] = igg3_weight(size[b, j], 0.5 * reject, reject)


@njit
def guard_against_lockout(
    interval: FloatArray,
    visible: NDArray[np.bool_],
    size: FloatArray,
    threshold: FloatArray,
    max_exclusion_s: float,
    min_satellites: int,
    excluded_s: FloatArray,
    state: FloatArray,
    covariance: FloatArray,
    weights: FloatArray,
) -> None:
    """Let satellites in again that were out for too long, or that are needed.

    `size`, `threshold` (B, n) statistic and threshold; `max_exclusion_s`: longest time at weight
    zero [s]; then the channel starts again; `excluded_s` (B, n) time at weight zero, overwritten;
    `state`, `covariance` (B, n, 3), (B, n, 6) memory of the filters, overwritten; `weights`
    (B, 2n), overwritten.
    """
    for b in range(visible.shape[0]):
        used = 0
        for j in range(visible.shape[1]):
            out = visible[b, j] and weights[b, j] == 0.0
            excluded_s[b, j] = excluded_s[b, j] + interval[b] if out else 0.0
            if excluded_s[b, j] > max_exclusion_s:
                restart(state[b, j], covariance[b, j])
                excluded_s[b, j], weights[b, j] = 0.0, 1.0
            used += visible[b, j] and weights[b, j] > 0.0
        readmit_nearest(size[b], threshold[b], visible[b], min_satellites - used, weights[b])
        for j in range(visible.shape[1]):
            if weights[b, j] > 0.0:
                excluded_s[b, j] = 0.0


SETTLING_S = 180.0
"""Time in which a filter that forgets nothing gets sluggish: it finds a ramp of 0.2 m/s in 87, 42
and 6 % of runs when it has been live for 20, 60 and 180 s."""


@dataclass
class InnovationRate(Detector):
    """Test of the rate of every satellite's normalized pseudorange innovation.

    Parameters
    ----------
    false_alarm : float
        Probability of an alarm in one epoch of the receiver, in (0, 1), where the filter's belief
        is right.
    threshold : float or None
        Constant threshold [1/s], 0.0029517 in the paper; None for that of the filter's variance.
    weight_scale : float or None
        m, in (0, 1]: the weight thresholds are m T and m T / 2, 1 in the paper's M2.  None for a
        passive test, M1.
    correlation_per_s : float
        Alpha [1/s], above 0; the paper has 0.5 to 0.9, which makes no difference.
    noise : float
        Epsilon [1/s^3], at least 0; the paper has 1e-9 to 1e-7.
    memory_s : float or None
        Time in which the filter forgets the past [s]; None to forget nothing.
    start_s, settled_s : float
        Time of the run at which the filter starts, and from which on it alarms and weighs [s].
    max_exclusion_s : float or None
        Longest time that a satellite has no weight [s]; None for no limit.
    min_satellites : int
        How many visible satellites have a weight at least, at least 0.
    alarm_scale : float
        Factor on the threshold of the alarm, above 0; weights go by the threshold without it.
    """

    described_as = "InnovationRate"
    false_alarm: float = 4e-6
    threshold: float | None = None
    weight_scale: float | None = None
    correlation_per_s: float = 0.7
    noise: float = 1e-9
    memory_s: float | None = None
    start_s: float = 0.0
    settled_s: float = 0.0
    max_exclusion_s: float | None = 120.0
    min_satellites: int = 5
    alarm_scale: float = field(default=1.0, kw_only=True, metadata=OMITTED)

    paper: ClassVar[str] = "ke2022"
    scope: ClassVar[str] = "channel"

    def __post_init__(self) -> None:
        check_probability("false_alarm", self.false_alarm)
        if self.weight_scale is not None and not 0.0 < self.weight_scale <= 1.0:
            raise ValueError(f"`weight_scale` must be in (0, 1] or None, got {self.weight_scale}")
        for name in ("threshold", "memory_s"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < math.inf:
                raise ValueError(f"`{name}` must be finite and > 0 or None, got {value}")
        if not 0.0 < self.correlation_per_s < math.inf:
            raise ValueError(
                f"`correlation_per_s` must be finite and > 0, got {self.correlation_per_s}"
            )
        for name in ("noise", "start_s", "settled_s"):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ValueError(f"`{name}` must be finite and >= 0, got {value}")
        check_limits(self.max_exclusion_s, self.min_satellites)
        check_finite("alarm_scale", self.alarm_scale, "> 0")

    @property
    def alarm_is_state(self) -> bool:
        """It is off before `settled_s`."""
        return self.settled_s > 0.0

    def armed(self, epoch: Epoch) -> NDArray[np.bool_]:
        """(B,) bool, whose alarms are on at an epoch."""
        on: NDArray[np.bool_] = epoch.time >= self.settled_s
        return on

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        shape = (context.receivers, context.channels)
        self.memory.declare("state", np.zeros((*shape, 3)))
        self.memory.declare("covariance", np.tile(FIRST_COVARIANCE, (*shape, 1)))
        self.memory.declare("excluded_s", np.zeros(shape))
        self._quantiles = channel_quantiles(self.false_alarm, context.channels)
        self._nothing = np.zeros(shape)
        remembers_s = SETTLING_S if self.memory_s is None else self.memory_s
        self.memory_epochs = round(remembers_s / context.epoch_interval_s)

    def added(self, epoch: Epoch) -> FloatArray:
        """What is added to the innovations: nothing, but in the oracles.  Returns (B, n) [m]."""
        return self._nothing

    def judge(self, epoch: Epoch) -> Verdict:
        """Judge one epoch. Returns (B, n) size of the rates [1/s], thresholds, alarms; (B, 2n)
        weights, 1 for range rates."""
        shape = epoch.visible.shape
        size, threshold = np.empty(shape), np.empty(shape)
        weights, alarm = np.empty(epoch.innovation.shape), np.empty(shape, dtype=np.bool_)
        state, covariance = self.memory["state"], self.memory["covariance"]
        judge_rates(
            epoch.time,
            epoch.interval,
            epoch.innovation,
            epoch.innovation_variance,
            epoch.visible,
            self.added(epoch),
            self._quantiles,
            self.threshold or 0.0,
            self.correlation_per_s,
            self.noise,
            math.inf if self.memory_s is None else self.memory_s,
            self.start_s,
            self.settled_s,
            self.weight_scale or 0.0,
            self.alarm_scale,
            state,
            covariance,
            size,
            threshold,
            weights,
            alarm,
        )
        limit = self.alarm_scale * threshold
        if self.weight_scale is None:
            return Verdict(size, limit, alarm)
        guard_against_lockout(
            epoch.interval,
            epoch.visible,
            size,
            threshold,
            math.inf if self.max_exclusion_s is None else self.max_exclusion_s,
            self.min_satellites,
            self.memory["excluded_s"],
            state,
            covariance,
            weights,
        )
        return Verdict(size, limit, alarm, weights)
