"""Recorded tracks: every format gives the same rows, and every kind of dirt is found."""

import json
import sys

import numpy as np
import pytest

from spoofgym.data.cleaning import clean_track, isolated_outliers, stale_runs
from spoofgym.data.tracks import FOOT, KNOT, read_track, track_from_frame
from spoofgym.truth.manoeuvres import Straight, Turn, fly

from .files import SERVICES, make_table
from .test_damaged_files import check_damage, check_track

pandas = pytest.importorskip("pandas")

START_S, NAN = 1_700_000_000, np.nan


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
    return make_table(flight, START_S).drop(columns="vertical_rate")


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
    assert json.loads(json.dumps(report.as_dict()))["rows"] == len(table)
    text = "\n".join(report.lines())
    assert f"{len(table)} rows" in text
    assert "the altitude (`altitude`, read in ft) is taken as height above the ellipsoid" in text


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
    assert clean_track(got)[1].fixes == len(table)
    check_damage(path, check_track, 2)


@pytest.mark.parametrize("service", SERVICES)
def test_files_of_services_are_read_as_they_come(tmp_path, flight, service):
    table = make_table(flight, START_S)
    path = SERVICES[service](tmp_path, table)
    got, want = read_track(path), track_from_frame(table, "t")
    flown = slice(-len(table), None)  # a row on the ground may come before
    for field in ("time", "latitude", "longitude", "altitude", "groundspeed", "track_deg"):
        x, y = getattr(got, field)[flown], getattr(want, field)
        if field == "groundspeed" and service == "OpenSky track":
            assert np.isnan(x).all()
            continue
        np.testing.assert_allclose(x, y, rtol=1e-9, err_msg=field)
    if np.isfinite(got.position_time).any():
        np.testing.assert_allclose(got.position_time[flown], want.time - 0.5)
    known = np.isfinite(got.vertical_rate)
    np.testing.assert_allclose(got.vertical_rate[known], 0.0, atol=1e-6)
    assert clean_track(got)[1].fixes == len(table)


