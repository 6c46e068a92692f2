"""Clean runs of a world: how large every detector's statistics become without an attack.

Passive detectors judge the same epochs, so that all of them take one pass; one that de-weights
changes the epochs that it judges, and takes a pass of its own.
"""

from __future__ import annotations

import dataclasses
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_number
from ..core.progress import NullProgress, ProgressCallback
from ..detectors import Calibrated, Detector, Never, PooledDetector
from ..detectors.base import judge_epoch
from ..simulation.engine import processors
from ..simulation.monitors import Monitor, Monitored, PassiveDetectors
from ..simulation.setup import Setup, make_generators, seeds_of_runs
from ..simulation.simulator import Simulator, draw_ages, run_serially, weighs

FloatArray = NDArray[np.float64]
Numbers = Sequence[int] | NDArray[np.int64]
CHUNK = 256
"""Runs that are played side by side; the bits are the same for any number."""
UNREACHED = 2.0**100
"""Factor on a threshold that no statistic reaches; a power of two, so that no bit is lost."""


class CleanRuns(NamedTuple):
    """What R runs without an attack have come to, for each of D detectors, (R, D) but for the last.

    - `before`, `judged`: largest ratio of statistic to threshold in the monitored warm-up, and in
      the judged window, where alarms are on; `early`, `alarmed`: whether there was an alarm;
    - `world`: (R,) number of it, of a domain with several; `age_s`: (R,) where `judged` begins [s].
    """

    before: FloatArray
    judged: FloatArray
    early: NDArray[np.bool_]
    alarmed: NDArray[np.bool_]
    world: NDArray[np.int64]
    age_s: FloatArray

    def column(self, k: int) -> CleanRuns:
        """One of the detectors, (R,) each."""
        return CleanRuns._make(part if part.ndim == 1 else part[:, k] for part in self)


