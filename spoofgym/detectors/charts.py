r"""EWMA, joint and Shewhart charts.

EWMA control chart of the innovations, with robust weights in the loop.

The pseudorange innovations of every satellite are averaged with weights that fall off
exponentially,

.. math:: \Lambda_k = \lambda z_k + (1 - \lambda) \Lambda_{k-1}, \qquad \Lambda_0 = 0,

and an alarm is raised where

.. math:: |\Lambda_k| > T_k = z_{\alpha/2} \, \sigma_k
    \sqrt{\tfrac{\lambda}{2 - \lambda} \left(1 - (1 - \lambda)^{2k}\right)}, \qquad
    \sigma_k^2 = S_{k,jj}.

The same statistic weighs the satellite's column of the Kalman gain by IGG-III between
:math:`T_{d0} = T_{d1} / 2` and :math:`T_{d1} = m T_k`, so that the filter does not get used to
an offset, and an offset of one satellite does not reach the others.

Symbols: z innovation of pseudorange j [m], S innovation covariance, :math:`\lambda` smoothing
factor, :math:`\alpha` false-alarm probability of one epoch, m scale of the weight thresholds.

Assumptions: innovations are white and of the variance that the filter believes in.  In the papers'
receiver they are smaller, and correlated by constant satellite biases.

Deviations from `zhong2025`, whose method M2 this is:

1. The paper writes the case limits of the weights for :math:`\Lambda`; as the chart is two-sided
   they are taken for its size.
2. :math:`\lambda` is not printed; 0.1 reproduces its delays.
3. m = 0.1 as printed locks satellites out for good; the default is 0.3.
4. The range rates keep weight 1, and the covariance update with the unweighted gain is the
   receiver's default (``covariance_update="unweighted"``), without which the delays are not met.
5. A satellite that sets and rises starts again.
6. Exclusion can be limited in time and in number (`limit_exclusions`).  It is not by default, so
   that the chart stays the one that the shipped spoofers were trained against.

Source: `zhong2025`, eqs. 11 to 14; the chart is from `roberts1959`, the weights from `yang2002`.

Joint chart: the onset by an EWMA chart, the end of spoofing by its ratio to the innovation.

The average of an EWMA chart finds a small offset soon, but keeps alarming long after its end.  The
present innovation forgets at once.  So once the chart has alarmed, the ratio of the two,

.. math:: \xi_k = z_k / \Lambda_k, \qquad
    \Lambda_k = \lambda z_k + (1 - \lambda) \Lambda_{k-1}

is near 1 as long as the offset lasts, and falls to about 0 at the first epoch without it.  There
the alarm ends, and chart and threshold start again: :math:`\Lambda = 0`, k = 0 in

.. math:: T_k = z_{\alpha/2} \, \sigma_k
    \sqrt{\tfrac{\lambda}{2 - \lambda} \left(1 - (1 - \lambda)^{2k}\right)}

Spoofing begins where :math:`|\Lambda_k| > T_k`.  It ends where the chart falls below T by itself,
or where the newest of three ratios :math:`\xi` drops: by more than :math:`T_3` below both others,
to less than :math:`1 - T_3`.  The alarm is the flag between the two, so that an attack's interval
can be read off it (`spoofgym.bench.runs.episode`).  Satellites are weighed as by the EWMA chart.

Symbols: z innovation of a pseudorange [m], :math:`\sigma` its standard deviation by the filter's
belief, :math:`\lambda` smoothing factor, :math:`\alpha` false-alarm probability of one epoch.

Assumptions: the offset does not go away gradually, and exceeds the noise by far: the ratio scatters
by about noise over offset, and :math:`T_3 = 0.6` is no quantile of that.

Deviations from `zhong2025`, whose method M3 this is:

1. The paper ends spoofing where any of the three ratios is further than :math:`T_3` from their
   median.  With the zeros for the time before the alarm that ends it as soon as it
   begins; the paper's figures show it otherwise.  The rule above asks for a full window since the
   alarm and for a drop of the newest ratio.  ``end_rule="literal"`` is the printed one, tested from
   the epoch after the onset on.
2. The ratio is formed only where :math:`|\Lambda| > T`, which keeps it finite.
3. The time index of the threshold is set back with :math:`\Lambda`.
4. m = 0.1 as printed locks satellites out; the default is 0.3, and exclusion is limited, by
   `limit_exclusions`; ``weight_scale=0.1, max_exclusion_s=None, min_satellites=0`` is the paper's.
5. A satellite that sets and rises starts again.

The rate of false alarms is a little below that of the EWMA chart, since a false alarm can end
early.

Source: `zhong2025`, eqs. 11 to 14 and 17 to 23.

Shewhart control chart of the innovations.

Every innovation is judged for itself, by the standard deviation that the filter believes it has,
so that the chart sees a jump at once and forgets it at once.  A drift to which the filter gets used
stays within the limits, and when an offset ends that the filter has followed, the innovations jump
to the other side and alarm although the attack is over.  The chart is the first half of zhong2025's
joint chart, and its method M1.

.. math:: |z_{k,j}| > z_{\alpha/2} \, \sigma_{k,j}, \qquad \sigma_{k,j}^2 = S_{k,jj}

Symbols: z innovation, S innovation covariance, :math:`\alpha` false-alarm probability of one
satellite in one epoch.

Assumptions: innovations are normal and of the variance that the filter believes in.

Deviations from `zhong2025`, whose method M1 this is:

1. The statistic is divided by :math:`\sigma`, and the threshold is :math:`z_{\alpha/2}`: the same
   alarms, and the same unit for pseudoranges and range rates.
2. The paper tests pseudoranges alone, which is the default.  With ``signals="both"`` a satellite's
   statistic is the larger of its two, and each is tested at :math:`\alpha/2`.
3. The paper's M1 has no weights; nor has this one by default.  `weight_scale` gives it those that
   M2 has, with limits of exclusion (`limit_exclusions`).

Source: `zhong2025`, eqs. 15 and 16; the chart is from `shewhart1931`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.compile import inlined, njit
from ..core.registry import check_finite
from ..core.settings import OMITTED
from ..receiver.epoch import Epoch
from .base import Detector, DetectorContext, Verdict
from .innovation import (
    InnovationTest,
    check_limits,
    check_probability,
    epochs_to_settle,
    ewma_threshold,
    igg3_weight,
    limit_exclusions,
    longest_exclusion,
    two_sided_quantile,
)

FloatArray = NDArray[np.float64]


@njit
def judge_channels(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    visible: NDArray[np.bool_],
    smoothing: float,
    quantile: float,
    weight_scale: float,
    average: FloatArray,
    decay: FloatArray,
    size: FloatArray,
    threshold: FloatArray,
    weights: FloatArray,
) -> None:
    """Advance all charts by one epoch. `innovation`, `innovation_variance`, `visible` (B, 2n), (B,
    2n), (B, n), of the epoch; `average`, `decay` (B, n) memory, overwritten; `size`, `threshold`
    (B, n), written: statistic and threshold [m]; `weights` (B, 2n), written: IGG-III for
    pseudoranges, 1 for range rates."""
    for b in range(visible.shape[0]):
        for j in range(visible.shape[1]):
            if visible[b, j]:
                decay[b, j] *= (1.0 - smoothing) * (1.0 - smoothing)
                average[b, j] += smoothing * (innovation[b, j] - average[b, j])
            else:
                decay[b, j], average[b, j] = 1.0, 0.0
            sd = math.sqrt(innovation_variance[b, j])
            first = (1.0 - smoothing) * (1.0 - smoothing)
            limit = ewma_threshold(sd, min(decay[b, j], first), smoothing, quantile)
            size[b, j] = abs(average[b, j])
            threshold[b, j] = limit
            reject = weight_scale * limit
            weights[b, j] = igg3_weight(size[b, j], 0.5 * reject, reject)
            weights[b, visible.shape[1] + j] = 1.0


@dataclass
class Ewma(Detector):
    """EWMA chart of every satellite's pseudorange innovation, with robust weights in the loop.

    Parameters
    ----------
    smoothing : float
        Lambda, in (0, 1].
    false_alarm : float
        Alpha, probability of an alarm of one satellite in one epoch, in (0, 1).
    weight_scale : float or None
        m, in (0, 1]: the weight thresholds are m T and m T / 2.  None for a passive
        chart.
    max_exclusion_s : float or None
        Longest time that a satellite can have weight 0 without an alarm, above 0; None for no
        limit.
    min_satellites : int
        Fewest satellites that keep a weight above 0, where as many are in view; 0 for none.
    """

    described_as = "Ewma"
    smoothing: float = 0.1
    false_alarm: float = 1e-5
    weight_scale: float | None = 0.3
    max_exclusion_s: float | None = None
    min_satellites: int = 0

    paper: ClassVar[str] = "zhong2025"
    scope: ClassVar[str] = "channel"

    def __post_init__(self) -> None:
        if not 0.0 < self.smoothing <= 1.0:
            raise ValueError(f"`smoothing` must be in (0, 1], got {self.smoothing}")
        check_probability("false_alarm", self.false_alarm)
        if self.weight_scale is not None and not 0.0 < self.weight_scale <= 1.0:
            raise ValueError(f"`weight_scale` must be in (0, 1] or None, got {self.weight_scale}")
        check_limits(self.max_exclusion_s, self.min_satellites)

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        shape = (context.receivers, context.channels)
        self.memory_epochs = epochs_to_settle(self.smoothing)
        self.memory.declare("average", np.zeros(shape))
        self.memory.declare("decay", np.ones(shape))
        self._quantile = two_sided_quantile(self.false_alarm)
        self._longest = longest_exclusion(self.max_exclusion_s, context.epoch_interval_s)
        limited = self.max_exclusion_s is not None or self.min_satellites > 0
        self.limits_exclusions = limited and self.weight_scale is not None
        if self.limits_exclusions:
            self.memory.declare("excluded", np.zeros(shape, dtype=np.int64))
        scale = 1.0 if self.weight_scale is None else self.weight_scale
        self.kernel_settings = np.array([self.smoothing, self._quantile, scale])

    def judge(self, epoch: Epoch) -> Verdict:
        """Judge one epoch. Returns (B, n) size of the averages, thresholds, alarms; (B, 2n)
        weights, 1 for range rates."""
        shape = epoch.visible.shape
        size, threshold = np.empty(shape), np.empty(shape)
        weights = np.empty(epoch.innovation.shape)
        smoothing, quantile, scale = self.kernel_settings.tolist()
        judge_channels(
            epoch.innovation,
            epoch.innovation_variance,
            epoch.visible,
            smoothing,
            quantile,
            scale,
            self.memory["average"],
            self.memory["decay"],
            size,
            threshold,
            weights,
        )
        in_loop = None if self.weight_scale is None else weights
        if self.limits_exclusions:
            limit_exclusions(
                size,
                threshold,
                epoch.visible,
                self._longest,
                self.min_satellites,
                self.memory["excluded"],
                weights,
            )
        return Verdict(size, threshold, size > threshold, in_loop)

    def settling_epochs(self, offset: float, threshold: float) -> float:
        r"""Epochs until the chart falls below the threshold after a constant offset has ended.

        .. math:: n = \frac{\ln(T / b)}{\ln(1 - \lambda)}

        `offset`: b, what the chart had settled on [m]; `threshold`: T [m].
        """
        return math.log(threshold / offset) / math.log(1.0 - self.smoothing)


END_RULES = ("drop", "literal")


@inlined
def has_dropped(older: float, old: float, newest: float, drop: float) -> bool:
    r"""Whether the newest of three ratios shows the end of an offset.

    .. math:: \min(\xi_{k-2}, \xi_{k-1}) - \xi_k > T_3, \qquad \xi_k < 1 - T_3
    """
    return min(older, old) - newest > drop and newest < 1.0 - drop


@inlined
def spread_of(older: float, old: float, newest: float) -> float:
    r"""Largest distance of three ratios from their median.

    .. math:: \Delta = \max_i |\xi_i - \operatorname{med}(\xi)|
    """
    low = min(older, old, newest)
    high = max(older, old, newest)
    median = older + old + newest - low - high
    return max(high - median, median - low)


@njit
def judge_joint_channels(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    visible: NDArray[np.bool_],
    smoothing: float,
    quantile: float,
    drop: float,
    literal: bool,
    alarm_scale: float,
    average: FloatArray,
    decay: FloatArray,
    ratios: FloatArray,
    spoofed: NDArray[np.int64],
    size: FloatArray,
    threshold: FloatArray,
) -> None:
    """Advance all charts by one epoch.

    `innovation`, `innovation_variance`, `visible` (B, 2n), (B, 2n), (B, n), of the epoch;
    `average`, `decay` (B, n) memory, overwritten; `ratios` (B, n, 2) memory, overwritten: the last
    ratios, the older one first; 0 before the alarm; `spoofed` (B, n) memory, overwritten: epochs
    since the alarm began, itself counted; 0 for none; `size`, `threshold` (B, n), written:
    statistic and threshold [m], without `alarm_scale`, which the alarm's is multiplied by.
    """
    keep = (1.0 - smoothing) * (1.0 - smoothing)
    for b in range(visible.shape[0]):
        for j in range(visible.shape[1]):
            if visible[b, j]:
                decay[b, j] *= keep
                average[b, j] += smoothing * (innovation[b, j] - average[b, j])
            else:
                decay[b, j], average[b, j] = 1.0, 0.0
            sd = math.sqrt(innovation_variance[b, j])
            limit = ewma_threshold(sd, min(decay[b, j], keep), smoothing, quantile)
            threshold[b, j] = limit
            ended = not abs(average[b, j]) > alarm_scale * limit
            if not ended:
                older, old = ratios[b, j, 0], ratios[b, j, 1]
                newest = innovation[b, j] / average[b, j]
                ratios[b, j, 0], ratios[b, j, 1] = old, newest
                if literal:
                    ended = spoofed[b, j] > 0 and spread_of(older, old, newest) > drop
                else:
                    ended = spoofed[b, j] > 1 and has_dropped(older, old, newest, drop)
                if ended:
                    decay[b, j], average[b, j] = 1.0, 0.0
            spoofed[b, j] = 0 if ended else spoofed[b, j] + 1
            if ended:
                ratios[b, j, 0], ratios[b, j, 1] = 0.0, 0.0
            size[b, j] = abs(average[b, j])


@njit
def chart_weights(size: FloatArray, threshold: FloatArray, weight_scale: float) -> FloatArray:
    """IGG-III weights of the pseudoranges; 1 for the range rates. `size`, `threshold` (B, n) of the
    charts [m]; returns (B, 2n)."""
    receivers, n = size.shape
    out = np.ones((receivers, 2 * n))
    for b in range(receivers):
        for j in range(n):
            reject = weight_scale * threshold[b, j]
            out[b, j] = igg3_weight(size[b, j], 0.5 * reject, reject)
    return out


@dataclass
class JointChart(Detector):
    """EWMA chart whose alarm ends with the offset, with robust weights in the loop.

    Parameters
    ----------
    smoothing : float
        Lambda, in (0, 1].
    false_alarm : float
        Alpha, probability of an alarm of one satellite in one epoch, in (0, 1).
    weight_scale : float or None
        m, in (0, 1]: the weight thresholds are m T and m T / 2.  None for a passive
        chart.
    drop : float
        T_3, in (0, 1): fall of the ratio that ends an alarm.
    end_rule : {"drop", "literal"}
        The rule above, or the printed one.
    max_exclusion_s : float or None
        Longest time that a satellite can have weight 0 without an alarm, above 0; None for no
        limit.
    min_satellites : int
        Fewest satellites that keep a weight above 0, where as many are in view; 0 for none.
    alarm_scale : float
        Factor on the threshold of the alarm, above 0; weights go by the threshold without it.
    """

    described_as = "JointChart"
    smoothing: float = 0.1
    false_alarm: float = 1e-5
    weight_scale: float | None = 0.3
    drop: float = 0.6
    end_rule: str = "drop"
    max_exclusion_s: float | None = 60.0
    min_satellites: int = 5
    alarm_scale: float = field(default=1.0, kw_only=True, metadata=OMITTED)

    paper: ClassVar[str] = "zhong2025"
    scope: ClassVar[str] = "channel"

    def __post_init__(self) -> None:
        if not 0.0 < self.smoothing <= 1.0:
            raise ValueError(f"`smoothing` must be in (0, 1], got {self.smoothing}")
        check_probability("false_alarm", self.false_alarm)
        if self.weight_scale is not None and not 0.0 < self.weight_scale <= 1.0:
            raise ValueError(f"`weight_scale` must be in (0, 1] or None, got {self.weight_scale}")
        if not 0.0 < self.drop < 1.0:
            raise ValueError(f"`drop` must lie between 0 and 1, both excluded, got {self.drop}")
        if self.end_rule not in END_RULES:
            raise ValueError(
                f"`end_rule` must be one of {', '.join(map(repr, END_RULES))}, "
                f"got {self.end_rule!r}"
            )
        check_limits(self.max_exclusion_s, self.min_satellites)
        check_finite("alarm_scale", self.alarm_scale, "> 0")

    @property
    def alarm_is_state(self) -> bool:
        """It stays up until the offset ends."""
        return True

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        shape = (context.receivers, context.channels)
        self.memory_epochs = epochs_to_settle(self.smoothing)
        self.memory.declare("average", np.zeros(shape))
        self.memory.declare("decay", np.ones(shape))
        self.memory.declare("ratios", np.zeros((*shape, 2)))
        self.memory.declare("spoofed", np.zeros(shape, dtype=np.int64))
        self.memory.declare("excluded", np.zeros(shape, dtype=np.int64))
        self._quantile = two_sided_quantile(self.false_alarm)
        self._longest = longest_exclusion(self.max_exclusion_s, context.epoch_interval_s)

    def judge(self, epoch: Epoch) -> Verdict:
        """Judge one epoch. Returns (B, n) size of the averages, thresholds, whether each satellite
        is being spoofed; (B, 2n) weights, 1 for range rates."""
        shape, memory = epoch.visible.shape, self.memory
        size, threshold = np.empty(shape), np.empty(shape)
        judge_joint_channels(
            epoch.innovation,
            epoch.innovation_variance,
            epoch.visible,
            self.smoothing,
            self._quantile,
            self.drop,
            self.end_rule == "literal",
            self.alarm_scale,
            memory["average"],
            memory["decay"],
            memory["ratios"],
            memory["spoofed"],
            size,
            threshold,
        )
        alarm, limit = memory["spoofed"] > 0, self.alarm_scale * threshold
        if self.weight_scale is None:
            return Verdict(size, limit, alarm)
        weights = chart_weights(size, threshold, self.weight_scale)
        limit_exclusions(
            size,
            threshold,
            epoch.visible,
            self._longest,
            self.min_satellites,
            memory["excluded"],
            weights,
        )
        return Verdict(size, limit, alarm, weights)


@njit
def largest_normalized(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    judged: NDArray[np.bool_],
    first: int,
    last: int,
) -> FloatArray:
    r"""Size of every satellite's innovation in standard deviations, the largest of its rows.

    .. math:: F_j = \max_r |z_r| / \sqrt{S_{rr}}

    `innovation`, `innovation_variance` (B, 2n); `judged` (B, n) bool, satellites to test;
    returns (B, n); 0 for the others.
    """
    receivers, n = judged.shape
    out = np.zeros((receivers, n))
    for b in range(receivers):
        for r in range(first, last):
            if judged[b, r % n]:
                size = abs(innovation[b, r]) / math.sqrt(innovation_variance[b, r])
                out[b, r % n] = max(out[b, r % n], size)
    return out


@njit
def snapshot_weights(statistic: FloatArray, reject: float) -> FloatArray:
    """IGG-III weights of the pseudoranges; 1 for the range rates. `statistic` (B, n); returns (B,
    2n)."""
    receivers, n = statistic.shape
    out = np.ones((receivers, 2 * n))
    for b in range(receivers):
        for j in range(n):
            out[b, j] = igg3_weight(statistic[b, j], 0.5 * reject, reject)
    return out


@dataclass
class Shewhart(InnovationTest):
    """Every satellite's innovation against its own standard deviation.

    Parameters
    ----------
    false_alarm : float
        Alpha, probability of an alarm of one satellite in one epoch, in (0, 1).
    weight_scale : float or None
        m, in (0, 1]: the pseudorange gets no weight from m times the threshold on, and less than 1
        from half of that.  None for a passive chart.
    signals : {"pseudorange", "range_rate", "both"}
        Innovations to test.
    bias_window_s : float
        Length of the first window whose mean innovation is taken away from every channel, which is
        not judged before; 0 for none.
    max_exclusion_s : float or None
        Longest time that a satellite can have weight 0 without an alarm, above 0; None for no
        limit.
    min_satellites : int
        Fewest satellites that keep a weight above 0, where as many are in view; 0 for none.
    """

    described_as = "Shewhart"
    false_alarm: float = 1e-5
    weight_scale: float | None = None
    signals: str = "pseudorange"
    bias_window_s: float = 0.0
    max_exclusion_s: float | None = 60.0
    min_satellites: int = 5

    paper: ClassVar[str] = "zhong2025"
    scope: ClassVar[str] = "channel"

    def __post_init__(self) -> None:
        if self.weight_scale is not None and not 0.0 < self.weight_scale <= 1.0:
            raise ValueError(f"`weight_scale` must be in (0, 1] or None, got {self.weight_scale}")
        super().__post_init__()
        check_limits(self.max_exclusion_s, self.min_satellites)

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        self._quantile = two_sided_quantile(self.false_alarm / self._per_satellite)
        shape = (context.receivers, context.channels)
        self.memory.declare("excluded", np.zeros(shape, dtype=np.int64))
        self._longest = longest_exclusion(self.max_exclusion_s, context.epoch_interval_s)

    def judge(self, epoch: Epoch) -> Verdict:
        """Judge one epoch. Returns (B, n) innovations in standard deviations, thresholds, alarms;
        (B, 2n) weights, 1 for range rates."""
        innovation, judged = self._without_bias(epoch)
        statistic = largest_normalized(innovation, epoch.innovation_variance, judged, *self._rows)
        threshold = np.full(statistic.shape, self._quantile)
        weights = None
        if self.weight_scale is not None:
            weights = snapshot_weights(statistic, self.weight_scale * self._quantile)
            limit_exclusions(
                statistic,
                threshold,
                epoch.visible,
                self._longest,
                self.min_satellites,
                self.memory["excluded"],
                weights,
            )
        return Verdict(statistic, threshold, statistic > threshold, weights)
