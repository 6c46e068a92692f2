r"""SRV-RAIM: two groups of satellites, told apart by the directions of their residual vectors.

Residuals of the fit to all satellites are made vectors along the rows of the geometry.  Those of
authentic and of spoofed satellites point to different sides of space, so that along one of 40
directions the five largest or the five smallest are likely of one kind; five that agree are a
seed, which takes in whatever agrees with it, and what is left over has to agree, too.  Some 20 fits
are enough, where a search of all subsets takes thousands.

.. math:: \mathrm{SRV}_i = r_i g_i, \qquad p_i(v) = v^T \mathrm{SRV}_i, \qquad
    \mathrm{SSE}(S) = \sqrt{\frac{r_S^T r_S}{|S| - 4}} < \mathrm{TH}(|S|) =
    \sigma \sqrt{\frac{\chi^2_p(|S| - 4)}{|S| - 4}}

Symbols: r residuals of the fit to all satellites, g rows (-u, 1) of the geometry, v search vectors,
r_S residuals of a fit to the subset S, :math:`\sigma` noise of a pseudorange, p confidence.

Assumptions: spoofed satellites tell one position and clock; noise is white and Gaussian.  Which
group is authentic is not decided: the first one is that which was found first.  It was made for 12
satellites; with uniformly drawn subsets and errors of the paper it is right in some 80 % of the
cases with 10 satellites and in half with 8, and with fewer than 10 a second group of less than 5
is accepted untested.

Deviations from `wu2024`:

1. The growth of the seed (steps 12 to 19 of the printed algorithm) is repeated until a pass adds
   nothing; the printed single pass gives nearly twice the false separations of the paper's table 5
   with one spoofed satellite.
2. The detector searches only after an alarm of all satellites in view, with a false-alarm
   probability of its own; ``false_alarm = 0.05`` is the paper's confidence.
3. Step 39, whether the groups stay consistent for some seconds, is left out, as in the paper.
4. With fewer than 5 satellites, or a singular geometry, there is no verdict: statistic 0.

The search vectors belong to axes: groups found in ECEF and in north-east-down axes may differ, and
the latter stand for any local frame, whose axes are the same but for order and sign.

Source: `wu2024`, algorithm 1, eqs. 9, 15, 20 to 23.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .._jit import njit
from .._registry import check_choice
from ..receiver.epoch import Epoch
from ..receiver.fits import PRODUCTS
from ..receiver.raim import (
    FRAMES,
    MIN_SATELLITES,
    check_channels,
    check_test,
    fit_thresholds,
    frame_axes,
    noise_sd,
    test_all,
    write_groups,
)
from ..receiver.srv_raim import search, search_vectors
from .base import Detector, DetectorContext, Verdict
from .thresholds import check_probability

FloatArray = NDArray[np.float64]


@njit
def judge_receivers(
    pseudorange: FloatArray,
    satellite_position: FloatArray,
    visible: NDArray[np.bool_],
    position: FloatArray,
    axes: FloatArray,
    alarm_limit: FloatArray,
    limit: FloatArray,
    vectors: FloatArray,
    statistic: FloatArray,
    threshold: FloatArray,
    group: NDArray[np.int8],
    weights: FloatArray,
) -> None:
    """Test all receivers, and search where there is an alarm.

    `pseudorange`, `satellite_position`, `visible`, `position` (B, n), (B, n, 3), (B, n), (B, 3) of
    the epoch; `axes` (B, 3, 3) from the frame of the search to ECEF; `vectors` (V, 4) search
    vectors; `statistic`, `threshold` (B, 1), written [m]; `group` (B, n), written; `weights`
    (B, 2n), written.
    """
    n = visible.shape[1]
    slots, order = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    lines, offsets = np.empty((n, 3)), np.empty(n)
    table, scratch = np.empty((n + 1, PRODUCTS)), np.empty((3, max(n, PRODUCTS)))
    for b in range(visible.shape[0]):
        count, verdict = test_all(
            pseudorange[b],
            satellite_position[b],
            visible[b],
            position[b],
            axes[b],
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
            found, mask, _ = search(count, lines, offsets, table, limit, vectors, order, scratch)
        write_groups(found, mask, count, slots, visible[b], group[b], weights[b])


@dataclass
class SrvRaim(Detector):
    """Residual test of all satellites in view; after an alarm, two groups by residual vectors.

    Parameters
    ----------
    sigma_m : float or None
        Noise of a pseudorange [m]; None takes what the receiver assumes.
    confidence : float
        Probability that satellites that agree pass for it in the search, in (0, 1).
    false_alarm : float
        Probability of an alarm in one epoch, in (0, 1).
    frame : {"ned", "ecef"}
        Axes of the search vectors.
    exclude : bool
        Give the second group weights 0, pseudoranges and range rates, as long as the alarm lasts.
        It may be the authentic one.

    Notes
    -----
    ``memory["group"]`` is (B, n): 1 and 2 for the groups, all 1 without an alarm, and 0 for what
    is not known: no verdict, or nothing found.
    """

    sigma_m: float | None = None
    confidence: float = 0.95
    false_alarm: float = 1e-5
    frame: str = "ned"
    exclude: bool = False

    paper: ClassVar[str] = "wu2024"

    def __post_init__(self) -> None:
        """Check the settings."""
        check_test(self.sigma_m, self.confidence)
        check_probability("false_alarm", self.false_alarm)
        check_choice("frame", self.frame, FRAMES)

    def bind(self, context: DetectorContext) -> None:
        """Prepare the limits for every number of satellites."""
        super().bind(context)
        n = context.channels
        check_channels(n)
        sigma = noise_sd(self.sigma_m, context.noise_variance, n)
        most = max(n, MIN_SATELLITES)
        self._limit = fit_thresholds(sigma, 1.0 - self.confidence, most)
        self._alarm = fit_thresholds(sigma, self.false_alarm, most)
        self._vectors = search_vectors()
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
            frame_axes(self.frame, epoch.predicted_position),
            self._alarm,
            self._limit,
            self._vectors,
            statistic,
            threshold,
            self.memory["group"],
            weights,
        )
        in_loop = weights if self.exclude else None
        return Verdict(statistic, threshold, statistic > threshold, in_loop)
