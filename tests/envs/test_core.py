"""Rewards, ends, warm-up and autoreset."""

import dataclasses

import numpy as np
import pytest

from spoofgym.detectors import Detector, Never, Verdict
from spoofgym.envs import SpoofCore
from spoofgym.envs.terms.observation import OwnCommand, Time, default_terms
from spoofgym.simulators import Engine, TightlyCoupledSetup

from .support import SHORT, single, vector


class AlarmAt(Detector):
    """Alarms once, a number of epochs after it was reset."""

    paper = "groves2013"
    scope = "receiver"

    def __init__(self, epoch: int) -> None:
        self.epoch = epoch

    def bind(self, context):
        super().bind(context)
        self.memory.declare("seen", np.zeros(context.receivers))

    def judge(self, epoch):
        self.memory["seen"] = self.memory["seen"] + 1.0
        alarm = (self.memory["seen"] == self.epoch)[:, None]
        return Verdict(alarm * 2.0, np.ones(alarm.shape), alarm)


LIVE, STEPS, HOLD = 20, 30, 10  # epochs of `SHORT`


def play(detector, steps=STEPS, **kwargs):
    """Displacements, rewards and infos of one episode pushed east."""
    env = single(detector=detector, **kwargs).unwrapped
    env.reset(seed=1)
    displacement, reward, infos = [0.0], [], []
    for _ in range(steps):
        _, r, terminated, truncated, info = env.step(np.array([0.0, 1.0]))
        assert not truncated
        assert r == info["reward_displacement"] + info["reward_retraction"] + info["reward_alarm"]
        displacement.append(info["displacement_m"])
        reward.append(r)
        infos.append(info)
        if terminated:
            break
    return np.array(displacement), np.array(reward), infos


def test_without_alarm_the_return_is_the_largest_displacement():
    displacement, reward, infos = play(Never())
    assert len(reward) == STEPS
    assert sum(reward) == pytest.approx(displacement.max())
    assert infos[-1]["undetected_displacement_m"] == pytest.approx(displacement.max())
    assert not infos[-1]["detected"]


@pytest.mark.parametrize("at", [1, 5, HOLD, HOLD + 1, HOLD + 2, 20, STEPS])
def test_an_alarm_takes_back_the_time_to_alert(at):
    displacement, reward, infos = play(AlarmAt(LIVE + at))
    assert len(reward) == at
    kept = displacement[: max(at - HOLD - 1, 0) + 1].max()
    assert sum(reward) == pytest.approx(kept - 10.0)
    assert infos[-1]["undetected_displacement_m"] == pytest.approx(kept)
    assert infos[-1]["detected"]


@pytest.mark.parametrize("late", [1, 4, HOLD])
def test_an_alarm_after_the_last_command_still_counts(late):
    displacement, reward, infos = play(AlarmAt(LIVE + STEPS + late))
    assert len(reward) == STEPS
    kept = displacement[: STEPS + late - HOLD].max()
    assert sum(reward) == pytest.approx(kept - 10.0)
    assert infos[-1]["alarm"]


def test_an_alarm_after_the_time_to_alert_comes_too_late():
    displacement, reward, _ = play(AlarmAt(LIVE + STEPS + HOLD + 1))
    assert sum(reward) == pytest.approx(displacement.max())


def test_without_end_at_alarm_the_rest_is_without_reward():
    _, reward, infos = play(AlarmAt(LIVE + 15), end_at_alarm=False)
    assert len(reward) == STEPS
    assert not np.any(reward[15:])
    assert infos[14]["alarm"]
    assert not infos[15]["alarm"]
    assert all(info["detected"] for info in infos[14:])


@pytest.mark.parametrize("at", [1, LIVE])
def test_an_alarm_in_the_warmup_is_latched_and_does_not_end_anything(at):
    env = single(detector=AlarmAt(at)).unwrapped
    _, info = env.reset(seed=1)
    assert info["warmup_alarm"]
    *_, terminated, _, info = env.step(np.zeros(2))
    assert info["warmup_alarm"]
    assert not info["detected"]
    assert not terminated


def test_the_target_direction_counts():
    east = play(Never(), target_heading_deg=90.0)[0]
    west = play(Never(), target_heading_deg=270.0)[0]
    np.testing.assert_allclose(east, -west, atol=1e-9)
    assert east[-1] > 1.0


