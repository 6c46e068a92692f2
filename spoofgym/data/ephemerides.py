"""Broadcast ephemerides: satellites where they really were on a day of the past.

Orbits follow IS-GPS-200, "NAVSTAR GPS Space Segment/Navigation User Interfaces", table 20-IV;
velocities are their exact derivatives (Thompson et al. 2019, "Computing GPS satellite velocity and
acceleration from the broadcast navigation message", NAVIGATION 66(4)).  Galileo (OS SIS ICD) and
BeiDou (B1I ICD; but for its geostationary satellites) differ by constants alone.  All times are GPS
seconds: seconds since 1980-01-06 00:00 in the GPS time scale, counted through every week.

A navigation file holds what receivers around the world have heard, now and then wrongly: `screen`
drops copies, and records that their neighbours in time, which describe the same orbit, contradict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime, timedelta
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.declared import setting, settings_record
from ..core.registry import require
from ..truth.satellites import SatelliteStates, checked_time, ecef_from_orbit

GPS_EPOCH = datetime(1980, 1, 6)  # start of GPS time
SECONDS_PER_WEEK = 604800.0
GPS_GRAVITATIONAL_CONSTANT = 3.986005e14  # mu of IS-GPS-200 [m^3/s^2], not that of WGS-84
GPS_EARTH_RATE = 7.2921151467e-5  # earth rate of the GPS user, IS-GPS-200 [rad/s]
GRAVITATIONAL_CONSTANT = 3.986004418e14  # mu of Galileo and BeiDou [m^3/s^2]
BEIDOU_EARTH_RATE = 7.292115e-5  # [rad/s]
BEIDOU_LAG = 14.0  # of the time of BeiDou behind that of GPS [s]
VALIDITY = 7200.0  # longest time from that of a record [s]: half the 4 h curve fit interval
ORBIT_FIELDS = (  # the 16 Keplerian parameters of a record
    *("root_semi_major_axis", "eccentricity", "mean_anomaly", "mean_motion_correction", "perigee"),
    *("node", "node_rate", "inclination", "inclination_rate"),
    *("cuc", "cus", "cic", "cis", "crc", "crs", "time_of_ephemeris"),
)
KEPLER_ITERATIONS = 6
DISAGREEMENT_TOLERANCE = 100.0  # distance of two records from which one of them is wrong [m]
DUPLICATE_RTOL = 1e-10  # what rounding to 12 decimals may leave between copies of a record

LEAP_SECOND_DATES = (
    *((year, 7, 1) for year in (1981, 1982, 1983, 1985)),
    *((year, 1, 1) for year in (1988, 1990, 1991)),
    *((year, 7, 1) for year in (1992, 1993, 1994)),
    *((1996, 1, 1), (1997, 7, 1), (1999, 1, 1), (2006, 1, 1), (2009, 1, 1)),
    *((2012, 7, 1), (2015, 7, 1), (2017, 1, 1)),
)  # UTC dates at whose start GPS time gained one second on UTC (IERS Bulletin C, to 2017)


def gps_seconds(moment: datetime) -> float:
    """GPS seconds of a date [s]: without a time zone it is in the GPS time scale, like those of a
    RINEX file; with one, it is civil time, and leap seconds are added."""
    leap_seconds = 0
    if moment.tzinfo is not None:
        moment = moment.astimezone(UTC).replace(tzinfo=None)
        leap_seconds = sum(moment >= datetime(*date) for date in LEAP_SECOND_DATES)
    require(moment >= GPS_EPOCH, f"`moment` must not be before {GPS_EPOCH}, got {moment}")
    return (moment - GPS_EPOCH).total_seconds() + leap_seconds


def _calendar(seconds: float) -> str:
    return f"{GPS_EPOCH + timedelta(seconds=round(seconds)):%Y-%m-%d %H:%M:%S} GPS time"


@dataclass(frozen=True, eq=False)
class Ephemerides:
    """Broadcast records, one entry per record in every array, in any order.

    Angles are in radians and the symbols in brackets are those of IS-GPS-200.

    - `satellite_id` (R,) "G01"; E for Galileo, C for BeiDou;
    - `health` (R,) SV health; 0 is healthy;
    - `issue` (R,) issue of data, ephemeris [IODE];
    - `time_of_clock`, `time_of_ephemeris` (R,) reference times, GPS seconds [s] [toc, toe];
    - `clock_bias`, `clock_drift`, `clock_drift_rate` (R,) satellite clock polynomial about
      `time_of_clock` [s], [s/s], [s/s^2] [af0, af1, af2];
    - `group_delay` (R,) [s] [TGD];
    - `root_semi_major_axis` (R,) [m^0.5] [sqrt A];
    - `eccentricity` (R,) 0 <= e < 1;
    - `mean_anomaly`, `mean_motion_correction` (R,) at `time_of_ephemeris` [rad], [rad/s]
      [M0, delta n];
    - `perigee` (R,) argument of perigee [rad] [omega];
    - `node`, `node_rate` (R,) longitude of the ascending node at the start of the week [rad], its
      rate with respect to inertial space [rad/s] [OMEGA0, OMEGADOT];
    - `inclination`, `inclination_rate` (R,) at `time_of_ephemeris` [rad], [rad/s] [i0, IDOT];
    - `cuc`, `cus`, `cic`, `cis` (R,) second harmonic corrections to the argument of latitude and
      the inclination [rad];
    - `crc`, `crs` (R,) second harmonic corrections to the radius [m].
    """

    satellite_id: NDArray[np.str_]
    health: NDArray[np.float64]
    issue: NDArray[np.float64]
    time_of_clock: NDArray[np.float64]
    time_of_ephemeris: NDArray[np.float64]
    clock_bias: NDArray[np.float64]
    clock_drift: NDArray[np.float64]
    clock_drift_rate: NDArray[np.float64]
    group_delay: NDArray[np.float64]
    root_semi_major_axis: NDArray[np.float64]
    eccentricity: NDArray[np.float64]
    mean_anomaly: NDArray[np.float64]
    mean_motion_correction: NDArray[np.float64]
    perigee: NDArray[np.float64]
    node: NDArray[np.float64]
    node_rate: NDArray[np.float64]
    inclination: NDArray[np.float64]
    inclination_rate: NDArray[np.float64]
    cuc: NDArray[np.float64]
    cus: NDArray[np.float64]
    cic: NDArray[np.float64]
    cis: NDArray[np.float64]
    crc: NDArray[np.float64]
    crs: NDArray[np.float64]

    def __post_init__(self) -> None:
        ids = np.array(self.satellite_id, dtype=np.str_)
        require(
            ids.ndim == 1 and ids.size,
            f"`satellite_id` must have shape (R,), R >= 1, got {ids.shape}",
        )
        ids.setflags(write=False)
        object.__setattr__(self, "satellite_id", ids)
        for field in fields(self)[1:]:
            values = np.array(getattr(self, field.name), dtype=np.float64)
            require(
                values.shape == ids.shape,
                f"`{field.name}` must have shape {ids.shape}, got {values.shape}",
            )
            if not np.isfinite(values).all():
                bad = np.flatnonzero(~np.isfinite(values))[0]
                raise ValueError(
                    f"`{field.name}` must be finite, got {values[bad]} for {ids[bad]}, record {bad}"
                )
            values.setflags(write=False)
            object.__setattr__(self, field.name, values)
        require(
            ((self.eccentricity >= 0.0) & (self.eccentricity < 1.0)).all(),
            "`eccentricity` must be within 0 <= e < 1, "
            f"got {self.eccentricity.min()} to {self.eccentricity.max()}",
        )
        require(
            (self.root_semi_major_axis > 0.0).all(),
            f"`root_semi_major_axis` must be positive, got {self.root_semi_major_axis.min()}",
        )

    def __len__(self) -> int:
        return self.satellite_id.size

    @property
    def satellite_ids(self) -> tuple[str, ...]:
        return tuple(np.unique(self.satellite_id).tolist())

    @property
    def healthy(self) -> NDArray[np.bool_]:
        return np.asarray(self.health == 0.0)

    def take(self, records: ArrayLike) -> Ephemerides:
        """Some of the records, by indices (S,) in their order, or booleans (R,)."""
        index = np.asarray(records)
        return Ephemerides(**{f.name: getattr(self, f.name)[index] for f in fields(self)})


def join_ephemerides(parts: Sequence[Ephemerides]) -> Ephemerides:
    """The records of several files, in their order; `screen` drops the copies among them."""
    names = [field.name for field in fields(Ephemerides)]
    return Ephemerides(**{x: np.concatenate([getattr(e, x) for e in parts]) for x in names})


def solve_kepler(mean_anomaly: ArrayLike, eccentricity: ArrayLike) -> NDArray[np.float64]:
    r"""Eccentric anomaly E from Kepler's equation.

    .. math::
        M = E - e \sin E

    Newton's method from :math:`E = M + e \sin M`, always `KEPLER_ITERATIONS` steps, so that a
    value does not depend on which others are solved along with it.

    `mean_anomaly`: M [rad]; `eccentricity`: e; exact to rounding up to e = 0.5, GPS orbits stay
    below 0.03; returns E [rad], within a revolution of zero.
    """
    e = np.asarray(eccentricity, dtype=np.float64)
    M = np.remainder(np.asarray(mean_anomaly, dtype=np.float64) + np.pi, 2.0 * np.pi) - np.pi
    E = M + e * np.sin(M)
    for _ in range(KEPLER_ITERATIONS):
        E = E - (E - e * np.sin(E) - M) / (1.0 - e * np.cos(E))
    return np.asarray(E)


def propagate_orbits(
    ephemerides: Ephemerides, record: ArrayLike, elapsed: ArrayLike
) -> SatelliteStates:
    r"""Position and velocity by single records, whatever their age and health.

    .. math::
        u = \phi + C_{us}\sin 2\phi + C_{uc}\cos 2\phi, \qquad
        r = A (1 - e \cos E) + C_{rs}\sin 2\phi + C_{rc}\cos 2\phi, \qquad
        i = i_0 + \dot\imath\,t_k + C_{is}\sin 2\phi + C_{ic}\cos 2\phi, \qquad
        \Omega = \Omega_0 + (\dot\Omega - \dot\Omega_e)\,t_k - \dot\Omega_e t_{oe}

    `elapsed`: time since its `time_of_ephemeris`, t_k [s]; NaN gives NaN; returns (S, 3) each.
    IS-GPS-200, table 20-IV; Thompson et al. (2019) for the derivatives.
    """
    index = np.asarray(record, dtype=np.intp)
    (A, e, M0, dn, omega, O0, O_dot, i0, i_dot, cuc, cus, cic, cis, crc, crs, toe) = (
        getattr(ephemerides, name)[index] for name in ORBIT_FIELDS
    )
    system = ephemerides.satellite_id.astype("<U1")[index]
    mu = np.where(system == "G", GPS_GRAVITATIONAL_CONSTANT, GRAVITATIONAL_CONSTANT)
    turn = np.where(system == "C", BEIDOU_EARTH_RATE, GPS_EARTH_RATE)
    of_week = (toe - np.where(system == "C", BEIDOU_LAG, 0.0)) % SECONDS_PER_WEEK
    A, t = A * A, np.asarray(elapsed, dtype=np.float64)
    n = np.sqrt(mu / (A * A * A)) + dn
    E = solve_kepler(M0 + n * t, e)
    rho = 1.0 - e * np.cos(E)
    root = np.sqrt(1.0 - e * e)
    phi = np.arctan2(root * np.sin(E), np.cos(E) - e) + omega
    phi_rate = root * n / (rho * rho)
    s2, c2 = np.sin(2.0 * phi), np.cos(2.0 * phi)
    return ecef_from_orbit(
        radius=A * rho + crs * s2 + crc * c2,
        radius_rate=A * e * np.sin(E) * n / rho + 2.0 * phi_rate * (crs * c2 - crc * s2),
        latitude_argument=phi + cus * s2 + cuc * c2,
        latitude_argument_rate=phi_rate * (1.0 + 2.0 * (cus * c2 - cuc * s2)),
        node=O0 + (O_dot - turn) * t - turn * of_week,
        node_rate=O_dot - turn,
        inclination=i0 + i_dot * t + cis * s2 + cic * c2,
        inclination_rate=i_dot + 2.0 * phi_rate * (cis * c2 - cic * s2),
    )


class _Schedule(NamedTuple):
    """For each of n satellites its m records by age; short rows are padded."""

    record: NDArray[np.intp]  # (n, m)
    epoch: NDArray[np.float64]  # (n, m) time of ephemeris, time of the simulation; unhealthy NaN
    switch: NDArray[np.float64]  # (n, m - 1) when the next record takes over, or infinity


@settings_record(frozen=True, eq=False)
class BroadcastConstellation:
    """GPS satellites by their broadcast ephemerides.

    At each time a satellite follows the record whose time of ephemeris is nearest, and is NaN
    when that one is unhealthy or more than 2 h away.  Where a record takes over from the one
    before, the orbit jumps by the broadcast errors, some metres when the records were screened.
    """

    ephemerides: Ephemerides = setting(
        help="Broadcast records, best screened by `spoofgym.data.ephemerides.screen`; unhealthy "
        "ones are never used."
    )
    start: float = setting(
        unit="s", help="GPS seconds at time 0 of the simulation, see `gps_seconds`."
    )

    def __post_init__(self) -> None:
        toe = self.ephemerides.time_of_ephemeris[self.ephemerides.healthy]
        require(toe.size, f"none of the {len(self.ephemerides)} records is healthy")
        if np.abs(toe - self.start).min() > VALIDITY:
            raise ValueError(
                f"`start` must be within {VALIDITY / 3600.0:g} h of a healthy record; they are of "
                f"{_calendar(toe.min())} to {_calendar(toe.max())}, got {self.start!r}, which is "
                f"{_calendar(self.start)}: give a file of that time"
            )

    @cached_property
    def satellite_ids(self) -> tuple[str, ...]:
        return self.ephemerides.satellite_ids

    @cached_property
    def _schedule(self) -> _Schedule:
        e = self.ephemerides
        rows = []
        for satellite in self.satellite_ids:
            row = np.flatnonzero(e.satellite_id == satellite)
            row = row[np.lexsort((e.health[row], e.time_of_ephemeris[row]))]
            # of records for the same time the unhealthiest, then the last upload, is obeyed
            rows.append(row[np.append(np.diff(e.time_of_ephemeris[row]) > 0.0, True)])
        shape = len(rows), max(row.size for row in rows)
        record = np.zeros(shape, dtype=np.intp)
        epoch = np.full(shape, np.inf)
        for k, row in enumerate(rows):
            record[k, : row.size] = row
            epoch[k, : row.size] = e.time_of_ephemeris[row] - self.start
        switch = 0.5 * (epoch[:, 1:] + epoch[:, :-1])
        return _Schedule(record, np.where(e.healthy[record], epoch, np.nan), switch)

    def states(self, time: ArrayLike) -> SatelliteStates:
        """Positions and velocities; NaN while the nearest record is unhealthy or 2 h away."""
        t = checked_time(time)
        schedule = self._schedule
        column = (t[:, None, None] >= schedule.switch).sum(axis=-1)
        satellite = np.arange(len(self.satellite_ids))
        elapsed = t[:, None] - schedule.epoch[satellite, column]
        elapsed[np.abs(elapsed) > VALIDITY] = np.nan
        return propagate_orbits(self.ephemerides, schedule.record[satellite, column], elapsed)

    def explain_loss(self, time: float) -> str:
        """Why satellites are missing at a time of the simulation [s], and what may help."""
        e, now = self.ephemerides, self.start + time
        near, ahead = np.abs(e.time_of_ephemeris - now) <= VALIDITY, e.time_of_ephemeris > now
        valid, later = (set(e.satellite_id[x & e.healthy]) for x in (near, ahead))
        lost = set(e.satellite_id[e.healthy]) - valid
        last = float(e.time_of_ephemeris[e.healthy].max())
        if not lost:
            return (
                f"; all {len(valid)} satellites of the files have a valid record then: lower the "
                "mask, or give files of more stations (--ephemeris may be repeated)"
            )
        return (
            f"; {len(lost)} of {len(lost | valid)} satellites have no valid record at "
            f"{_calendar(now)}, {len(lost & later)} of them have one later; the last record is of "
            f"{_calendar(last)}: give the files before and after this time too, such as that of "
            "the next day, or files of more stations (--ephemeris may be repeated)"
        )


class Rejection(NamedTuple):
    """A record that its neighbours contradict, its GPS seconds, and the distance to the position by
    the neighbour that it contradicts least [m]."""

    satellite_id: str
    time_of_ephemeris: float
    disagreement: float


@dataclass(frozen=True)
class ScreeningReport:
    """What `screen` found.

    - `unhealthy`: records that are marked unhealthy, copies not counted; they remain;
    - `rejections`: records rejected, by satellite and time;
    - `unchecked`: remaining records without a neighbour near enough to compare with;
    - `unresolved`: pairs of neighbours that remain although they disagree: it is not known which
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
       confirm each other, so that a run of them remains, its borders counted as unresolved.
    """
    distinct = _without_copies(ephemerides)
    accepted = np.ones(len(distinct), dtype=np.bool_)
    rejections: list[Rejection] = []
    unchecked = unresolved = 0
    for satellite in distinct.satellite_ids:
        rejected, gaps = _reject_contradictions(
            distinct, np.flatnonzero(distinct.satellite_id == satellite)
        )
        accepted[list(rejected)] = False
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
    return distinct.take(accepted), report


def _without_copies(ephemerides: Ephemerides) -> Ephemerides:
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
        propagate_orbits(ephemerides, before, half).position_e
        - propagate_orbits(ephemerides, after, -half).position_e
    )
    return np.asarray(np.linalg.norm(difference, axis=-1))


def _reject_contradictions(
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
