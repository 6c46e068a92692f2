"""RINEX navigation files, versions 2, 3 and 4: the broadcast ephemerides in them.

The format is that of "RINEX: The Receiver Independent Exchange Format", versions 2.11, 3.05 and
4.01, sections on navigation messages: a header, then eight lines of fixed columns to a record, in
version 4 below a line with its kind, of which the legacy ones (LNAV) are read. Records of Galileo
and BeiDou have the orbit and the clock of GPS in the same columns, on other scales of time.

The package georinex reads these files too, and the tests compare with it.  It isn't used here,
since it drops records that share an epoch, and misreads lines that end early.
"""

from __future__ import annotations

import logging
import math
import os
import re
import warnings
from codecs import BOM_UTF8 as BOM
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from datetime import datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..core.reading import FileError, read_lines
from ..core.registry import require
from .ephemerides import BEIDOU_LAG, ORBIT_FIELDS, SECONDS_PER_WEEK, Ephemerides, gps_seconds

_LOGGER = logging.getLogger(__name__)

HEADED = re.compile(r".{60}[A-Z /#]*[A-Z]{3}")  # a line of a header, by its label
FIELD_WIDTH = 19
LINES_PER_RECORD = 8
LAST_SATELLITE = 63  # largest number of a GPS satellite, IS-GPS-200 table 3-I
LAST_YEAR = 2099
LARGEST_LEAD = 6 * 3600.0  # of the time of an ephemeris on that of its clock [s]
FIELDS = {
    **dict(clock_bias=(0, 1), clock_drift=(0, 2), clock_drift_rate=(0, 3)),
    **dict(issue=(1, 0), crs=(1, 1), mean_motion_correction=(1, 2), mean_anomaly=(1, 3)),
    **dict(cuc=(2, 0), eccentricity=(2, 1), cus=(2, 2), root_semi_major_axis=(2, 3)),
    **dict(second_of_week=(3, 0), cic=(3, 1), node=(3, 2), cis=(3, 3)),
    **dict(inclination=(4, 0), crc=(4, 1), perigee=(4, 2), node_rate=(4, 3)),
    **dict(inclination_rate=(5, 0), health=(6, 1), group_delay=(6, 2)),
}  # line and column of the fields of a record; in line 0 the satellite and epoch are column 0
DISPENSABLE = FIELDS.keys() - {*ORBIT_FIELDS, "second_of_week"}  # 0 where they are blank


def _compute_signed_range(bits: int, exponent: int, unit: float = 1.0) -> tuple[float, float]:
    """Range of a number in two's complement; files round it, which may lead just outside."""
    largest = 2.0 ** (bits - 1 + exponent) * unit * (1.0 + 1e-9)
    return -largest, largest


# Valid values of the fields: what the bits of the message hold, or its narrower effective range
# (IS-GPS-200, tables 20-I and 20-III); angles of one turn either way, since writers differ. The
# inclination is that of the orbits flown, some 0.96: in semicircles it would be 0.3.
RANGES = {
    **dict(clock_bias=_compute_signed_range(22, -31), clock_drift=_compute_signed_range(16, -43)),
    **dict(
        clock_drift_rate=_compute_signed_range(8, -55), group_delay=_compute_signed_range(8, -31)
    ),
    **dict(health=(0.0, 63.0), issue=(0.0, 255.0), second_of_week=(0.0, SECONDS_PER_WEEK)),
    **dict(root_semi_major_axis=(2530.0, 8192.0), eccentricity=(0.0, 0.03)),
    **dict.fromkeys(("mean_anomaly", "perigee", "node"), (-2.0 * math.pi, 2.0 * math.pi)),
    **dict(inclination=(0.7, 1.2), inclination_rate=_compute_signed_range(14, -43, math.pi)),
    **dict(
        node_rate=_compute_signed_range(24, -43, math.pi),
        mean_motion_correction=_compute_signed_range(16, -43, math.pi),
    ),
    **dict.fromkeys(("cuc", "cus", "cic", "cis"), _compute_signed_range(16, -29)),
    **dict.fromkeys(("crc", "crs"), _compute_signed_range(16, -5)),
}
# The wider of the ranges of Galileo (OS SIS ICD, tables 66 to 75; two orbits are eccentric) and
# BeiDou (B1I ICD, tables 5-8 to 5-11) where they are wider than those of GPS.
WIDER_RANGES = RANGES | {
    **dict(clock_bias=_compute_signed_range(31, -34), clock_drift=_compute_signed_range(21, -46)),
    **dict(group_delay=_compute_signed_range(10, -32), eccentricity=(0.0, 0.2)),
    **dict(health=(0.0, 511.0), issue=(0.0, 1023.0)),
    **dict.fromkeys(("crc", "crs"), _compute_signed_range(18, -6)),
}
GEOSTATIONARY = frozenset(f"C{k:02d}" for k in (*range(1, 6), *range(59, 64)))
"""Satellites of BeiDou whose records are in axes of their own (B1I ICD, table 5-11)."""


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


