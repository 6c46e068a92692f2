"""Wrappers, single and vector: sugar for arguments, and a recorder of epochs."""

import itertools
import json
import pickle
from contextlib import nullcontext
from functools import partial

import gymnasium as gym
import numpy as np
import pytest

from spoofgym import wrappers
from spoofgym.detectors import Detector, SnapshotChi2, Verdict
from spoofgym.detectors.build import spec_of_judge
from spoofgym.detectors.calibrated import STANDARD_RATE, UncalibratedWarning
from spoofgym.wrappers import vector as vector_wrappers
from spoofgym.wrappers.single import EpochRecorder

from ..envs.players import MODES, Player, Sooner
from ..envs.support import (
    HOLD,
    LIVE,
    SHORT,
    STEPS,
    VICTIMS,
    AlarmAt,
    single,
    timeline_of,
    vector,
    victim,
    victims,
)

parquet = pytest.importorskip("pyarrow.parquet")


NAMES = ("statistic", "threshold")


def transitions(env, steps=36, seed=4):
    rng = np.random.default_rng(1)
    shape = env.unwrapped.action_space.shape
    result = [env.reset(seed=seed)[0]]
    infos = []
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(
            np.broadcast_to(rng.uniform(-0.2, 0.6, shape[-1:]), shape)
        )
        result += [observation, reward, terminated]
        infos.append(info)
        if isinstance(env, gym.Env) and (terminated or truncated):
            result.append(env.reset()[0])
    return result, infos


def assert_same(mine, theirs):
    for a, b in zip(mine, theirs, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("make", "module"),
    [(single, wrappers), (partial(vector, 2), vector_wrappers)],
    ids=["single", "vector"],
)
def test_a_wrapper_is_the_same_as_its_argument(make, module):
    detector = {"name": "cusum"}
    wrapped = module.DetectorWrapper(make(knowledge="oracle"), detector)
    wrapped = module.WatchWrapper(wrapped, ["snapshot-chi2"])
    wrapped = module.StealthBudget(wrapped, 3.0)
    end = ["at-alarm", {"name": "at-stealth-budget", "budget_nats": 3.0}]
    given = make(knowledge="oracle", detector=detector, watch="snapshot-chi2", end=end)
    assert wrapped.unwrapped.observation_names == given.unwrapped.observation_names
    assert wrapped.observation_space == given.observation_space
    mine, theirs = transitions(wrapped), transitions(given)
    assert_same(mine[0], theirs[0])
    assert set(mine[1][0]) == set(theirs[1][0])
    with pytest.raises(RuntimeError, match="before reset"):
        module.WatchWrapper(wrapped, ["cusum"])
    with pytest.raises(ValueError, match="'ewma' and 'cusum'"):
        module.DetectorWrapper(make(detector="ewma"), "cusum")
    for end_at_alarm in (True, False):
        env = make(detector=AlarmAt(LIVE + 3), end_at_alarm=end_at_alarm)
        env = module.StealthBudget(env, 1e9)  # leaves the end by an alarm as it was
        env.reset(seed=1)
        ends = [env.step(np.zeros(env.action_space.shape))[2] for _ in range(3)]
        assert [np.all(end) for end in ends] == [False, False, end_at_alarm]
    wrapped = module.DetectorWrapper(make(detector="never"), "cusum")  # which is as none
    with pytest.raises(ValueError, match="'cusum' and 'never'"):
        module.DetectorWrapper(wrapped, "never")


ONES = {
    "DetectorWrapper": ("cusum",),
    "EpochInfo": (),
    "PassiveDetector": ("cusum",),
    "RecordEpochs": ("unused",),
    "StealthBudget": (3.0,),
    "WatchWrapper": ("cusum",),
}


@pytest.mark.parametrize("name", ONES)
def test_a_wrapper_of_another_form_names_its_twin(name):
    forms = {"wrappers": single(), "wrappers.vector": vector(2)}
    for module, env in ((wrappers, "wrappers.vector"), (vector_wrappers, "wrappers")):
        with pytest.raises(TypeError, match=rf"`spoofgym\.{env}\.{name}`$"):
            getattr(module, name)(forms[env], *ONES[name])
    with pytest.raises(TypeError, match=r"a vector environment of Gymnasium, got 3$"):
        getattr(vector_wrappers, name)(3, *ONES[name])


