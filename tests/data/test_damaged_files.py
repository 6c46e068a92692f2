"""Damaged files are refused by one error, or what is read of them is within physical ranges."""

import gzip
import json
import tracemalloc
import warnings
from contextlib import suppress

import numpy as np
import pytest

from spoofgym.core.reading import MOST_CELLS, FileError, read_file
from spoofgym.data.cleaning import clean_track
from spoofgym.data.ephemerides import propagate_orbits, screen
from spoofgym.data.rinex import RANGES, read_navigation
from spoofgym.data.tracks import read_track

from .test_rinex import G05, G12, HEADER_2, HEADER_3, to_version_3

MUTATIONS = 60
"""Of each kind of file; thousands were run once."""
DIGITS = b"0123456789"
NONSENSE = (
    *(b"nan", b"inf", b"-inf", b"1e999", b"-1e30", b"9" * 40, b"9" * 5000, b"\x00", b"\xff\xfe"),
    *(b"[" * 9000, b'{"a":' * 9000, b"null", b"{}", b"true", b'"', b",", b"\n", b"\r", b"-", b""),
)


def mutated(content, count, seed):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        copy = bytearray(content)
        for _ in range(rng.integers(1, 4)):
            a, b = sorted(rng.integers(0, len(copy) + 1, 2).tolist())
            b = min(b, a + int(rng.integers(1, 40)))
            at = int(rng.integers(len(copy))) if copy else 0
            kind = rng.integers(7)
            if kind == 0 and copy:
                copy[at] ^= 1 << int(rng.integers(8))
            elif kind == 1 and copy:
                places = [k for k, byte in enumerate(copy) if byte in DIGITS] or [at]
                copy[rng.choice(places)] = rng.choice(list(DIGITS))
            elif kind == 2:
                copy[a:b] = rng.bytes(b - a)
            elif kind == 3:
                del copy[a:b]
            elif kind == 4:
                copy[at:at] = copy[a:b]
            elif kind == 5:
                copy[a:b] = NONSENSE[rng.integers(len(NONSENSE))]
            elif rng.random() < 0.3:
                del copy[at:]
        yield bytes(copy)


def check_navigation(path):
    """Of a file that is read: its orbits are ones that a satellite of GPS can have."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r".*malformed GPS records left out", RuntimeWarning)
        records = read_navigation(path)
    for name, (low, high) in RANGES.items():
        if name != "second_of_week":
            assert (getattr(records, name) >= low).all()
            assert (getattr(records, name) <= high).all()
    century = 120 * 366 * 86_400.0
    for time in (records.time_of_clock, records.time_of_ephemeris):
        assert ((time >= -302_400.0) & (time < century)).all()
    orbits = propagate_orbits(records, np.arange(len(records)), 0.0)
    radius = np.linalg.norm(orbits.position_e, axis=-1)
    assert ((radius > 6.0e6) & (radius < 7.0e7)).all()
    assert (np.linalg.norm(orbits.velocity_e, axis=-1) < 9.0e3).all()
    kept, _ = screen(records)
    assert 0 < len(kept) <= len(records)


def check_track(path):
    """Of a file that is read: its values are ones that an aircraft can have."""
    raw = read_track(path)
    assert np.isfinite(raw.time).all()
    assert (np.diff(raw.time) >= 0.0).all()
    assert ((raw.time >= 0.0) & (raw.time < 4.2e9)).all()
    for name, (low, high) in {
        "position_time": (0.0, 4.2e9),
        "latitude": (-np.pi / 2.0, np.pi / 2.0),
        "longitude": (-np.pi, 2.0 * np.pi),
        "altitude": (-2_000.0, 50_000.0),
        "groundspeed": (0.0, 3_000.0),
        "vertical_rate": (-500.0, 500.0),
        "track_deg": (-360.0, 360.0),
    }.items():
        value = getattr(raw, name)
        assert (np.isnan(value) | ((value >= low) & (value <= high))).all()
    with suppress(ValueError):  # too little may be left of it
        track, _ = clean_track(raw)
        assert np.isfinite([track.time, track.latitude, track.longitude, track.height]).all()


def check_damage(path, check, seed):
    """Each is refused by its name, or sound."""
    said = []
    for damaged in mutated(path.read_bytes(), MUTATIONS, seed):
        path.write_bytes(damaged)
        try:
            check(path)
        except FileError as error:
            said.append(str(error))
    assert all(str(path) in each for each in said)
    assert 0 < len(said) < MUTATIONS  # it was damage of both kinds


@pytest.mark.parametrize("name", ["2.24n", "3.24n", "2.24n.gz"])
def test_damaged_navigation_files(tmp_path, name):
    text = HEADER_2 + G05 + G12 + G05.replace(" 5 24", " 7 24")
    if name.startswith("3"):
        text = HEADER_3 + to_version_3(G05) + to_version_3(G12)
    path = tmp_path / name
    path.write_bytes(gzip.compress(text.encode(), mtime=0) if ".gz" in name else text.encode())
    check_damage(path, check_navigation, 1)


@pytest.mark.parametrize("reader", [read_navigation, read_track])
def test_gzip_data_that_are_cut_or_damaged_or_a_bomb(tmp_path, reader, monkeypatch):
    path, content = tmp_path / "file.json.gz", gzip.compress((HEADER_2 + G05).encode())
    for damaged in (content[: len(content) // 2], content[:-9] + b"x" + content[-8:]):
        path.write_bytes(damaged)
        with pytest.raises(FileError, match=r"file\.json\.gz: its gzip data are damaged or cut"):
            reader(path)
    path.write_bytes(gzip.compress(bytes(5 * 2**22)))
    monkeypatch.setattr("spoofgym.core.reading.LARGEST_SIZE", 2**22)
    tracemalloc.start()
    try:
        with pytest.raises(FileError, match=r"file\.json\.gz is too large: .* 4 MiB unpacked"):
            reader(path)
        assert tracemalloc.get_traced_memory()[1] < 4 * 2**22
    finally:
        tracemalloc.stop()


def test_the_largest_file_deep_json_and_huge_numbers(tmp_path, monkeypatch):
    pytest.importorskip("pandas")
    path = tmp_path / "t.json"
    for text in ("[" * 10**6, '{"a":' * 10**6, "[" + "9" * 10**6 + "]", "[1e999]", "{"):
        path.write_text(text)
        with pytest.raises(FileError, match=r"t\.json"):
            read_track(path)
    path.write_text(json.dumps([{"time": 0.0, "lat": 0.0, "lon": 0.0, "alt": 10**400}]))
    with pytest.raises(FileError, match=r"t\.json .* a number has at most 60 digits"):
        read_track(path)
    monkeypatch.setattr("spoofgym.core.reading.LARGEST_SIZE", 100)
    for pack in (bytes, gzip.compress):
        path.write_bytes(pack(bytes(100)))
        assert read_file(path) == bytes(100)
        path.write_bytes(pack(bytes(101)))
        with pytest.raises(FileError, match="too large"):
            read_file(path)


def test_a_parquet_file_of_too_many_values_is_not_read(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "t.parquet"
    rows = MOST_CELLS + 1
    parquet.write_table(pyarrow.table({"time": pyarrow.array(np.zeros(rows))}), path)
    assert path.stat().st_size < 8 * MOST_CELLS / 100
    with pytest.raises(FileError, match=f"at most {rows - 1} values, got {rows}"):
        read_track(path)
