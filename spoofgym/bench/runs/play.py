"""Spoofers on many runs, and what the detectors in front of them make of it."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ...core.memory import Memory
from ...core.registry import describe_error
from ...detectors import Detector
from ...detectors.base import has_protection_level, judge_epoch
from ...envs.context import apply_pace
from ...envs.observer import Observer
from ...envs.spoofer_binding import bound_spoofer
from ...envs.terms.action import CommandMap, Decisions
from ...simulation.engine import Engine
from ...simulation.monitors import Monitor, Monitored, PassiveDetectors
from ...simulation.setup import Setup
from ...simulation.simulator import FixedChoices, Simulator, keep_company
from ...spoofers import Spoofer, make_spoofer
from .on_device import DeviceEngine

FloatArray = NDArray[np.float64]


def make_bound_spoofer(
    spec: Any, setup: Setup, receivers: int
) -> tuple[Spoofer, Observer, CommandMap]:
    """Spoofer that is ready for a batch, what it observes, and what its actions command."""
    spoofer = make_spoofer(spec)
    context, observer, commands = bound_spoofer(spoofer, setup, receivers)
    spoofer.bind(context)
    spoofer.reset()
    return spoofer, observer, commands


class _Part(NamedTuple):
    """A spoofer, ready for its rows of a batch."""

    spec: Any
    spoofer: Spoofer
    rows: NDArray[np.intp]

    @property
    def where(self) -> slice | NDArray[np.intp]:
        """The rows, as a slice where they are side by side."""
        first, end = int(self.rows[0]), int(self.rows[-1]) + 1
        return slice(first, end) if end - first == len(self.rows) else self.rows


class SpooferController:
    """Spoofers that command the receivers of an engine, which are at their onset; it leaves
    measurements alone where the first transmits nothing. `specs` are alike but for their settings:
    they observe and command the same, at one pace; `which` (B,) commands each receiver, by default
    the first, and -1 none."""

    def __init__(
        self, specs: Sequence[Any], engine: Engine, which: NDArray[np.intp] | None = None
    ) -> None:
        self.engine = engine
        which = np.zeros(engine.receivers, dtype=np.intp) if which is None else which
        rows = [np.flatnonzero(which == k) for k in range(len(specs))]
        self._parts = [
            _Part(spec, make_spoofer(spec), own)
            for spec, own in zip(specs, rows, strict=True)
            if len(own)
        ]
        self._bind()
        first = self._parts[0].spoofer
        setup, size = apply_pace(engine.setup, first), len(self._commands.names)
        self._decisions = Decisions(setup, engine.receivers, size)
        if not first.transmits:
            engine.simulator.clean = np.ones(engine.receivers, dtype=np.bool_)

    def _bind(self) -> None:
        """Prepare the spoofers for the receivers of the engine."""
        made = bound_spoofer(self._parts[0].spoofer, self.engine.setup, self.engine.receivers)
        context, self._observer, self._commands = made
        for part in self._parts:
            part.spoofer.bind(context._replace(receivers=len(part.rows)))
            part.spoofer.reset()
        self._commands.aim(self.engine.simulator.heading)

    def command(self, epoch: int) -> FloatArray | None:
        """Command (B, a) of an epoch, counted from the onset on; None after the last one."""
        if epoch >= self.engine.setup.steps:
            return None
        return self._commands.command(self.action(epoch), self.engine.simulator.commanded_rate)

    def action(self, epoch: int) -> FloatArray:
        """Action (B, k) of an epoch, on the way from one decision to the next. Calls the spoofers
        where a decision is due."""
        if self._decisions.due(epoch):
            self._decisions.take(self.decide(epoch))
        return self._decisions.action(epoch)

    def decide(self, epoch: int) -> FloatArray:
        """Action of the spoofers, checked: (B, k) float64, C-contiguous."""
        seen = self._observer(self.engine, epoch)
        action = np.zeros((self.engine.receivers, len(self._commands.names)))
        for part in self._parts:
            rows = part.where
            action[rows] = _shaped_action(part.spoofer, seen[rows])
        within = np.abs(action) <= 1.0
        if not within.all():
            row, column = np.argwhere(~within)[0]
            (part,) = (each for each in self._parts if row in each.rows)
            raise ValueError(
                f"{type(part.spoofer).__name__} must return actions within [-1, 1], got "
                f"{action[row, column]}"
            )
        return action

    def go_on_with(self, engine: Engine, rows: NDArray[np.intp]) -> None:
        """Command an engine of some of the receivers from now on."""
        self.engine, before = engine, self._parts
        self._decisions = self._decisions.of(rows)
        own = [np.flatnonzero(np.isin(part.rows, rows)) for part in before]
        left = [(part, among) for part, among in zip(before, own, strict=True) if len(among)]
        self._parts = [
            _Part(part.spec, make_spoofer(part.spec), np.searchsorted(rows, part.rows[among]))
            for part, among in left
        ]
        self._bind()
        for mine, (part, among) in zip(self._parts, left, strict=True):
            mine.spoofer.memory.copy_rows(np.arange(len(among)), part.spoofer.memory, among)


def _shaped_action(spoofer: Spoofer, seen: NDArray[np.float32]) -> FloatArray:
    """Action of a spoofer: (B, k)."""
    try:
        action = np.asarray(spoofer.act(seen), dtype=np.float64)
    except (LookupError, AttributeError) as error:
        inner = getattr(spoofer, "spoofer", spoofer)
        raise RuntimeError(f"{type(inner).__name__} raises {describe_error(error)}") from error
    names = spoofer.context.action_names
    if action.shape != (len(seen), len(names)):
        raise ValueError(
            f"{type(spoofer).__name__} must return actions of shape {(len(seen), len(names))} "
            f"({', '.join(names)}), got {action.shape}"
        )
    return action


def get_traits(spoofer: Spoofer) -> tuple[Any, ...]:
    """What spoofers have in common that can command parts of one batch."""
    names = "knowledge", "action_terms", "decision_interval_s", "between", "transmits"
    return tuple(repr(getattr(spoofer, name)) for name in names)


DROP_EVERY, DROP_PART = 10, 0.25
"""How often, in epochs, settled runs are dropped, and from which part of all on."""


class Runs(NamedTuple):
    """What happened in the K epochs from the onset of the attack to the end of the hold.

    - `position` (K, R, d) estimated after each epoch, in the axes of `Setup.true_position` [m]; NaN
      once a run has been dropped; `alarm` (K, R) of any channel;
    - `peak` (R,) largest ratio of a statistic to its threshold; `blamed` (R,) channels, summed;
    - `onset` (R,) epoch of `Setup.epoch_time` after which the attack began; `heading` (R,) of the
      target, clockwise from north [rad];
    - `coasting` (K, R) whether the epoch had no update for want of measurements;
    - `protection` (K, R) level [m]; None but of clean runs of a detector that has one.
    """

    position: FloatArray
    alarm: NDArray[np.bool_]
    peak: FloatArray
    onset: NDArray[np.int64]
    heading: FloatArray
    coasting: NDArray[np.bool_]
    blamed: NDArray[np.int64]
    protection: FloatArray | None = None

    def first(self, count: int) -> Runs:
        return self.take(np.arange(min(count, len(self.peak))))

    def take(self, rows: NDArray[np.intp]) -> Runs:
        """Chosen runs, some of them more than once if so wanted."""
        return Runs(
            position=self.position[:, rows],
            alarm=self.alarm[:, rows],
            peak=self.peak[rows],
            onset=self.onset[rows],
            heading=self.heading[rows],
            coasting=self.coasting[:, rows],
            blamed=self.blamed[rows],
            protection=None if self.protection is None else self.protection[:, rows],
        )

    @property
    def first_alarm(self) -> NDArray[np.int64]:
        """(R,) epoch of the first alarm, from 1 on; 0 without an alarm."""
        first = self.alarm.argmax(axis=0) + 1
        return np.where(self.alarm.any(axis=0), first, 0)


class WarmStart:
    """Receivers at the onset of the attack, after one warm-up that all spoofers start from. The
    warm-up is clean, so that it is the same for every spoofer: a run from here has the same bits as
    one with a warm-up of its own. `setup`: world, victim, attack, detector and timeline; `device`:
    where runs are played, a GPU with the same bits; `warmup_alarm` (R,) bool, false alarms before
    the attack; `given`: as of `Engine.reset`."""

    def __init__(
        self,
        setup: Setup,
        rngs: Sequence[np.random.Generator],
        *,
        threads: int | None = None,
        device: str = "cpu",
        given: FixedChoices | None = None,
    ) -> None:
        self.setup, self.receivers = setup, len(rngs)
        self._make: Callable[[int, Setup], Engine] = partial(Engine, threads=threads)
        if device != "cpu":
            self._make = partial(DeviceEngine, device=device)
        self._engine = self._make(len(rngs), setup)
        self._engine.reset(rngs, given=given)
        self._rows = np.arange(len(rngs))
        self.warmup_alarm = self._engine.warmup_alarm.copy()

    @property
    def simulator(self) -> Simulator:
        """The receivers that were warmed up, taken or not, at the onset; they must not be
        changed."""
        return self._engine.simulator

    @property
    def bytes_each(self) -> float:
        """What detectors remember of a receiver in this process."""
        panel = _find_panel(self.simulator)
        judges = [self.simulator.detector] if panel is None else panel.detectors
        whole = sum(array.nbytes for each in judges for array in each.memory.values())
        return whole / self._engine.receivers

    def under(self, setup: Setup) -> WarmStart:
        """The same receivers; their runs have other monitors, or another attack."""
        part = copy.copy(self)
        part.setup = setup
        return part

    def first(self, count: int) -> WarmStart:
        """Some of the receivers, with the bits that they have among all."""
        return self.take(np.arange(min(count, self.receivers)))

    def take(self, rows: NDArray[np.intp]) -> WarmStart:
        """Chosen receivers, some of them more than once if so wanted; nothing is copied yet."""
        part = copy.copy(self)
        part.receivers, part._rows = len(rows), self._rows[rows]
        part.warmup_alarm = self.warmup_alarm[rows]
        return part

    def engine(self) -> Engine:
        """All receivers at the onset."""
        return self.extract(self._engine, self._rows)

    def extract(self, engine: Engine, rows: NDArray[np.intp]) -> Engine:
        part = self._make(len(rows), self.setup)
        part.take_over(engine, rows)
        return part


class PanelDetectors(PassiveDetectors):
    """Detectors that share a pass of the engine, by numbers that stay theirs in smaller panels.
    `memory`: ``alarmed`` and ``blamed`` channels (B, D) of the last epoch, ``so_far`` of the
    episode."""

    def __init__(self, detectors: Sequence[Detector], numbers: Sequence[int] | None = None) -> None:
        super().__init__(detectors)
        self.numbers = list(range(len(detectors)) if numbers is None else numbers)

    def bind(self, simulator: Monitored) -> None:
        super().bind(simulator)
        shape = self.memory["alarmed"].shape
        self.memory.declare("so_far", np.zeros(shape, dtype=np.bool_))
        self.memory.declare("blamed", np.zeros(shape, dtype=np.int64))

    def update(self, simulator: Monitored) -> None:
        alarmed, ratio, blamed = (self.memory[name] for name in ("alarmed", "ratio", "blamed"))
        for k, detector in enumerate(self.detectors):
            verdict = judge_epoch(detector, simulator.epoch)
            blamed[:, k] = verdict.alarm.sum(axis=1)
            ratio[:, k] = (verdict.statistic / verdict.threshold).max(axis=1)
        alarmed[:] = blamed > 0
        self.memory["so_far"] |= alarmed

    def copy_rows(self, to: NDArray[np.intp], other: Self, rows: NDArray[np.intp]) -> None:
        """Take over receivers of a panel that has these detectors among others."""
        place = [other.numbers.index(k) for k in self.numbers]
        for name, array in self.memory.items():
            array[to] = other.memory[name][rows][:, place]
        for detector, k in zip(self.detectors, place, strict=True):
            detector.memory.copy_rows(to, other.detectors[k].memory, rows)


class ProtectionLevels(Monitor):
    """Protection levels of detectors, which have judged an epoch before this looks at it. `levels`:
    for each detector (B,) of every epoch so far, nothing for one that has none."""

    def __init__(self, detectors: Sequence[Detector]) -> None:
        self._judges = detectors
        self.levels: list[list[FloatArray]] = [[] for _ in detectors]

    @classmethod
    def attach(cls, simulator: Simulator) -> Self:
        """Protection levels from now on; at no cost where no detector has one."""
        panel = _find_panel(simulator)
        found = cls([simulator.detector] if panel is None else panel.detectors)
        if any(has_protection_level(each) for each in found._judges):
            found.bind(simulator)
            simulator.monitors.append(found)
        return found

    def bind(self, simulator: Monitored) -> None:
        self.memory = Memory(simulator.receivers)

    def update(self, simulator: Monitored) -> None:
        for judge, levels in zip(self._judges, self.levels, strict=True):
            found = judge.protection_level(simulator.epoch)
            if found is not None:
                levels.append(found)


def _find_panel(simulator: Simulator) -> PanelDetectors | None:
    return next((each for each in simulator.monitors if isinstance(each, PanelDetectors)), None)


def _verdicts(simulator: Simulator) -> tuple[FloatArray, NDArray[np.int64]]:
    """Largest ratios and blamed channels (B, D) at the last epoch, of the panel where there is one,
    else of the detector in the loop."""
    panel = _find_panel(simulator)
    if panel is not None:
        return panel.memory["ratio"], panel.memory["blamed"]
    assert simulator.verdict is not None  # an epoch has been judged
    return simulator.ratio()[:, None], simulator.verdict.alarm.sum(axis=1)[:, None]


def play(
    start: WarmStart,
    spec: Any,
    *,
    drop_alarmed: bool = False,
    tick: Callable[[float], None] | None = None,
) -> Runs:
    """Let a spoofer attack all runs, from the onset to the end of the hold."""
    return play_side_by_side(start, [spec], drop_alarmed=drop_alarmed, tick=tick)[0]


def play_side_by_side(
    start: WarmStart,
    specs: Sequence[Any],
    which: NDArray[np.intp] | None = None,
    *,
    drop_alarmed: bool = False,
    tick: Callable[[float], None] | None = None,
) -> list[Runs]:
    """What each detector of a panel, or the one in the loop, makes of attacks on all runs. `specs`,
    `which`: as of an `SpooferController`; `drop_alarmed`: whether runs in which all of them have
    alarmed are left, after which nothing is known of them."""
    setup, everyone = start.setup, start.receivers
    attacker = SpooferController(specs, start.engine(), which)
    simulator = attacker.engine.simulator
    panel = _find_panel(simulator)
    epochs, count = setup.steps + setup.hold, 1 if panel is None else len(panel.detectors)
    alarm = np.zeros((count, epochs, everyone), dtype=np.bool_)
    peak, total = np.zeros((count, everyone)), np.zeros((count, everyone), dtype=np.int64)
    coasting = np.zeros((epochs, everyone), dtype=np.bool_)
    rows = np.arange(everyone)
    position = np.full((epochs, *simulator.position.shape), np.nan)
    clean = simulator.clean is not None and not drop_alarmed
    levels = ProtectionLevels.attach(simulator).levels if clean else [[] for _ in range(count)]
    onset, heading = simulator.onset.copy(), simulator.heading.copy()
    for k in range(epochs):
        attacker.engine.step(attacker.command(k))
        simulator = attacker.engine.simulator
        position[k, rows], coasting[k, rows] = simulator.position, simulator.coasting
        ratio, blamed = _verdicts(simulator)
        alarm[:, k, rows] = blamed.T > 0
        total[:, rows] += blamed.T
        peak[:, rows] = np.maximum(peak[:, rows], ratio.T)
        if tick is not None:
            tick(1.0 / epochs)
        if drop_alarmed and (k + 1) % DROP_EVERY == 0:
            open_ = ~alarm[:, : k + 1, rows].any(axis=1).all(axis=0)
            if not open_.any():
                if tick is not None:
                    tick((epochs - k - 1) / epochs)
                break
            open_rows = keep_company(np.flatnonzero(open_), np.flatnonzero(~open_))
            if len(open_rows) <= (1.0 - DROP_PART) * len(rows):
                attacker.go_on_with(start.extract(attacker.engine, open_rows), open_rows)
                rows = rows[open_rows]
    return [
        Runs(
            *(position, alarm[d], peak[d], onset, heading, coasting, total[d]),
            np.array(levels[d]) if levels[d] else None,
        )
        for d in range(count)
    ]


def list_attack_epochs(setup: Setup, onset: NDArray[np.int64]) -> NDArray[np.int64]:
    """Epochs of `Setup.epoch_time` at which runs are after their onset. `onset` (R,) of `Runs`;
    returns (K, R), from the first epoch under attack to the end of the hold."""
    epochs: NDArray[np.int64] = onset + 1 + np.arange(setup.steps + setup.hold)[:, None]
    return epochs


def to_local(vector: FloatArray, frames: FloatArray) -> FloatArray:
    """Vectors of every epoch in its local axes. `vector` (K, R, d); `frames` (K, R, d, d) to its
    axes from local axes; returns (K, R, d) north, east (and down)."""
    # sums written out: the bits of a matrix product depend on the number of runs
    parts = [vector[:, :, i, None] * frames[:, :, i, :] for i in range(vector.shape[2])]
    return np.asarray(functools.reduce(np.add, parts))


def compute_induced_offset(setup: Setup, attacked: Runs, twin: Runs) -> FloatArray:
    """The attacked solution less its clean twin: (K, R, d) north, east (and down) [m]."""
    apart = attacked.position - twin.position
    return to_local(apart, setup.C_en[list_attack_epochs(setup, twin.onset)])


def off_truth(setup: Setup, runs: Runs) -> FloatArray:
    """The solution less the truth: (K, R, d) north, east (and down) [m]."""
    epochs = list_attack_epochs(setup, runs.onset)
    return to_local(runs.position - setup.true_position[epochs], setup.C_en[epochs])


def horizontal(local: FloatArray) -> FloatArray:
    """Length of the horizontal part of vectors (K, R, d): (K, R) [m]."""
    return np.hypot(local[..., 0], local[..., 1])


def induced_error(setup: Setup, attacked: Runs, twin: Runs) -> FloatArray:
    """Horizontal distance of the attacked solution from its clean twin: (K, R) [m]."""
    return horizontal(compute_induced_offset(setup, attacked, twin))
