"""A spoofer and an environment: what fits is bound, and what does not is told in full."""

import json
import os
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.bench.runs.world import read_training_world
from spoofgym.detectors import Ewma
from spoofgym.envs.spoofer_binding import attach, setup_of_card
from spoofgym.policies import SpooferCard, list_shipped, load_card
from spoofgym.spoofers import Ramp
from tests.nightly import heavy

from ..spoofers.policies import ENV, FULL, TIMELINE, write_policy
from .support import ID, vector

SHIPPED = list_shipped("spoofer")
RATE = {"name": "false-position", "control": "rate"}
SLOW = {"name": "false-position", "rate_limit_mps": 3.0}


def single(**changes):
    return gym.make(ID, **{**ENV, **FULL, "knowledge": "blind", **changes})


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return str(write_policy(tmp_path_factory.mktemp("policy")))


def test_it_plays_environments_of_every_form(policy):
    env = single()
    spoofer = attach(policy, env)
    assert spoofer.context.receivers == 1
    observation, _ = env.reset(seed=1)
    terminated = False
    while not terminated:
        observation, _, terminated, _, _ = env.step(spoofer.act(observation[None])[0])
    envs = gym.wrappers.vector.RecordEpisodeStatistics(vector(4, **ENV, knowledge="blind"))
    spoofer = attach(policy, envs)
    observation, _ = envs.reset(seed=1)
    action = spoofer.act(observation)
    assert action.shape == (4, 2)
    one = attach(policy, single()).act(observation[2:3])
    assert one.tobytes() == action[2:3].tobytes()
    envs.step(action)
    ramp = Ramp(rate_mps=0.2)  # without a card it plays anywhere; the object is copied
    envs = vector(2, knowledge="oracle", attack="per-channel", detector="never")
    attached = attach(ramp, envs)
    assert attached == ramp
    assert not hasattr(ramp, "memory")
    assert attached.act(envs.reset(seed=0)[0]).shape == (2, len(envs.action_names))
    sb3 = pytest.importorskip("spoofgym.sb3")
    envs = sb3.SpoofVecEnv(3, scenario="zhong2025", **ENV, **FULL, knowledge="blind")
    assert attach(policy, envs).act(envs.reset()).shape == (3, 2)
    envs.close()


@pytest.mark.parametrize(
    ("spec", "between", "last"),
    [
        ({"name": "ramp", "rate_mps": 0.1}, "hold", 0.1),
        ({"name": "profile", "rates_mps": [0.0, 0.1, 0.1]}, "linear", 0.1),
        ({"name": "accelerating-ramp", "acceleration_mps2": 0.01}, "hold", 0.15),
        # half of the first decision is on the way to its acceleration
        ({"name": "accelerating-ramp", "acceleration_mps2": 0.01}, "linear", 0.14),
    ],
)
def test_a_scripted_spoofer_goes_by_the_time_between_its_decisions(spec, between, last):
    env = single(detector="never", decision_interval_s=2.5, between=between)
    spoofer = attach(spec, env)
    assert (spoofer.context.interval_s, spoofer.context.steps) == (2.5, 6)
    observation, _ = env.reset(seed=1)
    memory = env.unwrapped.core.engine.simulator.attack.memory
    rates = []
    for _ in range(6):
        observation, *_ = env.step(spoofer.act(observation[None])[0])
        rates.append(memory["rate"][0, 1])
    assert rates[-1] == pytest.approx(last)
    assert max(rates) < last + 1e-9


def test_other_settings_are_a_transfer(policy):
    env = single(
        detector={"name": "ewma", "smoothing": 0.2},
        scenario={"errors": "white", "imu_rate_hz": 20},
        receiver={"tuning": "matched"},
        target_heading_deg=0.0,
        attack={"name": "false-position", "coherent": False},
        timeline={**TIMELINE, "time_to_alert_s": 2.0},
    )
    with pytest.raises(ValueError, match="was made for another environment") as caught:
        attach(policy, env)
    first, *lines = str(caught.value).splitlines()
    assert "'tiny' was made for another environment (`transfer=True` allows" in first
    assert {line.strip() for line in lines} >= {
        "detector.smoothing: 0.1 on the card, 0.2 here",
        "scenario.errors: 'zhong2025' on the card, 'white' here",
        "scenario.imu_rate_hz: None on the card, 20 here",
        "receiver.tuning: 'paper' on the card, 'matched' here",
        "target_heading_deg: 90.0 on the card, 0.0 here",
        "attack.coherent: True on the card, False here",
        "timeline.time_to_alert_s: 5.0 on the card, 2.0 here",
    }
    attach(policy, env, transfer=True).act(env.reset(seed=0)[0][None])
    other = single(detector=type("Mine", (Ewma,), {})())
    with pytest.raises(ValueError, match=r"detector\.kind: 'Ewma' on the card, '.*Mine' here"):
        attach(policy, other)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"knowledge": "tracking"}, "observation: target_position_east, target_velocity_north"),
        ({"attack": "per-channel"}, "action: north_acceleration, east_acceleration only on the c"),
        ({"attack": RATE}, r"conditions\.control: 'acceleration' on the card, 'rate' here"),
        ({"attack": SLOW}, r"conditions\.rate_limit_mps: 5\.0 on the card, 3\.0 here"),
        ({"timeline": {**TIMELINE, "attack_s": 12.0}}, "steps: 30 on the card, 24 here"),
        ({"scenario": {"epoch_interval_s": 1.0}}, r"interval_s: 0\.5 on the card, 1\.0 here"),
    ],
)
def test_another_meaning_is_never_allowed(policy, changes, message):
    env = single(**changes)
    for transfer in (False, True):
        with pytest.raises(ValueError, match=message):
            attach(policy, env, transfer=transfer)


