r"""Classical receiver autonomous integrity monitoring: the least-squares residual.

A fit of position and clock to all pseudoranges leaves residuals, and these are too large when the
satellites do not agree.  One satellite that is wrong alone can be told: without it, the others
agree.  Satellites that are wrong together, as those of a spoofer are, can be noticed but not told.

.. math:: \mathrm{SSE} = \sqrt{\frac{r^T r}{n - 4}} >
    \sigma \sqrt{\frac{\chi^2_{1 - \alpha}(n - 4)}{n - 4}}, \qquad
    r = \left(I - G (G^T G)^{-1} G^T\right) y

Symbols: y pseudorange minus the range from the predicted position [m], G = (-u, 1) with lines of
sight u, n satellites, :math:`\sigma` noise of a pseudorange, :math:`\alpha` probability of a false
alarm.
The satellite to blame is the one with the largest :math:`r_i^2 / (1 - h_{ii})`, h being the
diagonal of the projection on G: that without which the residual is smallest.

Assumptions: white Gaussian noise, the same for all satellites; what all measurements have in
common, the receiver's clock above all, is part of the fit.  Spoofing of all satellites by the same
position and clock is consistent, and passes: "consistent" is not "authentic".

Deviations from `brown1992`:

1. The alarm has its own false-alarm probability; whether the others agree without the one to blame
   is tested with `confidence`.
2. With fewer than 5 satellites, or a singular geometry, there is no verdict: statistic 0.  With 5
   nobody can be blamed.

Source: `brown1992`, section on the least-squares-residuals method; `wu2024`, eq. 23.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._jit import njit
from ..receiver.epoch import Epoch
from ..receiver.fits import PRODUCTS, add, squared_residual
from ..receiver.partition import checked_rows
from ..receiver.raim import (
    MIN_SATELLITES,
    STATES,
    check_channels,
    check_test,
    fit_thresholds,
    noise_sd,
    test_all,
    write_groups,
)
from .base import Detector, DetectorContext, Verdict
from .thresholds import check_probability

FloatArray = NDArray[np.float64]


def residual_statistic(line_of_sight: ArrayLike, offset: ArrayLike) -> float:
    r"""Test statistic of all satellites in view.

    .. math:: \mathrm{SSE} = \sqrt{r^T r / (n - 4)}

    `line_of_sight` (n, 3) unit vectors to the satellites; `offset` (n,) pseudorange minus predicted
    range [m]; what isn't finite is left out; returns SSE [m].
    """
    rows = checked_rows(line_of_sight, offset)
    return math.sqrt(rows.squared_residual / (len(rows.slots) - STATES))


@njit
def blame(n: int, table: FloatArray, limit: FloatArray, kept: FloatArray) -> int:
    """The one satellite without which the others agree.

    `table` (N + 1, PRODUCTS) products; `limit`: limit of s^2 by number of satellites [m^2]; `kept`
    (1, PRODUCTS) scratch.
    """
    best, least = -1, limit[n - 1]
    for i in range(n if n > MIN_SATELLITES else 0):
        kept[:] = 0.0
        for k in range(n):
            if k != i:
                add(kept, 0, table, k, kept, 0)
        s2 = squared_residual(kept, 0)
        if s2 < least:
            best, least = i, s2
    return best


@njit
def judge_receivers(
    pseudorange: FloatArray,
    satellite_position: FloatArray,
    visible: NDArray[np.bool_],
    position: FloatArray,
    alarm_limit: FloatArray,
    limit: FloatArray,
    statistic: FloatArray,
    threshold: FloatArray,
    group: NDArray[np.int8],
    weights: FloatArray,
) -> None:
    """Test all receivers.

    `pseudorange`, `satellite_position`, `visible`, `position` (B, n), (B, n, 3), (B, n), (B, 3) of
    the epoch; `alarm_limit`, `limit` (n + 1,) limits of s^2 [m^2], of the alarm and of agreement;
    `statistic`, `threshold` (B, 1), written [m]; `group` (B, n), written; `weights` (B, 2n),
    written.
    """
    n = visible.shape[1]
    axes, kept = np.eye(3), np.empty((1, PRODUCTS))
    slots, lines, offsets = np.empty(n, dtype=np.int64), np.empty((n, 3)), np.empty(n)
    table = np.empty((n + 1, PRODUCTS))
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
            worst = blame(count, table, limit, kept)
            if worst >= 0:
                found, mask = True, mask - (1 << worst)
        write_groups(found, mask, count, slots, visible[b], group[b], weights[b])


@dataclass
class Raim(Detector):
    """Least-squares residual of all satellites in view.

    Parameters
    ----------
    sigma_m : float or None
        Noise of a pseudorange [m]; None takes what the receiver assumes.
    confidence : float
        Probability that satellites that agree pass for it when somebody is to be blamed, in (0, 1).
    false_alarm : float
        Probability of an alarm in one epoch, in (0, 1).
    exclude : bool
        Give the satellite to blame weights 0, pseudorange and range rate, as long as the alarm
        lasts.

    Notes
    -----
    ``memory["group"]`` is (B, n): 1 for satellites that agree, 2 for the one to blame, 0 for
    what is not known.
    """

    sigma_m: float | None = None
    confidence: float = 0.95
    false_alarm: float = 1e-5
    exclude: bool = False

    paper: ClassVar[str] = "brown1992"

    def __post_init__(self) -> None:
        """Check the settings."""
        check_test(self.sigma_m, self.confidence)
        check_probability("false_alarm", self.false_alarm)

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
        """Test one epoch: (B, 1) SSE [m], threshold and alarm; (B, 2n) weights with `exclude`."""
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
            statistic,
            threshold,
            self.memory["group"],
            weights,
        )
        in_loop = weights if self.exclude else None
        return Verdict(statistic, threshold, statistic > threshold, in_loop)
