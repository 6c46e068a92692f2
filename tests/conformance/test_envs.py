"""One matrix: every id, in every form that it has, keeps every contract.

The forms are the single environment, the vector one in its three autoreset modes, the adapter for
stable-baselines3, and the duel's two; the contracts are those of Gymnasium's checkers, determinism,
pickling within an episode, that receiver i is the single environment seeded ``seed + i``, and that
a spec goes through JSON and makes the same environment again.
"""

import json
import os
import pickle
import subprocess
import sys
from copy import deepcopy

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from tests.nightly import heavy

from ..duel.support import ONE_SKY
from ..envs.players import (
    COUNT,
    DUELS,
    IDS,
    MODES,
    SHORT,
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
        "twin": {"twin": True},
        "watch": {"watch": ["never", "never"], "end_at_alarm": False},
        "domain": {"domain": domain, "target_heading_deg": "random"},
        "oracle": {"knowledge": "oracle"},
        "worst": {"target_heading_deg": "worst", "twin": True},
        "interval": {"decision_interval_s": 2.0 * interval, "between": "linear"},
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
    *(pytest.param(MAIN, kwargs, id=word) for word, kwargs in MAIN_VARIANTS.items()),
    *(
        pytest.param(name, kwargs, id=f"{name[9:-3]}-{word}")
        for name in SMALL_IDS
        for word, kwargs in small_variants(name).items()
    ),
]
CODE_IDS = [name for name in IDS if "/Bench" not in name]
"""Ids that differ in code; a task is one of them at other settings, which is made and played."""
every_id = pytest.mark.parametrize("name", IDS)
every_code = pytest.mark.parametrize("name", CODE_IDS)
every_victim = pytest.mark.parametrize("name", VICTIM_IDS)
every_variant = pytest.mark.parametrize(("name", "kwargs"), VARIED)
every_form = pytest.mark.parametrize(
    ("name", "form"), [(name, form) for name in CODE_IDS for form in forms_of(name)]
)
every_mode = pytest.mark.parametrize("mode", MODES)
every_duel = pytest.mark.parametrize("form", DUELS)
some_duels = pytest.mark.parametrize(
    "kwargs", [MAIN_VARIANTS["domain"], {"attack": "tracking-1m"}], ids=["domain", "tracking"]
)


def enough(env):
    """Steps that go over the end of the first episode of every receiver."""
    steps = getattr(env, "unwrapped", env).core.episode_steps
    return steps + 4


def rewards(rows):
    return [[each["reward"] for each in row if "reward" in each] for row in rows]


def passed_an_end(rows):
    return all(any("reward" not in each for each in row[1:]) for row in rows)


# --- checkers --------------------------------------------------------------------------------


@every_id
def test_gymnasium_check_env(name):
    # a warning is an error here, so that the advice of the checker counts, too;
    # pictures are checked in `tests/envs/rendering`
    env = gym.make(name, **short(name)).unwrapped
    assert env.spec is not None
    check_env(env, skip_render_check=True)


@every_variant
def test_gymnasium_check_env_at(name, kwargs):
    check_env(gym.make(name, **short(name, **kwargs)).unwrapped, skip_render_check=True)


@every_code
def test_stable_baselines3_check_env(name):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gym.make(name, **short(name)).unwrapped, warn=True)


@every_code
@every_mode
def test_spaces_types_and_masks_of_a_vector_env(name, mode):
    envs = make(name, mode, **early(name))
    assert envs.metadata["autoreset_mode"] == AutoresetMode[mode.upper()]
    observation, info = envs.reset(seed=4)
    rng, ended, held = np.random.default_rng(0), np.zeros(COUNT, dtype=int), []
    for _ in range(2 * enough(envs)):
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
    assert ended.min() >= 2
    for given, kept in held:  # nothing that was handed out is written again
        np.testing.assert_array_equal(given, kept)


@pytest.mark.parametrize("name", [name for name in IDS if name not in CODE_IDS])
def test_a_task_plays_in_every_form_alike(name):
    first, *others = (
        Player(make(name, form, **early(name)), form).begin(5).go(2) for form in forms_of(name)
    )
    for found in others:
        np.testing.assert_allclose(rewards(found)[0], rewards(first)[0], rtol=1e-6)


# --- determinism and pickling ----------------------------------------------------------------


@every_form
def test_a_seed_tells_all_that_happens(name, form):
    player = Player(make(name, form, **early(name)), form)
    steps = enough(player.env)
    first = player.begin(5).go(steps)
    assert passed_an_end(first)
    assert_same(first, player.begin(5).go(steps), name)
    assert rewards(first) != rewards(player.begin(50).go(steps))


@every_form
def test_an_unfinished_episode_survives_pickling(name, form):
    pickled(name, form, **early(name))


@every_variant
def test_an_unfinished_episode_survives_pickling_at(name, kwargs):
    pickled(name, "same_step", **short(name, **kwargs))


def pickled(name, form, **settings):
    player = Player(make(name, form, **settings), form)
    player.begin(5).go(3)
    copies = pickle.loads(pickle.dumps(player)), deepcopy(player)
    steps = enough(player.env)
    mine = player.go(steps)
    for each in copies:
        assert_same(mine, each.go(steps), name)
    assert passed_an_end(mine)


@every_duel
@some_duels
def test_a_duel_is_told_by_its_seed_and_survives_pickling(form, kwargs):
    player = Player(make("", form, **{"timeline": SHORT, "domain": ONE_SKY, **kwargs}), form)
    first = player.begin(6).go(5)
    assert_same(first, player.begin(6).go(5), form)
    copy = pickle.loads(pickle.dumps(player))
    assert_same(player.go(30), copy.go(30), form)


# --- receivers of a batch --------------------------------------------------------------------


