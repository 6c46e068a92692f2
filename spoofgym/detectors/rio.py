r"""Distance constraint: GNSS must stay near to dead reckoning.

A fix is rejected where it is farther than D from the position that dead reckoning alone gives since
the start of the run, and so are all fixes after it, until one comes within a small distance of the
receiver's own estimate:

.. math:: |g_k - p_k^{DR}| > D, \qquad\text{and then until}\quad |g_k - \hat p_k^-| \le D_r

It knows jumps at once, and a drift once it amounts to D.

Symbols: g GNSS position, :math:`p^{DR}` dead reckoning alone, :math:`\hat p^-` prediction [m].

Assumptions: dead reckoning drifts by much less than D during the run.  Nothing promises a
false-alarm rate.

Deviations from `song2021`, which compares with it:

1. The paper gives neither the test nor D.  16.5 m is chosen by its latency of 26 s after a ramp of
   0.7 m/s.
2. The latch and D_r = 5 m are ours: after a slow attack the estimate is some 15 m off, so that no
   fix is believed any more, as the equal rows of the paper's data sets 3 and 4 show.
3. A missing fix has statistic 0 and changes nothing.

Source: `song2021`, section 5, which names `melendez2017` as the origin of its comparison.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from .._jit import inlined, njit
from ..receiver.epoch import Epoch
from .base import Detector, DetectorContext, Verdict

FloatArray = NDArray[np.float64]


@inlined
def distance(a: FloatArray, b: FloatArray) -> float:
    """Distance of two positions.  `a`, `b` (3,) [m]; returns [m]."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return math.sqrt(x * x + y * y + z * z)


@njit
def constrain_fixes(
    gnss_position: FloatArray,
    auxiliary_position: FloatArray,
    predicted_position: FloatArray,
    design: FloatArray,
    limit: float,
    readmission: float,
    rejecting: NDArray[np.bool_],
    statistic: FloatArray,
    threshold: FloatArray,
    weights: FloatArray,
) -> None:
    """Judge one fix of every receiver. `limit`, `readmission`: D and D_r [m]; `rejecting` (B,)
    memory, overwritten; `statistic`, `threshold` (B, 1), written: the distance that counts at
    present, and its limit [m]; `weights` (B, m), written: 0 or 1."""
    for b in range(statistic.shape[0]):
        present = False
        for i in range(design.shape[1]):
            for j in range(design.shape[2]):
                present = present or design[b, i, j] != 0.0
        threshold[b, 0] = readmission if rejecting[b] else limit
        statistic[b, 0] = 0.0
        weights[b, :] = 1.0
        if not present:
            continue
        anchor = predicted_position[b] if rejecting[b] else auxiliary_position[b]
        statistic[b, 0] = distance(gnss_position[b], anchor)
        rejecting[b] = statistic[b, 0] > threshold[b, 0]
        if rejecting[b]:
            weights[b, :] = 0.0


@dataclass
class Rio(Detector):
    """Distance constraint with a latch.

    Parameters
    ----------
    limit_m : float
        D, above 0.
    readmission_m : float
        D_r, above 0.
    """

    described_as = "Rio"
    limit_m: float = 16.5
    readmission_m: float = 5.0

    paper: ClassVar[str] = "song2021"
    needs: ClassVar[frozenset[str]] = frozenset({"auxiliary_position", "design", "gnss_position"})
    measures: ClassVar[str] = "position"

    def __post_init__(self) -> None:
        for name in ("limit_m", "readmission_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"`{name}` must be finite and > 0, got {value}")

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        self.memory.declare("rejecting", np.zeros(context.receivers, dtype=np.bool_))

    def judge(self, epoch: Epoch) -> Verdict:
        """Judge one fix. Returns (B, 1) distance, limit, alarm; (B, m) weights, 0 where the fix is
        rejected."""
        statistic = np.empty((len(epoch.time), 1))
        threshold = np.empty_like(statistic)
        weights = np.empty(epoch.innovation.shape)
        constrain_fixes(
            cast(FloatArray, epoch.gnss_position),
            cast(FloatArray, epoch.auxiliary_position),
            epoch.predicted_position,
            cast(FloatArray, epoch.design),
            self.limit_m,
            self.readmission_m,
            self.memory["rejecting"],
            statistic,
            threshold,
            weights,
        )
        return Verdict(statistic, threshold, statistic > threshold, weights)