class RunMaxima(PassiveDetectors):
    """Largest ratios and alarms since the last look, of passive detectors or of that in the loop.
    `detectors` is empty for that in the loop; `memory`: ``ratio`` and ``alarmed`` (B, D)."""

    def bind(self, simulator: Monitored) -> None:
        super().bind(simulator)
        if not self.detectors:
            self.memory.declare("ratio", np.zeros((simulator.receivers, 1)))
            self.memory.declare("alarmed", np.zeros((simulator.receivers, 1), dtype=np.bool_))

    def update(self, simulator: Any) -> None:
        ratio, alarmed = self.memory["ratio"], self.memory["alarmed"]
        for k, detector in enumerate(self.detectors or [simulator.detector]):
            verdict = (
                judge_epoch(detector, simulator.epoch) if self.detectors else simulator.verdict
            )
            largest = (verdict.statistic / verdict.threshold).max(axis=1)
            armed = detector.is_armed(simulator.epoch)
            if armed is not None:
                largest = np.where(armed, largest, 0.0)
            np.maximum(ratio[:, k], largest, out=ratio[:, k])
            alarmed[:, k] |= verdict.alarm.any(axis=1)

    def pop_maxima(self) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Ratios and alarms so far, which are forgotten."""
        found = self.memory["ratio"].copy(), self.memory["alarmed"].copy()
        self.memory.reset()
        return found


def plan_passes(setup: Setup, detectors: Sequence[Detector]) -> list[tuple[list[int], bool]]:
    """Which of some detectors are played in one pass, and whether in the loop: those that weigh."""
    heavy = [k for k, each in enumerate(detectors) if weighs(setup, each)]
    light = [k for k in range(len(detectors)) if k not in heavy]
    return ([(light, False)] if light else []) + [([k], True) for k in heavy]


def measuring(detector: Detector) -> tuple[Detector, float]:
    """Detector whose ratios are to be found, and what they are to be multiplied by. An alarm that
    is a state must not come, since what follows depends on it."""
    if isinstance(detector, Calibrated | PooledDetector):
        raise TypeError(
            f"{type(detector).__name__} has no ratios of its own: give the detector inside it, or "
            "the members of the pool"
        )
    if detector.alarm_is_state:
        never: Any = dataclasses.replace(detector, alarm_scale=UNREACHED)  # type: ignore[type-var]
        return never, UNREACHED
    return detector, 1.0


def play_batch(
    setup: Setup,
    detectors: Sequence[Detector],
    in_loop: bool,
    rngs: Sequence[np.random.Generator],
    stopped: threading.Event | None,
) -> CleanRuns:
    """Play a run of each generator, side by side, until it is stopped."""
    monitor = RunMaxima(() if in_loop else detectors)
    judge = detectors[0] if in_loop else Never()
    setup = setup.copy_with(detector=judge, monitors=[monitor])
    simulator: Simulator = setup.simulator(len(rngs), run_serially)
    maxima = simulator.monitor(RunMaxima)
    for _ in simulator.warming(rngs, piece=20 * len(rngs)):
        check_stopped(stopped)
    before = maxima.pop_maxima()
    for _ in range(setup.steps + setup.hold):
        check_stopped(stopped)
        simulator.step(attacked=False)
    return gather_runs(simulator, setup, before, maxima.pop_maxima())


def gather_runs(
    simulator: Simulator, setup: Setup, before: Sequence[Any], window: Sequence[Any]
) -> CleanRuns:
    """Runs of a simulator, from ratios and alarms before the onset and in the window."""
    age_s = np.asarray(simulator.ages * setup.interval_s, dtype=np.float64)
    world = simulator.onset // setup.epochs_each
    return CleanRuns(before[0], window[0], before[1], window[1], world, age_s)


@dataclass
class Player:
    """Plays clean runs of one world; `threads` share the chunks, with a simulator each; `batch`
    plays one."""

    setup: Setup
    entropy: int = 0
    seed_name: str = ""
    threads: int | None = None
    chunk: int = CHUNK
    batch: Callable[..., CleanRuns] = play_batch
    progress: ProgressCallback = field(default_factory=NullProgress)

    def __post_init__(self) -> None:
        self.seed_name = self.seed_name or self.setup.name
        for name, value in (("threads", self.threads), ("chunk", self.chunk)):
            if value is not None:
                check_number(name, value, least=1, whole=True)

    def play(
        self,
        detectors: Sequence[Detector],
        numbers: Numbers,
        *,
        split: str = "calibration",
        in_loop: bool = False,
        now: str = "clean runs",
    ) -> CleanRuns:
        """Runs of a split by their numbers; `in_loop` takes one detector, which weighs."""

        def tick(runs: int) -> None:
            self.progress.advance(float(runs), now)

        return join_runs(self.play_chunks(detectors, [numbers], split, in_loop, tick))

    def forget(self) -> None:
        """Leave nothing of what has been played, for one that keeps it."""

    def play_chunks(
        self,
        detectors: Sequence[Detector],
        chunks: Sequence[Numbers],
        split: str,
        in_loop: bool,
        tick: Callable[[int], None],
    ) -> Iterator[CleanRuns]:
        """Play chunks of runs, those of like ages side by side, so that few wait for the oldest.
        `tick` is given how many have been played."""

        def work(chunk: Numbers, stop: threading.Event) -> CleanRuns:
            rngs = self.generators(split, chunk)
            return self.batch(self.setup, detectors, in_loop, rngs, stop)

        numbers = np.concatenate([np.asarray(chunk) for chunk in chunks])
        order = np.argsort(-draw_ages(self.setup, self.generators(split, numbers)), kind="stable")
        ends, left, whole = np.cumsum([len(chunk) for chunk in chunks]), list(chunks), None
        missing = np.ones(len(numbers), dtype=np.bool_)
        pieces = self._chunks(order)
        played = map_ordered(work, [numbers[rows] for rows in pieces], self.threads)
        for rows, part in zip(pieces, played, strict=True):
            if whole is None:
                whole = [np.empty((len(numbers), *x.shape[1:]), x.dtype) for x in part]
            for array, own in zip(whole, part, strict=True):
                array[rows] = own
            missing[rows] = False
            tick(len(rows))
            while left and not missing[: (end := ends[-len(left)])].any():
                first = end - len(left.pop(0))
                yield CleanRuns._make(array[first:end] for array in whole)

    def simulators(self, monitor: Monitor, numbers: range) -> Iterator[Simulator]:
        """Let a monitor look at the judged windows of runs without a defence."""
        setup = self.setup.copy_with(detector=Never(), monitors=[monitor])

        def one(chunk: Numbers, stopped: threading.Event) -> Simulator:
            simulator: Simulator = setup.simulator(len(chunk), run_serially)
            simulator.warm_up(self.generators("calibration", chunk))
            simulator.monitors[0].start_episodes()
            for _ in range(setup.steps + setup.hold):
                check_stopped(stopped)
                simulator.step(attacked=False)
            return simulator

        return map_ordered(one, self._chunks(numbers), self.threads)

    def _chunks(self, numbers: Numbers) -> list[Numbers]:
        return [numbers[k : k + self.chunk] for k in range(0, len(numbers), self.chunk)]

    def generators(self, split: str, numbers: Numbers) -> list[np.random.Generator]:
        """Random numbers of some runs."""
        runs = map(int, numbers)
        return make_generators(seeds_of_runs(self.entropy, split, self.seed_name, runs))


class Stopped(Exception):
    """Another thread has failed, or the program was interrupted."""


def check_stopped(stopped: threading.Event | None) -> None:
    if stopped is not None and stopped.is_set():
        raise Stopped


def map_ordered(
    work: Callable[[Any, threading.Event], Any], items: Iterable[Any], threads: int | None
) -> Iterator[Any]:
    """Call `work` on items in threads, all useful ones by default; results in their order."""
    stopped = threading.Event()
    waiting: deque[Future[Any]] = deque()
    threads = min(threads or processors(), processors())
    with ThreadPoolExecutor(threads) as pool:
        try:
            for item in items:
                waiting.append(pool.submit(work, item, stopped))
                if len(waiting) > threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:  # also where whoever takes them has failed
            stopped.set()
            for each in waiting:
                each.cancel()


def join_runs(parts: Iterable[CleanRuns]) -> CleanRuns:
    """All runs of some chunks."""
    return CleanRuns(*map(np.concatenate, zip(*parts, strict=True)))
