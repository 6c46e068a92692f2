"""Contracts that every environment id keeps, also under settings that change how a game is run."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.env_match import check_environments_match

from spoofgym import duel_v0
from spoofgym.tasks import TASKS

from ..golden import trajectories

IDS = sorted(name for name in gym.registry if name.startswith("spoofgym/"))
MAIN = "spoofgym/TightlyCoupled-v0"
SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 2.0}
SMALL_WORLDS = {
    "spoofgym/BenchT4-v1": {
        "timeline": {"warmup_s": 60.0, "live_s": 20.0, "attack_s": 300.0},
        "scenario": "realistic-tactical",
    },
    "spoofgym/BenchT5-v1": {
        "domain": {"start_s": [0.0, 30.0], "turned_deg": [0.0, 360.0], "worlds": 2}
    },
    "spoofgym/LooselyCoupled-v0": {
        "timeline": {"warmup_s": 2.0, "live_s": 1.0, "attack_s": 2.4, "time_to_alert_s": 0.5},
        "detector": {"name": "windowed-chi2", "window": 8},
    },
    "spoofgym/Snapshot-v0": {},
    "spoofgym/WheeledRobot-v0": {},
}
"""Short flights and few worlds, so that all of them are made within seconds."""
ELSEWHERE = {MAIN, "spoofgym/LooselyCoupled-v0", "spoofgym/Snapshot-v0", "spoofgym/WheeledRobot-v0"}
"""Ids that the checkers of Gymnasium try in `tests/envs`, at several settings."""

WORLDS = {"start_s": (0.0, 30.0), "turned_deg": (0.0, 360.0), "worlds": 2}
VARIANTS = {
    "twin": {"twin": True},
    "watch": {"watch": ("snapshot-chi2", {"name": "cusum"}), "end_at_alarm": False},
    "domain": {"domain": WORLDS, "target_heading_deg": "random"},
    "oracle": {"knowledge": "oracle", "detector": {"name": "ewma", "false_alarm": 0.05}},
    "worst": {"target_heading_deg": "worst", "twin": True},
    "interval": {"decision_interval_s": 1.0, "between": "linear"},
    "tracking-1m": {"attack": "tracking-1m", "receiver": "matched", "scenario": "realistic"},
    "meaconer": {"attack": "meaconer", "detector": {"name": "cusum"}},
    "all": {"twin": True, "watch": ("snapshot-chi2",), "domain": WORLDS, "attack": "tracking-1m"},
}
"""Settings of the main id that change what is simulated, or beside what."""


def short(name: str, **kwargs: object) -> dict[str, object]:
    return {**SMALL_WORLDS.get(name, {"timeline": SHORT}), **kwargs}


class Squeezed(gym.Env):
    """A vector environment of one, seen as a single one."""

    render_mode = None

    def __init__(self, name, **kwargs):
        self.env = gym.make_vec(name, num_envs=1, autoreset_mode="next_step", **kwargs)
        self.observation_space = self.env.single_observation_space
        self.action_space = self.env.single_action_space

    @staticmethod
    def _plain(info):
        return {name: info[name].item() for name in info if not name.startswith("_")}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        observation, info = self.env.reset(seed=seed)
        return observation[0], self._plain(info)

    def step(self, action):
        observation, *rest, info = self.env.step(np.asarray(action)[None])
        return observation[0], *(part[0].item() for part in rest), self._plain(info)


def assert_same(one, other, where):
    """Equal to the last bit, with dicts and arrays of arrays inside."""
    if isinstance(one, dict):
        assert one.keys() == other.keys(), where
        for key, value in one.items():
            assert_same(value, other[key], f"{where} {key}")
    elif isinstance(one, np.ndarray) and one.dtype == object:
        for mine, theirs in zip(one, other, strict=True):
            assert_same(mine, theirs, where)
    else:
        np.testing.assert_array_equal(one, other, err_msg=where)


def play_on(env, first, steps):
    """All that happens in some steps, the next episode of a single environment begun at an end."""
    happened = {}
    for k in range(first, first + steps):
        result = env.step(trajectories.action_at(k, env.action_space.shape))
        happened[k] = dict(enumerate(result))
        if isinstance(env, gym.Env) and (result[2] or result[3]):
            happened[k]["begun"] = dict(enumerate(env.reset()))
    return happened


def test_the_tasks_are_among_the_ids():
    assert {task.env_id for task in TASKS.values()} < set(IDS)
    assert {*SMALL_WORLDS, *ELSEWHERE} < set(IDS)


@pytest.mark.parametrize("name", sorted({*IDS} - ELSEWHERE))
def test_gymnasium_check_env(name):
    # a warning is an error here, so that the advice of the checker counts, too
    env = gym.make(name, **short(name)).unwrapped
    assert env.spec is not None
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize("name", IDS)
def test_stable_baselines3_check_env(name):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gym.make(name, **short(name)).unwrapped, warn=True)


@pytest.mark.parametrize("name", IDS)
def test_the_vector_env_of_one_is_the_single_env(name):
    kwargs = short(name)
    env = gym.make(name, **kwargs).unwrapped
    check_environments_match(env, Squeezed(name, **kwargs), num_steps=30, seed=7)


@pytest.mark.parametrize("kwargs", VARIANTS.values(), ids=VARIANTS)
def test_the_vector_env_of_one_is_the_single_env_at(kwargs):
    kwargs = {"timeline": SHORT, **kwargs}
    env = gym.make(MAIN, **kwargs).unwrapped
    check_environments_match(env, Squeezed(MAIN, **kwargs), num_steps=30, seed=7)


@pytest.mark.parametrize("name", IDS)
def test_the_spec_goes_through_json(name):
    """Of the id as it is, and with settings; the single and the vector form."""
    spec = gym.spec(name)
    assert EnvSpec.from_json(spec.to_json()) == spec
    kwargs = json.loads(json.dumps(short(name)))
    env = gym.make(name, **kwargs)
    envs = gym.make_vec(name, num_envs=2, **kwargs)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    many = gym.make_vec(EnvSpec.from_json(envs.spec.to_json()))
    seen, _ = env.reset(seed=3)
    np.testing.assert_array_equal(again.reset(seed=3)[0], seen)
    np.testing.assert_array_equal(many.reset(seed=3)[0], envs.reset(seed=3)[0])
    np.testing.assert_array_equal(many.reset(seed=3)[0][0], seen)


def played_on(name: str) -> dict[str, object]:
    """Settings with which an alarm ends no episode; a detector that learns gives none at rest."""
    return short(name, **({} if "DetectorView" in name else {"end_at_alarm": False}))


@pytest.mark.parametrize("name", IDS)
def test_an_env_made_from_its_spec_is_the_same_to_the_last_step(name):
    """With the length of an episode as its limit, a `TimeLimit` would truncate at the last step."""
    env = gym.make(name, **played_on(name))
    again = gym.make(env.spec)
    steps = env.unwrapped.core.episode_steps
    assert gym.spec(name).max_episode_steps is None
    assert env.spec.max_episode_steps == again.spec.max_episode_steps == steps + 1
    assert "TimeLimit" not in str(env)
    assert "TimeLimit" in str(again)
    action = np.zeros(env.action_space.shape, dtype=np.float32)
    for _ in range(2):
        assert_same(dict(enumerate(env.reset(seed=3))), dict(enumerate(again.reset(seed=3))), name)
        for step in range(1, steps + 1):
            mine, theirs = env.step(action), again.step(action)
            assert_same(dict(enumerate(mine)), dict(enumerate(theirs)), f"{name}, step {step}")
            assert mine[2:4] == (step == steps, False)


@pytest.mark.parametrize("name", IDS)
def test_a_vector_env_made_from_its_spec_is_the_same(name):
    kwargs = {**played_on(name), "num_envs": 2, "autoreset_mode": "same_step"}
    envs = gym.make_vec(name, **kwargs)
    again = gym.make_vec(gym.make_vec(envs.spec).spec)
    steps = envs.core.episode_steps
    assert envs.spec == again.spec
    assert envs.spec.max_episode_steps == steps + 1
    single = gym.make(name, **played_on(name))
    assert gym.make_vec(single.spec, num_envs=2).spec.max_episode_steps == steps + 1
    envs.reset(seed=3)
    again.reset(seed=3)
    action = np.zeros(envs.action_space.shape, dtype=np.float32)
    for step in range(1, steps + 3):
        mine, theirs = envs.step(action), again.step(action)
        assert_same(dict(enumerate(mine)), dict(enumerate(theirs)), f"{name}, step {step}")
        assert mine[2].tolist() == [step == steps] * 2
        assert not mine[3].any()
    for limit in (steps, 1.5):
        with pytest.raises(ValueError, match=rf"`max_episode_steps` must be .* got {limit}"):
            gym.make_vec(name, max_episode_steps=limit, **kwargs)


@pytest.mark.parametrize("name", IDS)
def test_a_seed_may_be_one_of_numpy(name):
    env, envs = gym.make(name, **short(name)), gym.make_vec(name, num_envs=2, **short(name))
    expected = env.reset(seed=3)[0]
    np.testing.assert_array_equal(env.reset(seed=np.int64(3))[0], expected)
    assert env.unwrapped.np_random_seed == 3
    each = envs.reset(seed=3)[0]
    for seed in (np.uint16(3), [np.int64(3), 4], np.array([3, 4])):
        np.testing.assert_array_equal(envs.reset(seed=seed)[0], each)
    envs.reset(seed=np.int64(3))
    assert envs.np_random_seed == 3


CASES = [(name, {}) for name in IDS] + [(MAIN, kwargs) for kwargs in VARIANTS.values()]


@pytest.mark.parametrize("count", [None, 3])
@pytest.mark.parametrize(("name", "kwargs"), CASES, ids=[*IDS, *VARIANTS])
def test_an_unfinished_episode_survives_pickling(name, kwargs, count):
    kwargs = short(name, **kwargs)
    if count is None:
        env = gym.make(name, **kwargs).unwrapped
    else:
        env = gym.make_vec(name, num_envs=count, autoreset_mode="same_step", **kwargs)
    env.reset(seed=5)
    play_on(env, 0, 5)
    copy = pickle.loads(pickle.dumps(env))
    assert_same(play_on(env, 5, 8), play_on(copy, 5, 8), name)
    np.testing.assert_array_equal(env.reset()[0], copy.reset()[0])


@pytest.mark.parametrize("kwargs", VARIANTS.values(), ids=VARIANTS)
def test_a_receiver_is_the_same_in_any_batch_and_with_any_threads(kwargs):
    kwargs = {"timeline": SHORT, "autoreset_mode": "same_step", **kwargs}
    few = gym.make_vec(MAIN, num_envs=3, threads=1, **kwargs)
    many = gym.make_vec(MAIN, num_envs=19, threads=2, **kwargs)
    np.testing.assert_array_equal(few.reset(seed=20)[0], many.reset(seed=4)[0][16:])
    for k in range(25):
        action = trajectories.action_at(k, many.action_space.shape)
        mine, theirs = few.step(action[16:]), many.step(action)
        for one, other in zip(mine[:4], theirs[:4], strict=True):
            np.testing.assert_array_equal(one, other[16:])


SOME = ("DetectorView-v0", "LooselyCoupled-v0", "RandomStart-v0", "Snapshot-v0", "duel_v0-aec")
REMOTE = """
import sys
from tests.golden.trajectories import cases, digest
table = cases()
for name in sys.argv[1:]:
    print(digest(table[name]()))
