"""Threads that share a step: an interrupt at any moment waits for them, and mixes nothing up."""

import faulthandler
import os
import sys
import threading
import time
from itertools import count
from queue import SimpleQueue

import pytest

from spoofgym.simulation import threads as module
from spoofgym.simulation.threads import Slices, Workers

SLICES = 3
BOUNDS = (0, 1, 2, 3)
PATIENCE_S = 60.0


@pytest.fixture(autouse=True)
def _no_hanging():
    """End the process where a wait never ends: nothing else gets a thread out of it."""
    faulthandler.dump_traceback_later(PATIENCE_S, exit=True)
    yield
    faulthandler.cancel_dump_traceback_later()


class Work:
    def __init__(self, lasting_s=0.0, failing=()):
        self.lasting_s, self.failing = lasting_s, failing
        self.running, self.ended, self.calls = set(), set(), []

    def __call__(self, lo, hi):
        self.calls.append((lo, hi))
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
        self.put, self.empty = self.queue.put, self.queue.empty

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
    work = Work(1e-3)
    workers.run(work, BOUNDS)
    assert (sorted(work.calls), work.ended) == ([(0, 1), (1, 2), (2, 3)], {0, 1, 2})


def test_every_slice_is_run_once(workers):
    for _ in range(100):
        work = Work()
        workers.run(work, range(41))
        assert sorted(work.calls) == [(k, k + 1) for k in range(40)]


@pytest.mark.parametrize("times", [1, 2])
def test_a_completion_that_an_interrupt_loses_is_not_waited_for(workers, monkeypatch, times):
    monkeypatch.setattr(module, "SimpleQueue", Interrupted)
    monkeypatch.setattr(Interrupted, "left", times)
    work = Work(0.02)
    with pytest.raises(KeyboardInterrupt):
        workers.run(work, BOUNDS)
    assert not work.running
    assert work.ended == {0, 1, 2}
    assert_whole(workers)


def run_interrupted(workers, work, moment, code):
    """Whether a run was interrupted at one bytecode of some code in this thread."""
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

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        workers.run(work, BOUNDS)
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    return False


@pytest.mark.parametrize(("function", "least"), [(Workers.run, 50), (Slices.__call__, 20)])
def test_an_interrupt_at_any_bytecode_leaves_no_slice_behind(workers, function, least):
    assert_whole(workers)
    for moment in count(1):
        work = Work(2e-3)
        if not run_interrupted(workers, work, moment, function.__code__):
            break
        assert not work.running, moment
        ended = set(work.ended)
        assert_whole(workers)
        assert work.ended == ended, moment  # none began afterwards
    assert moment > least  # it was a trace of all of it


def test_an_interrupted_start_leaves_no_thread_behind():
    before = set(threading.enumerate())
    for moment in count(1):
        workers = Workers(SLICES - 1)
        interrupted = run_interrupted(workers, Work(), moment, Workers._start.__code__)
        workers.close()
        for thread in set(threading.enumerate()) - before:
            thread.join(PATIENCE_S / 10)
            assert not thread.is_alive(), moment
        if not interrupted:
            break
    assert moment > 30  # it was a trace of all of it


def test_what_a_slice_fails_with_is_raised_when_all_have_ended(workers):
    for failing in range(SLICES):
        work = Work(5e-3, [failing])
        with pytest.raises(ArithmeticError, match=f"slice {failing}"):
            workers.run(work, BOUNDS)
        assert (sorted(work.calls), work.ended) == ([(0, 1), (1, 2), (2, 3)], {0, 1, 2})
        assert_whole(workers)


def test_nobody_waits_for_a_thread_that_is_busy_with_a_piece(workers):
    begun, go_on = threading.Event(), threading.Event()

    def piece():
        begun.set()
        go_on.wait(PATIENCE_S)
        return False

    workers.pieces[:] = [piece]
    workers.wake()
    assert begun.wait(PATIENCE_S)
    try:
        assert_whole(workers)  # by the caller alone
    finally:
        go_on.set()
    workers.pieces.clear()
    assert_whole(workers)


def test_threads_do_pieces_while_there_are_some_and_end_within_one(workers):
    calls, done = [], threading.Event()

    def piece():
        calls.append(None)
        if len(calls) == 30:
            done.set()
        return True

    workers.pieces[:] = [lambda: False, piece]
    workers.wake()
    assert done.wait(PATIENCE_S)
    assert_whole(workers)
    threads = list(workers._threads)
    workers.close()
    assert not any(thread.is_alive() for thread in threads)


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
