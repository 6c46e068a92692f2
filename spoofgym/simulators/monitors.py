"""Monitors: what looks at every epoch that is judged, and changes nothing.

They live in the simulators, so that they see the warm-up and the time to alert, too, and go with
their receivers when these are moved from one simulator to another.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from ..detectors import DETECTORS, Calibrated, Detector, Verdict
from ..detectors.base import check_needs
from ..detectors.verdicts import judged
from ..receiver.epoch import Epoch

FloatArray = NDArray[np.float64]


class Monitored(Protocol):
    """What a monitor looks at: a `Simulator`."""

    receivers: int
    epoch: Epoch
    verdict: Verdict | None

    def bind_detector(self, detector: Detector) -> None:
        """Bind a detector to these receivers."""


class Monitor(ABC):
    """What looks at the epochs of a simulator; `memory` is all that it remembers of receivers.
    `needs`: optional fields of `Epoch` that it reads, as of a `Detector`."""

    needs: ClassVar[frozenset[str]] = frozenset()
    memory: Memory

    @abstractmethod
    def bind(self, simulator: Monitored) -> None:
        """Prepare for the receivers of a simulator."""

    @abstractmethod
    def update(self, simulator: Monitored) -> None:
        """Look at an epoch between the verdict and the update."""

    def corrected(self, simulator: Monitored) -> None:  # noqa: B027  (few need it)
        """Look at an epoch after the update."""

    def begin(self) -> None:
        """Start new episodes in all receivers."""
        self.memory.reset()

    def copy_rows(self, to: NDArray[np.intp], other: Self, rows: NDArray[np.intp]) -> None:
        """Take over receivers of another simulator."""
        self.memory.copy_rows(to, other.memory, rows)


class PassiveDetectors(Monitor):
    """Detectors that judge the same epochs as the one in the loop; their weights are not used.
    `names`: name of each in ``info``: its `label`, or that of its class in `DETECTORS`, numbered
    where it is not alone; `memory`: ``alarmed`` (B, w) bool, whether each has alarmed since it was
    last set to False; ``ratio`` (B, w) largest statistic over threshold at the last epoch."""

    def __init__(self, detectors: Sequence[Detector]) -> None:
        self.detectors = [copy.deepcopy(detector) for detector in detectors]
        self.names = names_of(self.detectors)
        # those of the detectors, so that they are the object's, not the class's
        self.needs = frozenset().union(*map(check_needs, self.detectors))  # type: ignore[misc]

    def bind(self, simulator: Monitored) -> None:
        for detector in self.detectors:
            simulator.bind_detector(detector)
        receivers, count = simulator.receivers, len(self.detectors)
        self.memory = Memory(receivers)
        self.memory.declare("alarmed", np.zeros((receivers, count), dtype=np.bool_))
        self.memory.declare("ratio", np.zeros((receivers, count)))

    def begin(self) -> None:
        super().begin()
        for detector in self.detectors:
            detector.reset()

    def update(self, simulator: Monitored) -> None:
        alarmed, ratio = self.memory["alarmed"], self.memory["ratio"]
        for k, detector in enumerate(self.detectors):
            verdict = judged(detector, simulator.epoch)
            alarmed[:, k] |= verdict.alarm.any(axis=1)
            ratio[:, k] = (verdict.statistic / verdict.threshold).max(axis=1)

    def copy_rows(self, to: NDArray[np.intp], other: Self, rows: NDArray[np.intp]) -> None:
        super().copy_rows(to, other, rows)
        for mine, theirs in zip(self.detectors, other.detectors, strict=True):
            mine.memory.copy_rows(to, theirs.memory, rows)


def needed_monitors(terms: Iterable[Any]) -> list[Monitor]:
    """Monitors that terms rely on: one of each class that their attribute `needs` lists."""
    kinds = dict.fromkeys(kind for term in terms for kind in getattr(term, "needs", ()))
    return [kind() for kind in kinds]


def names_of(detectors: Sequence[Detector]) -> tuple[str, ...]:
    known = {kind: name for name, kind in DETECTORS.items()}
    detectors = [d.detector if isinstance(d, Calibrated) else d for d in detectors]
    named = [d.label or known.get(type(d), type(d).__name__) for d in detectors]
    words = [name.replace("-", "_").lower() for name in named]
    before = ((word, words[:k].count(word)) for k, word in enumerate(words))
    return tuple(f"{word}_{count + 1}" if count else word for word, count in before)
