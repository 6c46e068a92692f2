"""Raw measurements of a receiver: RINEX observation files, and tables of raw measurements.

RINEX is read as "RINEX: The Receiver Independent Exchange Format", versions 2.11 and 3.05, has it.
Tables (CSV, Parquet) have a row for each satellite and signal, with the columns of u-blox's
UBX-RXM-RAWX (`TABLE`). Of every system one signal is used, the first of `SIGNALS` that is there.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.reading import check_table, name_file, read_table
from ..core.registry import require
from ..earth.wgs84 import SPEED_OF_LIGHT
from .ephemerides import BEIDOU_LAG, SECONDS_PER_WEEK, gps_seconds
from .rinex import check_version, parse_date, read_text

Floats = NDArray[np.float64]


class Signal(NamedTuple):
    """One of a system: its frequency [Hz], and how much of the broadcast group delay it has."""

    frequency: float
    delays: float = 1.0


SIGNALS = {
    "G": dict.fromkeys(("1C", "1", "1W", "1P"), Signal(1575.42e6)),
    "E": dict.fromkeys(("1C", "1X", "1B", "1"), Signal(1575.42e6)),
    "C": {
        **dict.fromkeys(("2I", "1I", "2X"), Signal(1561.098e6)),
        **dict.fromkeys(("1P", "1D"), Signal(1575.42e6)),
        **dict.fromkeys(("6I", "6X"), Signal(1268.52e6, 0.0)),
    },
}
"""Signals by system and RINEX's code behind C and D, the preferred first. Clocks of BeiDou are of
B3; the delay of B1I is taken for B1C, whose own is in newer messages."""
UBLOX_SIGNALS = {
    **{(0, 0): ("G", "1C"), (2, 0): ("E", "1C"), (2, 1): ("E", "1B"), (3, 0): ("C", "2I")},
    **{(3, 1): ("C", "2I"), (3, 5): ("C", "1P"), (3, 6): ("C", "1D"), (3, 4): ("C", "6I")},
}
"""System and signal by u-blox's numbers of both (interface description, GNSS identifiers)."""
TABLE = ("week", "tow_s", "gnss_id", "sv_id", "sig_id", "pr_m", "doppler_hz")
SDS = ("pr_stdev_m", "doppler_stdev_hz")
ABSENT = "without pseudorange or Doppler shift"
DATES = {
    2: ((1, 3), (4, 6), (7, 9), (10, 12), (13, 15), (15, 26)),
    3: ((2, 6), (7, 9), (10, 12), (13, 15), (16, 18), (18, 29)),
}  # columns of year, month, day, hour, minute and second, by version


@dataclass(frozen=True, kw_only=True)
class Observations:
    """What a receiver measured, nothing of it corrected.

    - `time` (K,) of the epochs by the receiver's clock, GPS seconds [s]; `segment` (K,) int, one
      more wherever it does not rise;
    - `satellites` (n,) "G01"; `signals` of them;
    - `pseudorange`, `range_rate` (K, n) [m], [m/s], NaN where absent;
    - `sd` (K, 2n) what the receiver believes of their errors, NaN where it says nothing;
    - `left_out`: number of what was not used, by what it is.
    """

    time: Floats
    segment: NDArray[np.int64]
    satellites: tuple[str, ...]
    signals: tuple[Signal, ...]
    pseudorange: Floats
    range_rate: Floats
    sd: Floats
    left_out: dict[str, int]


_Row = tuple[int, str, float, float, float, float]
"""Epoch, satellite, pseudorange [m], Doppler shift [Hz], and their standard deviations."""


