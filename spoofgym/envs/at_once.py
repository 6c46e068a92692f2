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
from ..sim.world import World
from ._kernels import play
from .books import Books
from .engine import Engine
from .observer import Observer
from .tally import Tally

FloatArray = NDArray[np.float64]


def truth_of(world: World) -> FloatArray:
    """What displacements are told by, in one array.

    Parameters
    ----------
    world : World
        Of K epochs.

    Returns
    -------
    ndarray
        (13 K,) positions, local axes and times, one after the other.
    """
    return np.concatenate([world.position_e.ravel(), world.C_en.ravel(), world.epoch_time])


class AtOnce:
    """The epoch of a verdict in one kernel.

    Parameters
    ----------
    engine : Engine
        The receivers.
    books : Books
        What counts of their episodes.
    observer : Observer
        What is observed.
    origin : ndarray
        (B, 2) north and east difference at the onset, which does not count [m].
    at_alarm : bool
        Whether an alarm ends an episode.
    shares : ndarray
        (r, 4) of `shares_of`.
    """

    def __init__(
        self,
        engine: Engine,
        books: Books,
        observer: Observer,
        origin: FloatArray,
        at_alarm: bool,
        shares: FloatArray,
    ) -> None:
        setup, batch, twin = engine.setup, engine.batch, engine.twin
        rules = (
            setup.world.channels,
            twin is not None,
            setup.target_heading_deg == "worst",
            at_alarm,
            books.steps,
            books.hold,
            observer.command_column,
        )
        self._engine, self._batch = engine, batch
        self._fixed = (
            batch.buffers.floats,
            batch.buffers.flags,
            batch.buffers.floats if twin is None else twin.buffers.floats,
            truth_of(setup.world),
            origin,
            books.step_count,
            books.flags,
            books.amounts,
            np.array(rules, dtype=np.int64),
            np.concatenate([observer.command_scales, shares.ravel()]),
            observer.table,
            batch.sensors.epoch,
        )

    def __call__(self, verdict: Verdict, tally: Tally, seen: NDArray[np.float32]) -> bool:
        """Count and tell the epoch, and observe what the kernel knows how to.

        Parameters
        ----------
        verdict : Verdict
            Of the epoch, whose update is over.
        tally : Tally
            Written.
        seen : ndarray
            (B, o), written.

        Returns
        -------
        bool
            Whether somebody has to run the time to alert first: nothing is told or observed then.
        """
        batch = self._batch
        circumstances, attack = batch.memory, batch.attack.memory
        held: bool = play(
            *self._fixed,
            circumstances["onset"],
            circumstances["heading"],
            self._engine.warmup_alarm,
            np.ascontiguousarray(verdict.alarm),
            attack["displacement"],
            attack["rate"],
            tally.values,
            tally.marks,
            seen,
        )
        return held
