"""Cleaning of recorded tracks: rules, arrays in, True where a row doesn't count; and a report.

Rules and limits follow from what recorded tracks look like: rows at a fixed rate that repeat or
interpolate sparser fixes, fixes with about 100 m of error since their times are late by up to a
second, courses stored in a signed byte, fields that went stale.  Nothing is smoothed over: a fix
stays as it is or is dropped, and a course or speed is used or not.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_word
from ..core.registry import require
from ..earth.wgs84 import EQUATORIAL_RADIUS, geodetic_to_ecef
from .made_good import (
    COURSE_TOLERANCE,
    DISTINCT,
    LARGEST_GAP_S,
    LONG_CHORD_S,
    SPEED_TOLERANCE,
    GroundTrack,
    compute_ground_track,
    find_lasting,
    find_mistaken_altitude,
    find_mistaken_course,
    find_mistaken_speed,
    wrap,
)
from .track_fit import MINIMUM_FIXES, POSITION_SD, Track
from .tracks import KNOT, RawTrack

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
INTERPOLATION_TOLERANCE = 0.5  # from the line between its neighbours, of an interpolated fix [m]
STALE_SHARE = 0.1  # rejected share of a run of one value above which the whole run counts as stale
HEIGHT_ERROR = 300.0  # largest error of an altitude that is believed [m]
HIGHEST_SPEED, HIGHEST_CLIMB = 350.0, 60.0  # highest speeds believed between two fixes [m/s]
AIRBORNE_SPEED = 60.0 * KNOT  # speed over ground above which a fix counts as airborne [m/s]
DEFAULT_DURATION_S = 600.0  # duration of a track where none is requested [s]


def repeated_positions(latitude: Floats, longitude: Floats, known: Mask) -> Mask:
    """Rows that repeat the position of the row before, so that each position counts once.

    A receiver repeats a position until the next one comes.  Before the first one there is nothing
    to repeat: a first run of equal positions without any known time was filled backwards, and
    only its last row counts.

    `known` (n,) whether the file gives the time of the position.
    """
    same = (np.diff(latitude) == 0.0) & (np.diff(longitude) == 0.0)
    again = np.concatenate([[False], same])[: latitude.size]
    first = int(np.argmin(np.append(same, False)))
    if first > 0 and not known[: first + 1].any():
        again[:first] = True
        again[first] = False
    return again


def late_positions(time: Floats) -> Mask:
    """Rows whose position isn't newer than all before; a time counts once."""
    return np.concatenate([[False], time[1:] <= np.maximum.accumulate(time)[:-1]])[: time.size]


def interpolated_positions(time: Floats, latitude: Floats, longitude: Floats) -> Mask:
    """Rows on the line between their neighbours, at the time that interpolation gives: of a run of
    equal displacements, only the fix at each end was ever observed. Geodetic [rad]."""
    north = EQUATORIAL_RADIUS * off_line(time, latitude[:, None])
    east = EQUATORIAL_RADIUS * np.cos(latitude) * off_line(time, np.unwrap(longitude)[:, None])
    between = np.hypot(north, east) < INTERPOLATION_TOLERANCE
    between[:1] = between[-1:] = False
    return between


def off_line(time: Floats, value: Floats) -> Floats:
    """(n,) distance of each row of `value` (n, k) from its neighbours' line; 0 at both ends."""
    distance = np.zeros(time.size)
    if time.size > 2:
        weight = ((time[1:-1] - time[:-2]) / (time[2:] - time[:-2]))[:, None]
        line = value[:-2] + weight * (value[2:] - value[:-2])
        distance[1:-1] = np.linalg.norm(value[1:-1] - line, axis=1)
    return distance


def _excess(time: Floats, value: Floats, allowance: float, acceleration: float) -> Floats:
    believed = np.full(time.size, allowance)
    believed[1:-1] += 0.5 * acceleration * np.diff(time)[:-1] * np.diff(time)[1:]
    return np.asarray(off_line(time, value) / believed)


