"""Raw measurements of a receiver: RINEX observation files, and tables of raw measurements.

RINEX is read as "RINEX: The Receiver Independent Exchange Format", versions 2.11 and 3.05, has it:
a header with the types of observations of each system, then for each epoch a line with its time,
and one for each satellite (in version 2 one for every five types).  Of every system one signal is
used, the first of `SIGNALS` that the file has.

Tables (CSV, Parquet) have a row for each satellite and signal with the columns of u-blox's
UBX-RXM-RAWX: `week, tow_s, gnss_id, sv_id, sig_id, pr_m, doppler_hz`, and `pr_stdev_m`,
`doppler_stdev_hz` where there are any.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.reading import FileError, check_table, name_file, read_table
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
    "G": {name: Signal(1575.42e6) for name in ("1C", "1", "1W", "1P")},
    "E": {name: Signal(1575.42e6) for name in ("1C", "1X", "1B", "1")},
    "C": {
        **{name: Signal(1561.098e6) for name in ("2I", "1I", "2X")},
        **{name: Signal(1575.42e6) for name in ("1P", "1D", "1X")},
        **{name: Signal(1268.52e6, 0.0) for name in ("6I", "6X")},
    },
}
"""Signals by system and the code of RINEX behind C or D, the preferred first. Clocks
of BeiDou are those of B3; the delay of B1I is taken for B1C, whose own is in newer messages."""
UBLOX_SYSTEMS = {0: "G", 2: "E", 3: "C"}
UBLOX_SIGNALS = {
    **{("G", 0): "1C", ("E", 0): "1C", ("E", 1): "1B"},
    **{("C", 0): "2I", ("C", 1): "2I", ("C", 5): "1P", ("C", 6): "1D", ("C", 4): "6I"},
}
"""u-blox's numbers of systems and signals (interface description, sections on GNSS identifiers)."""
TABLE = ("week", "tow_s", "gnss_id", "sv_id", "sig_id", "pr_m", "doppler_hz")
SDS = ("pr_stdev_m", "doppler_stdev_hz")
MOST_SATELLITES = 999  # of an epoch: its number has three columns


@dataclass(frozen=True, kw_only=True)
class Observations:
    """What a receiver measured, nothing of it corrected.

    - `time` (K,) of the epochs by the receiver's clock, GPS seconds [s];
    - `segment` (K,) int, one more wherever the time does not rise;
    - `satellites` (n,) "G01"; `signals` of every system;
    - `pseudorange`, `range_rate` (K, n) [m], [m/s], NaN where absent;
    - `sd` (K, 2n) what the receiver itself believes of their errors, NaN where it says nothing;
    - `left_out`: number of what was not used, by what it is.
    """

    time: Floats
    segment: NDArray[np.int64]
    satellites: tuple[str, ...]
    signals: dict[str, str]
    pseudorange: Floats
    range_rate: Floats
    sd: Floats
    left_out: dict[str, int]

    def signal(self, satellite: int) -> Signal:
        system = self.satellites[satellite][0]
        return SIGNALS[system][self.signals[system]]


def read_observations(path: str | os.PathLike[str]) -> Observations:
    """Observations of a RINEX file, or of a table of raw measurements.

    A `spoofgym.core.reading.FileError` says why the file can't be read.
    """
    path = Path(path)
    with name_file(path):
        return (_read_raw_table if is_table(path) else _read_rinex)(path)


def is_table(path: Path) -> bool:
    return {".csv", ".parquet"} & set(path.suffixes[-2:]) != set()


class _Row(NamedTuple):
    epoch: int
    satellite: str
    pseudorange: float
    range_rate: float
    sds: tuple[float, float] = (np.nan, np.nan)


def _gather(
    times: list[float], rows: list[_Row], signals: dict[str, str], left_out: Counter[str]
) -> Observations:
    require(rows, f"it holds no pseudorange with a Doppler shift of {', '.join(SIGNALS)}")
    satellites = tuple(sorted({row.satellite for row in rows}))
    check_table(len(times), 2 * len(satellites))
    place = {name: j for j, name in enumerate(satellites)}
    k, j = np.array([(row.epoch, place[row.satellite]) for row in rows]).T
    ranges, rates = np.full((2, len(times), len(satellites)), np.nan)
    sds = np.full((len(times), 2, len(satellites)), np.nan)
    ranges[k, j] = [row.pseudorange for row in rows]
    rates[k, j] = [row.range_rate for row in rows]
    sds[k, :, j] = [row.sds for row in rows]
    time = np.array(times)
    return Observations(
        time=time,
        segment=np.cumsum(np.diff(time, prepend=-np.inf) <= 0.0),
        satellites=satellites,
        signals=signals,
        pseudorange=ranges,
        range_rate=rates,
        sd=sds.reshape(len(time), -1),
        left_out=dict(left_out.most_common()),
    )


