"""What is refused, and what is said of it: settings of an environment and of its resets."""

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.envs.terms.observation import Time
from spoofgym.envs.terms.reward import AlarmPenalty

from .support import VICTIMS, single, vector, victim, victims

TIGHT, LOOSE, SNAPSHOT, ROBOT = VICTIMS
LONG = {"name": "windowed-chi2", "window": 5000}
GRADES = {"receiver": {"grade": "tactical"}, "domain": {"imu": ["consumer"]}}
LIMITS = {"action": "along-target", "rate_limit_mps": [5.0, 2.0, 5.0, 5.0]}
NO_FILTER = (
    "the divergence of an attack needs the filter of a tightly coupled receiver, which a .* d"
)


@pytest.mark.parametrize(
    ("kind", "kwargs", "message"),
    [
        # of any victim
        (TIGHT, {"receivers": 4}, "got an unexpected keyword argument 'receivers'; valid: "),
        (TIGHT, {"knowledge": "orakel"}, "`knowledge` must be 'blind', .* did you mean 'oracle'"),
        (ROBOT, {"target_heading_deg": np.inf}, "`target_heading_deg` must be "),
        (LOOSE, {"target_heading_deg": "east"}, "target_heading_deg.*'east'"),
        (SNAPSHOT, {"alarm_price": -1.0}, "`alarm_price` must be a number of at least 0, got -1"),
        (TIGHT, {"length_m": 0.0}, "`length_m` must be a number above 0, got 0.0"),
        (TIGHT, {"length_m": "long"}, "`length_m` must be a number above 0, got 'long'"),
        (TIGHT, {"timeline": {"warmup_s": 500.0}}, "lasts 418 s"),
        (LOOSE, {"decision_interval_s": 0.25}, "a multiple of the interval between epochs, 0.1 s"),
        (TIGHT, {"decision_interval_s": 2.0}, "attack window of 15 s must hold a whole number"),
        (TIGHT, {"decision_interval_s": 1.5, "between": "spline"}, "between.*'spline'"),
        (TIGHT, {"between": "linear"}, "`between` 'linear' needs a `decision_interval_s`"),
        (TIGHT, {"twin": "no"}, "`twin` must be True or False, got 'no'"),
        (TIGHT, {"end_at_alarm": 1}, "`end_at_alarm` must be True or False, got 1"),
        # detectors, attacks, worlds
        (TIGHT, {"detector": "ewna"}, "valid: acna, .*; did you mean 'ewma'"),
        (TIGHT, {"detector": LONG}, "t alarm in its first 4999 epochs, and an episode has 60"),
        (TIGHT, {"watch": [LONG]}, "can't alarm in its first"),
        (TIGHT, {"watch": 3}, "`watch` must be a detector or a list of detectors, got 3"),
        (TIGHT, {"attack": "meaconner"}, "unknown attack .*did you mean 'meaconer'"),
        (TIGHT, {"attack": {"name": "per-channel", "channels": ["S99"]}}, "'S99' is not in view"),
        (TIGHT, GRADES, "`receiver` has the grade 'tactical', but"),
        # terms
        (TIGHT, {"observation": ["time", Time()]}, "two terms write the same"),
        (TIGHT, {"observation": [AlarmPenalty()]}, "it has no knowledge, names, bounds"),
        (TIGHT, {"end": {"name": "at-steps", "step": 3}}, "no setting 'step'; valid: steps"),
        (TIGHT, {"end": "at-displacement"}, "needs the setting 'limit_m'"),
        (TIGHT, {"end": {"limit_m": 5.0}}, "no `name`; `spoofgym.envs.terms.describe_terms`"),
        (ROBOT, {"end": ["at-alarm"] * 2}, "two end terms have the same name"),
        (TIGHT, {"end": "at-alarm", "end_at_alarm": False}, "`end` lists 'at-alarm', but"),
        (TIGHT, {"reward": ["retraction"] * 2}, "two reward terms have the same name"),
        (TIGHT, {"reward": [3]}, "a term of kind 'reward' is a name .*got 3"),
        (TIGHT, {"reward": AlarmPenalty}, "it is a class"),
        (TIGHT, {"reward": "alarm-penalty", "alarm_price": 5.0}, "`reward` is given"),
        (TIGHT, {"action": ["full-command"] * 2}, "two action terms have the same"),
        (TIGHT, {"action": []}, "an action needs at least one term"),
        (TIGHT, {"action": {"name": "channels", "ids": ["S99"]}}, "no channel 'S99' to command"),
        (ROBOT, {"action": {"name": "channels", "ids": ["clock"]}}, "valid: north, east"),
        (TIGHT, {"action": {"name": "channels", "ids": ["east"] * 2}}, "must be different"),
        (LOOSE, {"action": "common-offset"}, "per channel, 'per-channel', got 'loose'"),
        (SNAPSHOT, LIMITS, "needs the same limit north and east, got 5 and 2"),
        # what a victim does not have
        (SNAPSHOT, {"watch": ["never", "rio"]}, "Rio needs .*, which a snapshot receiver does"),
        (ROBOT, {"observation": "satellite-geometry"}, "a wheeled robot has no satellites"),
        (SNAPSHOT, {"end": {"name": "at-stealth-budget", "budget_nats": 2.0}}, NO_FILTER),
        (ROBOT, {"observation": ["time", "divergence-spent"]}, NO_FILTER),
    ],
)
def test_a_wrong_setting_says_what_is_valid(kind, kwargs, message):
    for make in (victim, lambda kind, **given: victims(kind, 2, **given)):
        with pytest.raises((ValueError, TypeError), match=message):
            make(kind, **kwargs)


