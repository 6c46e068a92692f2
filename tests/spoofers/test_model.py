"""A model in memory as a spoofer."""

import copy
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.policies.card import Space
from spoofgym.spoofers.learned import ModelPolicy, inner_env, make_function, read_training_env

from .policies import BLIND


def test_a_copy_has_the_same_model_and_a_memory_of_its_own():
    class Heavy:
        def __deepcopy__(self, memo):
            raise AssertionError("a model must not be copied")

        def __call__(self, seen):
            return np.full((len(seen), 2), 3.0)

    policy = ModelPolicy(Heavy(), label="heavy")
    policy.bind(BLIND)
    twin = copy.deepcopy(policy)
    assert twin.model is policy.model
    assert not hasattr(twin, "memory")
    twin.bind(BLIND._replace(receivers=5))
    action = twin.act(np.zeros((5, 6), dtype=np.float32))
    np.testing.assert_array_equal(action, np.ones((5, 2)))  # cut to what can be commanded
    assert policy.context.receivers == 3


def test_it_refuses_other_observations_than_it_was_trained_on():
    bounds = {"low": BLIND.observation_low, "high": BLIND.observation_high}
    policy = ModelPolicy(len, observation=Space(names=BLIND.observation_names, **bounds))
    policy.bind(BLIND)
    names = (*BLIND.observation_names[:-1], "target_speed")
    with pytest.raises(ValueError, match=r"observation: time_left only where it was trained"):
        policy.bind(BLIND._replace(observation_names=names))


class Loaded:
    def __init__(self, env=None):
        self.get_env = lambda: env


def test_a_model_is_played_as_its_environment_says_however_that_was_made():
    pace = {"decision_interval_s": 10.0, "between": "linear"}
    env = gym.make("spoofgym/Zhong2025-v0", knowledge="tracking", **pace)
    found = read_training_env(Loaded(SimpleNamespace(envs=[env])))  # as of a DummyVecEnv
    assert found.items() >= {"knowledge": "tracking", **pace}.items()
    predicting = SimpleNamespace(predict=lambda seen, deterministic: (seen + deterministic, None))
    assert (make_function(predicting)(np.zeros((3, 6))) == 1.0).all()
    assert read_training_env(lambda seen: seen) == {}
    assert inner_env(None) is inner_env(object()) is None
    with pytest.warns(UserWarning, match="Loaded has no environment that can be read"):
        assert read_training_env(Loaded()) == {}
