r"""Traversal RAIM: the smallest set of satellites without which all others agree.

All subsets are left out in turn, the smaller ones first; the first one that leaves satellites that
agree, and agrees itself where it is large enough to disagree, is the second group.  It finds
whatever the test of consistency can find, and takes thousands of fits where half of the satellites
are spoofed.

.. math:: \mathrm{SSE}(S) = \sqrt{\frac{r_S^T r_S}{|S| - 4}} < \mathrm{TH}(|S|) =
    \sigma \sqrt{\frac{\chi^2_p(|S| - 4)}{|S| - 4}}

for S the satellites that are kept, and for those left out where there are 5 or more.

Symbols: r_S residuals of a fit to the subset S, :math:`\sigma` noise of a pseudorange, p
confidence.

Assumptions: spoofed satellites tell one position and clock; noise is white and Gaussian.  Which
group is authentic is not decided, and the larger one is kept.

Deviations from `wu2024`, where it is the method to compare with:

1. Nothing left out comes first, "no spoofing"; it costs one fit, which the paper's counts for one
   spoofed satellite seem to lack.
2. The detector searches only after an alarm of all satellites in view, with a false-alarm
   probability of its own; ``false_alarm = 0.05`` is the paper's confidence.
3. The second group has at most `largest_group` satellites: 6 is all there is with 12 in view, while
   20 would take half a million fits without it.
4. With fewer than 5 satellites, or a singular geometry, there is no verdict: statistic 0.

Source: `wu2024`, section 3, tables 7 and 8.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .._jit import njit
from ..receiver.epoch import Epoch
from ..receiver.fits import PRODUCTS
from ..receiver.raim import (
    MIN_SATELLITES,
    check_channels,
    check_test,
    fit_thresholds,
    noise_sd,
    test_all,
    write_groups,
)
from ..receiver.traversal_raim import LARGEST_GROUP, check_largest_group, search
from .base import Detector, DetectorContext, Verdict
from .thresholds import check_probability

FloatArray = NDArray[np.float64]


@njit
def judge_receivers(
    pseudorange: FloatArray,
    satellite_position: FloatArray,
    visible: NDArray[np.bool_],
    position: FloatArray,
    alarm_limit: FloatArray,
    limit: FloatArray,
    largest_group: int,
    statistic: FloatArray,
    threshold: FloatArray,
    group: NDArray[np.int8],
    weights: FloatArray,
) -> None:
    """Test all receivers, and search where there is an alarm.

    `pseudorange`, `satellite_position`, `visible`, `position` (B, n), (B, n, 3), (B, n), (B, 3) of
    the epoch; `alarm_limit`, `limit`: limits of s^2 by number of satellites [m^2], of the alarm and
    of agreement; `statistic`, `threshold` (B, 1), written [m]; `group` (B, n), written; `weights`
    (B, 2n), written.
    """
    n = visible.shape[1]
    axes = np.eye(3)
    slots, chosen = np.empty(n, dtype=np.int64), np.empty(largest_group, dtype=np.int64)
    lines, offsets = np.empty((n, 3)), np.empty(n)
    table, after = np.empty((n + 1, PRODUCTS)), np.empty((n + 1, PRODUCTS))
    stack = np.empty((2, largest_group + 1, PRODUCTS))
    for b in range(visible.shape[0]):
        count, verdict = test_all(
            pseudorange[b],
            satellite_position[b],
            visible[b],
            position[b],
            axes,
            alarm_limit,
            slots,
            lines,
            offsets,
            table,
            statistic[b],
            threshold[b],
        )
        found, mask = verdict == 1, (1 << count) - 1
        if verdict == 2:
            found, mask, _ = search(count, table, limit, largest_group, after, stack, chosen)
        write_groups(found, mask, count, slots, visible[b], group[b], weights[b])


@dataclass
class TraversalRaim(Detector):
    """Residual test of all satellites in view; after an alarm, the smallest group to leave out.

    Parameters
    ----------
    sigma_m : float or None
        Noise of a pseudorange [m]; None takes what the receiver assumes.
    confidence : float
        Probability that satellites that agree pass for it in the search, in (0, 1).
    false_alarm : float
        Probability of an alarm in one epoch, in (0, 1).
    largest_group : int
        Most satellites to leave out.
    exclude : bool
        Give the second group weights 0, pseudoranges and range rates, as long as the alarm lasts.
        It may be the authentic one.

    Notes
    -----
    ``memory["group"]`` is (B, n): 1 for satellites that are kept, all without an alarm, 2 for those
    left out, and 0 for what is not known: no verdict, or nothing found.
    """

    sigma_m: float | None = None
    confidence: float = 0.95
    false_alarm: float = 1e-5
    largest_group: int = LARGEST_GROUP
    exclude: bool = False

    paper: ClassVar[str] = "wu2024"

    def __post_init__(self) -> None:
        """Check the settings."""
        check_test(self.sigma_m, self.confidence)
        check_probability("false_alarm", self.false_alarm)
        check_largest_group(self.largest_group)

    def bind(self, context: DetectorContext) -> None:
        """Prepare the limits for every number of satellites."""
        super().bind(context)
        n = context.channels
        check_channels(n)
        sigma = noise_sd(self.sigma_m, context.noise_variance, n)
        most = max(n, MIN_SATELLITES)
        self._limit = fit_thresholds(sigma, 1.0 - self.confidence, most)
        self._alarm = fit_thresholds(sigma, self.false_alarm, most)
        self.memory.declare("group", np.zeros((context.receivers, n), dtype=np.int8))

    def judge(self, epoch: Epoch) -> Verdict:
        """Test one epoch.

        Returns (B, 1) SSE of all in view [m], threshold and alarm; (B, 2n) weights with `exclude`.
        """
        b = len(epoch.time)
        statistic, threshold = np.empty((b, 1)), np.empty((b, 1))
        weights = np.empty((b, 2 * epoch.visible.shape[1]))
        judge_receivers(
            epoch.pseudorange,
            epoch.satellite_position,
            epoch.visible,
            epoch.predicted_position,
            self._alarm,
            self._limit,
            self.largest_group,
            statistic,
            threshold,
            self.memory["group"],
            weights,
        )
        in_loop = weights if self.exclude else None
        return Verdict(statistic, threshold, statistic > threshold, in_loop)