@pytest.mark.parametrize(
    ("count", "kwargs", "message"),
    [
        (2, {"autoreset_mode": "sometimes"}, "`autoreset_mode` must be .* got 'sometimes'"),
        (2, {"render_mode": "rgb_array"}, r"nothing to render .* seed \+ i shows receiver"),
        (2, {"infos": ("alarms",)}, "unknown info 'alarms'; valid: alarm.*did you mean"),
        (2, {"infos": "some"}, "`infos` must be 'all' or 'none', got 'some'"),
        (1.5, {}, "`num_envs` must be a whole number of at least 1, got 1.5"),
    ],
)
def test_a_wrong_setting_of_a_vector_environment_says_what_is_valid(count, kwargs, message):
    with pytest.raises(ValueError, match=message):
        vector(count, **kwargs)


@pytest.mark.usefixtures("default_rate")
def test_who_can_not_judge_is_not_told_to_be_calibrated():
    for detector, message in (
        ({"name": "pool", "members": ["raim", "ewma"]}, "Raim measures satellites"),
        ({"name": "windowed-chi2", "window": 900}, "shorten its windows"),
    ):
        with pytest.raises(ValueError, match=message):
            gym.make("spoofgym/LooselyCoupled-v0", detector=detector)


@pytest.mark.parametrize(
    ("kind", "bad"),
    [*((k, [0.0, 1.5]) for k in VICTIMS), (ROBOT, [np.nan, 0.0]), (ROBOT, [-np.inf, 0.0])],
)
def test_a_bad_action_names_element_and_value(kind, bad):
    env, envs = victim(kind).unwrapped, victims(kind, 2)
    with pytest.raises(RuntimeError, match="no episode has started: call reset"):
        env.step(np.zeros(2))
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


def test_what_a_reset_does_not_take_is_told_by_its_name():
    env, envs = single(), vector(2)
    for made in (env, envs):
        with pytest.raises(TypeError, match=r"`options` of a reset must be a dict, got \['doma"):
            made.reset(options=["domain"])
        for seed in ("abc", 1.5, -1):
            with pytest.raises(ValueError, match=f"a seed must be a whole number.* got {seed!r}"):
                made.reset(seed=seed)
        with pytest.warns(UserWarning, match="no option 'speed'; valid: domain"):
            made.reset(seed=0, options={"speed": 2})
        made.reset(seed=0, options={})
    with pytest.raises(ValueError, match=r"must be a whole number of at least 0, got 0\.5"):
        envs.reset(seed=[1, 0.5])
    with pytest.raises(ValueError, match="must have 2 elements, got 3"):
        envs.reset(seed=[1, 2, 3])


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
    envs = victims(SNAPSHOT, 3, autoreset_mode="disabled")
    with pytest.raises(ValueError, match="first reset must be that of all"):
        envs.reset(options={"reset_mask": np.array([True, False, False])})
    envs.reset(seed=0)
    with pytest.raises(error, match=message):
        envs.reset(options={"reset_mask": mask})


def test_an_argument_that_a_library_tries_is_refused_in_python_s_own_words():
    """As TorchRL's `GymEnv`, which goes on without it."""
    with pytest.raises(TypeError, match="got an unexpected keyword argument 'frameskip'; valid: "):
        gym.make("spoofgym/Zhong2025-v0", frameskip=4)