def isolated_outliers(time: Floats, value: Floats, allowance: float, acceleration: float) -> Mask:
    """Single rows that neither neighbour leads to, while the neighbours lead to each other.

    A row is off when it lies further from the line between its neighbours than an allowance for
    errors and half the acceleration times the product of both intervals.  Off rows go one by
    one, worst of their surroundings first, and only if that heals the surroundings: a jump that
    lasts is not an outlier, and breaks the track instead.

    `value` (n, k) coordinates [m]; `allowance`, `acceleration`: believed [m], [m/s^2].
    """
    used = np.arange(time.size)
    while True:
        excess = _excess(time[used], value[used], allowance, acceleration)
        padded = np.pad(excess, 1)
        worst = (excess > 1.0) & (excess >= padded[:-2]) & (excess >= padded[2:])
        healing = []
        for index in np.flatnonzero(worst):
            near = np.concatenate([used[max(index - 2, 0) : index], used[index + 1 : index + 3]])
            if (_excess(time[near], value[near], allowance, acceleration) <= 1.0).all():
                healing.append(index)
        if not healing:
            break
        used = np.delete(used, healing)
    off = np.ones(time.size, dtype=np.bool_)
    off[used] = False
    return off


def broken_links(time: Floats, position_e: Floats, altitude: Floats) -> Mask:
    """(n-1,) which fixes don't lead on to the next: gaps, and jumps that last."""
    interval = np.diff(time)
    broken = interval > LARGEST_GAP_S
    for value, allowance, highest in (
        (position_e, 5.0 * POSITION_SD, HIGHEST_SPEED),
        (altitude[:, None], HEIGHT_ERROR, HIGHEST_CLIMB),
    ):
        distance = np.linalg.norm(np.diff(value, axis=0), axis=1)
        broken |= distance > allowance + highest * interval
        for index in np.flatnonzero(_excess(time, value, allowance, 10.0) > 1.0):
            faster = distance[index] / interval[index] > distance[index - 1] / interval[index - 1]
            broken[index if faster else index - 1] = True
    return broken


def contradicting_speeds(groundspeed: Floats, made: GroundTrack) -> Mask:
    """Reported speeds [m/s] that can't be true, a stale one for instance: outside chord and path
    speed by a tenth and three standard deviations."""
    margin = 3.0 * math.sqrt(2.0) * POSITION_SD / made.span
    too_low = groundspeed < 0.9 * made.speed - margin
    too_high = groundspeed > 1.1 * made.path_speed + margin
    return np.asarray(too_low | too_high)


def stale_runs(value: Floats, wrong: Mask) -> Mask:
    """Runs of one and the same value of which more than `STALE_SHARE` was rejected as `wrong`, too
    much for the rest to be right; NaN where missing."""
    run = np.cumsum(np.diff(value, prepend=value[:1]) != 0.0)
    share = np.bincount(run, wrong) / np.maximum(np.bincount(run), 1)
    return np.asarray(np.isfinite(value) & (share[run] > STALE_SHARE))


def stale_speeds(time: Floats, groundspeed: Floats, made: GroundTrack) -> Mask:
    """All speeds [m/s], where they are of one value or two, and positions move otherwise."""
    used = np.isfinite(groundspeed) & (groundspeed > 0.0) & made.straight
    if np.unique(groundspeed[used]).size >= DISTINCT:
        return np.zeros(time.size, dtype=np.bool_)
    off = np.log(made.speed[used] / groundspeed[used])
    lasting = find_lasting(time[used], off, SPEED_TOLERANCE)
    return np.isfinite(groundspeed) & (lasting is not None)


