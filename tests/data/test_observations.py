"""Observations of RINEX files and tables: what is read, left out, and refused."""

from datetime import datetime

import numpy as np
import pytest

from spoofgym.core.reading import FileError
from spoofgym.data.ephemerides import gps_seconds
from spoofgym.data.observations import SDS, TABLE, read_observations
from spoofgym.earth.wgs84 import SPEED_OF_LIGHT

from .test_damaged_files import mutated

TYPES_3 = ["G    4 C1C L1C D1C S1C", "C    3 C2I L2I", "            D2I", "R    1 C1C"]
FIRST, LATER = (float(gps_seconds(datetime(2024, 9, 14, 22, 0, s))) for s in (1, 2))
LINES_3 = [
    "> 2024 09 14 22 00 01.0000000  0  3",
    f"G05{21e6:14.3f}  {'':16}{-1500.0:14.3f}  {45.0:14.3f}",
    f"C20{24e6:14.3f} 7{'':16}{700.25:14.3f}",
    f"R01{19e6:14.3f}",
    "> 2024 09 14 22 00 01.5000000  4  1",
    f"{'a comment in between':60}COMMENT",
    "> 2024 09 14 22 00 02.0000000  1  3",
    f"G05{'':32}{-1499.0:14.3f}",  # no pseudorange
    f"G07{21e6 + 1:14.3f}  {'':16}{-1498.0:14.3f}",
    "C20     24000000.x00  ",  # malformed
    "> 2024 09 14 22 00 01.0000000  0  1",  # time jumps back
    f"G07{21e6 + 2:14.3f}  {'':16}{-1497.0:14.3f}",
    "> 2024 09 14 22 00 03.0000000  0  2",  # cut short
]


def head(version, label, types, scale="GPS"):
    first = f"{version:>9}           OBSERVATION DATA    M"
    lines = [f"{first:60}RINEX VERSION / TYPE", *(f"{line:60}{label}" for line in types)]
    lines.append(f"{f'  2024     9    14    22     0    1.0     {scale:>9}':60}TIME OF FIRST OBS")
    return [*lines, f"{'':60}END OF HEADER"]


HEAD_3 = head("3.04", "SYS / # / OBS TYPES", TYPES_3)


@pytest.fixture
def written(tmp_path):
    def write(lines, name="o.24o", ends="\n"):
        path = tmp_path / name
        path.write_bytes(ends.join(lines).encode())
        return path

    return write


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_version_3(written, ends):
    o = read_observations(written([*HEAD_3, *LINES_3], ends=ends))
    assert o.satellites == ("C20", "G05", "G07")
    assert o.time.tolist() == [FIRST, LATER, FIRST]
    assert (np.diff(o.segment) == [0, 1]).all()
    nan = np.nan
    ranges = [[24e6, 21e6, nan], [nan, nan, 21e6 + 1], [nan, nan, 21e6 + 2]]
    np.testing.assert_array_equal(o.pseudorange, ranges)
    assert o.range_rate[0, 1] == pytest.approx(1500.0 * SPEED_OF_LIGHT / 1575.42e6)
    assert o.range_rate[0, 0] == pytest.approx(-700.25 * SPEED_OF_LIGHT / 1561.098e6)
    absent = "without pseudorange or Doppler shift"
    assert o.left_out == {absent: 2, "of system R": 1, "events": 1, "malformed lines": 1}
    beidou = read_observations(
        written([*head("3.04", "SYS / # / OBS TYPES", TYPES_3, "BDT"), *LINES_3])
    )
    assert (beidou.time == o.time + 14.0).all()


def test_version_2_with_lines_that_go_on(written):
    types = ["     6    C1    L1    L2    P2    S1    D1"]
    names = ["G01", " 02", "G 3", *(f"G{k:02d}" for k in range(4, 15))]
    lines = [
        *head("2.11", "# / TYPES OF OBSERV", types),
        f" 24  9 14 22  0  1.0000000  0 14{''.join(names[:12])}",
        f"{'':32}{''.join(names[12:])}",
    ]
    for k in range(14):
        lines += [f"{2e7 + k:14.3f}", f"{-100.0 - k:14.3f}"]
    o = read_observations(written(lines))
    assert o.satellites == tuple(f"G{k:02d}" for k in range(1, 15))
    assert o.pseudorange[0].tolist() == [2e7 + k for k in range(14)]
    assert o.range_rate[0] == pytest.approx(
        (100.0 + np.arange(14)) * SPEED_OF_LIGHT / 1575.42e6, rel=1e-12
    )


