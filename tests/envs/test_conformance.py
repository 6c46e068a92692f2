"""The contracts of Gymnasium and Stable-Baselines3."""

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.env_match import check_environments_match

from .support import ID, SHORT, Squeezed, single, vector

VARIANTS = [
    {},
    {"knowledge": "blind"},
    {"knowledge": "oracle", "detector": "snapshot-chi2"},
    {"attack": {"name": "per-channel", "control": "rate", "coherent": False}},
    {"detector": "never", "end_at_alarm": False, "receiver": {"tuning": "matched"}},
]


@pytest.mark.parametrize("kwargs", VARIANTS)
def test_gymnasium_check_env(kwargs):
    # a warning is an error here, so that the advice of the checker counts, too
    check_env(single(**kwargs).unwrapped)


@pytest.mark.parametrize("kwargs", VARIANTS[:3])
def test_stable_baselines3_check_env(kwargs):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(single(**kwargs).unwrapped, warn=True)


@pytest.mark.parametrize("kwargs", VARIANTS[:3])
def test_the_vector_env_of_one_is_the_single_env(kwargs):
    env = single(**kwargs).unwrapped
    check_environments_match(env, Squeezed(**kwargs), num_steps=29, seed=7)


def test_the_default_is_what_the_architecture_says():
    env = gym.make(ID).unwrapped
    setup = env.core.setup
    assert (setup.onset, setup.steps, setup.hold) == (400, 300, 20)
    assert setup.detector.weight_scale == 0.3
    assert env.action_names == ("north_acceleration", "east_acceleration")
    assert gym.spec(ID).max_episode_steps is None


def test_make_vec_uses_the_vector_entry_point():
    envs = gym.make_vec(ID, num_envs=3, timeline=SHORT, autoreset_mode="same_step")
    assert envs.metadata["autoreset_mode"] == gym.vector.AutoresetMode.SAME_STEP
    observation, _ = envs.reset(seed=1)
    assert envs.observation_space.contains(observation)
    again = gym.make_vec(envs.spec)
    assert again.num_envs == 3


def test_the_spec_goes_through_json():
    env = single(detector={"name": "ewma", "weight_scale": None})
    copy = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert copy.unwrapped.core.setup.detector.weight_scale is None


@pytest.mark.parametrize("make", [lambda: single().unwrapped, lambda: vector(3)])
def test_an_unfinished_episode_survives_pickling(make):
    env = make()
    env.reset(seed=5)
    action = np.full(env.action_space.shape, 0.3, dtype=np.float32)
    for _ in range(4):
        env.step(action)
    copy = pickle.loads(pickle.dumps(env))
    for _ in range(4):
        mine, theirs = env.step(action), copy.step(action)
        np.testing.assert_array_equal(mine[0], theirs[0])
        np.testing.assert_array_equal(mine[1], theirs[1])


def test_observations_and_actions_are_named():
    env = single(knowledge="oracle").unwrapped
    assert len(env.observation_names) == env.observation_space.shape[0]
    assert len(set(env.observation_names)) == len(env.observation_names)
    assert len(env.action_names) == env.action_space.shape[0]
    assert np.isfinite(env.observation_space.low).all()


@pytest.mark.parametrize(
    "bad", [np.array([np.nan, 0.0]), np.array([0.0, 1.5]), np.array([np.inf, 0])]
)
def test_a_bad_action_names_element_and_value(bad):
    env = single().unwrapped
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"finite and in \[-1, 1\].*acceleration.*is"):
        env.step(bad)
    envs = vector(2)
    envs.reset(seed=0)
    with pytest.raises(ValueError, match="of receiver 1 is"):
        envs.step(np.stack([np.zeros(2), bad]))
    with pytest.raises(ValueError, match=r"shape \(2, 2\)"):
        envs.step(np.zeros(2))


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"detector": "ewna"}, "valid: acna, .*; did you mean 'ewma'"),
        ({"detector": {"name": "ewma", "lambda": 1}}, "no setting 'lambda'; valid: smoothing"),
        (
            {"detector": {"name": "windowed-chi2", "window": 5000}},
            "WindowedChi2 can't alarm in its first 4999 epochs, and an episode has 60",
        ),
        (
            {"detector": {"name": "cusum", "bias_window_s": 220.0}},
            "Cusum can't alarm in its first 440 epochs",
        ),
        ({"attack": "meaconner"}, "unknown attack .*did you mean 'meaconer'"),
        ({"scenario": "mars"}, "unknown scenario"),
        ({"scenario": {"imu": "toy"}}, "unknown imu grade"),
        ({"receiver": {"tunes": "paper"}}, "no setting 'tunes'"),
        ({"knowledge": "omniscient"}, "unknown knowledge"),
        ({"timeline": {"warmup_s": 500.0}}, "lasts 418 s"),
        (
            {"timeline": {"warmup_s": 400.0}, "decision_interval_s": 5.0},
            r"takes 565 s .warm-up 400 s, .* 10 s, and one decision of 5 s in reserve.",
        ),
        ({"attack": {"name": "per-channel", "channels": ["S05", "S05"]}}, "each satellite once"),
        ({"timeline": {"attack_s": -1.0}}, "`attack_s` must be"),
        ({"alarm_penalty_m": -1.0}, "`penalty_m` must be"),
        ({"target_heading_deg": np.nan}, "`target_heading_deg` must be a finite number"),
        ({"attack": {"name": "per-channel", "channels": ["S99"]}}, "'S99' is not in view"),
        ({"autoreset_mode": "sometimes"}, "unknown autoreset mode"),
        ({"render_mode": "rgb_array"}, "nothing to render"),
    ],
)
def test_a_wrong_setting_says_what_is_valid(kwargs, message):
    with pytest.raises(ValueError, match=message):
        vector(2, **kwargs)


def test_a_finished_episode_must_be_reset():
    env = single().unwrapped
    with pytest.raises(RuntimeError, match="call reset"):
        env.step(np.zeros(2))


def test_what_a_reset_does_not_take_is_told_by_its_name():
    env, envs = single(), vector(2)
    with pytest.raises(RuntimeError, match="no episode has started: call reset"):
        env.unwrapped.step(np.zeros(2))
    for made in (env, envs):
        with pytest.raises(
            TypeError, match=r"`options` of a reset must be a dict, got \['domain'\]"
        ):
            made.reset(options=["domain"])
        for seed in ("abc", 1.5, -1):
            with pytest.raises(ValueError, match=f"a seed must be a whole number.* got {seed!r}"):
                made.reset(seed=seed)
    with pytest.raises(ValueError, match=r"must be a whole number of at least 0, got 0\.5"):
        envs.reset(seed=[1, 0.5])
    with pytest.raises(
        ValueError, match=r"`num_envs` must be a whole number of at least 1, got 1\.5"
    ):
        vector(1.5)
