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
from typing import ClassVar

from ..receiver.epoch import Epoch
from ..receiver.nis import normalized_innovation_squared
from .base import Detector, DetectorContext, Verdict
from .thresholds import check_probability, chi2_thresholds

SIGNALS = ("pseudorange", "range_rate", "both")


@dataclass
class SnapshotChi2(Detector):
    """Chi-square test of the present epoch, for the whole receiver; it only watches.

    Parameters
    ----------
    false_alarm : float
        Probability of an alarm in one epoch where the filter's belief is right, in (0, 1).
    signals : {"both", "pseudorange", "range_rate"}
        Innovations to test.
    """

    false_alarm: float = 1e-5
    signals: str = "both"

    paper: ClassVar[str] = "barshalom2001"

    def __post_init__(self) -> None:
        """Check the settings."""
        check_probability("false_alarm", self.false_alarm)
        if self.signals not in SIGNALS:
            raise ValueError(
                f"`signals` must be one of {', '.join(map(repr, SIGNALS))}, got {self.signals!r}"
            )

    def bind(self, context: DetectorContext) -> None:
        """Prepare the thresholds for every number of visible satellites.

        Parameters
        ----------
        context : DetectorContext
            Sizes.
        """
        super().bind(context)
        n = context.channels
        self._rows = {"pseudorange": (0, n), "range_rate": (n, 2 * n), "both": (0, 2 * n)}[
            self.signals
        ]
        per_satellite = 2 if self.signals == "both" else 1
        self._thresholds = chi2_thresholds(self.false_alarm, per_satellite * n)[::per_satellite]

    def judge(self, epoch: Epoch) -> Verdict:
        """Test one epoch.

        Parameters
        ----------
        epoch : Epoch
            Read-only.

        Returns
        -------
        Verdict
            (B, 1) statistic, threshold and alarm; no weights.
        """
        statistic = normalized_innovation_squared(
            epoch.innovation, epoch.innovation_cov, *self._rows
        )[:, None]
        threshold = self._thresholds[epoch.visible.sum(axis=1)][:, None]
        return Verdict(statistic, threshold, statistic > threshold)
