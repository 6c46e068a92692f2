"""RINEX navigation files, versions 2 and 3: the GPS broadcast ephemerides in them.

The format is that of "RINEX: The Receiver Independent Exchange Format", versions 2.11 and 3.05,
sections on the GPS navigation message: a header, then eight lines of fixed columns to a record.

The package georinex reads these files too, and the tests compare with it.  It isn't used here,
since version 1.16.2 drops every record of a satellite of which a version 2 file holds two records
of one epoch, takes a wrong health from a line that ends early, and fills a cut record with NaN.
"""

from __future__ import annotations

import gzip
import logging
import math
import os
import warnings
from collections import Counter
from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..sim.broadcast import (
    SECONDS_PER_WEEK,
    BroadcastConstellation,
    Ephemerides,
    gps_seconds,
)
from ..sim.screening import ScreeningReport, screen

_LOGGER = logging.getLogger(__name__)

GZIP_MAGIC = b"\x1f\x8b"
COMPRESS_MAGIC = b"\x1f\x9d"
FIELD_WIDTH = 19
LINES_PER_RECORD = 8
FIELDS = {
    **dict(clock_bias=(0, 1), clock_drift=(0, 2), clock_drift_rate=(0, 3)),
    **dict(issue=(1, 0), crs=(1, 1), mean_motion_correction=(1, 2), mean_anomaly=(1, 3)),
    **dict(cuc=(2, 0), eccentricity=(2, 1), cus=(2, 2), root_semi_major_axis=(2, 3)),
    **dict(second_of_week=(3, 0), cic=(3, 1), node=(3, 2), cis=(3, 3)),
    **dict(inclination=(4, 0), crc=(4, 1), perigee=(4, 2), node_rate=(4, 3)),
    **dict(inclination_rate=(5, 0), health=(6, 1), group_delay=(6, 2)),
}
"""Line and column of the fields of a record; in line 0 the satellite and epoch are column 0."""


class _Layout(NamedTuple):
    """Where a version of the format has its columns."""

    satellite: slice
    date: tuple[slice, ...]  # year, month, day, hour, minute, second
    first_column: int


_LAYOUTS = {
    2: _Layout(
        slice(0, 2),
        (slice(3, 5), slice(6, 8), slice(9, 11), slice(12, 14), slice(15, 17), slice(17, 22)),
        first_column=3,
    ),
    3: _Layout(
        slice(1, 3),
        (slice(4, 8), slice(9, 11), slice(12, 14), slice(15, 17), slice(18, 20), slice(21, 23)),
        first_column=4,
    ),
}


def read_navigation(path: str | os.PathLike[str]) -> Ephemerides:
    """GPS records of a RINEX navigation file, in the order of the file.

    Records of other constellations are left out, and their number is logged.  Malformed records
    (cut short, a field that is no number or is out of range) are left out with one warning.  The
    calendar date of a record tells its week, so that the week number field isn't needed.
    """
    path = Path(path)
    lines = _read_lines(path)
    version = _checked_version(lines[0] if lines else "", path)
    satellites: list[str] = []
    records: list[dict[str, float]] = []
    others: Counter[str] = Counter()
    malformed: list[str] = []
    for number, block in _blocks(lines, path):
        system = block[0][0] if version == 3 else "G"
        if system != "G":
            others[system] += 1
            continue
        try:
            satellite, record = _parse(block, _LAYOUTS[version])
        except ValueError as error:
            malformed.append(f"line {number}: {error}")
            continue
        satellites.append(satellite)
        records.append(record)
    if others:
        told = ", ".join(f"{system} {count}" for system, count in sorted(others.items()))
        _LOGGER.info("%s: records of other constellations ignored: %s", path, told)
    if not records:
        raise ValueError(
            f"{path} holds no usable GPS satellite: {len(malformed)} malformed GPS records, "
            f"{sum(others.values())} records of other constellations"
        )
    if malformed:
        warnings.warn(
            f"{path}: {len(malformed)} malformed GPS records left out, the first at {malformed[0]}",
            RuntimeWarning,
            stacklevel=2,
        )
    columns = {name: np.array([record[name] for record in records]) for name in records[0]}
    return Ephemerides(satellite_id=np.array(satellites), **columns)


