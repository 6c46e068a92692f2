"""Recorded tracks: every format gives the same rows, and every kind of dirt is found."""

import json
import sys

import numpy as np
import pytest

from spoofgym.data.cleaning import (
    clean_track,
    isolated_outliers,
    late_positions,
    repeated_positions,
    resolved_courses,
    stale_runs,
)
from spoofgym.data.tracks import FOOT, KNOT, read_track, track_from_frame
from spoofgym.truth.manoeuvres import Straight, Turn, fly

pandas = pytest.importorskip("pandas")

START_S = 1_700_000_000


@pytest.fixture(scope="module")
def flight():
    return fly(
        [Straight(60.0), Turn(200.0, bank_deg=20.0), Straight(120.0)],
        latitude_deg=46.0,
        longitude_deg=8.0,
        height_m=2000.0,
        speed_mps=100.0,
        heading_deg=10.0,
        rate_hz=10.0,
    )


@pytest.fixture
def table(flight):
    """Fixes of the flight every 5 s, with 20 m of error, as an ADS-B decoder writes them."""
    rows = np.arange(0, flight.time.size, 50)
    latitude, longitude, height = (value[rows] for value in flight.geodetic)
    off = 20.0 / 6.4e6 * np.random.default_rng(3).standard_normal((2, rows.size))
    north, east, _ = flight.velocity_n[rows].T
    return pandas.DataFrame(
        {
            "timestamp": START_S + flight.time[rows],
            "icao24": "4b1801",
            "latitude": np.degrees(latitude + off[0]),
            "longitude": np.degrees(longitude + off[1]),
            "altitude": height / FOOT,
            "groundspeed": np.hypot(north, east) / KNOT,
            "track": np.degrees(np.arctan2(east, north)) % 360.0,
        }
    )


def cleaned(table, **settings):
    return clean_track(track_from_frame(table, "dirty"), **settings)


def row_times(track):
    return track.start_utc.timestamp() - START_S + track.time


def test_a_clean_table_loses_nothing(flight, table):
    track, report = cleaned(table)
    assert report.fixes == report.angles == report.angles_as_given == len(table)
    dropped = report.repeated, report.late, report.interpolated, report.incomplete
    assert dropped == (0, 0, 0, 0)
    assert (report.position_outliers, report.height_outliers, report.grounded) == (0, 0, 0)
    assert (report.speeds_rejected, report.angles_rejected) == (0, 0)
    assert (track.start_utc.timestamp(), track.time[0]) == (START_S, 0.0)
    rows = np.arange(0, flight.time.size, 50)
    np.testing.assert_allclose(track.latitude, flight.geodetic[0][rows], atol=2e-5)
    np.testing.assert_allclose(track.height, flight.geodetic[2][rows], atol=1e-9)
    np.testing.assert_allclose(track.groundspeed, 100.0, rtol=1e-9)
    course = flight.euler[2][rows]
    np.testing.assert_allclose(np.exp(1j * track.track_angle), np.exp(1j * course), atol=1e-9)


def test_the_report_speaks_and_is_json(table):
    _, report = cleaned(table)
    assert json.loads(json.dumps(report.as_dict()))["rows"] == len(table)
    text = "\n".join(report.lines())
    assert f"{len(table)} rows" in text
    assert "barometric altitude is taken as height above the ellipsoid" in text


# --- reading -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["t.csv", "t.csv.gz", "t.json", "t.json.gz", "columns.json", "t.parquet"]
)
def test_every_format_gives_the_same_rows(tmp_path, table, name):
    path = tmp_path / name
    if ".csv" in name:
        table.to_csv(path, index=False)
    elif name.endswith(".parquet"):
        pytest.importorskip("pyarrow")
        table.to_parquet(path)
    else:
        orient = "columns" if name == "columns.json" else "records"
        table.to_json(path, orient=orient, double_precision=15)
    got, want = read_track(path), track_from_frame(table, "t")
    assert got.name == path.name.split(".")[0]
    for field in ("time", "latitude", "longitude", "altitude", "groundspeed", "track_deg"):
        np.testing.assert_allclose(getattr(got, field), getattr(want, field), rtol=1e-12)
    assert np.isnan(got.position_time).all()
    assert np.isnan(got.vertical_rate).all()


