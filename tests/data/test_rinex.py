import gzip
import logging
import re
import warnings
from datetime import datetime

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from spoofgym.data.ephemerides import (
    SECONDS_PER_WEEK,
    Ephemerides,
    gps_seconds,
    propagate_orbits,
    screen,
)
from spoofgym.data.rinex import read_navigation
from tools.fuzz import RECORD

HEADER_2 = """\
     2.10           N: GPS NAV DATA                         RINEX VERSION / TYPE
made by hand                            20240914            PGM / RUN BY / DATE
invented, numbers rounded                                   COMMENT
                                                            END OF HEADER
"""
# Saturday evening and the first minute of the next week
G05 = RECORD
G12 = """\
12 24  9 14 23 59 44.0 2.500000000000E-04 0.000000000000E+00 0.000000000000E+00
    1.700000000000E+01 4.000000000000E+01 5.100000000000E-09-2.200000000000E+00
    1.800000000000E-06 8.000000000000E-03 7.700000000000E-06 5.153600000000E+03
    0.000000000000E+00-1.100000000000E-07-1.000000000000E+00 5.000000000000E-08
    9.500000000000E-01 2.400000000000E+02 1.300000000000E+00-8.300000000000E-09
   -1.000000000000E-10 1.000000000000E+00 2.332000000000E+03 0.000000000000E+00
    2.000000000000E+00 6.300000000000E+01-4.700000000000E-09 1.700000000000E+01
    5.990400000000E+05
"""
HEADER_3 = """\
     3.04           N: GNSS NAV DATA    M: MIXED            RINEX VERSION / TYPE
made by hand                            20240914            PGM / RUN BY / DATE
                                                            END OF HEADER
"""
R07 = """\
R07 2024 09 14 22 15 00 0.500000000000E-04 0.000000000000E+00 0.598500000000E+06
     0.120000000000E+05-0.100000000000E+01 0.000000000000E+00 0.000000000000E+00
    -0.150000000000E+05 0.200000000000E+01 0.000000000000E+00 0.500000000000E+01
     0.160000000000E+05 0.300000000000E+01 0.000000000000E+00 0.000000000000E+00
"""


def to_version_3(record, system="G"):
    first, *rest = record.splitlines()
    year, *date = first[2:17].split()
    second = int(float(first[17:22]))
    epoch = f"{int(year) + 2000} " + " ".join(f"{part:02d}" for part in [*map(int, date), second])
    lines = [f"{system}{int(first[:2]):02d} {epoch}{first[22:]}", *(" " + line for line in rest)]
    return "\n".join(lines) + "\n"


