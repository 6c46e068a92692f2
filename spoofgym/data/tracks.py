"""Recorded tracks as they are: CSV, Parquet and JSON files of ADS-B; `cleaning` comes next."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from io import BytesIO, StringIO
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_word
from ..core.reading import FileError, check_table, choose_columns, parse_json, read_file, read_lines
from ..core.registry import require

if TYPE_CHECKING:
    import pandas

FOOT = 0.3048  # international foot [m]
KNOT = 1852.0 / 3600.0  # knot [m/s]
LEVEL = 100.0 * FOOT  # of a flight level [m]
UNITS = {"ft": FOOT, "m": 1.0, "fl": LEVEL}  # of the altitude, as a user names them [m]
FACTORS = {  # of the units that may end a column's name, in m, m/s and deg
    **dict.fromkeys(("ft", "feet"), FOOT),
    **dict.fromkeys(("m", "meter", "meters", "metres", "mps", "m_s", "ms", "deg", "degrees"), 1.0),
    **dict.fromkeys(("kt", "kts", "knots", "kn"), KNOT),
    **dict.fromkeys(("kmh", "km_h", "kph"), 1.0 / 3.6),
    **dict.fromkeys(("mph",), 0.44704),
    **dict.fromkeys(("ftpmin", "fpm", "ft_min"), FOOT / 60.0),
}

TIME = (
    *("timestamp", "time", "datetime", "utc", "timestamp_utc", "time_utc", "now", "ts", "snapshot"),
    *("snapshottime", "date_time", "unixtime", "epoch", "last_contact", "lastcontact"),
    *("snapshot_id", "postime", "unix_time", "utc_time", "event_time"),
)
TIME_UNITS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
REQUIRED = ("latitude", "longitude", "altitude")
POSITION_TIME = ("last_position", "lastposupdate", "position_time", "time_position")
AIRCRAFT = (
    *("icao24", "hex", "icao", "icao_address", "aircraft", "fr24_id", "fa_flight_id"),
    *("flight_id", "callsign", "flight", "registration"),
)
QUANTITIES: dict[str, dict[str, float]] = {
    "latitude": dict.fromkeys(("latitude", "lat"), 1.0),
    "longitude": dict.fromkeys(("longitude", "lon", "lng", "long"), 1.0),
    "altitude": {
        **dict.fromkeys(("altitude", "alt_baro", "altitude_baro", "alt"), FOOT),
        **dict.fromkeys(("height", "baro_altitude", "baroaltitude"), 1.0),
        **dict.fromkeys(("geo_altitude", "geoaltitude", "ele", "elevation"), 1.0),
        **dict.fromkeys(("alt_geom", "alt_gnss", "feet"), FOOT),
        "flight_level": LEVEL,
    },
    "groundspeed": {
        **dict.fromkeys(
            ("groundspeed", "ground_speed", "gs", "gspeed", "speed", "spd", "kts"), KNOT
        ),
        "velocity": 1.0,
    },
    "track": dict.fromkeys(
        (
            *("track", "true_track", "track_angle", "course", "direction", "trk", "trak"),
            *("heading", "hd"),
        ),
        1.0,
    ),
    "vertical_rate": {
        **dict.fromkeys(
            (
                *("vertical_rate", "verticalrate", "baro_rate", "vspeed", "verticalspeed"),
                *("vert_speed", "vsi"),
            ),
            FOOT / 60.0,
        ),
        "vertrate": 1.0,
    },
}
"""Column names of traffic, OpenSky, readsb and Flightradar24, each with its unit in m, m/s or deg;
a unit may be added to them. The first one counts."""
NAMELESS = {  # names of the values of a row, by the key of rows without them
    "states": (
        *("icao24", "callsign", "origin_country", "time_position", "last_contact", "longitude"),
        *("latitude", "baro_altitude", "on_ground", "velocity", "true_track", "vertical_rate_mps"),
        *("sensors", "geo_altitude"),
    ),
    "path": ("time", "latitude", "longitude", "baro_altitude", "true_track", "on_ground"),
    "trace": ("after_s", "lat", "lon", "alt_baro", "gs", "track", "flags", "baro_rate"),
}
BASE_STATION = (  # values of a line of dump1090 on port 30003, which has no head
    *("message", "transmission", "session", "aircraft_id", "hex", "flight_number", "date", "time"),
    *("logged_date", "logged_time", "callsign", "altitude", "groundspeed", "track", "latitude"),
    *("longitude", "vertical_rate", "squawk", "alert", "emergency", "spi", "on_ground"),
)
COLUMNS = {"date", *TIME, *POSITION_TIME, *AIRCRAFT, "position"}.union(*QUANTITIES.values())
"""All names that a column of a track may have, but for units."""
NESTS = ("result", "response", "data", "flight")  # keys of what holds rows further down
ROWS = (  # keys of rows
    *NAMELESS,
    *("aircraft", "ac", "aclist", "tracks", "track", "trail", "positions"),
    *NESTS,
)
MEANT = ("feet", "kts", "fpm")  # of a value that is given in several units
DAYS = (20_000.0, 800_000.0)  # of spreadsheets, from 1900 on, and of MATLAB, from the year 0 on
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
    - `track_deg` (n,) course over ground as recorded [deg], NaN where missing;
    - `unsorted`: rows that were earlier than one before them in the file;
    - `unit_by_name`: whether the altitude's unit is a guess by the column's name;
    - `read_as`: this name and unit, in words.
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
    unsorted: int = 0
    unit_by_name: bool = True
    read_as: str = ""


def read_track(
    path: str | Path, *, altitude_unit: str | None = None, aircraft: str | None = None
) -> RawTrack:
    """Read a recorded track from a CSV, Parquet, JSON or JSON Lines file, compressed or not.
    `altitude_unit`: unit of the altitude column; by default by its name, see `QUANTITIES`;
    `aircraft`: the one to take of several. A `spoofgym.data.tracks.FileError` says what is wrong
    with the file."""
    path = Path(path)
    if find_spec("pandas") is None:
        raise ImportError(
            "reading tracks needs pandas and pyarrow: pip install 'spoofgym[flights]', or "
            "'.[flights]' in a checkout"
        )
    kind = path.name.lower().removesuffix(".gz").rsplit(".", 1)[-1]
    require(
        kind in {"csv", "json", "jsonl", "ndjson", "parquet", "pq"},
        "the file of a track must end in .csv, .json, .jsonl or .parquet, and then perhaps in .gz, "
        f"got {path.name!r}: save its points as a table with columns for time, latitude, longitude "
        "and altitude",
    )
    content = (read_file if kind in {"parquet", "pq"} else read_lines)(path)
    try:
        frame = _frame(content, kind)
    except ImportError:
        raise
    except Exception as error:  # parsers raise what they like
        raise FileError(f"{path} can't be read as {kind.upper()}: {first_line(error)}") from error
    stem = path.name.split(".", 1)[0]
    try:
        return track_from_frame(frame, stem, altitude_unit=altitude_unit, aircraft=aircraft)
    except ValueError as error:
        raise FileError(f"{path}: {error}") from error


def first_line(error: Exception) -> str:
    """What a parser says, without its advice."""
    return (str(error).splitlines() or [type(error).__name__])[0]


def _frame(content: bytes, kind: str) -> pandas.DataFrame:
    if kind == "csv":
        return _read_csv(content)
    if kind.endswith("json") or kind == "jsonl":
        return _make_frame(_read_json(_decode(content), kind != "json"))
    return _read_parquet(content)


def _read_parquet(content: bytes) -> pandas.DataFrame:
    """Table of the columns of a track alone; texts are not repeated in memory."""
    from pyarrow.parquet import ParquetFile, read_table

    schema = ParquetFile(BytesIO(content))
    about, columns = schema.metadata, [*map(schema.schema.column, range(len(schema.schema)))]
    flat = [each for each in columns if each.name == each.path and not each.max_repetition_level]
    read = [each for each in flat if _is_of_track(each.name)]
    require(read, f"none of its columns is one of a track: {', '.join(x.path for x in columns)}")
    check_table(about.num_rows, len(read))
    texts = [each.name for each in read if each.physical_type == "BYTE_ARRAY"]
    table = read_table(
        BytesIO(content),
        columns=[each.name for each in read],
        read_dictionary=texts,
        use_threads=False,
    )
    frame = table.to_pandas(use_threads=False, ignore_metadata=True)  # an index is a column, too
    return frame.astype({name: object for name in texts if frame[name].dtype == "category"})


def _is_of_track(name: str) -> bool:
    """Whether a column may be one of a track, with a unit or without."""
    plain = _plain_name(name)
    return plain in COLUMNS or any(
        plain == f"{each}_{unit}" for each in COLUMNS for unit in (*FACTORS, *TIME_UNITS)
    )


def _decode(content: bytes) -> str:
    wide = content[:2] in (b"\xff\xfe", b"\xfe\xff")
    with suppress(UnicodeDecodeError):
        text = content.decode("utf-16" if wide else "utf-8-sig")
        require("\0" not in text, "it is no text")
        return text
    require(not re.search(rb"[\0-\x08\x0e-\x1f]", content), "it is no text")
    return content.decode("latin-1")  # of spreadsheets


def _read_csv(content: bytes) -> pandas.DataFrame:
    """Columns apart by commas, semicolons, tabs or bars; with others than commas, there may be
    commas for points. Names of aircraft stay text: 4e5432 is no number. Lines before the head, and
    heads of files put behind, are left out."""
    import pandas

    text = _decode(content).replace("\r\n", "\n").replace("\r", "\n")
    text = re.sub(r"\A([ \t]*\n|#[^,;\t|\n]*\n|sep=.\n)+", "", text)
    if re.match(r"(MSG|SEL|ID|AIR|STA|CLK),", text):
        text = f"{','.join(BASE_STATION)}\n{text}"
    head = text.partition("\n")[0]
    if not head:
        return pandas.DataFrame()
    while (again := f"\n{head}\n") in text:
        text = text.replace(again, "\n")
    apart = max(",;\t|", key=head.count)
    rows = csv.reader(StringIO(text), delimiter=apart, skipinitialspace=True)
    seen = list(islice(filter(None, rows), 2))
    check_table(text.count("\n") + 1, max(map(len, seen), default=0))
    names = pandas.read_csv(StringIO(text), sep=apart, nrows=0).columns
    kinds = {name: str for name in names if _plain_name(name) in AIRCRAFT}
    commas = apart != "," and re.search(rf"(^|[{apart}\n])\s*-?\d+,\d+\s*([{apart}\n]|$)", text)
    points = commas and re.search(rf"(^|[{apart}\n])\s*-?\d*\.\d{{1,2}}\s*([{apart}\n]|$)", text)
    return pandas.read_csv(
        StringIO(text), sep=apart, dtype=kinds, decimal="," if commas else ".",
        thousands="." if commas and not points else None,
        skipinitialspace=True, low_memory=False, na_values=["-", "--"],
        **choose_columns(seen[0], seen[-1]),
    )  # fmt: skip


def _read_json(text: str, by_line: bool) -> Any:
    """Rows of a JSON text, or columns by name."""
    if by_line:
        lines = enumerate(text.splitlines(), 1)
        found = [parse_json(x, f"its line {k}", object) for k, x in lines if x.strip()]
    else:
        found = parse_json(text, "its text", object)
    if not isinstance(found, (list, dict)):
        raise ValueError("it must hold a list of records or columns by name")
    return found if _is_columns(found) else list(_rows(found, {}))


def _make_frame(found: list[Any] | dict[str, Any]) -> pandas.DataFrame:
    """Table of rows, or of columns by name, of which each may be a mapping itself."""
    import pandas

    parts = list(found.values()) if isinstance(found, dict) else found
    names = {name for each in parts if isinstance(each, dict) for name in each}
    most = max((len(each) for each in parts if isinstance(each, list)), default=0)
    rows, columns = len(parts), max(len(names), most)
    check_table(*((columns, rows) if isinstance(found, dict) else (rows, columns)))
    return pandas.DataFrame(found)


def _is_columns(found: Any) -> bool:
    """Whether it is columns by name, of numbers or text."""
    return isinstance(found, dict) and all(
        isinstance(x, (list, dict)) and not any(isinstance(y, (list, dict)) for y in _items(x))
        for x in found.values()
    )


def _items(found: Any) -> Any:
    return found.values() if isinstance(found, dict) else found


def _rows(found: Any, above: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Rows of records, and of the answers of services, which nest them; what stands above rows,
    such as the time of all, holds for each."""
    for item in found if isinstance(found, list) else [found]:
        if not isinstance(item, dict):
            raise ValueError(f"a row must be an object with names, got {str(item)[:40]!r}")
        item = {str(key).strip().lower(): value for key, value in item.items()}
        key = next((key for key in ROWS if _holds_rows(key, item)), None)
        if key is None:
            yield _flat_row(above | item)
            continue
        own = above | {x: y for x, y in item.items() if not isinstance(y, (list, dict))}
        rows = item[key] or []
        if key in NAMELESS and isinstance(rows, list):
            rows = [
                dict(zip(NAMELESS[key], row, strict=False)) if isinstance(row, list) else row
                for row in rows
            ]
        if key == "positions" and isinstance(rows, list):  # of FlightAware, in hundreds of feet
            rows = [
                {"flight_level" if x == "altitude" else x: y for x, y in row.items()}
                if isinstance(row, dict)
                else row
                for row in rows
            ]
        yield from _rows(rows, own)


