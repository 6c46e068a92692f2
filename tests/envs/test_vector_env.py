"""Vector environments: seeds, masks, final observations, and the information that is asked for."""

from __future__ import annotations

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from spoofgym.detectors import Never

from .players import COUNT, MODES, VICTIM_IDS, early
from .support import LIVE, STEPS, AlarmAt, vector


def make(name, mode="next_step", **kwargs):
    settings = early(name, knowledge="blind", **kwargs)
    return gym.make_vec(name, num_envs=COUNT, autoreset_mode=mode, **settings)


@pytest.fixture(params=VICTIM_IDS)
def name(request):
    return request.param


def actions(envs, rng):
    return rng.uniform(-0.2, 0.2, envs.action_space.shape).astype(np.float32)


def test_a_seed_is_that_of_every_receiver(name):
    envs = make(name)
    first, _ = envs.reset(seed=11)
    listed, _ = envs.reset(seed=[11, 12, 13])
    np.testing.assert_array_equal(first, listed)
    envs.reset(seed=11)
    onwards = envs.reset()[1]
    again = envs.reset(seed=11)[1]
    assert set(onwards) == set(again)
    with pytest.raises(ValueError, match="must have 3 elements, got 2"):
        envs.reset(seed=[1, 2])


def test_final_observation_and_information(name):
    envs = make(name, "same_step")
    envs.reset(seed=2)
    rng = np.random.default_rng(1)
    while True:
        *_, terminated, _, info = envs.step(actions(envs, rng))
        assert ("final_obs" in info) == terminated.any()
        if terminated.any():
            break
    np.testing.assert_array_equal(info["_final_obs"], terminated)
    np.testing.assert_array_equal(info["_final_info"], terminated)
    final = info["final_info"]
    np.testing.assert_array_equal(final["_alarm"], terminated)
    for i in range(COUNT):
        if terminated[i]:
            assert envs.single_observation_space.contains(info["final_obs"][i])
            assert final["time_s"][i] > info["time_s"][i]
        else:
            assert info["final_obs"][i] is None


def types(info):
    """Type of every array, by key, `final_info` looked into."""
    kinds = {key: value.dtype for key, value in info.items() if key != "final_info"}
    within = info.get("final_info", {})
    return {**kinds, **{f"final {key}": value.dtype for key, value in within.items()}}


def test_the_types_of_the_last_information_are_those_of_gymnasium(name):
    ours = make(name, "same_step")
    theirs = gym.vector.SyncVectorEnv(
        [lambda: gym.make(name, **early(name, knowledge="blind"))] * COUNT,
        autoreset_mode=AutoresetMode.SAME_STEP,
    )
    ours.reset(seed=4)
    theirs.reset(seed=4)
    rng = np.random.default_rng(0)
    ends = 0
    while ends < 3:
        given = actions(ours, rng)
        *_, terminated, truncated, told = ours.step(given)
        expected = theirs.step(given)[4]
        ends += (terminated | truncated).any()
        found, right = types(told), types(expected)
        # where nobody has a key, Gymnasium leaves it out, and ours is masked
        assert found.keys() >= right.keys()
        assert {key: found[key] for key in right} == right
    ours.close()
    theirs.close()


def test_a_finished_receiver_must_be_reset(name):
    envs = make(name, "disabled")
    with pytest.raises(RuntimeError, match="call reset"):
        envs.step(np.zeros(envs.action_space.shape))
    envs.reset(seed=0)
    terminated = np.zeros(COUNT, dtype=bool)
    while not terminated.any():
        *_, terminated, _, _ = envs.step(np.zeros(envs.action_space.shape))
    which = ", ".join(map(str, np.flatnonzero(terminated)))
    with pytest.raises(RuntimeError, match=rf"receivers {which} are over: call reset"):
        envs.step(np.zeros(envs.action_space.shape))


@pytest.mark.parametrize(
    ("mask", "error", "message"),
    [
        ([True, False, False], TypeError, "must be an array of dtype bool"),
        (np.array([1, 0, 0]), TypeError, "got dtype int64"),
        (np.array([True, False]), ValueError, r"must have shape \(3,\), got \(2,\)"),
        (np.zeros(3, dtype=bool), ValueError, "True for at least one"),
    ],
)
def test_a_wrong_mask_is_refused(mask, error, message):
    envs = make("spoofgym/Snapshot-v0", "disabled")
    envs.reset(seed=0)
    with pytest.raises(error, match=message):
        envs.reset(options={"reset_mask": mask})