def read_observations(path: str | os.PathLike[str]) -> Observations:
    """Observations of a RINEX file or of a table. A `FileError` says why it can't be read."""
    path, left_out = Path(path), Counter[str]()
    with name_file(path):
        read = _read_raw_table if is_table(path) else _read_rinex
        times, rows, chosen = read(path, left_out)
        rows = [row for row in rows if np.isfinite(row[2:4]).all() and 0.0 not in row[2:4]]
        require(rows, f"it holds no pseudorange with a Doppler shift of {', '.join(SIGNALS)}")
        epoch, name, *values = (np.array(each) for each in zip(*rows, strict=True))
        satellites, j = np.unique(name, return_inverse=True)
        n = len(satellites)
        check_table(len(times), 2 * n)
    signals = [SIGNALS[x[0]][chosen[x[0]]] for x in satellites.tolist()]
    wave = SPEED_OF_LIGHT / np.array([each.frequency for each in signals])
    time, filled = np.array(times), np.full((4, len(times), n), np.nan)
    filled[:, epoch, j] = values
    filled[1::2] *= wave
    return Observations(
        time=time,
        segment=np.cumsum(np.diff(time, prepend=-np.inf) <= 0.0),
        satellites=tuple(satellites.tolist()),
        signals=tuple(signals),
        pseudorange=filled[0],
        range_rate=-filled[1],
        sd=np.hstack([filled[2], filled[3]]),
        left_out=dict(left_out.most_common()),
    )


def is_table(path: Path) -> bool:
    return not {".csv", ".parquet"}.isdisjoint(path.suffixes)


def _read_rinex(
    path: Path, left_out: Counter[str]
) -> tuple[list[float], list[_Row], dict[str, str]]:
    lines = read_text(path)
    version = check_version(lines[0] if lines else "", path, (2, 3))
    require(lines[0][20:21] == "O", f"it must be of observations (O), got {lines[0][20:40]!r}")
    end = next((k for k, line in enumerate(lines) if line[60:].strip() == "END OF HEADER"), None)
    if end is None:
        raise ValueError("it is cut short: its header has no end")
    types: dict[str, list[str]] = {}
    lag = _read_header(lines[:end], types)
    times, rows, chosen = list[float](), list[_Row](), dict[str, str]()
    for time, records in _list_epochs(lines, end + 1, version, types, left_out):
        times.append(time + lag)
        places = {x: _choose(types.get(x if version == 3 else "G", []), x) for x in SIGNALS}
        for satellite, record in records:
            if not (place := places.get(satellite[0])):
                left_out[f"of system {satellite[0]}"] += 1
                continue
            chosen[satellite[0]] = place[0]
            try:
                text = [record[16 * k : 16 * k + 14].strip() for k in place[1:]]
                length, shift = (float(x or "nan") for x in text)
            except ValueError:
                length = shift = np.nan
            left_out[ABSENT] += not (np.isfinite([length, shift]).all() and length and shift)
            rows.append((len(times) - 1, satellite, length, shift, np.nan, np.nan))
    if not chosen:
        found = " ".join(sorted({x for each in types.values() for x in each}))
        raise ValueError(
            "it must have pseudoranges with Doppler shifts, C1C and D1C (version 2: C1 and D1) of "
            f"GPS or Galileo, C2I and D2I of BeiDou, got {found or 'no types'}"
        )
    return times, rows, chosen


def _choose(types: list[str], system: str) -> tuple[str, int, int] | None:
    """Code of the signal, and the places of its pseudorange and Doppler shift."""
    both = [x for x in SIGNALS[system] if f"C{x}" in types and f"D{x}" in types]
    return (both[0], types.index(f"C{both[0]}"), types.index(f"D{both[0]}")) if both else None


def _read_header(lines: list[str], types: dict[str, list[str]]) -> float:
    """Note the types of observations by system (version 2: G for all); returns the lag of times."""
    lag, system = 0.0, "G"
    for line in lines:
        label = line[60:].strip()
        if label in ("# / TYPES OF OBSERV", "SYS / # / OBS TYPES"):
            if line[:6].strip():
                system = line[0] if label[0] == "S" else "G"
                types[system] = []
            types.setdefault(system, []).extend(line[6:60].split())
        elif label == "SYS / SCALE FACTOR":
            require(line[2:6].strip() in ("", "1"), f"scale factors are not read, got {line[:6]!r}")
        elif label == "TIME OF FIRST OBS":
            scale = line[48:51].strip() or "GPS"
            valid = scale in ("GPS", "GAL", "BDT")
            require(valid, f"its times must be those of GPS, GAL or BDT, got {scale}")
            lag = BEIDOU_LAG * (scale == "BDT")
    return lag