def resolved_courses(track_deg: Floats, course: Floats) -> tuple[Floats, Mask]:
    """Reported courses where they agree with the course made good.

    When all of them fit a signed byte, from -128 to 127 deg, they may have been stored in one,
    and 256 deg more and less are tried too.

    `track_deg` (n,) as recorded [deg], NaN where missing; `course` (n,) made good [rad], NaN where
    missing; returns `angle` (n,) course [rad] in (-pi, pi], NaN where rejected or missing;
    `unwrapped` (n,) True where it agrees after adding or taking 256 deg, and not as it is.
    """
    finite = track_deg[np.isfinite(track_deg)]
    is_byte = finite.size > 0 and finite.min() >= -128.0 and finite.max() <= 127.0
    angle = np.full(track_deg.size, np.nan)
    best = np.full(track_deg.size, COURSE_TOLERANCE)
    unwrapped = np.zeros(track_deg.size, dtype=np.bool_)
    for shift in (0.0, 256.0, -256.0) if is_byte else (0.0,):
        candidate = np.radians(track_deg + shift)
        difference = np.abs(wrap(candidate - course))
        better = difference <= best if shift == 0.0 else difference < best
        angle = np.where(better, wrap(candidate), angle)
        best = np.where(better, difference, best)
        unwrapped = np.where(better, shift != 0.0, unwrapped)
    return angle, unwrapped


def stretches(time: Floats, broken: Mask, airborne: Mask) -> list[tuple[int, int]]:
    """Airborne stretches without a broken link, (n-1,), longest first."""
    linked = np.concatenate([[False], ~broken & airborne[1:] & airborne[:-1], [False]])
    edges = np.flatnonzero(np.diff(linked.astype(np.int8)))
    found = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return sorted(found, key=lambda pair: float(time[pair[0]] - time[pair[1]]))


