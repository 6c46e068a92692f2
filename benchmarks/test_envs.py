"""Steps and resets of the environments, as a learner calls them."""

import gymnasium as gym
import numpy as np
import pytest

import spoofgym  # noqa: F401  (registers the ids)

from .perf import ENV, SETTINGS


@pytest.fixture(scope="module")
def single():
    env = gym.make(ENV, **SETTINGS)
    env.reset(seed=0)
    yield env
    env.close()


@pytest.fixture(scope="module", params=[64, 256])
def vector(request):
    envs = gym.make_vec(ENV, num_envs=request.param, **SETTINGS)
    envs.reset(seed=0)
    yield envs
    envs.close()


def test_single_episode(benchmark, single):
    action = np.zeros(single.action_space.shape, dtype=np.float32)

    def episode():
        single.reset()
        over = False
        while not over:
            _, _, terminated, truncated, _ = single.step(action)
            over = terminated or truncated

    benchmark(episode)


def test_single_reset(benchmark, single):
    benchmark(single.reset)


def test_vector_steps_with_warm_ups(benchmark, vector):
    """151 steps: an episode, and the step that starts the next ones."""
    actions = np.zeros(vector.action_space.shape, dtype=np.float32)

    def episode():
        over = False
        while not over:
            _, _, terminated, truncated, _ = vector.step(actions)
            over = (terminated | truncated).any()
        vector.step(actions)

    benchmark.pedantic(episode, rounds=5, warmup_rounds=1)


def test_vector_reset(benchmark, vector):
    benchmark.pedantic(vector.reset, kwargs={"seed": 0}, rounds=5)


def test_stable_baselines3(benchmark):
    """150 steps of 64 receivers, an episode with the start of the next."""
    pytest.importorskip("stable_baselines3")
    from spoofgym.sb3 import SpoofVecEnv

    envs = SpoofVecEnv(64, **SETTINGS)
    envs.reset()
    actions = np.zeros((64, *envs.action_space.shape), dtype=np.float32)

    def episode():
        over = False
        while not over:
            _, _, done, _ = envs.step(actions)
            over = done.any()

    benchmark.pedantic(episode, rounds=5, warmup_rounds=1)
    envs.close()
