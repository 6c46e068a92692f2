"""The vector environment of stable-baselines3."""

import pickle
from functools import partial

import numpy as np
import pytest

# ruff: noqa: E402 - stable-baselines3 may be missing
torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

import gymnasium as gym
from stable_baselines3.common.vec_env import SubprocVecEnv, VecMonitor, VecNormalize

from spoofgym.detectors import Calibrated
from spoofgym.envs.terms.reward import AlarmPenalty, default_rewards
from spoofgym.sb3 import AlarmRecorder, DetectorWrapper, PassiveDetector, RecordEpochs, SpoofVecEnv
from spoofgym.wrappers import vector as vector_wrappers
from spoofgym.wrappers import vector as wrapped_vectors

from .envs.support import AlarmAt
from .nightly import heavy

TIMELINE = {"warmup_s": 6.0, "live_s": 2.0, "attack_s": 5.0, "time_to_alert_s": 1.0}
SETTINGS = {
    "scenario": "zhong2025",
    "action": "full-command",
    "detector": {"name": "ewma", "false_alarm": 0.02},
    "knowledge": "oracle",
    "timeline": TIMELINE,
}
ENVS = 5


def make(**settings):
    return SpoofVecEnv(ENVS, seed=3, **{**SETTINGS, **settings})


def actions(steps):
    drawn = np.random.default_rng(0).normal(0.4, 0.5, (steps, ENVS, 2))
    return np.clip(drawn, -1, 1).astype(np.float32)


def play(envs, steps):
    return [envs.step(command) for command in actions(steps)]


def assert_same(one, other):
    for mine, theirs in zip(one, other, strict=True):
        for a, b in zip(mine[:3], theirs[:3], strict=True):
            assert np.array_equal(a, b)


TIMES = {"timeline": TIMELINE}
SHORT = {**TIMES, "scenario": "zhong2025"}
NOMINAL = {"name": "snapshot-chi2", "thresholds": "nominal"}
TWO_WORLDS = {"worlds": 2, "turned_deg": [0.0, 360.0]}
SMALL = {"timeline": {"warmup_s": 5, "live_s": 5, "attack_s": 6}}
LOOSE = {
    "timeline": {"warmup_s": 1, "live_s": 1, "attack_s": 2, "time_to_alert_s": 0.5},
    "detector": {"name": "windowed-chi2", "window": 8},
}
IDS = {
    "Zhong2025-v0": SETTINGS,
    "LooselyCoupled-v0": LOOSE,
    "Snapshot-v0": SMALL,
    "WheeledRobot-v0": SMALL,
    "SpooferView-v0": {**SHORT, "pool": [NOMINAL, {"name": "never"}]},
    "DetectorView-v0": {**SHORT, "pool": ["ramp", "step"]},
    "BenchT3-v1": {**TIMES, "detector": NOMINAL, "domain": TWO_WORLDS},
    "BenchT6-v1": {**TIMES, "pool": [NOMINAL, {"name": "never"}]},
}


@pytest.mark.parametrize("name", heavy(IDS, "LooselyCoupled-v0", "WheeledRobot-v0", "BenchT6-v1"))
def test_every_id_is_the_same_as_by_make_vec(name):
    env_id, settings = f"spoofgym/{name}", IDS[name]
    vector = gym.make_vec(env_id, num_envs=3, autoreset_mode="same_step", **settings)
    envs = SpoofVecEnv(3, env_id=env_id, seed=5, prefetch=name != "Zhong2025-v0", **settings)
    seen, _ = vector.reset(seed=5)
    assert np.array_equal(envs.reset(), seen)
    assert envs.observation_space == vector.single_observation_space
    assert envs.action_space == vector.single_action_space
    drawn = np.random.default_rng(1)
    ended, returns, lengths = 0, np.zeros(3), np.zeros(3, dtype=int)
    for _ in range(60):
        action = drawn.uniform(-0.3, 0.3, vector.action_space.shape).astype(np.float32)
        seen, rewards, terminated, truncated, all_infos = vector.step(action)
        other, paid, dones, infos = envs.step(action)
        assert (other.dtype, paid.dtype, dones.dtype) == (np.float32, np.float32, np.bool_)
        assert np.array_equal(other, seen)
        assert np.array_equal(paid, rewards.astype(np.float32))
        assert np.array_equal(dones, terminated | truncated)
        assert len({id(info) for info in infos}) == 3  # wrappers write into them
        returns, lengths = returns + rewards, lengths + 1
        for row, told in enumerate(infos):
            if not dones[row]:
                assert told == {}
                continue
            assert np.array_equal(told["terminal_observation"], all_infos["final_obs"][row])
            assert told["TimeLimit.truncated"] is bool(truncated[row])
            assert told["episode"]["l"] == lengths[row]
            assert told["episode"]["r"] == pytest.approx(returns[row], abs=1e-5)
            key = "undetected_displacement_m"
            assert told[key] == all_infos["final_info"][key][row]
            returns[row], lengths[row], ended = 0.0, 0, ended + 1
    assert ended
    vector.close()
    envs.close()


