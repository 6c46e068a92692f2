"""The next episodes of every receiver, warmed up in the background while the present one runs.

The warm-up is clean, and its noise depends on the seed and the number of the episode alone.  So it
can be run at any time before the episode starts, with the same bits.  Between two epochs under
attack a learner computes in Python or in one thread; a second processor does this meanwhile.

Episodes without an alarm all end together, and an alarm soon afterwards would have to wait for all
the others.  So every receiver that has come to its second episode keeps `STOCK` of them.

Which receivers are warmed up together depends on timing.  So the bits are the same only if those of
the detector do not depend on the size of the batch, as `spoofgym.testing.check_detector` checks.
"""

from __future__ import annotations

import os
import sys
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _threads
from .base import Rngs, Simulator

WarmUp = Callable[
    [Sequence[np.random.Generator], Callable[[], Any]], "tuple[Simulator, NDArray[np.bool_]]"
]
LEAST_TOGETHER, MOST_TOGETHER = 16, 64
"""Receivers of one piece of work: enough to be worth it, unless they are waited for, and not so
many that one waits for the others."""
STOCK = 2
"""Episodes that wait for every receiver."""
JOIN_S = 5.0
"""How long a thread that has been stopped is waited for.  It ends within a millisecond or so, if no
detector holds it up."""
LOOK_S = 0.1
"""How often a thread that may not compute looks whether it has been stopped."""


class StoppedError(Exception):
    """The thread has been stopped within its work."""


class Background:
    """One thread, and what it shares with its owner; used once, and in one process.

    A forked process inherits no thread, and locks that may be held.  `wake` gets True for new work,
    False for the end; `change` is held by who writes what both use; the thread computes while it is
    `free`, writes nothing any more when `stopped`, and leaves its `failure` until that is raised;
    `urgent` says that the owner waits.
    """

    def __init__(self) -> None:
        self.process = os.getpid()
        self.wake: SimpleQueue[bool] = SimpleQueue()
        self.change = threading.Condition()
        self.free = threading.Event()
        self.free.set()
        self.urgent = self.stopped = False
        self.failure: BaseException | None = None
        self._thread: threading.Thread | None = None

    def start(self, target: Callable[..., None], *args: Any) -> None:
        """Start the thread, unless it has been."""
        if self._thread is None:
            self._thread = _threads.start(partial(target, *args), self.stop, "spoofgym-next")

    def pause(self) -> None:
        """Wait as long as the processors are needed elsewhere; `StoppedError` at the end."""
        # an interrupt of the owner may have left it not free
        while not (self.stopped or self.free.wait(LOOK_S)):
            pass
        if self.stopped:
            raise StoppedError

    def stop(self) -> None:
        """Have the thread end soon; takes no lock, since a collection of garbage may call it."""
        if self.process == os.getpid():
            self.stopped = True
            self.wake.put(False)

    def join(self) -> None:
        """Wait for the thread, which has been stopped."""
        thread = self._thread
        # no thread waits for itself, and none runs on while the interpreter ends
        if thread is None or thread is threading.current_thread() or sys.is_finalizing():
            return
        thread.join(JOIN_S)


