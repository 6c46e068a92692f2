"""Recorded tracks as they are: CSV, Parquet and JSON files of ADS-B records; `cleaning` comes
next."""

from __future__ import annotations

import gzip
import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_word
from ..core.registry import require

GZIP_MAGIC = b"\x1f\x8b"
LARGEST_SIZE = 64 * 2**20  # of a file, unpacked [bytes]: twice a day of records once a second


class FileError(ValueError):
    """A file that isn't what it should be; the message names file, place and what is valid."""


def read_file(path: Path) -> bytes:
    """All of a file, unpacked where its first bytes say that gzip packed it. More than
    `LARGEST_SIZE` bytes are a `FileError`, as are damaged gzip data."""
    with path.open("rb") as file:
        packed = file.read(len(GZIP_MAGIC)) == GZIP_MAGIC
        file.seek(0)
        try:
            content = (gzip.GzipFile(fileobj=file) if packed else file).read(LARGEST_SIZE + 1)
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise FileError(f"{path}: its gzip data are damaged or cut short: {error}") from error
    if len(content) > LARGEST_SIZE:
        size = f"{LARGEST_SIZE // 2**20} MiB{' unpacked' if packed else ''}"
        raise FileError(f"{path} is too large: valid are at most {size}")
    return content


if TYPE_CHECKING:
    import pandas

FOOT = 0.3048  # international foot [m]
UNITS = {"ft": FOOT, "m": 1.0}  # of the altitude, as a user names them [m]
KNOT = 1852.0 / 3600.0  # knot [m/s]
MINUTE = 60.0  # minute [s]

TIME = ("timestamp", "time", "datetime", "utc")
POSITION_TIME = ("last_position", "lastposupdate", "position_time")
AIRCRAFT = ("icao24", "hex", "aircraft")
QUANTITIES: dict[str, dict[str, float]] = {
    "latitude": {"latitude": 1.0, "lat": 1.0},
    "longitude": {"longitude": 1.0, "lon": 1.0, "lng": 1.0, "long": 1.0},
    "altitude": {
        "altitude_m": 1.0,
        "height_m": 1.0,
        "altitude": FOOT,
        "altitude_ft": FOOT,
        "alt": FOOT,
    },
    "groundspeed": {
        "groundspeed_mps": 1.0,
        "groundspeed": KNOT,
        "groundspeed_kt": KNOT,
        "gs": KNOT,
    },
    "track": {"track": 1.0, "track_deg": 1.0, "course": 1.0},
    "vertical_rate": {
        "vertical_rate_mps": 1.0,
        "vertical_rate": FOOT / MINUTE,
        "vertical_rate_ftpmin": FOOT / MINUTE,
        "baro_rate": FOOT / MINUTE,
    },
}  # column names by quantity, each with what turns its unit into m, m/s or deg
RANGES = {  # valid values by quantity; beyond what ADS-B can say where that is bounded
    "latitude": (-90.0, 90.0, "deg"),
    "longitude": (-180.0, 360.0, "deg"),
    "altitude": (-2_000.0, 50_000.0, "m"),
    "groundspeed": (0.0, 3_000.0, "m/s"),
    "track": (-360.0, 360.0, "deg"),
    "vertical_rate": (-500.0, 500.0, "m/s"),
}
TIMES = (0.0, 4_102_444_800.0)  # valid times since 1970-01-01 UTC [s]: to the year 2100


@dataclass(frozen=True, eq=False)
class RawTrack:
    """Rows of a recorded track, in SI units but otherwise as they were found.

    - `name`: name of the file or flight;
    - `time` (n,) time of the rows since 1970-01-01 UTC [s], never falling;
    - `position_time` (n,) true time of the positions [s], NaN where the file doesn't say;
    - `latitude`, `longitude` (n,) geodetic [rad], NaN where missing;
    - `altitude` (n,) barometric altitude [m], NaN where missing;
    - `groundspeed`, `vertical_rate` (n,) over ground and upwards [m/s], NaN where missing;
    - `track_deg` (n,) course over ground as recorded [deg], NaN where missing.
    """

    name: str
    time: NDArray[np.float64]
    position_time: NDArray[np.float64]
    latitude: NDArray[np.float64]
    longitude: NDArray[np.float64]
    altitude: NDArray[np.float64]
    groundspeed: NDArray[np.float64]
    vertical_rate: NDArray[np.float64]
    track_deg: NDArray[np.float64]