@pytest.mark.parametrize(
    "convert",
    [
        lambda seconds: seconds.astype("int64"),
        lambda seconds: (seconds * 1e3).astype("int64"),
        lambda seconds: (seconds * 1e6).astype("int64"),
        lambda seconds: seconds.astype("int64") * 10**9,
        lambda seconds: pandas.to_datetime(seconds, unit="s"),
        lambda seconds: pandas.to_datetime(seconds, unit="s", utc=True).dt.tz_convert("Asia/Tokyo"),
        lambda seconds: pandas.to_datetime(seconds, unit="s", utc=True).map(
            lambda t: t.isoformat()
        ),
        lambda seconds: pandas.to_datetime(seconds, unit="s").dt.strftime("%Y-%m-%d %H:%M:%S"),
    ],
    ids=["s", "ms", "us", "ns", "naive", "zoned", "iso", "text"],
)
def test_times_are_understood(table, convert):
    want = track_from_frame(table, "t").time
    table["timestamp"] = convert(table["timestamp"])
    np.testing.assert_allclose(track_from_frame(table, "t").time, want, atol=1e-6)


def test_units_follow_the_column_or_the_argument(table):
    metres = table.rename(columns={"altitude": "altitude_m"})
    np.testing.assert_allclose(track_from_frame(metres, "t").altitude, table["altitude"])
    np.testing.assert_allclose(track_from_frame(table, "t").altitude, table["altitude"] * FOOT)
    forced = track_from_frame(table, "t", altitude_unit="m")
    np.testing.assert_allclose(forced.altitude, table["altitude"])
    table["vertical_rate"] = 600.0
    np.testing.assert_allclose(track_from_frame(table, "t").vertical_rate, 600.0 * FOOT / 60.0)


def test_other_names_of_columns_are_understood(table):
    renamed = table.rename(
        columns={"timestamp": "Time", "latitude": " LAT", "longitude": "lon", "groundspeed": "gs"}
    )
    track, _ = cleaned(renamed)
    np.testing.assert_allclose(track.groundspeed, 100.0, rtol=1e-9)


def test_one_aircraft_is_taken_out_of_several(table):
    other = table.assign(icao24="abcdef", latitude=table["latitude"] + 1.0)
    both = pandas.concat([table, other]).sort_values("timestamp", kind="stable")
    with pytest.raises(ValueError, match="`aircraft` must be one of 4b1801, abcdef, got none"):
        track_from_frame(both, "t")
    with pytest.raises(ValueError, match="got '123456'"):
        track_from_frame(both, "t", aircraft="123456")
    track = track_from_frame(both, "t", aircraft="abcdef")
    np.testing.assert_allclose(np.degrees(track.latitude), other["latitude"])


def spoil(table, column, row, value):
    changed = table.copy()
    changed[column] = changed[column].astype(object)
    changed.loc[row, column] = value
    return changed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.iloc[:0], "must have rows, got none in 'bad'"),
        (
            lambda t: t.drop(columns=["latitude", "altitude"]),
            r"latitude \(latitude, lat\); altitude \(altitude_m.*got timestamp, icao24, longitude",
        ),
        (
            lambda t: spoil(t, "timestamp", 7, START_S + 20.0),
            r"backwards, got -10 s from row 7 to row 8",
        ),
        (lambda t: spoil(t, "timestamp", 3, None), "every row must have a time, got none in row 4"),
        (
            lambda t: spoil(t, "timestamp", 3, "noon"),
            "`timestamp` must hold numbers or ISO 8601 times",
        ),
        (lambda t: spoil(t, "latitude", 5, 91.5), r"-90 and 90 deg, got 91.5 deg in row 6"),
        (lambda t: spoil(t, "longitude", 5, -200.0), r"-180 and 360 deg, got -200 deg in row 6"),
        (lambda t: spoil(t, "longitude", 5, np.inf), r"360 deg, got inf deg in row 6"),
        (lambda t: spoil(t, "altitude", 5, 1e9), r"`altitude` must .* 50000 m, got 304800000 m in"),
        (lambda t: spoil(t, "altitude", 5, 10**400), "`altitude` must hold numbers"),
        (
            lambda t: t.assign(timestamp=9e9),
            r"`time` must lie between 0 and 4102444800 s, got 9000000000 s in row 1",
        ),
        (lambda t: t.assign(LATITUDE=0.0), "each column once, got 'latitude' twice"),
        (lambda t: spoil(t, "altitude", 5, "high"), "`altitude` must hold numbers"),
        (lambda t: t.iloc[:4], "at least 6 rows with a position and an altitude, got 4"),
        (lambda t: t.assign(latitude=np.nan), "at least 6 rows with a position .*, got 0"),
        (lambda t: t.assign(altitude=0.0), "airborne stretch of at least 6 fixes"),
        (lambda t: t.assign(groundspeed=50.0, track=np.nan).iloc[::9], "a gap over 30 s"),
    ],
)
def test_what_is_no_track_is_refused(table, change, message):
    with pytest.raises(ValueError, match=message):
        clean_track(track_from_frame(change(table), "bad"))