def test_a_task_a_side_or_a_pool_alone_chooses_the_environment():
    settings = {**TIMES, "detector": NOMINAL, "domain": TWO_WORLDS}
    one = SpoofVecEnv(2, task="T3", seed=1, **settings)
    other = SpoofVecEnv(2, env_id="spoofgym/BenchT3-v1", seed=1, **settings)
    assert np.array_equal(one.reset(), other.reset())
    assert (one.env_kwargs["scenario"], one.core.length_m) == ("trolley", 20.0)
    assert SpoofVecEnv(2, side="detector", pool="step", **SHORT).core.opponents() == ["step"] * 2
    pooled = SpoofVecEnv(2, pool=[NOMINAL, "never"], weights=[0, 1], seed=0, **SHORT)
    pooled.reset()
    pool = {"members": [NOMINAL, "never"], "weights": [0, 1]}
    assert pooled.env_kwargs["detector"].items() >= pool.items()


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"env_id": "nix"}, ValueError, "unknown environment 'nix'; valid: spoofgym/Bench"),
        ({"env_id": "CartPole-v1"}, ValueError, "CartPole-v1 is no environment of a spoofer"),
        ({"env_id": "a", "task": "T1"}, ValueError, "`env_id` can't be given with task T1"),
        ({"side": "referee"}, ValueError, "`side` must be 'spoofer' or 'detector', got 'referee'"),
        ({"side": "detector", "detector": "ewma"}, ValueError, "the detector is the learner"),
        ({"weights": [1.0]}, ValueError, "`weights` needs a `pool`"),
        ({"env_id": "spoofgym/Snapshot-v0", "side": "detector"}, ValueError, "has none"),
        ({"pool": ["never"], "foo": 1}, TypeError, "got an unexpected keyword argument 'foo'"),
        ({"pool": []}, ValueError, "`pool` must have at least one opponent, got none"),
        ({"seed": 1.5}, ValueError, "`seed` must be a whole number of at least 0, got 1.5"),
        ({"infos": ["costs"]}, ValueError, r"unknown info 'costs'.*did you mean 'cost'"),
    ],
)
def test_settings_that_do_not_fit_are_refused(settings, error, message):
    with pytest.raises(error, match=message):
        SpoofVecEnv(2, **settings)


def test_what_belongs_to_the_spoofers_side_is_refused_on_the_other(tmp_path):
    envs = SpoofVecEnv(2, side="detector", **SHORT)
    with pytest.raises(ValueError, match="paid by the rules of the duel"):
        envs.set_rewards(default_rewards(7.0))
    with pytest.raises(TypeError, match="this SpoofVecEnv has the side 'detector'"):
        RecordEpochs(envs, tmp_path)


