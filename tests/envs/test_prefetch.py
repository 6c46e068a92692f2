"""Episodes that are warmed up ahead have the bits of those that are not."""

import copy
import gc
import os
import pickle
import threading

import numpy as np
import pytest

from spoofgym.envs.prefetch import copy_of, take_episode
from spoofgym.envs.presets import make_game, make_setup

TIMELINE = {"warmup_s": 8.0, "live_s": 3.0, "attack_s": 6.0, "time_to_alert_s": 1.0}


@pytest.fixture(scope="module")
def setup():
    return make_setup(detector={"name": "ewma", "false_alarm": 0.3}, timeline=TIMELINE)


def game_of(setup, prefetch, receivers=9):
    return make_game(receivers, setup, knowledge="oracle", threads=1, prefetch=prefetch)


def generators(receivers=9, seed=0):
    return [np.random.default_rng(seed + i) for i in range(receivers)]


def course(game, rngs, steps, chance):
    """Rewards, observations, warm-up alarms of some steps with autoresets."""
    seen = []
    for _ in range(steps):
        turn = game.step(np.clip(chance.normal(0.3, 0.5, (game.receivers, 2)), -1, 1))
        over = np.flatnonzero(turn.terminated)
        if len(over):
            game.reset([rngs[row] for row in over], over)
        seen.append((turn.reward, game.observe(), game.engine.warmup_alarm.copy()))
    return [np.array(column) for column in zip(*seen, strict=True)]


def assert_same(one, other):
    for x, y in zip(one, other, strict=True):
        assert np.array_equal(x, y)


def played(setup, prefetch, steps=40, seed=0):
    game, rngs = game_of(setup, prefetch), generators(seed=seed)
    game.reset(rngs)
    return course(game, rngs, steps, np.random.default_rng(1))


def test_same_bits_over_autoresets(setup):
    plain = played(setup, prefetch=False)
    assert plain[2].any()  # some warm-ups alarm
    assert_same(plain, played(setup, prefetch=True))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_a_copy_goes_on_with_the_same_bits(setup, copied):
    game, rngs = game_of(setup, True), generators()
    game.reset(rngs)
    chance = np.random.default_rng(1)
    first = course(game, rngs, 15, chance)
    game, rngs = copied((game, rngs))
    second = course(game, rngs, 25, chance)
    whole = [np.concatenate(pair) for pair in zip(first, second, strict=True)]
    assert_same(played(setup, prefetch=False), whole)


def test_other_generators_begin_anew(setup):
    game = game_of(setup, True)
    game.reset(generators(seed=5))
    rngs = generators(seed=0)
    game.reset(rngs)
    assert_same(played(setup, prefetch=False), course(game, rngs, 40, np.random.default_rng(1)))


def test_the_same_generators_go_on_to_their_next_episodes(setup):
    courses = []
    for prefetch in (False, True):
        game, rngs = game_of(setup, prefetch), generators()
        game.reset(rngs)
        game.reset(rngs)
        courses.append(course(game, rngs, 5, np.random.default_rng(1)))
    assert_same(*courses)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # a fork in a process with threads
def test_a_forked_child_goes_on_with_the_same_bits(setup):
    game, rngs = game_of(setup, True), generators()
    game.reset(rngs)
    chance = np.random.default_rng(1)
    first = course(game, rngs, 15, chance)
    read, write = os.pipe()
    child = os.fork()
    if child == 0:  # pragma: no cover
        status = 1
        try:
            second = course(game, rngs, 25, chance)
            with os.fdopen(write, "wb") as pipe:
                pickle.dump(second, pipe)
            status = 0
        finally:
            os._exit(status)
    os.close(write)
    with os.fdopen(read, "rb") as pipe:
        second = pickle.load(pipe)
    assert os.waitpid(child, 0)[1] == 0
    whole = [np.concatenate(pair) for pair in zip(first, second, strict=True)]
    assert_same(played(setup, prefetch=False), whole)


def test_what_goes_wrong_in_the_background_is_raised(setup):
    game, rngs = game_of(setup, True), generators()
    game.engine._next._warm_up = lambda rngs, between: 1 / 0
    game.reset(rngs)
    with pytest.raises(ZeroDivisionError):
        game.reset(rngs)


def test_threads_end_with_the_game(setup):
    def running():
        return {thread for thread in threading.enumerate() if thread.name == "spoofgym-next"}

    gc.collect()
    before = running()
    game = game_of(setup, True)
    game.reset(generators())
    game.reset(generators())
    (thread,) = running() - before
    del game
    gc.collect()
    thread.join(timeout=20)
    assert not thread.is_alive()


def test_a_closed_game_can_be_played_on(setup):
    game, rngs = game_of(setup, True), generators()
    game.reset(rngs)
    chance = np.random.default_rng(1)
    first = course(game, rngs, 15, chance)
    game.close()
    second = course(game, rngs, 25, chance)
    whole = [np.concatenate(pair) for pair in zip(first, second, strict=True)]
    assert_same(played(setup, prefetch=False), whole)


def test_an_episode_is_taken_from_a_generator():
    rng = np.random.default_rng(3)
    expected = [child.generate_state(2) for child in np.random.SeedSequence(3).spawn(3)]
    taken = [take_episode(rng) for _ in range(2)]
    for source, state in zip([*taken, copy_of(rng)], expected, strict=True):
        child = source.bit_generator.seed_seq.spawn(1)[0]
        assert np.array_equal(child.generate_state(2), state)