def test_next_step_resets_in_the_step_after_the_end():
    envs = vector(3, autoreset_mode="next_step", detector=Never())
    first, _ = envs.reset(seed=2)
    for _ in range(STEPS - 1):
        _, _, terminated, _, _ = envs.step(np.zeros((3, 2)))
        assert not terminated.any()
    last, _, terminated, _, info = envs.step(np.zeros((3, 2)))
    assert terminated.all()
    assert "final_obs" not in info
    assert last[0, envs.observation_names.index("time_left")] == 0.0
    observation, reward, terminated, _, info = envs.step(np.ones((3, 2)))
    assert not terminated.any()
    assert not reward.any()
    assert observation[0, envs.observation_names.index("time_left")] == 1.0
    assert info["_time_s"].all()
    assert "reward_alarm" not in info or not info["_reward_alarm"].any()
    assert first.shape == observation.shape


def test_next_step_with_receivers_in_different_phases():
    """Receivers that restart beside others that go on: masks, rewards, and no disturbance."""
    kwargs = {"detector": {"name": "ewma", "false_alarm": 0.05}, "knowledge": "oracle"}
    envs = vector(16, autoreset_mode="next_step", **kwargs)
    envs.reset(seed=30)
    singles = []
    for i in range(16):
        env = single(**kwargs).unwrapped
        env.reset(seed=30 + i)
        singles.append(env)
    over = np.zeros(16, dtype=bool)
    mixed = 0
    for k in range(45):
        action = np.full((16, 2), 0.2 * (k % 5))
        observation, reward, terminated, _, info = envs.step(action)
        mixed += over.any() and not over.all()
        np.testing.assert_array_equal(info["_reward_alarm"], ~over)
        for i, env in enumerate(singles):
            if over[i]:
                expected, r, end = env.reset()[0], 0.0, False
            else:
                expected, r, end, _, _ = env.step(action[i])
            np.testing.assert_array_equal(observation[i], expected)
            assert reward[i] == r
            assert terminated[i] == end
            over[i] = end
    assert mixed > 5


def test_same_step_keeps_the_final_observation():
    envs = vector(2, autoreset_mode="same_step", detector=Never())
    envs.reset(seed=2)
    for _ in range(STEPS):
        observation, _, terminated, _, info = envs.step(np.ones((2, 2)))
    left = envs.observation_names.index("time_left")
    assert terminated.all()
    assert info["_final_obs"].all()
    assert info["final_obs"][1][left] == 0.0
    assert observation[1, left] == 1.0
    assert info["final_info"]["undetected_displacement_m"].shape == (2,)
    assert info["final_info"]["_undetected_displacement_m"].all()
    assert not info["_undetected_displacement_m"].any()


def test_knowledge_only_grows():
    names = [
        single(knowledge=k).unwrapped.observation_names for k in ("blind", "tracking", "oracle")
    ]
    assert set(names[0]) < set(names[1]) < set(names[2])
    assert all(name.startswith(("own_", "time_")) for name in names[0])
    assert not any("statistic" in name or "error" in name for name in names[1])


def test_an_own_list_of_terms():
    env = single(observation=(Time(), OwnCommand(scale_m=1.0))).unwrapped
    assert env.observation_names[0] == "time_since_onset"
    with pytest.raises(ValueError, match="two terms write the same"):
        single(observation=(Time(), Time()))
    assert default_terms(setup, "blind")


def test_fewer_than_four_satellites_coast_and_say_so():
    """Satellites that sink after the first fix: the receiver coasts, and the detector is quiet."""
    setup = TightlyCoupledSetup(timeline=SHORT, detector="ewma")
    visible, satellites = setup.world.visible.copy(), setup.world.satellites.copy()
    visible[45:60, 3:] = False
    satellites[45:60, 3:, 6:] = 0.0
    setup.world = dataclasses.replace(setup.world, visible=visible, satellites=satellites)
    core = SpoofCore(2, setup)
    core.reset([np.random.default_rng(i) for i in range(2)])
    covariance = core.engine.simulator.buffers.state.covariance
    before = np.sqrt(covariance[:, 6, 6])
    coasting, spread = [], []
    for _ in range(25):
        turn = core.step(np.zeros((2, 2)))
        coasting.append(turn.info["coasting"])
        spread.append(np.sqrt(covariance[:, 6, 6]))
    coasting, spread = np.array(coasting), np.array(spread)
    assert not coasting[:4].any()
    assert coasting[4:19].all()
    assert not coasting[19:].any()
    assert (np.diff(spread[5:19], axis=0) > 0.0).all()
    assert (spread[-1] < 2.0 * before).all()
    assert np.isfinite(core.observe()).all()


def test_receivers_and_threads_are_checked():
    setup = TightlyCoupledSetup(timeline=SHORT)
    with pytest.raises(ValueError, match="`receivers` must be at least 1, got 0"):
        Engine(0, setup)
    with pytest.raises(ValueError, match="`threads` must be at least 1, got 0"):
        Engine(1, setup, threads=0)
