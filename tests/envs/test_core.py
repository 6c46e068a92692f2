"""Rewards, ends and warm-up of every victim."""

import dataclasses

import numpy as np
import pytest

from spoofgym.detectors import Never
from spoofgym.envs import SpoofCore
from spoofgym.envs.core import ALARM_PRICE
from spoofgym.envs.terms.reward import DisplacementGain
from spoofgym.simulation import TightlyCoupledSetup

from .support import HOLD, LIVE, SHORT, SMALL, STEPS, VICTIMS, AlarmAt, victim


@pytest.fixture(params=VICTIMS)
def kind(request):
    return request.param


def price_of(kind):
    return ALARM_PRICE * victim(kind).unwrapped.core.setup.scales["length_m"]


def play(kind, detector, **kwargs):
    """Displacements, rewards and infos of one episode pushed east."""
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


EDGES = [1, HOLD, HOLD + 1, HOLD + 2, STEPS, STEPS + 1, STEPS + HOLD, STEPS + HOLD + 1]
"""Epochs of an alarm: with all taken back, a part, and after the last command; then too late."""


@pytest.mark.parametrize(
    ("kind", "at"),
    [*(("TightlyCoupled", at) for at in EDGES), *((kind, at) for kind in SMALL for at in (20, 44))],
)
def test_an_alarm_takes_back_the_time_to_alert(kind, at):
    displacement, reward, infos = play(kind, AlarmAt(LIVE + at))
    detected = at <= STEPS + HOLD
    assert len(reward) == min(at, STEPS)
    kept = displacement[: max(at - HOLD - 1, 0) + 1].max()
    assert sum(reward) == pytest.approx(kept - detected * price_of(kind))
    assert infos[-1]["undetected_displacement_m"] == pytest.approx(kept)
    assert infos[-1]["detected"] == infos[-1]["alarm"] == detected


def test_without_end_at_alarm_the_rest_is_without_reward(kind):
    _, reward, infos = play(kind, AlarmAt(LIVE + 15), end_at_alarm=False)
    assert len(reward) == STEPS
    assert not np.any(reward[15:])
    assert infos[14]["alarm"]
    assert not infos[15]["alarm"]
    assert all(info["detected"] for info in infos[14:])


def test_an_alarm_in_the_warmup_is_latched_and_does_not_end_anything(kind):
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


def test_the_target_direction_counts(kind):
    east = play(kind, Never(), target_heading_deg=90.0)[0]
    west = play(kind, Never(), target_heading_deg=270.0)[0]
    np.testing.assert_allclose(east, -west, atol=1e-9)
    assert east[-1] > 1.0


def test_fewer_than_four_satellites_coast_and_say_so():
    """Satellites that sink after the first fix: the receiver coasts, and the detector is quiet."""
    setup = TightlyCoupledSetup(timeline=SHORT, detector="ewma")
    visible, satellites = setup.world.visible.copy(), setup.world.satellites.copy()
    visible[45:60, 3:] = False
    satellites[45:60, 3:, 6:] = 0.0
    setup.world = dataclasses.replace(setup.world, visible=visible, satellites=satellites)
    core = SpoofCore(2, setup, action="full-command")
    core.reset([np.random.default_rng(i) for i in range(2)])
    buffers = core.engine.simulator.buffers
    before = np.sqrt(buffers.covariance[:, 6, 6])
    coasting, spread = [], []
    for _ in range(25):
        result, observation = core.step(np.zeros((2, 2)))
        coasting.append(result.info["coasting"])
        spread.append(np.sqrt(buffers.covariance[:, 6, 6]))
    coasting, spread = np.array(coasting), np.array(spread)
    assert not coasting[:4].any()
    assert coasting[4:19].all()
    assert not coasting[19:].any()
    assert (np.diff(spread[5:19], axis=0) > 0.0).all()
    assert (spread[-1] < 2.0 * before).all()
    assert np.isfinite(observation).all()
