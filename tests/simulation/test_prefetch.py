"""Episodes that are warmed up ahead have the bits of those that are not."""

import gc
import os
import pickle
import signal
import threading
import time

import numpy as np
import pytest

from spoofgym.envs import SpoofCore, SpoofVectorEnv
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.prefetch import Group, copy_generator, take_episode

PATIENCE_S = 900.0
"""After which a thread or a process counts as hanging, however busy the machine."""
TIMELINE = {"warmup_s": 8.0, "live_s": 3.0, "attack_s": 6.0, "time_to_alert_s": 1.0}
JOIN_S = "spoofgym.simulation.threads.JOIN_S"


@pytest.fixture(scope="module")
def setup():
    return TightlyCoupledSetup(detector={"name": "ewma", "false_alarm": 0.3}, timeline=TIMELINE)


def core_of(setup, prefetch=True, receivers=9):
    how = {"threads": 1, "prefetch": prefetch, "action": "full-command"}
    return SpoofCore(receivers, setup, knowledge="oracle", **how)


def generators(receivers=9, seed=0):
    return [np.random.default_rng(seed + i) for i in range(receivers)]


def course(core, rngs, steps=40, chance=None):
    seen, chance = [], chance or np.random.default_rng(1)
    for _ in range(steps):
        command = np.clip(chance.normal(0.3, 0.5, (core.receivers, 2)), -1, 1)
        result, observation = core.step(command)
        over = np.flatnonzero(result.terminated)
        if len(over):
            core.reset([rngs[row] for row in over], over)
            observation = core.observe()
        seen.append((result.reward, observation, core.engine.warmup_alarm.copy()))
    return [np.array(column) for column in zip(*seen, strict=True)]


def begun(setup, **how):
    """A game in its first episodes, and the generators of the next ones."""
    core = core_of(setup, **how)
    rngs = generators(core.receivers)
    core.reset(rngs)
    return core, rngs


def second_episode(setup, receivers=9):
    core, rngs = begun(setup, prefetch=False, receivers=receivers)
    core.reset(rngs)
    return core.observe()


def assert_same(one, other):
    for x, y in zip(one, other, strict=True):
        assert np.array_equal(x, y)


@pytest.fixture(scope="module")
def plain(setup):
    found = course(*begun(setup, prefetch=False))
    assert found[2].any()  # some warm-ups alarm
    return found


def assert_goes_on(plain, first, second):
    assert_same(plain, [np.concatenate(pair) for pair in zip(first, second, strict=True)])


def closed(game):
    game[0].close()
    return game


@pytest.mark.parametrize("between", [lambda game: pickle.loads(pickle.dumps(game)), closed])
def test_a_game_that_was_copied_or_closed_goes_on_with_the_same_bits(setup, plain, between):
    core, rngs = begun(setup)
    chance = np.random.default_rng(1)
    first = course(core, rngs, 15, chance)
    core, rngs = between((core, rngs))
    assert_goes_on(plain, first, course(core, rngs, 25, chance))


def test_other_generators_begin_anew_the_same_go_on_and_some_leave_the_others_as_they_are(
    setup, plain
):
    core, rngs = core_of(setup), generators()
    core.reset(generators(seed=5))
    core.reset(rngs)
    assert_same(plain, course(core, rngs))
    core, rngs = begun(setup)
    core.reset(rngs)
    assert np.array_equal(core.observe(), second_episode(setup))
    seen = []
    for prefetch in (False, True):
        settings = {"timeline": TIMELINE, "threads": 1, "prefetch": prefetch}
        envs = SpoofVectorEnv(3, knowledge="oracle", **settings)
        seeds = (5, [7, None, None], [None, 8, None], None)
        seen.append([envs.reset(seed=seed)[0] for seed in seeds])
        envs.close()
    assert_same(*seen)
    assert not np.array_equal(seen[0][0][1], seen[0][1][1])  # the others are in their next episodes


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # a fork in a process with threads
def test_a_forked_child_goes_on_with_the_same_bits(setup, plain):
    core, rngs = begun(setup)
    chance = np.random.default_rng(1)
    first = course(core, rngs, 15, chance)
    read, write = os.pipe()
    child = os.fork()
    if child == 0:  # pragma: no cover
        status = 1
        try:
            with os.fdopen(write, "wb") as pipe:
                pickle.dump(course(core, rngs, 25, chance), pipe)
            status = 0
        finally:
            os._exit(status)
    os.close(write)
    with os.fdopen(read, "rb") as pipe:
        second = pickle.load(pipe)
    assert os.waitpid(child, 0)[1] == 0
    assert_goes_on(plain, first, second)


class Held:
    """Warm-ups whose first piece waits until it may go on."""

    def __init__(self, warm_up):
        self.warm_up, self.begun, self.go_on = warm_up, threading.Event(), threading.Event()

    def __call__(self, rngs):
        self.begun.set()
        self.go_on.wait(PATIENCE_S)
        yield from self.warm_up(rngs)


def held(core, rngs, monkeypatch):
    pieces = Held(core.engine._next._warm_up)
    with monkeypatch.context() as patch:
        patch.setattr(core.engine._next, "_warm_up", pieces)
        core.reset(rngs)
        assert pieces.begun.wait(PATIENCE_S)
    return pieces


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # a fork in a process with threads
@pytest.mark.parametrize("steps", [0, 1])
def test_a_fork_within_a_piece(setup, monkeypatch, steps):
    core, rngs = core_of(setup), generators()
    pieces = held(core, rngs, monkeypatch)
    child = os.fork()
    if child == 0:  # pragma: no cover
        signal.alarm(int(PATIENCE_S))  # ends a child that hangs
        status = 1
        try:
            pieces.go_on.set()
            for _ in range(steps):
                core.step(np.zeros((core.receivers, 2)))
            core.reset(rngs)
            core.close()
            status = 0
        finally:
            os._exit(status)
    pieces.go_on.set()
    assert os.waitpid(child, 0)[1] == 0
    core.close()