def _holds_rows(key: str, item: dict[str, Any]) -> bool:
    value = item.get(key)
    if isinstance(value, list):
        return all(isinstance(row, (list, dict)) for row in value)
    silent = key == "states" and key in item and value is None  # OpenSky heard nothing
    return silent or (key in NESTS and isinstance(value, dict))


def _flat_row(row: dict[str, Any]) -> dict[str, Any]:
    """A row in one unit, with the time of its position where only the age of it is given."""
    for key, value in row.items():
        if isinstance(value, dict):
            unit = next((unit for unit in MEANT if unit in value), None)
            if unit is None and _plain_name(key) in COLUMNS.difference(AIRCRAFT):
                raise ValueError(f"`{key}` must be a value, got an object with {', '.join(value)}")
            row[key] = None if unit is None else value[unit]
    if "after_s" in row:
        row["timestamp"] = row.get("timestamp", math.nan) + row["after_s"]
    now, age = row.get("now"), row.get("seen_pos")
    if isinstance(now, (int, float)) and isinstance(age, (int, float)):
        row["position_time"] = now - age * (1e3 if now > 1e11 else 1.0)
    return {key: value for key, value in row.items() if not isinstance(value, list)} or row


def _plain_name(name: Any) -> str:
    """A column's name in the words of `QUANTITIES`: "Altitude (ft)" is altitude_ft."""
    return re.sub(r"[^a-z0-9]+", "_", str(name).lower()).strip("_") or str(name)


