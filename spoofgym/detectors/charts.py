r"""Control charts of `zhong2025` for every satellite: EWMA (M2), joint (M3) and Shewhart (M1).

Symbols: z innovation of pseudorange j [m], :math:`\sigma^2 = S_{jj}` its variance by the filter's
belief, :math:`\lambda` smoothing factor, :math:`\alpha` false-alarm probability of one satellite in
one epoch, m scale of the weight thresholds.

Assumptions: innovations are white, normal and of the variance that the filter believes in.  In the
papers' receiver they are smaller, and correlated by constant satellite biases.

**EWMA chart** (eqs. 11 to 14; the chart is from `roberts1959`, the weights from `yang2002`):
innovations are averaged with weights that fall off exponentially, with an alarm where

.. math:: |\Lambda_k| > T_k = z_{\alpha/2} \, \sigma_k
    \sqrt{\tfrac{\lambda}{2 - \lambda} \left(1 - (1 - \lambda)^{2k}\right)}, \qquad
    \Lambda_k = \lambda z_k + (1 - \lambda) \Lambda_{k-1}, \quad \Lambda_0 = 0

The same statistic weighs the satellite's column of the Kalman gain by IGG-III between
:math:`T_{d0} = T_{d1} / 2` and :math:`T_{d1} = m T_k`, so that the filter does not get used to
an offset, and an offset of one satellite does not reach the others.  Deviations:

1. The paper writes the case limits of the weights for :math:`\Lambda`; as the chart is two-sided
   they are taken for its size.
2. :math:`\lambda` is not printed; 0.1 reproduces its delays.
3. m = 0.1 as printed locks satellites out for good; the default is 0.3.
4. The range rates keep weight 1, and the covariance update with the unweighted gain is the
   receiver's default (``covariance_update="unweighted"``), without which the delays are not met.
5. A satellite that sets and rises starts again.
6. Exclusion can be limited in time and in number (`limit_exclusions`).  It is not by default, so
   that the chart stays the one that the shipped spoofers were trained against.

**Joint chart** (eqs. 17 to 23): the average finds a small offset soon, but keeps alarming long
after its end; the present innovation forgets at once.  Once the chart has alarmed, their ratio
:math:`\xi_k = z_k / \Lambda_k` is near 1 as long as the offset lasts, and falls to about 0 at the
first epoch without it.  Spoofing begins where :math:`|\Lambda_k| > T_k`.  It ends where the chart
falls below T by itself, or where the newest of three ratios drops by more than :math:`T_3` below
both others, to less than :math:`1 - T_3`; then chart and threshold start again,
:math:`\Lambda = 0`, k = 0.  The alarm is the flag between the two, so that an attack's interval can
be read off it (`spoofgym.bench.runs.episode`).

It assumes that the offset does not go away gradually, and exceeds the noise by far: the ratio
scatters by about noise over offset, and :math:`T_3 = 0.6` is no quantile of that.  False alarms are
a little rarer than those of the EWMA chart, since they can end early.  Deviations:

1. The paper ends spoofing where any of the three ratios is further than :math:`T_3` from their
   median.  With the zeros for the time before the alarm that ends it as soon as it begins, other
   than in its figures.  The rule above takes a full window since the alarm and a drop of the newest
   ratio.  ``end_rule="literal"`` is the printed one, from the epoch after the onset on.
2. The ratio is formed only where :math:`|\Lambda| > T`, which keeps it finite.
3. The time index of the threshold is set back with :math:`\Lambda`.
4. The default of m is 0.3, and exclusion is limited, by `limit_exclusions`;
   ``weight_scale=0.1, max_exclusion_s=None, min_satellites=0`` is the paper's.
5. A satellite that sets and rises starts again.

**Shewhart chart** (eqs. 15 and 16; the chart is from `shewhart1931`): every innovation is judged
for itself, :math:`|z_k| > z_{\alpha/2} \, \sigma_k`.  It sees a jump at once and forgets it at
once; a drift to which the filter gets used stays within the limits, and when an offset ends that
the filter has followed, the innovations jump to the other side and alarm although the attack is
over.  Deviations:

1. The statistic is divided by :math:`\sigma`, and the threshold is :math:`z_{\alpha/2}`: the same
   alarms, and the same unit for pseudoranges and range rates.
2. The paper tests pseudoranges alone, which is the default.  With ``signals="both"`` a satellite's
   statistic is the larger of its two, and each is tested at :math:`\alpha/2`.
3. The paper's M1 has no weights, nor has this one by default; `weight_scale` gives it those of M2.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from ..core.compile import inline_njit, njit
from ..core.declared import setting, settings_record
from ..receiver.epoch import Epoch
from .base import BoolArray, Detector, DetectorContext, FloatArray, IntArray, Verdict, compare
from .innovation import (
    OF_ONE_SATELLITE,
    InnovationTest,
    alarm_probability,
    average_smoothing,
    epochs_to_settle,
    ewma_threshold,
    factor_on_alarm,
    fewest_weighed,
    first_window,
    igg3_weight,
    limit_exclusions,
    longest_exclusion,
    signals_to_test,
    two_sided_quantile,
    weight_limit,
)


class WeighingChart(Detector):
    """Base of charts that judge every satellite, and weigh its pseudorange by the same statistic.
    A subclass is a dataclass with these settings, which `Ewma` describes."""

    false_alarm: float
    weight_scale: float | None
    max_exclusion_s: float | None
    min_satellites: int

    paper: ClassVar[str] = "zhong2025"
    scope: ClassVar[str] = "channel"

    def _declare_exclusions(self, context: DetectorContext) -> None:
        limit_s, interval_s = self.max_exclusion_s, context.epoch_interval_s
        never = int(np.iinfo(np.int64).max)
        self._longest = (
            never if limit_s is None else max(1, round(min(limit_s / interval_s, never)))
        )
        shape = (context.receivers, context.channels)
        self.memory.declare("excluded", np.zeros(shape, dtype=np.int64))

    def _limit_exclusions(
        self, statistic: FloatArray, threshold: FloatArray, epoch: Epoch, weights: FloatArray
    ) -> None:
        least, excluded = self.min_satellites, self.memory["excluded"]
        limit_exclusions(
            statistic, threshold, epoch.visible, self._longest, least, excluded, weights
        )


@njit
def judge_channels(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    visible: BoolArray,
    smoothing: float,
    quantile: float,
    weight_scale: float,
    average: FloatArray,
    decay: FloatArray,
    size: FloatArray,
    threshold: FloatArray,
    weights: FloatArray,
) -> None:
    """Advance all charts by one epoch. `average`, `decay` (B, n) memory; `size`, `threshold` (B,
    n), written: statistic and threshold [m]; `weights` (B, 2n), written: IGG-III for pseudoranges,
    1 for range rates."""
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


@settings_record
class Ewma(WeighingChart):
    """EWMA chart of every satellite's pseudorange innovation, with robust weights in the loop."""

    smoothing: float = average_smoothing()
    false_alarm: float = alarm_probability(help=OF_ONE_SATELLITE)
    weight_scale: float | None = weight_limit(
        0.3, "Factor m: the weight thresholds are m T and m T / 2.  None for a passive chart."
    )
    max_exclusion_s: float | None = longest_exclusion(None)
    min_satellites: int = fewest_weighed(0)

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        shape = (context.receivers, context.channels)
        self.memory_epochs = epochs_to_settle(self.smoothing)
        self.memory.declare_all(average=np.zeros(shape), decay=np.ones(shape))
        limited = self.max_exclusion_s is not None or self.min_satellites > 0
        self.limits_exclusions = limited and self.weight_scale is not None
        if self.limits_exclusions:
            self._declare_exclusions(context)
        scale = 1.0 if self.weight_scale is None else self.weight_scale
        quantile = two_sided_quantile(self.false_alarm)
        self.kernel_settings = np.array([self.smoothing, quantile, scale])

    def judge(self, epoch: Epoch) -> Verdict:
        shape = epoch.visible.shape
        size, threshold = np.empty(shape), np.empty(shape)
        weights = np.empty(epoch.innovation.shape)
        smoothing, quantile, scale = self.kernel_settings.tolist()
        signal = epoch.innovation, epoch.innovation_variance, epoch.visible
        chart = self.memory["average"], self.memory["decay"]
        judge_channels(*signal, smoothing, quantile, scale, *chart, size, threshold, weights)
        if self.limits_exclusions:
            self._limit_exclusions(size, threshold, epoch, weights)
        return compare(size, threshold, None if self.weight_scale is None else weights)


