"""Vector environments: seeds of some, final observations, and the information that is asked for."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from .players import COUNT, MODES, early
from .support import ID, LIVE, AlarmAt, vector, victims

SMALL = "spoofgym/Snapshot-v0"


def make(name, mode="next_step", **kwargs):
    settings = early(name, knowledge="blind", **kwargs)
    return gym.make_vec(name, num_envs=COUNT, autoreset_mode=mode, **settings)


def types(info):
    kinds = {key: value.dtype for key, value in info.items() if key != "final_info"}
    within = info.get("final_info", {})
    return {**kinds, **{f"final {key}": value.dtype for key, value in within.items()}}


@pytest.mark.parametrize("name", [ID, SMALL])
def test_the_last_information_is_that_of_gymnasium(name):
    ours = make(name, "same_step")
    theirs = gym.vector.SyncVectorEnv(
        [lambda: gym.make(name, **early(name, knowledge="blind"))] * COUNT,
        autoreset_mode=AutoresetMode.SAME_STEP,
    )
    ours.reset(seed=4)
    theirs.reset(seed=4)
    rng, ends = np.random.default_rng(0), 0
    while ends < 3:
        given = rng.uniform(-0.2, 0.2, ours.action_space.shape).astype(np.float32)
        *_, terminated, truncated, told = ours.step(given)
        expected = theirs.step(given)[4]
        over = terminated | truncated
        ends += over.any()
        assert ("final_obs" in told) == over.any()
        if over.any():
            np.testing.assert_array_equal(told["_final_obs"], over)
            np.testing.assert_array_equal(told["_final_info"], over)
            assert [last is None for last in told["final_obs"]] == (~over).tolist()
        found, right = types(told), types(expected)
        # where nobody has a key, Gymnasium leaves it out, and ours is masked
        assert right.items() <= found.items()


def test_a_finished_receiver_must_be_reset():
    envs = make(SMALL, "disabled")
    still = np.zeros(envs.action_space.shape)
    with pytest.raises(RuntimeError, match="call reset"):
        envs.step(still)
    envs.reset(seed=0)
    terminated = np.zeros(COUNT, dtype=bool)
    while not terminated.any():
        *_, terminated, _, _ = envs.step(still)
    which = ", ".join(map(str, np.flatnonzero(terminated)))
    with pytest.raises(RuntimeError, match=rf"receivers {which} are over: call reset"):
        envs.step(still)


def test_a_part_of_the_receivers_can_be_seeded_and_given_circumstances():
    envs, plain = make(SMALL, "disabled"), make(SMALL, "disabled")
    envs.reset(seed=5)
    first, *_ = envs.step(np.zeros(envs.action_space.shape))
    options = {"reset_mask": np.array([False, True, False])}
    mixed, info = envs.reset(seed=100, options=options)
    assert "reset_mask" in options  # the user's own dictionary is left alone
    np.testing.assert_array_equal(mixed[[0, 2]], first[[0, 2]])
    np.testing.assert_array_equal(mixed[1], envs.reset(seed=100)[0][1])
    assert info["_time_s"].tolist() == [False, True, False]
    # the streams of the others go on as if nothing had been
    for each, seed in ((plain, None), (envs, 100)):
        each.reset(seed=5)
        each.reset(seed=seed, options=options)
        each.reset()
    expected, found = (each.unwrapped.core.engine.simulator.position for each in (plain, envs))
    np.testing.assert_array_equal(found[[0, 2]], expected[[0, 2]])
    assert not np.array_equal(found[1], expected[1])
    envs = victims("LooselyCoupled", 3, autoreset_mode="disabled", domain={"start_s": [0.0, 20.0]})
    begun = envs.reset(seed=5, options={"domain": {"start_s": [1.0, 2.0, 3.0]}})[1]["time_s"]
    mask = np.array([False, True, True])
    options = {"domain": {"start_s": [7.0, 8.0, 9.0]}, "reset_mask": mask}
    np.testing.assert_allclose(envs.reset(options=options)[1]["time_s"] - begun, [0.0, 6.0, 6.0])


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


@pytest.mark.parametrize("mode", MODES)
def test_only_the_information_that_was_asked_for(mode):
    every = make(SMALL, mode).unwrapped.core.info_names
    for asked, names in (("all", {*every}), ("none", set()), (("alarm", "time_s"), None)):
        names = {*asked} if names is None else names
        envs = make(SMALL, mode, infos=asked)
        begun = envs.reset(seed=3)[1]
        assert {key for key in begun if key[0] != "_"} <= names
        over = np.zeros(COUNT, dtype=bool)
        while not over.any():
            *_, over, _, info = envs.step(np.zeros(envs.action_space.shape))
            told = {key for key in info if key[0] != "_"}
            assert told - {"final_obs", "final_info"} == names
        if mode == "same_step":
            assert {key for key in info["final_info"] if key[0] != "_"} == names
