"""The next episode of every receiver, warmed up in the background while the present one runs.

The warm-up is clean, and its noise depends on the seed and the number of the episode alone.  So it
can be run at any time before the episode begins, with the same bits.  Between two epochs under
attack a learner computes in Python or in one thread; a second processor does this meanwhile.
"""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .engine import Batch

WarmUp = Callable[
    [Sequence[np.random.Generator], Callable[[], Any]], "tuple[Batch, NDArray[np.bool_]]"
]
LEAST_AT_ONCE, MOST_AT_ONCE = 16, 64
"""Receivers of one piece of work: enough to be worth it, unless they are waited for, and not so
many that one waits for the others."""


class NextEpisodes:
    """Receivers that wait at the onset of their next episodes.

    Parameters
    ----------
    waiting : Batch
        Of as many receivers as the engine; written.
    warm_up : callable
        ``warm_up(rngs, between)`` returns a batch at the onset, and (b,) bool, alarms of its
        warm-up; called in another thread.  It calls ``between()`` every millisecond or so, which
        waits as long as the processors are needed for the present episodes.
    """

    def __init__(
        self,
        waiting: Batch,
        warm_up: WarmUp,
    ) -> None:
        self._waiting, self._warm_up = waiting, warm_up
        receivers = waiting.receivers
        self._alarm = np.zeros(receivers, dtype=np.bool_)
        self._ready = np.zeros(receivers, dtype=np.bool_)
        self._sources: list[np.random.Generator | None] = [None] * receivers
        self._episodes: list[np.random.Generator | None] = [None] * receivers
        self._asked: list[int] = []
        self._no_thread_yet()

    def _no_thread_yet(self) -> None:
        self._owner = 0
        self._wake: SimpleQueue[bool] = SimpleQueue()
        self._change = threading.Condition()
        self._urgent = False
        self._failure: BaseException | None = None
        self._free = threading.Event()
        self._free.set()

    @contextmanager
    def kept_waiting(self) -> Iterator[None]:
        """Leave the processors to the present episodes meanwhile."""
        self._free.clear()
        try:
            yield
        finally:
            self._free.set()

    def _here(self) -> None:
        """Have a thread in this process, a forked one too, which inherits none."""
        if self._owner == os.getpid():
            return
        if self._owner:  # a lock may be held by a thread that is not here
            self._no_thread_yet()
        self._owner = os.getpid()
        threading.Thread(
            target=_serve, args=(weakref.ref(self), self._wake), name="spoofgym-next", daemon=True
        ).start()

    def close(self) -> None:
        """End the thread; it is started again when it is needed."""
        self._wake.put(False)
        self._no_thread_yet()

    def __del__(self) -> None:
        """End the thread with its owner."""
        if hasattr(self, "_wake"):
            self._wake.put(False)

    def __getstate__(self) -> dict[str, Any]:
        """State without the thread, after it has done what it was asked for."""
        self._wait(lambda: not self._asked)
        left = ("_owner", "_wake", "_change", "_urgent", "_failure", "_free")
        return {name: value for name, value in self.__dict__.items() if name not in left}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the state; a thread is started when it is needed."""
        self.__dict__.update(state)
        self._no_thread_yet()

    def _wait(self, until: Callable[[], bool]) -> None:
        """Have the thread work on, until something holds or it has failed."""
        if until():
            return
        self._here()
        with self._change:
            self._urgent = True
            self._wake.put(True)
            self._change.wait_for(lambda: self._failure is not None or until())
            self._urgent = False
        if self._failure is not None:
            raise self._failure

    def prepare(self, rows: NDArray[np.intp], rngs: Sequence[np.random.Generator]) -> None:
        """Ask for the next episodes of some receivers.

        Parameters
        ----------
        rows : ndarray
            Which receivers; what waited there is thrown away.
        rngs : sequence of Generator
            One per row; the coming episode of each is taken from it at once.
        """
        self._here()
        with self._change:
            for row, rng in zip(rows.tolist(), rngs, strict=True):
                self._sources[row], self._episodes[row] = rng, take_episode(rng)
                self._ready[row] = False
                if row not in self._asked:
                    self._asked.append(row)
        self._wake.put(True)

    def prepared(self, rows: NDArray[np.intp], rngs: Sequence[np.random.Generator]) -> bool:
        """Whether the next episodes of these generators have been asked for.

        Parameters
        ----------
        rows : ndarray
            Which receivers.
        rngs : sequence of Generator
            One per row.

        Returns
        -------
        bool
            True for all of them.
        """
        return all(self._sources[row] is rng for row, rng in zip(rows.tolist(), rngs, strict=True))

    def take(self, rows: NDArray[np.intp], into: Batch) -> NDArray[np.bool_]:
        """Let some receivers begin the episodes that wait for them.

        Parameters
        ----------
        rows : ndarray
            Which receivers, prepared; waited for where they are not ready.
        into : Batch
            Its rows are overwritten.

        Returns
        -------
        ndarray
            (b,) bool, alarms of the warm-ups.

        Raises
        ------
        BaseException
            What the warm-up raised.
        """
        with self._change:
            # what is waited for comes first
            urgent = [row for row in rows.tolist() if not self._ready[row]]
            self._asked = urgent + [row for row in self._asked if row not in urgent]
        self._wait(lambda: bool(self._ready[rows].all()))
        with self._change:
            into.copy_rows(rows, self._waiting, rows)
            for row in rows.tolist():
                self._sources[row] = None
            return self._alarm[rows]

    def serve(self) -> None:
        """Do what has been asked for, as long as it is worth a piece of work."""
        least = min(LEAST_AT_ONCE, self._waiting.receivers)
        while True:
            with self._change:
                if len(self._asked) < (1 if self._urgent else least):
                    return
                rows = self._asked[:MOST_AT_ONCE]
                episodes = [self._episodes[row] for row in rows]
            try:
                batch, alarm = self._warm_up(
                    [copy_of(rng) for rng in episodes if rng is not None], self._free.wait
                )
            except BaseException as error:  # handed to who waits
                with self._change:
                    self._failure = error
                    self._change.notify_all()
                return
            with self._change:
                # what has been asked for anew meanwhile is another episode
                still = [i for i, row in enumerate(rows) if self._episodes[row] is episodes[i]]
                to = np.array([rows[i] for i in still], dtype=np.intp)
                self._waiting.copy_rows(to, batch, np.array(still, dtype=np.intp))
                self._alarm[to], self._ready[to] = alarm[still], True
                done = set(to.tolist())
                self._asked = [row for row in self._asked if row not in done]
                self._change.notify_all()


def _serve(owner: weakref.ref[NextEpisodes], wake: SimpleQueue[bool]) -> None:
    while wake.get():
        episodes = owner()
        if episodes is None:
            return
        episodes.serve()
        del episodes


def take_episode(rng: np.random.Generator) -> np.random.Generator:
    """Generator whose first episode is the coming one of another, which then goes on to the next.

    Parameters
    ----------
    rng : Generator
        Its seed sequence counts episodes.

    Returns
    -------
    Generator
        A new one.
    """
    episode = copy_of(rng)
    rng.bit_generator.seed_seq.spawn(1)  # type: ignore[attr-defined]
    return episode


def copy_of(rng: np.random.Generator) -> np.random.Generator:
    """Generator with the same seed sequence, and as many episodes behind it.

    Parameters
    ----------
    rng : Generator
        Left as it is.

    Returns
    -------
    Generator
        A new one.
    """
    seed: Any = rng.bit_generator.seed_seq
    twin = np.random.SeedSequence(
        seed.entropy,
        spawn_key=seed.spawn_key,
        pool_size=seed.pool_size,
        n_children_spawned=seed.n_children_spawned,
    )
    return np.random.Generator(np.random.PCG64(twin))
