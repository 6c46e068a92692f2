"""The environments of all victims: settings, names, commands, circumstances and records."""

from __future__ import annotations

import itertools
import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.detectors import Ewma
from spoofgym.envs import SpoofEnv, wrappers
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.loose import DEFAULT_DETECTOR as LOOSE
from spoofgym.simulation.robot import DEFAULT_DETECTOR as ROBOT

from .support import HOLD, ID, LIVE, SMALL, STEPS, VICTIMS, victim, victims

LOOPS: dict[str, Any] = {
    "Snapshot": "srv-raim",
    "WheeledRobot": ROBOT,
    "LooselyCoupled": {"name": "windowed-chi2", "window": 8},
}
"""The detector in the loop."""
every_victim = pytest.mark.parametrize("kind", VICTIMS)
every_small_one = pytest.mark.parametrize("kind", SMALL)


def pushed(env, east):
    action = np.zeros(env.action_space.shape)
    action[..., 1] = east
    return action


def trace(env, actions, seed=2):
    """What is seen and paid."""
    rows = [env.reset(seed=seed)[0]]
    for action in actions:
        observation, reward, *_, info = env.step(action)
        rows += [observation, reward, info["displacement_m"]]
    return rows


def assert_same(mine, theirs):
    for a, b in zip(mine, theirs, strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_defaults_are_what_the_architecture_says():
    env = gym.make(ID).unwrapped
    setup = env.core.setup
    assert (setup.onset, setup.steps, setup.hold) == (400, 300, 20)
    assert setup.detector.weight_scale == 0.3
    assert env.action_names == ("along_target_setpoint",)
    assert gym.spec(ID).max_episode_steps is None
    made = {kind: gym.make(f"spoofgym/{kind}-v0").unwrapped.core.setup.detector for kind in SMALL}
    names = [type(detector).__name__ for detector in made.values()]
    assert names == ["WindowedChi2", "SrvRaim", "Acna"]
    assert made["LooselyCoupled"].window == LOOSE["window"]
    env = SpoofEnv(detector=None, attack=None, knowledge=None, timeline=None)
    assert isinstance(env.core.setup.detector, Ewma)
    assert env.core.setup.timeline == TightlyCoupledSetup().timeline
    assert env.detector_setting is None


@every_victim
def test_knowledge_only_grows(kind):
    names = []
    for knowledge in ("blind", "tracking", "oracle"):
        env = victim(kind, knowledge=knowledge).unwrapped
        assert len(env.observation_names) == env.observation_space.shape[0]
        assert len(env.action_names) == env.action_space.shape[0]
        assert np.isfinite(env.observation_space.low).all()
        assert np.isfinite(env.observation_space.high).all()
        assert len(set(env.observation_names)) == len(env.observation_names)
        names.append(env.observation_names)
    for less, more in itertools.pairwise(names):
        assert more[: len(less)] == less != more
    assert all(name.startswith(("own_", "time_")) for name in names[0])
    assert not any(name.startswith(("statistic_", "error_", "weight_")) for name in names[1])
    assert {"error_north", "error_east"} < {*names[2]}


@every_small_one
def test_actions_along_and_across_the_target_are_those_of_the_axes(kind):
    heading = np.radians(30.0)
    kwargs = {"detector": "never", "target_heading_deg": 30.0}
    axes = victim(kind, **kwargs)
    both = victim(kind, **kwargs, action=["along-target", "across-target"])
    assert both.unwrapped.action_names == ("along_target_rate", "across_target_rate")
    parts = np.random.default_rng(0).uniform(-0.6, 0.6, (5, 2))
    north_east = np.zeros((5, axes.action_space.shape[0]))
    north_east[:, 0] = parts[:, 0] * np.cos(heading) + parts[:, 1] * np.cos(heading + np.pi / 2)
    north_east[:, 1] = parts[:, 0] * np.sin(heading) + parts[:, 1] * np.sin(heading + np.pi / 2)
    assert_same(trace(both, parts), trace(axes, north_east))


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


GIVEN = {
    "LooselyCoupled": ({"domain": {"start_s": [0.0, 5.0]}}, {"start_s": 2.5}),
    "Snapshot": ({"domain": {"turned_deg": [0.0, 360.0], "worlds": 3}}, {"world": 2}),
    "WheeledRobot": ({"domain": {"start_s": [0.0, None]}}, {"start_s": 7.0}),
}


@every_small_one
def test_a_reset_may_be_given_the_circumstances(kind):
    settings, given = GIVEN[kind]
    settings = {**settings, "target_heading_deg": "random", "knowledge": "tracking"}
    envs, other = victims(kind, 6, **settings), victims(kind, 6, **settings)
    drawn, _ = envs.reset(seed=1)
    names = envs.observation_names
    shown = drawn[:, [names.index(f"target_direction_{axis}") for axis in ("north", "east")]]
    np.testing.assert_allclose(np.hypot(*shown.T), 1.0, atol=1e-6)
    memory = envs.core.engine.simulator.memory
    assert len(set(memory["first"])) > 1
    np.testing.assert_allclose(
        np.arctan2(*shown.T[::-1]) % (2 * np.pi), envs.core.heading_rad % (2 * np.pi), atol=1e-6
    )
    _, info = envs.reset(options={"domain": {**given, "target_heading_deg": 45.0}})
    np.testing.assert_allclose(envs.core.heading_rad, np.radians(45.0))
    assert len(set(memory["first"])) == 1
    if "start_s" in given:
        np.testing.assert_allclose(info["time_s"], given["start_s"] + 2 * LIVE * VICTIMS[kind])
    # the next episodes draw again, and are those of an environment that was given nothing
    other.reset(seed=1)
    other.reset()
    np.testing.assert_array_equal(other.reset()[0], envs.reset()[0])


@every_small_one
def test_own_observations_are_those_of_the_simulator(kind):
    own = ["own-command", "time", "estimate-error", {"name": "statistic-ratio", "largest": True}]
    env = victim(kind, observation=own, detector=LOOPS[kind]).unwrapped
    seen, _ = env.reset(seed=3)
    for k in range(4):
        named = dict(zip(env.observation_names, seen.tolist(), strict=True))
        assert named["time_since_onset"] == pytest.approx(k / STEPS)
        assert named["time_left"] == pytest.approx(1.0 - k / STEPS)
        error = env.core.engine.simulator.error_n()[0] / 40.0
        first = env.observation_names.index("error_north")
        np.testing.assert_allclose(seen[first : first + len(error)], error, rtol=1e-6)
        ratio = env.core.engine.simulator.ratio()[0]
        assert seen[-1] == pytest.approx(min(ratio, 10.0), rel=1e-6)
        seen = env.step(pushed(env, 0.1))[0]


@every_small_one
def test_every_epoch_of_the_commands_is_written(kind, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    interval_s = round(3.0 * VICTIMS[kind], 6)
    env = victim(kind, detector="never", decision_interval_s=interval_s)
    env = wrappers.RecordEpochs(env, tmp_path)
    env.reset(seed=3)
    over = False
    while not over:
        *_, over, _, info = env.step(pushed(env, 0.2))
    env.close()
    table = parquet.read_table(tmp_path / "receiver-000-episode-000000.parquet")
    assert json.loads(table.schema.metadata[b"spoofgym"])["complete"]
    assert table["step"].to_pylist() == list(range(1, STEPS + 1))
    time_s = VICTIMS[kind] * (2 * LIVE + np.arange(1, STEPS + 1))
    np.testing.assert_allclose(table["time_s"].to_pylist(), time_s)
    assert info["time_s"] == pytest.approx(time_s[-1] + HOLD * VICTIMS[kind])
    commanded = np.array(table["commanded_displacement_m"].to_pylist())
    assert (np.diff(commanded[:, 1]) > 0.0).all()
    assert ("visible" in table.column_names) == (kind == "Snapshot")
    width = {"Snapshot": 24, "WheeledRobot": 2, "LooselyCoupled": 3}[kind]
    assert np.array(table["innovation"].to_pylist()).shape == (STEPS, width)