@pytest.mark.parametrize("kind", ["Zhong2025", "WheeledRobot"])
def test_statistic_and_threshold_of_the_loudest_channel_are_in_the_information(kind):
    env, envs = victim(kind), victims(kind, 2)
    infos = [env.reset(seed=5)[1]], [envs.reset(seed=5)[1]]
    for _ in range(5):
        verdict = envs.core.engine.simulator.verdict
        ratio = (verdict.statistic / verdict.threshold).max(axis=1)
        now = [each[-1] for each in infos]
        np.testing.assert_array_equal(now[1]["statistic"] / now[1]["threshold"], ratio)
        assert [now[0][key] for key in NAMES] == [now[1][key][0] for key in NAMES]
        push = np.full(env.action_space.shape, 0.02)  # no alarm ends the episode
        for each, one, given in zip(infos, (env, envs), (push, np.stack([push] * 2)), strict=True):
            each.append(one.step(given)[4])
    assert len({info["statistic"] for info in infos[0]}) > 1


def test_before_anything_is_judged_there_is_no_statistic():
    timeline = {**SHORT, "live_s": 0.0}
    info = single(timeline=timeline).reset(seed=0)[1]
    assert all(np.isnan(info[key]) for key in NAMES)


def test_the_spec_of_a_wrapped_environment_makes_it_again():
    env = wrappers.StealthBudget(wrappers.DetectorWrapper(single(), "snapshot-chi2"), 3.0)
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert type(again.unwrapped.core.setup.detector).__name__ == "SnapshotChi2"
    assert_same(transitions(env)[0], transitions(again)[0])
    for other in (
        gym.make("spoofgym/SpooferView-v0", scenario="zhong2025", timeline=SHORT),
        gym.make("CartPole-v1"),
    ):
        with pytest.raises(TypeError, match="`env` must be a SpoofEnv, a SpoofVectorEnv or a Sp"):
            wrappers.WatchWrapper(other, ["cusum"])


@pytest.mark.usefixtures("default_rate")
@pytest.mark.parametrize(
    ("make", "detector", "rate", "found"),
    [
        (partial(gym.make_vec, num_envs=2), {"name": "snapshot-chi2"}, None, STANDARD_RATE),
        (gym.make, SnapshotChi2, 0.5, 0.5),
        (gym.make, "spoofgym.detectors:SnapshotChi2", None, STANDARD_RATE),
        (gym.make, SnapshotChi2(), None, None),  # keeps its own thresholds
    ],
)
def test_the_detector_of_an_id_is_replaced(make, detector, rate, found):
    env = make("spoofgym/BenchT3-v1")  # which brings one of its own, solution separation
    module = wrappers if make is gym.make else vector_wrappers
    own = pytest.warns(UncalibratedWarning, match="`spoofgym calibrate .* snapshot-chi2 --false-al")
    with nullcontext() if found else own:
        env = module.DetectorWrapper(env, detector, false_alarms_per_hour=rate)
    spec = spec_of_judge(env.unwrapped.core.setup.detector)
    assert (spec["name"], spec.get("false_alarms_per_hour")) == ("snapshot-chi2", found)
    with pytest.raises(ValueError, match="two detectors are set at once"):
        module.DetectorWrapper(env, "ewma")
    env.close()


@pytest.mark.usefixtures("default_rate")
@pytest.mark.parametrize(
    ("env", "detector", "rate", "message"),
    [
        ("LooselyCoupled", "ewma", None, "^Ewma measures satellites, but the receiver measures po"),
        ("Zhong2025", "rio", 0.3, "^Rio needs auxiliary_position, gnss_position, which a ti"),
        ("Zhong2025", "fma", None, "^there is no calibration of fma in .*`spoofgym calibrate"),
        ("Zhong2025", {"name": "ewma", "thresholds": "nominal"}, 0.2, "thresholds of its own"),
        ("Zhong2025", "tests.envs.raises:Mine", None, ":Mine. raises RuntimeError"),
    ],
)
def test_a_detector_is_refused_for_its_reason(env, detector, rate, message):
    env = gym.make(f"spoofgym/{env}-v0")
    with pytest.raises(ValueError, match=message) as caught:
        wrappers.DetectorWrapper(env, detector, false_alarms_per_hour=rate)
    assert "\n" not in str(caught.value)