def track_from_frame(
    frame: pandas.DataFrame,
    name: str,
    *,
    altitude_unit: str | None = None,
    aircraft: str | None = None,
) -> RawTrack:
    """Take a recorded track from a table with one row per report, see `read_track`; rows are
    sorted by time."""
    if altitude_unit is not None:
        check_word("altitude_unit", altitude_unit, UNITS)
    frame = frame.rename(columns=_plain_name)
    names = f" below the columns {', '.join(frame.columns)[:80]}" * (frame.columns.size > 0)
    require(not frame.empty, f"a track must have rows, got none in {name!r}{names}")
    frame = _join_date(_split_position(frame))
    used = {quantity: _find_column(frame, names) for quantity, names in QUANTITIES.items()}
    _check_columns(frame, used)
    frame = _one_aircraft(frame, aircraft, str(used["latitude"] and used["latitude"][0]))
    used = {quantity: _find_column(frame, names) for quantity, names in QUANTITIES.items()}
    time = _join_periods(_seconds(frame, TIME))
    position_time = _seconds(frame, POSITION_TIME)
    position_time[position_time == 0.0] = np.nan  # never heard
    _check_times(time)
    _check_range("time", time, *TIMES, "s")
    _check_range("position time", position_time, *TIMES, "s")
    if altitude_unit is not None:
        used["altitude"] = (used["altitude"] or ("",))[0], UNITS[altitude_unit]
    column, factor = used["altitude"] or ("", FOOT)
    unit = next((unit for unit, size in UNITS.items() if size == factor), f"{factor:g} m")
    columns = {quantity: _numbers(frame, column) for quantity, column in used.items()}
    for quantity, valid in RANGES.items():
        _check_range(quantity, columns[quantity], *valid)
    order = np.argsort(time, kind="stable")
    latitude, longitude, *others = (columns[quantity][order] for quantity in QUANTITIES)
    altitude, groundspeed, track, vertical_rate = others
    _check_degrees(time[order], latitude, longitude, groundspeed)
    return RawTrack(
        name,
        time[order],
        position_time[order],
        np.radians(latitude),
        np.radians(longitude),
        altitude,
        groundspeed,
        vertical_rate,
        track,
        unsorted=int((time < np.maximum.accumulate(time)).sum()),
        unit_by_name=altitude_unit is None,
        read_as=f"`{column}`, read in {unit}",
    )