def read_navigation(path: str | os.PathLike[str], systems: str = "G") -> Ephemerides:
    """Records of a RINEX navigation file of GPS, or of any `systems` of "GEC", in its order.

    Records of other constellations, and of geostationary satellites, are left out, and their number
    is logged.  Malformed records (cut short, a field that is no number or is out of range) are left
    out with one warning.  The calendar date of a record gives its week, so that the week number
    field isn't needed.  A `spoofgym.core.reading.FileError` says why the file can't be read.
    """
    path = Path(path)
    lines = read_text(path)
    version = check_version(lines[0] if lines else "", path, (2, 3, 4))
    if not (kind := lines[0][20:40].strip()).startswith("N"):
        raise FileError(f"{path} is not a navigation file of GPS (N), got type {kind!r}")
    others: Counter[str] = Counter()
    if version == 4:
        version, lines = 3, _blank_other_frames(lines, others)
    wanted = "GPS" if systems == "G" else " ".join(systems)
    satellites: list[str] = []
    records: list[dict[str, float]] = []
    malformed, first = 0, ""
    for number, block in _blocks(lines, path):
        system = block[0][0] if version == 3 else "G"
        if (system != " " and system not in systems) or block[0][:3] in GEOSTATIONARY:
            others[system] += 1
            continue
        try:
            satellite, record = _parse(block, _LAYOUTS[version], system)
        except ValueError as error:
            malformed, first = malformed + 1, first or f"line {number}: {error}"
            continue
        satellites.append(satellite)
        records.append(record)
    if others:
        ignored = ", ".join(f"{system} {count}" for system, count in sorted(others.items()))
        _LOGGER.info("%s: records of other constellations or messages: %s", path, ignored)
    if not records:
        raise FileError(
            f"{path} holds no usable {wanted} satellite: {malformed} malformed {wanted} records"
            f"{first and f' (the first at {first})'}, "
            f"{sum(others.values())} records of other constellations or messages"
        )
    if malformed:
        warnings.warn(
            f"{path}: {malformed} malformed {wanted} records left out, the first at {first}",
            RuntimeWarning,
            stacklevel=2,
        )
    columns = {name: np.array([record[name] for record in records]) for name in records[0]}
    return Ephemerides(satellite_id=np.array(satellites), **columns)


def read_ionosphere(path: str | os.PathLike[str]) -> tuple[float, ...] | None:
    """Coefficients alpha 0 to 3 and beta 0 to 3 of GPS's model of the ionosphere in the header of a
    navigation file of version 2 or 3; None where it has not all of them."""
    found: dict[str, list[float]] = {}
    for line in read_text(Path(path)):
        if (label := line[60:].strip()) == "END OF HEADER":
            break
        for which, old, new in (("alpha", "ION ALPHA", "GPSA"), ("beta", "ION BETA", "GPSB")):
            first = 2 if label == old else 5
            if label == old or (label == "IONOSPHERIC CORR" and line.startswith(new)):
                fields = (line[first + 12 * k : first + 12 * k + 12] for k in range(4))
                with suppress(ValueError):
                    found[which] = [float(x.upper().replace("D", "E")) for x in fields]
    values = found.get("alpha", []) + found.get("beta", [])
    return tuple(values) if len(values) == 8 and np.isfinite(values).all() else None