def test_an_empty_or_unknown_file_is_refused(tmp_path):
    (tmp_path / "empty.csv").touch()
    with pytest.raises(ValueError, match="must have rows, got none in 'empty'"):
        read_track(tmp_path / "empty.csv")
    (tmp_path / "empty.json").write_text("[]")
    with pytest.raises(ValueError, match="must have rows, got none in 'empty'"):
        read_track(tmp_path / "empty.json")
    (tmp_path / "number.json").write_text("1")
    with pytest.raises(ValueError, match=r"number\.json .* must hold a list"):
        read_track(tmp_path / "number.json")
    with pytest.raises(ValueError, match=r"must end in \.csv, .* got 'a\.txt'"):
        read_track(tmp_path / "a.txt")


def test_without_pandas_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"pip install spoofgym\[flights\]"):
        read_track("any.csv")


# --- cleaning ----------------------------------------------------------------------------------


def test_courses_in_a_signed_byte_are_resolved(flight, table):
    true = np.round(table["track"]).astype(int)
    table["track"] = (true + 128) % 256 - 128
    track, report = cleaned(table)
    assert report.angles_rejected == 0
    assert report.angles_unwrapped == int((table["track"] != true).sum()) > 0
    np.testing.assert_allclose(
        np.exp(1j * track.track_angle), np.exp(1j * np.radians(true)), atol=1e-9
    )


def test_256_deg_are_not_tried_where_courses_do_not_fit_a_byte():
    course = np.radians([10.0, 10.0, 200.0])
    angle, unwrapped = resolved_courses(np.array([10.0, 114.0, 200.0]), course)
    np.testing.assert_array_equal(np.isnan(angle), [False, True, False])
    assert not unwrapped.any()


def test_courses_off_by_more_than_20_deg_are_rejected(table):
    table.loc[[4, 9], "track"] = (table.loc[[4, 9], "track"] + [60.0, 10.0]) % 360.0
    track, report = cleaned(table)
    assert report.angles_rejected == 1
    assert np.flatnonzero(np.isnan(track.track_angle)).tolist() == [4]


def test_interpolated_runs_count_as_one_fix_at_each_end(table):
    run = slice(20, 25)
    for column in ("latitude", "longitude"):
        ends = table[column].iloc[[20, 24]]
        table.iloc[run, table.columns.get_loc(column)] = np.linspace(*ends, 5).round(6)
    track, report = cleaned(table)
    assert report.interpolated == 3
    kept = np.delete(np.arange(len(table)), [21, 22, 23])
    np.testing.assert_allclose(row_times(track), 5.0 * kept)


def test_a_noiseless_straight_flight_is_kept_on_demand(table):
    straight = table.iloc[:13].assign(
        latitude=np.linspace(46.0, 46.05, 13), longitude=8.0, track=0.0, groundspeed=180.0
    )
    with pytest.raises(ValueError, match="interpolated='keep'"):
        cleaned(straight)
    track, report = cleaned(straight, interpolated="keep")
    assert (track.time.size, report.interpolated) == (13, 0)
    with pytest.raises(ValueError, match="must be 'drop' or 'keep', got 'maybe'"):
        cleaned(straight, interpolated="maybe")


