"""Runs at their onset, played once for all detectors that only look; and runs by their onsets.

Detectors that leave the filter alone see the same epochs whatever they make of them, so that a pass
of the engine is enough for all of them.  One that takes weight off measurements has passes of its
own, as one has that a spoofer watches.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Generator, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...calibration.clean_runs import RunMaxima
from ...detectors import Calibrated, Detector, Never, PooledDetector
from ...detectors.calibrated import resolve_thresholds
from ...envs.context import spoofer_context
from ...simulation.domain import draw
from ...simulation.monitors import Monitor
from ...simulation.setup import Setup, make_generators, seeds_of_runs
from ...simulation.simulator import episode_seeds
from ...spoofers import SpooferContext, make_spoofer
from ...spoofers.base import sees_statistics
from ...tasks import CANDIDATES, NEAR_ALARM_S, SWITCH_WITHIN_S, TURNING_DEGPS
from ...truth.sensors import draw_source_keys
from .on_device import TOGETHER
from .play import FloatArray, PanelDetectors, Runs, WarmStart, get_traits, play_side_by_side
from .record import Mask, RunRecord, compute_displacement, mask_valid_runs

Rngs = Callable[[], list[np.random.Generator]]
"""Makes the generators of runs, each time as they were."""
BLOCK, MOST_TRIED = 512, 400_000
"""How many runs are looked at together for one that fits, and how many at most."""
MOST_ROWS, MOST_BYTES = 384, 5e7
"""Runs that attacks of one pass have together, and what detectors remember of them, but for a
single attack that has more."""


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


CONDITIONS: dict[str, Callable[[Setup], Mask]] = {"turn": turning, "satellite-switch": near_switch}
"""Conditions on the onset that follow from the world alone."""


def select_runs(
    setup: Setup, entropy: int, split: str, runs: int, condition: str | None
) -> NDArray[np.int64]:
    """(R,) the first runs of a split with an onset that meets a condition; any run without one.
    Each draws its world and its start as ever; only which of them are played is chosen."""
    if condition is None:
        return np.arange(runs)
    holds, found = CONDITIONS[condition](setup), np.zeros(0, dtype=np.int64)
    for first in range(0, MOST_TRIED, BLOCK):
        numbers = np.arange(first, first + BLOCK)
        seeds = seeds_of_runs(entropy, split, setup.name, numbers.tolist())
        choice = draw(
            setup.bounds, draw_source_keys(episode_seeds(make_generators(seeds)))["domain"]
        )
        found = np.concatenate([found, numbers[holds[setup.find_onsets(choice)]]])
        if len(found) >= runs:
            return found[:runs]
    raise ValueError(
        f"of {MOST_TRIED} runs in {setup.name} only {len(found)} have an onset at a {condition}, "
        f"and {runs} are wanted: perhaps no flight has one where an attack can start"
    )


def generators(
    setup: Setup, entropy: int, split: str, numbers: NDArray[np.int64]
) -> list[np.random.Generator]:
    return make_generators(seeds_of_runs(entropy, split, setup.name, numbers.tolist()))


def in_any_world(judge: Detector) -> Detector:
    """A detector with the thresholds that it has, whatever world it is put into; a copy."""
    if isinstance(judge, PooledDetector):
        return PooledDetector([in_any_world(each) for each in judge.judges], judge.weights)
    if not isinstance(judge, Calibrated):
        return copy.deepcopy(judge)
    inner = copy.deepcopy(judge.detector)
    return Calibrated(inner, judge.scale, rescaled=judge.rescaled, rescale=judge.rescale)


class LateMaxima(RunMaxima):
    """Largest ratio of the detector in the loop at the last epochs of the monitored warm-up, of
    which `last` count."""

    def __init__(self, last: int) -> None:
        super().__init__(())
        self._last = last

    def update(self, simulator: Any) -> None:
        super().update(simulator)
        self.memory.reset(simulator.epochs == simulator.onset - self._last)


class PanelAttack(NamedTuple):
    """An attack on the first so many runs of a panel; `attack` in place of the world's own."""

    spec: Any
    runs: int
    attack: Any = None

    @property
    def key(self) -> str:
        """Equal for what is played once."""
        return repr(tuple(self))


Numbers = tuple[int, ...]  # which detectors of a panel, in their order
T = TypeVar("T")
Search = Generator[list[PanelAttack], list[Runs], T]
"""Yields attacks, is sent what a detector makes of them, and returns what it has found."""


