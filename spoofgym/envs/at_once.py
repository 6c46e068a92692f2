"""One epoch of the usual game in one kernel: the fast twin of what `Game` does piece by piece.

A step of a single receiver takes less time than handing its arrays to a few small kernels.  So,
where no term, listener or later epoch comes between the verdict and the observation, `play` does
all of it in one call; the pieces are the same compiled functions, and `tests/envs/test_tally.py`
compares both ways bit by bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..detectors import Verdict
from ._kernels import play
from .books import Books
from .engine import Engine
from .observer import Observer
from .tally import Tally

FloatArray = NDArray[np.float64]


def rules_of(
    engine: Engine, books: Books, observer: Observer, at_alarm: bool, shares: FloatArray
) -> FloatArray:
    """What does not change while a game is played, in one array.

    `shares` (r, 4) of `shares_of`; returns (11 + 4 r + 13 K,): slots, whether there are twins,
    whether the worst direction counts, whether an alarm ends an episode, epochs of the command
    phase and of the time to alert, `first` and `scales` of `look`; then `shares`; then positions,
    local axes and times of all epochs.
    """
    world = engine.setup.world
    numbers = (
        world.channels,
        engine.twin is not None,
        engine.setup.target_heading_deg == "worst",
        at_alarm,
        books.steps,
        books.hold,
        observer.command_column,
        *observer.command_scales,
    )
    truth = (world.position_e.ravel(), world.C_en.ravel(), world.epoch_time)
    return np.concatenate([np.array(numbers, dtype=np.float64), shares.ravel(), *truth])


class AtOnce:
    """The epoch of a verdict in one kernel.  `books`: what counts of their episodes."""

    def __init__(self, engine: Engine, books: Books, observer: Observer, rules: FloatArray) -> None:
        batch, twin = engine.batch, engine.twin
        self._attack = batch.attack
        self._begun = np.zeros(5 * engine.receivers)
        self._fixed = (
            batch.buffers.floats,
            batch.buffers.flags,
            batch.buffers.floats if twin is None else twin.buffers.floats,
            batch.sensors.epoch,
            books.raw,
            rules,
            observer.table,
            self._begun,
        )

    def begin(self, engine: Engine, origin: FloatArray) -> None:
        """Take what new episodes begin with.

        `origin` (B, 2) north and east difference at the onset, which does not count [m].
        """
        batch = engine.batch
        parts = (batch.onset, batch.heading, origin.ravel(), engine.warmup_alarm)
        np.concatenate(parts, out=self._begun, casting="unsafe")

    def __call__(self, verdict: Verdict, tally: Tally, seen: NDArray[np.float32]) -> bool:
        """Count and tell the epoch, and observe what `look` knows how to.

        `seen` (B o,), written.
        """
        memory = self._attack.memory
        held: bool = play(
            *self._fixed,
            np.ascontiguousarray(verdict.alarm),
            memory["displacement"],
            memory["rate"],
            tally.numbers,
            tally.flags,
            seen,
        )
        return held