def test_repeated_positions_count_once(table):
    repeated = table.loc[table.index.repeat(5)].reset_index(drop=True)
    repeated["timestamp"] = START_S + np.arange(len(repeated), dtype=float)
    track, report = cleaned(repeated)
    assert report.repeated == 4 * len(table)
    # filled backwards before the first change, forwards after it
    np.testing.assert_allclose(row_times(track)[:3], [4.0, 5.0, 10.0])


def test_positions_count_at_the_time_the_file_knows(table):
    repeated = table.loc[table.index.repeat(3)].reset_index(drop=True)
    repeated["last_position"] = 1e3 * repeated["timestamp"]
    repeated["timestamp"] += np.tile([1.2, 2.2, 3.2], len(table))
    track, report = cleaned(repeated)
    assert report.repeated == 2 * len(table)
    np.testing.assert_allclose(row_times(track), 5.0 * np.arange(len(table)), atol=1e-6)


def test_positions_that_are_not_newer_are_dropped(table):
    table["last_position"] = 1e3 * table["timestamp"]
    table.loc[8, "last_position"] -= 12_000.0
    track, report = cleaned(table)
    assert report.late == 1
    assert 40.0 not in row_times(track)


def test_rows_without_position_or_altitude_are_dropped(table):
    table.loc[3, "latitude"] = np.nan
    table.loc[8, "altitude"] = np.nan
    _, report = cleaned(table)
    assert (report.incomplete, report.fixes) == (2, len(table) - 2)


@pytest.mark.parametrize("rows", [[10], [10, 30], [10, 13]])
def test_outliers_are_dropped_one_by_one(table, rows):
    table.loc[rows, "latitude"] += 0.03
    track, report = cleaned(table)
    assert report.position_outliers == len(rows)
    assert report.fixes == len(table) - len(rows)
    assert not set(row_times(track)) & {5.0 * row for row in rows}


def test_wild_altitudes_are_dropped(table):
    table.loc[[6, 21], "altitude"] = [107_700.0, 0.0]
    track, report = cleaned(table)
    assert report.height_outliers == 2
    assert track.height.max() < 2100.0


def test_a_jump_that_lasts_breaks_the_track_and_drops_nothing(table):
    table.loc[30:, "latitude"] += 0.3
    track, report = cleaned(table)
    assert (report.position_outliers, report.stretches) == (0, 2)
    assert report.fixes == track.time.size == max(30, len(table) - 30)


def test_a_gap_over_30_s_breaks_the_track(table):
    table = table.drop(index=range(31, 37))
    track, report = cleaned(table)
    assert report.stretches == 2
    assert track.time.size == report.fixes == 31
    assert np.diff(track.time).max() <= 30.0


def test_a_gap_of_30_s_does_not(table):
    _, report = cleaned(table.drop(index=range(31, 36)))
    assert (report.stretches, report.fixes) == (1, len(table) - 5)


def test_rows_at_an_altitude_of_0_are_not_airborne(table):
    table.loc[:9, "altitude"] = 0.0
    track, report = cleaned(table)
    assert report.grounded == 10
    assert row_times(track)[0] == 50.0


def test_rows_at_60_kt_are_not_airborne(table):
    still_to_taxi = 5.0 * 55.0 * KNOT * np.arange(10, 0, -1) + np.tile([0.0, 3.0], 5)
    table.loc[:9, "latitude"] = table.loc[10, "latitude"] - still_to_taxi / 111_200.0
    table.loc[:9, "longitude"] = table.loc[10, "longitude"]
    table.loc[:9, "groundspeed"] = 55.0
    track, report = cleaned(table)
    assert report.grounded == 10
    assert row_times(track)[0] == 50.0


def test_without_groundspeed_the_speed_made_good_decides(table):
    _, report = cleaned(table.drop(columns=["groundspeed", "track"]))
    assert report.fixes == len(table)
    assert report.angles == 0


def test_a_stale_groundspeed_is_not_used(table):
    table["groundspeed"] = 400.0
    track, report = cleaned(table)
    assert report.speeds_rejected == len(table)
    assert np.isnan(track.groundspeed).all()


