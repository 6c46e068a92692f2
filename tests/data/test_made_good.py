"""Files that contradict their own positions are refused by the name of the mistake."""

import numpy as np
import pytest

from spoofgym.data.cleaning import clean_track
from spoofgym.data.track_fit import fit_track
from spoofgym.data.tracks import FOOT, KNOT, track_from_frame
from spoofgym.truth.manoeuvres import Climb, Straight, Turn, fly

from .files import make_table

pandas = pytest.importorskip("pandas")
MPH = 0.44704


def make_flight(speed, height):
    legs = [Straight(120.0), Climb(900.0), Turn(120.0, bank_deg=20.0), Straight(200.0)]
    place = {"latitude_deg": 46.0, "longitude_deg": 8.0, "height_m": height}
    return fly(legs, **place, speed_mps=speed, heading_deg=10.0, rate_hz=10.0)


@pytest.fixture(scope="module")
def flights():
    return {speed: make_flight(speed, height) for speed, height in ((100.0, 3e3), (240.0, 1.1e4))}


def blow(table, across_mps=10.0):
    """Headings in a wind from 250 deg."""
    wind = np.radians(250.0 - table["track"])
    speed = table["groundspeed"] * KNOT
    return (table["track"] + np.degrees(np.arcsin(across_mps * np.sin(wind) / speed))) % 360.0


def blow_against(table, wind_mps=10.0):
    """Airspeeds [kt] in a wind from 250 deg."""
    speed, wind = table["groundspeed"], wind_mps / KNOT
    along = np.cos(np.radians(250.0 - table["track"]))
    return np.sqrt(speed**2 + 2.0 * speed * wind * along + wind**2)


