"""One cell of a campaign: a detector, a spoofer, and all runs side by side."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..envs.engine import Engine
from ..envs.observer import Observer
from ..envs.setup import Setup
from ..envs.snapshot import Snapshot
from ..spoofers import Spoofer
from .metrics import undetected_displacement
from .suite import make_bound_spoofer

FloatArray = NDArray[np.float64]
DROP_EVERY, DROP_PART = 10, 0.25
"""How often, in epochs, settled runs are dropped, and from which part of all on."""


class Runs(NamedTuple):
    """What happened in the K epochs from the onset of the attack to the end of the hold.

    - `position_e` (K, R, 3) estimated antenna after each epoch, ECEF [m]; NaN once a run has been
      dropped;
    - `alarm` (K, R) bool, whether any channel alarmed;
    - `peak` (R,) largest ratio of a statistic to its threshold;
    - `onset` (R,) epoch of the world after which the attack began.
    """

    position_e: FloatArray
    alarm: NDArray[np.bool_]
    peak: FloatArray
    onset: NDArray[np.int64]

    def first(self, count: int) -> Runs:
        """Some of the runs."""
        return Runs(
            self.position_e[:, :count],
            self.alarm[:, :count],
            self.peak[:count],
            self.onset[:count],
        )

    def take(self, rows: NDArray[np.intp]) -> Runs:
        """Chosen runs, some of them more than once if so wanted."""
        return Runs(
            self.position_e[:, rows], self.alarm[:, rows], self.peak[rows], self.onset[rows]
        )

    @property
    def first_alarm(self) -> NDArray[np.int64]:
        """(R,) epoch of the first alarm, from 1 on; 0 where there is none."""
        first = self.alarm.argmax(axis=0) + 1
        return np.where(self.alarm.any(axis=0), first, 0)


class WarmStart:
    """Receivers at the onset of the attack, after one warm-up that all spoofers begin from.

    The warm-up is clean, so that it is the same for every spoofer: a run from here has the same
    bits as one with a warm-up of its own.

    `setup`: world, victim, attack, detector and timeline; `warmup_alarm` (R,) bool, false alarms
    before the attack.
    """

    def __init__(
        self, setup: Setup, rngs: Sequence[np.random.Generator], *, threads: int | None = None
    ) -> None:
        self.setup, self.receivers, self._threads = setup, len(rngs), threads
        self._engine = Engine(len(rngs), setup, threads=threads)
        self._engine.reset(rngs)
        self.warmup_alarm = self._engine.warmup_alarm.copy()

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
        """Some receivers of an engine as they are."""
        part = Engine(len(rows), self.setup, threads=self._threads)
        part.batch.copy_rows(np.arange(len(rows)), engine.batch, rows)
        if engine.batch.clean is not None:
            part.batch.clean = engine.batch.clean[rows]
        part.warmup_alarm = engine.warmup_alarm[rows]
        return part


def play(
    start: WarmStart,
    spec: Any,
    *,
    drop_alarmed: bool = False,
    tick: Callable[[float], None] | None = None,
) -> Runs:
    """Let a spoofer attack all runs, from the onset to the end of the hold."""
    setup = start.setup
    epochs, everyone = setup.steps + setup.hold, start.receivers
    position_e = np.full((epochs, everyone, 3), np.nan)
    alarm = np.zeros((epochs, everyone), dtype=np.bool_)
    peak = np.zeros(everyone)
    rows = np.arange(everyone)
    engine = start.engine()
    onset = engine.batch.onset.copy()
    spoofer, observer = make_bound_spoofer(spec, setup, everyone)
    if not spoofer.transmits:
        engine.batch.clean = np.ones(everyone, dtype=np.bool_)
    before = given = np.zeros((everyone, len(setup.attack.action_names(setup.world))))
    for k in range(epochs):
        if k < setup.steps and k % setup.repeat == 0:
            before, given = given, command(spoofer, observer, engine, k)
        now = setup.command(before, given, k % setup.repeat) if k < setup.steps else None
        verdict = engine.step(now)
        position_e[k, rows] = engine.batch.buffers.state.position_e
        alarm[k, rows] = verdict.alarm.any(axis=1)
        ratio = (verdict.statistic / verdict.threshold).max(axis=1)
        peak[rows] = np.maximum(peak[rows], ratio)
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
                engine = start.extract(engine, kept)
                fewer, _ = make_bound_spoofer(spec, setup, len(kept))
                fewer.memory.copy_rows(np.arange(len(kept)), spoofer.memory, kept)
                spoofer, rows = fewer, rows[kept]
                before, given = before[kept], given[kept]
    return Runs(position_e, alarm, peak, onset)


def command(spoofer: Spoofer, observer: Observer, engine: Engine, step: int) -> NDArray[np.float64]:
    """Action of a spoofer, checked: (B, a) float64, C-contiguous."""
    steps = np.full(engine.receivers, step, dtype=np.int64)
    seen = observer.observe(Snapshot(engine.setup, engine.batch, steps))
    action = np.ascontiguousarray(spoofer.act(seen), dtype=np.float64)
    names = spoofer.context.action_names
    if action.shape != (engine.receivers, len(names)):
        raise ValueError(
            f"{type(spoofer).__name__} must return actions of shape "
            f"{(engine.receivers, len(names))} ({', '.join(names)}), got {action.shape}"
        )
    if not (np.abs(action) <= 1.0).all():
        worst = action.flat[int(np.argmin(np.abs(action) <= 1.0))]
        raise ValueError(
            f"{type(spoofer).__name__} must return actions within [-1, 1], got {worst}"
        )
    return action


def epochs_of(setup: Setup, onset: NDArray[np.int64]) -> NDArray[np.int64]:
    """Epochs of the world at which runs are after their onset.

    `onset` (R,) of `Runs`; returns (K, R), from the first epoch under attack to the end of the
    hold.
    """
    epochs: NDArray[np.int64] = onset + 1 + np.arange(setup.steps + setup.hold)[:, None]
    return epochs


def to_local(vector_e: FloatArray, frames: FloatArray) -> FloatArray:
    """Vectors of every epoch in its local axes.

    `vector_e` (K, R, 3) ECEF axes; `frames` (K, R, 3, 3) to ECEF from local axes; returns (K, R, 3)
    north, east, down.
    """
    # sums written out: the bits of a matrix product depend on the number of runs
    parts = [vector_e[:, :, i, None] * frames[:, :, i, :] for i in range(3)]
    return np.asarray(parts[0] + parts[1] + parts[2])


def induced_error(setup: Setup, attacked: Runs, twin: Runs) -> FloatArray:
    """Horizontal distance of the attacked solution from its clean twin: (K, R) [m]."""
    frames = setup.world.C_en[epochs_of(setup, twin.onset)]
    apart = to_local(attacked.position_e - twin.position_e, frames)
    return np.hypot(apart[..., 0], apart[..., 1])


def navigation_error(setup: Setup, runs: Runs) -> FloatArray:
    """Horizontal distance of the solution from the truth: (K, R) [m]."""
    epochs = epochs_of(setup, runs.onset)
    apart = to_local(runs.position_e - setup.world.position_e[epochs], setup.world.C_en[epochs])
    return np.hypot(apart[..., 0], apart[..., 1])


def displacement_of(setup: Setup, attacked: Runs, twin: Runs) -> FloatArray:
    """Undetected displacement of every run: (R,) [m]."""
    error = induced_error(setup, attacked, twin)[: setup.steps]
    return undetected_displacement(error, attacked.first_alarm, setup.hold)
