r"""Snapshot chi-square test of the innovation.

The innovations of one epoch, normalized by the covariance that the filter believes in, are
chi-square distributed when nothing is wrong:

.. math:: q_k = z_k^T S_k^{-1} z_k \sim \chi^2(d)

with one degree of freedom for every visible row.  The test knows only the present epoch, so that a
slow drift to which the filter gets used passes; and its false-alarm rate is the stated one only
where the belief S is right, which the receiver of the papers' tables is far from.

Source: `barshalom2001`, section 5.4, in references.bib.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, cast

import numpy as np

from ..receiver.epoch import Epoch
from ..receiver.nis import normalized_innovation_squared
from .base import DetectorContext, Verdict
from .innovation_test import FloatArray, InnovationTest
from .thresholds import chi2_thresholds


@dataclass
class SnapshotChi2(InnovationTest):
    """Chi-square test of the present epoch, for the whole receiver; monitor only.

    Parameters
    ----------
    false_alarm : float
        Probability of an alarm in one epoch where the filter's belief is right, in (0, 1).
    signals : {"both", "pseudorange", "range_rate"}
        Innovations to test.
    bias_window_s : float
        Length of the first window whose mean innovation is taken away from every channel, which is
        not judged before; 0 for none.
    """

    false_alarm: float = 1e-5
    signals: str = "both"
    bias_window_s: float = 0.0

    paper: ClassVar[str] = "barshalom2001"
    needs: ClassVar[frozenset[str]] = frozenset({"innovation_cov"})

    def bind(self, context: DetectorContext) -> None:
        """Prepare the thresholds for every number of visible satellites."""
        super().bind(context)
        each = self._per_satellite
        self._thresholds = chi2_thresholds(self.false_alarm, each * context.channels)[::each]

    def judge(self, epoch: Epoch) -> Verdict:
        """Test one epoch: (B, 1) statistic, threshold and alarm; no weights."""
        innovation, judged = self._without_bias(epoch)
        belief = cast(FloatArray, epoch.innovation_cov)
        if self._bias_window > 0:
            rows = np.hstack([judged, judged])
            belief = np.where(rows[:, :, None] & rows[:, None, :], belief, np.eye(rows.shape[1]))
        statistic = normalized_innovation_squared(innovation, belief, *self._rows)[:, None]
        threshold = self._thresholds[judged.sum(axis=1)][:, None]
        return Verdict(statistic, threshold, statistic > threshold)
