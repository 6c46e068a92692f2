"""The next episodes of every receiver, warmed up in spare time while the present one runs.

The warm-up is clean, and its noise depends on the seed and the number of the episode alone.  So it
can be run at any time before the episode starts, with the same bits.  Between two epochs under
attack a learner computes in Python or in one thread; the engine's other threads do this meanwhile.

Episodes without an alarm all end together, and an alarm soon afterwards would have to wait for all
the others.  So every receiver that has come to its second episode keeps `STOCK` of them.

Which receivers are warmed up together depends on timing.  So the bits are the same only if those of
the detector do not depend on the size of the batch, as `spoofgym.testing.check_detector` checks.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core import threads as _threads
from .simulator import Rngs, Simulator
from .threads import Workers

WarmUp = Callable[[Sequence[np.random.Generator]], Iterator[Simulator]]
LEAST_TOGETHER, MOST_TOGETHER = 16, 64  # receivers of a group: worth it, and none waits long
STOCK = 2  # episodes that wait for every receiver
PIECE = 64  # epochs of single receivers in one piece of a warm-up: some 0.1 ms


class Group:
    """Some receivers on their way to the onset, in pieces that any thread may do. `slots` and
    `episodes` are where they go to and their generators; `failure` is what the warm-up raised; it
    is `over` with that, or with `batch`."""

    batch: Simulator

    def __init__(
        self, slots: list[int], episodes: list[np.random.Generator], warm_up: WarmUp
    ) -> None:
        self.slots, self.episodes = slots, episodes
        self.failure: BaseException | None = None
        self.over = self._wanted = False
        self._pieces = warm_up([copy_generator(rng) for rng in episodes])
        self._turn = threading.Lock()

    def __call__(self) -> bool:
        """Do the next piece, unless another thread does it; whether there was one to do."""
        if self.over or self._wanted or not self._turn.acquire(blocking=False):
            return False
        try:
            self._go_on()
        finally:
            self._turn.release()
        return True

    def finish(self) -> None:
        """Do all that is left, after the piece that another thread may be at."""
        self._wanted = True
        with self._turn:
            while not self.over:
                self._go_on()

    def _go_on(self) -> None:
        try:
            self.batch = next(self._pieces)
        except StopIteration:
            self.over = True
        except BaseException as error:  # raised where the batch is needed
            self.failure, self.over = error, True


class NextEpisodes:
    """Receivers that wait at the onset of their next episodes. `waiting` has `STOCK` times the B
    receivers of the engine, in slots ``row`` and ``row + B`` in turn. ``warm_up(rngs)`` makes a
    batch, and stops between pieces of its warm-up. Threads do no more than such pieces; the books
    are the owner's alone."""

    def __init__(self, waiting: Simulator, warm_up: WarmUp, workers: Workers) -> None:
        self._waiting, self._warm_up, self._workers = waiting, warm_up, workers
        slots = waiting.receivers
        self._receivers = slots // STOCK
        self._ready = np.zeros(slots, dtype=np.bool_)
        self._episodes: dict[int, np.random.Generator] = {}
        self._sources: list[np.random.Generator | None] = [None] * self._receivers
        self._consumed = np.zeros(self._receivers, dtype=np.int64)
        self._stock = np.zeros(self._receivers, dtype=np.int64)
        self._requests: dict[int, None] = {}
        self._groups: list[Group] = []
        self._generation = _threads.generation()

    def forget(self) -> None:
        self._ask_again(self._groups)
        self._requests, self._sources = {}, [None] * self._receivers

    def _ask_again(self, groups: Iterable[Group]) -> None:
        self._requests = {**self._open(groups), **self._requests}
        self._groups = [group for group in self._groups if group not in groups]
        self._workers.pieces[:] = self._groups

    def _open(self, groups: Iterable[Group]) -> dict[int, None]:
        """Slots of groups for which nothing else has been requested meanwhile."""
        pairs = ((group.slots[i], i, group) for group in groups for i in range(len(group.slots)))
        return {
            slot: None for slot, i, group in pairs if self._episodes.get(slot) is group.episodes[i]
        }

    def _drop_unwanted(self) -> None:
        self._groups = [group for group in self._groups if self._open([group])]
        self._workers.pieces[:] = self._groups

    def _check_fork(self) -> None:
        """Take all groups apart in a forked process, which has no thread that goes on with them."""
        if self._generation is not _threads.generation():
            self._ask_again(self._groups)
            self._generation = _threads.generation()

    def __getstate__(self) -> dict[str, Any]:
        pending = {**self._open(self._groups), **self._requests}
        return {**self.__dict__, "_requests": pending, "_groups": [], "_generation": None}

    def _slots(self, rows: NDArray[np.intp], ahead: NDArray[np.int64] | int) -> NDArray[np.intp]:
        """Where the episodes lie that some receivers come to after some others."""
        return rows + self._receivers * ((self._consumed[rows] + ahead) % STOCK)

    def prepare(self, rows: NDArray[np.intp], rngs: Rngs) -> None:
        """Ask for the next episodes of some receivers, each from its generator. A generator that is
        new gets one, in place of what waited for the receiver before; a known one as many as it
        lacks of its stock."""
        self._check_fork()
        known = self.find_prepared(rows, rngs, least=0)
        self._stock[rows[~known]] = 0
        wanted = np.where(known, STOCK, 1)
        for ahead in range(STOCK):
            lacking = (self._stock[rows] <= ahead) & (ahead < wanted)
            slots = self._slots(rows[lacking], ahead).tolist()
            for i, slot in zip(np.flatnonzero(lacking).tolist(), slots, strict=True):
                self._ready[slot], self._episodes[slot] = False, take_episode(rngs[i])
                self._requests[slot] = None
                self._sources[int(rows[i])] = rngs[i]
                self._stock[rows[i]] += 1
        if not known.all():
            self._drop_unwanted()
        count = len(self._requests)
        if not all(group.over for group in self._groups):
            count -= count % MOST_TOGETHER  # more may join the rest while the threads are busy
        if count >= min(LEAST_TOGETHER, self._receivers):
            self._group(list(self._requests)[:count])
            self._workers.pieces[:] = self._groups
            self._workers.wake()

    def _group(self, slots: list[int]) -> None:
        for part in np.array_split(slots, -(-len(slots) // MOST_TOGETHER)):
            episodes = [self._episodes[slot] for slot in part.tolist()]
            self._groups.append(Group(part.tolist(), episodes, self._warm_up))
        for slot in slots:
            del self._requests[slot]

    def find_prepared(
        self, rows: NDArray[np.intp], rngs: Rngs, least: int = 1
    ) -> NDArray[np.bool_]:
        pairs = zip(rows.tolist(), rngs, strict=True)
        same = np.array([self._sources[row] is rng for row, rng in pairs], dtype=np.bool_)
        return same & (self._stock[rows] >= least)

    def take(self, rows: NDArray[np.intp], into: Simulator) -> None:
        slots = self._slots(rows, 0)
        self._finish([slot for slot in slots.tolist() if not self._ready[slot]])
        into.copy_rows(rows, self._waiting, slots)
        self._consumed[rows] += 1
        self._stock[rows] -= 1

    def _finish(self, slots: list[int]) -> None:
        if not slots:
            return
        self._check_fork()
        lacking = [slot for slot in slots if slot in self._requests]
        if lacking:  # a few more cost next to nothing
            others = [slot for slot in self._requests if slot not in lacking]
            self._group([*lacking, *others[: max(LEAST_TOGETHER - len(lacking), 0)]])
        urgent = [
            group for group in self._groups if not self._open([group]).keys().isdisjoint(slots)
        ]
        self._workers.pieces[:] = [*urgent, *self._groups]
        self._workers.wake()
        for group in urgent:
            group.finish()
            self._collect(group)

    def _collect(self, group: Group) -> None:
        """Let a group wait at the onset, or raise, once, what it failed with."""
        if group.failure is not None:
            self._ask_again([group])
            raise group.failure
        open_ = self._open([group])
        here = [i for i, slot in enumerate(group.slots) if slot in open_]
        to = np.array([group.slots[i] for i in here], dtype=np.intp)
        self._waiting.copy_rows(to, group.batch, np.array(here, dtype=np.intp))
        self._ready[to] = True
        self._groups.remove(group)
        self._workers.pieces[:] = self._groups

    def instead(self, rows: NDArray[np.intp], rngs: Rngs) -> list[np.random.Generator]:
        """Give up the next episodes of some receivers, which are to start otherwise."""
        known = self.find_prepared(rows, rngs)
        slots = self._slots(rows, 0).tolist()
        instead = list(rngs)
        for i in np.flatnonzero(known).tolist():
            instead[i] = copy_generator(self._episodes.pop(slots[i]))
            self._requests.pop(slots[i], None)
            self._consumed[rows[i]] += 1
            self._stock[rows[i]] -= 1
        self._drop_unwanted()
        return instead


def take_episode(rng: np.random.Generator) -> np.random.Generator:
    """Generator whose first episode is the next one of another, which then skips it."""
    episode = copy_generator(rng)
    rng.bit_generator.seed_seq.spawn(1)  # type: ignore[attr-defined]
    return episode


def copy_generator(rng: np.random.Generator) -> np.random.Generator:
    seed: Any = rng.bit_generator.seed_seq
    twin = np.random.SeedSequence(
        seed.entropy,
        spawn_key=seed.spawn_key,
        pool_size=seed.pool_size,
        n_children_spawned=seed.n_children_spawned,
    )
    return np.random.Generator(np.random.PCG64(twin))