@dataclass(frozen=True)
class CleaningReport:
    """What cleaning found and dropped; counts are rows of the file unless said otherwise.

    - `name`: name of the file or flight; `altitude`: which column it is, and its unit; `rows`: all
      of them; `unsorted`: those that came too late in the file;
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
    altitude: str
    rows: int
    unsorted: int
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
        used = self.angles_as_given + self.angles_unwrapped
        return [
            f"{self.name}: {self.rows} rows, {self.incomplete} without a position or altitude",
            f"dropped: {self.repeated} repeated, {self.late} late, "
            f"{self.interpolated} interpolated positions",
            f"dropped: {self.position_outliers} outliers in position, "
            f"{self.height_outliers} in altitude, {self.grounded} not airborne",
            f"course angles: {used} used ({self.angles_unwrapped} of them modulo 256), "
            f"{self.angles_rejected} rejected; groundspeeds: {self.speeds_rejected} rejected",
            f"{self.stretches} airborne stretches without a gap over {LARGEST_GAP_S:g} s; of one "
            f"that lasts {self.stretch_s:.0f} s",
            f"taken: {self.duration_s:.0f} s from {self.start_utc}, {self.fixes} fixes, "
            f"{self.angles} with a course",
            f"the altitude ({self.altitude}) is taken as height above the ellipsoid",
            *[f"{self.unsorted} rows were out of order, and are sorted by time"][: self.unsorted],
        ]


def clean_track(
    raw: RawTrack,
    *,
    from_s: float | None = None,
    duration_s: float | None = None,
    interpolated: str = "drop",
) -> tuple[Track, CleaningReport]:
    """Clean a recorded track and cut out a stretch that was flown without a gap: from so many
    seconds after the first row of the file, by default the start of the longest stretch, for ten
    minutes, or what the stretch offers."""
    check_word("interpolated", interpolated, ("drop", "keep"))
    counts: dict[str, int] = {"rows": raw.time.size, "unsorted": raw.unsorted}
    fixes = _distinct_fixes(raw, counts, interpolated == "drop")
    fixes = _without_outliers(fixes, counts)
    angle, speed = _trusted_velocities(raw.name, fixes, counts)
    found = _airborne_stretches(raw.name, fixes, speed, counts)
    elapsed = fixes.time - raw.time[0]
    first, last = _chosen_stretch(elapsed, found, from_s)
    cut = _cut(elapsed, (first, last), from_s, duration_s)
    fixes, angle, speed = fixes[cut], angle[cut], speed[cut]
    if raw.unit_by_name:
        climb, reported = fixes.vertical_rate, fixes.groundspeed
        mistake = find_mistaken_altitude(fixes.time, fixes.altitude, climb, speed, reported)
        _refuse(raw.name, mistake)
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
        altitude=raw.read_as,
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
    time: Floats
    latitude: Floats
    longitude: Floats
    altitude: Floats
    groundspeed: Floats
    track_deg: Floats
    vertical_rate: Floats

    def __getitem__(self, used: Mask) -> _Fixes:
        return _Fixes(*(getattr(self, field)[used] for field in self.__dataclass_fields__))

    @property
    def position_e(self) -> Floats:
        return geodetic_to_ecef(self.latitude, self.longitude, 0.0)


def _distinct_fixes(raw: RawTrack, counts: dict[str, int], drop_interpolated: bool) -> _Fixes:
    known = np.isfinite(raw.position_time)
    fixes = _Fixes(
        np.where(known, raw.position_time, raw.time),
        raw.latitude,
        raw.longitude,
        raw.altitude,
        raw.groundspeed,
        raw.track_deg,
        raw.vertical_rate,
    )
    complete = np.isfinite(raw.latitude + raw.longitude + raw.altitude)
    require(
        complete.sum() >= MINIMUM_FIXES,
        f"{raw.name!r} must have at least {MINIMUM_FIXES} rows with a position and an "
        f"altitude, got {complete.sum()}",
    )
    fixes, known = fixes[complete], known[complete]
    again = repeated_positions(fixes.latitude, fixes.longitude, known)
    fixes = fixes[~again]
    late = late_positions(fixes.time)
    fixes = fixes[~late]
    between = interpolated_positions(fixes.time, fixes.latitude, fixes.longitude)
    between &= drop_interpolated
    counts.update(
        incomplete=int((~complete).sum()),
        repeated=int(again.sum()),
        late=int(late.sum()),
        interpolated=int(between.sum()),
    )
    return fixes[~between]


def _without_outliers(fixes: _Fixes, counts: dict[str, int]) -> _Fixes:
    off = isolated_outliers(fixes.time, fixes.altitude[:, None], HEIGHT_ERROR, 10.0)
    counts["height_outliers"] = int(off.sum())
    fixes = fixes[~off]
    off = isolated_outliers(fixes.time, fixes.position_e, 5.0 * POSITION_SD, 10.0)
    counts["position_outliers"] = int(off.sum())
    return fixes[~off]


def _refuse(name: str, mistake: str | None) -> None:
    if mistake is not None:
        raise ValueError(f"{name!r} contradicts itself: {mistake}")


def _trusted_velocities(name: str, fixes: _Fixes, counts: dict[str, int]) -> tuple[Floats, Floats]:
    """Courses to be trusted, and speeds: reported ones where trusted, else made good. Groundspeeds
    that are not to be trusted become NaN in the fixes."""
    made = compute_ground_track(fixes.time, fixes.latitude, fixes.longitude)
    seen = compute_ground_track(fixes.time, fixes.latitude, fixes.longitude, LONG_CHORD_S)
    swapped = None
    if (np.abs(fixes.longitude) < 0.5 * np.pi).all():
        swapped = compute_ground_track(fixes.time, fixes.longitude, fixes.latitude, LONG_CHORD_S)
    reported = fixes.groundspeed.copy()
    wrong = contradicting_speeds(fixes.groundspeed, made)
    wrong |= stale_runs(fixes.groundspeed, wrong) | stale_speeds(fixes.time, reported, seen)
    fixes.groundspeed[wrong] = np.nan
    angle, unwrapped = resolved_courses(fixes.track_deg, made.course)
    _refuse(name, find_mistaken_course(fixes.time, fixes.track_deg, angle, seen, swapped))
    _refuse(name, find_mistaken_speed(fixes.time, reported, seen, swapped))
    rejected = np.isfinite(fixes.track_deg) & np.isnan(angle)
    rejected |= stale_runs(fixes.track_deg, rejected)
    angle[rejected] = np.nan
    counts.update(
        speeds_rejected=int(wrong.sum()),
        angles_as_given=int((np.isfinite(angle) & ~unwrapped).sum()),
        angles_unwrapped=int((np.isfinite(angle) & unwrapped).sum()),
        angles_rejected=int(rejected.sum()),
    )
    return angle, np.where(np.isnan(fixes.groundspeed), made.speed, fixes.groundspeed)


def _airborne_stretches(
    name: str, fixes: _Fixes, speed: Floats, counts: dict[str, int]
) -> list[tuple[int, int]]:
    """Stretches in the air and without a gap, longest first; at least one."""
    airborne = (speed > AIRBORNE_SPEED) & (fixes.altitude > 0.0)
    found = stretches(
        fixes.time, broken_links(fixes.time, fixes.position_e, fixes.altitude), airborne
    )
    found = [(first, last) for first, last in found if last - first + 1 >= MINIMUM_FIXES]
    counts.update(grounded=int((~airborne).sum()), stretches=len(found))
    if not found:
        raise ValueError(
            f"{name!r} must have an airborne stretch of at least {MINIMUM_FIXES} fixes without a "
            f"gap over {LARGEST_GAP_S:g} s, got none: {_explain_none(fixes, speed, counts)}"
        )
    return found


def _explain_none(fixes: _Fixes, speed: Floats, counts: dict[str, int]) -> str:
    """Why no stretch is left: each reason that concerns half of the fixes, or else the first."""
    count, dropped = fixes.time.size, counts["interpolated"]
    slow, low = ~(speed > AIRBORNE_SPEED), fixes.altitude <= 0.0
    if dropped > count and slow.mean() < 0.5:
        return (
            f"{dropped} of {count + dropped} positions are interpolated between their neighbours; "
            "a simulated track without noise needs interpolated='keep' (--interpolated keep)"
        )
    if counts["late"] > count:
        return f"{counts['late']} rows have no later time than one before them, and another place"
    interval = np.diff(fixes.time)
    far = interval > LARGEST_GAP_S
    moved = np.linalg.norm(np.diff(fixes.position_e, axis=0), axis=1)
    jumps = moved > 5.0 * POSITION_SD + HIGHEST_SPEED * interval
    pace = np.median(moved / interval) if count > 1 else 0.0
    reasons = [
        (slow, f"{slow.sum()} of {count} fixes are at {AIRBORNE_SPEED / KNOT:g} kt or slower"),
        (low, f"{low.sum()} of {count} fixes are at an altitude of 0 or below"),
        (far, f"fixes are {np.median(interval) if count > 1 else 0.0:.0f} s apart in the median"),
        (
            jumps,
            f"fixes are {pace:.0f} m/s from each other in the median (are times in seconds, and "
            "all rows of one aircraft?)",
        ),
    ]
    found = [words for mask, words in reasons if mask.size and mask.mean() >= 0.5]
    others = f"{slow.sum()} slow and {low.sum()} low fixes, {far.sum()} gaps"
    return "; ".join(found) or f"{others}, and jumps of place or altitude between them"


def _chosen_stretch(
    elapsed: Floats, found: list[tuple[int, int]], from_s: float | None
) -> tuple[int, int]:
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
    start = elapsed[stretch[0]] if from_s is None else from_s
    rest = float(elapsed[stretch[1]] - start)
    if duration_s is not None and not 0.0 < duration_s <= rest + 1e-6:
        raise ValueError(f"`duration_s` must be at most {rest:.0f} s here, got {duration_s:g} s")
    end = start + min(DEFAULT_DURATION_S if duration_s is None else duration_s, rest)
    inside = (elapsed >= start) & (elapsed <= end + 1e-6)
    inside[: stretch[0]] = inside[stretch[1] + 1 :] = False
    return inside