@pytest.fixture
def written(tmp_path):
    def write(text, name="hand0010.24n"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


def same(first, second):
    return all(
        np.array_equal(getattr(first, name), getattr(second, name))
        for name in Ephemerides.__dataclass_fields__
    )


PLACES = [
    *("clock_bias", "clock_drift", "clock_drift_rate"),
    *("issue", "crs", "mean_motion_correction", "mean_anomaly"),
    *("cuc", "eccentricity", "cus", "root_semi_major_axis"),
    *("toe", "cic", "node", "cis"),
    *("inclination", "crc", "perigee", "node_rate"),
    *("inclination_rate", "codes", "week", "flag"),
    *("accuracy", "health", "group_delay"),
]


def test_every_field_is_in_its_place_and_years_have_two_digits(written):
    e = read_navigation(written(HEADER_2 + G05 + G12))
    assert (e.satellite_id.tolist(), e.satellite_ids) == (["G05", "G12"], ("G05", "G12"))
    numbers = [re.findall(r"-?\d\.\d{12}[DE][+-]\d\d", record) for record in (G05, G12)]
    columns = [
        [float(each.replace("D", "E")) for each in pair] for pair in zip(*numbers, strict=False)
    ]
    places = dict(zip(PLACES, columns, strict=False))
    toe, week = (np.array(places.pop(name)) for name in ("toe", "week"))
    for unused in ("codes", "flag", "accuracy"):
        places.pop(unused)
    places["time_of_ephemeris"] = (week * SECONDS_PER_WEEK + toe).tolist()
    clock = datetime(2024, 9, 14, 22), datetime(2024, 9, 14, 23, 59, 44)
    places["time_of_clock"] = [*map(gps_seconds, clock)]
    for name, values in places.items():
        assert getattr(e, name).tolist() == values, name
    assert places.keys() | {"satellite_id"} == set(Ephemerides.__dataclass_fields__)
    assert (e.root_semi_major_axis[0], e.health[1], week[1]) == (5153.7, 63.0, 2332.0)
    for year, saturday in ((1980, 13), (1999, 11), (2000, 16)):
        epoch = f" 5 {year % 100:02d}  9 {saturday}"
        e = read_navigation(written(HEADER_2 + G05.replace(" 5 24  9 14", epoch)))
        assert e.time_of_clock.tolist() == [gps_seconds(datetime(year, 9, saturday, 22))]
        assert abs(e.time_of_ephemeris - e.time_of_clock)[0] <= SECONDS_PER_WEEK / 2
    e = read_navigation(written(HEADER_2 + G05 + G12 + G05 + G05))
    kept, report = screen(e)
    assert (len(e), len(kept)) == (4, 2)
    assert (report.records, report.duplicates, report.unhealthy) == (4, 2, 1)


def test_version_3_says_the_same_and_other_constellations_are_left_out_and_told(written, caplog):
    second = read_navigation(written(HEADER_2 + G05 + G12))
    text = HEADER_3 + R07 + to_version_3(G12, "E") + to_version_3(G05) + R07 + to_version_3(G12)
    with caplog.at_level(logging.INFO, logger="spoofgym"):
        assert same(second, read_navigation(written(text)))
    assert "E 1, R 2" in caplog.text


def test_version_4_gives_its_legacy_orbits_and_leaves_out_all_other_frames(written):
    g05, g12 = to_version_3(G05), to_version_3(G12)
    frames = {
        "STO G05 LNAV": "    2024 09 14 22 00 00 GPUT\n     0.594E+06 0.1D-08 0.1D-14 0.0D+00\n",
        "EPH G05 LNAV": g05,
        "EPH G05 CNAV": g05 + "     0.1E+01\n",
        "ION G05 LNAV": "    2024 09 14 22 00 00 0.1E-07 0.1E-07 0.1E-07\n     0.1E+06\n",
        "EPH R07 FDMA": R07,
        "EPH C12 CNV1": to_version_3(G12, "C") + "     0.1E+01\n",
        "EPH G12 LNAV": g12,
        "EOP J01 CNAV": "    2024 09 14 22 00 00 0.1E-07\n     0.1E+06\n     0.1E+06\n",
    }
    text = "".join(f"> {title}\n{lines}" for title, lines in frames.items())
    want = read_navigation(written(HEADER_2 + G05 + G12))
    path = written(HEADER_3.replace("3.04", "4.01") + text)
    assert same(read_navigation(path), want)
    assert same(read_navigation(path, "GC"), want)


def test_a_blank_field_drops_a_record_only_where_orbits_need_it(written):
    for field in ("-0.150000000000D-03", " 0.630000000000D+02-0.9", "-0.110000000000D-07"):
        found = read_navigation(written(HEADER_2 + G05.replace(field[:19], 19 * " ", 1)))
        assert found.root_semi_major_axis.tolist() == [5153.7]
    blank = written(HEADER_2 + G12 + G05.replace(" 0.700000000000D+00", 19 * " "))
    with pytest.warns(RuntimeWarning, match=r"line 13: `mean_anomaly` must be a number, got ''"):
        assert read_navigation(blank).satellite_ids == ("G12",)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("\n", "\r\n"),  # line ends of Windows
        ("D+", "d+"),
        ("D-", "E-"),
        (" 0.", "  ."),  # no digit before the point
        ("0.590400000000D+06 0.400000000000D+01", "0.590400000000D+06"),  # no fit interval
        ("0.590400000000D+06 0.400000000000D+01", "0.590400000000D+06" + " " * 57),
        ("0.233100000000D+04 0.000000000000D+00\n", "0.233100000000D+04\n"),  # a line ends early
        ("0.233100000000D+04", "0.283000000000D+03"),  # week number modulo 1024
        ("\n", "  \n"),
        (" 5 24  9 14 22  0  0.0", "05 24 09 14 22 00 00.0"),
        (" 5 24  9 14 22  0  0.0", " 5 24  9 14 21 59 60.0"),
    ],
)
def test_habits_of_writers(written, old, new):
    plain = read_navigation(written(HEADER_2 + G05 + G05.replace(" 5 24", " 7 24")))
    assert old in G05
    record = G05.replace(old, new)
    header = HEADER_2.replace("\n", new) if old == "\n" else HEADER_2
    other = record.replace(record[:5], " 7 24", 1)
    assert same(read_navigation(written(header + record + other)), plain)


