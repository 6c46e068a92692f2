"""One spoofer on many runs."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...envs.observer import Observer
from ...envs.spoofer_binding import bound_spoofer, paced
from ...envs.terms.action import CommandMap, Decisions
from ...simulation.engine import Engine
from ...simulation.setup import Setup
from ...simulation.simulator import Simulator
from ...spoofers import Spoofer
from ..scores.scores import undetected_displacement
from .players import build_spoofer


def make_bound_spoofer(
    spec: Any, setup: Setup, receivers: int
) -> tuple[Spoofer, Observer, CommandMap]:
    """Spoofer that is ready for a batch, what it observes, and what its actions command."""
    spoofer = build_spoofer(spec)
    context, observer, commands = bound_spoofer(spoofer, setup, receivers)
    spoofer.bind(context)
    spoofer.reset()
    return spoofer, observer, commands


class Attacker:
    """Spoofer that commands all receivers of an engine, which are at their onset.

    - `engine`: its simulator leaves all measurements alone where the spoofer transmits nothing;
    - `spoofer`: bound; it decides at its own pace.
    """

    def __init__(self, spec: Any, engine: Engine) -> None:
        self._spec, self.engine = spec, engine
        made = make_bound_spoofer(spec, engine.setup, engine.receivers)
        self.spoofer, self._observer, self._commands = made
        setup, size = paced(engine.setup, self.spoofer), len(self._commands.names)
        self._decisions = Decisions(setup, engine.receivers, size)
        self._commands.aim(engine.simulator.heading)
        if not self.spoofer.transmits:
            engine.simulator.clean = np.ones(engine.receivers, dtype=np.bool_)

    def command(self, epoch: int) -> FloatArray | None:
        """Command (B, a) of an epoch, counted from the onset on; None after the last one."""
        if epoch >= self.engine.setup.steps:
            return None
        return self._commands.command(self.action(epoch), self.engine.simulator.commanded_rate)

    def action(self, epoch: int) -> FloatArray:
        """Action (B, k) of an epoch, on the way from one decision to the next. Asks the spoofer
        where a decision is due."""
        if self._decisions.due(epoch):
            self._decisions.take(self.decide(epoch))
        return self._decisions.action(epoch)

    def decide(self, epoch: int) -> FloatArray:
        """Action of the spoofer, checked: (B, k) float64, C-contiguous."""
        receivers, word = self.engine.receivers, type(self.spoofer).__name__
        seen = self._observer(self.engine, epoch)
        action = np.ascontiguousarray(self.spoofer.act(seen), dtype=np.float64)
        names = self.spoofer.context.action_names
        if action.shape != (receivers, len(names)):
            raise ValueError(
                f"{word} must return actions of shape {(receivers, len(names))} "
                f"({', '.join(names)}), got {action.shape}"
            )
        if not (np.abs(action) <= 1.0).all():
            worst = action.flat[int(np.argmin(np.abs(action) <= 1.0))]
            raise ValueError(f"{word} must return actions within [-1, 1], got {worst}")
        return action

    def go_on_with(self, engine: Engine, rows: NDArray[np.intp]) -> None:
        """Command an engine of some of the receivers from now on."""
        spoofer, _, self._commands = make_bound_spoofer(self._spec, engine.setup, len(rows))
        self._commands.aim(engine.simulator.heading)
        spoofer.memory.copy_rows(np.arange(len(rows)), self.spoofer.memory, rows)
        self.engine, self.spoofer = engine, spoofer
        self._decisions = self._decisions.of(rows)


FloatArray = NDArray[np.float64]
Watch = Callable[[int, NDArray[np.intp], Simulator], NDArray[np.bool_]]
"""Is given an epoch, from 0 on, which runs play it, and their receivers; returns (b,) bool."""
DROP_EVERY, DROP_PART = 10, 0.25
"""How often, in epochs, settled runs are dropped, and from which part of all on."""


class Runs(NamedTuple):
    """What happened in the K epochs from the onset of the attack to the end of the hold.

    - `position` (K, R, d) estimated after each epoch, in the axes of `Setup.true_position` [m]; NaN
      once a run has been dropped;
    - `alarm` (K, R) bool, whether any channel alarmed;
    - `peak` (R,) largest ratio of a statistic to its threshold;
    - `onset` (R,) epoch of `Setup.epoch_time` after which the attack began;
    - `heading` (R,) direction of the target, clockwise from north [rad];
    - `coasting` (K, R) bool, whether the epoch had no update for want of measurements;
    - `blamed` (R,) channels that were blamed, summed over the epochs.
    """

    position: FloatArray
    alarm: NDArray[np.bool_]
    peak: FloatArray
    onset: NDArray[np.int64]
    heading: FloatArray
    coasting: NDArray[np.bool_]
    blamed: NDArray[np.int64]

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
        )

    @property
    def first_alarm(self) -> NDArray[np.int64]:
        """(R,) epoch of the first alarm, from 1 on; 0 where there is none."""
        first = self.alarm.argmax(axis=0) + 1
        return np.where(self.alarm.any(axis=0), first, 0)


class WarmStart:
    """Receivers at the onset of the attack, after one warm-up that all spoofers start from. The
    warm-up is clean, so that it is the same for every spoofer: a run from here has the same bits as
    one with a warm-up of its own. `setup`: world, victim, attack, detector and timeline;
    `warmup_alarm` (R,) bool, false alarms before the attack."""

    def __init__(
        self, setup: Setup, rngs: Sequence[np.random.Generator], *, threads: int | None = None
    ) -> None:
        self.setup, self.receivers, self._threads = setup, len(rngs), threads
        self._engine = Engine(len(rngs), setup, threads=threads)
        self._engine.reset(rngs)
        self.warmup_alarm = self._engine.warmup_alarm.copy()

    @property
    def simulator(self) -> Simulator:
        """The receivers at the onset, which nobody may change."""
        return self._engine.simulator

    def under(self, setup: Setup) -> WarmStart:
        """The same receivers, whose runs have other monitors."""
        part = copy.copy(self)
        part.setup = setup
        return part

    def first(self, count: int) -> WarmStart:
        """Some of the receivers, with the bits that they have among all."""
        return self.take(np.arange(min(count, self.receivers)))

    def take(self, rows: NDArray[np.intp]) -> WarmStart:
        """Chosen receivers, some of them more than once if so wanted."""
        part = copy.copy(self)
        part.receivers = len(rows)
        part._engine = self.extract(self._engine, rows)
        part.warmup_alarm = self.warmup_alarm[rows]
        return part

    def engine(self) -> Engine:
        """All receivers at the onset."""
        return self.extract(self._engine, np.arange(self.receivers))

    def extract(self, engine: Engine, rows: NDArray[np.intp]) -> Engine:
        part = Engine(len(rows), self.setup, threads=self._threads)
        part.simulator.copy_rows(np.arange(len(rows)), engine.simulator, rows)
        if engine.simulator.clean is not None:
            part.simulator.clean = engine.simulator.clean[rows]
        return part


def play(
    start: WarmStart,
    spec: Any,
    *,
    drop_alarmed: bool = False,
    tick: Callable[[float], None] | None = None,
    watch: Watch | None = None,
) -> Runs:
    """Let a spoofer attack all runs, from the onset to the end of the hold. `watch` looks at every
    epoch, and says which runs count as alarmed in place of the detector."""
    setup = start.setup
    epochs, everyone = setup.steps + setup.hold, start.receivers
    alarm = np.zeros((epochs, everyone), dtype=np.bool_)
    coasting, blamed = np.zeros_like(alarm), np.zeros(everyone, dtype=np.int64)
    peak = np.zeros(everyone)
    rows = np.arange(everyone)
    attacker = Attacker(spec, start.engine())
    position = np.full((epochs, *attacker.engine.simulator.position.shape), np.nan)
    onset = attacker.engine.simulator.onset.copy()
    heading = attacker.engine.simulator.heading.copy()
    for k in range(epochs):
        verdict = attacker.engine.step(attacker.command(k))
        simulator = attacker.engine.simulator
        position[k, rows], coasting[k, rows] = simulator.position, simulator.coasting
        alarm[k, rows] = verdict.alarm.any(axis=1) if watch is None else watch(k, rows, simulator)
        blamed[rows] += verdict.alarm.sum(axis=1)
        peak[rows] = np.maximum(peak[rows], simulator.ratio())
        if tick is not None:
            tick(1.0 / epochs)
        if drop_alarmed and (k + 1) % DROP_EVERY == 0:
            open_ = ~alarm[: k + 1, rows].any(axis=0)
            if not open_.any():
                if tick is not None:
                    tick((epochs - k - 1) / epochs)
                break
            if open_.mean() <= 1.0 - DROP_PART:
                kept = np.flatnonzero(open_)
                attacker.go_on_with(start.extract(attacker.engine, kept), kept)
                rows = rows[kept]
    return Runs(position, alarm, peak, onset, heading, coasting, blamed)


def epochs_of(setup: Setup, onset: NDArray[np.int64]) -> NDArray[np.int64]:
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


def induced(setup: Setup, attacked: Runs, twin: Runs) -> FloatArray:
    """The attacked solution less its clean twin: (K, R, d) north, east (and down) [m]."""
    apart = attacked.position - twin.position
    return to_local(apart, setup.C_en[epochs_of(setup, twin.onset)])


def off_truth(setup: Setup, runs: Runs) -> FloatArray:
    """The solution less the truth: (K, R, d) north, east (and down) [m]."""
    epochs = epochs_of(setup, runs.onset)
    return to_local(runs.position - setup.true_position[epochs], setup.C_en[epochs])


def horizontal(local: FloatArray) -> FloatArray:
    """Length of the horizontal part of vectors (K, R, d): (K, R) [m]."""
    return np.hypot(local[..., 0], local[..., 1])


def induced_error(setup: Setup, attacked: Runs, twin: Runs) -> FloatArray:
    """Horizontal distance of the attacked solution from its clean twin: (K, R) [m]."""
    return horizontal(induced(setup, attacked, twin))


def displacement_of(setup: Setup, attacked: Runs, twin: Runs) -> FloatArray:
    """Undetected displacement of every run: (R,) [m]."""
    error = induced_error(setup, attacked, twin)[: setup.steps]
    return undetected_displacement(error, attacked.first_alarm, setup.hold)
