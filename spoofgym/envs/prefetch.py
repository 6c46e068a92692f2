"""The next episode of every receiver, warmed up in the background while the present one runs.

The warm-up is clean, and its noise depends on the seed and the number of the episode alone.  So it
can be run at any time before the episode begins, with the same bits.  Between two epochs under
attack a learner computes in Python or in one thread; a second processor does this meanwhile.

Which receivers are warmed up together depends on timing.  So the bits are the same only if those of
the detector do not depend on the size of the batch, as `spoofgym.testing.check_detector` checks.
"""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .link import Link, StoppedError

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
        self._link = Link()

    @contextmanager
    def kept_waiting(self) -> Iterator[None]:
        """Leave the processors to the present episodes meanwhile."""
        free = self._linked().free
        try:
            free.clear()
            yield
        finally:
            free.set()

    def _linked(self) -> Link:
        """Link of this process, anew after a fork."""
        if self._link.process != os.getpid():
            self._link = Link()
        return self._link

    def _here(self) -> Link:
        """Have a thread in this process."""
        link = self._linked()
        link.start(_serve, weakref.ref(self), link)
        return link

    def close(self) -> None:
        """End the thread, within a warm-up too; it is started again when it is needed."""
        link = self._linked()
        link.stop()
        link.join()
        self._link = Link()

    def __del__(self) -> None:
        """End the thread with its owner."""
        if hasattr(self, "_link"):
            self._link.stop()

    def __getstate__(self) -> dict[str, Any]:
        """State without the thread, after it has done what it was asked for."""
        self._wait(lambda: not self._asked)
        return {name: value for name, value in self.__dict__.items() if name != "_link"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the state; a thread is started when it is needed."""
        self.__dict__.update(state)
        self._link = Link()

    def _wait(self, until: Callable[[], bool]) -> None:
        """Have the thread work on until something holds; or raise, once, what it failed with."""
        if until():
            return
        link = self._here()
        with link.change:
            link.urgent = True
            try:
                if link.failure is None:
                    link.wake.put(True)
                link.change.wait_for(lambda: link.failure is not None or until())
            finally:
                link.urgent = False
            if until():
                return
            failure, link.failure = link.failure, None
        if failure is not None:
            raise failure

    def prepare(self, rows: NDArray[np.intp], rngs: Sequence[np.random.Generator]) -> None:
        """Ask for the next episodes of some receivers.

        Parameters
        ----------
        rows : ndarray
            Which receivers; what waited there is thrown away.
        rngs : sequence of Generator
            One per row; the coming episode of each is taken from it at once.
        """
        link = self._here()
        with link.change:
            for row, rng in zip(rows.tolist(), rngs, strict=True):
                self._ready[row] = False
                self._sources[row], self._episodes[row] = rng, take_episode(rng)
                if row not in self._asked:
                    self._asked.append(row)
        link.wake.put(True)

    def prepared(
        self, rows: NDArray[np.intp], rngs: Sequence[np.random.Generator]
    ) -> NDArray[np.bool_]:
        """Whether the next episodes of these generators have been asked for.

        Parameters
        ----------
        rows : ndarray
            Which receivers.
        rngs : sequence of Generator
            One per row.

        Returns
        -------
        ndarray
            (b,) bool.
        """
        pairs = zip(rows.tolist(), rngs, strict=True)
        return np.array([self._sources[row] is rng for row, rng in pairs], dtype=np.bool_)

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
            What the warm-up raised.  It is tried again when its episodes are taken again.
        """
        link = self._here()
        with link.change:
            # what is waited for comes first
            urgent = [row for row in rows.tolist() if not self._ready[row]]
            self._asked = urgent + [row for row in self._asked if row not in urgent]
        self._wait(lambda: bool(self._ready[rows].all()))
        with link.change:
            into.copy_rows(rows, self._waiting, rows)
            for row in rows.tolist():
                self._sources[row] = None
            return self._alarm[rows]

    def serve(self, link: Link) -> None:
        """Do what has been asked for, as long as it is worth a piece of work.

        Parameters
        ----------
        link : Link
            Of the thread that calls this.
        """
        try:
            while self._piece(link):
                pass
        except StoppedError:
            return
        except BaseException as error:  # handed to who waits
            with link.change:
                link.failure = error
                link.change.notify_all()

    def _piece(self, link: Link) -> bool:
        """Warm up some receivers; False if there is nothing to do."""
        least = min(LEAST_AT_ONCE, self._waiting.receivers)
        with link.change:
            if link.stopped or len(self._asked) < (1 if link.urgent else least):
                return False
            rows = self._asked[:MOST_AT_ONCE]
            episodes = [self._episodes[row] for row in rows]
        batch, alarm = self._warm_up(
            [copy_of(rng) for rng in episodes if rng is not None], link.pause
        )
        with link.change:
            if link.stopped:
                return False
            # what has been asked for anew meanwhile is another episode
            still = [i for i, row in enumerate(rows) if self._episodes[row] is episodes[i]]
            to = np.array([rows[i] for i in still], dtype=np.intp)
            self._waiting.copy_rows(to, batch, np.array(still, dtype=np.intp))
            self._alarm[to], self._ready[to] = alarm[still], True
            done = set(to.tolist())
            self._asked = [row for row in self._asked if row not in done]
            link.change.notify_all()
        return True


def _serve(owner: weakref.ref[NextEpisodes], link: Link) -> None:
    while link.wake.get():
        episodes = owner()
        if episodes is None:
            return
        episodes.serve(link)
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
