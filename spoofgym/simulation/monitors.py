"""Monitors: what looks at every epoch that is judged, and changes nothing; passive detectors.

`EpochLog` hands the epochs out, for a detector outside of the environment.

They live in the simulators, so that they see the warm-up and the time to alert, too, and go with
their receivers when these are moved from one simulator to another.

An aircraft's surveillance reports broadcast the position that the victim believes, at fixed
intervals: each arrives after a latency that is drawn for it.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ..core.memory import Memory
from ..detectors import Detector, Verdict
from ..detectors.base import check_needs, find_name, judge_epoch
from ..detectors.calibrated import unwrap
from ..receiver.epoch import ALWAYS, Epoch, frozen, select_receiver
from ._kernels import remember_positions

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
    `needs`: optional fields of `Epoch` that it reads, as of a `Detector`; `detectors`: its own;
    `from_start`: whether it is shown the filter-only warm-up, too, as they are (`watch`)."""

    needs: ClassVar[frozenset[str]] = frozenset()
    detectors: Sequence[Detector] = ()
    from_start: bool = False
    memory: Memory

    @abstractmethod
    def bind(self, simulator: Monitored) -> None:
        """Prepare for the receivers of a simulator."""

    @abstractmethod
    def update(self, simulator: Monitored) -> None:
        """Look at an epoch between the verdict and the update."""

    def observe_update(self, simulator: Monitored) -> None:  # noqa: B027  (few need it)
        """Look at an epoch after the update."""

    def watch(self, epoch: Epoch) -> None:  # noqa: B027  (few need it)
        """See an epoch of the filter-only warm-up."""

    def start_episodes(self) -> None:
        self.memory.reset()

    def copy_rows(self, to: NDArray[np.intp], other: Self, rows: NDArray[np.intp]) -> None:
        self.memory.copy_rows(to, other.memory, rows)


class EpochLog(Monitor):
    """Epochs of every receiver since they were taken the last time, or since its episode began.
    `needs`: optional fields that they have; `from_start`: whether the filter-only warm-up is
    stored, too."""

    def __init__(self, fields: Iterable[str] = (), *, from_start: bool = False) -> None:
        self.needs = frozenset(fields)  # type: ignore[misc]
        self.from_start = from_start

    def bind(self, simulator: Monitored) -> None:
        self.memory = Memory(simulator.receivers)
        self.start_episodes()

    def start_episodes(self) -> None:
        rows = range(self.memory.receivers)
        self._settling: list[list[tuple[Epoch, int]]] = [[] for _ in rows]
        self._judged: list[list[tuple[Epoch, int]]] = [[] for _ in rows]

    def watch(self, epoch: Epoch) -> None:
        self._store(self._settling, epoch)

    def update(self, simulator: Monitored) -> None:
        self._store(self._judged, simulator.epoch)

    def _store(self, to: list[list[tuple[Epoch, int]]], epoch: Epoch) -> None:
        chosen = {name: getattr(epoch, name) for name in ALWAYS.union(self.needs)}
        copied = Epoch(**{name: frozen(array) for name, array in chosen.items()})
        for row, stored in enumerate(to):
            stored.append((copied, row))

    def copy_rows(self, to: NDArray[np.intp], other: Self, rows: NDArray[np.intp]) -> None:
        for mine, theirs in zip(to.tolist(), rows.tolist(), strict=True):
            self._settling[mine] = list(other._settling[theirs])
            self._judged[mine] = list(other._judged[theirs])

    def take(self) -> NDArray[Any]:
        """(B,) tuples of the epochs of one receiver each, as `select_receiver` gives them."""
        taken = _as_objects(self._judged)
        self._judged = [[] for _ in taken]
        return taken

    def take_settling(self) -> NDArray[Any]:
        """The same of the filter-only warm-up."""
        taken = _as_objects(self._settling)
        self._settling = [[] for _ in taken]
        return taken


def _as_objects(stored: list[list[tuple[Epoch, int]]]) -> NDArray[Any]:
    taken = np.empty(len(stored), dtype=np.object_)
    for row, epochs in enumerate(stored):
        taken[row] = tuple(select_receiver(epoch, place) for epoch, place in epochs)
    return taken