def read_text(path: Path) -> list[str]:
    """Lines of a RINEX file."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    content = read_lines(path).removeprefix(BOM).rstrip(b"\0\x1a\r\n")
    return content.decode("ascii", errors="replace").splitlines()


def check_version(line: str, path: Path, valid: tuple[int, ...]) -> int:
    """Version that the first line of a RINEX file names."""
    if line[60:80].rstrip() != "RINEX VERSION / TYPE":
        raise FileError(
            f"{path} is not a RINEX file, valid are versions {_join(valid)}: it begins with "
            f"{line[:80]!r}"
        )
    try:
        version = int(float(line[:9]))
    except (ValueError, OverflowError):
        raise FileError(f"{path} has no RINEX version, got {line[:9]!r}") from None
    if version not in valid:
        raise FileError(f"{path} is of RINEX version {line[:9].strip()}, valid are {_join(valid)}")
    return version


def _join(versions: tuple[int, ...]) -> str:
    *most, last = map(str, versions)
    return f"{', '.join(most)} and {last}"


def _blank_other_frames(lines: list[str], others: Counter[str]) -> list[str]:
    """A version 4 file as one of version 3: blank where there are titles, and frames other than
    orbits, or orbits of other messages than the legacy ones, which are counted."""
    blanked, used = list[str](), True
    for line in lines:
        if is_title := line.startswith(">"):
            kind, satellite, message = (line[1:].split() + [""] * 3)[:3]
            legacy = message == "LNAV" if satellite[:1] == "G" else message[:2] != "CN"
            used = kind == "EPH" and legacy
            if kind == "EPH" and not used:
                others[message] += 1
        blanked.append(line if used and not is_title else "")
    return blanked


def _blocks(lines: list[str], path: Path) -> Iterator[tuple[int, list[str]]]:
    """Line number and lines of each record: the first columns of its later lines are blank, and
    what looks like a line of a header is a comment or from another file put behind."""
    end = next((k for k, line in enumerate(lines) if line[60:].strip() == "END OF HEADER"), None)
    if end is None:
        raise FileError(f"{path} is cut short: its header has no end")
    number, block = end + 2, list[str]()
    for k, line in enumerate(lines[end + 1 :], start=end + 2):
        if not line.strip() or HEADED.match(line):
            continue
        if line[:3].strip():
            if block:
                yield number, block
            number, block = k, []
        block.append(line)
    if block:
        yield number, block


def _parse(block: list[str], layout: _Layout, system: str) -> tuple[str, dict[str, float]]:
    require(
        len(block) == LINES_PER_RECORD, f"a record has {LINES_PER_RECORD} lines, got {len(block)}"
    )
    text = block[0][layout.satellite].strip()
    require(system != " ", "a record must begin with the letter of its system, got ' '")
    require(
        text.isdigit() and 1 <= int(text) <= LAST_SATELLITE,
        f"the satellite must be 1 to {LAST_SATELLITE}, got {text!r}",
    )
    record = {
        name: _number(block[line], layout.first_column + FIELD_WIDTH * column, name)
        for name, (line, column) in FIELDS.items()
    }
    if system == "E" and int(_number(block[5], layout.first_column + FIELD_WIDTH, "source")) & 512:
        column = layout.first_column + 3 * FIELD_WIDTH  # clock and delay of E5b and E1
        record["group_delay"] = _number(block[6], column, "group_delay")
    for name, (low, high) in (RANGES if system == "G" else WIDER_RANGES).items():
        if not low <= record[name] <= high:
            raise ValueError(f"`{name}` must be within {low:g} to {high:g}, got {record[name]:g}")
    second_of_week = record.pop("second_of_week")
    time_of_clock = gps_seconds(parse_date([block[0][part] for part in layout.date]))
    half = 0.5 * SECONDS_PER_WEEK
    lead = (second_of_week - time_of_clock + half) % SECONDS_PER_WEEK - half
    if abs(lead) > LARGEST_LEAD:
        raise ValueError(
            f"the time of the ephemeris must be within {LARGEST_LEAD / 3600.0:g} h of the epoch, "
            f"got {lead / 3600.0:.4g} h"
        )
    record["time_of_clock"] = time_of_clock + BEIDOU_LAG * (system == "C")
    record["time_of_ephemeris"] = record["time_of_clock"] + lead
    return f"{system}{int(text):02d}", record


def _number(line: str, column: int, name: str) -> float:
    text = line[column : column + FIELD_WIDTH].strip()
    if not text and name in DISPENSABLE:
        return 0.0
    try:
        value = float(text.upper().replace("D", "E"))
    except ValueError:
        raise ValueError(f"`{name}` must be a number, got {text!r}") from None
    require(math.isfinite(value), f"`{name}` must be finite, got {text!r}")
    return value


def parse_date(parts: list[str]) -> datetime:
    """Date from its parts; years of two digits are those of 1980 to 2079."""
    with suppress(ValueError):
        year, month, day, hour, minute = map(int, parts[:5])
        second = float(parts[5])
        if 0 <= year < 100:
            year += 1900 if year >= 80 else 2000
        if year <= LAST_YEAR and 0 <= hour <= 24 and 0 <= minute <= 60 and 0.0 <= second <= 60.0:
            return datetime(year, month, day) + timedelta(
                hours=hour, minutes=minute, seconds=second
            )
    raise ValueError(
        f"the epoch must be a date up to the year {LAST_YEAR}, with at most 24 hours, 60 minutes "
        f"and 60 seconds, got {' '.join(parts)!r}"
    )
