"""Clean runs of a world: how large every detector's statistics become where nobody attacks.

Passive detectors judge the same epochs, so that all of them take one pass; one that de-weights
changes the epochs that it judges, and takes a pass of its own.
"""

from __future__ import annotations

import dataclasses
import threading
import time
import zipfile
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ..core.compile import COMPILED_LAYERS, source_digest
from ..core.files import whole_file
from ..core.memory import Memory
from ..core.progress import NullProgress, ProgressCallback
from ..core.settings import digest_of
from ..detectors import Calibrated, Detector, Never, PooledDetector
from ..detectors.base import judged
from ..detectors.calibrated import identity_of
from ..simulation.engine import available_threads
from ..simulation.monitors import Monitor, Monitored, PassiveDetectors
from ..simulation.setup import Setup, generators_of, seeds_of_runs
from ..simulation.simulator import Simulator, run_serially

FloatArray = NDArray[np.float64]
CHUNK = 256
"""Runs that are played side by side; the bits are the same for any number."""
SAVE_EVERY_S = 10.0
"""How often what has been played is written down."""
UNREACHED = 2.0**100
"""Factor on a threshold that no statistic reaches; a power of two, so that no bit is lost."""


class CleanRuns(NamedTuple):
    """What R runs without an attack have come to, for each of D detectors, (R, D) but for `world`.

    - `before`, `judged`: largest ratio of statistic to threshold in the monitored warm-up, and in
      the judged window, over channels and the epochs at which alarms are on;
    - `early`, `alarmed`: bool, whether there was an alarm in each of them;
    - `world`: (R,) number of the world that was drawn, of a domain with several.
    """

    before: FloatArray
    judged: FloatArray
    early: NDArray[np.bool_]
    alarmed: NDArray[np.bool_]
    world: NDArray[np.int64]

    def first(self, runs: int) -> CleanRuns:
        return CleanRuns._make(part[:runs] for part in self)

    def column(self, k: int) -> CleanRuns:
        """One of the detectors, (R,) each."""
        return CleanRuns._make(part if part.ndim == 1 else part[:, k] for part in self)