def _split_position(frame: pandas.DataFrame) -> pandas.DataFrame:
    """A column "46.1,8.2" of Flightradar24 as two."""
    if "position" not in frame or {"latitude", "lat"} & {*frame}:
        return frame
    parts = frame["position"].astype(str).str.extract(r"^\s*([^,;\s]+)[,;\s]+([^,;\s]+)\s*$")
    return frame.assign(latitude=parts[0], longitude=parts[1])


def _join_date(frame: pandas.DataFrame) -> pandas.DataFrame:
    """A column of dates and one of times of the day as one."""
    if "date" not in frame or "time" not in frame or frame.empty:
        return frame
    time = frame["time"].astype(str)
    if not time.str.match(r"^\s*\d{1,2}:\d\d").all():
        return frame
    date = frame["date"].astype(str).str.strip().str.replace("/", "-")
    return frame.assign(time=date + "T" + time.str.strip().str.zfill(8))


def _find_column(frame: pandas.DataFrame, names: Mapping[str, float]) -> tuple[str, float] | None:
    """The first column of a quantity that isn't empty, and what its unit is in SI units."""
    found = [
        (column, factor if unit is None else FACTORS[unit])
        for name, factor in names.items()
        for unit in (*FACTORS, None)
        if (column := name if unit is None else f"{name}_{unit}") in frame
    ]
    held = [each for each in found if frame[[each[0]]].notna().to_numpy().any()]
    return next(iter(held or found), None)


