"""The vector environment of stable-baselines3."""

from __future__ import annotations

import pickle
import sys

import numpy as np
import pytest

# ruff: noqa: E402 - stable-baselines3 may be missing
torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

import gymnasium as gym
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

from spoofgym.envs import SpoofEnv
from spoofgym.envs.terms.reward import AlarmPenalty, default_rewards
from spoofgym.envs.wrappers import vector as vector_wrappers
from spoofgym.sb3 import DetectorWrapper, RecordEpochs, SpoofVecEnv

TIMELINE = {"warmup_s": 6.0, "live_s": 2.0, "attack_s": 5.0, "time_to_alert_s": 1.0}
SETTINGS = {
    "action": "full-command",
    "detector": {"name": "ewma", "false_alarm": 0.02},
    "knowledge": "oracle",
    "timeline": TIMELINE,
}
ENVS = 5


@pytest.fixture(autouse=True)
def torch_threads():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def make(**settings):
    return SpoofVecEnv(ENVS, seed=3, **{**SETTINGS, **settings})


def actions(steps):
    drawn = np.random.default_rng(0).normal(0.4, 0.5, (steps, ENVS, 2))
    return np.clip(drawn, -1, 1).astype(np.float32)


def play(envs, commands):
    """All that a learner sees of some steps."""
    return [envs.step(command) for command in commands]


def assert_same(one, other):
    for (obs, reward, done, _), (obs2, reward2, done2, _) in zip(one, other, strict=True):
        assert np.array_equal(obs, obs2)
        assert np.array_equal(reward, reward2)
        assert np.array_equal(done, done2)


@pytest.mark.parametrize("prefetch", [False, True])
def test_receivers_are_single_environments_with_autoresets(prefetch):
    envs = make(prefetch=prefetch)
    first = envs.reset()
    commands = actions(25)
    turns = play(envs, commands)
    assert sum(done.sum() for _, _, done, _ in turns) > ENVS  # every one has ended, some twice
    for i in range(ENVS):
        env = SpoofEnv(**SETTINGS)
        observation, _ = env.reset(seed=3 + i)
        assert np.array_equal(observation, first[i])
        total, length = 0.0, 0
        for command, (observations, rewards, dones, infos) in zip(commands, turns, strict=True):
            observation, reward, terminated, truncated, info = env.step(command[i])
            total, length = total + reward, length + 1
            assert rewards[i] == np.float32(reward)
            assert dones[i] == terminated
            if not terminated:
                assert infos[i] == {}
                assert np.array_equal(observations[i], observation)
                continue
            told = infos[i]
            assert np.array_equal(told["terminal_observation"], observation)
            assert told["TimeLimit.truncated"] is truncated is False
            assert told["episode"]["l"] == length
            assert told["episode"]["r"] == pytest.approx(total, abs=1e-5)
            for name in ("undetected_displacement_m", "detected", "warmup_alarm", "coasting"):
                assert told[name] == info[name]
            observation, _ = env.reset()
            assert np.array_equal(observations[i], observation)
            total, length = 0.0, 0


def test_types_are_those_of_stable_baselines3():
    envs = make()
    observation = envs.reset()
    assert observation.dtype == np.float32
    assert envs.observation_space.contains(observation[0])
    observation, reward, done, infos = envs.step(actions(1)[0])
    assert (observation.dtype, reward.dtype, done.dtype) == (np.float32, np.float32, np.bool_)
    assert len(infos) == ENVS
    assert len({id(info) for info in infos}) == ENVS  # wrappers write into them


def test_what_is_returned_is_not_used_again():
    envs = make()
    kept = [envs.reset(), *(part for turn in play(envs, actions(12)) for part in turn[:3])]
    before = [part.copy() for part in kept]
    play(envs, actions(12))
    for part, copied in zip(kept, before, strict=True):
        assert np.array_equal(part, copied)


def test_a_reset_goes_on_and_a_seeded_one_begins_anew():
    envs = make()
    first = envs.reset()
    second = envs.reset()
    assert not np.array_equal(first, second)
    envs.seed(3)
    assert np.array_equal(envs.reset(), first)
    assert np.array_equal(envs.reset(), second)
    envs.seed(np.int64(3))
    assert np.array_equal(envs.reset(), first)


