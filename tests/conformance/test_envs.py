"""One matrix: every id, in every form that it has, keeps every contract.

The forms are the single environment, the vector one in its three autoreset modes, the adapter for
stable-baselines3; the contracts are those of Gymnasium's checkers, determinism,
pickling within an episode, that receiver i is the single environment seeded ``seed + i``, and that
a spec goes through JSON and makes the same environment again.
"""

import json
import pickle
from copy import deepcopy
from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from spoofgym.envs.factory import DEFAULT_ID
from tests.nightly import heavy

from ..envs.players import (
    COUNT,
    IDS,
    MODES,
    SMALL_IDS,
    VICTIM_IDS,
    Player,
    assert_same,
    early,
    forms_of,
    make,
    short,
)
from ..golden import trajectories

MAIN = VICTIM_IDS[0]
WORLDS = {"start_s": [0.0, 30.0], "turned_deg": [0.0, 360.0], "worlds": 2}
PUSHED = {"name": "at-displacement", "limit_m": 9.0}
MAIN_VARIANTS = {
    "twin": {"twin": True},
    "watch": {"watch": ["snapshot-chi2", {"name": "cusum"}], "end_at_alarm": False},
    "domain": {"domain": WORLDS, "target_heading_deg": "random"},
    "oracle": {"knowledge": "oracle", "detector": {"name": "ewma", "false_alarm": 0.05}},
    "worst": {"target_heading_deg": "worst", "twin": True},
    "interval": {"decision_interval_s": 1.0, "between": "linear"},
    "tracking-1m": {"attack": "tracking-1m", "receiver": "matched", "scenario": "trolley"},
    "meaconer": {"attack": "meaconer", "detector": {"name": "cusum"}},
    "offsets": {
        "attack": {"name": "offsets", "slot_order": "elevation", "errors": "replaced"},
        **{"control": "offset", "basis": "rotated", "channels": "6 drawn", "domain": WORLDS},
    },
    "per channel": {"attack": {"name": "per-channel", "control": "rate", "coherent": False}},
    "all": {
        "twin": True,
        "watch": ["snapshot-chi2"],
        "domain": WORLDS,
        "attack": "tracking-1m",
        "decision_interval_s": 1.0,
        "observation": ["own-command", "divergence-spent", "estimate-error"],
        "reward": ["displacement-gain", "effort-penalty"],
        "end": ["at-alarm", PUSHED, {"name": "at-steps", "steps": 7}],
    },
}
"""Settings of the main id that change what is simulated, or what with."""
SMALL_DOMAINS = {
    "spoofgym/LooselyCoupled-v0": {"start_s": [0.0, 5.0]},
    "spoofgym/Snapshot-v0": {"turned_deg": [0.0, 360.0], "worlds": 3},
    "spoofgym/WheeledRobot-v0": {"start_s": [0.0, None]},
}
INTERVALS = {"spoofgym/LooselyCoupled-v0": 0.1, MAIN: 0.5}


def small_variants(name):
    """The like, of a small id."""
    domain, interval = SMALL_DOMAINS[name], INTERVALS.get(name, 1.0)
    return {
        "worst": {
            "target_heading_deg": "worst",
            "twin": True,
            "watch": ["never", "never"],
            "end_at_alarm": False,
            "knowledge": "oracle",
            "decision_interval_s": 2.0 * interval,
            "between": "linear",
        },
        "all": {
            "twin": True,
            "watch": ["never"],
            "domain": domain,
            "target_heading_deg": "random",
            "decision_interval_s": 3.0 * interval,
            "observation": ["own-command", "target-direction", "estimate-error"],
            "action": ["along-target", "across-target"],
            "reward": ["displacement-gain", "effort-penalty"],
            "end": ["at-alarm", PUSHED, {"name": "at-steps", "steps": 7}],
        },
    }


