"""The link between a thread in the background and its owner."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue
from typing import Any

from .. import _threads

JOIN_S = 5.0
"""How long a thread that has been stopped is waited for.  It ends within a millisecond or so, if no
detector holds it up."""
LOOK_S = 0.1
"""How often a thread that may not compute looks whether it has been stopped."""


class StoppedError(Exception):
    """The thread has been stopped within its work."""


class Link:
    """One thread, and what it and its owner tell each other; used once, and in one process.

    - `process`: where it was made.  A forked process inherits no thread, and locks that may be
      held;
    - `wake`: True for new work, False for the end;
    - `change`: held by who writes what both of them use;
    - `free`: whether the thread may compute;
    - `urgent`: whether the owner waits for the work;
    - `stopped`: whether the thread is to end; it writes nothing any more;
    - `failure`: what the work failed with, until it is raised.
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
        """Wait as long as the processors are needed elsewhere.

        Raises `StoppedError` when the thread is to end.
        """
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
