"""Every small environment keeps the contracts of Gymnasium, with its own plant."""

from __future__ import annotations

import inspect
import json
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import spoofgym  # noqa: F401  (registers the ids)
from spoofgym.detectors import Detector, Verdict

SMALL = {
    "spoofgym/LooselyCoupled-v0": 0.1,
    "spoofgym/Snapshot-v0": 1.0,
    "spoofgym/WheeledRobot-v0": 1.0,
}
"""Ids, and the interval of their epochs [s]."""
KNOWLEDGE = ("blind", "tracking", "oracle")


def short(name, **settings):
    """Settings of an episode of 24 commands, and of a detector that has settled by then."""
    interval = SMALL[name]
    parts = {"warmup_s": 10, "live_s": 10, "attack_s": 24, "time_to_alert_s": 5}
    settings["timeline"] = {key: count * interval for key, count in parts.items()}
    if name == "spoofgym/LooselyCoupled-v0" and settings.get("detector") is None:
        settings["detector"] = {"name": "windowed-chi2", "window": 8}
    return settings


@pytest.fixture(params=SMALL)
def name(request):
    return request.param


class Sooner(Detector):
    """Alarms when the first innovation has been large for a time that differs by receiver."""

    paper = "groves2013"
    measures = "any"

    def bind(self, context):
        super().bind(context)
        self.memory.declare("total", np.zeros(context.receivers))

    def judge(self, epoch):
        measured = epoch.pseudorange if epoch.visible.shape[1] else epoch.innovation
        self.memory["total"] = self.memory["total"] + np.abs(measured[:, 0] * 1e3) % 1.0
        statistic = self.memory["total"][:, None].copy()
        threshold = np.full_like(statistic, 16.0)
        return Verdict(statistic, threshold, statistic > threshold)


@pytest.mark.parametrize("knowledge", KNOWLEDGE)
def test_gymnasium_check_env(name, knowledge):
    # a warning is an error here, so that the advice of the checker counts, too;
    # pictures, which knowledge has no part in, are checked in `rendering`
    env = gym.make(name, **short(name, knowledge=knowledge)).unwrapped
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize("detector", [None, Sooner()], ids=["own", "early"])
@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_the_vector_env_is_the_single_ones(name, mode, detector):
    """Bit for bit over autoresets, with receivers in different phases."""
    kwargs = short(name, knowledge="oracle", detector=detector)
    envs = gym.make_vec(name, num_envs=5, autoreset_mode=mode, **kwargs)
    seen, _ = envs.reset(seed=30)
    singles = [gym.make(name, **kwargs).unwrapped for _ in range(5)]
    for i, env in enumerate(singles):
        np.testing.assert_array_equal(env.reset(seed=30 + i)[0], seen[i])
    rng = np.random.default_rng(3)
    over = np.zeros(5, dtype=bool)
    ends = 0
    for _ in range(56):
        action = rng.uniform(-0.2, 0.4, envs.action_space.shape)
        observations, reward, terminated, _, _ = envs.step(action)
        for i, env in enumerate(singles):
            if mode == "next_step" and over[i]:
                observation, r, end = env.reset()[0], 0.0, False
            else:
                observation, r, end, _, info = env.step(action[i])
                assert all(np.isfinite(value) for value in info.values())
                if mode == "same_step" and end:
                    observation = env.reset()[0]
            np.testing.assert_array_equal(observation, observations[i])
            assert (reward[i], terminated[i]) == (r, end)
            over[i] = end
            ends += end
    assert ends >= 10


def test_a_push_without_a_defence_moves_the_victim(name):
    env = gym.make(name, **short(name, detector="never", target_heading_deg=0.0))
    moved = []
    for push in (0.0, 0.5):
        env.reset(seed=2)
        action = np.zeros(env.action_space.shape)
        action[0] = push
        for _ in range(24):
            *_, terminated, _, info = env.step(action)
        assert terminated
        moved.append(info["displacement_m"])
    assert moved[1] > moved[0] + 0.1 * SMALL[name]
    assert info["undetected_displacement_m"] >= info["displacement_m"]


def test_an_unfinished_episode_survives_pickling(name):
    env = gym.make_vec(name, num_envs=2, **short(name, knowledge="oracle"))
    env.reset(seed=5)
    action = np.full(env.action_space.shape, 0.2)
    for _ in range(4):
        env.step(action)
    other = pickle.loads(pickle.dumps(env))
    for _ in range(4):
        np.testing.assert_array_equal(env.step(action)[0], other.step(action)[0])


def test_names_bounds_and_settings(name):
    names = []
    for knowledge in KNOWLEDGE:
        env = gym.make(name, **short(name, knowledge=knowledge)).unwrapped
        assert len(env.observation_names) == env.observation_space.shape[0]
        assert len(env.action_names) == env.action_space.shape[0]
        names.append(set(env.observation_names))
    assert names[0] < names[1] < names[2]
    assert all(each.startswith(("own_", "time_")) for each in names[0])
    settings = inspect.signature(type(env)).parameters
    assert "rate_limit_mps" in settings
    with pytest.raises(ValueError, match=r"has no setting 'rate'; valid: .*rate_limit_mps"):
        gym.make(name, rate=1.0)
    spec = gym.make(name, **short(name, knowledge="blind")).spec
    again = gym.make(gym.envs.registration.EnvSpec.from_json(spec.to_json()))
    assert json.loads(spec.to_json())["id"] == name
    assert again.unwrapped.game.knowledge == "blind"
