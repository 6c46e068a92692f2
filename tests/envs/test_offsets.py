"""``control=``, ``basis=`` and ``channels=``: one action a satellite slot, or one an axis."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.attacks import FalsePosition
from spoofgym.envs import attach, offsets_action
from spoofgym.simulation import TightlyCoupledSetup

PLAIN = "spoofgym/Zhong2025-v0"
TIMES = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 40.0, "time_to_alert_s": 5.0}
QUIET = {"timeline": TIMES, "detector": "never"}
OFFSETS = {
    **{"control": "rate", "basis": "satellites"},
    **{"decision_interval_s": 10.0, "between": "linear"},
}
"""What `spoofgym/Offsets-v0` has, here in a smaller world."""
SKIES = {"start_s": [0.0, 60.0], "turned_deg": [0.0, 360.0], "worlds": 2}
LIMITS = {"name": "offsets", "acceleration_limit_mps2": 1e3}


def make(**settings):
    return gym.make(PLAIN, **{**QUIET, **OFFSETS, **settings})


def fly(env, actions, seed=3):
    """Displacement [m] and offsets [m] after each of some decisions."""
    env.reset(seed=seed)
    infos = [env.step(action)[4] for action in actions]
    return [np.array([info[name] for info in infos]) for name in ("displacement_m", "offsets_m")]


def test_the_id_decides_every_10_s_by_rates_of_satellites():
    own, default = (
        gym.spec(f"spoofgym/{name}-v0").kwargs for name in ("Offsets", "TightlyCoupled")
    )
    assert own == {**default, **OFFSETS}
    env = make().unwrapped
    assert env.action_names == tuple(f"slot{s:02d}_rate" for s in range(8))
    assert env.core.episode_steps == 4
    attack = env.core.setup.attack
    assert (attack.control, attack.basis, env.core.setup.between) == (
        "rate",
        "satellites",
        "linear",
    )
    assert attack.rate_limit_mps == FalsePosition().rate_limit_mps
    env.reset(seed=1)
    seen, _, _, _, info = env.step([0.1] * 8)
    # linear between decisions: the mean rate is half of it, but for one epoch
    np.testing.assert_allclose(info["offsets_m"], 0.1 * 10.0 * 10.5 / 20.0, rtol=1e-9)
    named = dict(zip(env.observation_names, seen.tolist(), strict=True))
    assert named["own_offset_slot00"] == pytest.approx(info["offsets_m"][0] / 150.0)
    assert named["own_rate_slot00"] == pytest.approx(0.1)


@pytest.mark.parametrize("control", ["rate", "offset"])
@pytest.mark.parametrize("basis", ["satellites", "position+clock", "rotated"])
def test_a_scripted_ramp_is_that_of_the_false_position_in_every_basis(basis, control):
    pace = {"decision_interval_s": 0.5, "between": "hold"}
    by_rate = {"name": "false-position", "control": "rate", "rate_limit_mps": 1.0}
    truth = gym.make(PLAIN, attack=by_rate, action="full-command", **QUIET)
    truth.reset(seed=3)
    sensors = truth.unwrapped.core.engine.simulator.sensors
    wanted, exact = [], []
    for _ in range(79):  # the last would run the time to alert, too
        exact.append(truth.step(np.array([0.0, 1.0]))[4]["displacement_m"])
        wanted.append(sensors.range_offset[0].copy())
    env = make(attack=LIMITS, control=control, basis=basis, channels="all", **pace)
    env.reset(seed=3)
    found = []
    for k, offsets in enumerate(wanted):
        request = {"east": 0.5 * (k + 1) if control == "offset" else 1.0}
        if basis == "satellites":
            before = wanted[k - 1] if k else 0.0 * offsets
            request = (offsets if control == "offset" else (offsets - before) / 0.5)[:8]
        info = env.step(offsets_action(env, request))[4]
        np.testing.assert_allclose(info["offsets_m"], offsets[:8], atol=1e-6)
        found.append(info["displacement_m"])
    assert abs(exact[-1]) > 10.0
    np.testing.assert_allclose(found, exact, atol=0.01)


def test_a_scripted_spoofer_pushes_along_its_heading_with_some_satellites_left_alone():
    for basis in ("position+clock", "rotated"):
        env = make(basis=basis, channels="7 of 8", decision_interval_s=0.5, between="hold")
        spoofer = attach({"name": "ramp", "rate_mps": 0.3, "heading_deg": 90.0}, env)
        seen, _ = env.reset(seed=1)
        for _ in range(60):
            seen, *_, info = env.step(spoofer.act(seen[None])[0])
        simulator = env.unwrapped.core.engine.simulator
        np.testing.assert_allclose(simulator.commanded_rate[0, :2], [0.0, 0.3], atol=1e-12)
        assert not simulator.commanded_rate[0, 2:].any()
        assert np.count_nonzero(simulator.sensors.range_offset[0]) == 7
        assert info["offsets_m"].shape == (7,)
    env = make(basis="rotated", action="along-target")
    assert env.unwrapped.action_names == ("along_target_rate",)


def test_where_skies_differ_masks_and_captured_channels_are_observed():
    settings = {"scenario": "trolley", "domain": SKIES, "channels": "5 drawn", **QUIET}
    envs = gym.make_vec(PLAIN, num_envs=4, **{**OFFSETS, **settings})
    seen, info = envs.reset(seed=2)
    names = envs.unwrapped.observation_names
    masks = seen[:, [names.index(f"counts_slot{s:02d}") for s in range(5)]]
    taken = seen[:, [names.index(f"captured_slot{s:02d}") for s in range(12)]]
    np.testing.assert_array_equal(masks, info["action_mask"])
    assert (taken.sum(axis=1) == 5).all()
    assert len(np.unique(taken, axis=0)) > 1
    assert info["offsets_m"].shape == (4, 5)
    seen, *_, info = envs.step(np.full((4, 5), 0.2, dtype=np.float32))
    assert info["_offsets_m"].all()
    np.testing.assert_array_equal(info["offsets_m"] != 0.0, masks > 0.0)


def test_other_attacks_and_channels_of_any_attack():
    setup = TightlyCoupledSetup(attack="tracking-1m", control="offset", basis="rotated")
    assert (setup.attack.kind, setup.attack.control) == ("offsets", "offset")
    assert setup.attack.tracking is not None
    some = TightlyCoupledSetup(channels=["S05", "S11"])
    assert some.attack.label == "false-position-partial"
    plain = TightlyCoupledSetup()
    assert plain.attack == FalsePosition()
    assert setup.conditions.settings == plain.conditions.settings  # no clean run depends on it


@pytest.mark.parametrize(
    ("control", "wanted", "said"),
    [
        ("offset", {"S05": 200.0}, "'slot00_offset' of receiver 0 .* from -150 to 150 m, got 200"),
        ("offset", {"S05": np.nan}, "'slot00_offset' of receiver 0 must be a number .* got nan"),
        ("rate", {"S05": 2.0}, "'slot00_rate' of receiver 0 .* from -1 to 1 m/s, got 2"),
        ("offset", {"S06": 1.0}, "'S06' is not captured in receiver 0; captured: S05, S11"),
        ("offset", {"S99": 1.0}, "no axis or satellite 'S99'; valid: S05, S11, slot00, slot01"),
        ("offset", [1.0, 2.0, 3.0], r"shape \(2,\) or \(1, 2\), one for each of slot00_offset"),
    ],
)
def test_metres_that_can_not_be_requested_are_named(control, wanted, said):
    env = make(control=control, channels=["S05", "S11"])
    env.reset(seed=1)
    with pytest.raises(ValueError, match=said):
        offsets_action(env, wanted)


def test_a_satellite_that_is_not_in_view_takes_no_offset():
    env = make(control="offset", channels=["S05", "S11"])
    env.reset(seed=1)
    core = env.unwrapped.core
    world, epoch = core.setup.world, core.engine.simulator.epochs[0]
    visible = world.visible.copy()
    visible[epoch, world.satellite_ids.index("S11")] = False
    core.setup.world = replace(world, visible=visible)
    with pytest.raises(ValueError, match="'S11' is not in view of receiver 0; in view: S05"):
        offsets_action(env, {"S11": 1.0})


def test_settings_and_actions_that_do_not_fit_are_named():
    env = make(control="offset")
    env.reset(seed=1)
    for action, said in (
        (np.full(8, 1.5), r"'slot00_offset' is 1.5; `spoofgym.envs.offsets_action` makes actions"),
        (np.full(8, np.nan), "'slot00_offset' is nan"),
        (np.zeros(5), r"shape \(8,\) \(slot00_offset, .* got \(5,\)"),
    ):
        with pytest.raises(ValueError, match=said):
            env.step(action)
    steady = {"decision_interval_s": 0.5, "between": "hold"}
    ramp = {"name": "ramp", "rate_mps": 0.1}
    for act, said in (
        (lambda: make(channels="1 of 8"), "capture at least 2 satellites, got '1 of 8'"),
        (lambda: make(channels="5 of 9"), "'5 of 9' does not fit .* '5 of 8'"),
        (lambda: make(attack="meaconer"), "offsets single satellites, got 'meaconer'"),
        (lambda: make(basis="east"), "`basis` must be 'satellites', 'position.clock' or 'rotated'"),
        (lambda: make(action="rate-setpoint"), "follows wanted rates itself"),
        (lambda: gym.make(PLAIN, observation="own-offsets"), "need the attack 'offsets'"),
        (lambda: gym.make("spoofgym/Snapshot-v0", basis="rotated"), "'basis'"),
        (lambda: attach(ramp, make(**steady)), "needs the `basis` 'position.clock' or 'rotated'"),
        (lambda: attach(ramp, make(control="offset", **steady)), "needs `control` 'rate'"),
        (lambda: offsets_action(gym.make(PLAIN), {"east": 1.0}), "an environment with `control`"),
    ):
        with pytest.raises((ValueError, TypeError), match=said):
            act()