"""


def test_trajectories_are_the_same_in_another_process():
    """In another order, with other hashes of strings."""
    table = trajectories.cases()
    here = [trajectories.digest(table[name]()) for name in SOME]
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    command = [sys.executable, "-c", REMOTE, *reversed(SOME)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == here[::-1]


def test_processes_of_async_vector_env_after_threads_in_the_parent():
    """A forked child can compute, though its parent has run kernels in threads."""
    kwargs = {"timeline": SHORT}
    threaded = gym.make_vec(MAIN, num_envs=33, threads=2, **kwargs)
    expected, _ = threaded.reset(seed=8)
    action = trajectories.action_at(0, threaded.action_space.shape)
    stepped = threaded.step(action)
    processes = gym.make_vec(MAIN, num_envs=2, vectorization_mode="async", **kwargs)
    try:
        np.testing.assert_array_equal(processes.reset(seed=8)[0], expected[:2])
        observation, reward, *_ = processes.step(action[:2])
        np.testing.assert_array_equal(observation, stepped[0][:2])
        np.testing.assert_array_equal(reward, stepped[1][:2])
    finally:
        processes.close()
    again = threaded.step(action)  # nor are the parent's threads disturbed
    assert threaded.observation_space.contains(again[0])


def play_parallel(env, rounds):
    for k in range(rounds):
        actions = {a: trajectories.action_at(k, env.action_space(a).shape) for a in env.agents}
        yield {"step": dict(enumerate(env.step(actions)))}
        if not env.agents:
            yield {"begun": dict(enumerate(env.reset()))}


def play_aec(env, rounds):
    for k in range(2 * rounds):
        result, shape = env.last(), env.action_space(env.agent_selection).shape
        yield {env.agent_selection: dict(enumerate(result))}
        env.step(None if result[2] else trajectories.action_at(k, shape))
        if not env.agents:
            env.reset()


@pytest.mark.parametrize("kwargs", [VARIANTS["domain"], {"attack": "tracking-1m"}])
@pytest.mark.parametrize(
    ("make", "play"), [(duel_v0.parallel_env, play_parallel), (duel_v0.env, play_aec)]
)
def test_an_unfinished_duel_survives_pickling(make, play, kwargs):
    env = make(timeline=SHORT, **kwargs)
    env.reset(seed=6)
    assert list(play(env, 5))
    copy = pickle.loads(pickle.dumps(env))
    for mine, theirs in zip(play(env, 20), play(copy, 20), strict=True):
        assert_same(mine, theirs, "duel")
