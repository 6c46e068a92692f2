"""The detector that never alarms: the victim without a defence.

It is the baseline of every comparison: what a spoofer induces where nobody looks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..receiver.epoch import Epoch
from .base import Detector, DetectorContext, Verdict


@dataclass
class Never(Detector):
    """No defence: statistic 0, threshold 1, never an alarm, no weights."""

    described_as = "Never"
    paper: ClassVar[str] = "groves2013"
    measures: ClassVar[str] = "any"
    calibrates: ClassVar[bool] = False

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)

    def judge(self, epoch: Epoch) -> Verdict:
        """No alarm: (B, 1) zeros, ones and no alarm."""
        shape = (len(epoch.time), 1)
        return Verdict(np.zeros(shape), np.ones(shape), np.zeros(shape, dtype=np.bool_))
