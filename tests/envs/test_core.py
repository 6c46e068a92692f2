"""Rewards, ends and warm-up of every victim, and what an alarm costs."""

import numpy as np
import pytest

from spoofgym.detectors import Never
from spoofgym.envs.core import ALARM_PRICE
from spoofgym.envs.terms.reward import DisplacementGain

from .support import HOLD, LIVE, SMALL, STEPS, VICTIMS, AlarmAt, victim


@pytest.fixture(params=VICTIMS)
def kind(request):
    return request.param


def play(kind, detector, **kwargs):
    env = victim(kind, detector=detector, **kwargs).unwrapped
    env.reset(seed=1)
    action = np.zeros(env.action_space.shape)
    action[1] = 1.0
    displacement, reward, infos = [0.0], [], []
    for _ in range(STEPS):
        _, r, terminated, truncated, info = env.step(action)
        assert not truncated
        assert r == info["reward_displacement"] + info["reward_retraction"] + info["reward_alarm"]
        displacement.append(info["displacement_m"])
        reward.append(r)
        infos.append(info)
        if terminated:
            break
    return np.array(displacement), np.array(reward), infos


@pytest.mark.parametrize(
    ("kind", "at"),
    [
        # all is taken back, a part, and after the last command; then it is too late
        *(("Zhong2025", at) for at in (1, HOLD, HOLD + 1, HOLD + 2, STEPS, STEPS + 1)),
        *(("Zhong2025", STEPS + at) for at in (HOLD, HOLD + 1)),
        *((kind, at) for kind in SMALL for at in (20, 44)),
    ],
)
def test_an_alarm_takes_back_the_time_to_alert(kind, at):
    displacement, reward, infos = play(kind, AlarmAt(LIVE + at))
    detected = at <= STEPS + HOLD
    assert len(reward) == min(at, STEPS)
    kept = displacement[: max(at - HOLD - 1, 0) + 1].max()
    price = ALARM_PRICE * victim(kind).unwrapped.core.length_m
    assert sum(reward) == pytest.approx(kept - detected * price)
    assert infos[-1]["undetected_displacement_m"] == pytest.approx(kept)
    assert infos[-1]["detected"] == infos[-1]["alarm"] == detected


def test_an_alarm_ends_nothing_in_the_warmup_or_without_end_at_alarm(kind):
    _, reward, infos = play(kind, AlarmAt(LIVE + 15), end_at_alarm=False)
    assert len(reward) == STEPS
    assert not np.any(reward[15:])
    assert infos[14]["alarm"]
    assert not infos[15]["alarm"]
    assert all(info["detected"] for info in infos[14:])
    env = victim(kind, detector=AlarmAt(LIVE if kind in SMALL[:2] else 1)).unwrapped
    _, info = env.reset(seed=1)
    assert info["warmup_alarm"]
    assert info["time_s"] == pytest.approx(2 * LIVE * VICTIMS[kind])
    *_, terminated, _, info = env.step(np.zeros(env.action_space.shape))
    assert info["warmup_alarm"]
    assert not info["detected"]
    assert not terminated


def test_own_reward_terms_and_a_price_of_an_alarm():
    *_, infos = play("Snapshot", AlarmAt(LIVE + 3), alarm_price=2.5, length_m=10.0)
    assert infos[-1]["reward_alarm"] == -25.0
    env = victim("Snapshot", reward=[DisplacementGain(per_m=2.0)], detector=Never())
    env.reset(seed=1)
    _, reward, _, _, info = env.step(np.full(env.action_space.shape, 0.5))
    assert reward == info["reward_displacement"]
    assert not any(name in info for name in ("reward_retraction", "reward_alarm"))


class AlarmOfMoved(AlarmAt):
    """Alarms at one epoch for every receiver, at an earlier one for those that are spoofed."""

    def __init__(self, epoch, moved):
        super().__init__(epoch)
        self.moved = moved

    def judge(self, epoch):
        verdict = super().judge(epoch)
        innovation = np.abs(epoch.innovation).max(axis=1, keepdims=True)
        hit = (self.memory["seen"][:, None] == self.moved) & (innovation > 30.0)
        alarm = verdict.alarm | hit
        return verdict._replace(statistic=alarm * 2.0, alarm=alarm)


def play_twins(detector, **settings):
    push = {"name": "false-position", "acceleration_limit_mps2": 50.0, "rate_limit_mps": 500.0}
    env = victim("Zhong2025", detector=detector, twin=True, attack=push, **settings)
    env.reset(seed=1)
    infos, total, over = [], 0.0, False
    while not over:
        _, reward, over, _, info = env.step(np.array([0.0, 1.0]))
        infos.append(info)
        total += reward
    return infos, total


@pytest.mark.parametrize(
    ("detector", "steps", "cost"),
    [
        (AlarmAt(LIVE + 5), 5, 0.0),
        (AlarmAt(LIVE + STEPS + 3), STEPS, 0.0),
        (AlarmOfMoved(LIVE + 15, LIVE + 9), 9, 1.0),
        # in the time to alert
        (AlarmOfMoved(LIVE + STEPS + HOLD - 1, LIVE + STEPS + 2), STEPS, 1.0),
    ],
)
def test_an_alarm_is_paid_where_the_twin_has_not_alarmed_so_far(detector, steps, cost):
    infos, total = play_twins(detector)
    assert len(infos) == steps
    assert infos[-1]["detected"]
    assert infos[-1]["twin_alarm"] == (not cost)
    assert [info["cost"] for info in infos] == [0.0] * (steps - 1) + [cost]
    price = cost * ALARM_PRICE * 40.0
    assert infos[-1]["reward_alarm"] == -price
    assert total == pytest.approx(infos[-1]["undetected_displacement_m"] - price)


def test_a_twins_alarm_is_remembered_and_without_a_twin_every_first_alarm_costs():
    infos, _ = play_twins(AlarmAt(LIVE + 5), end_at_alarm=False)
    said = [info["twin_alarm"] for info in infos]
    assert said == [False] * 4 + [True] * (STEPS - 4)
    env = victim("Zhong2025", detector=AlarmAt(LIVE + 5))
    env.reset(seed=1)
    infos = [env.step(np.zeros(2))[4] for _ in range(5)]
    assert [info["cost"] for info in infos] == [0.0] * 4 + [1.0]
    assert "twin_alarm" not in infos[-1]