# --- RINEX -----------------------------------------------------------------------------------


class _Header:
    """Types of observations by system, the scale of time, and what is chosen of them."""

    def __init__(self, version: int) -> None:
        self.version, self.lag, self._system = version, 0.0, ""
        self.types: dict[str, list[str]] = {}

    def read(self, line: str) -> None:
        label = line[60:].strip()
        if label == "# / TYPES OF OBSERV":
            if line[:6].strip():
                self.types = {"": []}
            self.types[""] += line[6:60].split()
        elif label == "SYS / # / OBS TYPES":
            if line[0] != " ":
                self._system = line[0]
                self.types[self._system] = []
            self.types.setdefault(self._system, []).extend(line[6:60].split())
        elif label == "SYS / SCALE FACTOR" and line[2:6].strip() not in ("", "1"):
            raise FileError(f"its scale factor {line[:6]!r} is not read, valid is 1")
        elif label == "TIME OF FIRST OBS":
            scale = line[48:51].strip() or "GPS"
            require(
                scale in ("GPS", "GAL", "BDT"),
                f"its times must be those of GPS, GAL or BDT, got {scale}",
            )
            self.lag = BEIDOU_LAG if scale == "BDT" else 0.0

    def list_types(self, system: str) -> list[str]:
        return self.types.get("" if self.version == 2 else system, [])

    def choose(self) -> dict[str, tuple[str, int, int]]:
        """Signal of each system, and its places of pseudorange and Doppler shift."""
        chosen = {}
        for system, signals in SIGNALS.items():
            types = self.list_types(system)
            both = [x for x in signals if f"C{x}" in types and f"D{x}" in types]
            if both:
                name = both[0]
                chosen[system] = name, types.index(f"C{name}"), types.index(f"D{name}")
        if not chosen:
            found = " ".join(sorted({x for each in self.types.values() for x in each}))
            raise FileError(
                "a replay needs pseudoranges with Doppler shifts, C1C and D1C (version 2: C1 and "
                f"D1) of GPS or Galileo, C2I and D2I of BeiDou, got {found or 'no types'}"
            )
        return chosen


def _read_rinex(path: Path) -> Observations:
    lines = read_text(path)
    header = _Header(check_version(lines[0] if lines else "", path, (2, 3)))
    require(lines[0][20:21] == "O", f"it is not of observations (O), got {lines[0][20:40]!r}")
    end = next((k for k, line in enumerate(lines) if line[60:].strip() == "END OF HEADER"), None)
    if end is None:
        raise FileError("it is cut short: its header has no end")
    for line in lines[:end]:
        header.read(line)
    chosen = header.choose()
    times, rows, left_out = list[float](), list[_Row](), Counter[str]()
    for time, records in _list_epochs(lines, end + 1, header, left_out):
        chosen = header.choose()  # an event may have other types
        times.append(time + header.lag)
        for satellite, record in records:
            system = satellite[0]
            if system not in chosen:
                left_out[f"of system {system}"] += 1
                continue
            name, *places = chosen[system]
            try:
                text = [record[16 * place : 16 * place + 14].strip() for place in places]
                values = [float(x) if x else 0.0 for x in text]
            except ValueError:
                left_out["malformed"] += 1
                continue
            if not all(np.isfinite(values)) or 0.0 in values:  # which both mean that it is absent
                left_out["without pseudorange or Doppler shift"] += 1
                continue
            length = SPEED_OF_LIGHT / SIGNALS[system][name].frequency
            rows.append(_Row(len(times) - 1, satellite, values[0], -length * values[1]))
    return _gather(times, rows, {x: each[0] for x, each in chosen.items()}, left_out)


def _list_epochs(
    lines: list[str], k: int, header: _Header, left_out: Counter[str]
) -> Iterator[tuple[float, list[tuple[str, str]]]]:
    """Time of each epoch, and the satellites with their values side by side."""
    parse: Callable[[list[str], int, _Header], tuple[str, float, int, list[tuple[str, str]]]]
    parse = _parse_epoch_2 if header.version == 2 else _parse_epoch_3
    while k < len(lines):
        try:
            flag, time, after, records = parse(lines, k, header)
        except ValueError:
            left_out["malformed lines"] += bool(lines[k].strip())
            k += 1
            continue
        if flag in "01":
            yield time, records
        else:
            left_out["events"] += 1
            for line in lines[k + 1 : after] if flag == "4" else ():
                header.read(line)
        k = after


