"""The environments of all victims: settings, names, commands, circumstances and records."""

import itertools

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.detectors import Ewma
from spoofgym.envs import SpoofEnv
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.robot import DEFAULT_DETECTOR as ROBOT

from .support import ID, LIVE, STEPS, VICTIMS, victim, victims

every_victim = pytest.mark.parametrize("kind", VICTIMS)


def test_none_is_the_default():
    env = SpoofEnv(detector=None, attack=None, knowledge=None, timeline=None)
    assert isinstance(env.core.setup.detector, Ewma)
    assert env.core.setup.timeline == TightlyCoupledSetup().timeline
    assert env.detector_setting is None
    assert gym.spec(ID).max_episode_steps is None


@every_victim
def test_knowledge_only_grows(kind):
    blind, tracking, oracle = names = [
        victim(kind, knowledge=word).unwrapped.observation_names
        for word in ("blind", "tracking", "oracle")
    ]
    for less, more in itertools.pairwise(names):
        assert more[: len(less)] == less != more
    assert all(name.startswith(("own_", "time_")) for name in blind)
    assert not any(name.startswith(("statistic_", "error_", "weight_")) for name in tracking)
    assert {"error_north", "error_east"} < {*oracle}


@every_victim
def test_actions_along_and_across_the_target_are_those_of_the_turned_axes(kind):
    heading, kwargs = np.radians(30.0), {"detector": "never", "target_heading_deg": 30.0}
    axes = victim(kind, **kwargs)
    both = victim(kind, **kwargs, action=["along-target", "across-target"])
    word = "acceleration" if kind == "Zhong2025" else "rate"
    assert both.unwrapped.action_names == (f"along_target_{word}", f"across_target_{word}")
    seen = [env.reset(seed=2)[0] for env in (both, axes)]
    for along, across in np.random.default_rng(0).uniform(-0.6, 0.6, (20, 2)):
        given = np.zeros(axes.action_space.shape)
        given[0] = along * np.cos(heading) - across * np.sin(heading)
        given[1] = along * np.sin(heading) + across * np.cos(heading)
        mine, theirs = both.step([along, across]), axes.step(given)
        for a, b in ((mine[0], theirs[0]), (mine[1], theirs[1]), seen):
            np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "action", "given", "rate"),
    [
        ("WheeledRobot", ["full-command", "along-target"], [-0.2, 1.0, 1.0], [-0.2, 1.0]),
        ("Snapshot", {"name": "channels", "ids": ["east", "clock"]}, [0.5, -1], [0, 2.5, 0, -5]),
    ],
)
def test_a_sum_of_commands_is_cut_to_what_the_victim_takes(kind, action, given, rate):
    env = victim(kind, action=action, detector="never")
    env.reset(seed=1)
    env.step(given)
    found = env.unwrapped.core.engine.simulator.commanded_rate[0]
    np.testing.assert_allclose(found, rate, atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "domain", "given"),
    [
        ("LooselyCoupled", {"start_s": [0.0, 5.0]}, {"start_s": 2.5}),
        ("Snapshot", {"turned_deg": [0.0, 360.0], "worlds": 3}, {"world": 2}),
        ("WheeledRobot", {"start_s": [0.0, None]}, {"start_s": 7.0}),
    ],
)
def test_a_reset_may_be_given_the_circumstances(kind, domain, given):
    settings = {"domain": domain, "target_heading_deg": "random", "knowledge": "tracking"}
    envs, other = victims(kind, 6, **settings), victims(kind, 6, **settings)
    drawn, _ = envs.reset(seed=1)
    first = envs.observation_names.index("target_direction_north")
    north, east = drawn[:, first : first + 2].T.astype(float)
    turn = np.arctan2(east, north) - envs.core.heading_rad
    np.testing.assert_allclose(np.hypot(north, east) * np.exp(1j * turn), 1.0, atol=1e-6)
    memory = envs.core.engine.simulator.memory
    assert len(set(memory["first"])) > 1
    _, info = envs.reset(options={"domain": {**given, "target_heading_deg": 45.0}})
    np.testing.assert_allclose(envs.core.heading_rad, np.radians(45.0))
    assert len(set(memory["first"])) == 1
    if "start_s" in given:
        np.testing.assert_allclose(info["time_s"], given["start_s"] + 2 * LIVE * VICTIMS[kind])
    # the next episodes draw again, and are those of an environment that was given nothing
    other.reset(seed=1)
    other.reset()
    np.testing.assert_array_equal(other.reset()[0], envs.reset()[0])


@pytest.mark.parametrize(
    ("kind", "detector"),
    [
        ("Snapshot", "srv-raim"),
        ("WheeledRobot", ROBOT),
        ("LooselyCoupled", {"name": "windowed-chi2", "window": 8}),
    ],
)
def test_own_observations_are_those_of_the_simulator(kind, detector):
    own = ["own-command", "time", "estimate-error", {"name": "statistic-ratio", "largest": True}]
    env = victim(kind, observation=own, detector=detector).unwrapped
    seen, _ = env.reset(seed=3)
    push = np.zeros(env.action_space.shape)
    push[1] = 0.1
    for k in range(4):
        named = dict(zip(env.observation_names, seen.tolist(), strict=True))
        assert named["time_since_onset"] == pytest.approx(k / STEPS)
        assert named["time_left"] == pytest.approx(1.0 - k / STEPS)
        error = env.core.engine.simulator.error_n()[0] / 40.0
        first = env.observation_names.index("error_north")
        np.testing.assert_allclose(seen[first : first + len(error)], error, rtol=1e-6)
        ratio = env.core.engine.simulator.ratio()[0]
        assert seen[-1] == pytest.approx(min(ratio, 10.0), rel=1e-6)
        seen = env.step(push)[0]