def read_track(
    path: str | Path,
    *,
    altitude_unit: Literal["ft", "m"] | None = None,
    aircraft: str | None = None,
) -> RawTrack:
    """Read a recorded track from a CSV, Parquet or JSON file, compressed or not. `altitude_unit`:
    unit of the altitude column; by default feet, unless its name ends in _m. A
    `spoofgym.data.tracks.FileError` says what is wrong with the file."""
    path = Path(path)
    if find_spec("pandas") is None:
        raise ImportError("reading tracks needs pandas and pyarrow: pip install spoofgym[flights]")
    kind = path.name.removesuffix(".gz").rsplit(".", 1)[-1].lower()
    require(
        kind in {"csv", "json", "parquet", "pq"},
        f"`path` must end in .csv, .json or .parquet, got {path.name!r}",
    )
    content = read_file(path)
    try:
        frame = _frame(content, kind)
    except ImportError:
        raise
    except Exception as error:  # parsers raise what they like
        raise FileError(f"{path} can't be read as {kind.upper()}: {error}") from error
    stem = path.name.split(".", 1)[0]
    try:
        return track_from_frame(frame, stem, altitude_unit=altitude_unit, aircraft=aircraft)
    except ValueError as error:
        raise FileError(f"{path}: {error}") from error


def _frame(content: bytes, kind: str) -> pandas.DataFrame:
    import pandas

    if kind == "csv":
        return pandas.read_csv(BytesIO(content)) if content.strip() else pandas.DataFrame()
    if kind == "json":
        found = json.loads(content)
        if not isinstance(found, (list, dict)):
            raise ValueError("it must hold a list of records or columns by name")
        return pandas.DataFrame(found)
    from pyarrow.parquet import read_metadata

    about = read_metadata(BytesIO(content))
    if (size := 8 * about.num_rows * about.num_columns) > LARGEST_SIZE:
        raise ValueError(f"it must hold at most {LARGEST_SIZE // 8} values, got {size // 8}")
    return pandas.read_parquet(BytesIO(content))


def track_from_frame(
    frame: pandas.DataFrame,
    name: str,
    *,
    altitude_unit: Literal["ft", "m"] | None = None,
    aircraft: str | None = None,
) -> RawTrack:
    """Take a recorded track from a table with one row per report. `altitude_unit`: unit of the
    altitude column; by default feet, unless its name ends in _m."""
    if altitude_unit is not None:
        check_word("altitude_unit", altitude_unit, UNITS)
    frame = frame.rename(columns=lambda column: str(column).strip().lower())
    require(not frame.empty, f"a track must have rows, got none in {name!r}")
    frame = _one_aircraft(frame, aircraft)
    required = {"time": TIME} | {
        quantity: tuple(QUANTITIES[quantity]) for quantity in ("latitude", "longitude", "altitude")
    }
    _check_columns(frame, required)
    time = _seconds(frame, TIME)
    position_time = _seconds(frame, POSITION_TIME)
    _check_times(time)
    _check_range("time", time, *TIMES, "s")
    _check_range("position time", position_time, *TIMES, "s")
    columns = {quantity: _numbers(frame, names) for quantity, names in QUANTITIES.items()}
    if altitude_unit is not None:
        factor = UNITS[altitude_unit]
        columns["altitude"] = _numbers(frame, dict.fromkeys(QUANTITIES["altitude"], factor))
    for quantity, valid in RANGES.items():
        _check_range(quantity, columns[quantity], *valid)
    return RawTrack(
        name,
        time,
        position_time,
        np.radians(columns["latitude"]),
        np.radians(columns["longitude"]),
        columns["altitude"],
        columns["groundspeed"],
        columns["vertical_rate"],
        columns["track"],
    )


