"""Ends before that of the window: they are held to, as the last command is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from spoofgym.envs.core import ALARM_PRICE

from ..support import HOLD, LIVE, STEPS, VICTIMS, AlarmAt, single, victim, victims

LIMITS_M = {"Zhong2025": 0.5, "LooselyCoupled": 1.0, "Snapshot": 15.0, "WheeledRobot": 4.0}
"""Displacements that a full push comes to in some epochs of an episode."""


def far(kind):
    return {"name": "at-displacement", "limit_m": LIMITS_M[kind]}


@pytest.fixture(params=VICTIMS)
def kind(request):
    return request.param


def until_the_end(env, push=1.0):
    steps = 0
    while True:
        action = np.zeros(env.action_space.shape)
        action[1] = push
        observation, reward, terminated, truncated, info = env.step(action)
        steps += 1
        if terminated or truncated:
            return steps, observation, reward, terminated, truncated, info


def test_a_displacement_ends_the_episode_and_an_alarm_that_follows_takes_back_what_was_gained(kind):
    quiet = victim(kind, end=[far(kind)], detector="never")
    quiet.reset(seed=1)
    steps, *_, terminated, truncated, kept = until_the_end(quiet)
    assert 2 < steps < 30
    assert (terminated, truncated) == (True, False)
    assert kept["end_displacement"]
    assert kept["displacement_m"] >= LIMITS_M[kind]
    # the receiver has run the time to alert
    assert kept["time_s"] == pytest.approx(VICTIMS[kind] * (2 * LIVE + steps + HOLD))
    for after, taken in ((1, True), (HOLD, True), (HOLD + 1, False)):
        detector = AlarmAt(LIVE + steps + after)
        env = victim(kind, end=[far(kind), "at-alarm"], detector=detector)
        env.reset(seed=1)
        again, _, reward, terminated, _, info = until_the_end(env)
        assert (again, terminated) == (steps, True)
        assert info["detected"] == taken
        if taken:
            price = ALARM_PRICE * env.unwrapped.core.length_m
            parts = info["reward_displacement"] + info["reward_retraction"] - price
            assert reward == pytest.approx(parts)
            assert info["undetected_displacement_m"] < kept["undetected_displacement_m"]
        else:
            assert info["undetected_displacement_m"] == kept["undetected_displacement_m"]


def test_a_limit_from_outside_truncates_and_holds_nothing(kind):
    env = victim(kind, end=["at-alarm", {"name": "at-steps", "steps": 7}], detector="never")
    env.reset(seed=1)
    steps, *_, terminated, truncated, info = until_the_end(env)
    assert (steps, terminated, truncated) == (7, False, True)
    assert info["time_s"] == pytest.approx(VICTIMS[kind] * (2 * LIVE + 7))
    with pytest.raises(RuntimeError, match="call reset"):
        env.step(np.zeros(env.action_space.shape))


@pytest.mark.parametrize("steps", [STEPS - 1, STEPS])
def test_a_receiver_that_is_over_is_not_held_to_twice(steps):
    """Its next epoch is thrown away; it must not run out of the world."""
    kind = "Zhong2025" if steps == STEPS else "LooselyCoupled"
    end = [{"name": "at-steps", "steps": steps}, far(kind)]
    envs = victims(kind, 2, end=end, detector="never")
    envs.reset(seed=1)
    action = np.zeros(envs.action_space.shape)
    action[:, 1] = 1.0, -0.1
    ends, latest = np.zeros(2, dtype=int), VICTIMS[kind] * (2 * LIVE + STEPS + HOLD)
    for _ in range(70):
        *_, terminated, truncated, info = envs.step(action)
        assert info["time_s"].max() <= latest + 1e-9
        ends += terminated | truncated
    assert ends.min() >= 2
    assert ends[0] > ends[1]


@dataclass(frozen=True)
class AtCommanded:
    """An end of one's own, which looks at the simulator."""

    limit_m: float
    name: ClassVar[str] = "commanded"
    truncates: ClassVar[bool] = False

    def __call__(self, state):
        return state.snapshot.simulator.commanded_displacement[:, 1] >= self.limit_m


@pytest.mark.parametrize(
    ("kind", "end", "steps"),
    [
        ("Snapshot", ["at-alarm"], 4),
        ("Snapshot", "at-window-end", STEPS),
        ("Snapshot", [], STEPS),
        ("Snapshot", AtCommanded(8.0), 2),  # at 5 m/s
        ("WheeledRobot", [{"name": "at-steps", "steps": STEPS}], STEPS),  # no truncation
    ],
)
def test_an_alarm_ends_it_only_where_it_is_listed_and_the_last_command_always(kind, end, steps):
    env = victim(kind, end=end, detector=AlarmAt(LIVE + 4))
    env.reset(seed=1)
    taken, _, _, terminated, truncated, _ = until_the_end(env)
    assert (taken, terminated, truncated) == (steps, True, False)


@pytest.mark.parametrize("budget", [1.0, 8.0])
def test_the_stealth_budget_ends_when_it_is_spent(budget):
    env = single(
        end=[{"name": "at-stealth-budget", "budget_nats": budget}],
        observation=[{"name": "divergence-spent", "budget_nats": budget}],
        detector="never",
    )
    spent, terminated = [env.reset(seed=1)[0][0]], False
    while not terminated:
        observation, _, terminated, _, info = env.step([0.0, 0.5])
        assert info["end_stealth_budget"] == terminated
        spent.append(observation[0])
    assert spent[0] == 0.0
    assert spent == sorted(spent)
    assert spent[-2] <= 1.0 < spent[-1]