def test_a_cut_is_chosen_by_its_times(table):
    track, report = cleaned(table, from_s=40.0, duration_s=100.0)
    times = row_times(track)
    assert (times[0], times[-1], report.duration_s) == (40.0, 140.0, 100.0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"from_s": 5000.0}, r"`from_s` must lie in an airborne stretch \(0 to \d+ s\), got 5000"),
        ({"duration_s": 5000.0}, r"`duration_s` must be at most \d+ s here, got 5000 s"),
        ({"duration_s": 0.0}, "`duration_s`"),
        ({"duration_s": 20.0}, "at least 6 fixes, got 5"),
    ],
)
def test_a_cut_that_is_not_there_is_refused(table, settings, message):
    with pytest.raises(ValueError, match=message):
        cleaned(table, **settings)


def test_ten_minutes_are_the_default():
    long = fly(
        [Turn(3000.0, bank_deg=20.0)],
        latitude_deg=46.0,
        longitude_deg=8.0,
        height_m=2000.0,
        speed_mps=100.0,
        heading_deg=0.0,
        rate_hz=1.0,
    )
    rows = np.arange(0, long.time.size, 4)
    assert long.duration > 700.0
    table = pandas.DataFrame(
        {
            "time": long.time[rows],
            "lat": np.degrees(long.geodetic[0][rows]),
            "lon": np.degrees(long.geodetic[1][rows]),
            "altitude_m": long.geodetic[2][rows],
        }
    )
    _, report = cleaned(table)
    assert report.duration_s == 600.0
    assert report.stretch_s > 700.0


# --- single rules ------------------------------------------------------------------------------


def test_no_rows_break_no_rule():
    nothing = np.array([])
    assert late_positions(nothing).size == 0
    assert repeated_positions(nothing, nothing, nothing.astype(bool)).size == 0
    assert stale_runs(nothing, nothing.astype(bool)).size == 0


def test_only_runs_with_too_much_wrong_are_stale():
    value = np.repeat([1.0, 2.0, np.nan], 10)
    wrong = np.zeros(30, dtype=bool)
    wrong[[3, 13, 14]] = True
    stale = stale_runs(value, wrong)
    assert not stale[:10].any()
    assert stale[10:20].all()
    assert not stale[20:].any()


def test_an_honest_turn_has_no_outlier():
    time = np.arange(0.0, 120.0, 10.0)
    radius, rate = 1500.0, 0.06
    circle = radius * np.stack([np.cos(rate * time), np.sin(rate * time)], axis=-1)
    assert not isolated_outliers(time, circle, 500.0, 10.0).any()


# --- recorded tracks ---------------------------------------------------------------------------


def read(data_folder, name):
    return read_track(data_folder / f"adsb_flights/{name}.json.gz")


def test_ajaccio_is_half_interpolated_and_stored_in_a_signed_byte(data_folder):
    track, report = clean_track(read(data_folder, "ajaccio"))
    assert report.interpolated / report.rows == pytest.approx(0.46, abs=0.01)
    assert report.angles_unwrapped > 0
    assert report.angles_rejected < 0.05 * (report.angles_as_given + report.angles_unwrapped)
    assert report.duration_s == 600.0
    assert np.diff(track.time).max() <= 30.0


def test_noisy_spoofing_repeats_half_of_its_positions(data_folder):
    track, report = clean_track(read(data_folder, "noisy_spoofing"))
    assert report.repeated / report.rows == pytest.approx(0.46, abs=0.01)
    assert np.degrees(track.latitude).max() < 49.0, "the captured part is no flight"


def test_the_only_groundspeed_of_inflight_refuelling_is_not_used(data_folder):
    track, report = clean_track(read(data_folder, "inflight_refuelling"))
    assert np.isnan(track.groundspeed).all()
    assert report.height_outliers > 0
    assert track.height.max() < 15_000.0


def test_airbus_tree_falls_apart_at_its_gaps(data_folder):
    track, report = clean_track(read(data_folder, "airbus_tree"))
    assert report.stretches > 1
    assert np.diff(track.time).max() <= 30.0