def test_resets_copies_and_refusals_leave_no_trace():
    envs = make()
    with pytest.raises(RuntimeError, match=r"call reset\(\)"):
        envs.step(actions(1)[0])
    first, second = envs.reset(), envs.reset()
    assert not np.array_equal(first, second)
    for seed in (3, np.int64(3)):
        envs.seed(seed)
        assert np.array_equal(envs.reset(), first)
    assert np.array_equal(envs.reset(), second)
    with pytest.raises(RuntimeError, match="step_async"):
        envs.step_wait()
    for wrong, message in (
        (np.full((ENVS, 2), np.nan), "must be finite"),
        (np.zeros((ENVS, 3)), r"shape \(5, 2\)"),
        (np.full((ENVS, 2), 1.5), r"in \[-1, 1\]"),
    ):
        with pytest.raises(ValueError, match=message):
            envs.step(wrong)
    kept = play(envs, 12)
    before = pickle.dumps(kept)
    fresh = make()
    fresh.reset(), fresh.reset()
    assert_same(kept, play(fresh, 12))
    twin = pickle.loads(pickle.dumps(envs))
    assert_same(play(envs, 15), play(twin, 15))
    assert pickle.dumps(kept) == before  # what is returned is not used again


def test_attributes_and_methods_are_shared_and_torch_gets_one_thread_unless_told():
    envs = make()
    assert envs.get_attr("action_names") == [envs.action_names] * ENVS
    assert envs.get_attr("render_mode", indices=0) == [None]
    envs.set_attr("note", 5)
    assert envs.note == 5
    assert envs.env_is_wrapped(gym.Wrapper) == [False] * ENVS
    envs.env_method("set_rewards", default_rewards(7.0))
    with pytest.raises(ValueError, match="`indices` must be None"):
        envs.set_attr("note", 6, indices=0)
    with pytest.raises(ValueError, match="`indices` must be None"):
        envs.env_method("close", indices=[1])
    torch.set_num_threads(2)
    make(torch_threads=None)
    assert torch.get_num_threads() == 2
    make()
    assert torch.get_num_threads() == 1


def test_rewards_can_change_between_steps_also_by_name():
    envs = make()
    envs.reset()
    envs.set_rewards([AlarmPenalty(100.0)])
    prices = {
        (float(rewards[i]), info["detected"])
        for _, rewards, _, infos in play(envs, 25)
        for i, info in enumerate(infos)
        if info
    }
    assert prices == {(-100.0, True), (0.0, False)}
    envs.set_rewards(["alarm-penalty"])
    assert envs.step(actions(1)[0])[1].max() <= 0.0


def test_information_of_every_step_is_handed_out_where_it_is_asked_for():
    plain, told = make(watch="snapshot-chi2"), make(watch="snapshot-chi2", infos=["cost"])
    plain.reset(), told.reset()
    pairs = [
        pair
        for (*_, infos), (*_, more) in zip(play(plain, 30), play(told, 30), strict=True)
        for pair in zip(infos, more, strict=True)
    ]
    assert all(one.keys() | {"cost"} == other.keys() for one, other in pairs)
    assert sum("watch_snapshot_chi2_alarm" in one for one, _ in pairs) > ENVS
    assert sum(other["cost"] for _, other in pairs) > 0.0


def test_a_reset_may_be_told_the_circumstances():
    envs = make(domain={"start_s": (0.0, 10.0)})
    envs.set_options([{"domain": {"start_s": float(row)}} for row in range(ENVS)])
    envs.reset()
    begun = envs.core.engine.simulator.memory["first"]
    np.testing.assert_array_equal(begun, 2 * np.arange(ENVS))
    envs.set_options([{"domain": {"start_s": 1.0}}] + [{}] * (ENVS - 1))
    with pytest.raises(ValueError, match="the same circumstances for every receiver"):
        envs.reset()


