"""Spoofers that follow the target direction that they observe."""

import gymnasium as gym
import numpy as np
import pytest

from spoofgym import duel_v0
from spoofgym.envs import attach
from spoofgym.spoofers import SpooferContext, make_spoofer
from spoofgym.spoofers.base import TARGET_NAMES

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 30.0, "time_to_alert_s": 2.0}
STRONG = {"name": "false-position", "acceleration_limit_mps2": 1.0}
WORLD = {"timeline": SHORT, "attack": STRONG, "detector": "never", "action": "full-command"}
DRAWN = {"domain": {"start_s": [0.0, None]}, "target_heading_deg": "random"}
FOLLOWING = {"name": "ramp", "rate_mps": 2.0, "heading_deg": "target"}
SCRIPTED = [
    FOLLOWING,
    {"name": "step", "size_m": 30.0, "heading_deg": "target"},
    {"name": "intermittent", "shapes": ["step"], "heading_deg": "target"},
    {"name": "profile", "cross_rates_mps": [0.0, 1.0], "heading_deg": "target"},
]
HEADINGS = np.array([0.0, 90.0, 312.0])


def context(control, axes, *seen):
    names = tuple(f"{axis}_{control}" for axis in axes)
    return SpooferContext(3, 0.5, 300, control, 0.05, 5.0, names, seen)


@pytest.mark.parametrize(
    ("control", "axes"), [("rate", ("north", "east")), ("acceleration", ("east", "down", "north"))]
)
@pytest.mark.parametrize("spec", SCRIPTED, ids=lambda spec: spec["name"])
def test_each_receiver_is_pushed_as_along_its_own_heading(spec, control, axes):
    told = context(control, axes, "time", *TARGET_NAMES)
    following = make_spoofer(spec)
    following.bind(told)
    radians = np.radians(HEADINGS)
    seen = np.stack([np.ones(3), np.cos(radians), np.sin(radians)], axis=1).astype(np.float32)
    fixed = [make_spoofer({**spec, "heading_deg": heading}) for heading in HEADINGS.tolist()]
    for one in fixed:
        one.bind(told)
    for _ in range(60):
        action = following.act(seen)
        assert action.shape == (3, len(axes))
        assert action.flags["C_CONTIGUOUS"]
        assert np.abs(action).max() <= 1.0
        for i, one in enumerate(fixed):
            np.testing.assert_allclose(action[i], one.act(seen)[i], atol=2e-7)


def test_where_a_target_cannot_be_followed():
    for axes, seen, message in (
        (("north", "east"), (), "needs target_direction_north and target_direction_east among"),
        (("east",), TARGET_NAMES, "'target' needs a command to the north, but the attack"),
    ):
        with pytest.raises(ValueError, match=message):
            make_spoofer(FOLLOWING).bind(context("rate", axes, *seen))
    spoofer, action = make_spoofer(FOLLOWING), []
    spoofer.bind(context("rate", ("north", "east"), *TARGET_NAMES))
    shown = np.array([[1.0, 0.0], [0.2, -0.1], [0.0, 1.0]], dtype=np.float32)
    with pytest.raises(ValueError, match=r"receiver 1 observes, \(0.2, -0.1\), has not the length"):
        spoofer.act(shown)
    for heading in ("target", 90.0):  # of an attack on channels, which has none
        spoofer = make_spoofer({**FOLLOWING, "heading_deg": heading})
        spoofer.bind(context("rate", ("G01", "G02")))
        action.append(spoofer.act(np.zeros((3, 0), dtype=np.float32)))
    np.testing.assert_array_equal(*action)


@pytest.mark.parametrize(
    "action", ["full-command", {"name": "rate-setpoint", "full_scale_mps": 2.0}]
)
def test_a_target_that_is_drawn_is_reached(action):
    envs = gym.make_vec("spoofgym/Zhong2025-v0", num_envs=6, **{**WORLD, **DRAWN, "action": action})
    spoofer = attach(FOLLOWING, envs)
    observation, _ = envs.reset(seed=4)
    for _ in range(60):
        observation, _, over, _, info = envs.step(spoofer.act(observation))
    assert over.all()
    # a constant rate of 2 m/s, reached after 2 s, pulls the filter along
    assert (info["undetected_displacement_m"] > 10.0).all()


def test_a_fixed_heading_is_warned_of_once():
    envs = gym.make_vec("spoofgym/Zhong2025-v0", num_envs=2, **WORLD, **DRAWN)
    ramp = {"name": "ramp", "rate_mps": 2.0}
    with pytest.warns(UserWarning, match=r"Ramp \(heading_deg=90\); with heading_deg='target'"):
        attach(ramp, envs)
    attach("none", envs)
    envs.close()
    drawn = {"scenario": "trolley", "timeline": SHORT, "target_heading_deg": "random"}
    pool = [ramp, "none", {"name": "step", "heading_deg": 10.0}, FOLLOWING]
    with pytest.warns(UserWarning, match=r"heading: Ramp \(.*=90\), Step \(.*=10\); with") as told:
        duel_v0.DetectorView(pool, **drawn)
    assert len(told) == 1
    duel_v0.DetectorView(["none", FOLLOWING], **drawn)
    duel_v0.DetectorView(ramp, **drawn, attack="per-channel")
    with pytest.raises(ValueError, match="'target' needs target_direction_north"):
        duel_v0.DetectorView(FOLLOWING, scenario="trolley", timeline=SHORT)
