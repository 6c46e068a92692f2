"""The environments of all victims: settings, names, and what is refused."""

from __future__ import annotations

import inspect
import itertools

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.detectors import Ewma
from spoofgym.envs import SpoofEnv
from spoofgym.envs.core import ALARM_PRICE
from spoofgym.simulation import TightlyCoupledSetup

from .support import ID, SMALL, STEPS, VICTIMS, single, vector, victim, victims


@pytest.fixture(params=VICTIMS)
def kind(request):
    return request.param


def test_the_default_is_what_the_architecture_says():
    env = gym.make(ID).unwrapped
    setup = env.core.setup
    assert (setup.onset, setup.steps, setup.hold) == (400, 300, 20)
    assert setup.detector.weight_scale == 0.3
    assert env.action_names == ("along_target_setpoint",)
    assert gym.spec(ID).max_episode_steps is None


def test_a_signature_shows_all_settings(kind):
    env, envs = victim(kind).unwrapped, victims(kind, 2)
    single, vector = (inspect.signature(type(each)).parameters for each in (env, envs))
    assert next(iter(vector)) == "num_envs"
    for parameters in (single, vector):
        assert "settings" not in parameters
        assert parameters["between"].default == "hold"
        assert parameters["alarm_price"].default == ALARM_PRICE
        assert {"timeline", "domain", "twin", "watch"} < set(parameters)
    assert ("rate_limit_mps" in single) == (kind in SMALL)


def test_none_is_the_default_of_a_setting():
    env = SpoofEnv(detector=None, attack=None, knowledge=None, timeline=None)
    assert isinstance(env.core.setup.detector, Ewma)
    assert env.core.setup.timeline == TightlyCoupledSetup().timeline
    assert env.given_detector is None


def test_knowledge_only_grows(kind):
    names = []
    for knowledge in ("blind", "tracking", "oracle"):
        env = victim(kind, knowledge=knowledge).unwrapped
        assert len(env.observation_names) == env.observation_space.shape[0]
        assert len(env.action_names) == env.action_space.shape[0]
        assert np.isfinite(env.observation_space.low).all()
        assert np.isfinite(env.observation_space.high).all()
        assert len(set(env.observation_names)) == len(env.observation_names)
        names.append(env.observation_names)
    for less, more in itertools.pairwise(names):
        assert more[: len(less)] == less != more
    assert all(name.startswith(("own_", "time_")) for name in names[0])
    assert not any(name.startswith(("statistic_", "error_", "weight_")) for name in names[1])
    assert {"error_north", "error_east"} < {*names[2]}


def test_a_push_without_a_defence_moves_the_victim(kind):
    env = victim(kind, detector="never", target_heading_deg=0.0)
    moved = []
    for push in (0.0, 0.5):
        env.reset(seed=2)
        action = np.zeros(env.action_space.shape)
        action[0] = push
        for _ in range(STEPS):
            *_, terminated, _, info = env.step(action)
        assert terminated
        moved.append(info["displacement_m"])
    assert moved[1] > moved[0] + 0.1 * VICTIMS[kind]
    assert info["undetected_displacement_m"] >= info["displacement_m"]


@pytest.mark.parametrize(
    ("kind", "bad"),
    [
        *((kind, [0.0, 1.5]) for kind in VICTIMS),
        ("Snapshot", [np.nan, 0]),
        ("Snapshot", [-np.inf, 0]),
    ],
)
def test_a_bad_action_names_element_and_value(kind, bad):
    env, envs = victim(kind).unwrapped, victims(kind, 2)
    env.reset(seed=0)
    envs.reset(seed=0)
    axes = env.action_space.shape[0]
    given = np.append(bad, np.zeros(axes - 2))
    with pytest.raises(ValueError, match=r"finite and in \[-1, 1\].*(acceleration|rate).*is"):
        env.step(given)
    with pytest.raises(ValueError, match=rf"shape \({axes},\) .*got \(5,\)"):
        env.step(np.zeros(5))
    with pytest.raises(ValueError, match="of receiver 1 is"):
        envs.step(np.stack([np.zeros(axes), given]))
    with pytest.raises(ValueError, match=rf"shape \(2, {axes}\)"):
        envs.step(np.zeros(axes))


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"detector": "ewna"}, "valid: acna, .*; did you mean 'ewma'"),
        (
            {"detector": {"name": "windowed-chi2", "window": 5000}},
            "WindowedChi2 can't alarm in its first 4999 epochs, and an episode has 60",
        ),
        (
            {"detector": {"name": "cusum", "bias_window_s": 220.0}},
            "Cusum can't alarm in its first 440 epochs",
        ),
        ({"watch": [{"name": "windowed-chi2", "window": 5000}]}, "can't alarm in its first"),
        ({"attack": "meaconner"}, "unknown attack .*did you mean 'meaconer'"),
        ({"receiver": {"tunes": "paper"}}, "no setting 'tunes'"),
        ({"timeline": {"warmup_s": 500.0}}, "lasts 418 s"),
        (
            {"timeline": {"warmup_s": 400.0}, "decision_interval_s": 5.0},
            r"takes 560.5 s .warm-up 400 s, .* 10 s, and one epoch of 0.5 s in reserve.",
        ),
        ({"attack": {"name": "per-channel", "channels": ["S05", "S05"]}}, "each satellite once"),
        ({"length_m": 0.0}, "`length_m` must be a number above 0, got 0.0"),
        ({"decision_interval_s": 3.0}, "attack window of 15 s must hold a whole number"),
        ({"attack": {"name": "per-channel", "channels": ["S99"]}}, "'S99' is not in view"),
        ({"autoreset_mode": "sometimes"}, "`autoreset_mode` must be .* got 'sometimes'"),
        ({"render_mode": "rgb_array"}, "nothing to render"),
    ],
)
def test_a_wrong_setting_says_what_is_valid(kwargs, message):
    with pytest.raises(ValueError, match=message):
        vector(2, **kwargs)


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"receivers": 4}, TypeError, "has no argument 'receivers'; valid: "),
        ({"knowledge": "omniscient"}, ValueError, "`knowledge` must be 'blind', .* got 'omn"),
        ({"target_heading_deg": np.inf}, ValueError, "`target_heading_deg` must be "),
        ({"alarm_price": -1.0}, ValueError, "`alarm_price` must be a number of at least 0, got -1"),
        ({"reward": ["retraction"] * 2}, ValueError, "two reward terms have the same name"),
        ({"between": "spline"}, ValueError, "between.*'spline'"),
        ({"target_heading_deg": "east"}, ValueError, "target_heading_deg.*'east'"),
        ({"timeline": {"attack_s": 0.0}}, ValueError, "`attack_s` must be "),
        ({"decision_interval_s": 0.25}, ValueError, "must be a multiple of the interval betwe"),
    ],
)
def test_a_wrong_setting_of_any_victim_says_what_is_valid(settings, error, message):
    for made in (victim, lambda kind, **given: victims(kind, 2, **given)):
        for kind in ("LooselyCoupled", "TightlyCoupled"):
            with pytest.raises(error, match=message):
                made(kind, **settings)


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