VARIED = [
    *((MAIN, word, kwargs) for word, kwargs in MAIN_VARIANTS.items()),
    *((name, *variant) for name in SMALL_IDS for variant in small_variants(name).items()),
]
CODE_IDS = [name for name in IDS if "/Bench" not in name and name != DEFAULT_ID]
"""Ids that differ in code; a task is one of them at other settings, which is made and played."""
TASKS = [name for name in IDS if name not in CODE_IDS]
ROUTINE = ("spoofgym/BenchD1-v1", "spoofgym/BenchT3-v1")
"""A task of each side that does not wait for the nightly tests to be played at full size."""
LATER = ("spoofgym/Offsets-v0", *(name for name in TASKS if name not in ROUTINE))
every_code = pytest.mark.parametrize("name", CODE_IDS)
some_codes = pytest.mark.parametrize("name", [MAIN, "spoofgym/DetectorView-v0"])
every_variant = pytest.mark.parametrize(
    ("name", "kwargs"),
    [pytest.param(name, kwargs, id=f"{name[9:-3]}-{word}") for name, word, kwargs in VARIED],
)
FORMS = [(name, form) for name in CODE_IDS for form in forms_of(name)]


def enough(env):
    """Steps that go over the end of the first episode of every receiver."""
    steps = getattr(env, "unwrapped", env).core.episode_steps
    return steps + 4


def rewards(rows):
    return [[each["reward"] for each in row if "reward" in each] for row in rows]


def seen_and_paid(rows):
    return [[(each["seen"].tolist(), each.get("reward")) for each in row] for row in rows]


def passed_an_end(rows):
    return all(any("reward" not in each for each in row[1:]) for row in rows)


# --- checkers --------------------------------------------------------------------------------


def check(name, kwargs):
    # a warning is an error here, so that the advice of the checker counts, too;
    # pictures are checked in `tests/envs/rendering`
    env = gym.make(name, **short(name, **kwargs)).unwrapped
    assert env.spec is not None
    check_env(env, skip_render_check=True)


@every_code
def test_gymnasium_check_env(name):
    check(name, {})


@every_variant
def test_gymnasium_check_env_at(name, kwargs):
    check(name, kwargs)


@every_code
def test_stable_baselines3_check_env(name):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gym.make(name, **short(name)).unwrapped, warn=True)


@every_code
@pytest.mark.parametrize("mode", MODES)
def test_spaces_types_and_masks_of_a_vector_env(name, mode):
    envs = make(name, mode, **early(name))
    assert envs.metadata["autoreset_mode"] == AutoresetMode[mode.upper()]
    observation, info = envs.reset(seed=4)
    rng, ended, held = np.random.default_rng(0), np.zeros(COUNT, dtype=int), []
    for _ in range(enough(envs)):
        held.append((observation, observation.copy()))
        assert envs.observation_space.contains(observation)
        assert observation.dtype == np.float32
        for key, value in info.items():
            if not key.startswith("_") and key != "final_info":
                assert value.shape[0] == COUNT, key
                assert info[f"_{key}"].dtype == bool
                assert info[f"_{key}"].shape == (COUNT,)
        action = rng.uniform(-0.2, 0.2, envs.action_space.shape).astype(np.float32)
        observation, reward, terminated, truncated, info = envs.step(action)
        assert reward.shape == terminated.shape == truncated.shape == (COUNT,)
        assert (reward.dtype, terminated.dtype, truncated.dtype) == (float, bool, bool)
        over = terminated | truncated
        ended += over
        if mode == "disabled" and over.any():
            observation, info = envs.reset(options={"reset_mask": over})
            np.testing.assert_array_equal(info["_time_s"], over)
    assert ended.min() >= 1
    for given, kept in held:  # nothing that was handed out is written again
        np.testing.assert_array_equal(given, kept)


@pytest.mark.parametrize("name", TASKS)
def test_a_task_plays_in_every_form_alike(name):
    forms = {*forms_of(name)} - {"next_step", "disabled"}  # which do not depend on the id
    first, *others = (
        Player(make(name, form, **early(name)), form).begin(5).go(2) for form in sorted(forms)
    )
    for found in others:
        np.testing.assert_allclose(rewards(found)[0], rewards(first)[0], rtol=1e-6)