@inline_njit
def compute_median_distance(older: float, old: float, newest: float) -> float:
    """Largest distance of three ratios from their median."""
    low = min(older, old, newest)
    high = max(older, old, newest)
    median = older + old + newest - low - high
    return max(high - median, median - low)


@njit
def judge_joint_channels(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    visible: BoolArray,
    smoothing: float,
    quantile: float,
    drop: float,
    literal: bool,
    alarm_scale: float,
    average: FloatArray,
    decay: FloatArray,
    ratios: FloatArray,
    spoofed: IntArray,
    size: FloatArray,
    threshold: FloatArray,
) -> None:
    """Advance all charts by one epoch. `average`, `decay` (B, n) memory; `ratios` (B, n, 2) memory:
    the last ratios, the older one first, 0 before the alarm; `spoofed` (B, n) memory: epochs since
    the alarm began, itself counted, 0 for none; `size`, `threshold` (B, n), written: statistic and
    threshold [m], without `alarm_scale`, which the alarm's is multiplied by."""
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
                    ended = spoofed[b, j] > 0 and compute_median_distance(older, old, newest) > drop
                else:
                    dropped = min(older, old) - newest > drop and newest < 1.0 - drop
                    ended = spoofed[b, j] > 1 and dropped
                if ended:
                    decay[b, j], average[b, j] = 1.0, 0.0
            spoofed[b, j] = 0 if ended else spoofed[b, j] + 1
            if ended:
                ratios[b, j, 0], ratios[b, j, 1] = 0.0, 0.0
            size[b, j] = abs(average[b, j])


