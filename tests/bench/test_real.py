"""Scenarios from a recorded flight and a navigation file."""

from datetime import date

import numpy as np
import pytest

from spoofgym.bench.experiments.suite import Suite
from spoofgym.data.recorded import real_scenario


@pytest.fixture(scope="module")
def files(data_folder):
    flight, broadcast = "adsb_flights/ajaccio.json.gz", "gnss_broadcast/brdc3050.12n"
    return data_folder / flight, data_folder / broadcast


@pytest.fixture(scope="module")
def real(files):
    return real_scenario(*files)


def test_ten_minutes_of_the_flight_under_the_satellites_of_the_day(real):
    world = real.scenario.world()
    assert world.epoch_time[-1] == pytest.approx(600.0)
    assert world.visible.sum(axis=1).min() >= 6
    assert set(world.satellite_ids) & {"G24", "G27"} == set()  # unhealthy all day
    # over Corsica and the sea around it
    sine = world.position_e[:, 2] / np.linalg.norm(world.position_e, axis=1)
    latitude = np.degrees(np.arcsin(sine))
    assert ((latitude > 40.0) & (latitude < 44.0)).all()
    radius = np.linalg.norm(world.satellites[0, world.visible[0], :3], axis=1)
    assert (np.abs(radius - 26.56e6) < 0.7e6).all()
    # all that was assumed is said
    text = "\n".join(real.lines)
    for part in (
        "1210 interpolated positions",
        "920 of them modulo 256",
        "the altitude (`altitude`, read in ft) is taken as height above the ellipsoid",
        "distance of the fixes: RMS",
        "26 marked unhealthy and not used",
        "mapped to another day: flown 2018-01-12 12:00:40 UTC, simulated 2012-10-31 12:00:40 UTC",
    ):
        assert part in text
    assert real.reports["time"]["mapped"]
    assert real.reports["ephemeris"]["records"] == 423


def test_the_digest_follows_the_files_and_another_day_can_be_asked_for(files, real):
    other = real_scenario(*files, duration_s=400.0)
    digests = {Suite(scenario=each.scenario, notes=each.lines).digest for each in (real, other)}
    assert len(digests) == 2
    with pytest.raises(ValueError, match="`start` must be within 2 h of a healthy record"):
        real_scenario(*files, day=date(2018, 1, 12), duration_s=120.0)