WRITERS = {
    "comments": lambda t: f"\n# by hand\n# in feet\n{t}",
    "sep": lambda t: f"sep=;\n{t.replace(',', ';')}",
    "ends of lines": lambda t: t.replace("\n", ",\n"),
    "of rows alone": lambda t: t.replace("\n", ",\n").replace(",\n", "\n", 1),
    "row names of R": lambda t: t.replace("\n", "\n1,").removesuffix("1,"),
    "put behind": lambda t: f"{t}{t}",
    "heads put behind": lambda t: t + 2 * t.splitlines(keepends=True)[0],
    "time_ms": lambda t: t.replace("timestamp", "time_ms").replace(".0,4b", "000,4b"),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_habits_of_writers_of_csv(tmp_path, table, writer):
    path = tmp_path / "t.csv"
    path.write_text(WRITERS[writer](table.to_csv(index=False)))
    got, want = clean_track(read_track(path))[0], cleaned(table)[0]
    for field in ("time", "latitude", "longitude", "height", "groundspeed", "track_angle"):
        np.testing.assert_allclose(getattr(got, field), getattr(want, field), atol=1e-9)
    assert got.start_utc == want.start_utc


def test_rows_of_more_values_than_the_head_names_shift_no_columns(tmp_path, table):
    path = tmp_path / "t.csv"
    path.write_text(table.to_csv(index=False).replace("\n", ",7\n").replace(",7\n", "\n", 1))
    n = len(table.columns)
    with pytest.raises(ValueError, match=f"names {n} columns, its first row has {n + 1}"):
        read_track(path)


def test_seconds_of_a_day_that_begin_again_count_on(table):
    late = (table["timestamp"] - START_S + 86_300.0) % 86_400.0
    track, report = cleaned(table.assign(timestamp=late))
    assert (report.unsorted, report.fixes) == (0, len(table))
    assert track.duration == cleaned(table)[0].duration
    k = int(np.argmin(late))  # the first row after midnight, which comes one too early
    crossed = [*range(k - 1), k, k - 1, *range(k + 1, len(table))]
    _, report = cleaned(table.assign(timestamp=late).iloc[crossed])
    assert (report.unsorted, report.fixes, report.duration_s) == (1, len(table), track.duration)


def test_a_date_of_another_day_moves_no_row_but_its_own(table):
    early = spoil(table, "timestamp", 20, table["timestamp"][20] + 86_400.0)
    _, report = cleaned(early)
    assert (report.fixes, report.duration_s) == (len(table) - 1, cleaned(table)[0].duration)


def test_rows_out_of_order_are_sorted_and_it_is_said(table):
    shuffled = table.iloc[[0, 1, 4, 2, 3, *range(5, len(table))]]
    track, report = cleaned(shuffled)
    assert report.unsorted == 2
    assert "2 rows were out of order" in "\n".join(report.lines())
    np.testing.assert_array_equal(track.time, cleaned(table)[0].time)
    assert "out of order" not in "\n".join(cleaned(table)[1].lines())


def test_times_units_and_names_are_understood(table):
    plain, seconds = track_from_frame(table, "t"), table["timestamp"]
    zoned = pandas.to_datetime(seconds, unit="s", utc=True)
    for times in (
        seconds.astype("int64"),
        (seconds * 1e3).astype("int64"),
        (seconds * 1e6).astype("int64"),
        seconds.astype("int64") * 10**9,
        pandas.to_datetime(seconds, unit="s"),
        zoned.dt.tz_convert("Asia/Tokyo"),
        zoned.map(lambda t: t.isoformat()),
        pandas.to_datetime(seconds, unit="s").dt.strftime("%Y-%m-%d %H:%M:%S"),
    ):
        found = track_from_frame(table.assign(timestamp=times), "t")
        np.testing.assert_allclose(found.time, plain.time, atol=1e-6)
    metres = table.rename(columns={"altitude": "altitude_m"})
    np.testing.assert_allclose(track_from_frame(metres, "t").altitude, table["altitude"])
    np.testing.assert_allclose(plain.altitude, table["altitude"] * FOOT)
    forced = track_from_frame(table.assign(vertical_rate=600.0), "t", altitude_unit="m")
    np.testing.assert_allclose(forced.altitude, table["altitude"])
    np.testing.assert_allclose(forced.vertical_rate, 600.0 * FOOT / 60.0)
    names = {"timestamp": "Time", "latitude": " LAT", "longitude": "lon", "groundspeed": "gs"}
    track, _ = cleaned(table.rename(columns=names))
    np.testing.assert_allclose(track.groundspeed, 100.0, rtol=1e-9)


def test_one_aircraft_is_taken_out_of_several(table):
    names = ["abcdef"] * (len(table) - 1) + ["ABCDEF"]
    other = table.assign(icao24=names, latitude=table["latitude"] + 1.0)
    both = pandas.concat([table, other]).sort_values("timestamp", kind="stable")
    for aircraft, said in ((None, "of 4b1801, abcdef, .* got none"), ("123456", "got '123456'")):
        with pytest.raises(ValueError, match=f"`aircraft` must be one .*{said}"):
            track_from_frame(both, "t", aircraft=aircraft)
    track = track_from_frame(both, "t", aircraft="abcdef")
    np.testing.assert_allclose(np.degrees(track.latitude), other["latitude"])
    short = pandas.concat([table.iloc[:2].assign(icao24="777777"), table, other])
    with pytest.raises(ValueError, match="one of 4b1801, abcdef, 777777, those of most rows first"):
        track_from_frame(short, "t")
    with pytest.raises(ValueError, match="one aircraft over time, got one row each of 57"):
        track_from_frame(table.assign(icao24=[f"4b{k:04x}" for k in table.index]), "t")


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
            r"latitude \(latitude, lat\); altitude \(altitude, .*got timestamp, icao24, longitude",
        ),
        (
            lambda t: t.drop(columns="latitude").assign(
                icao24=[f"{k:06x}" for k in t.index], **{f"engine{k}": 0.0 for k in range(60)}
            ),
            r"latitude \(latitude, lat\), got timestamp, icao24, .{60,200}, \.\.\.$",
        ),
        (
            lambda t: t.assign(altitude=t["altitude"] + 6e3 * (t.index % 6 > 2)),
            "jumps of place or altitude between them",
        ),
        (
            lambda t: t.assign(timestamp=45_000.5 + t.index / 17_280.0),
            "looks like days of a spread",
        ),
        (lambda t: spoil(t, "timestamp", 3, None), "every row must have a time, got none in row 4"),
        (
            lambda t: spoil(t, "timestamp", 3, "noon"),
            "numbers or ISO 8601 times, got 'noon' in row 4",
        ),
        (lambda t: spoil(t, "groundspeed", 3, "fast"), "must hold numbers, got 'fast' in row 4"),
        (lambda t: t.assign(latitude=4e8), r"in row 1; are they in 1e-7 deg\?$"),
        (
            lambda t: t.assign(timestamp=739_000.5 + t.index / 17_280.0),
            "days of a spreadsheet or of MATLAB",
        ),
        (
            lambda t: t.assign(**np.radians(t[["latitude", "longitude"]])),
            r"are latitude and longitude in radians\?",
        ),
        (
            lambda t: t.assign(
                altitude=t["altitude"] / 100.0, groundspeed=t["groundspeed"] * 3.0
            ).assign(timestamp=START_S + (t["timestamp"] - START_S) / 3.0),
            "altitudes seem to be flight levels, taken as feet .--altitude-unit fl; ft if right.",
        ),
        (lambda t: spoil(t, "latitude", 5, 91.5), r"-90 and 90 deg, got 91.5 deg in row 6"),
        (lambda t: spoil(t, "altitude", 5, 1e9), r"`altitude` must .* 50000 m, got 304800000 m in"),
        (lambda t: t.assign(timestamp=9e9), r"`time` must lie between 0 and 4102444800 s, got 9"),
        (lambda t: t.assign(LATITUDE=0.0), "each column once, got 'latitude' twice"),
        (
            lambda t: t.assign(timestamp=221_300 + t.index // 12 * 100 + t.index % 12 * 5),
            "looks like hours, minutes and seconds in one number",
        ),
        (
            lambda t: t.assign(timestamp=(t.timestamp - START_S) / 60.0),
            "times seem not to be in seconds",
        ),
        (
            lambda t: pandas.concat(
                [t, t.assign(latitude=t.latitude + 1.0, timestamp=t.timestamp + 2.0)]
            ).sort_values("timestamp"),
            "all rows of one aircraft",
        ),
        (
            lambda t: t.assign(
                latitude=46.0 + 1e-6 * (t.index % 3), longitude=8.0, groundspeed=0.0
            ),
            "fixes are at 60 kt or slower",
        ),
        (lambda t: t.assign(timestamp=START_S), "56 rows have no later time"),
        (lambda t: t.iloc[:4], "at least 6 rows with a position and an altitude, got 4"),
        (lambda t: t.assign(altitude=0.0), "airborne stretch of at least 6 fixes.*at an altitude"),
        (
            lambda t: t.assign(groundspeed=50.0, track=np.nan).iloc[::9],
            "a gap over 30 s.*45 s apart",
        ),
    ],
)
def test_what_is_no_track_is_refused(table, change, message):
    with pytest.raises(ValueError, match=message):
        clean_track(track_from_frame(change(table), "bad"))


