"""A policy in a file, bit for bit in any batch, and a model in memory as a spoofer."""

import copy
import hashlib
import multiprocessing
import os
import pickle
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from spoofgym.policies.card import Space, SpooferCard
from spoofgym.spoofers import OnnxPolicy, make_spoofer
from spoofgym.spoofers.learned import ModelPolicy, inner_env, make_function, read_training_env
from spoofgym.testing import check_spoofer

from .policies import BLIND, context_of, network, write_policy


def observations(count, size=6):
    return np.random.default_rng(3).uniform(-2.0, 2.0, (count, size)).astype(np.float32)


def bound(path, receivers=3):
    policy = OnnxPolicy(str(path))
    policy.bind(BLIND._replace(receivers=receivers))
    policy.reset()
    return policy


def test_it_does_what_the_network_says(tmp_path):
    path = write_policy(tmp_path, knowledge="tracking")
    policy = make_spoofer(str(path))
    size = len(policy.card.observation.names)
    policy.bind(context_of(500, "tracking"))
    seen = observations(500, size)
    tensors = onnx.load(path).graph.initializer
    weights = {item.name: numpy_helper.to_array(item).astype(np.float64) for item in tensors}
    h = seen.astype(np.float64)
    for k in range(2):
        h = np.tanh(h @ weights[f"w{k}"].T + weights[f"b{k}"])
    expected = np.clip(h @ weights["w2"].T + weights["b2"], -1.0, 1.0)
    turned = np.asfortranarray(seen)
    turned.flags.writeable = False
    for given in (seen, turned):
        action = policy.act(given)
        assert action.dtype == np.float64
        assert action.flags.c_contiguous
        np.testing.assert_allclose(action, expected, atol=1e-6)
    assert np.abs(action).max() == 1.0  # some are clipped
    said = (policy.knowledge, policy.label, policy.designed_on)
    assert said == ("tracking", "tiny", "ewma, zhong2025")
    assert policy.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert policy.card == SpooferCard.load(path.with_suffix(".json"))
    assert policy == OnnxPolicy(str(path), policy.sha256)
    check_spoofer(str(path))


def test_an_observation_of_a_single_environment_is_refused_with_what_to_do(tmp_path):
    policy = bound(write_policy(tmp_path))
    seen = observations(3, len(policy.card.observation.names))
    with pytest.raises(ValueError, match=r"must be \(B, o\), not .*act\(observation\[None\]\)"):
        policy.act(seen[0])


@pytest.mark.parametrize(("inputs", "width"), [(6, 16), (61, 33)])
def test_the_bits_do_not_depend_on_the_batch(inputs, width, tmp_path):
    names = tuple(f"element_{k}" for k in range(inputs))
    told = BLIND._replace(observation_names=names, observation_low=(), observation_high=())

    def card(fields):
        fields["observation"] = {"names": names, "low": [-10.0] * inputs, "high": [10.0] * inputs}

    path = write_policy(tmp_path, model=lambda _: network(inputs, 2, width=width), card=card)
    policy = OnnxPolicy(str(path))
    seen = observations(1024, inputs)
    policy.bind(told._replace(receivers=1024))
    whole = policy.act(seen)
    for size in (1, 7, 8, 17, 257, 1023):
        policy.bind(told._replace(receivers=size))
        for begin in range(0, 1024 - size + 1, max(size, 101)):
            part = policy.act(seen[begin : begin + size])
            assert part.tobytes() == whole[begin : begin + size].tobytes(), (size, begin)


def test_a_copy_needs_no_file(tmp_path):
    path, seen = write_policy(tmp_path), observations(3)
    policy = bound(path)
    path.unlink()  # its content is kept in memory
    for other in (copy.deepcopy(policy), pickle.loads(pickle.dumps(policy))):
        assert other.act(seen).tobytes() == policy.act(seen).tobytes()
        assert other == policy


def _in_child(policy, seen, queue):
    before = policy.model._session
    queue.put((policy.act(seen).tobytes(), policy.model._session is before))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # a fork in a process with threads
def test_a_forked_child_makes_its_own_session(tmp_path):
    policy, seen = bound(write_policy(tmp_path)), observations(3)
    mine = policy.act(seen).tobytes()
    session = policy.model._session
    context = multiprocessing.get_context("fork")
    queue = context.SimpleQueue()
    child = context.Process(target=_in_child, args=(policy, seen, queue))
    child.start()
    assert queue.get() == (mine, False)
    child.join()
    assert child.exitcode == 0
    assert policy.model._session is session


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