def test_a_table_of_raw_measurements(written):
    rows = [
        "2331,597601.0,0,5,0,21e6,-1500,0.5,0.2",
        "2331,597601.0,0,5,3,21e6,-1200,0.5,0.2",  # L2
        "2331,597601.0,6,5,0,19e6,-1500,0.5,0.2",  # GLONASS
        "2331,597602.0,3,20,4,24e6,100,,",
    ]
    o = read_observations(written([",".join((*TABLE, *SDS)), *rows], "raw.csv"))
    assert o.satellites == ("C20", "G05")
    assert o.time.tolist() == [FIRST, LATER]
    assert o.range_rate[1, 0] == pytest.approx(-100.0 * SPEED_OF_LIGHT / 1268.52e6)
    assert o.sd[0, 1::2] == pytest.approx([0.5, 0.2 * SPEED_OF_LIGHT / 1575.42e6])
    assert o.left_out == {"of other systems or signals": 2}
    with pytest.raises(FileError, match="missing: doppler_hz"):
        read_observations(written([",".join(TABLE[:-1]), rows[0][:24]], "raw.csv"))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (head("3.04", "SYS / # / OBS TYPES", ["G    2 C1C L1C"]), "Doppler shifts, .* got C1C L1C"),
        (HEAD_3, "it holds no pseudorange|it must have pseudoranges"),
        (HEAD_3[:-1], "its header has no end"),
        (["garbage"], "is not a RINEX file"),
        ([HEAD_3[0].replace("3.04", "4.01")], "version 4.01, valid are 2 and 3"),
        ([HEAD_3[0].replace("OBSERVATION", "NAVIGATION ")], "it must be of observations"),
        (head("3.04", "SYS / # / OBS TYPES", TYPES_3, "GLO"), "GPS, GAL or BDT, got GLO"),
    ],
)
def test_what_can_not_be_used_is_refused(written, lines, message):
    if "END OF HEADER" in lines[-1] and lines is not HEAD_3:
        lines = [*lines, *LINES_3]
    path = written(lines)
    with pytest.raises(FileError, match=message) as caught:
        read_observations(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_damage_is_refused_by_one_error_or_left_out(written):
    path = written([*HEAD_3, *LINES_3])
    refused = 0
    for damaged in mutated(path.read_bytes(), 80, 3):
        path.write_bytes(damaged)
        try:
            o = read_observations(path)
        except FileError:
            refused += 1
        else:
            assert np.isfinite(o.time).all()
            assert o.pseudorange.shape == (len(o.time), len(o.satellites))
    assert 0 < refused < 80


@pytest.mark.filterwarnings("ignore::FutureWarning")  # of xarray
def test_georinex_reads_the_same(data_folder, written):
    georinex = pytest.importorskip("georinex")
    path = data_folder / "hksc_spoofed" / "COM8_220214_013336.obs"
    lines = path.read_text().splitlines()
    cut = [k for k, line in enumerate(lines) if line.startswith(">")][100]
    copy = written([*lines[:cut], ""], "part.obs")  # georinex stops where the time jumps back
    theirs, ours = georinex.load(copy, use="G", meas=["C1C", "D1C"]), read_observations(copy)
    assert ours.satellites == tuple(theirs.sv.values.tolist())
    ranges, shifts = (np.where(x == 0.0, np.nan, x) for x in (theirs["C1C"].values, theirs["D1C"]))
    both = np.isfinite(ranges) & np.isfinite(shifts)
    np.testing.assert_array_equal(ours.pseudorange, np.where(both, ranges, np.nan))
    length = SPEED_OF_LIGHT / 1575.42e6
    np.testing.assert_allclose(ours.range_rate, np.where(both, -length * shifts, np.nan))