class Panel:
    """Runs at their onset, under a `sky` (R,), in front of a detector in the loop, or of several
    that only look; `clean`: what each makes of them without attack; `warmup_alarm`, `twin_alarm`
    (R, D) alarms before the onset, and epoch of the first after it; `counts` (R, D) which of them
    count. `device`: as of a `WarmStart`, for one detector."""

    def __init__(
        self,
        setup: Setup,
        judges: Sequence[Detector],
        rngs: Rngs,
        threads: int | None,
        watched: Sequence[Monitor] = (),
        device: str = "cpu",
    ) -> None:
        self.world, self.judges, self.rngs, self.threads = setup, judges, rngs, threads
        self._watched, self.device = list(watched), device
        self._start_at_onset(self._warm_up(self._build_setup(tuple(range(len(judges)))), rngs()))

    def _warm_up(self, setup: Setup, rngs: list[np.random.Generator]) -> WarmStart:
        return WarmStart(setup, rngs, threads=self.threads, device=self.device)

    def _build_setup(self, numbers: Numbers) -> Setup:
        if len(self.judges) == 1:
            return self.world.copy_with(detector=self.judges[0], monitors=self._watched)
        panel = PanelDetectors([self.judges[k] for k in numbers], numbers)
        return self.world.copy_with(detector=Never(), monitors=[panel, *self._watched])

    def _start_at_onset(self, start: WarmStart, warmup_alarm: Mask | None = None) -> None:
        """Take the receivers at the onset, and see what they do without attack."""
        self.start, self.setup = start, start.setup
        self._alone: dict[int, WarmStart] = {}
        if warmup_alarm is None:
            alone = len(self.judges) == 1
            warmup_alarm = (
                start.warmup_alarm[:, None]
                if alone
                else start.simulator.monitor(PanelDetectors).memory["so_far"]
            ).copy()
        self.warmup_alarm = warmup_alarm
        self.clean = play_side_by_side(start, ["none"])
        self.twin_alarm = np.stack([each.first_alarm for each in self.clean], axis=1)
        self.counts = mask_valid_runs(self.warmup_alarm, self.twin_alarm)
        self.sky = np.asarray(self.clean[0].onset // self.setup.epochs_each)

    @property
    def runs(self) -> int:
        return self.start.receivers

    @property
    def nbytes(self) -> float:
        """What detectors remember of the runs at their onset."""
        return self.runs * self.start.bytes_each

    @property
    def context(self) -> SpooferContext:
        return spoofer_context(self.setup)

    def play(
        self,
        attacks: Sequence[tuple[PanelAttack, int]],
        *,
        drop: bool = True,
        tick: Callable[[float], None] = lambda _: None,
    ) -> list[Runs]:
        """What detectors make of attacks, each by its number; `drop`: as of `play_side_by_side`.
        Equal attacks are played once, and those side by side share a pass; a spoofer that observes
        statistics has a pass of its own with every detector in the loop."""
        wanted: dict[str, tuple[PanelAttack, set[int]]] = {}
        for each, number in attacks:
            wanted.setdefault(each.key, (each, set()))[1].add(number)
        passes: dict[Any, list[PanelAttack]] = {}
        for each, numbers in wanted.values():
            spoofer = make_spoofer(each.spec)
            alone = len(self.judges) > 1 and sees_statistics(spoofer.knowledge)
            for own in [(k,) for k in numbers] if alone else [tuple(sorted(numbers))]:
                key = own, alone, id(each.attack), get_traits(spoofer)
                passes.setdefault(key, []).append(each)
        found: dict[tuple[str, int], Runs] = {}
        for (numbers, alone, *_), several in passes.items():
            sizes = [min(each.runs, self.runs) for each in several]
            together = MOST_ROWS if self.device == "cpu" else TOGETHER
            most = min(together, int(MOST_BYTES / max(self.start.bytes_each, 1.0)))
            share = (np.cumsum(sizes) - 1) // max(most, *sizes)
            for part in np.unique(share):
                some = [(several[j], sizes[j]) for j in np.flatnonzero(share == part)]
                rows = np.concatenate([np.arange(size) for _, size in some])
                which = np.repeat(np.arange(len(some)), [size for _, size in some])
                size = len(rows) * len(numbers)
                played = play_side_by_side(
                    self._start(numbers, alone, some[0][0], rows),
                    [each.spec for each, _ in some],
                    which,
                    drop_alarmed=drop,
                    tick=lambda part, n=size: tick(part * n),  # type: ignore[misc]
                )
                for j, (each, _) in enumerate(some):
                    own_rows = np.flatnonzero(which == j)
                    shared = played[0].take(own_rows)
                    for k, runs in zip(numbers, played, strict=True):
                        found[each.key, k] = shared._replace(
                            alarm=runs.alarm[:, own_rows],
                            peak=runs.peak[own_rows],
                            blamed=runs.blamed[own_rows],
                        )
        return [found[each.key, number] for each, number in attacks]

    def play_each(
        self, number: int, specs: Sequence[Any], which: NDArray[np.intp], rows: NDArray[np.intp]
    ) -> Runs:
        """What a detector makes of some runs, each under an attack of its own, `which` (r,) of the
        specs; runs are left once they have alarmed."""
        alone = len(self.judges) > 1 and sees_statistics(make_spoofer(specs[0]).knowledge)
        count = len(rows)
        if count == 1:  # see `keep_company`
            rows, which = np.repeat(rows, 2), np.repeat(which, 2)
        start = self._start((number,), alone, PanelAttack(specs[0], len(rows)), rows)
        return play_side_by_side(start, specs, which, drop_alarmed=True)[0].first(count)

    def at_thresholds(self, number: int, factor: float, runs: int) -> Panel:
        """The first runs with the thresholds of one of the detectors so many times as high, from
        the same onset, since weights are not scaled; the same runs count. A TypeError where it has
        no scaled thresholds."""
        judge = copy.deepcopy(self.judges[number])
        if not isinstance(judge, Calibrated):
            raise TypeError(f"{judge!r} has no scaled thresholds")
        resolve_thresholds(judge, self.world)
        scaled = in_any_world(judge)
        scaled.scale *= factor  # type: ignore[attr-defined]
        part = copy.copy(self)
        part.judges = [scaled if k == number else each for k, each in enumerate(self.judges)]
        part.rngs = lambda: self.rngs()[:runs]
        own = part._build_setup(tuple(range(len(part.judges))))
        part.start, part.setup = self.start.first(runs).under(own), own
        part.clean = [each.first(runs) for each in self.clean]
        part.warmup_alarm, part.twin_alarm = self.warmup_alarm[:runs], self.twin_alarm[:runs]
        part.counts, part.sky = self.counts[:runs], self.sky[:runs]
        in_loop = self.world.copy_with(detector=scaled, monitors=self._watched)
        part._alone = {
            k: start.first(runs).under(in_loop) for k, start in self._alone.items() if k == number
        }
        return part

    def _start(
        self, numbers: Numbers, alone: bool, attack: PanelAttack, rows: NDArray[np.intp]
    ) -> WarmStart:
        """Runs at the onset in front of some detectors."""
        if not alone:
            setup = self.setup
            if len(numbers) < len(self.judges):
                setup = self._build_setup(numbers)
            if attack.attack is not None:
                setup = copy.copy(setup)
                setup.attack = attack.attack
            return self.start.under(setup).take(rows)
        if numbers[0] not in self._alone:
            setup = self.world.copy_with(detector=self.judges[numbers[0]], monitors=self._watched)
            self._alone[numbers[0]] = self._warm_up(setup, self.rngs())
        return self._alone[numbers[0]].take(rows)

    def record(self, number: int, attacked: Runs, head: dict[str, Any]) -> RunRecord:
        moved = compute_displacement(self.setup, attacked, self.clean[number])
        records = {
            "warmup_alarm": self.warmup_alarm[:, number],
            "first_alarm": attacked.first_alarm,
            "twin_alarm": self.twin_alarm[:, number],
            "undetected_displacement_m": moved,
            "sky": self.sky,
        }
        return RunRecord(head, records)

    def displacement(self, attack: PanelAttack) -> FloatArray:
        """(D, R') undetected displacement under an attack [m]."""
        played = self.play([(attack, k) for k in range(len(self.judges))])
        pairs = zip(played, self.clean, strict=True)
        moved = [compute_displacement(self.setup, x, twin.first(attack.runs)) for x, twin in pairs]
        return np.asarray(np.round(np.array(moved), 6), dtype=np.float64)


def play_searches(
    panel: Panel,
    searches: Sequence[tuple[int, Search[T]]],
    tick: Callable[[float], None] = lambda _: None,
) -> list[T]:
    """Run searches side by side, each against a detector of a panel by its number."""
    found: dict[int, T] = {}
    waiting = {n: next(search) for n, (_, search) in enumerate(searches)}
    while waiting:
        requests = [(each, searches[n][0]) for n, attacks in waiting.items() for each in attacks]
        answers = iter(panel.play(requests, tick=tick))
        for n, attacks in list(waiting.items()):
            try:
                waiting[n] = searches[n][1].send([next(answers) for _ in attacks])
            except StopIteration as stop:
                found[n] = stop.value
                del waiting[n]
    return [found[n] for n in range(len(searches))]


class NearAlarm(Panel):
    """Runs of one detector in which it alarmed before the onset, or came closest to doing so. They
    are the closest of `CANDIDATES` times as many. One with an alarm before the onset counts."""

    def __init__(self, setup: Setup, judge: Detector, rngs: Rngs, threads: int | None) -> None:
        self.world, self.judges, self.threads, self._watched = setup, [judge], threads, []
        self.device = "cpu"  # that of the monitor
        own, last = self._build_setup((0,)), round(NEAR_ALARM_S / setup.interval_s)
        drawn, watched = rngs(), own.copy_with(monitors=[LateMaxima(last)])
        ratio, size = np.empty(len(drawn)), math.ceil(len(drawn) / CANDIDATES)
        for first in range(0, len(drawn), size):  # not all at once, for want of memory
            part = slice(first, first + size)
            late = WarmStart(watched, drawn[part], threads=threads).simulator.monitor(LateMaxima)
            ratio[part] = late.pop_maxima()[0][:, 0]
        order = np.argsort(-ratio, kind="stable")
        chosen = np.sort(order[:size])
        selected = set(chosen.tolist())
        self.rngs = lambda: [drawn for k, drawn in enumerate(rngs()) if k in selected]
        self.ratio = ratio[chosen]
        start = self._warm_up(own, self.rngs())
        self._start_at_onset(start, np.zeros((len(chosen), 1), dtype=np.bool_))
