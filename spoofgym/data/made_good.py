"""Speeds and courses that positions alone tell, and columns that contradict them as a whole.

A single wrong value is dirt, which cleaning drops, and so is one that stands for many.  Values that
are all wrong are a mistake about the file, and refused, with the mistake's name where it is known.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..earth.wgs84 import dcm_e_from_n, geodetic_to_ecef
from .track_fit import POSITION_SD
from .tracks import FACTORS, FOOT, LEVEL

Floats = NDArray[np.float64]
LARGEST_GAP_S = 30.0  # longest time between distinct fixes of a stretch [s]
CHORD_S = 4.0  # time to either side over which course and speed made good are taken, at least [s]
LONG_CHORD_S = 20.0  # the same where all fixes are looked at [s]: errors of fixes weigh less
COURSE_TOLERANCE = math.radians(20.0)  # between a reported course and the course made good [rad]
FEWEST = 12  # fixes that a mistake is found from
DISTINCT = 3  # speeds or courses; fewer are a field that went stale
STRAIGHT = 1.05  # legs over chord up to which both tell the speed
SPEED_TOLERANCE = 0.04  # of the ratio that a mistaken unit gives; real tracks stay within 0.02
UNLIKE = 1.3  # ratio of speeds from which on they are not of the same flight
DRIFT = math.radians(2.0)  # lasting difference of course and track from which it is a heading [rad]
BLOCK_S = 60.0  # time over which a difference lasts [s]
MOST = 0.8  # share of the fixes that a mistake must explain
HIGHEST = 25_000.0  # altitude [m]; airliners in feet taken for metres are above it
LOWEST, LOW_SPEED = 600.0 * FOOT, 100.0  # flight level 600 taken for feet, and a speed there [m/s]
SLOW = 30.0  # path along the fixes below which its direction says little [m/s]
FASTEST = 195.0  # equivalent airspeed [m/s], above those of airliners (365 kt), and some wind
MISTAKEN_SPEEDS = {
    f"in {true}, and taken as {taken}": FACTORS[true_key] / FACTORS[taken_key]
    for taken, taken_key in (("kt", "kt"), ("m/s", "mps"))
    for true, true_key in (("m/s", "mps"), ("kt", "kt"), ("mph", "mph"), ("km/h", "kmh"))
    if true != taken
}  # what they are, likelier ones first, and what they must be multiplied by


class GroundTrack(NamedTuple):
    """Speeds and courses that follow from positions alone.

    - `speed`, `path_speed`, `legs_speed` (n,) length of the chord to both sides of a fix, of the
      path along the fixes, and of both chords that meet at the fix, over time [m/s];
    - `course` (n,) direction of the chord, clockwise from north [rad]; NaN below `POSITION_SD`;
    - `span` (n,) time between the ends of the chord [s].
    """

    speed: Floats
    path_speed: Floats
    legs_speed: Floats
    course: Floats
    span: Floats

    @property
    def straight(self) -> NDArray[np.bool_]:
        return np.asarray(self.legs_speed < STRAIGHT * self.speed)


def compute_ground_track(
    time: Floats, latitude: Floats, longitude: Floats, chord_s: float = CHORD_S
) -> GroundTrack:
    """Speeds and courses from positions [rad], over chords of at least `chord_s` to either side;
    NaN where there is no other fix within `LARGEST_GAP_S`."""
    position = geodetic_to_ecef(latitude, longitude, 0.0)
    here = np.arange(time.size)
    a = np.maximum(np.searchsorted(time, time - chord_s, side="right") - 1, 0)
    b = np.minimum(np.searchsorted(time, time + chord_s), time.size - 1)
    a = np.where(time - time[a] > LARGEST_GAP_S, here, a)
    b = np.where(time[b] - time > LARGEST_GAP_S, here, b)
    span = np.where(a < b, time[b] - time[a], np.nan)
    chord_n = np.einsum("nji,nj->ni", dcm_e_from_n(latitude, longitude), position[b] - position[a])
    length = np.hypot(chord_n[:, 0], chord_n[:, 1])
    path = np.cumsum(np.linalg.norm(np.diff(position, axis=0, prepend=position[:1]), axis=1))
    legs = sum(np.linalg.norm(position - position[end], axis=1) for end in (a, b))
    course = np.where(length > POSITION_SD, np.arctan2(chord_n[:, 1], chord_n[:, 0]), np.nan)
    return GroundTrack(length / span, (path[b] - path[a]) / span, legs / span, course, span)


def find_mistaken_speed(
    time: Floats, reported: Floats, made: GroundTrack, swapped: GroundTrack | None
) -> str | None:
    """The unit that most groundspeeds [m/s] are in, where it is not the one that they are taken
    for, in words; that `swapped` latitude and longitude agree with them alone; or that they are
    other speeds."""
    used = np.isfinite(reported) & (reported > 0.0) & made.straight
    if used.sum() < FEWEST:
        return None
    ratio = made.speed[used] / reported[used]
    middle = float(np.median(ratio))
    same = np.abs(ratio / middle - 1.0) < 0.25
    if swapped is not None:
        ratios = (x.speed[used] / reported[used] for x in (made, swapped))
        off, then = (float(np.nanmedian(np.abs(ratio - 1.0))) for ratio in ratios)
        if off > 2.0 * SPEED_TOLERANCE and then < 0.25 * off:
            return "latitude and longitude are swapped: the speeds contradict the positions"
    stale = np.unique(reported[used]).size < DISTINCT  # and any value may be
    for words, factor in [*MISTAKEN_SPEEDS.items()][: 3 if stale else None]:
        if abs(middle / factor - 1.0) < SPEED_TOLERANCE and same.mean() > MOST:
            return f"groundspeeds seem to be {words}: the positions move {middle:.2f} times as fast"
    if not stale and same.mean() > MOST and not 1.0 / UNLIKE < middle < UNLIKE:
        return (
            f"the positions move {middle:.3g} times as fast as the groundspeeds say: are these, or "
            "the times, in another unit?"
        )
    lasting = None if stale else find_lasting(time[used], np.log(ratio), SPEED_TOLERANCE)
    if lasting is not None:
        low, high = np.exp([lasting.min(), lasting.max()])
        return (
            f"groundspeeds seem to be airspeeds: the positions move {low:.2f} to {high:.2f} times "
            "as fast, by the minute (without their column, speeds follow from the positions)"
        )
    return None


def find_mistaken_course(
    time: Floats,
    track_deg: Floats,
    resolved: Floats,
    made: GroundTrack,
    swapped: GroundTrack | None,
) -> str | None:
    """What most courses are in place of the track over ground, in words.

    `track_deg` (n,) as recorded [deg]; `resolved` (n,) where they agree with the positions [rad],
    else NaN; `swapped`: what latitude and longitude tell when exchanged.
    """
    used = np.isfinite(track_deg) & np.isfinite(made.course) & made.straight
    if used.sum() < FEWEST or np.unique(track_deg[used]).size < DISTINCT:
        return None
    now = np.nan_to_num(np.abs(wrap(resolved - made.course))[used], nan=math.pi)
    if (middle := float(np.median(now))) < DRIFT:
        return None
    wrong = now > COURSE_TOLERANCE
    if wrong.mean() > 0.5 and np.unique(track_deg[used][wrong]).size < DISTINCT:
        return None  # such as 0 where none is known
    recorded = np.radians(track_deg)
    causes = [] if swapped is None else [("latitude and longitude are swapped", recorded, swapped)]
    causes += [
        ("courses are in radians", track_deg, made),
        ("courses are where the aircraft comes from", recorded + math.pi, made),
        ("courses are counted from east, to the left", math.pi / 2.0 - recorded, made),
        ("latitudes have lost their sign (south is negative)", math.pi - recorded, made),
        ("longitudes have lost their sign (west is negative)", -recorded, made),
    ]
    for words, course, seen in causes:
        off = np.abs(wrap(course - seen.course))
        known = np.isfinite(off) & seen.straight
        agree = known.sum() >= FEWEST and (off[known] < COURSE_TOLERANCE).mean() > MOST
        if agree and np.median(off[known]) < 0.5 * middle:
            return f"{words}: the courses contradict the positions as they are, and agree then"
    agree, pace = int((~wrong).sum()), float(np.nanmedian(made.path_speed))
    if wrong.mean() > MOST and SLOW < pace < 2.0 * FASTEST:  # else times are wrong
        return f"courses agree with the positions at {agree} of {now.size} fixes: what are they?"
    return _find_drift(time, resolved, made) if middle < math.pi else None


def _find_drift(time: Floats, resolved: Floats, made: GroundTrack) -> str | None:
    straight = np.isfinite(resolved) & np.isfinite(made.course) & made.straight
    lasting = find_lasting(time[straight], wrap(resolved - made.course)[straight], DRIFT)
    if lasting is None:
        return None
    return (
        "courses seem to be headings: the positions drift from them by "
        f"{math.degrees(float(np.median(np.abs(lasting)))):.0f} deg in the median"
    )


def find_lasting(time: Floats, off: Floats, least: float) -> Floats | None:
    """What differences `off` are in the median of every minute, where it is clearly beyond `least`
    in at least half of them. Those within a chord of each other are not independent."""
    length = max(BLOCK_S, 6.0 * float(np.median(np.diff(time)))) if time.size > 1 else BLOCK_S
    block = (time // length).astype(np.int64)
    blocks = [each for k in np.unique(block) if (each := off[block == k]).size >= 5]
    if sum(map(len, blocks)) < FEWEST:
        return None
    lasting = np.array([np.median(each) for each in blocks])
    spread = np.array(
        [np.median(np.abs(x - m)) for x, m in zip(blocks, lasting, strict=True)]
    ) / math.sqrt(min(5.0, length / LONG_CHORD_S))
    return lasting if (np.abs(lasting) > least + 4.0 * spread).mean() >= 0.5 else None


def find_mistaken_altitude(
    time: Floats, altitude: Floats, vertical_rate: Floats, speed: Floats, reported: Floats
) -> str | None:
    """The unit that altitudes [m] are in, where climb rates or speeds [m/s] say that it is not the
    one they are taken for, in words. `reported` (n,) speeds that agree with the positions, which
    tell that times are in seconds; NaN without one."""
    feet = "altitudes seem to be in feet, and taken as metres (--altitude-unit ft)"
    metres = "altitudes seem to be in metres, and taken as feet (--altitude-unit m)"
    levels = "altitudes seem to be flight levels, taken as feet (--altitude-unit fl; ft if right)"
    later = np.minimum(np.searchsorted(time, time + 20.0), time.size - 1)
    span = np.where(later > np.arange(time.size), time[later] - time, np.nan)
    mean = 0.5 * (vertical_rate + vertical_rate[later])
    climbs = (np.abs(mean) > 2.5) & (span < 60.0)
    if climbs.sum() >= FEWEST:
        made = ((altitude[later] - altitude) / span)[climbs]
        ratios = made / mean[climbs]
        ratio = float(np.median(ratios))
        for words, factor in ((feet, 1.0 / FOOT), (metres, FOOT), (levels, FOOT / LEVEL)):
            if abs(ratio / factor - 1.0) < 0.2:
                return f"{words}: they change {ratio:.2f} times as fast as the climb rate says"
        alike = np.abs(ratios - ratio) < 0.5 * abs(ratio)
        if alike.mean() > MOST and not 0.5 < ratio < 2.0:
            return (
                f"altitudes change {ratio:.3g} times as fast as the climb rate says: is one of "
                "them in another unit (--altitude-unit)?"
            )
    if (high := float(np.median(altitude))) > HIGHEST:
        return f"{feet}: half of them are above {high:.0f} m"
    if high < LOWEST and (quick := float(np.nanmedian(speed))) > LOW_SPEED:
        return f"{levels}: at {high:.0f} m, {quick:.0f} m/s are too fast"
    fast, then = (
        float(np.nanmedian(speed * np.clip(1.0 - 2.25577e-5 * h, 0.75, 1.0) ** (0.5 * 4.2559)))
        for h in (altitude, altitude / FOOT)
    )  # equivalent airspeeds, ICAO, to 11 km
    if fast > FASTEST and (then < FASTEST or np.isfinite(reported).mean() < 0.5):
        cause = metres if then < FASTEST else "times seem not to be in seconds"
        return f"{cause}: at {high:.0f} m, {fast:.0f} m/s of equivalent airspeed are too fast"
    return None


def wrap(angle: Floats) -> Floats:
    """Angles in (-pi, pi]."""
    return np.asarray(np.pi - (np.pi - angle) % (2.0 * np.pi))
