"""The rate set-point: the acceleration follows the wanted rate, within the attack's limits."""

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.envs import SpoofCore, attach
from spoofgym.envs.terms.action import CommandMap, default_action
from spoofgym.simulation import TightlyCoupledSetup

from ..support import ID, SHORT

ATTACK = {"name": "false-position", "acceleration_limit_mps2": 0.2, "rate_limit_mps": 0.5}
STEP = 0.2 * 0.5
"""Largest change of the rate in an epoch [m/s]."""
WORLD = ("target_heading_deg", "decision_interval_s")


def core_of(receivers=1, **settings):
    attack = settings.pop("attack", ATTACK)
    world = {name: settings.pop(name) for name in WORLD if name in settings}
    setup = TightlyCoupledSetup(timeline=SHORT, attack=attack, detector="never", **world)
    core = SpoofCore(receivers, setup, end_at_alarm=False, **settings)
    core.reset([np.random.default_rng(i) for i in range(receivers)])
    return core


def rates_of(core, actions):
    """(K, B, a) rates after each of the actions."""
    seen = []
    for action in actions:
        core.step(np.broadcast_to(np.asarray(action, dtype=float), (core.receivers, len(action))))
        seen.append(core.engine.simulator.commanded_rate.copy())
    return np.array(seen)


def test_the_default_is_along_the_target():
    core = core_of()
    assert core.action_names == ("along_target_setpoint",)
    assert core_of(target_heading_deg="worst").action_names == ("north_setpoint", "east_setpoint")
    channels = TightlyCoupledSetup(timeline=SHORT, attack="per-channel", detector="never")
    assert not CommandMap(default_action(channels), channels).setpoint_mps


def test_a_rate_is_reached_at_the_largest_acceleration_and_stays_within_the_limit():
    action = {"name": "rate-setpoint", "full_scale_mps": 0.5}
    rate = rates_of(core_of(action=action), [[0.5]] * 6)[:, 0, 1]
    np.testing.assert_allclose(rate, [0.1, 0.2, 0.25, 0.25, 0.25, 0.25], atol=1e-15)
    assert rate[3] == rate[4] == rate[5]
    core = core_of(decision_interval_s=2.5)
    core.step(np.array([[0.25]]))  # and follows in every epoch of a decision
    assert core.engine.simulator.commanded_rate[0, 1] == pytest.approx(0.25, abs=1e-15)
    core = core_of()
    up = rates_of(core, [[1.0]] * 8)[:, 0, 1]
    np.testing.assert_allclose(up, [0.1, 0.2, 0.3, 0.4, 0.5, 0.5, 0.5, 0.5], atol=1e-14)
    down = rates_of(core, [[-1.0]] * 3)[:, 0, 1]
    np.testing.assert_allclose(down, [0.4, 0.3, 0.2], atol=1e-14)


def test_in_two_dimensions_the_change_is_limited_as_a_vector():
    core = core_of(action={"name": "rate-setpoint", "dimensions": 2})
    rate = rates_of(core, [[0.3, 0.4]] * 8)[:, 0]
    change = np.diff(np.vstack([np.zeros(2), rate]), axis=0)
    assert np.hypot(*change.T).max() <= STEP * (1.0 + 1e-12)
    np.testing.assert_allclose(rate[-1], [0.3, 0.4], atol=1e-15)
    np.testing.assert_allclose(rate[0], STEP * np.array([0.6, 0.8]), atol=1e-15)


def test_an_attack_by_rate_takes_it_at_once():
    core = core_of(attack={"name": "false-position", "control": "rate", "rate_limit_mps": 2.0})
    np.testing.assert_allclose(rates_of(core, [[0.7], [-0.4]])[:, 0, 1], [0.7, -0.4], atol=1e-15)


def test_the_own_command_is_observed_along_the_target():
    core = core_of(target_heading_deg=30.0)
    rates_of(core, [[0.3]] * 5)
    moved = np.hypot(*core.engine.simulator.commanded_displacement[0])
    speed = np.hypot(*core.engine.simulator.commanded_rate[0])
    seen = dict(zip(core.observation_names, core.observe()[0].tolist(), strict=True))
    scale = core.setup.scales["length_m"]
    assert seen["own_displacement_along_target"] == pytest.approx(moved / scale, rel=1e-6)
    assert seen["own_rate_along_target"] == pytest.approx(speed / core.setup.rate_scale_mps)


@pytest.mark.parametrize(
    "spec",
    [{"name": "ramp", "rate_mps": 0.3}, {"name": "accelerating-ramp", "acceleration_mps2": 0.04}],
)
def test_a_scripted_spoofer_does_the_same_by_any_action(spec):
    flown = []
    for action in ("full-command", None, {"name": "rate-setpoint", "dimensions": 2}):
        env = gym.make(ID, timeline=SHORT, attack=ATTACK, detector="never", action=action)
        spoofer = attach(spec, env)
        seen, _ = env.reset(seed=1)
        over = False
        while not over:
            seen, _, over, _, _ = env.step(spoofer.act(seen[None])[0])
        flown.append(env.unwrapped.core.engine.simulator.commanded_displacement[0, 1])
        assert spoofer.memory["rate"][0] == pytest.approx(
            env.unwrapped.core.engine.simulator.commanded_rate[0, 1], abs=1e-12
        )
    np.testing.assert_allclose(flown, flown[0], rtol=1e-12)


def test_it_stands_alone_and_says_what_is_wrong():
    by_rate = {"name": "false-position", "control": "rate", "rate_limit_mps": 2.0}
    env = gym.make(ID, timeline=SHORT, detector="never", target_heading_deg=0.0)
    attach({"name": "ramp", "heading_deg": "target"}, env)
    fast = {"name": "ramp", "heading_deg": 0.0, "rate_mps": 3.0}
    full = {"name": "rate-setpoint", "full_scale_mps": 5.0}
    for wrong, message in (
        (lambda: core_of(action=["rate-setpoint", "across-target"]), "set-point commands everyt"),
        (lambda: core_of(attack="per-channel", action="rate-setpoint"), "has no axis 'north'"),
        (lambda: core_of(attack=by_rate, action=full), "must be at most .* 2, got 5"),
        (lambda: attach("ramp", env), "`heading_deg` = 90, but .* which is 0: give it"),
        (lambda: attach(fast, env), "more than the attack allows: `full_scale_mps` of"),
    ):
        with pytest.raises(ValueError, match=message):
            wrong()
