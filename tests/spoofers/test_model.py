"""A model in memory as a spoofer."""

from __future__ import annotations

import copy
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.policies.card import Space
from spoofgym.spoofers.learned import ModelPolicy, inner_env, make_function, read_training_env

from .policies import BLIND

SPACE = Space(names=BLIND.observation_names, low=BLIND.observation_low, high=BLIND.observation_high)


def quiet(seen):
    return np.zeros((len(seen), 2))


def test_a_copy_has_the_same_model_and_a_memory_of_its_own():
    class Heavy:
        def __deepcopy__(self, memo):
            raise AssertionError("a model must not be copied")

        def __call__(self, seen):
            return quiet(seen)

    policy = ModelPolicy(Heavy(), label="heavy")
    policy.bind(BLIND)
    twin = copy.deepcopy(policy)
    assert twin.model is policy.model
    assert not hasattr(twin, "memory")
    twin.bind(BLIND._replace(receivers=5))
    assert twin.act(np.zeros((5, 6), dtype=np.float32)).shape == (5, 2)
    assert policy.context.receivers == 3


def test_it_refuses_other_observations_than_it_was_trained_on():
    policy = ModelPolicy(quiet, observation=SPACE)
    policy.bind(BLIND)
    names = (*BLIND.observation_names[:-1], "target_speed")
    with pytest.raises(ValueError, match=r"observation: time_left only where it was trained"):
        policy.bind(BLIND._replace(observation_names=names))


def test_it_is_cut_to_what_can_be_commanded():
    policy = ModelPolicy(lambda seen: np.full((len(seen), 2), 3.0))
    policy.bind(BLIND)
    assert (policy.act(np.zeros((3, 6), dtype=np.float32)) == 1.0).all()


def test_models_of_other_libraries_have_predict():
    class Other:
        def predict(self, seen, deterministic):
            assert deterministic
            return np.ones((len(seen), 2)), None

    assert (make_function(Other())(np.zeros((3, 6))) == 1.0).all()


def test_there_may_be_no_environment_inside():
    assert inner_env(None) is None
    assert inner_env(object()) is None


class Loaded:
    """A model of stable-baselines3, as far as its environment is asked for."""

    def __init__(self, env=None):
        self.env = env

    def get_env(self):
        return self.env


def test_a_model_is_played_as_its_environment_says_however_that_was_made():
    pace = {"decision_interval_s": 10.0, "between": "linear"}
    env = gym.make("spoofgym/TightlyCoupled-v0", knowledge="tracking", **pace)
    found = read_training_env(Loaded(SimpleNamespace(envs=[env])))  # as of a DummyVecEnv
    assert found.items() >= {"knowledge": "tracking", **pace}.items()
    assert read_training_env(lambda seen: seen) == {}


def test_a_model_that_was_loaded_without_an_environment_is_warned_of():
    with pytest.warns(UserWarning, match="Loaded has no environment that can be read"):
        assert read_training_env(Loaded()) == {}