def test_a_copy_goes_on_with_the_same_bits():
    envs = make()
    envs.reset()
    play(envs, actions(7))
    twin = pickle.loads(pickle.dumps(envs))
    assert_same(play(envs, actions(15)), play(twin, actions(15)))


def test_attributes_and_methods_are_shared():
    envs = make()
    assert envs.get_attr("action_names") == [envs.action_names] * ENVS
    assert envs.get_attr("action_names", indices=[1, 2]) == [envs.action_names] * 2
    assert envs.get_attr("render_mode", indices=0) == [None]
    envs.set_attr("note", 5)
    assert envs.note == 5
    assert envs.env_is_wrapped(gym.Wrapper) == [False] * ENVS
    envs.env_method("set_rewards", default_rewards(7.0))
    for call in (
        lambda: envs.set_attr("note", 6, indices=0),
        lambda: envs.env_method("close", indices=[1]),
    ):
        with pytest.raises(ValueError, match="`indices` must be None"):
            call()
    with pytest.raises(AttributeError, match="nothing"):
        envs.get_attr("nothing")


def test_rewards_can_change_between_steps():
    one, other = make(end_at_alarm=True), make()
    one.reset(), other.reset()
    other.set_rewards([AlarmPenalty(100.0)])
    turns = zip(play(one, actions(25)), play(other, actions(25)), strict=True)
    prices = [
        (float(rewards[i]), info["detected"])
        for _, (_, rewards, _, infos) in turns
        for i, info in enumerate(infos)
        if info
    ]
    assert {price for price, detected in prices if detected} == {-100.0}
    assert {price for price, detected in prices if not detected} == {0.0}


def test_bad_actions_are_refused_and_change_nothing():
    envs, fresh = make(), make()
    envs.reset(), fresh.reset()
    for wrong, message in (
        (np.full((ENVS, 2), np.nan), "must be finite"),
        (np.zeros((ENVS, 3)), r"shape \(5, 2\)"),
        (np.full((ENVS, 2), 1.5), r"in \[-1, 1\]"),
    ):
        with pytest.raises(ValueError, match=message):
            envs.step(wrong)
    assert_same(play(envs, actions(3)), play(fresh, actions(3)))


def test_bad_calls_are_refused():
    with pytest.raises(ValueError, match="`num_envs` must be a whole number of at least 1, got 0"):
        SpoofVecEnv(0)
    with pytest.raises(ValueError, match="`torch_threads` must be a whole number of at least 1, "):
        make(torch_threads=0)
    envs = make()
    with pytest.raises(RuntimeError, match=r"call reset\(\)"):
        envs.step(actions(1)[0])
    envs.reset()
    with pytest.raises(RuntimeError, match="step_async"):
        envs.step_wait()


def test_torch_gets_one_thread_unless_told():
    torch.set_num_threads(2)
    make(torch_threads=None)
    assert torch.get_num_threads() == 2
    make()
    assert torch.get_num_threads() == 1


def test_ppo_learns_on_it_the_same_twice():
    weights = []
    for _ in range(2):
        envs = make(knowledge="blind")
        model = PPO("MlpPolicy", envs, n_steps=20, batch_size=50, gamma=1.0, seed=0, device="cpu")
        model.learn(200)
        assert len(model.ep_info_buffer) > 0  # episodes are told without VecMonitor
        weights.append([p.detach().numpy().copy() for p in model.policy.parameters()])
    for one, other in zip(*weights, strict=True):
        assert np.array_equal(one, other)


def test_vec_monitor_agrees():
    envs = VecMonitor(make())
    envs.reset()
    plain = make()
    plain.reset()
    for (_, _, _, infos), (_, _, _, own) in zip(
        play(envs, actions(12)), play(plain, actions(12)), strict=True
    ):
        for info, mine in zip(infos, own, strict=True):
            assert ("episode" in info) == ("episode" in mine)
            if mine:
                assert info["episode"]["r"] == pytest.approx(mine["episode"]["r"], abs=1e-5)
                assert info["episode"]["l"] == mine["episode"]["l"]


