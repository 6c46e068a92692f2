"""Threads that share the compiled half of a step, and have spare time between two steps."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial
from itertools import count, pairwise
from queue import SimpleQueue
from typing import Any

from ..core import threads as _threads

Work = Callable[[int, int], None]
Job = Callable[[], object]
Piece = Callable[[], bool]  # 0.1 ms of work, raises nothing; False where there was none
# How long threads that have been closed are waited for; they end with the piece that they are at,
# unless a detector holds them up.
JOIN_S = 5.0


class Slices:
    """Slices of one step, each of which goes to the first thread that comes for it."""

    def __init__(self, work: Work, bounds: Sequence[int]) -> None:
        self._work, self._bounds = work, list(pairwise(bounds))
        # the calls of a counter are atomic under the lock of the interpreter
        self._next, self._end = count().__next__, count(1).__next__
        self.done: SimpleQueue[None] = SimpleQueue()
        self.failure: BaseException | None = None

    def __call__(self) -> None:
        while (number := self._next()) < len(self._bounds):
            try:
                self._work(*self._bounds[number])
            except BaseException as error:  # raised by `run`
                self.failure = error
            if self._end() == len(self._bounds):
                self.done.put(None)


class Workers:
    """A few threads that share the slices of a step with the caller.

    Simpler and quicker than a pool of the standard library, whose futures cost as much as the work
    on some dozens of receivers.  Threads are started when first needed, and again in a forked or
    unpickled copy; `count` are those besides the caller's own.  While there is no step they do
    `pieces`, the first that has something to do: only the owner changes that list, and calls `wake`
    after it.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self.pieces: list[Piece] = []
        self._generation: object = None
        self._busy = False
        self._threads: list[threading.Thread] = []
        self._jobs: list[SimpleQueue[Job | None]] = []

    def run(self, work: Work, bounds: Sequence[int]) -> None:
        """Call ``work(lo, hi)`` for all neighbouring bounds, here and in the threads. What the work
        raised, or an interrupt, is raised after all slices have ended."""
        self._start()
        if self._busy:
            self.settle()
        slices = Slices(work, bounds)
        try:
            self._busy = True
            for queue in self._jobs[: len(bounds) - 2]:
                queue.put(slices)
            slices()
            slices.done.get()
            self._busy = False
        except BaseException:
            self.settle()
            raise
        if slices.failure is not None:
            raise slices.failure

    def wake(self) -> None:
        self._start()
        for queue in self._jobs:
            queue.put(_nothing)

    def settle(self) -> None:
        """Wait until no slice of an interrupted `run` is left; interrupts have to wait, too. An
        interrupt may have lost an end, or have come before a slice was handed out. So nothing is
        counted: every thread is given one more job, which it comes to after all others."""
        interrupt: BaseException | None = None
        while self._busy and self._generation is _threads.generation():
            try:
                done: SimpleQueue[None] = SimpleQueue()
                for queue in self._jobs:
                    queue.put(partial(done.put, None))
                for _ in self._jobs:
                    done.get()
                self._busy = False
            except BaseException as error:
                interrupt = error
        if interrupt is not None:
            raise interrupt

    def _start(self) -> None:
        if self._generation is _threads.generation():
            return
        jobs: list[SimpleQueue[Job | None]] = [SimpleQueue() for _ in range(self.count)]
        try:
            self._threads = [
                _threads.start(
                    partial(_serve, queue, self.pieces),
                    partial(queue.put, None),
                    f"spoofgym-{number}",
                )
                for number, queue in enumerate(jobs)
            ]
            self._busy, self._jobs, self._generation = False, jobs, _threads.generation()
        except BaseException:  # those that have been started have no owner
            for queue in jobs:
                queue.put(None)
            raise

    def close(self) -> None:
        threads = self._threads
        self._stop()
        for thread in threads:
            # no thread waits for itself, and none runs on while the interpreter ends
            if thread is not threading.current_thread() and not sys.is_finalizing():
                thread.join(JOIN_S)

    def _stop(self) -> None:
        for queue in self._jobs:
            queue.put(None)
        self._generation, self._threads, self._jobs = None, [], []

    def __del__(self) -> None:
        """End the threads with their owner, without a wait: a collection of garbage may call it."""
        self._stop()

    def __getstate__(self) -> dict[str, Any]:
        return {"count": self.count}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["count"])  # type: ignore[misc]


def _nothing() -> None:
    """Do nothing."""


def _serve(jobs: SimpleQueue[Job | None], pieces: Sequence[Piece]) -> None:
    """Do jobs as they come, and after each of them pieces until the next one."""
    while (job := jobs.get()) is not None:
        job()
        del job
        while jobs.empty() and any(piece() for piece in tuple(pieces)):
            pass
