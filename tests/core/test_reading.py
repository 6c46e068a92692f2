"""Files that are small and take the machine, each in a child with a limit of memory."""

from __future__ import annotations

import gzip
import io
import json
import os
import resource
import threading
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.lib import format as npy

from spoofgym.calibration.clean_runs import map_ordered
from spoofgym.core.reading import (
    LARGEST_ARCHIVE,
    Archive,
    FileError,
    parse_array,
    parse_json,
    read_json,
    read_table,
)
from spoofgym.core.registry import parse_spec
from spoofgym.data.rinex import read_navigation
from spoofgym.data.tracks import read_track
from spoofgym.detectors.build import make_detector
from spoofgym.policies.card import LARGEST_CARD, Card
from spoofgym.simulation.engine import processors
from spoofgym.truth.scenario import make_scenario
from tools.fuzz import limit_growth

GROWTH, TIME_S = 500 << 10, 5.0  # kilobytes; of the processor


def read_in_child(read, path: Path) -> str:
    """Message of the FileError of a reader that has little memory and time."""
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            limit_growth()
            usage = resource.getrusage(resource.RUSAGE_SELF)
            start, before = time.process_time(), usage.ru_maxrss
            try:
                read(path)
                text = "read"
            except FileError as error:
                text = str(error)
            except BaseException as error:
                text = f"a fault: {error!r}"
            grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
            spent = time.process_time() - start
            if grown > GROWTH or spent > TIME_S:
                text = f"a fault: {grown} kB, {spent} s, {text}"
            os.write(theirs, text[:4000].encode())
        finally:
            os._exit(0)
    os.close(theirs)
    with os.fdopen(ours) as file:
        text = file.read()
    os.waitpid(child, 0)
    return text


