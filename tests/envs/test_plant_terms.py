"""Terms of action and end, and detectors that watch, in the environments over plants."""

from __future__ import annotations

import copy
import pickle
from dataclasses import dataclass
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import spoofgym  # noqa: F401  (registers the ids)
from spoofgym.detectors import Never
from spoofgym.envs import wrappers
from spoofgym.envs.loose_plant import DEFAULT_DETECTOR as LOOSE
from spoofgym.envs.robot_plant import DEFAULT_DETECTOR as ROBOT
from spoofgym.envs.wrappers import vector as vector_wrappers

from .test_ends import FAR, until_the_end
from .test_plant_game import HOLD, LIVE, STEPS, AlarmAt
from .toy_plant import FarFix, ToyEnv, ToyVectorEnv

SHORT = {"warmup_s": 6.0, "live_s": 6.0, "attack_s": 14.0, "time_to_alert_s": 3.0}
PLANTS = {
    "Snapshot": (SHORT, "srv-raim", "srv_raim"),
    "WheeledRobot": (SHORT, ROBOT, "acna"),
    "LooselyCoupled": (
        {"warmup_s": 12.0, "live_s": 12.0, "attack_s": 1.4, "time_to_alert_s": 0.3},
        LOOSE,
        "windowed_chi2",
    ),
}
"""Timeline, the detector that it has by default, and its name where it watches."""
STEPS_OF_ALL = 14
ENDS = ["at-alarm", {"name": "at-displacement", "limit_m": 9.0}, {"name": "at-steps", "steps": 11}]


def single(kind, **kwargs):
    return gym.make(f"spoofgym/{kind}-v0", **{"timeline": PLANTS[kind][0], **kwargs})


def vector(kind, receivers, **kwargs):
    made = gym.make_vec(
        f"spoofgym/{kind}-v0", num_envs=receivers, **{"timeline": PLANTS[kind][0], **kwargs}
    )
    return made.unwrapped


@pytest.mark.parametrize("kind", PLANTS)
def test_every_receiver_of_a_batch_is_the_single_one_with_all_of_them(kind):
    """Actions along the target, ends of both kinds, a detector that watches; many autoresets."""
    kwargs = {
        "action": ["along-target", "across-target"],
        "end": ENDS,
        "watch": ["never", PLANTS[kind][1]],
        "target_heading_deg": 30.0,
        "knowledge": "oracle",
    }
    receivers, ends = 6, np.zeros(2, dtype=int)
    envs = vector(kind, receivers, **kwargs)
    singles = [single(kind, **kwargs).unwrapped for _ in range(receivers)]
    seen, begin = envs.reset(seed=30)
    for i, env in enumerate(singles):
        observation, info = env.reset(seed=30 + i)
        np.testing.assert_array_equal(observation, seen[i])
        assert {name: begin[name][i] for name in info} == info
    rng, over = np.random.default_rng(3), np.zeros(receivers, dtype=bool)
    pushes = np.linspace(0.0, 1.0, receivers)[:, None] * np.array([1.0, 0.2])
    for _ in range(30):
        action = pushes * rng.uniform(0.0, 1.0, (receivers, 1))
        observations, reward, terminated, truncated, info = envs.step(action)
        for i, env in enumerate(singles):
            if over[i]:
                (observation, mine), r, end, cut = env.reset(), 0.0, False, False
            else:
                observation, r, end, cut, mine = env.step(action[i])
            np.testing.assert_array_equal(observation, observations[i])
            assert (reward[i], terminated[i], truncated[i]) == (r, end, cut)
            assert {name: info[name][i] for name in mine} == mine
            assert all(info[f"_{name}"][i] for name in mine)
        over = terminated | truncated
        ends += terminated.sum(), truncated.sum()
    assert ends.min() >= 2


