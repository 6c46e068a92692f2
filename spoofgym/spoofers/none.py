"""The spoofer that does nothing: the clean twin of every attack, and the source of false alarms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .base import FloatArray, Spoofer


@dataclass
class NoSpoofer(Spoofer):
    """Commands zero; a benchmark leaves the measurements of its runs authentic."""

    described_as = "NoSpoofer"
    knowledge = "blind"
    transmits = False

    def act(self, observation: NDArray[np.float32]) -> FloatArray:
        """Command nothing: (B, a) zeros."""
        return np.zeros((self.context.receivers, len(self.context.action_names)))
