"""Recorded tracks as they are: CSV, Parquet and JSON files of ADS-B records; `cleaning` comes
next.

Columns are found by their names, which also give their units (`QUANTITIES`). Besides plain tables
these are read as they come: state vectors and tracks of OpenSky (its API and its database), traces
and snapshots of readsb and tar1090, flights of Flightradar24 (CSV, and the JSON of a playback).
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from io import BytesIO, StringIO
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_word
from ..core.reading import FileError, check_table, parse_json, read_file, read_lines
from ..core.registry import require

if TYPE_CHECKING:
    import pandas

FOOT = 0.3048  # international foot [m]
UNITS = {"ft": FOOT, "m": 1.0}  # of the altitude, as a user names them [m]
KNOT = 1852.0 / 3600.0  # knot [m/s]
MINUTE, DAY = 60.0, 86_400.0  # [s]

TIME = ("timestamp", "time", "datetime", "utc", "now")
POSITION_TIME = ("last_position", "lastposupdate", "position_time", "time_position")
AIRCRAFT = ("icao24", "hex", "icao", "aircraft")
GROUND = "ground"  # in place of an altitude, of an aircraft that stands or rolls
QUANTITIES: dict[str, dict[str, float]] = {
    "latitude": {"latitude": 1.0, "lat": 1.0},
    "longitude": {"longitude": 1.0, "lon": 1.0, "lng": 1.0, "long": 1.0},
    "altitude": {
        "altitude_m": 1.0,
        "height_m": 1.0,
        **dict.fromkeys(("baroaltitude", "baro_altitude"), 1.0),
        **dict.fromkeys(("altitude", "altitude_ft", "alt_baro", "alt", "alt_geom"), FOOT),
        **dict.fromkeys(("geoaltitude", "geo_altitude"), 1.0),
    },
    "groundspeed": {
        **dict.fromkeys(("groundspeed_mps", "velocity", "velocity_mps"), 1.0),
        **dict.fromkeys(("groundspeed", "groundspeed_kt", "ground_speed", "gs", "speed"), KNOT),
    },
    "track": dict.fromkeys(
        ("track", "track_deg", "true_track", "course", "heading", "direction"), 1.0
    ),
    "vertical_rate": {
        **dict.fromkeys(("vertical_rate_mps", "vertrate"), 1.0),
        **dict.fromkeys(
            ("vertical_rate", "vertical_rate_ftpmin", "baro_rate", "verticalspeed"), FOOT / MINUTE
        ),
    },
}  # column names by quantity, each with what turns its unit into m, m/s or deg
COLUMNS = {*TIME, *POSITION_TIME, *AIRCRAFT, "position"}.union(*QUANTITIES.values())
"""All names that a column of a track may have."""
STATE_VECTOR = (
    *("icao24", "callsign", "origin_country", "time_position", "last_contact", "longitude"),
    *("latitude", "baro_altitude", "on_ground", "velocity", "true_track", "vertrate", "sensors"),
    "geo_altitude",
)
"""First fields of a state vector of OpenSky."""
PATH = ("time", "latitude", "longitude", "baro_altitude", "true_track", "on_ground")
"""Fields of a waypoint of OpenSky."""
TRACE = ("offset", "lat", "lon", "alt_baro", "gs", "track", "flags", "baro_rate")
"""First fields of a point of a trace of readsb; times are after that of the file."""
EXCEL_DAYS = (20_000.0, 80_000.0)  # of the years 1954 to 2119, counted from 1899-12-30
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
    - `reordered`: rows of the file that came after a later one;
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
    reordered: int = 0


def read_track(
    path: str | Path,
    *,
    altitude_unit: Literal["ft", "m"] | None = None,
    aircraft: str | None = None,
) -> RawTrack:
    """Read a recorded track from a CSV, Parquet, JSON or JSON Lines file, compressed or not.
    `altitude_unit`: unit of the altitude column; by default that of its name, feet for `altitude`;
    `aircraft`: address of the one that is wanted. A `spoofgym.data.tracks.FileError` says what is
    wrong with the file."""
    path = Path(path)
    if find_spec("pandas") is None:
        raise ImportError("reading tracks needs pandas and pyarrow: pip install spoofgym[flights]")
    kind = path.name.removesuffix(".gz").rsplit(".", 1)[-1].lower()
    require(
        kind in {"csv", "json", "jsonl", "ndjson", "parquet", "pq"},
        f"`path` must end in .csv, .json, .jsonl or .parquet, got {path.name!r}",
    )
    content = (read_file if kind in {"parquet", "pq"} else read_lines)(path)
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
    if kind == "csv":
        return _read_csv(content.decode("utf-8-sig", errors="replace"))
    if kind in {"json", "jsonl", "ndjson"}:
        try:
            found = parse_json(content, "its text", object)
        except FileError as error:
            if "Extra data" not in str(error):
                raise
            lines = enumerate(content.decode("utf-8-sig").splitlines(), start=1)
            found = [parse_json(x, f"its line {k}", object) for k, x in lines if x.strip()]
        return _tabulate(found)
    return _read_parquet(content)


def _read_parquet(content: bytes) -> pandas.DataFrame:
    """Table of the columns of a track alone; texts are not repeated in memory."""
    from pyarrow.parquet import ParquetFile, read_table

    schema = ParquetFile(BytesIO(content))
    about, columns = schema.metadata, [*map(schema.schema.column, range(len(schema.schema)))]
    flat = [each for each in columns if each.name == each.path and not each.max_repetition_level]
    read = [each for each in flat if each.name.strip().strip("\"'").lower() in COLUMNS]
    require(read, f"none of its columns is one of a track: {', '.join(x.path for x in columns)}")
    check_table(about.num_rows, len(read))
    texts = [each.name for each in read if each.physical_type == "BYTE_ARRAY"]
    table = read_table(
        BytesIO(content),
        columns=[each.name for each in read],
        read_dictionary=texts,
        use_threads=False,
    )
    frame = table.to_pandas(use_threads=False)
    return frame.astype({name: object for name in texts if frame[name].dtype == "category"})


def _read_csv(text: str) -> pandas.DataFrame:
    """Table of a text with commas, semicolons or tabs."""
    import pandas

    if not text.strip():
        return pandas.DataFrame()
    head = text.lstrip().split("\n", 1)[0]
    separator = max(",;\t", key=head.count)
    rows = csv.reader(StringIO(text.lstrip()), delimiter=separator, skipinitialspace=True)
    check_table(text.count("\n") + 1, max(map(len, islice(filter(None, rows), 2)), default=0))
    frame = pandas.read_csv(StringIO(text), sep=separator, skipinitialspace=True)
    if separator == ";":  # where the comma may be the decimal one
        for name in frame.select_dtypes(exclude="number"):
            numbers = frame[name].astype("string").str.replace(",", ".", regex=False)
            numbers = pandas.to_numeric(numbers, errors="coerce")
            if numbers.notna().sum() == frame[name].notna().sum():
                frame[name] = numbers
    return frame


def _tabulate(found: Any) -> pandas.DataFrame:
    """Table of records in one of the forms that services write."""
    if isinstance(found, list) and found and all(isinstance(each, dict) for each in found):
        parts = [_find_rows(each) for each in found]
        if any(part is not None for part in parts):
            return _make_frame([row for part in parts for row in part or ()])
    elif isinstance(found, dict) and (rows := _find_rows(found)) is not None:
        return _make_frame(rows)
    if not isinstance(found, (list, dict)):
        raise ValueError("it must hold a list of records or columns by name")
    return _make_frame(found)


def _make_frame(found: list[Any] | dict[str, Any]) -> pandas.DataFrame:
    """Table of rows, or of columns by name, of which each may be a mapping itself."""
    import pandas

    parts = list(found.values()) if isinstance(found, dict) else found
    names = {name for each in parts if isinstance(each, dict) for name in each}
    most = max((len(each) for each in parts if isinstance(each, list)), default=0)
    rows, columns = len(parts), max(len(names), most)
    check_table(*((columns, rows) if isinstance(found, dict) else (rows, columns)))
    return pandas.DataFrame(found)


def _find_rows(found: Mapping[str, Any]) -> list[dict[str, Any]] | None:
    """Records of an answer of OpenSky, readsb or Flightradar24; None where it is none of them."""
    about, when = found, found.get("now", found.get("time"))
    if isinstance(states := found.get("states"), list) and when is not None:
        return [
            {"time": when, **dict(zip(STATE_VECTOR, each, strict=False))} for each in states or ()
        ]
    if isinstance(path := found.get("path"), list):
        return [
            {**dict(zip(PATH, each, strict=False)), "icao24": about.get("icao24")} for each in path
        ]
    if isinstance(trace := found.get("trace"), list) and "timestamp" in found:
        rows = [dict(zip(TRACE, each, strict=False)) for each in trace]
        return [{**row, "time": found["timestamp"] + row.pop("offset")} for row in rows]
    if isinstance(several := found.get("aircraft"), list) and when is not None:
        seen = [each for each in several if "lat" in each]
        age = "seen_pos"
        return [{**each, "time": when, "position_time": when - each.get(age, 0.0)} for each in seen]
    flight = found
    for name in ("result", "response", "data", "flight"):
        flight = flight[name] if isinstance(flight.get(name), dict) else flight
    if isinstance(points := flight.get("track"), list) and points and isinstance(points[0], dict):
        return [_flatten_point(each) for each in points]
    return None


def _flatten_point(point: Mapping[str, Any]) -> dict[str, Any]:
    """Point of Flightradar24, its quantities by unit, in those that the columns have."""
    units = {"altitude": "feet", "speed": "kts", "verticalSpeed": "fpm"}
    return {
        name: value.get(units.get(name)) if isinstance(value, dict) else value
        for name, value in point.items()
    }


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
    frame = frame.rename(columns=lambda column: str(column).strip().strip("\"'").lower())
    require(not frame.empty, f"a track must have rows, got none in {name!r}")
    frame = _split_positions(frame)
    frame = _one_aircraft(frame, aircraft)
    required = {"time": TIME} | {
        quantity: tuple(QUANTITIES[quantity]) for quantity in ("latitude", "longitude", "altitude")
    }
    _check_columns(frame, required)
    time = _seconds(frame, TIME)
    _check_times(time)
    order = np.argsort(time, kind="stable")
    reordered = int((time < np.maximum.accumulate(time)).sum())
    frame, time = frame.iloc[order], time[order]
    position_time = _seconds(frame, POSITION_TIME)
    _check_range("time", time, *TIMES, "s")
    _check_range("position time", position_time, *TIMES, "s")
    columns = {quantity: _numbers(frame, names) for quantity, names in QUANTITIES.items()}
    if altitude_unit is not None:
        factor = UNITS[altitude_unit]
        columns["altitude"] = _numbers(frame, dict.fromkeys(QUANTITIES["altitude"], factor))
    _refuse_swapped(columns["latitude"], columns["longitude"])
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
        reordered,
    )


def _refuse_swapped(latitude: NDArray[np.float64], longitude: NDArray[np.float64]) -> None:
    """Raise where most latitudes are none, while all longitudes could be."""
    beyond = np.abs(latitude[np.isfinite(latitude)]) > 90.0
    if beyond.size and beyond.mean() > 0.5 and np.nanmax(np.abs(longitude), initial=0.0) <= 90.0:
        raise ValueError(
            f"`latitude` must lie between -90 and 90 deg, and {beyond.sum()} of {beyond.size} do "
            "not: latitude and longitude seem to be swapped"
        )


def _split_positions(frame: pandas.DataFrame) -> pandas.DataFrame:
    """Columns of latitude and longitude of one that holds both, as Flightradar24 writes it."""
    if "position" not in frame or "latitude" in frame or "lat" in frame:
        return frame
    both = frame["position"].astype("string").str.split(",", n=1, expand=True)
    if both.shape[1] != 2:
        return frame
    return frame.assign(latitude=both[0].str.strip(), longitude=both[1].str.strip())


def _one_aircraft(frame: pandas.DataFrame, aircraft: str | None) -> pandas.DataFrame:
    column = next((name for name in AIRCRAFT if name in frame), None)
    if column is None:
        require(aircraft is None, f"no column ({', '.join(AIRCRAFT)}) names the aircraft")
        return frame
    address = frame[column].astype("string").str.strip().str.lower()
    found = address.value_counts().index.tolist()  # the one with most rows first
    if aircraft is None and len(found) > 1:
        raise ValueError(
            f"the file holds {len(found)} aircraft: `aircraft` must be one of "
            f"{', '.join(found[:10])}, got none"
        )
    if aircraft is None:
        return frame
    if (wanted := aircraft.strip().lower()) not in found:
        raise ValueError(f"`aircraft` must be one of {', '.join(found[:10])}, got {aircraft!r}")
    return frame[(address == wanted).to_numpy(dtype=bool, na_value=False)]


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
            column = frame
            if factor == FOOT and (frame[name].astype("string") == GROUND).any():
                column = frame.assign(**{name: frame[name].replace(GROUND, 0.0)})
            return _as_numbers(column, name) * factor
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
            _refuse_days(name, values)
            per_second = 1e9 if size > 1e17 else 1e6 if size > 1e14 else 1e3 if size > 1e11 else 1.0
            return values / per_second
    try:
        moments = pandas.to_datetime(column, utc=True, format="ISO8601")
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"`{name}` must hold numbers or ISO 8601 times: {error}") from error
    epoch = pandas.Timestamp(0, tz="UTC")
    return np.asarray((moments - epoch).dt.total_seconds().to_numpy(np.float64))


def _refuse_days(name: str, values: NDArray[np.float64]) -> None:
    """Raise where times can only be days, as spreadsheets count them."""
    finite = values[np.isfinite(values)]
    if finite.size < 2 or not (EXCEL_DAYS[0] < finite.min() and finite.max() < EXCEL_DAYS[1]):
        return
    if np.median(np.abs(np.diff(finite))) < MINUTE / DAY:
        raise ValueError(
            f"`{name}` must be in seconds, milliseconds or ISO 8601, got {finite[0]:.10g} and "
            f"{finite[-1]:.10g}: these look like the days of a spreadsheet"
        )


def _check_times(time: NDArray[np.float64]) -> None:
    if (missing := np.flatnonzero(~np.isfinite(time))).size:
        raise ValueError(f"every row must have a time, got none in row {missing[0] + 1}")


def _check_range(name: str, value: NDArray[np.float64], low: float, high: float, unit: str) -> None:
    outside = np.flatnonzero((value < low) | (value > high))
    if outside.size:
        raise ValueError(
            f"`{name}` must lie between {low:.10g} and {high:.10g} {unit}, got "
            f"{value[outside[0]]:.10g} {unit} in row {outside[0] + 1}"
        )
