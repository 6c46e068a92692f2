"""Threads in the background, which end before the interpreter takes down what they compute with."""

from __future__ import annotations

import atexit
import os
import threading
import time
from collections.abc import Callable

END_S = 5.0
"""How long they are waited for when the interpreter ends."""
_running: dict[threading.Thread, Callable[[], None]] = {}
_generation = object()


def generation() -> object:
    """What is another one when all threads that were started before are gone."""
    return _generation


def _forget() -> None:
    global _generation
    _running.clear()
    _generation = object()


if hasattr(os, "register_at_fork"):  # a child inherits none of them
    os.register_at_fork(after_in_child=_forget)


def start(target: Callable[[], None], stop: Callable[[], None], name: str) -> threading.Thread:
    """Start a thread that ends soon after `stop` has been called."""

    def run() -> None:
        """Work, and be known as long as that lasts."""
        _running[threading.current_thread()] = stop
        try:
            target()
        finally:
            _running.pop(threading.current_thread(), None)

    thread = threading.Thread(target=run, name=name, daemon=True)
    thread.start()
    return thread


@atexit.register
def end_all() -> None:
    """Stop all threads and wait for them; an interrupt has to wait, too."""
    deadline = time.monotonic() + END_S
    while time.monotonic() < deadline:
        try:
            threads = list(_running.items())
            for _, stop in threads:
                stop()
            for thread, _ in threads:
                thread.join(max(0.0, deadline - time.monotonic()))
        except BaseException:  # the process ends already
            continue
        break
    _forget()
