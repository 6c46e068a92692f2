"""A spoofer and an environment: what fits is bound, and what does not is told in full."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.envs.spoofer_binding import attach, setup_of_card
from spoofgym.policies import SpooferCard, card_of, shipped
from spoofgym.spoofers import Ramp

from ..spoofers.policies import ENV, FULL, TIMELINE, write_policy
from .support import ID, vector


def single(**changes: Any) -> gym.Env:
    return gym.make(ID, **{**ENV, **FULL, "knowledge": "blind", **changes})


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(write_policy(tmp_path_factory.mktemp("policy")))


def test_it_plays_a_single_environment(policy: str) -> None:
    env = single()
    spoofer = attach(policy, env)
    observation, _ = env.reset(seed=1)
    terminated, steps = False, 0
    while not terminated:
        action = spoofer.act(observation[None])
        observation, _, terminated, _, _ = env.step(action[0])
        steps += 1
    assert steps <= 30
    assert spoofer.context.receivers == 1


def test_it_plays_a_vector_environment(policy: str) -> None:
    envs = gym.wrappers.vector.RecordEpisodeStatistics(vector(4, **ENV, knowledge="blind"))
    spoofer = attach(policy, envs)
    observation, _ = envs.reset(seed=1)
    action = spoofer.act(observation)
    assert action.shape == (4, 2)
    one = attach(policy, single()).act(observation[2:3])
    assert one.tobytes() == action[2:3].tobytes()
    envs.step(action)


def test_it_plays_stable_baselines_environment(policy: str) -> None:
    sb3 = pytest.importorskip("spoofgym.sb3")
    envs = sb3.SpoofVecEnv(3, **ENV, **FULL, knowledge="blind")
    assert attach(policy, envs).act(envs.reset()).shape == (3, 2)
    envs.close()


@pytest.mark.parametrize("between", ["hold", "linear"])
@pytest.mark.parametrize(
    "spec",
    [
        {"name": "ramp", "rate_mps": 0.1},
        {"name": "profile", "rates_mps": [0.0, 0.1, 0.1]},
        {"name": "accelerating-ramp", "acceleration_mps2": 0.01},
    ],
)
def test_a_scripted_spoofer_goes_by_the_time_between_its_decisions(
    spec: dict[str, Any], between: str
) -> None:
    env = single(detector="never", decision_interval_s=2.5, between=between)
    spoofer = attach(spec, env)
    assert (spoofer.context.interval_s, spoofer.context.steps) == (2.5, 6)
    observation, _ = env.reset(seed=1)
    memory = env.unwrapped.core.engine.simulator.attack.memory
    rates = []
    for _ in range(6):
        observation, *_ = env.step(spoofer.act(observation[None])[0])
        rates.append(memory["rate"][0, 1])
    if spec["name"] == "accelerating-ramp":
        # linear: half of the first decision is on the way to its acceleration
        late = 2.5 * (between == "linear") * 0.5 * (1.0 - 1.0 / 5.0)
        assert rates[-1] == pytest.approx(0.01 * (15.0 - late))
    else:
        assert rates[-1] == pytest.approx(0.1)
        assert max(rates) < 0.1 + 1e-9


def test_the_object_is_copied() -> None:
    ramp = Ramp(rate_mps=0.2)
    attached = attach(ramp, single())
    assert attached == ramp
    assert not hasattr(ramp, "memory")
    assert attached.memory["step"].tolist() == [0.0]


def test_a_spoofer_without_a_card_plays_anywhere() -> None:
    envs = vector(2, knowledge="oracle", attack="per-channel", detector="never")
    assert attach("ramp", envs).act(envs.reset(seed=0)[0]).shape == (2, len(envs.action_names))


OTHER_SETTINGS = [
    ({"detector": "snapshot-chi2"}, r"detector\.kind: 'Ewma' on the card, 'SnapshotChi2' here"),
    (
        {"detector": {"name": "ewma", "smoothing": 0.2}},
        r"detector\.smoothing: 0\.1 on the card, 0\.2 here",
    ),
    ({"scenario": {"errors": "white"}}, r"scenario\.errors: 'zhong2025' on the card, 'white' here"),
    ({"receiver": {"tuning": "matched"}}, r"receiver\.tuning: 'paper' on the card, 'matched' here"),
    ({"target_heading_deg": 0.0}, r"target_heading_deg: 90\.0 on the card, 0\.0 here"),
    (
        {"attack": {"name": "false-position", "coherent": False}},
        r"attack\.coherent: True on the card, False here",
    ),
    (
        {"timeline": {**TIMELINE, "time_to_alert_s": 2.0}},
        r"timeline\.time_to_alert_s: 5\.0 on the card, 2\.0 here",
    ),
    ({"imu_rate_hz": 20}, r"scenario\.imu_rate_hz: None on the card, 20 here"),
]


@pytest.mark.parametrize(("changes", "message"), OTHER_SETTINGS)
def test_other_settings_are_a_transfer(policy: str, changes: dict[str, Any], message: str) -> None:
    env = single(**changes)
    with pytest.raises(ValueError, match=message) as caught:
        attach(policy, env)
    assert "'tiny' was made for another environment (`transfer=True` allows" in str(caught.value)
    attach(policy, env, transfer=True).act(env.reset(seed=0)[0][None])


def test_all_differences_are_listed(policy: str) -> None:
    changes = {key: value for other, _ in OTHER_SETTINGS[1:5] for key, value in other.items()}
    with pytest.raises(ValueError, match="was made for another") as caught:
        attach(policy, single(**changes))
    lines = [line.strip().split(":")[0] for line in str(caught.value).splitlines()[1:]]
    assert {"detector.smoothing", "receiver.tuning", "target_heading_deg"} <= set(lines)


OTHER_MEANING = [
    ({"knowledge": "tracking"}, r"observation: target_position_east, target_velocity_north"),
    ({"attack": "per-channel"}, r"action: north_acceleration, east_acceleration only on the card"),
    (
        {"attack": {"name": "false-position", "control": "rate"}},
        r"conditions\.control: 'acceleration' on the card, 'rate' here",
    ),
    (
        {"attack": {"name": "false-position", "rate_limit_mps": 3.0}},
        r"conditions\.rate_limit_mps: 5\.0 on the card, 3\.0 here",
    ),
    ({"timeline": {**TIMELINE, "attack_s": 12.0}}, r"steps: 30 on the card, 24 here"),
    ({"scenario": {"epoch_interval_s": 1.0}}, r"interval_s: 0\.5 on the card, 1\.0 here"),
]


@pytest.mark.parametrize(("changes", "message"), OTHER_MEANING)
@pytest.mark.parametrize("transfer", [False, True])
def test_another_meaning_is_never_allowed(
    policy: str, changes: dict[str, Any], message: str, transfer: bool
) -> None:
    with pytest.raises(ValueError, match=message):
        attach(policy, single(**changes), transfer=transfer)


def test_other_scales_of_the_space_are_seen(policy: str) -> None:
    squeezed = gym.wrappers.RescaleObservation(single(), np.float32(-1.0), np.float32(1.0))
    with pytest.raises(ValueError, match="observation: a wrapper changes the space from Box"):
        attach(policy, squeezed, transfer=True)
    scaled = gym.wrappers.RescaleAction(single(), np.float32(0.0), np.float32(1.0))
    with pytest.raises(ValueError, match="action: a wrapper changes the space from Box"):
        attach(policy, scaled, transfer=True)


def test_a_detector_of_the_user_is_another_one(policy: str) -> None:
    from spoofgym.detectors import Ewma

    class Mine(Ewma):
        pass

    with pytest.raises(ValueError, match=r"detector\.kind: 'Ewma' on the card, '.*Mine' here"):
        attach(policy, single(detector=Mine()))


def test_a_shipped_profile_is_compared_by_its_card(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("spoofgym.policies.zoo.ZOO_FOLDER", tmp_path)
    card = json.loads(write_policy(tmp_path).with_suffix(".json").read_text())
    settings = {"rates_mps": [0.0, 0.2], "heading_deg": 90.0}
    card |= {"name": "slow", "kind": "profile", "file": None, "observation": None}
    (tmp_path / "slow.json").write_text(json.dumps({**card, "settings": settings}))
    env = single(knowledge="tracking")  # it looks at nothing
    assert attach("slow", env).act(env.reset(seed=0)[0][None]).shape == (1, 2)
    with pytest.raises(ValueError, match=r"'slow' was made .*\n.*detector\.kind"):
        attach({"name": "slow"}, single(detector="never"))


@pytest.mark.usefixtures("default_rate")
@pytest.mark.parametrize("name", shipped("spoofer"))
def test_a_shipped_spoofer_plays_the_environment_of_its_card(name: str) -> None:
    """Also where that looks its thresholds up by a rate of false alarms."""
    card = card_of(name)
    envs = gym.make_vec(card.env_id, num_envs=2, **card.env_kwargs)
    spoofer = attach(name, envs)
    observation, _ = envs.reset(seed=1)
    assert envs.action_space.contains(spoofer.act(observation).astype(np.float32))
    envs.close()
    other = {**card.env_kwargs, "detector": {"name": "cusum", "thresholds": "nominal"}}
    with pytest.raises(ValueError, match="detector"):
        attach(name, gym.make_vec(card.env_id, num_envs=2, **other))


def test_what_is_no_environment_of_ours_is_refused(policy: str) -> None:
    for env in (3, gym.make_vec(ID, 1, vectorization_mode="sync", **ENV)):
        with pytest.raises(TypeError, match="`env` must be a SpoofEnv, a SpoofVectorEnv or"):
            attach(policy, env)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"env_id": "CartPole-v1"},
            r"card of 'tiny': `env_id` must be one of spoofgym/.*got 'CartPole",
        ),
        ({"env_kwargs": {"scenery": "x"}}, r"card of 'tiny': `env_kwargs` has 'scenery'; valid:"),
        ({"env_kwargs": {"detector": "emwa"}}, r"`env_kwargs`: unknown detector 'emwa'; valid:"),
        ({"env_kwargs": {"timeline": {"attack_s": "x"}}}, r"card of 'tiny': `env_kwargs`: "),
    ],
)
def test_a_card_of_no_environment_is_told(
    policy: str, changes: dict[str, Any], message: str
) -> None:
    card = SpooferCard.load(Path(policy).with_suffix(".json")).model_copy(update=changes)
    with pytest.raises(ValueError, match=message):
        setup_of_card(card)