class PassiveDetectors(Monitor):
    """Detectors that judge the same epochs as the one in the loop; their weights are not used.
    `names`: name of each in ``info``: its `label`, or that of its class in `DETECTORS`, numbered
    where it is not alone; `memory`: ``alarmed`` (B, w) bool, whether each has alarmed since it was
    last set to False; ``ratio`` (B, w) largest statistic over threshold at the last epoch."""

    judge: ClassVar[Callable[..., Verdict]] = staticmethod(judge_epoch)

    def __init__(self, detectors: Sequence[Detector]) -> None:
        self.detectors = [copy.deepcopy(detector) for detector in detectors]
        self.names = name_detectors(self.detectors)
        # those of the detectors, so that they are the object's, not the class's
        self.needs = frozenset().union(*map(check_needs, self.detectors))  # type: ignore[misc]

    def bind(self, simulator: Monitored) -> None:
        for detector in self.detectors:
            simulator.bind_detector(detector)
        receivers, count = simulator.receivers, len(self.detectors)
        self.memory = Memory(receivers)
        alarmed = np.zeros((receivers, count), dtype=np.bool_)
        self.memory.declare_all(alarmed=alarmed, ratio=np.zeros((receivers, count)))

    def start_episodes(self) -> None:
        super().start_episodes()
        for detector in self.detectors:
            detector.reset()

    def update(self, simulator: Monitored) -> None:
        alarmed, ratio = self.memory["alarmed"], self.memory["ratio"]
        for k, detector in enumerate(self.detectors):
            verdict = self.judge(detector, simulator.epoch)
            alarmed[:, k] |= verdict.alarm.any(axis=1)
            ratio[:, k] = (verdict.statistic / verdict.threshold).max(axis=1)

    def copy_rows(self, to: NDArray[np.intp], other: Self, rows: NDArray[np.intp]) -> None:
        super().copy_rows(to, other, rows)
        for mine, theirs in zip(self.detectors, other.detectors, strict=True):
            mine.memory.copy_rows(to, theirs.memory, rows)


def needed_monitors(terms: Iterable[Any]) -> list[Monitor]:
    kinds = dict.fromkeys(kind for term in terms for kind in getattr(term, "needs", ()))
    return [kind() for kind in kinds]


def name_detector(detector: Detector) -> str:
    detector = unwrap(detector)
    return detector.label or find_name(type(detector)) or type(detector).__name__


def name_detectors(detectors: Sequence[Detector]) -> tuple[str, ...]:
    words = [name_detector(each).replace("-", "_").lower() for each in detectors]
    before = ((word, words[:k].count(word)) for k, word in enumerate(words))
    return tuple(f"{word}_{count + 1}" if count else word for word, count in before)


HISTORY_EPOCHS = 64  # epochs whose positions are stored


class PastPositions(Monitor):
    """Positions that the victims have believed at the last `HISTORY_EPOCHS` epochs that were
    judged. `memory`: ``past_position`` (B, HISTORY_EPOCHS, d) in the axes of `Setup.true_position`
    [m], and ``past_epochs`` (B, HISTORY_EPOCHS), the epoch of each, -1 for none; that of epoch k is
    at the place k modulo `HISTORY_EPOCHS`."""

    @staticmethod
    def empty(receivers: int, epochs: int, axes: int) -> dict[str, NDArray[Any]]:
        """The memory of so many epochs, with none yet."""
        past_epochs = np.full((receivers, epochs), -1, dtype=np.int64)
        return {"past_position": np.zeros((receivers, epochs, axes)), "past_epochs": past_epochs}

    def bind(self, simulator: Monitored) -> None:
        receivers, setup = simulator.receivers, simulator.setup  # type: ignore[attr-defined]
        self.memory, axes = Memory(receivers), setup.true_position.shape[1]
        self.memory.declare_all(**self.empty(receivers, HISTORY_EPOCHS, axes))

    def update(self, simulator: Any) -> None:
        """Nothing: what the victim believes of the epoch is known after the update."""

    def observe_update(self, simulator: Any) -> None:
        past = self.memory["past_position"], self.memory["past_epochs"]
        remember_positions(simulator.position, simulator.epochs, *past)
