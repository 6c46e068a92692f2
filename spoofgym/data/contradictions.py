"""Columns of a track that contradict its positions as a whole: wrong units, headings, swaps.

A single wrong value is dirt, which cleaning drops.  Values that are all wrong in one known way are
a mistake about the file, and refused with the mistake's name.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .tracks import FOOT, KNOT

Floats = NDArray[np.float64]
FEWEST = 12  # fixes from which a verdict is drawn
DISTINCT = 3  # values; fewer are a field that went stale
STRAIGHT = 1.05  # path over chord up to which both tell the speed
SPEED_TOLERANCE = 0.04  # of the ratio that a mistaken unit gives; real tracks stay within 0.02
AGREES = math.radians(20.0)  # courses this near to the one made good agree [rad]
DRIFT = math.radians(
    3.0
)  # a lasting difference of course and track from which it is a heading [rad]
BLOCK_S = 60.0  # over which a difference lasts [s]
MOST = 0.8  # share of the fixes that a mistake must explain
MPH = 0.44704  # mile per hour [m/s]
MISTAKEN_SPEEDS = {
    "in m/s, and taken as kt": 1.0 / KNOT,
    "in mph, and taken as kt": MPH / KNOT,
    "in km/h, and taken as kt": 1.0 / 3.6 / KNOT,
    "in kt, and taken as m/s": KNOT,
    "in mph, and taken as m/s": MPH,
    "in km/h, and taken as m/s": 1.0 / 3.6,
}  # what they are, and what they must be multiplied by
HIGHEST = 25_000.0  # altitude [m]; airliners in feet taken for metres are above it
FASTEST = 195.0  # equivalent airspeed [m/s], above those of airliners (365 kt), and some wind


class Made(NamedTuple):
    """What follows from positions alone, see `cleaning.GroundTrack`."""

    speed: Floats
    path_speed: Floats
    course: Floats


def find_mistaken_speed(reported: Floats, made: Made) -> str | None:
    """The unit that most groundspeeds [m/s] are in, where it is not the one that they are taken
    for, in words."""
    used = np.isfinite(reported) & (reported > 0.0) & (made.path_speed < STRAIGHT * made.speed)
    if used.sum() < FEWEST or np.unique(reported[used]).size < DISTINCT:
        return None
    ratio = made.speed[used] / reported[used]
    middle = float(np.median(ratio))
    same = np.abs(ratio / middle - 1.0) < 0.25
    for words, factor in MISTAKEN_SPEEDS.items():
        if abs(middle / factor - 1.0) < SPEED_TOLERANCE and same.mean() > MOST:
            return f"groundspeeds seem to be {words}: the positions move {middle:.2f} times as fast"
    return None


def find_mistaken_course(
    time: Floats, track_deg: Floats, resolved: Floats, made: Made, swapped: Made | None
) -> str | None:
    """What most courses are in place of the track over ground, in words.

    `track_deg` (n,) as recorded [deg]; `resolved` (n,) where they agree with the positions [rad],
    else NaN; `swapped`: what latitude and longitude tell when exchanged.
    """
    used = np.isfinite(track_deg) & np.isfinite(made.course)
    if used.sum() < FEWEST or np.unique(track_deg[used]).size < DISTINCT:
        return None
    if np.isfinite(resolved[used]).mean() > 0.5:
        return _find_drift(time, resolved, made)
    recorded = np.radians(track_deg)
    causes = [] if swapped is None else [("latitude and longitude are swapped", recorded, swapped)]
    causes += [
        ("courses are in radians", track_deg, made),
        ("courses are where the aircraft comes from", recorded + math.pi, made),
        ("courses are counted from east, to the left", math.pi / 2.0 - recorded, made),
    ]
    for words, course, seen in causes:
        off = np.abs(wrap(course - seen.course))
        known = np.isfinite(off)
        if known.sum() >= FEWEST and (off[known] < AGREES).mean() > MOST:
            return f"{words}: the courses contradict the positions as they are, and agree then"
    return None


def _find_drift(time: Floats, resolved: Floats, made: Made) -> str | None:
    straight = np.isfinite(resolved) & (made.path_speed < STRAIGHT * made.speed)
    off = wrap(resolved - made.course)[straight]
    block = (time[straight] // BLOCK_S).astype(np.int64)
    blocks = [off[block == each] for each in np.unique(block)]
    blocks = [each for each in blocks if each.size >= 5]
    if sum(map(len, blocks)) < FEWEST:
        return None
    lasting = np.array([np.median(each) for each in blocks])
    noise = np.array(
        [np.median(np.abs(x - m)) / math.sqrt(x.size) for x, m in zip(blocks, lasting)]
    )
    clear = np.abs(lasting) > DRIFT + 4.0 * noise
    if clear.mean() < 0.5:
        return None
    return (
        "courses seem to be headings: the positions drift from them by "
        f"{math.degrees(float(np.median(np.abs(lasting)))):.0f} deg in the median"
    )


def find_mistaken_altitude(
    time: Floats, altitude: Floats, vertical_rate: Floats, speed: Floats
) -> str | None:
    """The unit that altitudes [m] are in, where climb rates or speeds [m/s] say that it is not the
    one they are taken for, in words."""
    feet = "altitudes seem to be in feet, and taken as metres (--altitude-unit ft)"
    metres = "altitudes seem to be in metres, and taken as feet (--altitude-unit m)"
    later = np.minimum(np.searchsorted(time, time + 20.0), time.size - 1)
    span = np.where(later > np.arange(time.size), time[later] - time, np.nan)
    mean = 0.5 * (vertical_rate + vertical_rate[later])
    climbs = (np.abs(mean) > 2.5) & (span < 60.0)
    if climbs.sum() >= FEWEST:
        ratio = float(np.median(((altitude[later] - altitude) / span / mean)[climbs]))
        for words, factor in ((feet, 1.0 / FOOT), (metres, FOOT)):
            if abs(ratio / factor - 1.0) < 0.2:
                return f"{words}: they change {ratio:.2f} times as fast as the climb rate says"
    if (high := float(np.median(altitude))) > HIGHEST:
        return f"{feet}: half of them are above {high:.0f} m"
    thinner = np.clip(1.0 - 2.25577e-5 * altitude, 0.75, 1.0) ** (0.5 * 4.2559)  # ICAO, to 11 km
    if (fast := float(np.nanmedian(speed * thinner))) > FASTEST:
        return f"{metres}: at {high:.0f} m, {fast:.0f} m/s of equivalent airspeed are too fast"
    return None


def wrap(angle: Floats) -> Floats:
    """Angles in (-pi, pi]."""
    return np.asarray(np.pi - (np.pi - angle) % (2.0 * np.pi))
