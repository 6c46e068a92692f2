"""Threads that share the compiled half of a step."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from itertools import pairwise
from queue import SimpleQueue
from typing import Any

Work = Callable[[int, int], None]


class Workers:
    """A few threads that each take one slice of a batch.

    Simpler and quicker than a pool of the standard library, whose futures cost as much as the work
    on some dozens of receivers.  Threads are started when first needed, and again in a forked or
    unpickled copy.

    `count`: threads besides the caller's own.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._owner = 0
        self._jobs: list[SimpleQueue[tuple[Work, int, int] | None]] = []
        self._done: SimpleQueue[BaseException | None] = SimpleQueue()

    def run(self, work: Work, bounds: Sequence[int]) -> None:
        """Call ``work(lo, hi)`` for all neighbouring bounds, the first in this thread.

        `bounds`: one more than slices; at most as many slices as threads.
        """
        if self._owner != os.getpid():
            self._start()
        first, *slices = pairwise(bounds)
        for queue, (lo, hi) in zip(self._jobs, slices, strict=False):
            queue.put((work, lo, hi))
        failure: BaseException | None = None
        try:
            work(*first)
        except BaseException as error:  # the other slices must end before it is raised
            failure = error
        left = len(slices)
        while left:  # an interrupt, too, has to wait: the slices' arrays must outlive them
            try:
                failure = self._done.get() or failure
                left -= 1
            except BaseException as error:
                failure = error
        if failure is not None:
            raise failure

    def _start(self) -> None:
        self._owner = os.getpid()
        self._done = SimpleQueue()
        self._jobs = [SimpleQueue() for _ in range(self.count)]
        for number, queue in enumerate(self._jobs):
            threading.Thread(
                target=_serve,
                args=(queue, self._done),
                name=f"spoofgym-{number}",
                daemon=True,
            ).start()

    def close(self) -> None:
        """End the threads; a later run starts new ones."""
        if self._owner == os.getpid():
            for queue in self._jobs:
                queue.put(None)
        self._owner = 0
        self._jobs = []

    def __del__(self) -> None:
        """End the threads with their owner."""
        self.close()

    def __getstate__(self) -> dict[str, Any]:
        """State without the threads."""
        return {"count": self.count}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Begin without threads."""
        self.__init__(state["count"])  # type: ignore[misc]


def _serve(
    jobs: SimpleQueue[tuple[Work, int, int] | None], done: SimpleQueue[BaseException | None]
) -> None:
    while (job := jobs.get()) is not None:
        work, lo, hi = job
        try:
            work(lo, hi)
        except BaseException as error:  # handed to the caller
            done.put(error)
        else:
            done.put(None)
        del job, work
