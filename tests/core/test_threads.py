"""Threads in the background: none outlives the wait for all, wherever an interrupt comes."""

import signal
import threading
import time

import pytest

from spoofgym.core import threads as _threads

LATE_S = 0.3
NAME = "late"


def running():
    return [each for each in threading.enumerate() if each.name == NAME]


def test_a_thread_that_has_not_begun_when_its_start_is_interrupted_is_waited_for(monkeypatch):
    said = []
    stopped = threading.Event()
    bootstrap, wait = threading.Thread._bootstrap, threading.Event.wait

    def late(thread):
        time.sleep(LATE_S)
        bootstrap(thread)

    def interrupted(event, timeout=None):
        monkeypatch.setattr(threading.Event, "wait", wait)
        raise KeyboardInterrupt

    def target():
        said.append("begun")
        stopped.wait()
        said.append("ended")

    monkeypatch.setattr(threading.Thread, "_bootstrap", late)
    monkeypatch.setattr(threading.Event, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        _threads.start(target, stopped.set, NAME)
    assert not said
    _threads.end_all()
    assert said == ["begun", "ended"]
    assert not running()


def test_a_thread_is_waited_for_until_it_has_left_the_interpreter(monkeypatch):
    leaving = threading.Event()
    delete = threading.Thread._delete

    def late(thread):
        leaving.set()
        time.sleep(LATE_S)
        delete(thread)

    monkeypatch.setattr(threading.Thread, "_delete", late)
    thread = _threads.start(lambda: None, lambda: None, NAME)
    assert leaving.wait(10.0)
    _threads.end_all()
    assert not thread.is_alive()


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no signal to one thread")
def test_an_interrupt_does_not_end_the_wait_for_a_thread():
    """After an interrupted `join`, Python 3.11 says that the thread is over."""
    stopped, ended = threading.Event(), threading.Event()

    def target():
        stopped.wait()
        time.sleep(LATE_S / 3)
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        time.sleep(LATE_S)
        ended.set()

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        _threads.start(target, stopped.set, NAME)
        _threads.end_all()
    finally:
        signal.signal(signal.SIGINT, before)
    assert ended.is_set()
    assert not running()


def test_threads_that_are_over_are_forgotten_and_the_end_does_not_wait_for_ever(monkeypatch):
    for _ in range(3):
        _threads.start(lambda: None, lambda: None, NAME).join()
    assert sum(each.name == NAME for each in _threads._known) == 1
    monkeypatch.setattr(_threads, "END_S", 0.05)
    stopped, before = threading.Event(), _threads.generation()
    thread = _threads.start(stopped.wait, lambda: None, NAME)
    _threads.end_all()
    assert thread.is_alive()
    assert _threads.generation() is not before
    stopped.set()
    thread.join()