def test_other_scales_and_what_is_no_environment_of_ours_are_refused(policy):
    rescale = gym.wrappers.RescaleObservation, gym.wrappers.RescaleAction
    for wrapper, word in zip(rescale, ("observation", "action"), strict=True):
        env = wrapper(single(), np.float32(0.0), np.float32(1.0))
        with pytest.raises(ValueError, match=f"{wrapper.__name__} changes every {word}, and 't"):
            attach(policy, env, transfer=True)
    for env in (3, gym.make_vec(ID, 1, vectorization_mode="sync", **ENV)):
        with pytest.raises(TypeError, match="`env` must be a SpoofEnv, a SpoofVectorEnv or"):
            attach(policy, env)
    card = SpooferCard.load(Path(policy).with_suffix(".json"))
    for changes, message in (
        (
            {"env_id": "CartPole-v1"},
            "`env_id`: unknown environment 'CartPole-v1'; valid: spoofgym/",
        ),
        ({"env_kwargs": {"scenery": "x"}}, "`env_kwargs` has 'scenery'; valid:"),
        ({"env_kwargs": {"detector": "emwa"}}, "`env_kwargs`: unknown detector 'emwa'; valid:"),
        ({"env_kwargs": {"timeline": {"attack_s": "x"}}}, "`env_kwargs`: "),
    ):
        with pytest.raises(ValueError, match=f"card of 'tiny': {message}"):
            setup_of_card(card.model_copy(update=changes))


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"": 1}, "must be settings of an environment, got ''"),
        ({"decision_interval_s": 0.0}, "`decision_interval_s` must be above 0 and finite, got 0.0"),
        ({"decision_interval_s": True}, "`decision_interval_s` must be above 0"),
        ({"between": "leap"}, "`between` must be 'hold' or 'linear', got 'leap'"),
    ],
)
def test_settings_on_a_card_are_checked_when_it_is_loaded(kwargs, message, tmp_path):
    path = write_policy(tmp_path).with_suffix(".json")
    path.write_text(json.dumps({**json.loads(path.read_text()), "env_kwargs": kwargs}))
    with pytest.raises(ValueError, match=message):
        SpooferCard.load(path)


def test_a_world_is_not_read_from_a_card_with_unknown_settings(tmp_path):
    path = write_policy(tmp_path).with_suffix(".json")
    fields = json.loads(path.read_text())
    path.write_text(json.dumps({**fields, "env_kwargs": {**fields["env_kwargs"], "scenery": "x"}}))
    with pytest.raises(ValueError, match="`env_kwargs` has 'scenery'; valid:"):
        read_training_world(os.fspath(path.with_suffix(".onnx")))


def test_a_shipped_profile_is_compared_by_its_card(tmp_path, monkeypatch):
    monkeypatch.setattr("spoofgym.policies.zoo.ZOO_FOLDER", tmp_path)
    card = json.loads(write_policy(tmp_path).with_suffix(".json").read_text())
    settings = {"rates_mps": [0.0, 0.2], "heading_deg": 90.0}
    card |= {"name": "slow", "kind": "profile", "file": None, "observation": None}
    (tmp_path / "slow.json").write_text(json.dumps({**card, "settings": settings}))
    env = single(knowledge="tracking")  # it looks at nothing
    assert attach("slow", env).act(env.reset(seed=0)[0][None]).shape == (1, 2)
    for named in ({"name": "slow"}, str(tmp_path / "slow.json")):
        with pytest.raises(ValueError, match=r"'slow' was made .*\n.*detector\.kind"):
            attach(named, single(detector="never"))


def test_the_card_of_a_policy_stands_for_it(policy, tmp_path):
    by_card = attach(str(Path(policy).with_suffix(".json")), single())
    assert by_card == attach(policy, single())
    (tmp_path / "alone.json").write_bytes(Path(policy).with_suffix(".json").read_bytes())
    with pytest.raises(ValueError, match=r"alone\.onnx"):
        attach(str(tmp_path / "alone.json"), single())


@pytest.mark.usefixtures("default_rate")
@pytest.mark.parametrize("name", heavy(SHIPPED, *SHIPPED[2:]))
def test_a_shipped_spoofer_plays_the_environment_of_its_card(name):
    """Also where that looks its thresholds up by a rate of false alarms."""
    card = load_card(name)
    envs = gym.make_vec(card.env_id, num_envs=2, **card.env_kwargs)
    spoofer = attach(name, envs)
    observation, _ = envs.reset(seed=1)
    assert envs.action_space.contains(spoofer.act(observation).astype(np.float32))
    envs.close()
    other = {**card.env_kwargs, "detector": {"name": "cusum", "thresholds": "nominal"}}
    with pytest.raises(ValueError, match="detector"):
        attach(name, gym.make_vec(card.env_id, num_envs=2, **other))


def test_where_thresholds_alone_differ_nothing_else_of_the_detector_is_named():
    env = gym.make("spoofgym/Zhong2025-v0", detector={"name": "ewma", "thresholds": "nominal"})
    with pytest.raises(ValueError, match=r"'ewma-ppo' was made for") as error:
        attach("ewma-ppo", env)
    named = [line.split(":")[0].strip() for line in str(error.value).splitlines()]
    named = [name for name in named if name.startswith("detector.")]
    assert named == ["detector.scale", "detector.false_alarms_per_hour", "detector.rescaled"]
