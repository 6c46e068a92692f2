"""Ends before that of the window: they are held to, as the last command is."""

from __future__ import annotations

import numpy as np
import pytest

from spoofgym.detectors import Detector, Verdict

from .support import single, vector

FAR = {"name": "at-displacement", "limit_m": 0.5}


class AfterEpochs(Detector):
    """Alarms at one epoch after the onset."""

    paper = "groves2013"

    def __init__(self, at):
        self.at = at

    def bind(self, context):
        super().bind(context)
        self.memory.declare("count", np.zeros(context.receivers))

    def judge(self, epoch):
        self.memory["count"] = self.memory["count"] + 1.0
        statistic = (self.memory["count"][:, None] == 20 + self.at).astype(float)
        return Verdict(statistic, np.full_like(statistic, 0.5), statistic > 0.5)


def until_the_end(env, push=1.0):
    steps = 0
    while True:
        observation, reward, terminated, truncated, info = env.step([0.0, push])
        steps += 1
        if terminated or truncated:
            return steps, observation, reward, terminated, truncated, info


def test_a_displacement_ends_the_episode_and_is_held_to():
    env = single(end=[FAR], detector="never")
    env.reset(seed=1)
    steps, *_, terminated, truncated, info = until_the_end(env)
    assert 2 < steps < 30
    assert (terminated, truncated) == (True, False)
    assert info["end_displacement"]
    assert info["displacement_m"] >= 0.5
    # the receiver has run the time to alert, 10 epochs of half a second
    assert info["time_s"] == pytest.approx(20.0 + 0.5 * steps + 5.0)
    with pytest.raises(RuntimeError, match="call reset"):
        env.step([0.0, 0.0])


def test_an_alarm_after_an_early_end_takes_back_what_was_gained():
    quiet = single(end=[FAR], detector="never")
    quiet.reset(seed=1)
    steps, *_, kept = until_the_end(quiet)
    for after, taken in ((1, True), (10, True), (11, False)):
        env = single(end=[FAR, "at-alarm"], detector=AfterEpochs(steps + after))
        env.reset(seed=1)
        again, _, reward, terminated, _, info = until_the_end(env)
        assert (again, terminated) == (steps, True)
        assert info["detected"] == taken
        if taken:
            parts = info["reward_displacement"] + info["reward_retraction"] - 10.0
            assert reward == pytest.approx(parts)
            assert info["undetected_displacement_m"] < kept["undetected_displacement_m"]
        else:
            assert info["undetected_displacement_m"] == kept["undetected_displacement_m"]


def test_an_alarm_ends_it_only_where_it_is_listed():
    for end, steps in ((["at-alarm"], 4), (["at-window-end"], 30), ([], 30)):
        env = single(end=end, detector=AfterEpochs(4))
        env.reset(seed=1)
        assert until_the_end(env)[0] == steps


def test_a_limit_from_outside_truncates_and_holds_nothing():
    env = single(end=["at-alarm", {"name": "at-steps", "steps": 7}], detector="never")
    env.reset(seed=1)
    steps, *_, terminated, truncated, info = until_the_end(env)
    assert (steps, terminated, truncated) == (7, False, True)
    assert info["time_s"] == pytest.approx(20.0 + 3.5)
    with pytest.raises(RuntimeError, match="call reset"):
        env.step([0.0, 0.0])


def test_the_last_command_is_an_end_and_no_truncation():
    env = single(end=[{"name": "at-steps", "steps": 30}], detector="never")
    env.reset(seed=1)
    assert until_the_end(env)[3:5] == (True, False)


@pytest.mark.parametrize("steps", [29, 30])
def test_a_receiver_that_is_over_is_not_held_to_twice(steps):
    """Its next epoch is thrown away; it must not run out of the world."""
    envs = vector(2, end=[{"name": "at-steps", "steps": steps}, FAR], detector="never")
    envs.reset(seed=1)
    ends = 0
    for _ in range(70):
        *_, terminated, truncated, info = envs.step([[0.0, 1.0], [0.0, -0.1]])
        assert info["time_s"].max() <= 20.0 + 15.0 + 5.0
        ends = ends + (terminated | truncated)
    assert ends.min() >= 2
    assert ends[0] > ends[1]


def test_the_stealth_budget_ends_when_it_is_spent():
    spent = "divergence_spent"
    for budget in (1.0, 8.0):
        env = single(
            end=[{"name": "at-stealth-budget", "budget_nats": budget}],
            observation=[{"name": "divergence-spent", "budget_nats": budget}],
            detector="never",
        )
        assert env.unwrapped.observation_names == (spent,)
        assert env.reset(seed=1)[0][0] == 0.0
        before = 0.0
        for _ in range(30):
            observation, _, terminated, _, info = env.step([0.0, 0.5])
            assert info["end_stealth_budget"] == terminated
            if terminated:
                break
            assert before <= observation[0] <= 1.0
            before = observation[0]
        assert terminated
        assert observation[0] > 1.0