@pytest.mark.parametrize("kind", PLANTS)
def test_what_watches_changes_nothing_and_sees_what_the_loop_sees(kind):
    _, loop, name = PLANTS[kind]
    kwargs = {"knowledge": "oracle", "end": ["at-window-end"]}
    plain, watched = vector(kind, 5, **kwargs), vector(kind, 5, **kwargs, watch=[loop, "never"])
    np.testing.assert_array_equal(plain.reset(seed=1)[0], watched.reset(seed=1)[0])
    rng, alarms = np.random.default_rng(0), []
    pushes = np.linspace(0.0, 1.0, 5)[:, None]
    detected = np.zeros(5, dtype=bool)
    for _ in range(2 * STEPS_OF_ALL + 2):
        action = pushes * rng.uniform(0.0, 1.0, plain.action_space.shape)
        mine, theirs = plain.step(action), watched.step(action)
        for a, b in zip(mine[:4], theirs[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        told, begun = theirs[4], ~theirs[4].get("_alarm", np.zeros(5, dtype=bool))
        np.testing.assert_array_equal(told[f"watch_{name}_warmup_alarm"], told["warmup_alarm"])
        if begun.all():
            detected[:] = False
            continue
        np.testing.assert_array_equal(told[f"watch_{name}_alarm"], told["alarm"])
        now = told[f"watch_{name}_ratio"] > 1.0
        # the alarm of the last step may be one of the time to alert
        assert (now <= told["alarm"]).all()
        assert not told["watch_never_alarm"].any()
        detected |= told["alarm"]
        alarms.append(detected.copy())
    assert np.any(alarms)
    assert not np.all(alarms[-1])


def test_a_displacement_ends_the_episode_and_is_held_to():
    env = ToyEnv(end=[{"name": "at-displacement", "limit_m": 4.0}], detector=Never())
    env.reset(seed=1)
    steps, *_, terminated, truncated, info = until_the_end(env, 0.5)
    assert 2 < steps < STEPS
    assert (terminated, truncated) == (True, False)
    assert info["end_displacement"]
    assert info["displacement_m"] >= 4.0
    assert info["time_s"] == pytest.approx(0.5 * (LIVE + steps + HOLD))
    kept = info["undetected_displacement_m"]
    for after, taken in ((1, True), (HOLD, True), (HOLD + 1, False)):
        env = ToyEnv(
            end=["at-alarm", {"name": "at-displacement", "limit_m": 4.0}],
            detector=AlarmAt(LIVE + steps + after),
        )
        env.reset(seed=1)
        again, _, reward, terminated, _, info = until_the_end(env, 0.5)
        assert (again, terminated, info["detected"]) == (steps, True, taken)
        assert (info["undetected_displacement_m"] < kept) == taken
        parts = [info[f"reward_{part}"] for part in ("displacement", "retraction", "alarm")]
        assert reward == sum(parts)


def test_a_limit_from_outside_truncates_and_holds_nothing():
    env = ToyEnv(end=["at-alarm", {"name": "at-steps", "steps": 7}], detector=Never())
    env.reset(seed=1)
    steps, *_, terminated, truncated, info = until_the_end(env, 0.5)
    assert (steps, terminated, truncated) == (7, False, True)
    assert info["time_s"] == pytest.approx(0.5 * (LIVE + 7))
    with pytest.raises(RuntimeError, match="call reset"):
        env.step([0.0, 0.0])


def test_an_alarm_ends_it_only_where_it_is_listed():
    for end, steps in ((["at-alarm"], 4), ("at-window-end", STEPS), ([], STEPS)):
        env = ToyEnv(end=end, detector=AlarmAt(LIVE + 4))
        env.reset(seed=1)
        assert until_the_end(env, 0.5)[0] == steps


@pytest.mark.parametrize("kind", PLANTS)
@pytest.mark.parametrize("steps", [STEPS_OF_ALL - 1, STEPS_OF_ALL])
def test_a_receiver_that_is_over_is_not_held_to_twice(kind, steps):
    """Its next epoch is thrown away; it must not run out of its flight."""
    envs = vector(kind, 2, end=[{"name": "at-steps", "steps": steps}, FAR], detector="never")
    timeline = PLANTS[kind][0]
    envs.reset(seed=1)
    last = sum(timeline[name] for name in ("warmup_s", "attack_s", "time_to_alert_s"))
    spare = envs.game.plant.interval_s
    action = np.zeros(envs.action_space.shape)
    action[0, 1], ends = 1.0, np.zeros(2, dtype=int)
    for _ in range(3 * STEPS_OF_ALL):
        *_, terminated, truncated, info = envs.step(action)
        assert info["time_s"].max() <= last + spare + 1e-9
        ends += terminated | truncated
    assert ends.min() >= 2


@dataclass(frozen=True)
class AtOffset:
    """An end of one's own, which looks at the plant."""

    limit_m: float
    name: ClassVar[str] = "offset"
    truncates: ClassVar[bool] = False

    def __call__(self, standing):
        return standing.snapshot.plant.memory["offset"][:, 1] >= self.limit_m


@dataclass(frozen=True)
class AtEngine(AtOffset):
    def __call__(self, standing):
        return standing.snapshot.batch.epochs > 0


def test_an_end_of_ones_own_sees_the_plant_and_is_told_that_there_is_no_engine():
    env = ToyEnv(end=AtOffset(3.0), detector=Never())
    env.reset(seed=1)
    # 2 m/s at an action of 1, epochs of half a second
    assert until_the_end(env)[0] == 3
    env = ToyEnv(end=AtEngine(3.0))
    env.reset(seed=1)
    with pytest.raises(TypeError, match="batch of an engine, which the plant 'toy' does not have"):
        env.step([0.0, 0.0])


def trace(env, actions, seed=2):
    rows = [env.reset(seed=seed)[0]]
    for action in actions:
        observation, reward, *_, info = env.step(action)
        rows += [observation, reward, info["displacement_m"]]
    return rows


def assert_same(mine, theirs):
    for a, b in zip(mine, theirs, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("kind", PLANTS)
def test_an_action_along_the_target_is_that_of_its_axes(kind):
    heading = np.radians(30.0)
    kwargs = {"detector": "never", "target_heading_deg": 30.0}
    axes = single(kind, **kwargs)
    along = single(kind, **kwargs, action="along-target")
    both = single(kind, **kwargs, action=["along-target", "across-target"])
    assert along.unwrapped.action_names == ("along_target_rate",)
    assert both.unwrapped.action_names == ("along_target_rate", "across_target_rate")
    parts = np.random.default_rng(0).uniform(-0.6, 0.6, (5, 2))
    width = axes.action_space.shape[0]
    north_east = np.zeros((5, width))
    north_east[:, 0] = parts[:, 0] * np.cos(heading) + parts[:, 1] * np.cos(heading + np.pi / 2)
    north_east[:, 1] = parts[:, 0] * np.sin(heading) + parts[:, 1] * np.sin(heading + np.pi / 2)
    assert_same(trace(both, parts), trace(axes, north_east))
    north_east[:, 0] = parts[:, 0] * np.cos(heading)
    north_east[:, 1] = parts[:, 0] * np.sin(heading)
    assert_same(trace(along, parts[:, :1]), trace(axes, north_east))


def test_a_sum_of_commands_is_cut_to_what_the_plant_takes():
    env = single("WheeledRobot", action=["full-command", "along-target"], detector="never")
    env.reset(seed=1)
    env.step([-0.2, 1.0, 1.0])
    rate = env.unwrapped.game.plant.memory["rate"][0]
    np.testing.assert_allclose(rate, [-0.2, 1.0], atol=1e-12)


def test_some_axes_of_a_snapshot_receiver():
    env = single("Snapshot", action={"name": "channels", "ids": ["east", "clock"]})
    assert env.unwrapped.action_names == ("east_rate", "clock_rate")
    env.reset(seed=1)
    env.step([0.5, -1.0])
    rate = env.unwrapped.game.plant.memory["rate"][0]
    np.testing.assert_array_equal(rate, [0.0, 2.5, 0.0, -5.0])


@pytest.mark.parametrize(
    ("kind", "kwargs", "message"),
    [
        (
            "Snapshot",
            {"end": {"name": "at-stealth-budget", "budget_nats": 2.0}},
            "'stealth_budget' needs the Divergence of a tightly coupled filter, which .*'snapshot'",
        ),
        ("WheeledRobot", {"end": ["at-alarm", "at-alarm"]}, "two end terms have the same name"),
        ("WheeledRobot", {"end": "at-alram"}, "did you mean 'at-alarm'"),
        ("LooselyCoupled", {"action": "common-offset"}, "per channel, 'per-channel', got 'loose'"),
        (
            "Snapshot",
            {"action": "along-target", "rate_limit_mps": [5.0, 2.0, 5.0, 5.0]},
            "AlongTarget needs the same limit north and east, got 5 and 2",
        ),
        (
            "WheeledRobot",
            {"action": {"name": "channels", "ids": ["clock"]}},
            "no channel 'clock' to command; valid: north, east",
        ),
        ("WheeledRobot", {"watch": "ewma"}, "Ewma measures satellites, but the receiver measures"),
        ("Snapshot", {"watch": ["never", "rio"]}, "Rio needs .*, which a snapshot receiver does"),
        ("LooselyCoupled", {"watch": {"name": "windowed-chi2", "window": 900}}, "shorten its"),
    ],
)
def test_what_a_plant_does_not_have_is_refused(kind, kwargs, message):
    with pytest.raises(ValueError, match=message):
        single(kind, **kwargs)


@pytest.mark.parametrize("kind", PLANTS)
def test_the_spec_makes_the_same_again_and_keeps_the_contract(kind):
    kwargs = {"end": ENDS, "action": "along-target", "watch": ["never"]}
    env = single(kind, **kwargs)
    check_env(env.unwrapped)
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    actions = np.full((4, 1), 0.1)
    assert_same(trace(env, actions), trace(again, actions))
    assert "watch_never_ratio" in again.unwrapped.game.info_names


@pytest.mark.parametrize("duplicate", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy])
def test_an_unfinished_episode_survives_copying(duplicate):
    kwargs = {"end": ENDS, "action": "along-target", "watch": [FarFix(3.0), FarFix(4.0)]}
    envs = ToyVectorEnv(3, **kwargs)
    envs.reset(seed=5)
    action = np.full((3, 1), 0.4)
    for _ in range(4):
        envs.step(action)
    other = duplicate(envs)
    for _ in range(20):
        mine, theirs = envs.step(action), other.step(action)
        assert_same(mine[:4], theirs[:4])
        assert_same(mine[4].values(), theirs[4].values())


MAKERS = [(single, wrappers), (lambda kind, **kwargs: vector(kind, 2, **kwargs), vector_wrappers)]


@pytest.mark.parametrize(("make", "module"), MAKERS, ids=["single", "vector"])
def test_a_wrapper_is_the_same_as_its_argument(make, module):
    wrapped = module.WatchWrapper(make("Snapshot", watch=["never"]), "srv-raim")
    wrapped = module.DetectorWrapper(wrapped, "traversal-raim")
    given = make("Snapshot", detector="traversal-raim", watch=["never", "srv-raim"])
    actions = [np.full(given.action_space.shape, push) for push in (0.1, 0.4, 0.8)]
    assert_same(trace(wrapped, actions), trace(given, actions))
    assert wrapped.unwrapped.game.info_names == given.unwrapped.game.info_names
    with pytest.raises(ValueError, match="'traversal-raim' and 'srv-raim'"):
        module.DetectorWrapper(make("Snapshot", detector="traversal-raim"), "srv-raim")
    with pytest.raises(ValueError, match="Divergence of a tightly coupled filter"):
        module.StealthBudget(make("Snapshot"), 2.0)
    with pytest.raises(TypeError, match="needs a SpoofEnv"):
        module.RecordEpochs(make("Snapshot"), "epochs")