def assert_receivers_are_single(name, form, **settings):
    """Observations, rewards, ends and information over autoresets, to the last bit."""
    player = Player(make(name, form, **settings), form).begin(20)
    steps = 2 * enough(player.env)
    many, alone = player.go(steps), []
    for i in range(COUNT):
        single = Player(make(name, "single", **settings), "single", first=i)
        alone += single.begin(20 + i).go(steps)
    assert passed_an_end(alone)
    if form == "SB3":  # its rewards are single, its first observations without information
        for each in (each for row in alone for each in row):
            if "reward" in each:
                each["reward"] = np.float32(each["reward"])
            else:
                each["info"] = None
    assert_same(many, alone, f"{name} {form}")


@pytest.mark.parametrize(
    ("name", "form"),
    [(name, form) for name in CODE_IDS for form in forms_of(name) if form != "single"],
)
def test_every_receiver_of_a_batch_is_the_single_env(name, form):
    assert_receivers_are_single(name, form, **early(name))


@every_variant
def test_every_receiver_of_a_batch_is_the_single_env_at(name, kwargs):
    assert_receivers_are_single(name, "same_step", **short(name, **kwargs))


@pytest.mark.parametrize("kwargs", MAIN_VARIANTS.values(), ids=MAIN_VARIANTS)
def test_a_receiver_is_the_same_in_any_batch_and_with_any_threads(kwargs):
    kwargs = short(MAIN, autoreset_mode="same_step", **kwargs)
    few = gym.make_vec(MAIN, num_envs=3, threads=1, **kwargs)
    many = gym.make_vec(MAIN, num_envs=19, threads=2, **kwargs)
    np.testing.assert_array_equal(few.reset(seed=20)[0], many.reset(seed=4)[0][16:])
    for k in range(25):
        action = trajectories.action_at(k, many.action_space.shape)
        mine, theirs = few.step(action[16:]), many.step(action)
        for one, other in zip(mine[:4], theirs[:4], strict=True):
            np.testing.assert_array_equal(one, other[16:])


# --- specs -----------------------------------------------------------------------------------


@every_id
def test_the_spec_of_an_id_goes_through_json(name):
    spec = gym.spec(name)
    assert spec.max_episode_steps is None
    assert EnvSpec.from_json(spec.to_json()) == spec


def remade(env):
    """The environment that the spec of another makes, after it has been through JSON."""
    make_it = gym.make if isinstance(env, gym.Env) else gym.make_vec
    return make_it(EnvSpec.from_json(env.spec.to_json()))


@every_code
@pytest.mark.parametrize("form", ["single", *MODES])
def test_a_spec_makes_the_same_environment_again(name, form):
    """To the last step: with an episode's length as its limit a `TimeLimit` would truncate it."""
    # an alarm ends no episode, but where the detector learns
    detects = "DetectorView" in name or "BenchD" in name
    lasting = {} if detects else {"end_at_alarm": False}
    env = make(name, form, **json.loads(json.dumps(short(name, **lasting))))
    again = remade(remade(env))
    steps = env.unwrapped.core.episode_steps
    assert env.spec.max_episode_steps == again.spec.max_episode_steps == steps + 1
    if form == "single":
        assert "TimeLimit" not in str(env)
        assert "TimeLimit" in str(again)
        assert gym.make_vec(env.spec, num_envs=2).spec.max_episode_steps == steps + 1
    else:
        assert again.spec == env.spec
        assert again.metadata["autoreset_mode"] == AutoresetMode[form.upper()]
    mine, theirs = (Player(each, form, push=0.0).begin(3).go(2 * steps) for each in (env, again))
    assert_same(mine, theirs, name)
    for row in mine:
        taken = [each for each in row if "reward" in each]
        assert not any(each["truncated"] for each in taken)
        ends = [k for k, each in enumerate(taken, 1) if each["terminated"]]
        assert max(np.diff([0, *ends])) == steps
        assert ends == [steps, 2 * steps] or not lasting


@every_variant
def test_a_spec_makes_the_same_environment_again_at(name, kwargs):
    env = make(name, "single", **json.loads(json.dumps(short(name, **kwargs))))
    mine, theirs = (Player(each, "single").begin(3).go(5) for each in (env, remade(env)))
    assert_same(mine, theirs, name)


@every_code
def test_a_limit_that_would_cut_an_episode_is_refused(name):
    steps = gym.make(name, **short(name)).unwrapped.core.episode_steps
    for limit in (steps, 1.5):
        with pytest.raises(ValueError, match=rf"`max_episode_steps` must be .* got {limit}"):
            gym.make_vec(name, num_envs=2, max_episode_steps=limit, **short(name))


@every_code
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

SOME = ("DetectorView-v0", "LooselyCoupled-v0", "RandomStart-v0", "Snapshot-v0", "duel_v0-aec")
REMOTE = """
import sys
from spoofgym.detectors import calibrated
from tests.golden.trajectories import cases, digest
calibrated.DEFAULT_RATE = None  # as here
for name in sys.argv[1:]:
    print(digest(cases()[name]()))
"""


def test_trajectories_are_the_same_in_another_process():
    """In another order, with other hashes of strings."""
    table = trajectories.cases()
    here = [trajectories.digest(table[name]()) for name in SOME]
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    command = [sys.executable, "-c", REMOTE, *reversed(SOME)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == here[::-1]


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
@pytest.mark.parametrize("name", heavy(IDS, "spoofgym/BenchD2-v1", "spoofgym/BenchT4-v1"))
def test_it_plays_as_users_have_it(name):
    """With the detector that it has by default, at the rate that is shipped."""
    env = gym.make(name)
    env.reset(seed=1)
    env.step(env.action_space.sample())
    env.close()