def test_a_part_of_the_receivers_can_be_seeded():
    envs = make("spoofgym/Snapshot-v0", "disabled")
    with pytest.raises(ValueError, match="first reset must be that of all"):
        envs.reset(options={"reset_mask": np.array([True, False, False])})
    envs.reset(seed=5)
    zeros = np.zeros(envs.action_space.shape)
    envs.step(zeros)
    first, *_ = envs.step(zeros)
    options = {"reset_mask": np.array([False, True, False])}
    mixed, info = envs.reset(seed=100, options=options)
    assert "reset_mask" in options  # the user's own dictionary is left alone
    np.testing.assert_array_equal(mixed[[0, 2]], first[[0, 2]])
    np.testing.assert_array_equal(mixed[1], envs.reset(seed=100)[0][1])
    assert info["_time_s"].tolist() == [False, True, False]


def test_a_seed_for_some_leaves_the_streams_of_the_others_alone():
    plain, seeded = (make("spoofgym/Snapshot-v0", "disabled") for _ in range(2))
    for envs, seed in ((plain, None), (seeded, 100)):
        envs.reset(seed=5)
        envs.reset(seed=seed, options={"reset_mask": np.array([False, True, False])})
        envs.reset()
    expected, found = (envs.core.engine.simulator.position for envs in (plain, seeded))
    np.testing.assert_array_equal(found[[0, 2]], expected[[0, 2]])
    assert not np.array_equal(found[1], expected[1])


def test_some_receivers_have_the_circumstances_that_are_given_for_them():
    domain = {"start_s": [0.0, 20.0]}
    envs = gym.make_vec(
        "spoofgym/LooselyCoupled-v0", 3, autoreset_mode="disabled", domain=domain
    ).unwrapped
    begun = envs.reset(seed=5, options={"domain": {"start_s": [1.0, 2.0, 3.0]}})[1]["time_s"]
    options = {"domain": {"start_s": [7.0, 8.0, 9.0]}}
    options["reset_mask"] = np.array([False, True, True])
    again = envs.reset(options=options)[1]["time_s"]
    np.testing.assert_allclose(again - begun, [0.0, 6.0, 6.0])


def test_the_information_of_a_reset_is_the_users_own():
    changed, plain = (vector(2, detector=AlarmAt(LIVE)) for _ in range(2))
    begun = changed.reset(seed=1)[1]
    assert begun["warmup_alarm"].all()
    plain.reset(seed=1)
    for array in begun.values():
        array[...] = 0
    mine, expected = (envs.step(np.zeros((2, 2)))[4] for envs in (changed, plain))
    for key, array in expected.items():
        np.testing.assert_array_equal(mine[key], array, err_msg=key)


def test_unknown_options_are_warned_of(name):
    envs, env = make(name), gym.make(name, **early(name, knowledge="blind"))
    with pytest.warns(UserWarning, match=r"no option 'speed'; valid: domain, reset_mask"):
        envs.reset(seed=0, options={"speed": 2})
    with pytest.warns(UserWarning, match=r"no option 'speed'; valid: domain"):
        env.reset(seed=0, options={"speed": 2})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        envs.reset(seed=0, options={})
        env.reset(seed=0, options=None)


@pytest.mark.parametrize("mode", MODES)
def test_only_the_information_that_was_asked_for(name, mode):
    every = make(name, mode)
    every.reset(seed=3)
    info = every.step(np.zeros(every.action_space.shape))[4]
    assert set(every.core.info_names) == {key for key in info if not key.startswith("_")}
    for asked, names in (("none", set()), (("alarm", "time_s"), {"alarm", "time_s"})):
        envs = make(name, mode, infos=asked)
        begun = envs.reset(seed=3)[1]
        assert {key for key in begun if not key.startswith("_")} <= names
        over = np.zeros(COUNT, dtype=bool)
        while not over.any():
            *_, terminated, _, info = envs.step(np.zeros(envs.action_space.shape))
            over = terminated
            told = {key for key in info if not key.startswith("_")}
            assert told - {"final_obs", "final_info"} == names
        if mode == "same_step":
            assert {key for key in info["final_info"] if not key.startswith("_")} == names


def test_unknown_information_is_refused(name):
    with pytest.raises(ValueError, match=r"unknown info 'alarms'; valid: alarm.*did you mean"):
        make(name, infos=("alarms",))
    with pytest.raises(ValueError, match="unknown choice of infos 'some'; valid: all, none"):
        make(name, infos="some")


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