def _one_aircraft(frame: pandas.DataFrame, aircraft: str | None) -> pandas.DataFrame:
    column = next((name for name in AIRCRAFT if name in frame), None)
    if column is None:
        return frame
    found = frame[column].dropna().astype(str).unique().tolist()
    if aircraft is None and len(found) > 1:
        raise ValueError(f"`aircraft` must be one of {', '.join(found[:10])}, got none")
    if aircraft is None:
        return frame
    if aircraft not in found:
        raise ValueError(f"`aircraft` must be one of {', '.join(found[:10])}, got {aircraft!r}")
    return frame[frame[column].astype(str) == aircraft]


def _check_columns(frame: pandas.DataFrame, required: Mapping[str, tuple[str, ...]]) -> None:
    if (twice := frame.columns[frame.columns.duplicated()]).size:
        raise ValueError(f"a track must have each column once, got {twice[0]!r} twice")
    missing = {
        quantity: names
        for quantity, names in required.items()
        if not any(name in frame for name in names)
    }
    if missing:
        wanted = "; ".join(f"{key} ({', '.join(names)})" for key, names in missing.items())
        raise ValueError(
            f"a track must have columns for {wanted}, got {', '.join(map(str, frame.columns))}"
        )


def _numbers(frame: pandas.DataFrame, factors: Mapping[str, float]) -> NDArray[np.float64]:
    for name, factor in factors.items():
        if name in frame:
            return _as_numbers(frame, name) * factor
    return np.full(len(frame), math.nan)


def _as_numbers(frame: pandas.DataFrame, name: str) -> NDArray[np.float64]:
    import pandas

    try:
        values: NDArray[np.float64] = pandas.to_numeric(frame[name]).to_numpy(
            dtype=np.float64, na_value=math.nan
        )
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"`{name}` must hold numbers: {error}") from error
    return values


def _seconds(frame: pandas.DataFrame, names: tuple[str, ...]) -> NDArray[np.float64]:
    """Times since 1970-01-01 UTC [s]; NaN without a column. Numbers are distinguished by their
    size: nanoseconds, microseconds, milliseconds or seconds."""
    import pandas

    name = next((name for name in names if name in frame), None)
    if name is None:
        return np.full(len(frame), math.nan)
    column: Any = frame[name]
    if not pandas.api.types.is_datetime64_any_dtype(column):
        try:
            values = _as_numbers(frame, name)
        except ValueError:
            column = column.astype("string")
        else:
            size = float(np.nanmax(np.abs(values), initial=0.0))
            per_second = 1e9 if size > 1e17 else 1e6 if size > 1e14 else 1e3 if size > 1e11 else 1.0
            return values / per_second
    try:
        moments = pandas.to_datetime(column, utc=True, format="ISO8601")
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"`{name}` must hold numbers or ISO 8601 times: {error}") from error
    epoch = pandas.Timestamp(0, tz="UTC")
    return np.asarray((moments - epoch).dt.total_seconds().to_numpy(np.float64))


def _check_times(time: NDArray[np.float64]) -> None:
    if (missing := np.flatnonzero(~np.isfinite(time))).size:
        raise ValueError(f"every row must have a time, got none in row {missing[0] + 1}")
    if (back := np.flatnonzero(np.diff(time) < 0.0)).size:
        row = int(back[0]) + 1
        raise ValueError(
            f"time must not run backwards, got {time[row] - time[row - 1]:g} s from row {row} "
            f"to row {row + 1}"
        )


def _check_range(name: str, value: NDArray[np.float64], low: float, high: float, unit: str) -> None:
    outside = np.flatnonzero((value < low) | (value > high))
    if outside.size:
        raise ValueError(
            f"`{name}` must lie between {low:.10g} and {high:.10g} {unit}, got "
            f"{value[outside[0]]:.10g} {unit} in row {outside[0] + 1}"
        )