@njit
def chart_weights(statistic: FloatArray, reject: FloatArray) -> FloatArray:
    """IGG-III weights (B, 2n) of statistics (B, n), 0 above `reject` (B, n), falling off from half
    of it on; 1 for the range rates."""
    receivers, n = statistic.shape
    out = np.ones((receivers, 2 * n))
    for b in range(receivers):
        for j in range(n):
            out[b, j] = igg3_weight(statistic[b, j], 0.5 * reject[b, j], reject[b, j])
    return out


@settings_record
class JointChart(WeighingChart):
    """EWMA chart whose alarm ends with the offset, with robust weights in the loop."""

    smoothing: float = average_smoothing()
    false_alarm: float = alarm_probability(help=OF_ONE_SATELLITE)
    weight_scale: float | None = weight_limit(
        0.3, "Factor m: the weight thresholds are m T and m T / 2.  None for a passive chart."
    )
    drop: float = setting(
        default=0.6, above=0.0, below=1.0, help="T_3: fall of the ratio that ends an alarm."
    )
    end_rule: str = setting(
        default="drop", one_of=("drop", "literal"), help="The rule above, or the printed one."
    )
    max_exclusion_s: float | None = longest_exclusion(60.0)
    min_satellites: int = fewest_weighed(5)
    alarm_scale: float = factor_on_alarm()

    alarm_is_state: ClassVar[bool] = True  # type: ignore[misc]  # it stays up until the offset ends

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        shape = (context.receivers, context.channels)
        self.memory_epochs = epochs_to_settle(self.smoothing)
        self.memory.declare_all(
            average=np.zeros(shape),
            decay=np.ones(shape),
            ratios=np.zeros((*shape, 2)),
            spoofed=np.zeros(shape, dtype=np.int64),
        )
        self._declare_exclusions(context)
        self._quantile = two_sided_quantile(self.false_alarm)

    def judge(self, epoch: Epoch) -> Verdict:
        shape, memory = epoch.visible.shape, self.memory
        size, threshold = np.empty(shape), np.empty(shape)
        signal = epoch.innovation, epoch.innovation_variance, epoch.visible
        end = self.drop, self.end_rule == "literal", self.alarm_scale
        chart = memory["average"], memory["decay"], memory["ratios"], memory["spoofed"]
        judge_joint_channels(*signal, self.smoothing, self._quantile, *end, *chart, size, threshold)
        alarm, limit, weights = memory["spoofed"] > 0, self.alarm_scale * threshold, None
        if self.weight_scale is not None:
            weights = chart_weights(size, self.weight_scale * threshold)
            self._limit_exclusions(size, threshold, epoch, weights)
        return Verdict(size, limit, alarm, weights)


@njit
def find_largest_sizes(
    innovation: FloatArray,
    innovation_variance: FloatArray,
    judged: BoolArray,
    first: int,
    last: int,
    out: FloatArray,
) -> FloatArray:
    """Write the size of every satellite's innovation in standard deviations, the largest of its
    rows, into `out` (B, n), and return it; 0 for those that are not judged."""
    receivers, n = judged.shape
    for b in range(receivers):
        for j in range(n):
            out[b, j] = 0.0
        for r in range(first, last):
            if judged[b, r % n]:
                size = abs(innovation[b, r]) / math.sqrt(innovation_variance[b, r])
                out[b, r % n] = max(out[b, r % n], size)
    return out


@settings_record
class Shewhart(WeighingChart, InnovationTest):
    """Every satellite's innovation against its own standard deviation."""

    false_alarm: float = alarm_probability(help=OF_ONE_SATELLITE)
    weight_scale: float | None = weight_limit(
        None,
        "Factor m: the pseudorange gets no weight from m times the threshold on, and less than 1 "
        "from half of that.  None for a passive chart.",
    )
    signals: str = signals_to_test("pseudorange")
    bias_window_s: float = first_window()
    max_exclusion_s: float | None = longest_exclusion(60.0)
    min_satellites: int = fewest_weighed(5)

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        self._quantile = two_sided_quantile(self.false_alarm / self._per_satellite)
        self._declare_exclusions(context)

    def judge(self, epoch: Epoch) -> Verdict:
        innovation, judged = self._without_bias(epoch)
        signal, out = (innovation, epoch.innovation_variance, judged), np.empty(judged.shape)
        statistic = find_largest_sizes(*signal, *self._rows, out)
        verdict = compare(statistic, self._quantile)
        if self.weight_scale is None:
            return verdict
        weights = chart_weights(statistic, self.weight_scale * verdict.threshold)
        self._limit_exclusions(statistic, verdict.threshold, epoch, weights)
        return verdict._replace(weights=weights)