def test_nobody_else_here_imports_stable_baselines3():
    import subprocess

    code = "import sys, spoofgym.cli, spoofgym.testing; print('stable_baselines3' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def written(folder):
    """Contents of the files of a recorder, by name."""
    import pyarrow.parquet as pq

    return {path.name: pq.read_table(path) for path in sorted(folder.glob("*.parquet"))}


def test_recorded_epochs_are_those_of_the_vector_environment(tmp_path):
    """Every file of it is the same but for the learner's last, unfinished episodes."""
    pytest.importorskip("pyarrow")
    envs = RecordEpochs(VecNormalize(make()), tmp_path / "sb3")
    commands = actions(25)
    envs.reset()
    played = play(envs, commands)
    ends = sum(step[2].sum() for step in played)
    envs.close()
    other = gym.make_vec(
        "spoofgym/TightlyCoupled-v0", num_envs=ENVS, autoreset_mode="same_step", **SETTINGS
    )
    other = vector_wrappers.RecordEpochs(other, tmp_path / "gymnasium")
    other.reset(seed=3)
    for command in commands:
        other.step(command)
    other.close()
    mine, theirs = written(tmp_path / "sb3"), written(tmp_path / "gymnasium")
    assert list(mine) == list(theirs)
    for name, table in mine.items():
        assert table.equals(theirs[name], check_metadata=True)
    assert ends >= ENVS
    told = [table.schema.metadata[b"spoofgym"] for table in mine.values()]
    assert sum(b'"complete": true' in text for text in told) == ends


def test_what_is_recorded_ends_with_what_the_learner_is_told(tmp_path):
    pytest.importorskip("pyarrow")
    envs = RecordEpochs(make(decision_interval_s=1.0), tmp_path)
    envs.reset()
    ends, since = [], np.zeros(ENVS, dtype=int)
    for *_, done, infos in play(envs, actions(12)):
        since += 1
        ends += [(row, since[row], infos[row]) for row in np.flatnonzero(done)]
        since[done] = 0
    tables, seen = written(tmp_path), [0] * ENVS
    for row, decisions, info in ends:
        table = tables[f"receiver-{row:03d}-episode-{seen[row]:06d}.parquet"]
        seen[row] += 1
        assert info["episode"]["l"] == decisions  # as VecMonitor counts
        # every epoch of a decision, up to an alarm
        assert 2 * decisions - 1 <= table.num_rows <= 2 * decisions
        alarms = table["alarm"].to_pylist()
        assert not any(alarms[:-1])
        # one in the time to alert ends it, too
        assert alarms[-1] <= info["detected"]
    assert sum(seen) == len(tables) > ENVS


def test_a_recorder_needs_the_environment_of_this_package(tmp_path):
    others = DummyVecEnv([lambda: gym.make("spoofgym/Snapshot-v0")])
    with pytest.raises(TypeError, match=r"needs a SpoofVecEnv, wrapped or not, got <.*Dummy"):
        RecordEpochs(others, tmp_path)


def test_information_of_every_step_is_handed_out_where_it_is_asked_for():
    plain, told = make(watch="snapshot-chi2"), make(watch="snapshot-chi2", infos=["cost"])
    plain.reset()
    told.reset()
    ends, costs = 0, 0.0
    for command in actions(30):
        *_, over, infos = plain.step(command)
        more = told.step(command)[3]
        for row in range(ENVS):
            assert set(infos[row]) >= {"cost", "watch_snapshot_chi2_alarm"} or not over[row]
            assert infos[row].keys() | {"cost"} == more[row].keys()
            costs += more[row]["cost"]
        ends += over.sum()
    assert costs > 0.0
    assert ends > ENVS
    with pytest.raises(ValueError, match=r"unknown info 'costs'.*did you mean 'cost'"):
        make(infos=["costs"])


def test_the_length_of_an_episode_is_that_of_its_decisions():
    envs = make(detector="never", decision_interval_s=2.5)
    envs.reset()
    envs.step(np.zeros((ENVS, 2)))
    infos = envs.step(np.zeros((ENVS, 2)))[3]
    assert [info["episode"]["l"] for info in infos] == [2] * ENVS