class Nervous(Detector):
    paper = "groves2013"
    measures = "any"

    def bind(self, context):
        super().bind(context)

    def judge(self, epoch):
        statistic = np.abs(epoch.innovation[:, :1]) * 1e4 % 1.0
        threshold = np.full_like(statistic, 79 / 80)
        return Verdict(statistic, threshold, statistic > threshold)


@pytest.mark.parametrize(
    ("kind", "prefetch"), [("Zhong2025", False), ("Zhong2025", True), ("WheeledRobot", False)]
)
def test_detectors_that_watch_change_nothing_and_see_everything(kind, prefetch):
    """Warm-up, commands and time to alert, over episodes that end by themselves."""
    loud, weighs = Nervous(), "ewma" if kind == "Zhong2025" else "acna"
    timeline = {**timeline_of(kind), "live_s": timeline_of(kind)["warmup_s"]}
    kwargs = {"end": ["at-window-end"], "timeline": timeline, "detector": loud}
    kwargs |= {"prefetch": prefetch} if kind == "Zhong2025" else {}
    alone, watched = (
        victims(kind, 3, **kwargs, **w) for w in ({}, {"watch": [loud, weighs, weighs]})
    )
    assert [name for name in watched.core.info_names if name.endswith("_ratio")] == [
        "watch_nervous_ratio",
        f"watch_{weighs}_ratio",
        f"watch_{weighs}_2_ratio",
    ]
    mine, theirs = transitions(alone, 70), transitions(watched, 70)
    assert_same(mine[0], theirs[0])
    assert max(np.max(info.get(f"watch_{weighs}_ratio", 0.0)) for info in theirs[1]) > 0.0
    warmup, alarmed = [], []
    for info in theirs[1]:
        np.testing.assert_array_equal(info["watch_nervous_warmup_alarm"], info["warmup_alarm"])
        warmup.append(info["warmup_alarm"])
        if "alarm" in info:  # else all begin anew
            here = info["_alarm"]
            # the time to alert is only run by those without an alarm before
            seen = info["watch_nervous_alarm"][here]
            np.testing.assert_array_equal(seen, info["alarm"][here])
            alarmed += seen.tolist()
    for found in (np.array(warmup), np.array(alarmed)):
        assert found.any()
        assert not found.all()


def read(path):
    table = parquet.read_table(path)
    return table, json.loads(table.schema.metadata[b"spoofgym"])


