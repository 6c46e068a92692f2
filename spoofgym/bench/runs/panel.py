"""Runs of a task for detectors: chosen by their onsets, played once for all that only look.

Detectors that leave the filter alone see the same epochs whatever they make of them, so that a pass
of the engine is enough for all of them.  One that takes weight off measurements has passes of its
own, as one has that a spoofer watches.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...calibration.clean_runs import RunMaxima
from ...detectors import Calibrated, Detector, Never, PooledDetector
from ...simulation.domain import draw
from ...simulation.monitors import PassiveDetectors
from ...simulation.setup import Setup, generators_of, seeds_of_runs
from ...simulation.simulator import Simulator, episode_seeds
from ...tasks import CANDIDATES, NEAR_ALARM_S, SWITCH_WITHIN_S, TURNING_DEGPS
from ...truth.sensors import keys_of
from ..scores.scores import counted, undetected_displacement
from .play import Runs, WarmStart, induced_error, play

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]
Rngs = Callable[[], list[np.random.Generator]]
"""Makes the generators of runs, each time as they were."""
BLOCK, MOST_TRIED = 512, 400_000
"""How many runs are looked at together for one that fits, and how many at most."""


def turning(setup: Setup) -> Mask:
    """(K,) at which epochs of its worlds the target's track turns."""
    velocity = np.einsum("kji,kj->ki", setup.C_en, setup.world.velocity_e)
    heading = np.arctan2(velocity[:, 1], velocity[:, 0]).reshape(-1, setup.epochs_each)
    rate = np.gradient(np.unwrap(heading, axis=1), setup.interval_s, axis=1)
    return np.asarray(np.abs(np.degrees(rate)).ravel() > TURNING_DEGPS)


def near_switch(setup: Setup) -> Mask:
    """(K,) at which epochs of its worlds a satellite rises or sets within `SWITCH_WITHIN_S`."""
    visible = setup.world.visible.reshape(-1, setup.epochs_each, setup.world.visible.shape[1])
    changed = np.zeros(visible.shape[:2], dtype=np.bool_)
    changed[:, 1:] = (visible[:, 1:] != visible[:, :-1]).any(axis=2)
    near, span = changed.copy(), round(SWITCH_WITHIN_S / setup.interval_s)
    for k in range(1, span + 1):
        near[:, k:] |= changed[:, :-k]
        near[:, :-k] |= changed[:, k:]
    return near.ravel()


CONDITIONS: dict[str, Callable[[Setup], Mask]] = {
    "turn": turning,
    "satellite-switch": near_switch,
}
"""Conditions on the onset that follow from the world alone."""


def numbers_of(
    setup: Setup, entropy: int, split: str, runs: int, condition: str | None
) -> NDArray[np.int64]:
    """(R,) the first runs of a split whose onset is as a condition has it; any without one. Each
    draws its world and its start as ever; which of them are played is all that is chosen."""
    if condition is None:
        return np.arange(runs)
    holds, found = CONDITIONS[condition](setup), np.zeros(0, dtype=np.int64)
    for first in range(0, MOST_TRIED, BLOCK):
        numbers = np.arange(first, first + BLOCK)
        seeds = seeds_of_runs(entropy, split, setup.name, numbers.tolist())
        choice = draw(setup.bounds, keys_of(episode_seeds(generators_of(seeds)))["domain"])
        onset = choice.world * setup.epochs_each + choice.start + setup.onset
        found = np.concatenate([found, numbers[holds[onset]]])
        if len(found) >= runs:
            return found[:runs]
    raise ValueError(
        f"of {MOST_TRIED} runs in {setup.name} only {len(found)} have an onset at a {condition}, "
        f"and {runs} are wanted: none of its flights may have one where an attack can start"
    )


def generators(
    setup: Setup, entropy: int, split: str, numbers: NDArray[np.int64]
) -> list[np.random.Generator]:
    return generators_of(seeds_of_runs(entropy, split, setup.name, numbers.tolist()))


def in_any_world(judge: Detector) -> Detector:
    """A detector with the thresholds that it has, whatever world it is put into; a copy."""
    if isinstance(judge, PooledDetector):
        return PooledDetector([in_any_world(each) for each in judge.judges], judge.weights)
    if not isinstance(judge, Calibrated):
        return copy.deepcopy(judge)
    inner = copy.deepcopy(judge.detector)
    return Calibrated(inner, judge.scale, rescaled=judge.rescaled, rescale=judge.rescale)


class LateMaxima(RunMaxima):
    """Largest ratio of the detector in the loop at the last epochs of the monitored warm-up.
    `epochs`: of the warm-up; `last` of them count."""

    def __init__(self, epochs: int, last: int) -> None:
        super().__init__(())
        self._skipped, self._seen = max(epochs - last, 0), 0

    def begin(self) -> None:
        super().begin()
        self._seen = 0

    def update(self, simulator: Any) -> None:
        super().update(simulator)
        self._seen += 1
        if self._seen == self._skipped:
            self.memory.reset()


