"""Worlds from recorded files: satellites that run out, several files, and what is said."""

from datetime import UTC, date, datetime, timedelta

import numpy as np
import pytest

from spoofgym.data.recorded import ONLY_TRAJECTORY, ephemeris_day, real_scenario
from spoofgym.truth.manoeuvres import Straight, Turn, fly

from ..truth.records import SATURDAY_22, one_record
from .files import make_orbits, make_table, write_orbits

pytest.importorskip("pandas")
DAY = datetime(2024, 9, 14)


@pytest.fixture(scope="module")
def flight():
    legs = [Straight(100.0), Turn(200.0, bank_deg=20.0), Straight(400.0)]
    place = {"latitude_deg": 46.0, "longitude_deg": 8.0, "height_m": 2000.0}
    return fly(legs, **place, speed_mps=100.0, heading_deg=10.0, rate_hz=10.0)


@pytest.fixture(scope="module")
def days(tmp_path_factory):
    """Navigation files of two days, by the hour at which their records begin and end."""
    folder = tmp_path_factory.mktemp("days")

    def write(first, last, take=slice(None)):
        orbits = make_orbits(DAY, DAY + timedelta(hours=30))
        hour = (orbits.time_of_ephemeris - orbits.time_of_ephemeris.min()) / 3600.0
        inside = np.flatnonzero((hour >= first) & (hour <= last))[take]
        return write_orbits(folder / f"{first}_{last}.rnx", orbits.take(inside))

    return write


@pytest.fixture
def fly_at(tmp_path, flight):
    """The scenario of the flight that begins at an hour of the day."""

    def begin(hour, *files, **settings):
        start = (DAY.replace(tzinfo=UTC) + timedelta(hours=hour)).timestamp()
        make_table(flight, start).to_csv(tmp_path / "flown.csv", index=False)
        return real_scenario(tmp_path / "flown.csv", files, **settings)

    return begin


def test_satellites_that_run_out_in_flight_are_refused_with_time_and_remedy(fly_at, days):
    day, night = days(0, 22), days(24, 30)
    with pytest.raises(ValueError, match="needs 4 satellites above 10 deg, got 0") as caught:
        fly_at(23.95, day)  # the records last until midnight, 162 s on with the leap seconds
    for said in ("at 162.5 s", "2024-09-14 22:00:00 GPS time", "next day", "--ephemeris"):
        assert said in str(caught.value)
    real = fly_at(23.95, day, night)
    assert real.scenario.world().visible.sum(axis=1).min() >= 4
    assert "satellites with a valid record are visible in flight" in "\n".join(real.lines)
    assert real.reports["ephemeris"]["fewest_visible"] >= 4
    again = fly_at(23.95, day, night, night)
    assert again.reports["ephemeris"]["duplicates"] == 24 * 4
    assert real.scenario.world().satellites.tolist() == again.scenario.world().satellites.tolist()


def test_gaps_and_files_of_hours_and_stations(fly_at, days):
    before, after = days(0, 8), days(14, 20)
    with pytest.raises(ValueError, match=r"24 of 24 .* no valid record .* 24 of them have one lat"):
        fly_at(9.95, before, after)
    heard = [days(8, 12, slice(k, None, 2)) for k in (0, 1)]  # each station hears every other one
    assert fly_at(9.95, *heard).scenario.world().visible.sum(axis=1).min() >= 4
    few = days(8, 12, slice(9))
    with pytest.raises(
        ValueError,
        match=r"first fix needs 4 .* got \d at time.*all \d satellites of the files .* mo",
    ):
        fly_at(9.95, few)


def test_a_flight_of_the_day_is_simulated_on_it_and_its_outputs_say_what_is_real(fly_at, days):
    real = fly_at(25.0, days(0, 22), days(24, 28))  # most records are of the day before
    assert not real.reports["time"]["mapped"]
    assert real.lines[0] == real.reports["note"] == ONLY_TRAJECTORY
    assert ONLY_TRAJECTORY.startswith("Only the trajectory is real")


def test_a_track_without_a_date_flies_on_the_day_of_the_records():
    records = one_record("G05", SATURDAY_22)
    for own in (datetime(1970, 1, 1, 8, tzinfo=UTC), datetime(2018, 1, 12, 12, tzinfo=UTC)):
        assert ephemeris_day(records, own) == date(2024, 9, 14)