class RunMaxima(Monitor):
    """Largest ratios and alarms since the last look, of passive detectors or of that in the loop.
    `detectors` is empty for that in the loop; `memory`: ``ratio`` and ``alarmed`` (B, D)."""

    def __init__(self, detectors: Sequence[Detector]) -> None:
        self._passive = PassiveDetectors(detectors)
        self.needs = self._passive.needs  # type: ignore[misc]
        self.in_loop = not detectors

    def bind(self, simulator: Monitored) -> None:
        self._passive.bind(simulator)
        shape = simulator.receivers, len(self._passive.detectors) or 1
        self.memory = Memory(simulator.receivers)
        self.memory.declare("ratio", np.zeros(shape))
        self.memory.declare("alarmed", np.zeros(shape, dtype=np.bool_))

    def begin(self) -> None:
        super().begin()
        self._passive.begin()

    def copy_rows(self, to: NDArray[np.intp], other: Self, rows: NDArray[np.intp]) -> None:
        super().copy_rows(to, other, rows)
        self._passive.copy_rows(to, other._passive, rows)

    def update(self, simulator: Any) -> None:
        detectors = [simulator.detector] if self.in_loop else self._passive.detectors
        ratio, alarmed = self.memory["ratio"], self.memory["alarmed"]
        for k, detector in enumerate(detectors):
            verdict = simulator.verdict if self.in_loop else judged(detector, simulator.epoch)
            largest = (verdict.statistic / verdict.threshold).max(axis=1)
            armed = detector.armed(simulator.epoch)
            if armed is not None:
                largest = np.where(armed, largest, 0.0)
            np.maximum(ratio[:, k], largest, out=ratio[:, k])
            alarmed[:, k] |= verdict.alarm.any(axis=1)

    def taken(self) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Ratios and alarms so far, which are forgotten."""
        found = self.memory["ratio"].copy(), self.memory["alarmed"].copy()
        self.memory.reset()
        return found


def weighs(setup: Setup, detector: Detector) -> bool:
    """Whether a detector de-weights measurements in this world: its first verdict says so."""
    simulator: Simulator = setup.altered(detector=detector, monitors=()).simulator(1, run_serially)
    simulator.begin(generators_of(seeds_of_runs(0, "calibration", setup.name, [0])))
    simulator.quiet_epochs(setup.quiet)
    return simulator.step(attacked=False).weights is not None


def measuring(detector: Detector) -> tuple[Detector, float]:
    """Detector whose ratios are to be found, and what they are to be multiplied by. An alarm that
    is a state must not come, since what follows depends on it."""
    if isinstance(detector, Calibrated | PooledDetector):
        raise TypeError(f"{type(detector).__name__} has no ratios of its own to be found")
    if detector.alarm_is_state:
        never: Any = dataclasses.replace(detector, alarm_scale=UNREACHED)  # type: ignore[type-var]
        return never, UNREACHED
    return detector, 1.0


class Player:
    """Plays clean runs of one world. `threads` share the chunks of runs, each of which has a
    simulator of its own; `store` is a folder for what has been played so far, so that a killed
    process goes on from there."""

    def __init__(
        self,
        setup: Setup,
        *,
        entropy: int = 0,
        seed_name: str | None = None,
        threads: int | None = None,
        chunk: int = CHUNK,
        store: Path | None = None,
        progress: ProgressCallback | None = None,
    ) -> None:
        self.setup, self.entropy = setup, entropy
        self.seed_name = setup.name if seed_name is None else seed_name
        self.threads = available_threads(10**9) if threads is None else threads
        self.chunk, self.store, self.progress = chunk, store, progress or NullProgress()
        for name, value in (("threads", self.threads), ("chunk", chunk)):
            if value < 1:
                raise ValueError(f"`{name}` must be at least 1, got {value}")

    def play(
        self,
        detectors: Sequence[Detector],
        numbers: Sequence[int] | NDArray[np.int64] | range,
        *,
        split: str = "calibration",
        in_loop: bool = False,
        now: str = "clean runs",
    ) -> CleanRuns:
        """Runs of a split by their numbers; `in_loop` takes one detector, which weighs."""
        if in_loop:
            (alone,) = detectors
            monitor = RunMaxima(())
            setup = self.setup.altered(detector=alone, monitors=[monitor])
        else:
            monitor = RunMaxima(detectors)
            setup = self.setup.altered(detector=Never(), monitors=[monitor])
        numbers = np.asarray(numbers, dtype=np.int64)
        file = self._file(detectors, split, in_loop, numbers)
        parts = [_nothing(len(detectors))]
        if file is not None:
            parts += [part.first(len(numbers)) for part in _read(file, len(detectors))]
        done = sum(len(part.judged) for part in parts)
        self.progress.advance(float(done), now)
        chunks = [numbers[k : k + self.chunk] for k in range(done, len(numbers), self.chunk)]
        saved = time.monotonic()

        def one(chunk: NDArray[np.int64], stopped: threading.Event) -> CleanRuns:
            return _play(setup, self._generators(split, chunk), stopped)

        def take(part: CleanRuns) -> None:
            nonlocal saved
            parts.append(part)
            self.progress.advance(float(len(part.judged)), now)
            if file is not None and time.monotonic() - saved > SAVE_EVERY_S:
                _write(file, _joined(parts))
                saved = time.monotonic()

        try:
            in_order(one, chunks, take, self.threads)
        except BaseException:
            if file is not None:
                _write(file, _joined(parts))
            raise
        if file is not None:
            _write(file, _joined(parts))
        return _joined(parts)

    def forget(
        self, detectors: Sequence[Detector], numbers: range, *, split: str, in_loop: bool
    ) -> None:
        """Remove what was written down of runs that are no longer needed."""
        file = self._file(detectors, split, in_loop, np.asarray(numbers))
        if file is not None:
            file.unlink(missing_ok=True)

    def each(self, monitor: Monitor, numbers: range, take: Callable[[Simulator], None]) -> None:
        """Let a monitor look at the judged windows of runs without a defence; `take` reads it."""
        setup = self.setup.altered(detector=Never(), monitors=[monitor])
        chunks = [numbers[k : k + self.chunk] for k in range(0, len(numbers), self.chunk)]

        def one(chunk: range, stopped: threading.Event) -> Simulator:
            simulator: Simulator = setup.simulator(len(chunk), run_serially)
            simulator.warm_up(self._generators("calibration", chunk))
            simulator.monitors[0].begin()
            for _ in range(setup.steps + setup.hold):
                _check(stopped)
                simulator.step(attacked=False)
            return simulator

        in_order(one, chunks, take, self.threads)

    def _generators(self, split: str, numbers: Any) -> list[np.random.Generator]:
        runs = map(int, numbers)
        return generators_of(seeds_of_runs(self.entropy, split, self.seed_name, runs))

    def _file(
        self, detectors: Sequence[Detector], split: str, in_loop: bool, numbers: NDArray[np.int64]
    ) -> Path | None:
        """Where these runs are written down; None for runs that are not the first ones."""
        if self.store is None or not np.array_equal(numbers, np.arange(len(numbers))):
            return None
        named = {
            "world": self.setup.conditions.digest,
            "detectors": [_named(each) for each in detectors],
            "runs": [self.entropy, split, self.seed_name, in_loop],
            # others' code would go on from what this one has played
            "sources": source_digest(len(COMPILED_LAYERS) - 1),
        }
        return self.store / f"{digest_of(named)}.npz"


def _named(detector: Detector) -> Any:
    if isinstance(detector, Calibrated):
        return [identity_of(detector.detector), detector.scale, detector.rescale]
    return [identity_of(detector), getattr(detector, "alarm_scale", 1.0)]


class Stopped(Exception):
    """Another thread has failed, or the program was interrupted."""


def _check(stopped: threading.Event) -> None:
    if stopped.is_set():
        raise Stopped


def _play(setup: Setup, rngs: list[np.random.Generator], stopped: threading.Event) -> CleanRuns:
    simulator: Simulator = setup.simulator(len(rngs), run_serially)
    maxima = simulator.monitor(RunMaxima)
    for _ in simulator.warming(rngs, piece=20 * len(rngs)):
        _check(stopped)
    before, early = maxima.taken()
    world = simulator.onset // setup.epochs_each
    for _ in range(setup.steps + setup.hold):
        _check(stopped)
        simulator.step(attacked=False)
    judged, alarmed = maxima.taken()
    return CleanRuns(before, judged, early, alarmed, world)


def in_order(
    work: Callable[[Any, threading.Event], Any],
    items: Sequence[Any],
    take: Callable[[Any], None],
    threads: int,
) -> None:
    """Call `work` on items in threads, and `take` what it returns, here and in their order."""
    stopped = threading.Event()
    waiting: list[Future[Any]] = []
    with ThreadPoolExecutor(threads) as pool:
        try:
            for item in items:
                waiting.append(pool.submit(work, item, stopped))
                if len(waiting) > threads:
                    take(waiting.pop(0).result())
            while waiting:
                take(waiting.pop(0).result())
        except BaseException:
            stopped.set()
            for each in waiting:
                each.cancel()
            raise


def _nothing(detectors: int) -> CleanRuns:
    numbers, flags = np.zeros((0, detectors)), np.zeros((0, detectors), dtype=np.bool_)
    return CleanRuns(numbers, numbers, flags, flags, np.zeros(0, dtype=np.int64))


def _joined(parts: Sequence[CleanRuns]) -> CleanRuns:
    return CleanRuns(*map(np.concatenate, zip(*parts, strict=True)))


def _write(file: Path, runs: CleanRuns) -> None:
    with whole_file(file) as part, part.open("wb") as content:
        np.savez(content, **runs._asdict())


def _read(file: Path, detectors: int) -> list[CleanRuns]:
    """Runs that were written down; none where the file is damaged."""
    if not file.is_file():
        return []
    try:
        with np.load(file) as found:
            runs = CleanRuns(*(found[name] for name in CleanRuns._fields))
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return []
    return [runs] if runs.judged.ndim == 2 and runs.judged.shape[1] == detectors else []