def _one_aircraft(frame: pandas.DataFrame, aircraft: str | None, latitude: str) -> pandas.DataFrame:
    column = next((name for name in AIRCRAFT if name in frame), None)
    if column is None:
        require(aircraft is None, f"`aircraft` needs a column for it: {', '.join(AIRCRAFT)}")
        return frame
    names = frame[column].astype(str).str.strip().where(frame[column].notna(), "")
    names = names.where(frame[latitude].notna(), "")  # others are heard, and seen nowhere
    rows = Counter(names[names != ""].str.lower())
    spelled = dict(zip(names.str.lower()[::-1], names[::-1], strict=True))
    same = names.str.lower() == str(aircraft).strip().lower()
    if len(rows) > 1 if aircraft is None else not same.any():
        require(
            max(rows.values(), default=2) > 1,
            f"a track must have rows of one aircraft over time, got one row each of {len(rows)}",
        )
        found = [spelled[name] for name, _ in rows.most_common(11)]
        got = "none" if aircraft is None else repr(aircraft)
        raise ValueError(
            f"`aircraft` must be one of {_list_some(found, 10)}, those of most rows first, got "
            f"{got}; the command takes it by --aircraft"
        )
    return frame if aircraft is None else frame[same]


def _check_columns(frame: pandas.DataFrame, used: Mapping[str, tuple[str, float] | None]) -> None:
    if (twice := frame.columns[frame.columns.duplicated()]).size:
        raise ValueError(f"a track must have each column once, got {twice[0]!r} twice")
    wanted = {"time": TIME, **{key: (*QUANTITIES[key],) for key in REQUIRED}}
    there = {key for key, column in used.items() if column}
    there |= {"time" for name in _list_times(TIME) if name in frame}
    if missing := [f"{key} ({_list_some(x, 4)})" for key, x in wanted.items() if key not in there]:
        raise ValueError(
            f"a track must have columns for {'; '.join(missing)}, got "
            f"{_list_some([*frame.columns], 20)}"
        )


def _list_some(names: Sequence[Any], most: int) -> str:
    return ", ".join([*(str(x)[:40] for x in names[:most]), *["..."] * (len(names) > most)])


def _numbers(frame: pandas.DataFrame, column: tuple[str, float] | None) -> NDArray[np.float64]:
    if column is None:
        return np.full(len(frame), math.nan)
    return _as_numbers(frame, column[0]) * column[1]


def _as_numbers(frame: pandas.DataFrame, name: str) -> NDArray[np.float64]:
    import pandas

    try:
        column = frame[name].replace({"ground": 0.0, "": None})  # of readsb, and of CSV
        values: NDArray[np.float64] = pandas.to_numeric(column).to_numpy(
            dtype=np.float64, na_value=math.nan
        )
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(
            f"`{name}` must hold numbers{_say_first(column, pandas.to_numeric)}"
        ) from error
    return values


def _say_first(column: Any, *parsers: Any) -> str:
    """The first value that none of them takes, and its row."""
    bad = column.notna().to_numpy()
    try:
        for parse in parsers:
            bad = bad & parse(column, errors="coerce").isna().to_numpy()
    except OverflowError:  # a number of hundreds of digits, which pandas does not name
        return ""
    k = int(np.argmax(bad))
    return f", got {str(column.iloc[k])[:40]!r} in row {k + 1}" if bad.any() else ""


def _list_times(names: tuple[str, ...]) -> dict[str, float]:
    """Names of columns of times, each with its unit [s]; 0 where the name has none."""
    ended = {f"{name}_{unit}": size for name in names for unit, size in TIME_UNITS.items()}
    return dict.fromkeys(names, 0.0) | ended