@pytest.mark.parametrize("where", ["warm_up", "writing"])
def test_what_goes_wrong_ahead_of_time_is_raised_once(setup, monkeypatch, where):
    core, rngs = core_of(setup), generators()
    episodes, left = core.engine._next, [MemoryError("for once")]
    warm_up, copy_rows = episodes._warm_up, episodes._waiting.copy_rows

    def failing(rngs):
        pieces = warm_up(rngs)
        yield next(pieces)
        if left:
            raise left.pop()
        yield from pieces

    def fail_to_write(*args):
        if left:
            raise left.pop()
        copy_rows(*args)

    if where == "writing":
        monkeypatch.setattr(episodes._waiting, "copy_rows", fail_to_write)
    else:
        monkeypatch.setattr(episodes, "_warm_up", failing)
    core.reset(rngs)
    with pytest.raises(MemoryError, match="for once"):
        core.reset(rngs)
    core.reset(rngs)
    assert np.array_equal(core.observe(), second_episode(setup))


def test_an_interrupted_wait_leaves_nothing_behind(setup, plain, monkeypatch):
    core, rngs = core_of(setup), generators()
    pieces = held(core, rngs, monkeypatch)

    def interrupted(group):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Group, "finish", interrupted)
        with pytest.raises(KeyboardInterrupt):
            core.reset(rngs)
    pieces.go_on.set()
    rngs = generators()
    core.reset(rngs)
    assert_same(plain, course(core, rngs))


def test_the_owner_helps_with_what_it_needs(setup, monkeypatch):
    core, rngs = core_of(setup, receivers=40), generators(40)
    warm_up, by = core.engine._next._warm_up, set()

    def counted(rngs):
        for batch in warm_up(rngs):
            by.add(threading.get_ident())
            yield batch

    monkeypatch.setattr(core.engine._next, "_warm_up", counted)
    monkeypatch.setattr(core.engine._workers, "wake", lambda: None)  # no thread comes to help
    core.reset(rngs)
    core.reset(rngs)
    assert by == {threading.get_ident()}
    assert np.array_equal(core.observe(), second_episode(setup, receivers=40))


@pytest.mark.parametrize("given", [None, {"start_s": 0.0}])
def test_what_nobody_wants_any_more_is_dropped(setup, given):
    core, rngs = core_of(setup), generators()
    for seed in range(5):
        core.reset(rngs if given else generators(seed=seed), given=given)
        groups = core.engine._next._groups
        assert len(groups) <= 2
        assert core.engine._workers.pieces == groups
    core.close()


def running():
    return {thread for thread in threading.enumerate() if thread.name.startswith("spoofgym-")}


def assert_ends(thread):
    thread.join(timeout=PATIENCE_S)
    assert not thread.is_alive()


def test_a_game_is_closed_within_a_long_warm_up(setup, plain, monkeypatch):
    monkeypatch.setattr(JOIN_S, PATIENCE_S)
    before, begun = running(), threading.Event()
    core = core_of(setup)

    def endless(rngs):
        while True:
            begun.set()
            time.sleep(1e-3)
            yield core.engine.simulator

    with monkeypatch.context() as patch:
        patch.setattr(core.engine._next, "_warm_up", endless)
        core.reset(generators())
        assert begun.wait(PATIENCE_S)
        (thread,) = running() - before
        core.close()
        assert not thread.is_alive()
        core.engine._next.forget()
    rngs = generators()
    core.reset(rngs)
    assert_same(plain, course(core, rngs))


def test_a_thread_that_ends_late_leaves_its_receivers_to_the_owner(setup, plain, monkeypatch):
    monkeypatch.setattr(JOIN_S, 0.01)
    before = running()
    core, rngs = core_of(setup), generators()
    pieces = held(core, rngs, monkeypatch)
    (thread,) = running() - before
    core.close()
    assert thread.is_alive()
    pieces.go_on.set()
    assert_ends(thread)
    assert_same(plain, course(core, rngs))


def test_a_thread_may_close_its_owner(setup):
    core, before, closed = core_of(setup), running(), threading.Event()

    def closing(rngs):
        core.close()
        closed.set()
        yield core.engine.simulator

    core.engine._next._warm_up = closing
    core.reset(generators())
    assert closed.wait(PATIENCE_S)
    for thread in running() - before:
        assert_ends(thread)


def test_threads_end_with_the_game(setup):
    gc.collect()
    before = running()
    core, rngs = begun(setup)
    core.reset(rngs)
    (thread,) = running() - before
    del core
    gc.collect()
    assert_ends(thread)


def test_an_episode_is_taken_from_a_generator():
    rng = np.random.default_rng(3)
    expected = [child.generate_state(2) for child in np.random.SeedSequence(3).spawn(3)]
    taken = [take_episode(rng) for _ in range(2)]
    for source, state in zip([*taken, copy_generator(rng)], expected, strict=True):
        child = source.bit_generator.seed_seq.spawn(1)[0]
        assert np.array_equal(child.generate_state(2), state)
