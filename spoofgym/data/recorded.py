"""Real input: a scenario from a recorded track and a navigation file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..earth.wgs84 import dcm_e_from_n, ecef_to_geodetic, look_angles
from ..truth.flight import Flight
from ..truth.run import FEWEST_CHANNELS
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
    "only the trajectory and the orbits are real: measurements, errors and inertial sensors are "
    "simulated"
)
CHECKED_EVERY_S = 30.0  # time between two counts of the satellites in view [s]


@dataclass(frozen=True)
class RealInput:
    """A scenario from files, and how it was made.

    - `scenario`: flight and satellites of the files;
    - `lines`: text: what was dropped, how closely the flight fits the fixes, what was assumed;
    - `reports`: the same as data, with keys ``real``, ``track``, ``fit``, ``ephemeris``, ``time``.
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
    aircraft: str | None = None,
    altitude_unit: Literal["ft", "m"] | None = None,
    interpolated: Literal["drop", "keep"] = "drop",
    **settings: Any,
) -> RealInput:
    """Scenario of a recorded flight under the satellites of navigation files, which are joined.

    `from_s`: start [s] after the first row of the track; by default that of the longest airborne
    stretch without a gap; `duration_s`: duration [s]; by default ten minutes, or what the stretch
    offers; `day`: day of the flight; by default its own if the ephemerides are of it, else that of
    the ephemerides, at the same time of day; `aircraft`, `altitude_unit`: as of `read_track`;
    `interpolated`: as of `clean_track`. A ValueError where satellites run out in flight.
    """
    raw = read_track(track, altitude_unit=altitude_unit, aircraft=aircraft)
    fixes, cleaning = clean_track(
        raw, from_s=from_s, duration_s=duration_s, interpolated=interpolated
    )
    flight, fit = fit_track(fixes)
    paths = [ephemeris] if isinstance(ephemeris, (str, Path)) else list(ephemeris)
    accepted, screening = screen(join_ephemerides([read_navigation(path) for path in paths]))
    own = fixes.start_utc.astimezone(UTC)
    start = datetime.combine(day or _choose_day(accepted, own), own.timetz())
    seconds = gps_seconds(start)
    constellation = BroadcastConstellation(accepted, seconds)
    scenario = Scenario(name=fixes.name, flight=flight, constellation=constellation, **settings)
    name = ", ".join(Path(path).name for path in paths)
    return RealInput(
        scenario,
        (
            ONLY_TRAJECTORY,
            *cleaning.lines(),
            *fit.lines(),
            *screening_lines(name, screening),
            _time_line(own, start, name),
            *describe_satellites(flight, constellation, scenario.mask_deg),
        ),
        {
            "real": ONLY_TRAJECTORY,
            "track": cleaning.as_dict(),
            "fit": fit.as_dict(),
            "ephemeris": {"name": name, **asdict(screening), "rejected": screening.rejected},
            "time": {
                "track_start_utc": own.isoformat(),
                "simulated_start_utc": start.isoformat(),
                "gps_seconds": seconds,
                "mapped": start != own,
            },
        },
    )


def _choose_day(ephemerides: Ephemerides, own: datetime) -> date:
    """The flight's own day where the records are of it, else that of most records."""
    healthy = ephemerides.time_of_ephemeris[ephemerides.healthy]
    known = own.replace(tzinfo=None) >= GPS_EPOCH and healthy.size > 0
    if known and np.abs(healthy - gps_seconds(own)).min() <= VALIDITY:
        return own.date()
    return ephemeris_day(ephemerides)


def describe_satellites(
    flight: Flight, constellation: BroadcastConstellation, mask_deg: float
) -> list[str]:
    """How many satellites are in view, and which of them end in flight since their records do.

    Raises
    ------
    ValueError
        Where fewer than `FEWEST_CHANNELS` are left at any time.
    """
    time = np.arange(0.0, flight.duration + CHECKED_EVERY_S, CHECKED_EVERY_S)
    time[-1] = min(time[-1], flight.duration)
    sample = np.searchsorted(flight.time, time).clip(max=len(flight.time) - 1)
    position = flight.position_e[sample]
    latitude, longitude, _ = ecef_to_geodetic(position)
    axes = dcm_e_from_n(latitude, longitude)
    satellites = constellation.states(time).position_e
    known = np.isfinite(satellites[..., 0])
    elevation, _ = look_angles(np.nan_to_num(satellites, nan=0.0), position, axes)
    high = np.degrees(elevation) >= mask_deg
    count = (known & high).sum(axis=1)
    ended = known[:-1] & high[:-1] & ~known[1:]
    lost = {
        constellation.satellite_ids[k]: float(time[1:][ended[:, k]][0])
        for k in np.flatnonzero(ended.any(axis=0))
    }
    listed = ", ".join(f"{name} {when:.0f} s" for name, when in lost.items())
    said = f"the records of {len(lost)} satellites end in flight, after {listed}" if lost else ""
    if count.min() < FEWEST_CHANNELS:
        when = float(time[count.argmin()])
        raise ValueError(
            f"{count.min()} satellites are in view {when:.0f} s into the flight, and at least "
            f"{FEWEST_CHANNELS} are needed"
            + (f": {said}; add the navigation file of the hours after it" if said else "")
        )
    view = f"satellites above {mask_deg:g} deg: {count.min()} to {count.max()}"
    return [view, *([f"{said}: add the navigation file of the hours after it"] if said else [])]


def ephemeris_day(ephemerides: Ephemerides) -> date:
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