@pytest.mark.parametrize("mode", MODES)
def test_every_epoch_of_every_episode_is_written(tmp_path, mode):
    envs = vector(2, autoreset_mode=mode, detector=Sooner())
    played = Player(vector_wrappers.RecordEpochs(envs, tmp_path), mode).begin(3)
    rows = played.go(2 * STEPS)
    played.env.close()
    for i, row in enumerate(rows):
        starts = [k for k, each in enumerate(row) if "reward" not in each]
        assert len(starts) > 2  # the third is not over
        for episode, (first, last) in enumerate(itertools.pairwise(starts[:3])):
            expected = [each["info"]["displacement_m"] for each in row[first + 1 : last]]
            table, told = read(tmp_path / f"receiver-00{i}-episode-00000{episode}.parquet")
            assert (told["receiver"], told["episode"], told["complete"]) == (i, episode, True)
            assert table["step"].to_pylist() == list(range(1, table.num_rows + 1))
            assert table["displacement_m"].to_pylist() == expected
    names = set(table.column_names)
    assert {"time_s", "innovation", "innovation_variance", "statistic", "alarm"} <= names
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize(
    ("kind", "epochs", "at", "width"),
    [
        ("Zhong2025", 1, -5, 24),
        ("Zhong2025", 5, 33, 24),
        ("LooselyCoupled", 3, 33, 3),
        ("Snapshot", 3, 33, 24),
        ("WheeledRobot", 3, -5, 2),
    ],
)
def test_what_is_written_are_the_epochs_of_the_commands_and_no_others(
    tmp_path, kind, epochs, at, width
):
    """Neither the warm-up nor the time to alert: the information tells of alarms there."""
    interval_s = round(epochs * VICTIMS[kind], 6) if epochs > 1 else None
    env = victim(kind, detector=AlarmAt(LIVE + at), decision_interval_s=interval_s)
    env = wrappers.RecordEpochs(env, tmp_path)
    _, begun = env.reset(seed=3)
    push = np.zeros(env.action_space.shape)
    push[1] = 0.1
    over = False
    while not over:
        *_, over, _, info = env.step(push)
    env.close()
    assert (begun["warmup_alarm"], info["alarm"]) == (at < 0, at > 0)
    table, told = read(tmp_path / "receiver-000-episode-000000.parquet")
    assert told["complete"]
    assert table["step"].to_pylist() == list(range(1, STEPS + 1))
    time_s = VICTIMS[kind] * (2 * LIVE + np.arange(STEPS + HOLD + 1))
    np.testing.assert_allclose(table["time_s"].to_pylist(), time_s[1 : STEPS + 1])
    assert not any(table["alarm"].to_pylist())
    assert np.array(table["innovation"].to_pylist()).shape == (STEPS, width)
    assert ("visible" in table.column_names) == (width == 24)
    if kind != "Zhong2025":
        commanded = np.array(table["commanded_displacement_m"].to_pylist())
        assert (np.diff(commanded[:, 1]) > 0.0).all()
    # the receiver has run the time to alert, which no file tells of
    np.testing.assert_allclose((begun["time_s"], info["time_s"]), time_s[[0, -1]])


def test_what_can_not_be_recorded_is_refused_at_birth(monkeypatch, tmp_path):
    path = tmp_path / "file"
    path.write_text("")
    for folder in (path, path / "deeper"):
        with pytest.raises(ValueError, match=r"`folder` .*file.* can't be made"):
            wrappers.RecordEpochs(single(), folder)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ImportError, match="extra `flights`"):
        EpochRecorder(tmp_path, 1)


def test_a_reset_of_some_goes_on_with_the_files_of_the_others(tmp_path):
    envs = vector(2, autoreset_mode="disabled", detector="never")
    envs = vector_wrappers.RecordEpochs(envs, tmp_path)
    envs.reset(seed=3)
    for steps in (2, 3):
        for _ in range(steps):
            envs.step(np.zeros((2, 2)))
        envs.reset(options={"reset_mask": np.array([True, False])})
    envs.close()
    files = sorted(tmp_path.glob("*.parquet"))
    assert [path.stem for path in files] == [
        f"receiver-00{i}-episode-00000{k}" for i, k in ((0, 0), (0, 1), (1, 0))
    ]
    assert [read(path)[0].num_rows for path in files] == [2, 3, 5]


def test_a_later_run_counts_on_and_a_broken_episode_says_so(tmp_path):
    for _ in range(2):
        env = wrappers.RecordEpochs(wrappers.WatchWrapper(single(), ["cusum"]), tmp_path)
        env.reset(seed=1)
        env.step([0.0, 0.1])
        copy = pickle.loads(pickle.dumps(env))
        mine, theirs = (each.step([0.0, 0.2]) for each in (env, copy))
        np.testing.assert_array_equal(mine[0], theirs[0])
        assert mine[1:] == theirs[1:]
        env.reset()
        env.close()
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [f"receiver-000-episode-00000{k}.parquet" for k in range(2)]
    table, told = read(tmp_path / names[1])
    assert table.num_rows == 2
    assert not told["complete"]
    offsets = np.array(table["range_offset_m"].to_pylist())
    assert offsets[1].any()
