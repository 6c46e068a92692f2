"""Screening of broadcast ephemerides: copies, and records that their neighbours contradict.

A navigation file holds what receivers around the world have heard, now and then wrongly.  A record
has no check of its own, but its neighbours in time describe the same orbit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .broadcast import ORBIT_FIELDS, VALIDITY, Ephemerides, propagate

DISAGREEMENT_TOLERANCE = 100.0
"""Distance between two records' positions from which one of them is wrong [m]."""
DUPLICATE_RTOL = 1e-10
"""Relative difference that rounding to 12 decimals may leave between copies of a record."""


class Rejection(NamedTuple):
    """A record that its neighbours contradict. `time_of_ephemeris`: its reference time, GPS seconds
    [s]; `disagreement`: distance to the position by the neighbour that it contradicts least [m]."""

    satellite_id: str
    time_of_ephemeris: float
    disagreement: float


@dataclass(frozen=True)
class ScreeningReport:
    """What `screen` found.

    - `unhealthy`: records that are marked unhealthy, copies not counted; they are kept;
    - `rejections`: records rejected, by satellite and time;
    - `unchecked`: records kept without a neighbour near enough to compare with;
    - `unresolved`: pairs of neighbours that were kept although they disagree: it is not known which
      is wrong.
    """

    records: int
    duplicates: int
    unhealthy: int
    rejections: tuple[Rejection, ...]
    unchecked: int
    unresolved: int

    @property
    def rejected(self) -> int:
        """Number of records rejected."""
        return len(self.rejections)


def screen(ephemerides: Ephemerides) -> tuple[Ephemerides, ScreeningReport]:
    """Broadcast records without copies and without those that their neighbours contradict.

    Neighbours are the previous and next records of a satellite by time of ephemeris, healthy or
    not (a bad record may be the only healthy one), at most 4 h apart so that neither is carried
    further than its validity; they are compared at the time half way between them.

    1. A record more than 100 m away from both neighbours is rejected, the worst one first.  Its
       neighbours become each other's, and all are compared again.
    2. A record with one neighbour, at the end of a day or next to a gap, is rejected when it is
       more than 100 m away from it while the neighbour agrees with its own next one.
    3. Everything else stays: a record without neighbours (`unchecked`), and a pair that disagrees
       with no third record to decide (`unresolved`).  Records that are wrong in the same way
       confirm each other, so that a run of them is kept, its borders counted as unresolved.
    """
    distinct = _without_copies(ephemerides)
    kept = np.ones(len(distinct), dtype=np.bool_)
    rejections: list[Rejection] = []
    unchecked = unresolved = 0
    for satellite in distinct.satellite_ids:
        records = np.flatnonzero(distinct.satellite_id == satellite)
        rejected, gaps = _contradicted(distinct, records)
        kept[list(rejected)] = False
        rejections += [
            Rejection(satellite, float(distinct.time_of_ephemeris[record]), distance)
            for record, distance in sorted(rejected.items())
        ]
        compared = np.isfinite(np.concatenate([[np.nan], gaps, [np.nan]]))
        unchecked += int((~compared[1:] & ~compared[:-1]).sum())
        unresolved += int((gaps > DISAGREEMENT_TOLERANCE).sum())
    report = ScreeningReport(
        records=len(ephemerides),
        duplicates=len(ephemerides) - len(distinct),
        unhealthy=int((~distinct.healthy).sum()),
        rejections=tuple(rejections),
        unchecked=unchecked,
        unresolved=unresolved,
    )
    return distinct.take(kept), report


def _without_copies(ephemerides: Ephemerides) -> Ephemerides:
    """The records by satellite, time and issue; of copies the unhealthiest."""
    e = ephemerides
    e = e.take(np.lexsort((-e.health, e.issue, e.time_of_ephemeris, e.satellite_id)))
    same = e.satellite_id[1:] == e.satellite_id[:-1]
    for name in ORBIT_FIELDS:
        values = getattr(e, name)
        rtol = 0.0 if name == "time_of_ephemeris" else DUPLICATE_RTOL
        same &= np.isclose(values[1:], values[:-1], rtol=rtol, atol=0.0)
    return e.take(np.append(True, ~same))


def _disagreements(ephemerides: Ephemerides, records: NDArray[np.intp]) -> NDArray[np.float64]:
    """(S - 1,) distances between S successive records half way between them [m], or NaN."""
    before, after = records[:-1], records[1:]
    toe = ephemerides.time_of_ephemeris
    half = 0.5 * (toe[after] - toe[before])
    half = np.where(half <= VALIDITY, half, np.nan)
    difference = (
        propagate(ephemerides, before, half).position_e
        - propagate(ephemerides, after, -half).position_e
    )
    return np.asarray(np.linalg.norm(difference, axis=-1))


def _contradicted(
    ephemerides: Ephemerides, records: NDArray[np.intp]
) -> tuple[dict[int, float], NDArray[np.float64]]:
    """Rejected records of one satellite, ordered by time, and the distances that remain."""
    tolerance = DISAGREEMENT_TOLERANCE
    rejected: dict[int, float] = {}
    while True:
        gaps = _disagreements(ephemerides, records)
        padded = np.concatenate([[np.nan, np.nan], gaps, [np.nan, np.nan]])
        before, after = padded[1:-2], padded[2:-1]
        wrong = np.minimum(before, after) > tolerance
        if not wrong.any():
            first = np.isnan(before) & (after > tolerance) & (padded[3:] <= tolerance)
            last = np.isnan(after) & (before > tolerance) & (padded[:-3] <= tolerance)
            wrong = first | last
        if not wrong.any():
            return rejected, gaps
        distance = np.fmin(before, after)
        worst = int(np.argmax(np.where(wrong, distance, 0.0)))
        rejected[int(records[worst])] = float(distance[worst])
        records = np.delete(records, worst)
