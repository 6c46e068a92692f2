"""Threads that share the compiled half of a step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from queue import SimpleQueue
from typing import Any

from .. import _threads

Work = Callable[[int, int], None]
Done = SimpleQueue[BaseException | None]
Job = tuple[Done, Work, int, int]


class Workers:
    """A few threads that each take one slice of a batch.

    Simpler and quicker than a pool of the standard library, whose futures cost as much as the work
    on some dozens of receivers.  Threads are started when first needed, and again in a forked or
    unpickled copy; `count` are those besides the caller's own.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._threads: object = None
        self._busy = False
        self._jobs: list[SimpleQueue[Job | None]] = []

    def run(self, work: Work, bounds: Sequence[int]) -> None:
        """Call ``work(lo, hi)`` for all neighbouring bounds, at most as many pairs as threads.

        What the work raised, or an interrupt, is raised after all slices have ended.
        """
        if self._threads is not _threads.generation():
            self._start()
        if self._busy:
            self.settle()
        first, *slices = pairwise(bounds)
        done: Done = SimpleQueue()  # of this call alone: no end of another one's slice comes here
        failure: BaseException | None = None
        try:
            self._busy = True
            for queue, (lo, hi) in zip(self._jobs, slices, strict=False):
                queue.put((done, work, lo, hi))
            work(*first)
            for _ in slices:
                failure = done.get() or failure
            self._busy = False
        except BaseException:
            self.settle()
            raise
        if failure is not None:
            raise failure

    def settle(self) -> None:
        """Wait until no slice of an interrupted `run` is left; interrupts have to wait, too.

        An interrupt may have lost an end, or have come before a slice was handed out.  So nothing
        is counted: every thread is given one more job, which it comes to after all others.
        """
        interrupt: BaseException | None = None
        while self._busy and self._threads is _threads.generation():
            try:
                done: Done = SimpleQueue()
                for queue in self._jobs:
                    queue.put((done, _nothing, 0, 0))
                for _ in self._jobs:
                    done.get()
                self._busy = False
            except BaseException as error:
                interrupt = error
        if interrupt is not None:
            raise interrupt

    def _start(self) -> None:
        jobs: list[SimpleQueue[Job | None]] = [SimpleQueue() for _ in range(self.count)]
        for number, queue in enumerate(jobs):
            _threads.start(partial(_serve, queue), partial(queue.put, None), f"spoofgym-{number}")
        self._busy, self._jobs, self._threads = False, jobs, _threads.generation()

    def close(self) -> None:
        """End the threads; a later run starts new ones."""
        if self._threads is _threads.generation():
            for queue in self._jobs:
                queue.put(None)
        self._threads, self._jobs = None, []

    def __del__(self) -> None:
        """End the threads with their owner."""
        self.close()

    def __getstate__(self) -> dict[str, Any]:
        """State without the threads."""
        return {"count": self.count}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Start without threads."""
        self.__init__(state["count"])  # type: ignore[misc]


def _nothing(lo: int, hi: int) -> None:
    """Do nothing with receivers lo to hi."""


def _serve(jobs: SimpleQueue[Job | None]) -> None:
    while (job := jobs.get()) is not None:
        done, work, lo, hi = job
        try:
            work(lo, hi)
        except BaseException as error:  # handed to the caller
            done.put(error)
        else:
            done.put(None)
        del job, done, work
