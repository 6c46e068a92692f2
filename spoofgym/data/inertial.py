"""Inertial samples of a table, whose columns a TOML file describes (docs/logs.md)."""

from __future__ import annotations

import os
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.reading import name_file, read_table, read_toml
from ..core.registry import check_choice, require
from ..earth.wgs84 import DEGREE, STANDARD_GRAVITY
from .ephemerides import GPS_EPOCH, LEAP_SECOND_DATES, SECONDS_PER_WEEK

Floats = NDArray[np.float64]
UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "specific_force": {"m/s^2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY},
    "angular_rate": {"rad/s": 1.0, "deg/s": DEGREE},
}
FORMS = {
    "time": ("column", "unit", "scale"),
    "specific_force": ("columns", "unit"),
    "angular_rate": ("columns", "unit"),
}
TIME_SCALES = {
    "gps": "seconds since 1980-01-06",
    "week": "seconds of a GPS week",
    "unix": "UTC seconds since 1970-01-01",
    "unix-gps": "those counted without leap seconds, in GPS time",
}
UNIX = datetime(1970, 1, 1)
LONGEST_ARM_M = 100.0


class InertialSamples(NamedTuple):
    """Samples of a sensor at the antenna.

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
    r"""Samples of a CSV or Parquet file; `near` GPS seconds of the flight. With an antenna l from
    the sensor,

    .. math:: f_a = f + \dot\omega \times l + \omega \times (\omega \times l)
    """
    path, keys = Path(path), _read_mapping(Path(mapping))
    columns = {name: keys[name].get("columns", [keys[name].get("column")]) for name in UNITS}
    with name_file(path):
        used = [x for each in columns.values() for x in each]
        named = [] if int in map(type, used) else [str(x).removeprefix("-") for x in used]
        table = read_table(path, named, header=keys.get("header", True))
        own_time, force, rate = (
            UNITS[name][keys[name]["unit"]]
            * np.column_stack([_take(table, x) for x in columns[name]])
            for name in UNITS
        )
        time = _count_gps_seconds(own_time[:, 0], keys["time"]["scale"], near)
        good = np.asarray(np.isfinite(np.column_stack([time, force, rate])).all(axis=1))
        latest = np.maximum.accumulate(np.where(good, time, -np.inf))
        good[1:] &= time[1:] > latest[:-1]
        require(good.sum() > 1, "it needs two samples with finite values and rising times")
        time, force, rate = time[good], force[good], rate[good]
        if any(lever := keys.get("lever_arm_m", [0.0])):
            turning = np.gradient(rate, time, axis=0)
            force = force + np.cross(turning, lever) + np.cross(rate, np.cross(rate, lever))
    return InertialSamples(time, force, rate, int((~good).sum()))


def _count_gps_seconds(time: Floats, scale: str, near: float) -> Floats:
    if scale == "week":
        return np.asarray(time + SECONDS_PER_WEEK * np.round((near - time) / SECONDS_PER_WEEK))
    leaps = [(datetime(*date) - UNIX).total_seconds() for date in LEAP_SECOND_DATES]
    leap_seconds = np.searchsorted(leaps, time, side="right") if scale == "unix" else 0
    return time + leap_seconds - (0.0 if scale == "gps" else (GPS_EPOCH - UNIX).total_seconds())


def _take(table: Any, column: str | int) -> Floats:
    """Values of a column by its name or number, with the sign in front of it."""
    text = str(column)
    names = list(map(str, range(1, len(table.columns) + 1) if isinstance(column, int) else table))
    check_choice("column", text.removeprefix("-"), names)
    values = table.iloc[:, names.index(text.removeprefix("-"))].to_numpy(dtype=np.float64)
    return np.asarray(-values if text.startswith("-") else values)


def _read_mapping(path: Path) -> dict[str, Any]:
    with name_file(path):
        keys = read_toml(path)
        for name in keys:
            check_choice("key", name, [*FORMS, "header", "lever_arm_m"])
        require(isinstance(keys.get("header", True), bool), "`header` must be true or false")
        lever = keys.get("lever_arm_m", [0.0] * 3)
        good = _is_list(lever, 3, (int, float)) and all(abs(x) <= LONGEST_ARM_M for x in lever)
        require(
            good, f"`lever_arm_m` must be 3 numbers of at most {LONGEST_ARM_M:g} m, got {lever}"
        )
        for name, form in FORMS.items():
            part = keys.get(name, {})
            good = isinstance(part, dict) and set(part) == set(form)
            require(good, f"[{name}] must have the keys {', '.join(form)}, got {part}")
            check_choice(f"`{name}.unit`", part["unit"], UNITS[name])
            columns = part.get("columns", [part.get("column")])
            count = 1 if name == "time" else 3
            require(
                _is_list(columns, count, (str, int)),
                f"`{name}.{form[0]}` must be {count} names or numbers of columns, got {columns}",
            )
        check_choice("`time.scale`", keys["time"]["scale"], TIME_SCALES)
    return keys


def _is_list(found: Any, count: int, kinds: tuple[type, ...]) -> bool:
    whole = isinstance(found, list) and len(found) == count
    return whole and all(isinstance(x, kinds) and not isinstance(x, bool) for x in found)
