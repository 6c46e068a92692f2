"""Witnesses: what looks at every epoch that is judged, and changes nothing.

They live in the batches of the engine, so that they see the warm-up and the time to alert, too, and
go with their receivers when these are moved from one batch to another.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from ..detectors import DETECTORS, Detector
from ..receiver.epoch import Epoch

if TYPE_CHECKING:
    from .engine import Batch

FloatArray = NDArray[np.float64]


class Witness(ABC):
    """What looks at the epochs of a batch.  `memory`: all that it remembers of every receiver."""

    memory: Memory

    @abstractmethod
    def bind(self, batch: Batch) -> None:
        """Prepare for a batch."""

    @abstractmethod
    def see(self, batch: Batch) -> None:
        """Look at an epoch between the verdict and the update."""

    def begin(self) -> None:
        """Begin new episodes in all receivers."""
        self.memory.reset()

    def copy_rows(self, to: NDArray[np.intp], other: Self, rows: NDArray[np.intp]) -> None:
        """Take over receivers of another batch."""
        self.memory.copy_rows(to, other.memory, rows)


class Watch(Witness):
    """Detectors that run on the epochs beside the one in the loop; their weights are not used.

    `names`: name of each in ``info``: that of its class in `DETECTORS`, numbered where it is not
    alone; `memory`: ``alarmed`` (B, w) bool, whether each has alarmed since it was last set to
    False; ``ratio`` (B, w) largest statistic over threshold at the last epoch.
    """

    def __init__(self, detectors: Sequence[Detector]) -> None:
        self.detectors = [copy.deepcopy(detector) for detector in detectors]
        self.names = names_of(self.detectors)

    def bind(self, batch: Batch) -> None:
        """Prepare for a batch."""
        for detector in self.detectors:
            batch.bind_detector(detector)
        self.declare(batch.receivers)

    def declare(self, receivers: int) -> None:
        """Prepare for what the detectors will see."""
        count = len(self.detectors)
        self.memory = Memory(receivers)
        self.memory.declare("alarmed", np.zeros((receivers, count), dtype=np.bool_))
        self.memory.declare("ratio", np.zeros((receivers, count)))

    def begin(self) -> None:
        """Begin new episodes in all receivers."""
        super().begin()
        for detector in self.detectors:
            detector.reset()

    def see(self, batch: Batch) -> None:
        """Let every detector judge the epoch."""
        self.look(batch.epoch)

    def look(self, epoch: Epoch) -> None:
        """Let every detector judge an epoch."""
        alarmed, ratio = self.memory["alarmed"], self.memory["ratio"]
        for k, detector in enumerate(self.detectors):
            verdict = detector.judge(epoch)
            alarmed[:, k] |= verdict.alarm.any(axis=1)
            ratio[:, k] = (verdict.statistic / verdict.threshold).max(axis=1)

    def copy_rows(self, to: NDArray[np.intp], other: Self, rows: NDArray[np.intp]) -> None:
        """Take over receivers of another batch."""
        super().copy_rows(to, other, rows)
        for mine, theirs in zip(self.detectors, other.detectors, strict=True):
            mine.memory.copy_rows(to, theirs.memory, rows)


def names_of(detectors: Sequence[Detector]) -> tuple[str, ...]:
    """Names of detectors, with underscores."""
    known = {kind: name for name, kind in DETECTORS.items()}
    words = [known.get(type(d), type(d).__name__).replace("-", "_").lower() for d in detectors]
    before = [words[:k].count(word) for k, word in enumerate(words)]
    return tuple(
        f"{word}_{count + 1}" if count else word for word, count in zip(words, before, strict=True)
    )