def test_a_reset_may_be_told_the_circumstances():
    envs = make(domain={"start_s": (0.0, 10.0)})
    envs.set_options([{"domain": {"start_s": float(row)}} for row in range(ENVS)])
    envs.reset()
    begun = envs.core.engine.simulator.memory["first"]
    np.testing.assert_array_equal(begun, 2 * np.arange(ENVS))
    envs.set_options([{"domain": {"start_s": 1.0}}] + [{}] * (ENVS - 1))
    with pytest.raises(ValueError, match="the same circumstances for every receiver"):
        envs.reset()
    envs.set_options({"start": 1.0})
    with pytest.warns(UserWarning, match="reset has no option 'start'; valid: domain"):
        envs.reset()


def test_rewards_are_set_by_name():
    envs = make()
    envs.reset()
    envs.set_rewards(["alarm-penalty"])
    assert envs.step(actions(1)[0])[1].max() <= 0.0
    with pytest.raises(ValueError, match="did you mean 'alarm-penalty'"):
        envs.set_rewards("alarm-penality")


# --- any environment, either side ---

SHORT = {"timeline": TIMELINE}
NOMINAL = {"name": "snapshot-chi2", "thresholds": "nominal"}
TWO_WORLDS = {"worlds": 2, "turned_deg": [0.0, 360.0]}
OTHERS = [
    (
        "spoofgym/LooselyCoupled-v0",
        {
            "timeline": {"warmup_s": 1, "live_s": 1, "attack_s": 2, "time_to_alert_s": 0.5},
            "detector": {"name": "windowed-chi2", "window": 8},
        },
    ),
    ("spoofgym/Snapshot-v0", {"timeline": {"warmup_s": 5, "live_s": 5, "attack_s": 6}}),
    ("spoofgym/WheeledRobot-v0", {"timeline": {"warmup_s": 5, "live_s": 5, "attack_s": 6}}),
    ("spoofgym/SpooferView-v0", {**SHORT, "pool": [NOMINAL, {"name": "never"}]}),
    ("spoofgym/DetectorView-v0", {**SHORT, "pool": ["ramp", "step"]}),
    ("spoofgym/BenchT3-v1", {**SHORT, "detector": NOMINAL, "domain": TWO_WORLDS}),
    ("spoofgym/BenchT6-v1", {**SHORT, "pool": [NOMINAL, {"name": "never"}]}),
]


@pytest.mark.parametrize(("env_id", "settings"), OTHERS, ids=[name for name, _ in OTHERS])
def test_every_id_is_the_same_as_by_make_vec(env_id, settings):
    vector = gym.make_vec(env_id, num_envs=3, autoreset_mode="same_step", **settings)
    envs = SpoofVecEnv(3, env_id=env_id, seed=5, **settings)
    seen, _ = vector.reset(seed=5)
    assert np.array_equal(envs.reset(), seen)
    assert envs.observation_space == vector.single_observation_space
    assert envs.action_space == vector.single_action_space
    drawn = np.random.default_rng(1)
    ended, lengths = 0, np.zeros(3, dtype=int)
    for _ in range(90):
        action = drawn.uniform(-0.3, 0.3, vector.action_space.shape).astype(np.float32)
        seen, rewards, terminated, truncated, _ = vector.step(action)
        other, paid, dones, infos = envs.step(action)
        lengths += 1
        assert np.array_equal(other, seen)
        assert np.array_equal(paid, rewards.astype(np.float32))
        assert np.array_equal(dones, terminated | truncated)
        for row in np.flatnonzero(dones):
            assert infos[row]["episode"]["l"] == lengths[row]
            assert "undetected_displacement_m" in infos[row]
            lengths[row], ended = 0, ended + 1
    assert ended
    vector.close()
    envs.close()


def test_a_task_is_its_environment():
    settings = {**SHORT, "detector": NOMINAL, "domain": TWO_WORLDS}
    one = SpoofVecEnv(2, task="T3", seed=1, **settings)
    other = SpoofVecEnv(2, env_id="spoofgym/BenchT3-v1", seed=1, **settings)
    assert np.array_equal(one.reset(), other.reset())
    assert one.env_kwargs["scenario"] == "trolley"
    assert one.core.length_m == 20.0