SWAP = {"latitude": "longitude", "longitude": "latitude"}
METRES = "metres, and taken as feet .--altitude-unit m.: "
MISTAKES = {
    "m/s": (lambda t: t.assign(groundspeed=t.groundspeed * KNOT), "in m/s, and taken as kt"),
    "mph": (lambda t: t.assign(groundspeed=t.groundspeed * KNOT / MPH), "in mph, and taken as kt"),
    "km/h": (lambda t: t.assign(groundspeed=t.groundspeed * 1.852), "in km/h, and taken as kt"),
    "kt": (lambda t: t.rename(columns={"groundspeed": "velocity"}), "in kt, and taken as m/s"),
    "heading": (lambda t: t.assign(track=blow(t)), "courses seem to be headings"),
    "swapped": (lambda t: t.rename(columns=SWAP), "latitude and longitude are swapped"),
    "airspeed": (
        lambda t: t.assign(groundspeed=(0.86 * blow_against(t)).round()),
        r"groundspeeds seem to be airspeeds: the positions move 1\.\d+ to 1\.\d+ times as fast",
    ),
    "true airspeed": (
        lambda t: t.assign(groundspeed=blow_against(t, 25.0)),
        "groundspeeds seem to be airspeeds",
    ),
    "south": (lambda t: t.assign(latitude=-t.latitude), "latitudes have lost their sign"),
    "west": (lambda t: t.assign(longitude=-t.longitude), "longitudes have lost their sign"),
    "radians": (lambda t: t.assign(track=np.radians(t.track)), "courses are in radians"),
    "times": (
        lambda t: t.assign(timestamp=1.7e9 + 1.5 * (t.timestamp - 1.7e9)),
        r"the positions move 0\.6[67]\d* times as fast .* are these, or the times, in",
    ),
    "ft/s": (lambda t: t.assign(groundspeed=t.groundspeed * KNOT / FOOT), r"move 0\.59\d* times"),
    "courses": (lambda t: t.assign(track=7.0 * t.track % 360.0), "courses agree .* at [0-9]* of"),
    "km": (lambda t: t.assign(altitude=t.altitude * FOOT / 1e3), r"change 0\.000\d+ times as fast"),
    "metres": (lambda t: t.assign(altitude=t.altitude * FOOT), METRES),
    "feet": (lambda t: t.rename(columns={"altitude": "baro_altitude"}), "in feet, and taken as me"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize(("every", "off_m"), [(10, 60.0), (50, 20.0)])
def test_a_mistake_of_a_whole_column_is_refused_with_its_cause(flights, mistake, every, off_m):
    change, said = MISTAKES[mistake]
    table = make_table(flights[100.0], 1.7e9, every, off_m)
    clean_track(track_from_frame(table, "honest"))
    with pytest.raises(ValueError, match=f"'wrong' contradicts itself: .*{said}"):
        clean_track(track_from_frame(change(table), "wrong"))


def test_altitudes_without_climb_rates_are_judged_by_speed_unless_their_unit_is_given(flights):
    table = make_table(flights[240.0], 1.7e9).drop(columns="vertical_rate")
    clean_track(track_from_frame(table, "honest"))
    metres = table.assign(altitude=table["altitude"] * FOOT)
    with pytest.raises(ValueError, match=f"{METRES}.* equivalent airspeed are too fast"):
        clean_track(track_from_frame(metres, "wrong"))
    with pytest.raises(ValueError, match=r"--altitude-unit ft.: half of them are above 3\d+ m"):
        clean_track(track_from_frame(table.rename(columns={"altitude": "altitude_m"}), "wrong"))
    right, _ = clean_track(track_from_frame(metres, "right", altitude_unit="m"))
    assert np.median(right.height) > 10_000.0
    low, _ = clean_track(track_from_frame(metres, "a jet, low", altitude_unit="ft"))
    assert np.median(low.height) < 5_000.0


def test_a_stale_speed_or_course_is_dirt_and_no_mistake(flights):
    table = make_table(flights[100.0], 1.7e9, 10, 60.0)
    _, report = clean_track(track_from_frame(table.assign(groundspeed=433.0, track=77.0), "stale"))
    assert report.speeds_rejected == report.rows


def test_an_airspeed_that_is_one_value_alone_is_not_used(flights):
    for every, off_m in ((10, 60.0), (50, 20.0)):
        table = make_table(flights[100.0], 1.7e9, every, off_m)
        track, report = clean_track(track_from_frame(table.assign(groundspeed=167.0), "ias"))
        assert report.speeds_rejected == report.rows
        assert np.isnan(track.groundspeed).all()
        assert clean_track(track_from_frame(table, "true"))[1].speeds_rejected == 0


def test_courses_that_sway_are_no_headings(flights):
    table = make_table(flights[100.0], 1.7e9, 10, 20.0)
    sway = 12.0 * np.sin(2.0 * np.pi * table["timestamp"] / 90.0)
    _, report = clean_track(track_from_frame(table.assign(track=(table.track + sway) % 360), "x"))
    assert report.angles > 0.9 * report.fixes


def test_a_mark_of_an_absent_course_is_dirt_however_often(flights):
    table = make_table(flights[240.0], 1.7e9)
    sparse = table.assign(track=table["track"].where(table.index % 10 == 0, 300.0))
    _, report = clean_track(track_from_frame(sparse, "sparse"))
    assert 0 < report.angles < 0.2 * report.fixes


def test_an_aircraft_that_circles_is_taken_as_it_is():
    place = {"latitude_deg": 46.0, "longitude_deg": 8.0, "height_m": 1e3}
    legs = [Straight(5.0), Turn(7_000.0, bank_deg=45.0)]
    around = fly(legs, **place, speed_mps=50.0, heading_deg=10.0, rate_hz=10.0)
    table = make_table(around, 1.7e9, 20)
    _, report = clean_track(track_from_frame(table, "around"))
    assert report.angles > 0.95 * report.fixes


def test_a_fast_jet_is_refused_only_where_its_times_may_be_wrong():
    place = {"latitude_deg": 46.0, "longitude_deg": 8.0, "height_m": 300.0}
    legs = [Straight(60.0), Turn(60.0, bank_deg=30.0), Straight(60.0)]
    table = make_table(fly(legs, **place, speed_mps=230.0, heading_deg=10.0, rate_hz=10.0), 1.7e9)
    clean_track(track_from_frame(table, "jet"))
    alone = table.drop(columns=["groundspeed", "vertical_rate"])
    with pytest.raises(ValueError, match="times seem not to be in seconds"):
        clean_track(track_from_frame(alone, "jet"))


def test_swapped_places_are_found_by_speeds_alone_too(flights):
    table = make_table(flights[100.0], 1.7e9).drop(columns="track")
    clean_track(track_from_frame(table, "honest"))
    with pytest.raises(ValueError, match="longitude are swapped: the speeds contradict"):
        clean_track(track_from_frame(table.rename(columns=SWAP), "wrong"))


def test_swapped_places_that_no_latitude_has_and_fits_off_their_fixes(flights):
    table = make_table(flights[100.0], 1.7e9)
    far = table.assign(latitude=table["longitude"] + 130.0)
    with pytest.raises(ValueError, match=r"138\.\d+ deg in row 1; are latitude and longitude sw"):
        track_from_frame(far, "far")
    track, _ = clean_track(track_from_frame(table, "late"))
    track.groundspeed.setflags(write=True)
    track.groundspeed[:] *= 1.6
    with pytest.raises(ValueError, match=r"within 400 m RMS, got \d+ m for 'late'"):
        fit_track(track)