def _list_epochs(
    lines: list[str], k: int, version: int, types: dict[str, list[str]], left_out: Counter[str]
) -> Iterator[tuple[float, list[tuple[str, str]]]]:
    """Time of each epoch, and its satellites with their values side by side."""
    at = 28 if version == 2 else 31  # column of the flag, before the number of satellites
    while k < len(lines):
        line = lines[k]
        try:
            require(version == 2 or line.startswith(">"), "it is no epoch")
            flag, count = line[at : at + 1].strip() or "0", int(line[at + 1 : at + 4])
            require(flag in "0123456" and count >= 0, "it is no epoch")
            heads, each = 1, 1  # lines of the epoch and of a satellite
            if version == 2 and flag in "01":
                heads, each = max(1, -(-count // 12)), max(1, -(-len(types.get("G", [])) // 5))
            after = k + heads + count * each
            require(after <= len(lines), "it is cut short")
            own = [lines[j : j + each] for j in range(k + heads, after, each)]
            if flag in "01":
                time = gps_seconds(parse_date([line[a:b] for a, b in DATES[version]]))
                names = "".join(x[32:68].ljust(36) for x in lines[k : k + heads])
                if version == 2:
                    named = [_name(names[3 * j : 3 * j + 3]) for j in range(count)]
                    values = ["".join(x.ljust(80)[:80] for x in part) for part in own]
                else:
                    named = [_name(part[0][:3]) for part in own]
                    values = [part[0][3:] for part in own]
        except ValueError:
            left_out["malformed lines"] += bool(line.strip())
            k += 1
            continue
        if flag in "01":
            yield time, list(zip(named, values, strict=True))
        else:
            left_out["events"] += 1
            if flag == "4":
                _read_header([part[0] for part in own], types)
        k = after


def _name(text: str) -> str:
    """Name of a satellite; without a letter it is of GPS, and its number may begin with a blank."""
    number = int(text[1:])
    require(number > 0, f"a satellite has a number from 1 to 99, got {text!r}")
    return f"{text[0].replace(' ', 'G')}{number:02d}"


def _read_raw_table(
    path: Path, left_out: Counter[str]
) -> tuple[list[float], list[_Row], dict[str, str]]:
    table = read_table(path, (*TABLE, *SDS))
    missing = [name for name in TABLE if name not in table]
    require(
        not missing,
        f"a table of raw measurements needs {', '.join(TABLE)}; missing: {', '.join(missing)}",
    )
    time = (table["week"] * SECONDS_PER_WEEK + table["tow_s"]).to_numpy(dtype=np.float64)
    require(np.isfinite(time).all(), "`week` and `tow_s` must be finite")
    begins = np.diff(time, prepend=np.nan) != 0.0
    keys = [UBLOX_SIGNALS.get(x) for x in zip(table["gnss_id"], table["sig_id"], strict=True)]
    preferred = [(x, name) for x in SIGNALS for name in SIGNALS[x] if (x, name) in {*keys}]
    chosen = dict(reversed(preferred))
    columns = table.reindex(columns=["sv_id", "pr_m", "doppler_hz", *SDS]).to_numpy(np.float64)
    rows = list[_Row]()
    for epoch, key, (number, *values) in zip(
        np.cumsum(begins) - 1, keys, columns.tolist(), strict=True
    ):
        if key is None or chosen[key[0]] != key[1]:
            left_out["of other systems or signals"] += 1
        elif not (0.0 < number < 100.0 and np.isfinite(values[:2]).all()):
            left_out[ABSENT] += 1
        else:
            rows.append((int(epoch), f"{key[0]}{int(number):02d}", *values))
    return time[begins].tolist(), rows, chosen
