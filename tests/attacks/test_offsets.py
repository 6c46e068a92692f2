"""What attacks make of commands and measurements: closed forms, names and settings."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofgym.attacks import AttackContext, FalsePosition, Meaconer, PerChannel, make_attack
from spoofgym.attacks._kernels import kinematic_step
from spoofgym.earth.wgs84 import ecef_to_geodetic
from spoofgym.receiver._kernels import first_fix
from spoofgym.truth.scenario import Scenario

from .support import ONSET, WORLD, begin, check_displaced, offsets


@pytest.mark.parametrize("start", [ONSET, ONSET + 400])
def test_a_false_position_has_the_ranges_of_a_displaced_antenna(start):
    attack = FalsePosition(axes="ned", control="rate", rate_limit_mps=10.0)
    actions = np.repeat([[0.6, 0.0, 0.0], [0.0, -0.5, 0.8]], 5, axis=0)
    ranges, rates = offsets(attack, actions, onset=start)
    displacement = np.zeros(3)
    for k, action in enumerate(actions):
        now, rate = start + k + 1, 10.0 * action
        displacement = displacement + 0.5 * rate
        shift, turning = WORLD.C_en[now] @ displacement, WORLD.axes_turning[now] @ displacement
        speed = WORLD.C_en[now] @ rate + turning
        check_displaced(WORLD, now, ranges[k, 0], rates[k, 0], shift, speed)
        assert not ranges[k, 0, ~WORLD.visible[now]].any()
        assert not rates[k, 0, ~WORLD.visible[now]].any()


def test_over_half_an_hour_the_counterfeit_keeps_its_height_and_its_bearing():
    """The axes follow the target: 20 m/s to the east in a flight of 360 km.

    In the axes of the onset the counterfeit would come to fly a kilometre too high.
    """
    world = Scenario(flight="airway").world()
    attack = FalsePosition(axes="e", control="rate", rate_limit_mps=20.0)
    ranges, rates = offsets(attack, [(1.0,)] * 3600, world=world)[:, :, 0]
    r, k = world.position_e, ONSET + 3600
    measured = np.where(world.visible[k], world.satellites[k, :, 6] + ranges[-1], 0.0)
    measured = np.stack([measured, world.satellites[k, :, 7] + rates[-1]])[None]
    fix, speed, clock = np.empty((1, 3)), np.empty((1, 3)), np.empty((1, 2))
    first_fix(measured, world.satellites, np.array([k]), r[k : k + 1], fix, speed, clock)
    apart = (fix[0] - r[k]) @ world.C_en[k]
    np.testing.assert_allclose(apart, [0.0, 36_000.0, 0.0], atol=1e-3)
    height = ecef_to_geodetic(fix[0])[2] - ecef_to_geodetic(r[k])[2]
    assert height == pytest.approx(36_000.0**2 / (2.0 * 6.38e6), rel=0.02)  # of a straight line
    fixed = r[k] + world.C_en[ONSET] @ [0.0, 36_000.0, 0.0]
    assert abs(ecef_to_geodetic(fixed)[2] - ecef_to_geodetic(fix[0])[2]) > 500.0
    # range rates are the derivatives of the ranges all the way
    seen = world.visible[ONSET + 1 : k + 1].all(axis=0)
    total = 0.25 * (rates[1:] + rates[:-1]).sum(axis=0)
    np.testing.assert_allclose(total[seen], (ranges[-1] - ranges[0])[seen], rtol=0, atol=0.5)


def test_a_channel_is_offset_by_what_it_was_commanded():
    attack = PerChannel(channels=("S11", "S05"), acceleration_limit_mps2=0.2)
    names = attack.action_names(WORLD)
    assert names == ("S05_acceleration", "S11_acceleration")  # in the order of the slots
    slots = [WORLD.satellite_ids.index(name) for name in ("S05", "S11")]
    ranges, rates = offsets(attack, [(1.0, -0.5)] * 20)[:, :, 0]
    t = 0.5 * np.arange(1.0, 21.0)[:, None]
    np.testing.assert_allclose(ranges[:, slots], t**2 * [0.1, -0.05], rtol=1e-12)
    np.testing.assert_allclose(rates[:, slots], t * [0.2, -0.1], rtol=1e-12)
    for each in (ranges, rates):
        assert not np.delete(each, slots, axis=1).any()


@pytest.mark.parametrize("follows", [True, False])
def test_ranges_of_a_meaconer_are_those_of_its_antenna_and_a_delay(follows):
    away = np.array([40.0, 30.0, 0.0])
    attack = Meaconer(antenna_m=tuple(away), follows=follows, control="rate")
    ranges, rates = offsets(attack, [(0.4,)] * 6)
    k = ONSET + 6
    shift, speed = WORLD.C_en[k] @ away, WORLD.axes_turning[k] @ away
    if not follows:
        there = WORLD.position_e[ONSET] + WORLD.C_en[ONSET] @ away
        shift, speed = there - WORLD.position_e[k], -WORLD.velocity_e[k]
    way = np.linalg.norm(shift)
    change = 2.0 + shift @ speed / way
    check_displaced(WORLD, k, ranges[-1, 0], rates[-1, 0], shift, speed, way + 6.0, change)


@pytest.mark.parametrize("control", ["acceleration", "rate"])
def test_a_delay_comes_to_rest_at_zero_within_its_limits(control):
    attack = Meaconer(control=control, acceleration_limit_mps2=0.5, rate_limit_mps=3.0)
    begin(attack, WORLD)
    rng, unused = np.random.default_rng(2), np.empty((2, 1, WORLD.channels))
    pushes = np.concatenate([np.ones(12), -np.ones(60), rng.uniform(-1.0, 1.0, 200)])
    rate, largest = 0.0, 0.0
    for number, push in enumerate(pushes):
        action = None if number % 7 == 6 else np.array([[push]])
        attack.command(action, np.array([ONSET + number]), *unused, 0, 1)
        delay, new = attack.memory["displacement"][0, 0], attack.memory["rate"][0, 0]
        assert delay >= 0.0
        assert abs(new) <= 3.0 + 1e-12
        assert control == "rate" or abs(new - rate) <= 0.25 + 1e-12
        rate, largest = new, max(largest, delay)
        assert number != 71 or delay < 0.01
    assert largest > 4.0


@pytest.mark.parametrize(
    ("attack", "label"),
    [
        (FalsePosition(), "false-position"),
        (PerChannel(channels=("S05",), coherent=False), "per-channel-partial-pseudorange-only"),
        (FalsePosition(errors="quiet"), "false-position-quiet"),
        (FalsePosition(errors={"blend_s": 5.0}), "false-position-replaced"),
        (PerChannel(tracking={}, channels="S*"), "per-channel-partial-tracking"),
        (Meaconer(spoofer_clock={}, capture={}), "meaconer-clock-capture"),
    ],
)
def test_labels_tell_the_threat(attack, label):
    assert attack.label == label


def refused(kind, said, **settings):
    return pytest.param(kind, settings, said, id=said)


@pytest.mark.parametrize(
    ("kind", "settings", "said"),
    [
        refused(PerChannel, "`channels` must be 'all' or .*satellite ids", channels="S05"),
        refused(PerChannel, "must name each satellite once", channels=("S05", "S05")),
        refused(PerChannel, "'S31' is not in view .*: S05, S06", channels=["S05", "S31"]),
        refused(FalsePosition, "`axes` must be .* got 'neu'", axes="neu"),
        refused(FalsePosition, "each at most once, got 'nn'", axes="nn"),
        refused(FalsePosition, "three finite numbers: .*2.0", tracking={"bias_m": [1.0, 2.0]}),
        refused(FalsePosition, "receiver's own noise", errors={"blend_s": 3.0, "code_sd_m": 0.5}),
        refused(Meaconer, "since a meaconer needs no position", tracking={"sd_m": 1.0}),
        refused(Meaconer, "`antenna_m` must be three finite numbers", antenna_m=(0.0, 1.0)),
    ],
)
def test_what_is_no_attack_is_refused(kind, settings, said):
    with pytest.raises((ValueError, TypeError), match=said):
        kind(**settings).bind(AttackContext(1, WORLD))


def test_attacks_by_name_and_names_of_the_actions():
    assert make_attack("false-position") == FalsePosition()
    assert make_attack({"name": "per-channel", "channels": ["S05"]}).channels == ("S05",)
    mine = PerChannel()
    assert make_attack(mine) == mine
    assert make_attack(mine) is not mine
    by_rate = FalsePosition(axes="de", control="rate")
    assert FalsePosition().action_names(WORLD) == ("north_acceleration", "east_acceleration")
    assert by_rate.action_names(WORLD) == ("down_rate", "east_rate")
    assert Meaconer().action_names(WORLD) == ("delay_acceleration",)
    assert len(PerChannel().action_names(WORLD)) == sum(map(bool, WORLD.satellite_ids))


SCALE, LIMIT = 0.7, 1.0


def plain(action, hold, tau, vector, by_rate, displacement, rate):
    if hold:
        return displacement + tau * rate, rate
    size = np.linalg.norm(action)
    u = action / size if vector and size > 1.0 else np.clip(action, -1.0, 1.0)
    if by_rate:
        new = SCALE * u
        return displacement + new * tau, new
    new = rate + SCALE * u * tau
    size = np.linalg.norm(new)
    if not vector:
        new = np.clip(new, -LIMIT, LIMIT)
    elif size > LIMIT:
        new = new * (LIMIT / size)
    return displacement + 0.5 * (rate + new) * tau, new


@pytest.mark.nojit
@pytest.mark.parametrize("hold", [False, True])
@given(
    st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=4),
    st.booleans(),
    st.booleans(),
    st.floats(0.01, 2.0),
    st.integers(0, 1000),
)
def test_a_step_is_that_of_its_definition(hold, action, vector, by_rate, tau, seed):
    rng, action = np.random.default_rng(seed), np.array(action)
    at = rng.normal(0.0, 10.0, len(action)), rng.normal(0.0, 0.5, len(action))
    want = plain(action, hold, tau, vector, by_rate, *at)
    kinematic_step(action, hold, tau, vector, by_rate, SCALE, LIMIT, *at)
    np.testing.assert_allclose(at, want, rtol=1e-12, atol=1e-12)
