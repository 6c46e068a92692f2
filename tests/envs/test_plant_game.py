"""The game over a plant is scored as that of the tightly coupled receiver."""

from __future__ import annotations

import numpy as np
import pytest

from spoofgym.detectors import Never
from spoofgym.envs.plant_game import PlantGame
from spoofgym.envs.rewards import DisplacementGain

from .test_game import AlarmAt as AlarmAtSatellites
from .toy_plant import ToyEnv, ToyPlant

LIVE, STEPS, HOLD = 20, 40, 10  # epochs of the toy's timeline


class AlarmAt(AlarmAtSatellites):
    measures = "any"


def play(detector, **kwargs):
    """Displacements, rewards and infos of one episode pushed east."""
    env = ToyEnv(detector=detector, **kwargs)
    env.reset(seed=1)
    displacement, reward, infos = [0.0], [], []
    for _ in range(STEPS):
        _, r, terminated, truncated, info = env.step(np.array([0.0, 0.5]))
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
    assert displacement[-1] > 10.0
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
    assert [info["alarm"] for info in infos].index(True) == 14
    assert all(info["detected"] for info in infos[14:])


@pytest.mark.parametrize("at", [1, LIVE])
def test_an_alarm_in_the_warmup_is_latched_and_does_not_end_anything(at):
    env = ToyEnv(detector=AlarmAt(at))
    _, info = env.reset(seed=1)
    assert info["warmup_alarm"]
    assert info["time_s"] == LIVE * 0.5
    *_, terminated, _, info = env.step(np.zeros(2))
    assert info["warmup_alarm"]
    assert not info["detected"]
    assert not terminated


def test_the_target_direction_counts():
    east, west, north = (
        play(Never(), target_heading_deg=heading)[0] for heading in (90.0, 270.0, 0.0)
    )
    np.testing.assert_allclose(east, -west, atol=1e-9)
    assert east[-1] > 10.0
    assert abs(north[-1]) < 5.0


def test_own_reward_terms_and_a_price_of_an_alarm():
    *_, infos = play(AlarmAt(LIVE + 3), alarm_penalty_m=25.0)
    assert infos[-1]["reward_alarm"] == -25.0
    game = PlantGame(ToyPlant(2), reward=[DisplacementGain(per_m=2.0)])
    game.reset([np.random.default_rng(i) for i in range(2)])
    turn = game.step(np.full((2, 2), 0.5))
    np.testing.assert_array_equal(turn.reward, turn.info["reward_displacement"])
    assert not any(name in turn.info for name in ("reward_retraction", "reward_alarm"))


def test_a_receiver_that_begins_anew_leaves_the_others_alone():
    def play(restarted):
        game = PlantGame(ToyPlant(3), knowledge="oracle")
        game.reset([np.random.default_rng(i) for i in range(3)])
        seen = []
        for k in range(12):
            if restarted and k == 6:
                game.reset([np.random.default_rng(7)], np.array([1]))
            seen.append(game.step(np.full((3, 2), 0.3)).info["displacement_m"])
        return np.array(seen), game.step_count, game.observe()

    plain, mixed = play(False), play(True)
    np.testing.assert_array_equal(plain[0][:, [0, 2]], mixed[0][:, [0, 2]])
    np.testing.assert_array_equal(plain[2][[0, 2]], mixed[2][[0, 2]])
    assert not np.array_equal(plain[0][6:, 1], mixed[0][6:, 1])
    assert mixed[1].tolist() == [12, 6, 12]
    # the restarted one is a receiver of that generator from its begin on
    own = PlantGame(ToyPlant(1), knowledge="oracle")
    own.reset([np.random.default_rng(7)])
    for k in range(6):
        assert own.step(np.full((1, 2), 0.3)).info["displacement_m"] == mixed[0][6 + k, 1]


class Twice(ToyPlant):
    def observation(self, knowledge):
        return ("a", "a"), np.zeros(2), np.ones(2)


class Unbounded(ToyPlant):
    def observation(self, knowledge):
        return ("a", "b"), np.zeros(2), np.array([1.0, np.inf])


class OneBound(ToyPlant):
    def observation(self, knowledge):
        return ("a", "b"), np.zeros(1), np.ones(1)


@pytest.mark.parametrize(
    ("plant", "kwargs", "message"),
    [
        (Twice, {}, "the observation of 'toy' has elements of the same name: a"),
        (Unbounded, {}, "needs finite bounds of 'b', got 0.0 to inf"),
        (OneBound, {}, r"has 2 names, but bounds of shapes \(1,\)"),
        (ToyPlant, {"knowledge": "omniscient"}, "unknown knowledge 'omniscient'"),
        (ToyPlant, {"target_heading_deg": np.inf}, "`target_heading_deg` must be a finite number"),
        (ToyPlant, {"alarm_penalty_m": -1.0}, "`penalty_m` must be finite"),
        (ToyPlant, {"reward": [DisplacementGain()] * 2}, "two reward terms have the same name"),
    ],
)
def test_settings_are_checked(plant, kwargs, message):
    with pytest.raises(ValueError, match=message):
        PlantGame(plant(1), **kwargs)