@pytest.mark.filterwarnings("error")
def test_joined_files_comments_marks_and_padding_lose_no_record(written, tmp_path):
    comment = f"{'RINEX FILE SPLICE':60}COMMENT\n"
    plain = read_navigation(written(HEADER_2 + G05 + G12))
    joined = HEADER_2 + comment + G05 + comment + HEADER_2 + G12 + "\x1a\n" + "\0" * 99
    (tmp_path / "joined.24n").write_bytes(b"\xef\xbb\xbf" + joined.encode())
    assert same(read_navigation(tmp_path / "joined.24n"), plain)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("".join(G05.splitlines(True)[5:]), "", "line 13: a record has 8 lines, got 5"),
        (
            "0.700000000000D+00",
            "0.7000000x0000D+00",
            "line 13: `mean_anomaly` must be a number, got",
        ),
        ("0.120000000000D-01", "0.120000000000D+00", r"`eccentricity` .* 0 to 0\.03, got 0\.12"),
        ("0.515370000000D+04", "0.000000000000D+00", "`root_semi_major_axis` .* 2530 to 8192, got"),
        ("0.597600000000D+06", "0.999999999999D+09", "`second_of_week` .* 0 to 604800, got 1e"),
        ("0.965000000000D+00", "               nan", "must be finite, got"),
        (" 0.0-0.15", "1e99-0.15", "line 13: the epoch must be a date up to the year 2099"),
        (" 5 24  9 14", " 5 24  9 13", "line 13: .* within 6 h of the epoch, got 24 h"),
        (" 5 24", "-5 24", "line 13: the satellite must be 1 to 63, got '-5'"),
        (" 5 24", "G5 24", "line 13: the satellite must be 1 to 63, got 'G5'"),
        (
            "24  9 14",
            "24 x9 14",
            "line 13: the epoch must be a date up to the year 2099, .* got '24 x",
        ),
        ("24  9 14", "24 13 14", "line 13: the epoch must be a date .* got '24 13 14 22"),
        ("0.965000000000D+00", "0.307000000000D+00", r"`inclination` .* 0\.7 to 1\.2, got 0\.307"),
    ],
)
def test_malformed_records_are_left_out_with_a_warning(written, old, new, said):
    path = written(HEADER_2 + G12 + G05.replace(old, new))
    with pytest.warns(RuntimeWarning, match=f"1 malformed GPS records .*{said}"):
        e = read_navigation(path)
    assert e.satellite_ids == ("G12",)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is not a RINEX file"),
        ("#cP2010  7  1  0  0  0.00000000      96 ORBIT IGS05 HLM  IGS\n", "begins with '#cP2010"),
        (HEADER_2.replace("N: GPS NAV DATA ", "OBSERVATION DATA"), "got type 'OBSERVATION DATA'"),
        (HEADER_3.replace("3.04", "5.00"), "version 5.00, valid are 2, 3 and 4"),
        (HEADER_2[: HEADER_2.index("        END")] + "\n" + G05, "header has no end"),
        (HEADER_2 + G05[:99], r"1 malformed GPS records \(the first at line 5: a record has 8"),
        (HEADER_3 + R07, "no usable GPS satellite: 0 malformed GPS records, 1 records of other"),
        (
            HEADER_3.replace("3.04", "4.01") + "> EPH G05 CNAV\n" + to_version_3(G05),
            "0 malformed GPS records, 1 records of other constellations or messages",
        ),
        (HEADER_3 + G05, "line 4: a record must begin with the letter of its system, got ' '"),
        (HEADER_2 + G05.partition("\n")[2], "line 5: a record has 8 lines, got 7"),
    ],
)
def test_other_files_are_refused(written, text, said):
    path = written(text)
    with pytest.raises(ValueError, match=said) as caught:
        read_navigation(path)
    assert path.name in str(caught.value)