# --- determinism, pickling, and receivers of a batch ------------------------------------------


@pytest.mark.parametrize(("name", "form"), FORMS)
def test_a_seed_tells_all_that_happens_and_copies_go_on_within_an_episode(name, form):
    player = Player(make(name, form, **early(name)), form).begin(5)
    steps, first = enough(player.env), player.go(3)
    copies = {"unpickled": pickle.loads(pickle.dumps(player)), "copied": deepcopy(player)}
    later = player.go(steps)
    assert passed_an_end(later)
    for word, copy in copies.items():
        assert_same(later, copy.go(steps), word)
    player.begin(5)
    assert_same([first, later], [player.go(3), player.go(steps)], "again")
    other = player.begin(50).go(3)
    assert seen_and_paid(first) != seen_and_paid(other)


@cache
def alone(name):
    """What single environments go through, beyond the ends of their first episodes."""
    rows = []
    for i in range(COUNT):
        player = Player(make(name, "single", **early(name)), "single", first=i).begin(20 + i)
        rows += player.go(enough(player.env) + 8)
    assert passed_an_end(rows)
    return rows


@pytest.mark.parametrize(("name", "form"), [each for each in FORMS if each[1] != "single"])
def test_every_receiver_of_a_batch_is_the_single_env(name, form):
    """Observations, rewards, ends and information over autoresets, to the last bit."""
    player, expected = Player(make(name, form, **early(name)), form).begin(20), alone(name)
    if form == "SB3":  # its rewards are single, its first observations without information
        expected = [
            [
                {**each, "reward": np.float32(each["reward"])}
                if "reward" in each
                else {**each, "info": None}
                for each in row
            ]
            for row in expected
        ]
    assert_same(player.go(enough(player.env) + 8), expected, f"{name} {form}")


@every_variant
def test_at_other_settings_a_batch_survives_pickling_and_is_what_the_spec_makes(name, kwargs):
    settings = json.loads(json.dumps(short(name, **kwargs)))
    player = Player(make(name, "same_step", **settings), "same_step").begin(20)
    steps, first = enough(player.env), player.go(3)
    copy = pickle.loads(pickle.dumps(player))
    later = player.go(steps)
    assert passed_an_end(later)
    assert_same(later, copy.go(steps), "unpickled")
    for i in range(COUNT):
        env = remade(make(name, "single", **settings))
        single = Player(env, "single", first=i).begin(20 + i)
        assert_same([first[i]], single.go(3), f"receiver {i}")
        assert_same([later[i]], single.go(steps), f"receiver {i}, later")


@pytest.mark.parametrize(
    "word", ["oracle", "tracking-1m", "meaconer", "offsets", "per channel", "all"]
)
def test_a_receiver_is_the_same_in_any_batch_and_with_any_threads(word):
    kwargs = short(MAIN, autoreset_mode="same_step", **MAIN_VARIANTS[word])
    few = gym.make_vec(MAIN, num_envs=3, threads=1, **kwargs)
    many = gym.make_vec(MAIN, num_envs=19, threads=2, **kwargs)
    np.testing.assert_array_equal(few.reset(seed=20)[0], many.reset(seed=4)[0][16:])
    for k in range(12):
        action = trajectories.action_at(k, many.action_space.shape)
        mine, theirs = few.step(action[16:]), many.step(action)
        for one, other in zip(mine[:4], theirs[:4], strict=True):
            np.testing.assert_array_equal(one, other[16:])


# --- specs -----------------------------------------------------------------------------------


def test_the_spec_of_every_id_goes_through_json():
    for name in IDS:
        spec = gym.spec(name)
        assert spec.max_episode_steps is None
        assert EnvSpec.from_json(spec.to_json()) == spec


def remade(env):
    """The environment that the spec of another makes, after it has been through JSON."""
    make_it = gym.make if isinstance(env, gym.Env) else gym.make_vec
    return make_it(EnvSpec.from_json(env.spec.to_json()))


