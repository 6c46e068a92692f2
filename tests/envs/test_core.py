"""Rewards, ends and warm-up of every victim."""

import dataclasses

import numpy as np
import pytest

from spoofgym.detectors import Never
from spoofgym.envs import SpoofCore
from spoofgym.envs.core import ALARM_PRICE
from spoofgym.envs.terms.observation import OwnCommand, Time
from spoofgym.envs.terms.reward import DisplacementGain
from spoofgym.simulation import Engine, TightlyCoupledSetup

from .support import HOLD, LIVE, SHORT, STEPS, VICTIMS, AlarmAt, single, victim, victims


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


def test_without_alarm_the_return_is_the_largest_displacement(kind):
    displacement, reward, infos = play(kind, Never())
    assert len(reward) == STEPS
    assert sum(reward) == pytest.approx(displacement.max())
    assert infos[-1]["undetected_displacement_m"] == pytest.approx(displacement.max())
    assert not infos[-1]["detected"]


@pytest.mark.parametrize("at", [1, 5, HOLD, HOLD + 1, HOLD + 2, 20, STEPS])
def test_an_alarm_takes_back_the_time_to_alert(kind, at):
    displacement, reward, infos = play(kind, AlarmAt(LIVE + at))
    assert len(reward) == at
    kept = displacement[: max(at - HOLD - 1, 0) + 1].max()
    assert sum(reward) == pytest.approx(kept - price_of(kind))
    assert infos[-1]["undetected_displacement_m"] == pytest.approx(kept)
    assert infos[-1]["detected"]


@pytest.mark.parametrize("late", [1, 4, HOLD])
def test_an_alarm_after_the_last_command_still_counts(kind, late):
    displacement, reward, infos = play(kind, AlarmAt(LIVE + STEPS + late))
    assert len(reward) == STEPS
    kept = displacement[: STEPS + late - HOLD].max()
    assert sum(reward) == pytest.approx(kept - price_of(kind))
    assert infos[-1]["alarm"]


def test_an_alarm_after_the_time_to_alert_comes_too_late(kind):
    displacement, reward, _ = play(kind, AlarmAt(LIVE + STEPS + HOLD + 1))
    assert sum(reward) == pytest.approx(displacement.max())


def test_without_end_at_alarm_the_rest_is_without_reward(kind):
    _, reward, infos = play(kind, AlarmAt(LIVE + 15), end_at_alarm=False)
    assert len(reward) == STEPS
    assert not np.any(reward[15:])
    assert infos[14]["alarm"]
    assert not infos[15]["alarm"]
    assert all(info["detected"] for info in infos[14:])


@pytest.mark.parametrize("at", [1, LIVE])
def test_an_alarm_in_the_warmup_is_latched_and_does_not_end_anything(kind, at):
    env = victim(kind, detector=AlarmAt(at)).unwrapped
    _, info = env.reset(seed=1)
    assert info["warmup_alarm"]
    assert info["time_s"] == pytest.approx(2 * LIVE * VICTIMS[kind])
    *_, terminated, _, info = env.step(np.zeros(env.action_space.shape))
    assert info["warmup_alarm"]
    assert not info["detected"]
    assert not terminated


def test_the_target_direction_counts(kind):
    east = play(kind, Never(), target_heading_deg=90.0)[0]
    west = play(kind, Never(), target_heading_deg=270.0)[0]
    np.testing.assert_allclose(east, -west, atol=1e-9)
    assert east[-1] > 1.0


def test_own_reward_terms_and_a_price_of_an_alarm(kind):
    *_, infos = play(kind, AlarmAt(LIVE + 3), alarm_price=2.5, length_m=10.0)
    assert infos[-1]["reward_alarm"] == -25.0
    env = victim(kind, reward=[DisplacementGain(per_m=2.0)], detector=Never())
    env.reset(seed=1)
    _, reward, _, _, info = env.step(np.full(env.action_space.shape, 0.5))
    assert reward == info["reward_displacement"]
    assert not any(name in info for name in ("reward_retraction", "reward_alarm"))


def test_a_receiver_that_starts_again_leaves_the_others_alone(kind):
    def played(restarted):
        core = victims(kind, 3, knowledge="oracle", detector=Never()).core
        core.reset([np.random.default_rng(i) for i in range(3)])
        action, seen = np.full((3, len(core.action_names)), 0.3), []
        for k in range(12):
            if restarted and k == 6:
                core.reset([np.random.default_rng(7)], np.array([1]))
            seen.append(core.step(action)[0].info["displacement_m"])
        return np.array(seen), core.score.step_count, core.observe()

    plain, mixed = played(False), played(True)
    np.testing.assert_array_equal(plain[0][:, [0, 2]], mixed[0][:, [0, 2]])
    np.testing.assert_array_equal(plain[2][[0, 2]], mixed[2][[0, 2]])
    assert not np.array_equal(plain[0][6:, 1], mixed[0][6:, 1])
    assert mixed[1].tolist() == [12, 6, 12]
    # the restarted one is a receiver of that generator from its start on
    own = victim(kind, knowledge="oracle", detector=Never()).unwrapped.core
    own.reset([np.random.default_rng(7)])
    for k in range(6):
        result, _ = own.step(np.full((1, len(own.action_names)), 0.3))
        assert result.info["displacement_m"] == mixed[0][6 + k, 1]


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


def test_receivers_and_threads_are_checked():
    setup = TightlyCoupledSetup(timeline=SHORT)
    with pytest.raises(ValueError, match="`receivers` must be at least 1, got 0"):
        Engine(0, setup)
    with pytest.raises(ValueError, match="`threads` must be at least 1, got 0"):
        Engine(1, setup, threads=0)
