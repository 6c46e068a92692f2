"""Scenarios: names that are valid, names that are not, and worlds that are shared."""

from dataclasses import replace

import numpy as np
import pytest

from spoofgym.simulation.domain import Domain
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
    ("settings", "said"),
    [
        ({"flight": "zhong2024"}, "unknown flight 'zhong2024'; valid: .*did you mean 'zhong2025'"),
        (
            {"errors": "none"},
            "unknown errors 'none'; valid: .*groves, ke2022, trolley, white, zhong2025",
        ),
        ({"imu": "Tactical"}, "unknown imu grade 'Tactical'; .* did you mean 'tactical'"),
    ],
)
def test_unknown_names_are_told_with_the_valid_ones(settings, said):
    with pytest.raises(ValueError, match=said):
        Scenario(**settings)


def test_an_old_name_is_told_with_the_new_one():
    with pytest.raises(ValueError, match=r"errors 'realistic' is now called 'trolley'$"):
        Scenario(errors="realistic")
    for end in ("", "-tactical", "-consumer", "-two-constellations"):
        said = rf"scenario 'realistic{end}' is now called 'trolley{end}'$"
        with pytest.raises(ValueError, match=said):
            make_scenario(f"realistic{end}")
    with pytest.raises(ValueError, match=r"errors 'realistic' is now called 'trolley'$"):
        Domain(errors=("realistic",))


def test_the_world_of_a_named_flight_is_computed_once():
    scenario = Scenario(flight="car", epoch_interval_s=1.0)
    assert scenario.world() is Scenario(flight="car", epoch_interval_s=1.0, errors="white").world()
    assert scenario.world() is not replace(scenario, epoch_interval_s=0.5).world()


def test_a_flight_by_name_and_as_an_object_is_the_same():
    named = Scenario(flight="car", epoch_interval_s=1.0).world()
    given = Scenario(flight=car(), epoch_interval_s=1.0).world()
    for name in ("run", "satellites", "visible", "position_e", "C_eb"):
        np.testing.assert_array_equal(getattr(named, name), getattr(given, name))
    assert named.satellite_ids == given.satellite_ids


def test_settings_reach_the_world():
    scenario = Scenario(
        flight="car",
        epoch_interval_s=2.0,
        channels=7,
        mask_deg=20.0,
        constellation=CircularConstellation(satellites=36),
    )
    world = scenario.world()
    assert world.channels == 7
    assert world.epoch_time[1] == 2.0
    assert world.elevation[world.visible].min() > np.radians(20.0)


@pytest.mark.parametrize("flight", FLIGHTS)
def test_every_flight_has_a_world(flight):
    world = Scenario(flight=flight).world()
    assert (world.visible.sum(axis=1) >= 4).all()


def test_errors_may_be_one_s_own():
    errors = replace(ERRORS["white"], code_sd_m=3.0)
    assert Scenario(errors=errors).gnss_errors is errors