class Panel:
    """Runs at their onset, for one detector in the loop, or for several that only look.

    - `start`: of all; `clean`: what they do without attack;
    - `warmup_alarm`, `twin_alarm` (R, D) alarms before the onset, and epoch of the first after it;
    - `counts` (R, D) which of them count; `sky` (R,) under which they fly.
    """

    def __init__(
        self,
        setup: Setup,
        judges: Sequence[Detector],
        rngs: Rngs,
        threads: int | None,
    ) -> None:
        self.judges, self.rngs, self.threads = judges, rngs, threads
        self.setup = self._defended(setup)
        self._begin(WarmStart(self.setup, rngs(), threads=threads), None)

    def _defended(self, setup: Setup) -> Setup:
        if len(self.judges) == 1:
            return setup.altered(detector=self.judges[0])
        return setup.altered(detector=Never(), monitors=[PassiveDetectors(self.judges)])

    def _begin(self, start: WarmStart, warmup_alarm: Mask | None) -> None:
        """Take the receivers at the onset, and see what they do without attack."""
        self.start = start
        self.warmup_alarm = self._alarmed(start) if warmup_alarm is None else warmup_alarm
        self.clean, self.twin_alarm = self._played(start, "none", drop=False)
        self.counts = counted(self.warmup_alarm, self.twin_alarm)
        self.sky = np.asarray(self.clean.onset // self.setup.epochs_each)

    @property
    def runs(self) -> int:
        """R."""
        return self.start.receivers

    def _alarmed(self, start: WarmStart) -> Mask:
        """(R, D) alarms before the onset, which are forgotten."""
        if len(self.judges) == 1:
            return start.warmup_alarm[:, None].copy()
        alarmed = start.simulator.monitor(PassiveDetectors).memory["alarmed"]
        before = alarmed.copy()
        alarmed[:] = False
        return before

    def _played(
        self, start: WarmStart, spec: Any, *, drop: bool = True
    ) -> tuple[Runs, NDArray[np.int64]]:
        """Runs under attack, and (R, D) the epoch of each detector's first alarm, 0 for none."""
        if len(self.judges) == 1:
            runs = play(start, spec, drop_alarmed=drop)
            return runs, runs.first_alarm[:, None]
        first = np.zeros((start.receivers, len(self.judges)), dtype=np.int64)

        def watch(epoch: int, rows: NDArray[np.intp], simulator: Simulator) -> Mask:
            alarmed = simulator.monitor(PassiveDetectors).memory["alarmed"]
            first[rows] = np.where(alarmed & (first[rows] == 0), epoch + 1, first[rows])
            return np.asarray(alarmed.all(axis=1))

        return play(start, spec, drop_alarmed=drop, watch=watch), first

    def displacement(self, spec: Any, runs: int, attack: Any = None) -> FloatArray:
        """(D, R') undetected displacement of the first runs under an attack of a spoofer [m].
        `attack`: in place of the panel's own; the receivers are then warmed up again."""
        start, clean = self.start.first(runs), self.clean.first(runs)
        if attack is not None:
            other = copy.copy(self.setup)
            other.attack = attack
            start = WarmStart(other, self.rngs()[:runs], threads=self.threads)
            self._alarmed(start)
        attacked, first = self._played(start, spec)
        setup = self.setup
        error = induced_error(setup, attacked, clean)[: setup.steps]
        moved = [undetected_displacement(error, each, setup.hold) for each in first.T]
        return np.asarray(np.round(np.array(moved), 6), dtype=np.float64)


class NearAlarm(Panel):
    """Runs of one detector in which it alarmed before the onset, or came closest to doing so. They
    are the closest of `CANDIDATES` times as many. One with an alarm before the onset counts."""

    def __init__(self, setup: Setup, judge: Detector, rngs: Rngs, threads: int | None) -> None:
        self.judges, self.threads = [judge], threads
        last = min(round(NEAR_ALARM_S / setup.interval_s), setup.live)
        own = self._defended(setup)
        watched = own.altered(monitors=[LateMaxima(setup.live, last)])
        everyone = WarmStart(watched, rngs(), threads=threads)
        ratio, _ = everyone.simulator.monitor(LateMaxima).taken()
        order = np.argsort(-ratio[:, 0], kind="stable")
        chosen = np.sort(order[: math.ceil(len(order) / CANDIDATES)])
        kept = set(chosen.tolist())
        self.rngs = lambda: [drawn for k, drawn in enumerate(rngs()) if k in kept]
        self.setup, self.ratio = own, ratio[chosen, 0]
        start = everyone.under(own).take(chosen)
        self._begin(start, np.zeros((len(chosen), 1), dtype=np.bool_))
