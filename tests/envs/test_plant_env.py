"""The contracts of Gymnasium, kept by an environment over any plant."""

from __future__ import annotations

import copy
import inspect
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from spoofgym.detectors import Never
from spoofgym.envs.plant_env import PlantEnv

from .toy_plant import FarFix, ToyEnv, ToyPlant, ToyVectorEnv

NOISY = {"detector": FarFix(threshold_m=4.0), "rate_mps": 3.0}  # some episodes end early


@pytest.fixture
def registered():
    """The toy, registered as an environment of this package would be."""
    name = "toy-test/Toy-v0"
    gym.register(
        name,
        entry_point="tests.envs.toy_plant:ToyEnv",
        vector_entry_point="tests.envs.toy_plant:ToyVectorEnv",
    )
    yield name
    del gym.registry[name]


@pytest.mark.parametrize("kwargs", [{}, {"knowledge": "blind"}, {"knowledge": "oracle", **NOISY}])
def test_gymnasium_check_env(registered, kwargs):
    # a warning is an error here, so that the advice of the checker counts, too
    check_env(gym.make(registered, **kwargs).unwrapped)


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
@pytest.mark.parametrize("end_at_alarm", [True, False])
def test_the_vector_env_is_the_single_ones(mode, end_at_alarm):
    """Observations, rewards, ends and information, bit for bit, over many autoresets."""
    kwargs = {"knowledge": "oracle", "end_at_alarm": end_at_alarm, **NOISY}
    envs = ToyVectorEnv(9, autoreset_mode=mode, **kwargs)
    seen, begin = envs.reset(seed=30)
    singles = [ToyEnv(**kwargs) for _ in range(9)]
    for i, env in enumerate(singles):
        observation, info = env.reset(seed=30 + i)
        np.testing.assert_array_equal(observation, seen[i])
        assert {name: begin[name][i] for name in info} == info
    rng = np.random.default_rng(3)
    over = np.zeros(9, dtype=bool)
    nobody = np.zeros(9, dtype=bool)
    ends = mixed = 0
    for _ in range(130):
        action = rng.uniform(-0.3, 1.0, (9, 2))
        observations, reward, terminated, truncated, info = envs.step(action)
        assert not truncated.any()
        mixed += over.any() and not over.all()
        for i, env in enumerate(singles):
            if mode == "next_step" and over[i]:
                (observation, mine), r, end = env.reset(), 0.0, False
                assert not info.get("_reward_alarm", nobody)[i]
            else:
                observation, r, end, _, mine = env.step(action[i])
                if mode == "same_step" and end:
                    np.testing.assert_array_equal(observation, info["final_obs"][i])
                    final = info["final_info"]
                    assert {name: final[name][i] for name in mine} == mine
                    assert all(final[f"_{name}"][i] for name in mine)
                    observation, mine = env.reset()
            np.testing.assert_array_equal(observation, observations[i])
            assert (reward[i], terminated[i]) == (r, end)
            assert {name: info[name][i] for name in mine} == mine
            assert all(info[f"_{name}"][i] for name in mine)
            over[i] = end
            ends += end
    assert ends >= 18
    if end_at_alarm and mode == "next_step":
        assert mixed > 5


def test_episodes_of_one_seed_differ_and_repeat():
    env = ToyEnv(knowledge="oracle", detector=FarFix())
    first, _ = env.reset(seed=4)
    second, _ = env.reset()
    again, _ = env.reset(seed=4)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, second)


@pytest.mark.parametrize("duplicate", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy])
@pytest.mark.parametrize("make", [lambda: ToyEnv(**NOISY), lambda: ToyVectorEnv(3, **NOISY)])
def test_an_unfinished_episode_survives_copying(make, duplicate):
    env = make()
    env.reset(seed=5)
    action = np.full(env.action_space.shape, 0.4, dtype=np.float32)
    for _ in range(4):
        env.step(action)
    other = duplicate(env)
    for _ in range(6):
        mine, theirs = env.step(action), other.step(action)
        for a, b in zip(mine[:4], theirs[:4], strict=True):
            np.testing.assert_array_equal(a, b)
    env.reset()
    other.reset()
    np.testing.assert_array_equal(env.step(action)[0], other.step(action)[0])


