"""Record and replay: another antenna's ranges, and one delay."""

import numpy as np
import pytest

from spoofgym.attacks import Meaconer
from spoofgym.earth.wgs84 import range_and_rate
from spoofgym.truth.scenario import Scenario

from .support import ONSET, begin, offsets


@pytest.fixture(scope="module")
def world():
    return Scenario().world()


@pytest.mark.parametrize("follows", [True, False])
def test_ranges_are_those_of_the_meaconers_antenna(world, follows):
    attack = Meaconer(antenna_m=(40.0, 30.0, 0.0), follows=follows, control="rate")
    ranges, rates = offsets(attack, world, [(0.4,)] * 6)
    delay, k = 2.0 * 3.0, ONSET + 6
    antenna = world.C_en[k if follows else ONSET] @ [40.0, 30.0, 0.0]
    r, v = world.position_e[k], world.velocity_e[k]
    there = r + antenna if follows else world.position_e[ONSET] + antenna
    speed = v + world.axes_turning[k] @ [40.0, 30.0, 0.0] if follows else np.zeros(3)
    way = np.linalg.norm(there - r)
    closing = (there - r) @ (speed - v) / way
    for s in np.flatnonzero(world.visible[k]):
        p = world.satellites[k, s, :3], world.satellites[k, s, 3:6]
        other, own = range_and_rate(*p, there, speed), range_and_rate(*p, r, v)
        assert ranges[-1, 0, s] == pytest.approx(other[0] - own[0] + way + delay, abs=3e-8)
        assert rates[-1, 0, s] == pytest.approx(other[1] - own[1] + closing + 2.0, abs=1e-9)


def test_one_delay_is_common_to_all_channels(world):
    ranges, rates = offsets(Meaconer(), world, [(1.0,)] * 10)
    seen = world.visible[ONSET + 10]
    np.testing.assert_allclose(ranges[-1, 0, seen], 0.5 * 0.05 * 5.0**2)
    np.testing.assert_allclose(rates[-1, 0, seen], 0.05 * 5.0)
    assert Meaconer().action_names(world) == ("delay_acceleration",)


@pytest.mark.parametrize("control", ["acceleration", "rate"])
def test_a_delay_comes_to_rest_at_zero_within_its_limits(world, control):
    attack = Meaconer(control=control, acceleration_limit_mps2=0.5, rate_limit_mps=3.0)
    begin(attack, world)
    rng, unused = np.random.default_rng(2), np.empty((2, 1, world.channels))
    pushes = np.concatenate([np.ones(12), -np.ones(60), rng.uniform(-1.0, 1.0, 200)])
    rate, largest = 0.0, 0.0
    for number, push in enumerate(pushes):
        hold = number % 7 == 6
        at = np.array([ONSET + number])
        attack.command(None if hold else np.array([[push]]), at, *unused, 0, 1)
        delay, new = attack.memory["displacement"][0, 0], attack.memory["rate"][0, 0]
        assert delay >= 0.0
        assert abs(new) <= 3.0 + 1e-12
        if control == "acceleration":
            assert abs(new - rate) <= 0.25 + 1e-12
        rate, largest = new, max(largest, delay)
        if number == 71:
            assert delay < 0.01
    assert largest > 4.0


def test_a_meaconer_needs_no_position():
    with pytest.raises(ValueError, match="`tracking` must be None, since a meaconer needs"):
        Meaconer(tracking={"sd_m": 1.0})
    with pytest.raises(ValueError, match="`antenna_m` must be three finite numbers"):
        Meaconer(antenna_m=(0.0, 1.0))
