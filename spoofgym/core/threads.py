"""Threads in the background, which end before the interpreter takes down what they compute with."""

from __future__ import annotations

import atexit
import os
import threading
import time
from collections.abc import Callable

END_S = 5.0  # how long they are waited for when the interpreter ends
LOOK_S = 1e-3  # how often it is looked whether they have ended
_known: dict[_Thread, Callable[[], None]] = {}
_generation = object()


class _Thread(threading.Thread):
    """A thread that reports whether it is gone, also where its start was interrupted."""

    _done = False

    def run(self) -> None:
        try:
            super().run()
        finally:
            self._done = True

    @property
    def is_over(self) -> bool:
        """Whether it has run and left the interpreter. Without `_done`, one that has yet to begin
        would count as over, and so would one whose `join` was interrupted: Python 3.11 takes that
        for its end."""
        return self._done and not self.is_alive()


def generation() -> object:
    """What is another one when all threads that were started before are gone."""
    return _generation


def _forget() -> None:
    global _generation
    _known.clear()
    _generation = object()


if hasattr(os, "register_at_fork"):  # a child inherits none of them
    os.register_at_fork(after_in_child=_forget)


def start(target: Callable[[], None], stop: Callable[[], None], name: str) -> threading.Thread:
    """Start a thread that ends soon after a call of `stop`, even one before its start. It is
    known from before its first moment until after its last one, so that `end_all` misses none,
    wherever an interrupt comes."""
    for each in list(_known):
        if each.is_over:
            _known.pop(each, None)
    thread = _Thread(target=target, name=name, daemon=True)
    _known[thread] = stop
    try:
        thread.start()
    except Exception:  # there can't be another one
        del _known[thread]
        raise
    return thread


@atexit.register
def end_all() -> None:
    """Stop all threads and wait for them; an interrupt has to wait, too."""
    deadline = time.monotonic() + END_S
    while time.monotonic() < deadline:
        try:
            for stop in list(_known.values()):
                stop()
            while time.monotonic() < deadline and not all(each.is_over for each in list(_known)):
                time.sleep(LOOK_S)
        except BaseException:  # the process ends already
            continue
        break
    _forget()