SIZE = 60 << 20
BOMBS = {
    "columns.csv.gz": (b"time," + b"a," * 10**7, "at most 1000 columns"),
    "rows.csv.gz": (b"a," * 900 + b"\n" + b"1\n" * 10**5, "at most 8388608 values"),
    "hidden.csv.gz": (b'"a\n' + b'",b' * 10 + b",c" * 10**6, "columns"),
    "lists.json.gz": (b"[" + b"[]," * (SIZE // 3), "values"),
    "keys.json.gz": (json.dumps([{f"k{i}": 0} for i in range(10**5)]).encode(), "columns"),
    "deep.json.gz": (b"[" * 10**6, "is not JSON"),
    "lines.24n.gz": (b"\n" * SIZE, "at most 1,048,576 lines"),
    "ends.24n.gz": (b"\r" * SIZE, "at most 1,048,576 lines"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_small_file_that_unpacks_to_much_is_refused(name: str, tmp_path: Path) -> None:
    content, message = BOMBS[name]
    path = tmp_path / name
    path.write_bytes(gzip.compress(content, 1))
    found = read_in_child(read_navigation if "24n" in name else read_track, path)
    assert name in found
    assert message in found


def test_unneeded_columns_of_parquet_are_not_read(tmp_path: Path, monkeypatch: Any) -> None:
    pandas, parquet = pytest.importorskip("pandas"), pytest.importorskip("pyarrow.parquet")
    path, read, columns = tmp_path / "t.parquet", parquet.read_table, list[str]()
    row = {"time": 1.7e9, "lat": 47.0, "lon": 8.0, "alt": 1e4, "icao24": "4b", "big": [0] * 10**5}
    pandas.DataFrame([row]).to_parquet(path)

    def note(*args: Any, **settings: Any) -> Any:
        columns.extend(settings["columns"])
        return read(*args, **settings)

    monkeypatch.setattr(parquet, "read_table", note)
    assert read_track(path).latitude[0] == pytest.approx(np.radians(47.0))
    assert columns == ["time", "lat", "lon", "alt", "icao24"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"a": NaN}', "NaN is no number"),
        ('{"a": 1e999}', "no number that a computer holds"),
        ('{"a": ' + "9" * 400 + "}", "at most 60 digits, got 400"),
        ("[" * 1000 + "]" * 1000, "at most 100 lists and objects"),
        ("[1]", "must be an object of JSON, got list"),
        ('{"a": "\\ud800"}', "surrogates not allowed"),
        (b"\xff\xfe{}", "can't decode"),
    ],
)
def test_json_that_no_computation_can_take(text: str | bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(FileError, match=message) as caught:
        read_json(path)
    assert str(path) in str(caught.value)
    assert parse_json('{"a": [' + "[" * 90 + "]" * 91 + "}", "it")


def test_a_large_card_is_refused_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "large.json"
    path.write_bytes(b"[" + b" " * LARGEST_CARD)
    with pytest.raises(ValueError, match=r"large\.json is too large: valid are at most 4 MiB"):
        Card.load(path)


@pytest.mark.parametrize("end", ["", ",", ",,"])
def test_rows_of_a_table_may_end_with_separators_and_not_with_values(
    end: str, tmp_path: Path
) -> None:
    path = tmp_path / "x.csv"
    path.write_text("a, b\n" + "".join(f"{k}5,{k}6{end}\n" for k in range(3)))
    assert read_table(path).to_numpy().tolist() == [[5, 6], [15, 16], [25, 26]]
    path.write_text(path.read_text().replace(f"6{end}\n", "6,7\n"))
    with pytest.raises(ValueError, match="its head names 2 columns, its first row has 3"):
        read_table(path)


def test_arrays_and_archives_are_refused_from_their_headers(tmp_path: Path) -> None:
    head = io.BytesIO()
    npy.write_array_header_1_0(head, {"shape": (8 << 30,), "fortran_order": False, "descr": "<f8"})
    with pytest.raises(FileError, match="has 68719476736 bytes, and 8 are there"):
        parse_array(head.getvalue() + bytes(8))
    whole = io.BytesIO()
    np.save(whole, np.arange(6.0).reshape(2, 3))
    assert parse_array(whole.getvalue()).tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]
    with pytest.raises(FileError, match="its header is not that of an array"):
        parse_array(b"no array")
    path = tmp_path / "zeros.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("a", bytes(1 << 20))
    content = path.read_bytes()
    size = (1 << 20).to_bytes(4, "little")
    assert content.count(size) == 2  # beside the member, and in the list at the end
    path.write_bytes(content.replace(size, (LARGEST_ARCHIVE + 1).to_bytes(4, "little")))
    with pytest.raises(zipfile.BadZipFile, match="valid are 1,024 MiB"):
        Archive(path)
    path.write_bytes(content.replace(size, (10).to_bytes(4, "little")))
    with pytest.raises(zipfile.BadZipFile, match="CRC"), Archive(path) as file:
        file.read("a")


@pytest.mark.parametrize(
    ("make", "text", "message"),
    [
        (make_scenario, "zhong2025:epoch_interval_s=0", "`epoch_interval_s` must be a .* got 0"),
        (make_scenario, "zhong2025:events=3", "`events` must be settings of events or None, got 3"),
        (make_detector, "ewma:max_exclusion_s=" + "9" * 400, "`max_exclusion_s` must be .*got"),
        (make_detector, '{"name": "ewma", "smoothing": ' + "9" * 400 + "}", "at most 60 digits"),
        (make_detector, {"name": "ewma", "smoothing": 10**400}, "`smoothing` must be"),
        (make_detector, "x" * 10**6, "at most 10000 characters, got 1000000"),
        (make_detector, '{"name": "' + "x" * 10**6 + '"}', "unknown detector 'xxx"),
    ],
)
def test_settings_that_no_world_has_end_in_one_line(make: Any, text: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        make(parse_spec(text) if isinstance(text, str) else text)
    assert len(str(caught.value)) < 1500


def test_no_more_threads_are_started_than_there_are_processors() -> None:
    def work(item: int, stopped: Any) -> int:
        return threading.active_count()

    most = threading.active_count() + processors()
    assert max(map_ordered(work, range(50), 10**9)) <= most