def test_a_side_or_a_pool_alone_chooses_the_view():
    assert SpoofVecEnv(2, side="detector", pool="step", **SHORT).core.opponents() == ["step"] * 2
    pooled = SpoofVecEnv(2, pool=[NOMINAL, "never"], weights=[0, 1], seed=0, **SHORT)
    pooled.reset()
    assert pooled.env_kwargs["detector"]["members"] == [NOMINAL, "never"]
    assert pooled.env_kwargs["detector"]["weights"] == [0, 1]
    assert SpoofVecEnv(2, pool="never", **SHORT).env_kwargs["detector"] == "never"


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"env_id": "nix"}, ValueError, "unknown environment 'nix'; valid: spoofgym/Bench"),
        ({"env_id": "CartPole-v1"}, ValueError, "CartPole-v1 is no environment of a spoofer"),
        ({"env_id": "a", "task": "T1"}, ValueError, "`env_id` can't be given with task T1"),
        ({"task": "T9"}, ValueError, "unknown task 'T9'"),
        ({"side": "referee"}, ValueError, "`side` must be 'spoofer' or 'detector', got 'referee'"),
        ({"side": "detector", "detector": "ewma"}, ValueError, "the detector is the learner"),
        ({"weights": [1.0]}, ValueError, "`weights` needs a `pool`"),
        ({"env_id": "spoofgym/Snapshot-v0", "side": "detector"}, ValueError, "has none"),
        ({"env_id": "spoofgym/Snapshot-v0", "pool": ["raim"]}, ValueError, "has none"),
        ({"pool": ["never"], "detector": "ewma"}, ValueError, "two detectors are set at once"),
        ({"pool": ["never"], "foo": 1}, TypeError, "has no argument 'foo'"),
        ({"pool": ["nobody"]}, ValueError, "nobody"),
        ({"pool": []}, ValueError, "`pool` must have at least one opponent, got none"),
        ({"seed": -1}, ValueError, "`seed` must be a whole number of at least 0, got -1"),
        ({"seed": 1.5}, ValueError, "`seed` must be a whole number of at least 0, got 1.5"),
        ({"side": "detector", "foo": 1}, TypeError, "has no argument 'foo'"),
    ],
)
def test_sides_and_ids_that_do_not_fit_are_refused(settings, error, message):
    with pytest.raises(error, match=message):
        SpoofVecEnv(2, **settings)


def test_what_belongs_to_the_spoofers_side_is_refused_on_the_other(tmp_path):
    envs = SpoofVecEnv(2, side="detector", **SHORT)
    with pytest.raises(ValueError, match="paid by the rules of the duel"):
        envs.set_rewards(default_rewards(7.0))
    with pytest.raises(TypeError, match="this SpoofVecEnv has the side 'detector'"):
        RecordEpochs(envs, tmp_path)


def test_a_wrapper_sets_the_detector_as_its_argument_does():
    settings = {key: value for key, value in SETTINGS.items() if key != "detector"}
    bare = SpoofVecEnv(ENVS, seed=3, **settings)
    wrapped = DetectorWrapper(bare, SETTINGS["detector"])
    given, commands = make(), actions(12)
    assert np.array_equal(wrapped.reset(), given.reset())
    assert_same(play(wrapped, commands), play(given, commands))
    assert bare.env_kwargs == given.env_kwargs


def test_a_wrapper_takes_the_place_of_a_tasks_detector():
    envs = SpoofVecEnv(2, task="T1")
    DetectorWrapper(VecMonitor(envs), "snapshot-chi2", false_alarms_per_hour=0.2)
    rated = {"name": "snapshot-chi2", "false_alarms_per_hour": 0.2}
    assert envs.env_kwargs["detector"] == rated
    for refused in (envs, make(), SpoofVecEnv(2, pool=["ewma", "never"])):
        with pytest.raises(ValueError, match="two detectors are set at once"):
            DetectorWrapper(refused, "cusum")
    with pytest.raises(TypeError, match="`env` must be a SpoofEnv, a SpoofVectorEnv or a SpoofV"):
        DetectorWrapper(SpoofVecEnv(2, side="detector"), "cusum")
    begun = SpoofVecEnv(2, timeline=TIMELINE)
    begun.reset()
    with pytest.raises(RuntimeError, match="before reset"):
        DetectorWrapper(begun, "cusum")
