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

from dataclasses import dataclass, field
from typing import ClassVar, cast

import numpy as np

from .._describe import OMITTED
from ..receiver.epoch import Epoch
from ..receiver.nis import normalized_innovation_squared
from .base import DetectorContext, Verdict
from .innovation_test import FloatArray, InnovationTest
from .thresholds import chi2_lower_thresholds, chi2_thresholds, outside_ratio


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
    two_sided : bool
        Whether innovations that are too small alarm, too, each side with half of `false_alarm`: a
        counterfeit signal may have less noise than nature.  The statistic is then the ratio to the
        limit that is nearer, and the threshold 1.
    """

    described_as = "SnapshotChi2"
    false_alarm: float = 1e-5
    signals: str = "both"
    bias_window_s: float = 0.0
    two_sided: bool = field(default=False, metadata=OMITTED)

    paper: ClassVar[str] = "barshalom2001"
    needs: ClassVar[frozenset[str]] = frozenset({"innovation_cov"})

    def bind(self, context: DetectorContext) -> None:
        """Prepare the thresholds for every number of visible satellites."""
        super().bind(context)
        each = self._per_satellite
        each_side = 0.5 * self.false_alarm if self.two_sided else self.false_alarm
        self._thresholds = chi2_thresholds(each_side, each * context.channels)[::each]
        degrees = each * np.arange(context.channels + 1.0)
        self._lower = chi2_lower_thresholds(each_side, degrees)

    def judge(self, epoch: Epoch) -> Verdict:
        """Test one epoch: (B, 1) statistic, threshold and alarm; no weights."""
        innovation, judged = self._without_bias(epoch)
        belief = cast(FloatArray, epoch.innovation_cov)
        if self._bias_window > 0:
            rows = np.hstack([judged, judged])
            belief = np.where(rows[:, :, None] & rows[:, None, :], belief, np.eye(rows.shape[1]))
        statistic = normalized_innovation_squared(innovation, belief, *self._rows)[:, None]
        seen = judged.sum(axis=1)
        if self.two_sided:
            limits = self._lower[seen], self._thresholds[seen]
            statistic = outside_ratio(statistic[:, 0], *limits, seen > 0)
            return Verdict(statistic, np.ones_like(statistic), statistic > 1.0)
        threshold = self._thresholds[seen][:, None]
        return Verdict(statistic, threshold, statistic > threshold)