def test_make_vec_and_the_spec(registered):
    envs = gym.make_vec(registered, num_envs=3, rate_mps=1.0, autoreset_mode="same_step")
    assert envs.metadata["autoreset_mode"] == gym.vector.AutoresetMode.SAME_STEP
    observation, _ = envs.reset(seed=1)
    assert envs.observation_space.contains(observation)
    assert gym.make_vec(envs.spec).num_envs == 3
    env = gym.make(registered, detector="never", timeline={"attack_s": 5.0, "live_s": 10.0})
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json())).unwrapped
    assert again.game.plant.steps == 10


def test_the_signature_shows_the_settings_of_the_plant():
    single, vector = inspect.signature(ToyEnv), inspect.signature(ToyVectorEnv)
    assert single.parameters["rate_mps"].default == 2.0
    assert "settings" not in single.parameters
    assert next(iter(vector.parameters)) == "num_envs"
    assert list(single.parameters)[-2:] == ["rate_mps", "gain"]


def test_observations_and_actions_are_named():
    env = ToyEnv(knowledge="oracle")
    assert len(env.observation_names) == env.observation_space.shape[0]
    assert env.action_names == ("north_rate", "east_rate")
    levels = [set(ToyEnv(knowledge=k).observation_names) for k in ("blind", "tracking", "oracle")]
    assert levels[0] < levels[1] < levels[2]


@pytest.mark.parametrize("bad", [[np.nan, 0.0], [0.0, 1.5], [np.inf, 0]])
def test_a_bad_action_names_element_and_value(bad):
    env, envs = ToyEnv(), ToyVectorEnv(2)
    env.reset(seed=0)
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=r"finite and in \[-1, 1\].*_rate.*is"):
        env.step(bad)
    with pytest.raises(ValueError, match=r"shape \(2,\) .*got \(3,\)"):
        env.step([0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="of receiver 1 is"):
        envs.step([[0.0, 0.0], bad])
    with pytest.raises(ValueError, match=r"shape \(2, 2\)"):
        envs.step([0.0, 0.0])


def test_a_step_needs_a_running_episode():
    with pytest.raises(RuntimeError, match=r"call reset\(\) before step"):
        ToyEnv().step([0.0, 0.0])
    with pytest.raises(RuntimeError, match=r"call reset\(\) before step"):
        ToyVectorEnv(2).step(np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        (
            {"rate": 1.0},
            "'toy' has no setting 'rate'; valid: detector, timeline, knowledge, .*rate_mps, gain",
        ),
        ({"rate_mps": 0.0}, "`rate_mps` must be > 0, got 0.0"),
        ({"receivers": 4}, "no setting 'receivers'"),
        ({"detector": "ewma"}, "Ewma measures satellites, but the receiver measures position"),
        ({"knowledge": "omniscient"}, "unknown knowledge"),
        ({"render_mode": "rgb_array"}, "nothing to render"),
    ],
)
def test_a_wrong_setting_says_what_is_valid(kwargs, message):
    with pytest.raises(ValueError, match=message):
        ToyEnv(**kwargs)
    with pytest.raises(ValueError, match=message):
        ToyVectorEnv(2, **kwargs)


def test_wrong_numbers_and_modes_of_a_vector_env():
    with pytest.raises(ValueError, match="`num_envs` must be at least 1, got 0"):
        ToyVectorEnv(0)
    with pytest.raises(ValueError, match="unknown autoreset mode 'sometimes'"):
        ToyVectorEnv(2, autoreset_mode="sometimes")
    with pytest.raises(ValueError, match="must have 2 elements, got 3"):
        ToyVectorEnv(2).reset(seed=[1, 2, 3])


class OwnDetector(ToyPlant):
    """Has another default than None."""

    def __init__(self, receivers, *, detector="never", timeline=None):
        super().__init__(receivers, detector=detector, timeline=timeline)


def test_none_is_the_default_of_the_plant():
    class OwnEnv(PlantEnv):
        plant_type = OwnDetector

    assert isinstance(OwnEnv(detector=None).game.plant.detector, Never)
    assert "rate_mps" not in inspect.signature(OwnEnv).parameters