def test_compressed_and_missing_files(tmp_path, written):
    packed = tmp_path / "hand0010.24n.gz"
    packed.write_bytes(gzip.compress((HEADER_2 + G05).encode()))
    assert same(read_navigation(str(packed)), read_navigation(written(HEADER_2 + G05)))
    packed.write_bytes(b"\x1f\x9d\x90")
    with pytest.raises(ValueError, match="unpack it first"):
        read_navigation(packed)
    with pytest.raises(FileNotFoundError, match=r"nowhere\.24n"):
        read_navigation(tmp_path / "nowhere.24n")


GEORINEX = {
    **{"health": "health", "issue": "IODE", "group_delay": "TGD", "eccentricity": "Eccentricity"},
    **{"clock_bias": "SVclockBias", "clock_drift": "SVclockDrift"},
    **{"clock_drift_rate": "SVclockDriftRate", "root_semi_major_axis": "sqrtA"},
    **{"mean_anomaly": "M0", "mean_motion_correction": "DeltaN", "perigee": "omega"},
    **{"node": "Omega0", "node_rate": "OmegaDot", "inclination": "Io", "inclination_rate": "IDOT"},
    **{name.lower(): name for name in ("Cuc", "Cus", "Cic", "Cis", "Crc", "Crs")},
}


@pytest.mark.parametrize(
    ("name", "records"),
    [
        ("gnss_broadcast/brdc1820.10n", 421),
        ("gnss_broadcast/brdc3050.12n", 423),
        ("gnss_broadcast/07590920.05n", 162),
        ("ublox_walk/walk_convbin.nav", 4),
    ],
)
def test_real_files_as_georinex_reads_them(data_folder, name, records):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of xarray, about georinex' use of it
        georinex = pytest.importorskip("georinex")
        expected = georinex.load(data_folder / name, use="G")
    e = read_navigation(data_folder / name)
    assert len(e) == records == int(expected.Toe.notnull().sum())
    times, satellites = expected.time.to_index(), expected.sv.to_index()
    dates = np.datetime64("1980-01-06") + e.time_of_clock.astype("timedelta64[s]")
    index = times.get_indexer(dates), satellites.get_indexer(e.satellite_id)
    for ours, theirs in GEORINEX.items():
        assert_array_equal(getattr(e, ours), expected[theirs].values[index], ours)
    toe = expected.GPSWeek.values * SECONDS_PER_WEEK + expected.Toe.values
    assert_array_equal(e.time_of_ephemeris, toe[index])


def test_galileo_and_beidou_are_read_where_they_are_wanted(written):
    gps = to_version_3(G05)
    both = to_version_3(G05, "E") + to_version_3(G05, "C").replace("C05", "C20")
    path = written(HEADER_3 + gps + both + to_version_3(G05, "C"))  # C05 is geostationary
    assert read_navigation(path).satellite_ids == ("G05",)
    e = read_navigation(path, "GEC")
    assert e.satellite_id.tolist() == ["G05", "E05", "C20"]
    assert (e.time_of_ephemeris - e.time_of_ephemeris[0]).tolist() == [0.0, 0.0, 14.0]
    assert (e.time_of_clock - e.time_of_clock[0]).tolist() == [0.0, 0.0, 14.0]
    a, b, c = propagate_orbits(e, [0, 1, 2], 0.0).position_e
    assert_array_equal(a, b)
    assert np.linalg.norm(c - a) < 20.0  # the Earth turns a little slower there
    moved = propagate_orbits(e, [0, 1], 7200.0).position_e
    n = np.sqrt(np.array([3.986005e14, 3.986004418e14]) / 5153.7**6)
    assert np.linalg.norm(moved[1] - moved[0]) == pytest.approx(
        (n[0] - n[1]) * 7200.0 * 5153.7**2, rel=0.05
    )
    source = "0.200000000000D-09 0.100000000000D+01"
    assert source in both
    assert read_navigation(path, "E").group_delay[0] == -1.1e-8
    other = both.replace(source, "0.200000000000D-09 0.513000000000D+03")  # I/NAV
    other = other.replace("0.630000000000D+02\n     0.59", "0.220000000000D-08\n     0.59")
    assert read_navigation(written(HEADER_3 + other), "E").group_delay[0] == 2.2e-9