class NextEpisodes:
    """Receivers that wait at the onset of their next episodes.

    `waiting` has `STOCK` times the B receivers of the engine, in slots ``row`` and ``row + B`` in
    turn.  ``warm_up(rngs, between)`` returns a batch at the onset, and (b,) bool, alarms of its
    warm-up; called in another thread, it calls ``between()`` every millisecond or so, which waits
    as long as the processors are needed for the present episodes.
    """

    def __init__(self, waiting: Simulator, warm_up: WarmUp) -> None:
        self._waiting, self._warm_up = waiting, warm_up
        slots = waiting.receivers
        self._receivers = slots // STOCK
        self._alarm = np.zeros(slots, dtype=np.bool_)
        self._ready = np.zeros(slots, dtype=np.bool_)
        self._episodes: list[np.random.Generator | None] = [None] * slots
        self._sources: list[np.random.Generator | None] = [None] * self._receivers
        self._taken = np.zeros(self._receivers, dtype=np.int64)
        self._stock = np.zeros(self._receivers, dtype=np.int64)
        self._asked: list[int] = []
        self._background = Background()

    @contextmanager
    def kept_waiting(self) -> Iterator[None]:
        """Leave the processors to the present episodes meanwhile."""
        free = self._own().free
        try:
            free.clear()
            yield
        finally:
            free.set()

    def _own(self) -> Background:
        """Thread of this process; another one after a fork, and when it has been stopped."""
        if self._background.stopped or self._background.process != os.getpid():
            self._background = Background()
        return self._background

    def _started(self) -> Background:
        """The same, running."""
        background = self._own()
        background.start(_serve, weakref.ref(self), background)
        return background

    def close(self) -> None:
        """End the thread, within a warm-up too; it is started again when it is needed."""
        background = self._own()
        background.stop()
        background.join()
        self._background = Background()

    def forget(self) -> None:
        """Throw away all that has been asked for; the generators go on from where they are."""
        self.close()
        self._asked, self._sources = [], [None] * self._receivers

    def __del__(self) -> None:
        """End the thread with its owner."""
        if hasattr(self, "_background"):
            self._background.stop()

    def __getstate__(self) -> dict[str, Any]:
        """State without the thread, after it has done what it was asked for."""
        self._wait(lambda: not self._asked)
        return {name: value for name, value in self.__dict__.items() if name != "_background"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the state; a thread is started when it is needed."""
        self.__dict__.update(state)
        self._background = Background()

    def _wait(self, until: Callable[[], bool]) -> None:
        """Have the thread work on until something holds; or raise, once, what it failed with."""
        if until():
            return
        background = self._started()
        with background.change:
            background.urgent = True
            try:
                if background.failure is None:
                    background.wake.put(True)
                background.change.wait_for(lambda: background.failure is not None or until())
            finally:
                background.urgent = False
            if until():
                return
            failure, background.failure = background.failure, None
        if failure is not None:
            raise failure

    def _slots(self, rows: NDArray[np.intp], ahead: NDArray[np.int64] | int) -> NDArray[np.intp]:
        """Where the episodes lie that some receivers come to after some others."""
        return rows + self._receivers * ((self._taken[rows] + ahead) % STOCK)

    def prepare(self, rows: NDArray[np.intp], rngs: Rngs) -> None:
        """Ask for the next episodes of some receivers, each from its generator.

        One is asked for where that is new, and what waited there is thrown away; else as many as
        are missing.
        """
        background = self._started()
        with background.change:
            known = self.prepared(rows, rngs, least=0)
            self._stock[rows[~known]] = 0
            wanted = np.where(known, STOCK, 1)
            for ahead in range(STOCK):
                lacking = (self._stock[rows] <= ahead) & (ahead < wanted)
                slots = self._slots(rows[lacking], ahead).tolist()
                for i, slot in zip(np.flatnonzero(lacking).tolist(), slots, strict=True):
                    self._ready[slot], self._episodes[slot] = False, take_episode(rngs[i])
                    if slot not in self._asked:
                        self._asked.append(slot)
                    self._sources[int(rows[i])] = rngs[i]
                    self._stock[rows[i]] += 1
        background.wake.put(True)

    def prepared(self, rows: NDArray[np.intp], rngs: Rngs, least: int = 1) -> NDArray[np.bool_]:
        """Whether the next episodes of these generators have been asked for."""
        pairs = zip(rows.tolist(), rngs, strict=True)
        same = np.array([self._sources[row] is rng for row, rng in pairs], dtype=np.bool_)
        return same & (self._stock[rows] >= least)

    def take(self, rows: NDArray[np.intp], into: Simulator) -> NDArray[np.bool_]:
        """Let some receivers start the episodes that wait for them; (b,) alarms of warm-ups."""
        background = self._started()
        slots = self._slots(rows, 0)
        with background.change:
            # what is waited for comes first
            urgent = [slot for slot in slots.tolist() if not self._ready[slot]]
            self._asked = urgent + [slot for slot in self._asked if slot not in urgent]
        self._wait(lambda: bool(self._ready[slots].all()))
        with background.change:
            into.copy_rows(rows, self._waiting, slots)
            self._taken[rows] += 1
            self._stock[rows] -= 1
            return self._alarm[slots]

    def instead(self, rows: NDArray[np.intp], rngs: Rngs) -> list[np.random.Generator]:
        """Give up the next episodes of some receivers, which are to start otherwise."""
        background = self._started()
        with background.change:
            known = self.prepared(rows, rngs)
            slots = self._slots(rows, 0).tolist()
            instead = list(rngs)
            for i in np.flatnonzero(known).tolist():
                waiting = self._episodes[slots[i]]
                if waiting is not None:
                    instead[i] = copy_of(waiting)
                self._asked = [slot for slot in self._asked if slot != slots[i]]
                self._taken[rows[i]] += 1
                self._stock[rows[i]] -= 1
            return instead

    def serve(self, background: Background) -> None:
        """Do what has been asked for, as long as it is worth a piece of work."""
        try:
            while self._piece(background):
                pass
        except StoppedError:
            return
        except BaseException as error:  # handed to who waits
            with background.change:
                background.failure = error
                background.change.notify_all()

    def _piece(self, background: Background) -> bool:
        """Warm up some receivers; False if there is nothing to do."""
        least = min(LEAST_TOGETHER, self._receivers)
        with background.change:
            if background.stopped or background.failure is not None:  # to be raised first
                return False
            if len(self._asked) < (1 if background.urgent else least):
                return False
            slots = self._asked[:MOST_TOGETHER]
            episodes = [self._episodes[slot] for slot in slots]
        batch, alarm = self._warm_up(
            [copy_of(rng) for rng in episodes if rng is not None], background.pause
        )
        with background.change:
            if background.stopped:
                return False
            # what has been asked for again meanwhile is another episode
            still = [i for i, slot in enumerate(slots) if self._episodes[slot] is episodes[i]]
            to = np.array([slots[i] for i in still], dtype=np.intp)
            self._waiting.copy_rows(to, batch, np.array(still, dtype=np.intp))
            self._alarm[to], self._ready[to] = alarm[still], True
            done = set(to.tolist())
            self._asked = [slot for slot in self._asked if slot not in done]
            background.change.notify_all()
        return True


def _serve(owner: weakref.ref[NextEpisodes], background: Background) -> None:
    while background.wake.get() and (episodes := owner()) is not None:
        episodes.serve(background)
        del episodes


def take_episode(rng: np.random.Generator) -> np.random.Generator:
    """Generator whose first episode is the next one of another, which then skips it."""
    episode = copy_of(rng)
    rng.bit_generator.seed_seq.spawn(1)  # type: ignore[attr-defined]
    return episode


def copy_of(rng: np.random.Generator) -> np.random.Generator:
    """Generator with the same seed sequence, and as many episodes behind it."""
    seed: Any = rng.bit_generator.seed_seq
    twin = np.random.SeedSequence(
        seed.entropy,
        spawn_key=seed.spawn_key,
        pool_size=seed.pool_size,
        n_children_spawned=seed.n_children_spawned,
    )
    return np.random.Generator(np.random.PCG64(twin))
