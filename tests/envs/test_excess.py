"""With a clean twin an alarm costs only where that one has not alarmed so far."""

import numpy as np
import pytest

from spoofgym.detectors import Verdict
from spoofgym.envs.core import ALARM_PRICE

from .support import HOLD, LIVE, STEPS, AlarmAt, victim


class AlarmOfMoved(AlarmAt):
    """Alarms at one epoch for every receiver, at an earlier one for those that are spoofed."""

    def __init__(self, epoch: int, moved: int) -> None:
        super().__init__(epoch)
        self.moved = moved

    def judge(self, epoch) -> Verdict:
        verdict = super().judge(epoch)
        innovation = np.abs(epoch.innovation).max(axis=1, keepdims=True)
        hit = (self.memory["seen"][:, None] == self.moved) & (innovation > 30.0)
        alarm = verdict.alarm | hit
        return verdict._replace(statistic=alarm * 2.0, alarm=alarm)


PUSH = {"name": "false-position", "acceleration_limit_mps2": 50.0, "rate_limit_mps": 500.0}


def play(detector, **settings):
    env = victim("TightlyCoupled", detector=detector, twin=True, attack=PUSH, **settings)
    env.reset(seed=1)
    infos, total, over = [], 0.0, False
    while not over:
        _, reward, over, _, info = env.step(np.array([0.0, 1.0]))
        infos.append(info)
        total += reward
    return infos, total


@pytest.mark.parametrize("at", [5, STEPS + 3])
def test_an_alarm_of_both_is_chance(at):
    infos, total = play(AlarmAt(LIVE + at))
    assert infos[-1]["detected"]
    assert infos[-1]["twin_alarm"]
    assert sum(info["cost"] for info in infos) == 0.0
    assert total == pytest.approx(infos[-1]["undetected_displacement_m"])


def test_an_alarm_before_that_of_the_twin_is_paid():
    infos, total = play(AlarmOfMoved(LIVE + 15, LIVE + 9))
    assert len(infos) == 9
    assert not infos[-1]["twin_alarm"]
    assert infos[-1]["cost"] == 1.0
    price = ALARM_PRICE * 40.0
    assert infos[-1]["reward_alarm"] == -price
    assert total == pytest.approx(infos[-1]["undetected_displacement_m"] - price)


def test_an_alarm_in_the_time_to_alert_before_the_twins_is_paid():
    infos, _ = play(AlarmOfMoved(LIVE + STEPS + HOLD - 1, LIVE + STEPS + 2))
    assert len(infos) == STEPS
    assert infos[-1]["detected"]
    assert infos[-1]["cost"] == 1.0
    assert not infos[-1]["twin_alarm"]


def test_a_twins_alarm_is_remembered_for_the_episode():
    infos, _ = play(AlarmAt(LIVE + 5), end_at_alarm=False)
    said = [info["twin_alarm"] for info in infos]
    assert said == [False] * 4 + [True] * (STEPS - 4)


def test_without_a_twin_every_first_alarm_costs():
    env = victim("TightlyCoupled", detector=AlarmAt(LIVE + 5))
    env.reset(seed=1)
    infos = [env.step(np.zeros(2))[4] for _ in range(5)]
    assert [info["cost"] for info in infos] == [0.0] * 4 + [1.0]
    assert "twin_alarm" not in infos[-1]