def test_an_empty_or_unknown_file_is_refused_and_pandas_asked_for(tmp_path, monkeypatch):
    for name, text, said in (
        ("empty.csv", "", "must have rows, got none in 'empty'"),
        ("empty.json", "[]", "must have rows, got none in 'empty'"),
        ("number.json", "1", r"number\.json .* must hold a list"),
        (
            "answer.csv",
            "<p>404: not found</p>",
            "got none in 'answer' below the columns p_404_not_fo",
        ),
        ("far.json", '{"flights": [{"lat": 4}]}', "must have columns for time .*, got flights"),
        (
            "dates.json",
            '[{"time": {"$date": 4}}]',
            r"`time` must be a value, got an object with \$d",
        ),
        ("a.txt", "", r"must end in \.csv, .* got 'a\.txt': save its points as a table with col"),
        ("zip.csv", "PK\x03\x04", r"zip\.csv is packed by zip, .* unpack it first"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(ValueError, match=said):
            read_track(tmp_path / name)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"pip install 'spoofgym\[flights\]'"):
        read_track("any.csv")


def test_interpolated_runs_count_as_one_fix_at_each_end_or_are_kept_on_demand(table):
    line = {"longitude": 8.0, "track": 0.0, "groundspeed": 180.0}
    straight = table.iloc[:13].assign(latitude=np.linspace(46.0, 46.05, 13), **line)
    with pytest.raises(ValueError, match="interpolated='keep'"):
        cleaned(straight)
    track, report = cleaned(straight, interpolated="keep")
    assert (track.time.size, report.interpolated) == (13, 0)
    with pytest.raises(ValueError, match="must be 'drop' or 'keep', got 'maybe'"):
        cleaned(straight, interpolated="maybe")
    run = slice(20, 25)
    for column in ("latitude", "longitude"):
        ends = table[column].iloc[[20, 24]]
        table.iloc[run, table.columns.get_loc(column)] = np.linspace(*ends, 5).round(6)
    track, report = cleaned(table)
    assert report.interpolated == 3
    kept = np.delete(np.arange(len(table)), [21, 22, 23])
    np.testing.assert_allclose(row_times(track), 5.0 * kept)


def stored(table, **values):
    for column, by_row in values.items():
        table.loc[[*by_row], column] = [*by_row.values()]
    return table


def repeat(table, times):
    return table.loc[table.index.repeat(times)].reset_index(drop=True)


def known(table, times, late_s):
    rows = repeat(table, times)
    rows["last_position"] = 1e3 * rows["timestamp"]
    rows["timestamp"] += np.tile(late_s, len(table))
    return rows


def taxiing(table):
    still_to_taxi = 5.0 * 55.0 * KNOT * np.arange(10, 0, -1) + np.tile([0.0, 3.0], 5)
    table.loc[:9, "latitude"] = table.loc[10, "latitude"] - still_to_taxi / 111_200.0
    table.loc[:9, "longitude"] = table.loc[10, "longitude"]
    table.loc[:9, "groundspeed"] = 55.0
    return table


@pytest.mark.parametrize(
    ("change", "counts", "dropped"),
    [
        (lambda t: known(t, 3, [1.2, 2.2, 3.2]), {"repeated": 2}, []),
        (
            lambda t: t.assign(last_position=1e3 * t["timestamp"] - 12_000.0 * (t.index == 8)),
            {"late": 1},
            [8],
        ),
        (lambda t: stored(t, latitude={3: NAN}, altitude={8: NAN}), {"incomplete": 2}, [3, 8]),
        *(
            (
                lambda t, rows=rows: t.assign(latitude=t["latitude"] + 0.03 * t.index.isin(rows)),
                {"position_outliers": len(rows)},
                rows,
            )
            for rows in ([10], [10, 30], [10, 13])
        ),
        (lambda t: stored(t, altitude={6: 107_700.0, 21: 0.0}), {"height_outliers": 2}, [6, 21]),
        (lambda t: stored(t, altitude=dict.fromkeys(range(10), 0.0)), {"grounded": 10}, range(10)),
        (taxiing, {"grounded": 10}, range(10)),
        (lambda t: t.drop(index=range(31, 36)), {"stretches": 1}, range(31, 36)),  # 30 s
        (lambda t: t.drop(columns=["groundspeed", "track"]), {"angles": 0}, []),
    ],
)
def test_dirt_is_found_and_dropped(table, change, counts, dropped):
    rows = len(table)
    track, report = cleaned(change(table))
    told = report.as_dict()
    for name, count in counts.items():
        assert told[name] == (count * rows if name == "repeated" else count), name
    kept = np.delete(np.arange(rows), [*dropped])
    np.testing.assert_allclose(row_times(track), 5.0 * kept, atol=1e-6)
    assert report.fixes == len(kept)


def test_wrong_speeds_and_courses_are_not_used_and_those_in_a_signed_byte_resolved(table, flight):
    course = (table["track"] + 60.0 * (table.index == 4) + 10.0 * (table.index == 9)) % 360.0
    track, report = cleaned(table.assign(groundspeed=400.0, track=course))
    assert report.speeds_rejected == len(table)
    assert np.isnan(track.groundspeed).all()
    assert report.angles_rejected == 1  # 20 deg are the limit
    assert np.flatnonzero(np.isnan(track.track_angle)).tolist() == [4]
    true = np.round(table["track"]).astype(int)
    table["track"] = (true + 128) % 256 - 128
    track, report = cleaned(table)
    assert report.angles_rejected == 0
    assert report.angles_unwrapped == int((table["track"] != true).sum()) > 0
    turned = np.exp(1j * track.track_angle)
    np.testing.assert_allclose(turned, np.exp(1j * np.radians(true)), atol=1e-9)


def test_repeated_positions_count_once(table):
    repeated = repeat(table, 5)
    repeated["timestamp"] = START_S + np.arange(len(repeated), dtype=float)
    track, report = cleaned(repeated)
    assert report.repeated == 4 * len(table)
    # filled backwards before the first change, forwards after it
    np.testing.assert_allclose(row_times(track)[:3], [4.0, 5.0, 10.0])


def test_a_gap_over_30_s_and_a_jump_that_lasts_break_the_track(table):
    track, report = cleaned(table.drop(index=range(31, 37)))
    assert report.stretches == 2
    assert track.time.size == report.fixes == 31
    assert np.diff(track.time).max() <= 30.0
    table.loc[30:, "latitude"] += 0.3
    track, report = cleaned(table)
    assert (report.position_outliers, report.stretches) == (0, 2)
    assert report.fixes == track.time.size == max(30, len(table) - 30)


def test_altitudes_that_jump_for_good_break_the_track(table):
    later = table.index >= 20
    for change in (table["altitude"] + 5e3 * later, table["altitude"].where(later, 200.0)):
        track, report = cleaned(table.assign(altitude=change))
        assert report.stretches == 2
        assert len(table) - 22 < report.fixes == track.time.size
        assert np.ptp(track.height) < 1.0


def test_a_cut_is_chosen_by_its_times_and_lasts_ten_minutes_by_default(table):
    track, report = cleaned(table, from_s=40.0, duration_s=100.0)
    times = row_times(track)
    assert (times[0], times[-1], report.duration_s) == (40.0, 140.0, 100.0)
    for settings, message in (
        ({"from_s": 5000.0}, r"in an airborne stretch \(0 to \d+ s\), got 5000"),
        ({"duration_s": 5000.0}, r"`duration_s` must be at most \d+ s here, got 5000 s"),
        ({"duration_s": 0.0}, "`duration_s`"),
        ({"duration_s": 20.0}, "at least 6 fixes, got 5"),
    ):
        with pytest.raises(ValueError, match=message):
            cleaned(table, **settings)
    # 750 s of a circle, at one place a second
    time = np.arange(0.0, 750.0, 4.0)
    north, east = 1.5e3 * np.sin(time / 15.0), 1.5e3 * np.cos(time / 15.0)
    noise = np.random.default_rng(0).normal(0.0, 5.0, (2, time.size))
    table = pandas.DataFrame(
        {
            "time": time,
            "lat": 46.0 + (north + noise[0]) / 111_200.0,
            "lon": 8.0 + (east + noise[1]) / 77_000.0,
            "altitude_m": 2000.0,
        }
    )
    _, report = cleaned(table)
    assert report.duration_s == 600.0
    assert report.stretch_s > 700.0


def test_single_rules():
    # only runs with too much wrong are stale
    wrong = np.isin(np.arange(30), [3, 13, 14])
    stale = stale_runs(np.repeat([1.0, 2.0, np.nan], 10), wrong)
    np.testing.assert_array_equal(stale, np.repeat([False, True, False], 10))
    # an honest turn has no outlier
    time = np.arange(0.0, 120.0, 10.0)
    radius, rate = 1500.0, 0.06
    circle = radius * np.stack([np.cos(rate * time), np.sin(rate * time)], axis=-1)
    assert not isolated_outliers(time, circle, 500.0, 10.0).any()


def test_recorded_tracks_have_the_dirt_that_is_known_of_them(data_folder):
    names = ("ajaccio", "noisy_spoofing", "inflight_refuelling", "airbus_tree")
    found = [clean_track(read_track(data_folder / f"adsb_flights/{x}.json.gz")) for x in names]
    (first, ajaccio), (noisy, spoofing), (fuelled, refuelling), (last, airbus) = found
    # half interpolated, stored in a signed byte
    assert ajaccio.interpolated / ajaccio.rows == pytest.approx(0.46, abs=0.01)
    assert ajaccio.angles_unwrapped > 0
    angles = ajaccio.angles_as_given + ajaccio.angles_unwrapped
    assert ajaccio.angles_rejected < 0.05 * angles
    assert ajaccio.duration_s == 600.0
    # repeats half of its positions; the captured part is no flight
    assert spoofing.repeated / spoofing.rows == pytest.approx(0.46, abs=0.01)
    assert np.degrees(noisy.latitude).max() < 49.0
    # has one groundspeed
    assert np.isnan(fuelled.groundspeed).all()
    assert refuelling.height_outliers > 0
    assert fuelled.height.max() < 15_000.0
    # falls apart at its gaps
    assert airbus.stretches > 1
    for track in (first, last):
        assert np.diff(track.time).max() <= 30.0