@every_code
@pytest.mark.parametrize("form", ["single", "same_step"])
def test_a_spec_makes_the_same_environment_again(name, form):
    """To the last step: with an episode's length as its limit a `TimeLimit` would truncate it."""
    # an alarm ends no episode, but where the detector learns
    lasting = {} if "DetectorView" in name else {"end_at_alarm": False}
    env = make(name, form, **json.loads(json.dumps(short(name, **lasting))))
    again = remade(remade(env))
    steps = env.unwrapped.core.episode_steps
    assert env.spec.max_episode_steps == again.spec.max_episode_steps == steps + 1
    if form == "single":
        assert "TimeLimit" not in str(env)
        assert "TimeLimit" in str(again)
        assert gym.make_vec(env.spec, num_envs=2).spec.max_episode_steps == steps + 1
    mine, theirs = (Player(each, form, push=0.0).begin(3).go(2 * steps) for each in (env, again))
    assert_same(mine, theirs, name)
    for row in mine:
        taken = [each for each in row if "reward" in each]
        assert not any(each["truncated"] for each in taken)
        ends = [k for k, each in enumerate(taken, 1) if each["terminated"]]
        assert max(np.diff([0, *ends])) == steps
        assert ends == [steps, 2 * steps] or not lasting
    for limit in (steps, 1.5):  # which would cut an episode
        with pytest.raises(ValueError, match=rf"`max_episode_steps` must be .* got {limit}"):
            gym.make_vec(name, num_envs=2, max_episode_steps=limit, **short(name))


@some_codes
@pytest.mark.parametrize("mode", MODES)
def test_the_spec_of_a_vector_environment_keeps_its_mode(name, mode):
    envs = make(name, mode, **short(name))
    again = remade(envs)
    assert again.spec == envs.spec
    assert again.metadata["autoreset_mode"] == AutoresetMode[mode.upper()]


@some_codes
def test_a_seed_may_be_one_of_numpy(name):
    env, envs = gym.make(name, **short(name)), gym.make_vec(name, num_envs=2, **short(name))
    expected = env.reset(seed=3)[0]
    np.testing.assert_array_equal(env.reset(seed=np.int64(3))[0], expected)
    assert env.unwrapped.np_random_seed == 3
    each = envs.reset(seed=3)[0]
    for seed in (np.uint16(3), [np.int64(3), 4], np.array([3, 4])):
        np.testing.assert_array_equal(envs.reset(seed=seed)[0], each)
    envs.reset(seed=np.int64(3))
    assert envs.np_random_seed == 3


# --- processes -------------------------------------------------------------------------------


def test_processes_of_async_vector_env_after_threads_in_the_parent():
    """A forked child can compute, though its parent has run kernels in threads."""
    kwargs = short(MAIN)
    threaded = gym.make_vec(MAIN, num_envs=33, threads=2, **kwargs)
    expected, _ = threaded.reset(seed=8)
    action = trajectories.action_at(0, threaded.action_space.shape)
    stepped = threaded.step(action)
    processes = gym.make_vec(MAIN, num_envs=2, vectorization_mode="async", **kwargs)
    try:
        np.testing.assert_array_equal(processes.reset(seed=8)[0], expected[:2])
        observation, reward, *_ = processes.step(action[:2])
        np.testing.assert_array_equal(observation, stepped[0][:2])
        np.testing.assert_array_equal(reward, stepped[1][:2])
    finally:
        processes.close()
    again = threaded.step(action)  # nor are the parent's threads disturbed
    assert threaded.observation_space.contains(again[0])


@pytest.mark.usefixtures("default_rate")
@pytest.mark.parametrize("name", heavy(IDS, *LATER))
def test_it_plays_as_users_have_it(name):
    """With the detector that it has by default, at the rate that is shipped."""
    env = gym.make(name)
    env.reset(seed=1)
    env.step(env.action_space.sample())
    env.close()