def _parse_epoch_3(
    lines: list[str], k: int, _: _Header
) -> tuple[str, float, int, list[tuple[str, str]]]:
    line = lines[k]
    require(line[:1] == ">", "it must begin with >")
    flag, count = line[31:32], int(line[32:35])
    after = k + 1 + count
    require(flag in set("0123456") and count >= 0 and after <= len(lines), "it is cut short")
    if flag not in "01":
        return flag, 0.0, after, []
    date = [line[a:b] for a, b in ((2, 6), (7, 9), (10, 12), (13, 15), (16, 18), (18, 29))]
    records = [(_name(each[:3]), each[3:]) for each in lines[k + 1 : after]]
    return flag, gps_seconds(parse_date(date)), after, records


def _parse_epoch_2(
    lines: list[str], k: int, header: _Header
) -> tuple[str, float, int, list[tuple[str, str]]]:
    line = lines[k]
    flag, count = line[28:29].replace(" ", "0") or "0", int(line[29:32])
    require(flag in set("0123456") and 0 <= count <= MOST_SATELLITES, "it is no epoch")
    if flag not in "01":
        require(k + count < len(lines), "it is cut short")
        return flag, 0.0, k + 1 + count, []
    date = [line[a:b] for a, b in ((1, 3), (4, 6), (7, 9), (10, 12), (13, 15), (15, 26))]
    first = k + max(1, -(-count // 12))
    names = "".join(each[32:68].ljust(36) for each in lines[k:first])
    each_takes = max(1, -(-len(header.list_types("")) // 5))
    after = first + count * each_takes
    require(after <= len(lines), "it is cut short")
    records = []
    for j in range(count):
        own = lines[first + j * each_takes : first + (j + 1) * each_takes]
        values = "".join(each.ljust(80)[:80] for each in own)
        records.append((_name(names[3 * j : 3 * j + 3]), values))
    return flag, gps_seconds(parse_date(date)), after, records


def _name(text: str) -> str:
    """Name of a satellite; a blank before the number is GPS in version 2, or a zero."""
    number = int(text[1:])
    require(0 < number < 100, f"a satellite has a number of 1 to 99, got {text!r}")
    return f"{text[0].replace(' ', 'G')}{number:02d}"


# --- tables ----------------------------------------------------------------------------------


def _read_raw_table(path: Path) -> Observations:
    table = read_table(path, (*TABLE, *SDS))
    missing = [name for name in TABLE if name not in table]
    require(
        not missing,
        f"a table of raw measurements needs {', '.join(TABLE)}; missing: {', '.join(missing)}",
    )
    system = [UBLOX_SYSTEMS.get(x, "other") for x in table["gnss_id"]]
    name = [UBLOX_SIGNALS.get(key) for key in zip(system, table["sig_id"], strict=True)]
    there = set(zip(system, name, strict=True))
    signals = {
        x: next(each for each in SIGNALS[x] if (x, each) in there)
        for x in SIGNALS
        if any((x, each) in there for each in SIGNALS[x])
    }
    time = table["week"].to_numpy() * SECONDS_PER_WEEK + table["tow_s"].to_numpy()
    begins = np.diff(time, prepend=np.nan) != 0.0
    times = time[begins].tolist()
    sds = table[list(SDS)].to_numpy() if set(SDS) <= set(table) else np.full((len(time), 2), np.nan)
    values = np.column_stack([table[["sv_id", "pr_m", "doppler_hz"]].to_numpy(), sds])
    rows, left_out = list[_Row](), Counter[str]()
    for epoch, x, of, (number, length, doppler, *sd) in zip(
        np.cumsum(begins) - 1, system, name, values.tolist(), strict=True
    ):
        if x not in signals:
            left_out["of other systems"] += 1
        elif of != signals[x]:
            left_out["of other signals"] += 1
        elif not np.isfinite([number, length, doppler]).all() or 0.0 in (length, doppler):
            left_out["without pseudorange or Doppler shift"] += 1
        else:
            wave = SPEED_OF_LIGHT / SIGNALS[x][of].frequency
            both = sd[0], wave * sd[1]
            rows.append(_Row(int(epoch), f"{x}{int(number):02d}", length, -wave * doppler, both))
    return _gather(times, rows, signals, left_out)
