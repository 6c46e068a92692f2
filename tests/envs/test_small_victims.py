"""The small environments have the terms, twins, domains and decisions of the others."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.envs import wrappers
from spoofgym.envs.wrappers import vector as vector_wrappers
from spoofgym.simulation.loose import DEFAULT_DETECTOR as LOOSE
from spoofgym.simulation.robot import DEFAULT_DETECTOR as ROBOT

from .support import HOLD, LIVE, SMALL, STEPS, VICTIMS, victim, victims

LOOPS = {
    "Snapshot": ("srv-raim", "srv_raim", 20.0),
    "WheeledRobot": (ROBOT, "acna", 1.0),
    "LooselyCoupled": ({"name": "windowed-chi2", "window": 8}, "windowed_chi2", 20.0),
}
"""The detector in the loop, its name where it is passive, and a rate that it notices."""
LENGTH = STEPS + 2
"""Epochs of an episode, with the step that starts the next one."""


@pytest.fixture(params=SMALL)
def kind(request):
    return request.param


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


# --- passive detectors -----------------------------------------------------------------------


def test_a_passive_detector_changes_nothing_and_sees_what_the_loop_sees(kind):
    loop, name, rate = LOOPS[kind]
    kwargs = {"knowledge": "oracle", "end": ["at-window-end"], "detector": loop}
    kwargs["rate_limit_mps"] = rate
    plain, passive = victims(kind, 5, **kwargs), victims(kind, 5, **kwargs, watch=[loop, "never"])
    np.testing.assert_array_equal(plain.reset(seed=1)[0], passive.reset(seed=1)[0])
    rng, alarms = np.random.default_rng(0), []
    pushes = np.linspace(0.0, 1.0, 5)[:, None]
    detected = np.zeros(5, dtype=bool)
    for _ in range(2 * LENGTH):
        action = pushes * rng.uniform(0.0, 1.0, plain.action_space.shape)
        mine, theirs = plain.step(action), passive.step(action)
        assert_same(mine[:4], theirs[:4])
        info, fresh = theirs[4], ~theirs[4].get("_alarm", np.zeros(5, dtype=bool))
        np.testing.assert_array_equal(info[f"watch_{name}_warmup_alarm"], info["warmup_alarm"])
        if fresh.all():
            detected[:] = False
            continue
        np.testing.assert_array_equal(info[f"watch_{name}_alarm"], info["alarm"])
        now = info[f"watch_{name}_ratio"] > 1.0
        # the alarm of the last step may be one of the time to alert
        assert (now <= info["alarm"]).all()
        assert not info["watch_never_alarm"].any()
        detected |= info["alarm"]
        alarms.append(detected.copy())
    assert np.any(alarms)
    assert not np.all(alarms[0])


# --- commands --------------------------------------------------------------------------------


def test_an_action_along_the_target_is_that_of_its_axes(kind):
    heading = np.radians(30.0)
    kwargs = {"detector": "never", "target_heading_deg": 30.0}
    kwargs["observation"] = ["own-command", "time", "estimate-error"]
    axes = victim(kind, **kwargs)
    both = victim(kind, **kwargs, action=["along-target", "across-target"])
    assert both.unwrapped.action_names == ("along_target_rate", "across_target_rate")
    parts = np.random.default_rng(0).uniform(-0.6, 0.6, (5, 2))
    width = axes.action_space.shape[0]
    north_east = np.zeros((5, width))
    north_east[:, 0] = parts[:, 0] * np.cos(heading) + parts[:, 1] * np.cos(heading + np.pi / 2)
    north_east[:, 1] = parts[:, 0] * np.sin(heading) + parts[:, 1] * np.sin(heading + np.pi / 2)
    assert_same(trace(both, parts), trace(axes, north_east))


def test_a_sum_of_commands_is_cut_to_what_the_victim_takes():
    env = victim("WheeledRobot", action=["full-command", "along-target"], detector="never")
    env.reset(seed=1)
    env.step([-0.2, 1.0, 1.0])
    rate = env.unwrapped.core.engine.simulator.commanded_rate[0]
    np.testing.assert_allclose(rate, [-0.2, 1.0], atol=1e-12)


def test_some_axes_of_a_snapshot_receiver():
    env = victim("Snapshot", action={"name": "channels", "ids": ["east", "clock"]})
    assert env.unwrapped.action_names == ("east_rate", "clock_rate")
    env.reset(seed=1)
    env.step([0.5, -1.0])
    rate = env.unwrapped.core.engine.simulator.commanded_rate[0]
    np.testing.assert_array_equal(rate, [0.0, 2.5, 0.0, -5.0])


@pytest.mark.parametrize(
    ("kind", "kwargs", "message"),
    [
        ("LooselyCoupled", {"action": "common-offset"}, "per channel, 'per-channel', got 'loose'"),
        (
            "Snapshot",
            {"action": "along-target", "rate_limit_mps": [5.0, 2.0, 5.0, 5.0]},
            "needs the same limit north and east, got 5 and 2",
        ),
        (
            "WheeledRobot",
            {"action": {"name": "channels", "ids": ["clock"]}},
            "no channel 'clock' to command; valid: north, east",
        ),
        ("WheeledRobot", {"watch": "ewma"}, "Ewma measures satellites, but the receiver measures"),
        ("LooselyCoupled", {"detector": "raim"}, "Raim measures satellites, but the receiver me"),
        ("Snapshot", {"watch": ["never", "rio"]}, "Rio needs .*, which a snapshot receiver does"),
        ("LooselyCoupled", {"watch": {"name": "windowed-chi2", "window": 900}}, "shorten its"),
        (
            "WheeledRobot",
            {"observation": "satellite-geometry"},
            "a wheeled robot has no satellites to observe",
        ),
        (
            "WheeledRobot",
            {"domain": {"imu": ["tactical"]}},
            "`domain` has no 'imu' for a wheeled robot; valid: start_s",
        ),
        (
            "Snapshot",
            {"domain": {"start_s": [0.0, 5.0]}},
            "`domain` has no 'start_s' for a snapshot receiver; valid: constellation_time_s, turn",
        ),
    ],
)
def test_what_a_victim_does_not_have_is_refused(kind, kwargs, message):
    with pytest.raises(ValueError, match=message):
        victim(kind, **kwargs)


# --- twins, decisions, domains, targets ------------------------------------------------------


GIVEN = {
    "LooselyCoupled": ({"domain": {"start_s": [0.0, 5.0]}}, {"start_s": 2.5}),
    "Snapshot": ({"domain": {"turned_deg": [0.0, 360.0], "worlds": 3}}, {"world": 2}),
    "WheeledRobot": ({"domain": {"start_s": [0.0, None]}}, {"start_s": 7.0}),
}


def test_a_reset_may_be_given_the_circumstances(kind):
    settings, given = GIVEN[kind]
    settings = {**settings, "target_heading_deg": "random", "knowledge": "tracking"}
    envs = victims(kind, 6, **settings)
    drawn, _ = envs.reset(seed=1)
    names = envs.observation_names
    shown = drawn[:, [names.index(f"target_direction_{axis}") for axis in ("north", "east")]]
    np.testing.assert_allclose(np.hypot(*shown.T), 1.0, atol=1e-6)
    memory = envs.core.engine.simulator.memory
    assert len(set(memory["first"])) > 1
    _, info = envs.reset(options={"domain": {**given, "target_heading_deg": 45.0}})
    np.testing.assert_allclose(envs.core.heading_rad, np.radians(45.0))
    assert len(set(memory["first"])) == 1
    if "start_s" in given:
        np.testing.assert_allclose(info["time_s"], given["start_s"] + 2 * LIVE * VICTIMS[kind])
    # the next episodes draw again, and are those of an environment that was given nothing
    other = victims(kind, 6, **settings)
    other.reset(seed=1)
    other.reset()
    np.testing.assert_array_equal(other.reset()[0], envs.reset()[0])


def test_own_observations_are_those_of_the_default(kind):
    own = ["own-command", "time", "estimate-error", {"name": "statistic-ratio", "largest": True}]
    env = victim(kind, observation=own, detector=LOOPS[kind][0]).unwrapped
    default = victim(kind, knowledge="oracle", detector=LOOPS[kind][0]).unwrapped
    seen, expected = env.reset(seed=3)[0], default.reset(seed=3)[0]
    for _ in range(4):
        for name in env.observation_names:
            if name.startswith("time_"):
                mine = seen[env.observation_names.index(name)]
                assert mine == expected[default.observation_names.index(name)]
        error = env.core.engine.simulator.error_n()[0] / 40.0
        first = env.observation_names.index("error_north")
        np.testing.assert_allclose(seen[first : first + len(error)], error, rtol=1e-6)
        ratio = env.core.engine.simulator.ratio()[0]
        assert seen[-1] == pytest.approx(min(ratio, 10.0), rel=1e-6)
        seen, expected = env.step(pushed(env, 0.1))[0], default.step(pushed(default, 0.1))[0]


# --- wrappers --------------------------------------------------------------------------------

MAKERS = [
    (victim, wrappers),
    (lambda kind, **kwargs: victims(kind, 2, **kwargs), vector_wrappers),
]


@pytest.mark.parametrize(("make", "module"), MAKERS, ids=["single", "vector"])
def test_a_wrapper_is_the_same_as_its_argument(make, module):
    wrapped = module.WatchWrapper(make("Snapshot", watch=["never"]), "srv-raim")
    wrapped = module.DetectorWrapper(wrapped, "traversal-raim")
    given = make("Snapshot", detector="traversal-raim", watch=["never", "srv-raim"])
    actions = [np.full(given.action_space.shape, push) for push in (0.1, 0.4, 0.8)]
    assert_same(trace(wrapped, actions), trace(given, actions))
    assert wrapped.unwrapped.core.info_names == given.unwrapped.core.info_names
    with pytest.raises(ValueError, match="'traversal-raim' and 'srv-raim'"):
        module.DetectorWrapper(make("Snapshot", detector="traversal-raim"), "srv-raim")
    with pytest.raises(ValueError, match="needs the filter of a tightly coupled receiver, which a"):
        module.StealthBudget(make("Snapshot"), 2.0)


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
    onset_s = 2 * LIVE * VICTIMS[kind]
    time_s = onset_s + VICTIMS[kind] * np.arange(1, STEPS + 1)
    np.testing.assert_allclose(table["time_s"].to_pylist(), time_s)
    assert info["time_s"] == pytest.approx(time_s[-1] + HOLD * VICTIMS[kind])
    commanded = np.array(table["commanded_displacement_m"].to_pylist())
    assert (np.diff(commanded[:, 1]) > 0.0).all()
    assert ("visible" in table.column_names) == (kind == "Snapshot")
    width = {"Snapshot": 24, "WheeledRobot": 2, "LooselyCoupled": 3}[kind]
    assert np.array(table["innovation"].to_pylist()).shape == (STEPS, width)


def test_pictures_of_an_episode_with_everything(kind):
    pytest.importorskip("matplotlib")
    settings = {**GIVEN[kind][0], "target_heading_deg": "random", "twin": True}
    env = victim(kind, render_mode="rgb_array", **settings)
    env.reset(seed=1)
    first = env.render()
    env.step(pushed(env, 0.5))
    assert (env.render() != first).any()
    env.close()


def test_the_default_detector_of_each():
    made = {kind: gym.make(f"spoofgym/{kind}-v0").unwrapped.core.setup for kind in SMALL}
    names = {kind: type(setup.detector).__name__ for kind, setup in made.items()}
    assert names == {
        "LooselyCoupled": "WindowedChi2",
        "Snapshot": "SrvRaim",
        "WheeledRobot": "Acna",
    }
    assert made["LooselyCoupled"].detector.window == LOOSE["window"]


@pytest.mark.usefixtures("default_rate")
@pytest.mark.parametrize(
    ("detector", "message"),
    [
        ({"name": "pool", "members": ["raim", "ewma"]}, "Raim measures satellites"),
        ({"name": "windowed-chi2", "window": 900}, "shorten its windows"),
    ],
)
def test_who_can_not_judge_is_not_told_to_be_calibrated(detector, message):
    with pytest.raises(ValueError, match=message):
        gym.make("spoofgym/LooselyCoupled-v0", detector=detector)