def test_recorded_epochs_are_those_of_the_vector_environment(tmp_path):
    pytest.importorskip("pyarrow")
    envs = RecordEpochs(VecNormalize(make(decision_interval_s=1.0)), tmp_path / "sb3")
    envs.reset()
    ends = sum(step[2].sum() for step in play(envs, 25))
    envs.close()
    settings = {**SETTINGS, "decision_interval_s": 1.0, "autoreset_mode": "same_step"}
    other = gym.make_vec("spoofgym/Zhong2025-v0", num_envs=ENVS, **settings)
    other = vector_wrappers.RecordEpochs(other, tmp_path / "gymnasium")
    other.reset(seed=3)
    play(other, 25)
    other.close()
    import pyarrow.parquet as pq

    mine, theirs = (
        {path.name: pq.read_table(path) for path in sorted((tmp_path / name).glob("*.parquet"))}
        for name in ("sb3", "gymnasium")
    )
    assert list(mine) == list(theirs)
    for name, table in mine.items():
        assert table.equals(theirs[name], check_metadata=True)
    told = [table.schema.metadata[b"spoofgym"] for table in mine.values()]
    assert sum(b'"complete": true' in text for text in told) == ends >= ENVS


def test_a_detector_outside_ends_the_episodes_that_it_ends_around_the_vector():
    detector, own = Calibrated(AlarmAt(7), scale=1.0), {"detector": "never", "infos": "all"}
    mine = AlarmRecorder(VecMonitor(PassiveDetector(make(**own), detector)))
    envs = gym.make_vec("spoofgym/Zhong2025-v0", num_envs=ENVS, **{**SETTINGS, **own}, threads=1)
    theirs = wrapped_vectors.AlarmRecorder(wrapped_vectors.PassiveDetector(envs, detector))
    mine.reset()
    theirs.reset(seed=3)
    ended, push = 0, np.ones((ENVS, 2), dtype=np.float32)
    for _ in range(12):
        observations, _, over, infos = mine.step(push)
        seen, _, terminated, truncated, all_infos = theirs.step(push)
        assert np.array_equal(over, terminated | truncated)
        for name in ("alarm", "statistic", "threshold"):
            assert [info[name] for info in infos] == all_infos[name].tolist()
        for row in np.flatnonzero(over):
            assert np.array_equal(infos[row]["terminal_observation"], seen[row])
        if over.any():
            assert over.all()  # at the same step, so that the two go on side by side
            begun, _, _, _, start = theirs.step(push)
            assert np.array_equal(observations, begun)
            told = [each["alarm"] for each in mine.venv.venv.reset_infos]
            assert told == start["alarm"].tolist()
            ended += 1
            assert all(info["alarm"] for info in infos)
    assert ended > 2
    assert mine.alarms.summarize() == theirs.alarms.summarize()
    with pytest.raises(TypeError, match="not wrapped yet"):
        PassiveDetector(VecMonitor(make(**own)), detector)
    with pytest.raises(ValueError, match="`infos` of the SpoofVecEnv must have alarm"):
        AlarmRecorder(make())


def test_a_wrapper_sets_the_detector_as_its_argument_does():
    settings = {key: value for key, value in SETTINGS.items() if key != "detector"}
    bare = SpoofVecEnv(ENVS, seed=3, **settings)
    wrapped, given = DetectorWrapper(bare, SETTINGS["detector"]), make()
    assert np.array_equal(wrapped.reset(), given.reset())
    assert_same(play(wrapped, 12), play(given, 12))
    assert bare.env_kwargs == given.env_kwargs
    envs = SpoofVecEnv(2, task="T1")  # whose own detector it takes the place of
    DetectorWrapper(VecMonitor(envs), "snapshot-chi2", false_alarms_per_hour=0.2)
    rated = {"name": "snapshot-chi2", "false_alarms_per_hour": 0.2}
    assert envs.env_kwargs["detector"] == rated
    for refused in (envs, SpoofVecEnv(2, pool=["ewma", "never"])):
        with pytest.raises(ValueError, match="two detectors are set at once"):
            DetectorWrapper(refused, "cusum")
    with pytest.raises(TypeError, match="`env` must be a SpoofEnv, a SpoofVectorEnv or a SpoofV"):
        DetectorWrapper(SpoofVecEnv(2, side="detector"), "cusum")


@pytest.mark.nightly
@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_processes_of_their_own_find_an_id_by_its_module(method):
    make = partial(gym.make, "spoofgym:spoofgym/Zhong2025-v0", detector="never")
    envs = SubprocVecEnv([make, make], start_method=method)
    assert envs.reset().shape == (2, 6)
    envs.close()
