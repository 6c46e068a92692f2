"""Threads that share a step: an interrupt at any moment waits for them, and mixes nothing up."""

from __future__ import annotations

import faulthandler
import os
import sys
import threading
import time
from queue import SimpleQueue

import pytest

from spoofgym.simulators import threads as module
from spoofgym.simulators.threads import Workers

SLICES = 3
BOUNDS = (0, 1, 2, 3)
PATIENCE_S = 60.0


@pytest.fixture(autouse=True)
def _no_hanging():
    """End the process where a wait never ends: nothing else gets a thread out of it."""
    faulthandler.dump_traceback_later(PATIENCE_S, exit=True)
    yield
    faulthandler.cancel_dump_traceback_later()


class Slices:
    """Work that says which of its slices run, and which have ended."""

    def __init__(self, lasting_s=0.0, failing=()):
        self.lasting_s, self.failing = lasting_s, failing
        self.running, self.ended = set(), set()

    def __call__(self, lo, hi):
        self.running.add(lo)
        time.sleep(self.lasting_s * lo)
        self.ended.add(lo)
        self.running.discard(lo)
        if lo in self.failing:
            raise ArithmeticError(f"slice {lo}")


class Interrupted:
    """A queue whose first `get` in the main thread takes something, and is interrupted then."""

    left = 1

    def __init__(self):
        self.queue = SimpleQueue()
        self.put = self.queue.put

    def get(self):
        taken = self.queue.get()
        if threading.current_thread() is threading.main_thread() and Interrupted.left:
            Interrupted.left -= 1
            raise KeyboardInterrupt
        return taken


@pytest.fixture
def workers():
    made = Workers(SLICES - 1)
    yield made
    made.close()


def assert_whole(workers):
    work = Slices(1e-3)
    workers.run(work, BOUNDS)
    assert work.ended == {0, 1, 2}


@pytest.mark.parametrize("times", [1, 2])
def test_a_completion_that_an_interrupt_loses_is_not_waited_for(workers, monkeypatch, times):
    monkeypatch.setattr(module, "SimpleQueue", Interrupted)
    monkeypatch.setattr(Interrupted, "left", times)
    work = Slices(0.02)
    with pytest.raises(KeyboardInterrupt):
        workers.run(work, BOUNDS)
    assert not work.running
    assert work.ended == {0, 1, 2}
    assert_whole(workers)


def interrupted_at(workers, work, moment, code):
    """Run with an interrupt at one bytecode of `run`; whether there was such a one."""
    left = moment

    def trace(frame, event, _):
        nonlocal left
        if frame.f_code is not code:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            left -= 1
            if left == 0:
                raise KeyboardInterrupt
        return trace

    sys.settrace(trace)
    try:
        workers.run(work, BOUNDS)
    finally:
        sys.settrace(None)


def test_an_interrupt_at_any_bytecode_leaves_no_slice_behind(workers):
    assert_whole(workers)
    moment, before = 0, sys.gettrace()
    try:
        while True:
            moment += 1
            work = Slices(2e-3)
            try:
                interrupted_at(workers, work, moment, Workers.run.__code__)
            except KeyboardInterrupt:
                assert not work.running, moment
                ended = set(work.ended)
                assert_whole(workers)
                assert work.ended == ended, moment  # none began afterwards
            else:
                break
    finally:
        sys.settrace(before)
    assert moment > 50  # it was a trace of all of it


def test_what_a_slice_fails_with_is_raised_when_all_have_ended(workers):
    for failing in range(SLICES):
        work = Slices(5e-3, [failing])
        with pytest.raises(ArithmeticError, match=f"slice {failing}"):
            workers.run(work, BOUNDS)
        assert work.ended == {0, 1, 2}
        assert_whole(workers)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # a fork in a process with threads
def test_a_forked_child_has_threads_of_its_own_and_ends(workers):
    assert_whole(workers)
    child = os.fork()
    if child == 0:
        code = 1
        try:
            assert_whole(workers)
            code = 0
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert_whole(workers)
