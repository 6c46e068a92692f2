"""Cleaning of recorded tracks, with a report of what was dropped and why.

Nothing is smoothed over here: a fix is kept as it is or dropped, and a course or speed is used
or not.  The rules are in `spoofgym.io.track_rules`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..earth.frames import geodetic_to_ecef
from ..sim.track import MINIMUM_FIXES, Track
from .track_rules import (
    LARGEST_GAP_S,
    POSITION_SD,
    broken_links,
    contradicting_speeds,
    interpolated_positions,
    isolated_outliers,
    late_positions,
    made_good,
    repeated_positions,
    resolved_courses,
    stale_runs,
    stretches,
)
from .tracks import KNOT, RawTrack

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

AIRBORNE_SPEED = 60.0 * KNOT
"""Speed over ground above which a fix counts as airborne [m/s]."""
DEFAULT_DURATION_S = 600.0
"""Duration of a track where none is asked for [s]."""


@dataclass(frozen=True)
class CleaningReport:
    """What cleaning found and dropped; counts are rows of the file unless said otherwise.

    - `name`: name of the file or flight;
    - `incomplete`: rows without latitude, longitude or altitude;
    - `repeated`: rows that repeat the position of the row before;
    - `late`: rows whose position is not newer than the one before;
    - `interpolated`: rows on the line between their neighbours, at the time that interpolation
      gives;
    - `position_outliers`, `height_outliers`: single fixes that neither neighbour can be reached
      from;
    - `grounded`: fixes at 60 kt or slower, or at an altitude of 0 or below;
    - `speeds_rejected`: groundspeeds that contradict the speed made good;
    - `angles_as_given`, `angles_unwrapped`, `angles_rejected`: course angles that agree with the
      course made good as they are, after adding or taking 256 deg, and not at all;
    - `stretches`: airborne stretches without a gap;
    - `stretch_s`: duration of the chosen stretch [s];
    - `start_utc`: time of the first fix of the track, ISO 8601;
    - `duration_s`: duration of the track [s];
    - `fixes`, `angles`: fixes of the track, and those among them with a course.
    """

    name: str
    rows: int
    incomplete: int
    repeated: int
    late: int
    interpolated: int
    position_outliers: int
    height_outliers: int
    grounded: int
    speeds_rejected: int
    angles_as_given: int
    angles_unwrapped: int
    angles_rejected: int
    stretches: int
    stretch_s: float
    start_utc: str
    duration_s: float
    fixes: int
    angles: int

    def as_dict(self) -> dict[str, str | int | float]:
        return asdict(self)

    def lines(self) -> list[str]:
        """Sentences for people."""
        kept = self.angles_as_given + self.angles_unwrapped
        return [
            f"{self.name}: {self.rows} rows, {self.incomplete} without a position or altitude",
            f"dropped: {self.repeated} repeated, {self.late} late, "
            f"{self.interpolated} interpolated positions",
            f"dropped: {self.position_outliers} outliers in position, "
            f"{self.height_outliers} in altitude, {self.grounded} not airborne",
            f"course angles: {kept} used ({self.angles_unwrapped} of them modulo 256), "
            f"{self.angles_rejected} rejected; groundspeeds: {self.speeds_rejected} rejected",
            f"{self.stretches} airborne stretches without a gap over {LARGEST_GAP_S:g} s; of one "
            f"that lasts {self.stretch_s:.0f} s",
            f"taken: {self.duration_s:.0f} s from {self.start_utc}, {self.fixes} fixes, "
            f"{self.angles} with a course",
            "the barometric altitude is taken as height above the ellipsoid",
        ]


def clean_track(
    raw: RawTrack,
    *,
    from_s: float | None = None,
    duration_s: float | None = None,
    interpolated: Literal["drop", "keep"] = "drop",
) -> tuple[Track, CleaningReport]:
    """Clean a recorded track and cut out a stretch that was flown without a gap. `from_s`: start of
    the cut [s] since the first row of the file; by default the start of the longest stretch;
    `duration_s`: duration of the cut [s]; by default ten minutes, or what the stretch offers."""
    if interpolated not in {"drop", "keep"}:
        raise ValueError(f"`interpolated` must be 'drop' or 'keep', got {interpolated!r}")
    counts: dict[str, int] = {"rows": raw.time.size}
    fixes = _distinct_fixes(raw, counts, interpolated == "drop")
    fixes = _without_outliers(fixes, counts)
    angle, speed = _trusted_velocities(fixes, counts)
    found = _airborne_stretches(raw.name, fixes, speed, counts)
    elapsed = fixes.time - raw.time[0]
    first, last = _chosen_stretch(elapsed, found, from_s)
    cut = _cut(elapsed, (first, last), from_s, duration_s)
    fixes, angle = fixes[cut], angle[cut]
    start = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=float(fixes.time[0]))
    track = Track(
        raw.name,
        start,
        fixes.time - fixes.time[0],
        fixes.latitude,
        fixes.longitude,
        fixes.altitude,
        fixes.groundspeed,
        angle,
    )
    report = CleaningReport(
        name=raw.name,
        **counts,
        stretch_s=float(elapsed[last] - elapsed[first]),
        start_utc=start.isoformat(),
        duration_s=track.duration,
        fixes=track.time.size,
        angles=int(np.isfinite(angle).sum()),
    )
    return track, report


@dataclass(eq=False)
class _Fixes:
    """Fixes still in the running, with the times of their positions."""

    time: Floats
    latitude: Floats
    longitude: Floats
    altitude: Floats
    groundspeed: Floats
    track_deg: Floats

    def __getitem__(self, kept: Mask) -> _Fixes:
        return _Fixes(*(getattr(self, field)[kept] for field in self.__dataclass_fields__))

    @property
    def position_e(self) -> Floats:
        """(n, 3) positions on the ellipsoid, ECEF [m]."""
        return geodetic_to_ecef(self.latitude, self.longitude, 0.0)


def _distinct_fixes(raw: RawTrack, counts: dict[str, int], drop_interpolated: bool) -> _Fixes:
    """Rows that hold a position of their own, at the true time of it."""
    known = np.isfinite(raw.position_time)
    fixes = _Fixes(
        np.where(known, raw.position_time, raw.time),
        raw.latitude,
        raw.longitude,
        raw.altitude,
        raw.groundspeed,
        raw.track_deg,
    )
    complete = np.isfinite(raw.latitude + raw.longitude + raw.altitude)
    if complete.sum() < MINIMUM_FIXES:
        raise ValueError(
            f"{raw.name!r} must have at least {MINIMUM_FIXES} rows with a position and an "
            f"altitude, got {complete.sum()}"
        )
    fixes, known = fixes[complete], known[complete]
    again = repeated_positions(fixes.latitude, fixes.longitude, known)
    fixes = fixes[~again]
    late = late_positions(fixes.time)
    fixes = fixes[~late]
    between = interpolated_positions(fixes.time, fixes.latitude, fixes.longitude)
    between &= drop_interpolated
    counts["incomplete"] = int((~complete).sum())
    counts["repeated"] = int(again.sum())
    counts["late"] = int(late.sum())
    counts["interpolated"] = int(between.sum())
    return fixes[~between]


def _without_outliers(fixes: _Fixes, counts: dict[str, int]) -> _Fixes:
    """Fixes without single ones that are off in altitude or position."""
    off = isolated_outliers(fixes.time, fixes.altitude[:, None], 300.0, 10.0)
    counts["height_outliers"] = int(off.sum())
    fixes = fixes[~off]
    off = isolated_outliers(fixes.time, fixes.position_e, 5.0 * POSITION_SD, 10.0)
    counts["position_outliers"] = int(off.sum())
    return fixes[~off]


def _trusted_velocities(fixes: _Fixes, counts: dict[str, int]) -> tuple[Floats, Floats]:
    """Courses to be trusted, and speeds: reported ones where trusted, else made good. Groundspeeds
    that are not to be trusted become NaN in the fixes."""
    made = made_good(fixes.time, fixes.latitude, fixes.longitude)
    wrong = contradicting_speeds(fixes.groundspeed, made)
    wrong |= stale_runs(fixes.groundspeed, wrong)
    fixes.groundspeed[wrong] = np.nan
    angle, unwrapped = resolved_courses(fixes.track_deg, made.course)
    rejected = np.isfinite(fixes.track_deg) & np.isnan(angle)
    rejected |= stale_runs(fixes.track_deg, rejected)
    angle[rejected] = np.nan
    counts["speeds_rejected"] = int(wrong.sum())
    counts["angles_as_given"] = int((np.isfinite(angle) & ~unwrapped).sum())
    counts["angles_unwrapped"] = int((np.isfinite(angle) & unwrapped).sum())
    counts["angles_rejected"] = int(rejected.sum())
    return angle, np.where(np.isnan(fixes.groundspeed), made.speed, fixes.groundspeed)


def _airborne_stretches(
    name: str, fixes: _Fixes, speed: Floats, counts: dict[str, int]
) -> list[tuple[int, int]]:
    """Stretches in the air and without a gap, longest first; at least one."""
    airborne = (speed > AIRBORNE_SPEED) & (fixes.altitude > 0.0)
    found = stretches(fixes.time, broken_links(fixes.time, fixes.position_e), airborne)
    found = [(first, last) for first, last in found if last - first + 1 >= MINIMUM_FIXES]
    counts["grounded"] = int((~airborne).sum())
    counts["stretches"] = len(found)
    if not found:
        tally = ", ".join(f"{key} {value}" for key, value in counts.items())
        raise ValueError(
            f"{name!r} must have an airborne stretch of at least {MINIMUM_FIXES} fixes without a "
            f"gap over {LARGEST_GAP_S:g} s, got none ({tally}); a simulated track without noise "
            "needs interpolated='keep'"
        )
    return found


def _chosen_stretch(
    elapsed: Floats, found: list[tuple[int, int]], from_s: float | None
) -> tuple[int, int]:
    """Longest stretch, or the one that a time lies in."""
    if from_s is None:
        return found[0]
    for a, b in found:
        if elapsed[a] <= from_s < elapsed[b]:
            return a, b
    offered = ", ".join(f"{elapsed[a]:.0f} to {elapsed[b]:.0f}" for a, b in sorted(found[:10]))
    raise ValueError(f"`from_s` must lie in an airborne stretch ({offered} s), got {from_s:g} s")


def _cut(
    elapsed: Floats, stretch: tuple[int, int], from_s: float | None, duration_s: float | None
) -> Mask:
    """Fixes of the stretch between two times."""
    start = elapsed[stretch[0]] if from_s is None else from_s
    rest = float(elapsed[stretch[1]] - start)
    if duration_s is not None and not 0.0 < duration_s <= rest + 1e-6:
        raise ValueError(f"`duration_s` must be at most {rest:.0f} s here, got {duration_s:g} s")
    end = start + min(DEFAULT_DURATION_S if duration_s is None else duration_s, rest)
    inside = (elapsed >= start) & (elapsed <= end + 1e-6)
    inside[: stretch[0]] = inside[stretch[1] + 1 :] = False
    return inside