def _seconds(frame: pandas.DataFrame, names: tuple[str, ...]) -> NDArray[np.float64]:
    """Times since 1970-01-01 UTC [s]; NaN without a column. Numbers whose column names no unit are
    distinguished by their size: nanoseconds, microseconds, milliseconds or seconds."""
    import pandas

    units = _list_times(names)
    name = next((name for name in units if name in frame), None)
    if name is None:
        return np.full(len(frame), math.nan)
    column: Any = frame[name]
    if not pandas.api.types.is_datetime64_any_dtype(column):
        try:
            values = _as_numbers(frame, name)
        except ValueError:
            column = column.astype("string").str.removesuffix(" UTC")
        else:
            low, high = np.nanmin(values, initial=math.inf), np.nanmax(values, initial=0.0)
            if DAYS[0] < low <= high < min(DAYS[1], low + 2.0) and len(values) > 2:
                raise ValueError(
                    f"`{name}` must hold seconds since 1970 or ISO 8601 times, got {low:.6f}, "
                    "which looks like days of a spreadsheet or of MATLAB"
                )
            of_minute = np.unique(values[np.isfinite(values)] % 100.0)
            if of_minute.size > 5 and of_minute.max() < 60.0 and high - low > 200.0:
                raise ValueError(
                    f"`{name}` must hold seconds since 1970 or ISO 8601 times, got {low:.15g}, "
                    "which looks like hours, minutes and seconds in one number"
                )
            if units[name]:
                return values * units[name]
            size = float(np.nanmax(np.abs(values), initial=0.0))
            per_second = 1e9 if size > 1e17 else 1e6 if size > 1e14 else 1e3 if size > 1e11 else 1.0
            return values / per_second
    try:
        moments = pandas.to_datetime(column, utc=True, format="ISO8601")
    except (ValueError, TypeError, OverflowError) as error:
        parsers = pandas.to_numeric, partial(pandas.to_datetime, utc=True, format="ISO8601")
        first = _say_first(column, *parsers)
        raise ValueError(f"`{name}` must hold numbers or ISO 8601 times{first}") from error
    epoch = pandas.Timestamp(0, tz="UTC")
    return np.asarray((moments - epoch).dt.total_seconds().to_numpy(np.float64))


def _join_periods(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Seconds of a day, or of a week, that count on where they begin again; dates as they are."""
    largest, change = np.nanmax(time, initial=0.0), np.diff(time, prepend=time[:1])
    for period in (86_400.0, 604_800.0):
        if largest <= period:
            again, back = (np.abs(change + way * period) < 30.0 for way in (1.0, -1.0))
            return time + period * (np.cumsum(again) - np.cumsum(back))
    return time


def _check_times(time: NDArray[np.float64]) -> None:
    if (missing := np.flatnonzero(~np.isfinite(time))).size:
        raise ValueError(f"every row must have a time, got none in row {missing[0] + 1}")


def _check_degrees(time: Any, latitude: Any, longitude: Any, groundspeed: Any) -> None:
    """Refuse places in radians: in degrees they hardly move."""
    known = np.isfinite(latitude + longitude)
    if known.sum() < 2 or np.hypot(latitude, longitude)[known].max() > math.pi:
        return
    moved = np.hypot(np.diff(latitude[known]), np.diff(longitude[known])).sum() * 111e3  # m by deg
    fast = float(np.nanmedian(np.append(groundspeed, 0.0)))
    if fast > 30.0 and moved < 0.05 * fast * np.ptp(time[known]):
        raise ValueError(
            f"read in degrees, positions move by {moved:.0f} m in {np.ptp(time[known]):.0f} s, at "
            f"a groundspeed of {fast:.0f} m/s: are latitude and longitude in radians?"
        )


def _check_range(name: str, value: NDArray[np.float64], low: float, high: float, unit: str) -> None:
    outside = np.flatnonzero((value < low) | (value > high))
    if outside.size:
        largest = float(np.nanmax(np.abs(value)))
        raise ValueError(
            f"`{name}` must lie between {low:.10g} and {high:.10g} {unit}, got "
            f"{value[outside[0]]:.10g} {unit} in row {outside[0] + 1}"
            + "; are latitude and longitude swapped?" * (name == "latitude" and largest <= 360.0)
            + "; are they in 1e-7 deg?" * (name in {"latitude", "longitude"} and largest > 1e6)
        )
