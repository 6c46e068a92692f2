"""Inertial samples of a table (CSV, Parquet), and the TOML file that says what its columns mean.

```toml
header = true                     # whether the first line of a CSV names the columns
lever_arm_m = [0.0, 0.0, 0.0]     # of the antenna from the sensor: forward, right, down

[time]
column = "time"                   # a name, or a number from 1; end of a sample's interval
unit = "s"
scale = "gps"                     # what it counts from, see TIME_SCALES

[specific_force]                  # at rest it points upwards: the third is about -1 g
columns = ["ax", "-ay", "-az"]    # forward, right, down; a minus turns an axis round
unit = "m/s^2"

[angular_rate]
columns = ["gx", "-gy", "-gz"]
unit = "rad/s"
```
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Collection, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.reading import FileError, name_file, read_file, read_table
from ..core.registry import check_choice, require
from ..earth.wgs84 import DEGREE, STANDARD_GRAVITY
from .ephemerides import GPS_EPOCH, LEAP_SECOND_DATES, SECONDS_PER_WEEK

Floats = NDArray[np.float64]
UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "specific_force": {"m/s^2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY},
    "angular_rate": {"rad/s": 1.0, "deg/s": DEGREE},
}
UNIX_EPOCH = (GPS_EPOCH - datetime(1970, 1, 1)).total_seconds()
LARGEST_MAPPING = 2**16


def _from_utc(time: Floats, _: float) -> Floats:
    leaps = [(datetime(*date) - datetime(1970, 1, 1)).total_seconds() for date in LEAP_SECOND_DATES]
    return time - UNIX_EPOCH + np.searchsorted(leaps, time, side="right")


TIME_SCALES: dict[str, Callable[[Floats, float], Floats]] = {
    "gps": lambda time, _: time,
    "week": lambda time, near: time + SECONDS_PER_WEEK * np.round((near - time) / SECONDS_PER_WEEK),
    "unix": _from_utc,
    "unix-gps": lambda time, _: time - UNIX_EPOCH,
}
"""To GPS seconds: from those since 1980-01-06, those of a GPS week, and those since 1970-01-01 in
UTC or, counted without leap seconds, in GPS time."""


class InertialSamples(NamedTuple):
    """Samples of the sensor, moved to the antenna.

    - `time` (N,) end of each sample's interval, GPS seconds [s], rising;
    - `specific_force_b`, `angular_rate_b` (N, 3) forward, right and down [m/s^2], [rad/s];
    - `dropped`: number of rows that were not finite, or whose time did not rise.
    """

    time: Floats
    specific_force_b: Floats
    angular_rate_b: Floats
    dropped: int


def read_inertial(
    path: str | os.PathLike[str], mapping: str | os.PathLike[str], near: float
) -> InertialSamples:
    """Samples of a table whose columns a TOML file describes; `near` GPS seconds of the flight."""
    path, mapping = Path(path), Path(mapping)
    keys = _read_mapping(mapping)
    columns = {
        name: [keys[name]["column"]] if name == "time" else keys[name]["columns"] for name in UNITS
    }
    named = [str(x).removeprefix("-") for each in columns.values() for x in each]
    with name_file(path):
        table = read_table(path, named, header=keys.get("header", True))
        time, force, rate = (
            UNITS[name][keys[name]["unit"]]
            * np.column_stack([_take(table, x) for x in columns[name]])
            for name in UNITS
        )
        time = TIME_SCALES[keys["time"]["scale"]](time[:, 0], near)
        good = np.isfinite(np.column_stack([time, force, rate])).all(axis=1)
        latest = np.maximum.accumulate(np.where(good, time, -np.inf))
        good[1:] &= time[1:] > latest[:-1]
        require(good.sum() > 1, "it needs two samples with finite values and rising times")
    samples = InertialSamples(time[good], force[good], rate[good], int((~good).sum()))
    return move_to_antenna(samples, np.array(keys.get("lever_arm_m", (0.0, 0.0, 0.0)), dtype=float))


def move_to_antenna(samples: InertialSamples, lever: Floats) -> InertialSamples:
    r"""Samples as a sensor at the antenna would have them, `lever` (3,) from the sensor, body axes.

    .. math:: f_a = f + \dot\omega \times l + \omega \times (\omega \times l)
    """
    time, force, rate, _ = samples
    change = np.gradient(rate, time, axis=0)
    moved = force + np.cross(change, lever) + np.cross(rate, np.cross(rate, lever))
    return samples._replace(specific_force_b=moved if lever.any() else force)


def _take(table: Any, column: str | int) -> Floats:
    """Values of a column by its name or number, with the sign in front of it."""
    text = str(column)
    name, sign = text.removeprefix("-"), -1.0 if text.startswith("-") else 1.0
    if isinstance(column, int):
        most = len(table.columns)
        require(1 <= abs(column) <= most, f"it has the columns 1 to {most}, got {column}")
        return sign * table.iloc[:, abs(column) - 1].to_numpy(dtype=np.float64)
    check_choice("column", name, [*map(str, table.columns)])
    return sign * table[name].to_numpy(dtype=np.float64)


def _read_mapping(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    with name_file(path):
        try:
            keys = tomllib.loads(read_file(path, LARGEST_MAPPING).decode())
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise FileError(f"it is not TOML: {error}") from error
        _check_keys("", keys, UNITS, ("header", "lever_arm_m"))
        require(isinstance(keys.get("header", True), bool), "`header` must be true or false")
        _check_list("lever_arm_m", keys.get("lever_arm_m", [0.0] * 3), (int, float))
        for name, units in UNITS.items():
            one = name == "time"
            part = keys[name]
            require(isinstance(part, dict), f"[{name}] must be a table, got {part!r}")
            _check_keys(name, part, ("column", "unit", "scale") if one else ("columns", "unit"))
            check_choice(f"`{name}.unit`", part["unit"], units)
            if one:
                check_choice("`time.scale`", part["scale"], TIME_SCALES)
                _check_list("time.column", [part["column"]], (str, int), 1)
            else:
                _check_list(f"{name}.columns", part["columns"], (str, int))
    return keys


def _check_keys(
    where: str, found: Mapping[str, Any], needed: Collection[str], more: Collection[str] = ()
) -> None:
    at = f"{where}." if where else ""
    for name in found:
        check_choice(f"key of {f'[{where}]' if where else 'a mapping'}", name, [*needed, *more])
    missing = [f"`{at}{name}`" for name in needed if name not in found]
    require(not missing, f"{', '.join(missing)} must be given")


def _check_list(name: str, found: Any, kinds: tuple[type, ...], count: int = 3) -> None:
    require(
        isinstance(found, list)
        and len(found) == count
        and all(isinstance(x, kinds) and not isinstance(x, bool) for x in found),
        f"`{name}` must be {count} of {' or '.join(x.__name__ for x in kinds)}, got {found!r}",
    )
