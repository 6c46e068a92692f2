"""Rules by which recorded tracks are cleaned: arrays in, True where a row doesn't count.

Rules and limits follow from what recorded tracks look like: rows at a fixed rate that repeat or
interpolate sparser fixes, fixes with about 100 m of error since their times are late by up to a
second, courses stored in a signed byte, fields that went stale.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..earth.frames import dcm_e_from_n, geodetic_to_ecef
from ..earth.wgs84 import EQUATORIAL_RADIUS

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

POSITION_SD = 100.0
"""Standard deviation of a fix, mostly the lateness of its time [m]."""
LARGEST_GAP_S = 30.0
"""Longest time between distinct fixes of a stretch [s]."""
COURSE_TOLERANCE = math.radians(20.0)
"""Largest difference between a reported course and the course made good [rad]."""
INTERPOLATION_TOLERANCE = 0.5
"""Distance from the line between its neighbours up to which a fix is interpolated [m]."""
STALE_SHARE = 0.1
"""Rejected share of a run of one value above which the whole run counts as stale."""
CHORD_S = 4.0
"""Time to either side over which course and speed made good are taken, at least [s]."""
HIGHEST_SPEED = 350.0
"""Highest speed believed between two fixes [m/s]."""


def repeated_positions(latitude: Floats, longitude: Floats, known: Mask) -> Mask:
    """Rows that repeat the position of the row before: a position counts once.

    A receiver repeats a position forwards until the next one comes.  Before the very first one
    there is nothing to repeat: there, rows without a known time of their position are filled
    backwards, and the last of them counts.

    `latitude`, `longitude` (n,) geodetic [rad]; `known` (n,) whether the file gives the time of the
    position; returns (n,) True where the row doesn't count.
    """
    same = (np.diff(latitude) == 0.0) & (np.diff(longitude) == 0.0)
    again = np.concatenate([[False], same])[: latitude.size]
    first = int(np.argmin(np.append(same, False)))
    if first > 0 and not known[: first + 1].any():
        again[:first] = True
        again[first] = False
    return again


def late_positions(time: Floats) -> Mask:
    """Rows whose position isn't newer than all before; a time counts once. `time` (n,) time of the
    positions [s]; returns (n,) True where the row doesn't count."""
    latest = np.maximum.accumulate(time)
    return np.concatenate([[False], time[1:] <= latest[:-1]])[: time.size]


def interpolated_positions(time: Floats, latitude: Floats, longitude: Floats) -> Mask:
    """Rows on the line between their neighbours, at the time that interpolation gives. Of a run of
    equal displacements, only the fix at each end was ever observed. `time` (n,) time of the
    positions [s], rising; `latitude`, `longitude` (n,) geodetic [rad]; returns (n,) True where a
    position is interpolated."""
    north = EQUATORIAL_RADIUS * off_line(time, latitude[:, None])
    east = EQUATORIAL_RADIUS * np.cos(latitude) * off_line(time, np.unwrap(longitude)[:, None])
    between = np.hypot(north, east) < INTERPOLATION_TOLERANCE
    between[:1] = between[-1:] = False
    return between


def off_line(time: Floats, value: Floats) -> Floats:
    """Distance of each row from the line between its neighbours; 0 at both ends. `time` (n,) rising
    [s]; `value` (n, k) coordinates; returns (n,) in the unit of the coordinates."""
    distance = np.zeros(time.size)
    if time.size > 2:
        weight = ((time[1:-1] - time[:-2]) / (time[2:] - time[:-2]))[:, None]
        line = value[:-2] + weight * (value[2:] - value[:-2])
        distance[1:-1] = np.linalg.norm(value[1:-1] - line, axis=1)
    return distance


def _excess(time: Floats, value: Floats, allowance: float, acceleration: float) -> Floats:
    """Distance from the line between the neighbours over the largest one believed."""
    believed = np.full(time.size, allowance)
    believed[1:-1] += 0.5 * acceleration * np.diff(time)[:-1] * np.diff(time)[1:]
    return np.asarray(off_line(time, value) / believed)


def isolated_outliers(time: Floats, value: Floats, allowance: float, acceleration: float) -> Mask:
    """Single rows that neither neighbour leads to, while the neighbours lead to each other.

    A row is off when it lies further from the line between its neighbours than an allowance for
    errors and half the acceleration times the product of both intervals.  Off rows go one by
    one, worst of their surroundings first, and only if that heals the surroundings: a jump that
    lasts is none, and breaks the track instead.

    `time` (n,) rising [s]; `value` (n, k) coordinates [m]; `allowance`: distance believed [m];
    `acceleration`: acceleration believed [m/s^2]; returns (n,) True where a row is an outlier.
    """
    kept = np.arange(time.size)
    while True:
        excess = _excess(time[kept], value[kept], allowance, acceleration)
        padded = np.pad(excess, 1)
        worst = (excess > 1.0) & (excess >= padded[:-2]) & (excess >= padded[2:])
        healing = []
        for index in np.flatnonzero(worst):
            near = np.concatenate([kept[max(index - 2, 0) : index], kept[index + 1 : index + 3]])
            if (_excess(time[near], value[near], allowance, acceleration) <= 1.0).all():
                healing.append(index)
        if not healing:
            break
        kept = np.delete(kept, healing)
    off = np.ones(time.size, dtype=np.bool_)
    off[kept] = False
    return off


