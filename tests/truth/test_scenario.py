"""Scenarios: names that are valid, names that are not, and worlds that are shared."""

from dataclasses import replace

import numpy as np
import pytest

from spoofgym.truth.gnss_errors import ERRORS
from spoofgym.truth.manoeuvres import FLIGHTS, car
from spoofgym.truth.satellites import CircularConstellation
from spoofgym.truth.scenario import SCENARIOS, Scenario, make_scenario
from spoofgym.truth.sensors import IMU_GRADES


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_says_what_it_is(name):
    scenario = SCENARIOS[name]()
    assert scenario.name == name
    assert scenario.imu in IMU_GRADES
    assert scenario.gnss_errors is ERRORS[scenario.errors]
    assert make_scenario(name) == scenario


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Scenario(flight="zhong2024"), "valid: .*did you mean 'zhong2025'"),
        (lambda: Scenario(errors="none"), "unknown errors 'none'; valid: .*groves, ke2022"),
    ],
)
def test_unknown_and_old_names_are_told_with_the_valid_ones(make, said):
    with pytest.raises(ValueError, match=said):
        make()


def test_settings_reach_the_world_and_that_of_a_named_flight_is_computed_once():
    scenario = Scenario(
        flight=car(),
        epoch_interval_s=2.0,
        channels=7,
        mask_deg=20.0,
        constellation=CircularConstellation(satellites=36),
        errors=replace(ERRORS["white"], code_sd_m=3.0),
    )
    world = scenario.world()
    assert (world.channels, world.epoch_time[1]) == (7, 2.0)
    assert world.elevation[world.visible].min() > np.radians(20.0)
    np.testing.assert_array_equal(world.run, replace(scenario, flight="car").world().run)
    assert scenario.gnss_errors is scenario.errors
    scenario = Scenario(flight="car", epoch_interval_s=1.0)
    assert scenario.world() is Scenario(flight="car", epoch_interval_s=1.0, errors="white").world()
    assert scenario.world() is not replace(scenario, epoch_interval_s=0.5).world()


@pytest.mark.parametrize("flight", sorted(FLIGHTS.keys() - {"en-route", "terminal"}))
def test_every_flight_has_a_world(flight):
    world = Scenario(flight=flight).world()
    assert (world.visible.sum(axis=1) >= 4).all()