def load_broadcast(
    path: str | os.PathLike[str], start: float | datetime
) -> tuple[BroadcastConstellation, ScreeningReport]:
    """The constellation of a RINEX navigation file, its records screened.

    `start`: time 0 of the simulation: GPS seconds [s], or a date as `gps_seconds` takes it.
    """
    kept, report = screen(read_navigation(path))
    if isinstance(start, datetime):
        start = gps_seconds(start)
    return BroadcastConstellation(kept, start), report


def _read_lines(path: Path) -> list[str]:
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    content = path.read_bytes()
    if content.startswith(COMPRESS_MAGIC):
        raise ValueError(f"{path} is compressed by `compress`; unpack it first (`gzip -d` does)")
    if content.startswith(GZIP_MAGIC):
        content = gzip.decompress(content)
    return content.decode("ascii", errors="replace").splitlines()


def _checked_version(line: str, path: Path) -> int:
    """The version of a navigation file by its first line, 2 or 3."""
    if line[60:80].rstrip() != "RINEX VERSION / TYPE":
        raise ValueError(f"{path} is not a RINEX file: it begins with {line[:80]!r}")
    kind = line[20:40].strip()
    try:
        version = int(float(line[:9]))
    except ValueError:
        raise ValueError(f"{path} has no RINEX version, got {line[:9]!r}") from None
    if version not in _LAYOUTS:
        raise ValueError(f"{path} is of RINEX version {line[:9].strip()}, valid are 2 and 3")
    if not kind.startswith("N"):
        raise ValueError(f"{path} is not a navigation file of GPS (N), got type {kind!r}")
    return version


def _blocks(lines: list[str], path: Path) -> Iterator[tuple[int, list[str]]]:
    """Line number and lines of each record: the first columns of its later lines are blank."""
    ends = (k for k, line in enumerate(lines) if line[60:].strip() == "END OF HEADER")
    end = next(ends, None)
    if end is None:
        raise ValueError(f"{path} is cut short: its header has no end")
    number, block = 0, list[str]()
    for k, line in enumerate(lines[end + 1 :], start=end + 2):
        if not line.strip():
            continue
        if line[:3].strip():
            if block:
                yield number, block
            number, block = k, []
        block.append(line)
    if block:
        yield number, block


def _parse(block: list[str], layout: _Layout) -> tuple[str, dict[str, float]]:
    """Satellite and fields of a record; ValueError says what is wrong with it."""
    if len(block) != LINES_PER_RECORD:
        raise ValueError(f"a record has {LINES_PER_RECORD} lines, got {len(block)}")
    satellite = f"G{int(block[0][layout.satellite]):02d}"
    record = {
        name: _number(block[line], layout.first_column + FIELD_WIDTH * column)
        for name, (line, column) in FIELDS.items()
    }
    second_of_week = record.pop("second_of_week")
    if not 0.0 <= second_of_week <= SECONDS_PER_WEEK:
        raise ValueError(f"the time of ephemeris must be within a week, got {second_of_week}")
    if not 0.0 <= record["eccentricity"] < 1.0:
        raise ValueError(
            f"the eccentricity must be within 0 <= e < 1, got {record['eccentricity']}"
        )
    if not record["root_semi_major_axis"] > 0.0:
        raise ValueError(f"sqrt A must be positive, got {record['root_semi_major_axis']}")
    time_of_clock = gps_seconds(_date([block[0][part] for part in layout.date]))
    half = 0.5 * SECONDS_PER_WEEK
    lead = (second_of_week - time_of_clock + half) % SECONDS_PER_WEEK - half
    record["time_of_clock"] = time_of_clock
    record["time_of_ephemeris"] = time_of_clock + lead
    return satellite, record


def _number(line: str, column: int) -> float:
    text = line[column : column + FIELD_WIDTH]
    value = float(text.upper().replace("D", "E"))
    if not math.isfinite(value):
        raise ValueError(f"a field must be finite, got {text!r}")
    return value


def _date(parts: list[str]) -> datetime:
    """Date from its parts; years of two digits are those of 1980 to 2079."""
    year, month, day, hour, minute = map(int, parts[:5])
    if year < 100:
        year += 1900 if year >= 80 else 2000
    clock = timedelta(hours=hour, minutes=minute, seconds=float(parts[5]))
    return datetime(year, month, day) + clock