def broken_links(time: Floats, position_e: Floats) -> Mask:
    """Which fixes don't lead on to the next: gaps, and jumps that last. `time` (n,) rising [s];
    `position_e` (n, 3) ECEF [m]; returns (n-1,) True where a stretch ends."""
    interval = np.diff(time)
    distance = np.linalg.norm(np.diff(position_e, axis=0), axis=1)
    broken = interval > LARGEST_GAP_S
    broken |= distance > 5.0 * POSITION_SD + HIGHEST_SPEED * interval
    for index in np.flatnonzero(_excess(time, position_e, 5.0 * POSITION_SD, 10.0) > 1.0):
        faster = distance[index] / interval[index] > distance[index - 1] / interval[index - 1]
        broken[index if faster else index - 1] = True
    return broken


class MadeGood(NamedTuple):
    """Speeds and courses that follow from positions alone.

    - `speed`, `path_speed` (n,) length of the chord to both sides of a fix, and of the path along
      the fixes, over time [m/s];
    - `course` (n,) direction of the chord, clockwise from north [rad]; NaN below `POSITION_SD`;
    - `span` (n,) time between the ends of the chord [s].
    """

    speed: Floats
    path_speed: Floats
    course: Floats
    span: Floats


def made_good(time: Floats, latitude: Floats, longitude: Floats) -> MadeGood:
    """Speeds and courses from positions, over chords of at least `CHORD_S` to either side. `time`
    (n,) rising [s]; `latitude`, `longitude` (n,) geodetic [rad]; returns NaN where there is no
    other fix within `LARGEST_GAP_S`."""
    position = geodetic_to_ecef(latitude, longitude, 0.0)
    here = np.arange(time.size)
    a = np.maximum(np.searchsorted(time, time - CHORD_S, side="right") - 1, 0)
    b = np.minimum(np.searchsorted(time, time + CHORD_S), time.size - 1)
    a = np.where(time - time[a] > LARGEST_GAP_S, here, a)
    b = np.where(time[b] - time > LARGEST_GAP_S, here, b)
    span = np.where(a < b, time[b] - time[a], np.nan)
    C_en = dcm_e_from_n(latitude, longitude)
    chord_n = np.einsum("nji,nj->ni", C_en, position[b] - position[a])
    length = np.hypot(chord_n[:, 0], chord_n[:, 1])
    path = np.cumsum(np.linalg.norm(np.diff(position, axis=0, prepend=position[:1]), axis=1))
    course = np.where(length > POSITION_SD, np.arctan2(chord_n[:, 1], chord_n[:, 0]), np.nan)
    return MadeGood(length / span, (path[b] - path[a]) / span, course, span)


def contradicting_speeds(groundspeed: Floats, made: MadeGood) -> Mask:
    """Groundspeeds outside chord and path speed by a tenth and three standard deviations.
    `groundspeed` (n,) as reported [m/s]; returns (n,) True where the reported speed can't be true,
    a stale one for instance."""
    margin = 3.0 * math.sqrt(2.0) * POSITION_SD / made.span
    too_low = groundspeed < 0.9 * made.speed - margin
    too_high = groundspeed > 1.1 * made.path_speed + margin
    return np.asarray(too_low | too_high)


def stale_runs(value: Floats, wrong: Mask) -> Mask:
    """Runs of one and the same value, too much of which is wrong for the rest to be right. `value`
    (n,) as reported, NaN where missing; `wrong` (n,) whether a value was rejected; returns (n,)
    True in runs of which more than `STALE_SHARE` was rejected."""
    run = np.cumsum(np.diff(value, prepend=value[:1]) != 0.0)
    share = np.bincount(run, wrong) / np.maximum(np.bincount(run), 1)
    stale: Mask = np.isfinite(value) & (share[run] > STALE_SHARE)
    return stale


def resolved_courses(track_deg: Floats, course: Floats) -> tuple[Floats, Mask]:
    """Reported courses where they agree with the course made good.

    When all of them fit a signed byte, from -128 to 127 deg, they may have been stored in one,
    and 256 deg more and less are tried too.

    `track_deg` (n,) as recorded [deg], NaN where missing; `course` (n,) made good [rad], NaN where
    there is none; returns `angle` (n,) course [rad] in (-pi, pi], NaN where rejected or missing;
    `unwrapped` (n,) True where it agrees after adding or taking 256 deg, and not as it is.
    """
    finite = track_deg[np.isfinite(track_deg)]
    is_byte = finite.size > 0 and finite.min() >= -128.0 and finite.max() <= 127.0
    angle = np.full(track_deg.size, np.nan)
    best = np.full(track_deg.size, COURSE_TOLERANCE)
    unwrapped = np.zeros(track_deg.size, dtype=np.bool_)
    for shift in (0.0, 256.0, -256.0) if is_byte else (0.0,):
        candidate = np.radians(track_deg + shift)
        difference = np.abs(_wrapped(candidate - course))
        better = difference <= best if shift == 0.0 else difference < best
        angle = np.where(better, _wrapped(candidate), angle)
        best = np.where(better, difference, best)
        unwrapped = np.where(better, shift != 0.0, unwrapped)
    return angle, unwrapped


def _wrapped(angle: Floats) -> Floats:
    """Angle in (-pi, pi]."""
    return np.asarray(np.pi - (np.pi - angle) % (2.0 * np.pi))


def stretches(time: Floats, broken: Mask, airborne: Mask) -> list[tuple[int, int]]:
    """Airborne stretches without a broken link. `time` (n,) rising [s]; `broken` (n-1,) whether a
    fix doesn't lead on to the next; `airborne` (n,) whether a fix is in the air."""
    linked = np.concatenate([[False], ~broken & airborne[1:] & airborne[:-1], [False]])
    edges = np.flatnonzero(np.diff(linked.astype(np.int8)))
    found = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return sorted(found, key=lambda pair: float(time[pair[0]] - time[pair[1]]))
