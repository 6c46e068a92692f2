r"""Classical receiver autonomous integrity monitoring: the least-squares residual.

A fit of position and clock to all pseudoranges leaves residuals, and these are too large when the
satellites do not agree.  One satellite that is wrong alone can be found: without it, the others
agree.  Satellites that are wrong together, as those of a spoofer are, can only be noticed.

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

from ..._jit import njit
from ...receiver.least_squares import PRODUCTS, STATES, add, squared_residual
from .base import ConsistencyTest
from .consistency import MIN_SATELLITES, SearchData, checked_rows

FloatArray = NDArray[np.float64]


def residual_statistic(line_of_sight: ArrayLike, offset: ArrayLike) -> float:
    r"""Test statistic of all satellites in view.

    .. math:: \mathrm{SSE} = \sqrt{r^T r / (n - 4)}

    `line_of_sight` (n, 3) unit vectors to the satellites; `offset` (n,) pseudorange minus predicted
    range [m]; what isn't finite is left out; returns SSE [m].
    """
    data, s2 = checked_rows(line_of_sight, offset)
    return math.sqrt(s2 / (data.rows[0] - STATES))


@njit
def blame(n: int, table: FloatArray, limit: FloatArray, kept: FloatArray) -> int:
    """The one satellite without which the others agree. `table` (N + 1, PRODUCTS) products;
    `limit`: limit of s^2 by number of satellites [m^2]; `kept` (1, PRODUCTS) scratch."""
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
def blame_all(data: SearchData, limit: FloatArray) -> None:
    """Look for the satellite to blame in all receivers with an alarm."""
    kept = np.empty((1, PRODUCTS))
    for b in range(data.alarm.shape[0]):
        if data.alarm[b]:
            worst = blame(data.rows[b], data.table[b], limit, kept)
            if worst >= 0:
                data.found[b] = True
                data.mask[b] -= 1 << worst


@dataclass
class Raim(ConsistencyTest):
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

    described_as = "Raim"
    sigma_m: float | None = None
    confidence: float = 0.95
    false_alarm: float = 1e-5
    exclude: bool = False

    paper: ClassVar[str] = "brown1992"

    def search(self, data: SearchData) -> None:
        blame_all(data, self._limit)
