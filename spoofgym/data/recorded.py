"""Real input: a scenario from a recorded track and a navigation file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from ..core.reading import name_file
from ..truth.scenario import Scenario
from .cleaning import clean_track
from .ephemerides import (
    GPS_EPOCH,
    VALIDITY,
    BroadcastConstellation,
    Ephemerides,
    ScreeningReport,
    gps_seconds,
    join_ephemerides,
    screen,
)
from .rinex import read_navigation
from .track_fit import fit_track
from .tracks import read_track

ONLY_TRAJECTORY = (
    "Only the trajectory is real, and where satellites were: measurements, sensor errors and "
    "attacks are simulated."
)


@dataclass(frozen=True)
class RealInput:
    """A scenario from files, and how it was made.

    - `scenario`: flight and satellites of the files;
    - `lines`: text: what was dropped, how closely the flight fits the fixes, what was assumed;
    - `reports`: the same as data, with keys ``note``, ``track``, ``fit``,
      ``ephemeris``, ``time``.
    """

    scenario: Scenario
    lines: tuple[str, ...]
    reports: dict[str, Any]


def real_scenario(
    track: str | Path,
    ephemeris: str | Path | Sequence[str | Path],
    *,
    from_s: float | None = None,
    duration_s: float | None = None,
    day: date | None = None,
    altitude_unit: str | None = None,
    aircraft: str | None = None,
    interpolated: str = "drop",
    **settings: Any,
) -> RealInput:
    """Scenario of a recorded flight under the satellites of a navigation file, or of several.

    `from_s`: start [s] after the first row of the track; by default that of the longest airborne
    stretch without a gap; `duration_s`: duration [s]; by default ten minutes, or what the stretch
    offers; `day`: day of the flight; by default its own if the ephemerides are of it, else that of
    the ephemerides, at the same time of day; `altitude_unit`, `aircraft`: see `read_track`;
    `interpolated`: see `clean_track`.
    """
    raw = read_track(track, altitude_unit=altitude_unit, aircraft=aircraft)
    with name_file(track):
        fixes, cleaning = clean_track(
            raw, from_s=from_s, duration_s=duration_s, interpolated=interpolated
        )
        flight, fit = fit_track(fixes)
    files = [ephemeris] if isinstance(ephemeris, (str, Path)) else [*ephemeris]
    accepted, screening = screen(join_ephemerides([read_navigation(file) for file in files]))
    name = ", ".join(Path(file).name for file in files)
    own = fixes.start_utc.astimezone(UTC)
    start = datetime.combine(day or ephemeris_day(accepted, own), own.timetz())
    seconds = gps_seconds(start)
    with name_file(name):
        constellation = BroadcastConstellation(accepted, seconds)
    scenario = Scenario(name=fixes.name, flight=flight, constellation=constellation, **settings)
    seen = scenario.world().visible.sum(axis=1)
    return RealInput(
        scenario,
        (
            ONLY_TRAJECTORY,
            *cleaning.lines(),
            *fit.lines(),
            *screening_lines(name, screening),
            _time_line(own, start, name),
            f"{seen.min()} to {seen.max()} satellites with a valid record are visible in flight",
        ),
        {
            "note": ONLY_TRAJECTORY,
            "track": cleaning.as_dict(),
            "fit": fit.as_dict(),
            "ephemeris": {"name": name, **asdict(screening), "rejected": screening.rejected}
            | {"fewest_visible": int(seen.min()), "most_visible": int(seen.max())},
            "time": {
                "track_start_utc": own.isoformat(),
                "simulated_start_utc": start.isoformat(),
                "gps_seconds": seconds,
                "mapped": start != own,
            },
        },
    )


def ephemeris_day(ephemerides: Ephemerides, own: datetime) -> date:
    """The day of a flight itself where there are records of its first time, else the day of most
    records. `own`: time of its first fix, UTC."""
    dated = own.replace(tzinfo=None) >= GPS_EPOCH  # else the times are those of a day alone
    if dated and np.abs(ephemerides.time_of_ephemeris - gps_seconds(own)).min() <= VALIDITY:
        return own.date()
    days = np.floor(ephemerides.time_of_ephemeris / 86_400.0).astype(np.int64)
    found, counts = np.unique(days, return_counts=True)
    return (GPS_EPOCH + timedelta(days=int(found[counts.argmax()]))).date()


def screening_lines(name: str, report: ScreeningReport) -> list[str]:
    lines = [
        f"{name}: {report.records} GPS records, {report.duplicates} copies dropped, "
        f"{report.unhealthy} marked unhealthy and not used, {report.rejected} rejected for "
        f"contradicting their neighbours, {report.unchecked} without a neighbour to compare with, "
        f"{report.unresolved} pairs that disagree, both used",
    ]
    for satellite, seconds, distance in report.rejections:
        when = GPS_EPOCH + timedelta(seconds=seconds)
        lines.append(
            f"rejected: {satellite} of {when:%Y-%m-%d %H:%M:%S} GPS time, {distance:.0f} m off"
        )
    return lines


def _time_line(own: datetime, start: datetime, name: str) -> str:
    if start == own:
        return f"the flight is of {own:%Y-%m-%d}, the day of {name}"
    return (
        f"the time of day is mapped to another day: flown {own:%Y-%m-%d %H:%M:%S} UTC, simulated "
        f"{start:%Y-%m-%d %H:%M:%S} UTC, the day of {name}"
    )
