"""From raw measurements to innovations: a receiver's observations, orbits and inertial samples.

Pseudoranges and range rates lose what is not the receiver's: satellite clocks with relativity and
group delay (IS-GPS-200, 20.3.3.3.3), the troposphere, constant offsets between the clocks of the
systems, and the receiver's own steps of whole milliseconds.  What is left is replayed in pieces, a
new one wherever time jumps or samples are missing; each begins with a least-squares fix, levelled,
and with the heading of its velocity.  The ionosphere stays in where the navigation files have no
coefficients of GPS's model of it.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.registry import require
from ..data.ephemerides import GPS_EPOCH, VALIDITY, Ephemerides, join_ephemerides, propagate_orbits
from ..data.inertial import InertialSamples, read_inertial
from ..data.observations import SIGNALS, Observations, is_table, read_observations
from ..data.rinex import GEOSTATIONARY, read_ionosphere, read_navigation
from ..earth.wgs84 import (
    EARTH_RATE,
    SPEED_OF_LIGHT,
    dcm_e_from_n,
    ecef_to_geodetic,
    gravity,
    look_angles,
)
from .epoch import FILTER
from .log import MOST_ELEMENTS, InnovationLog
from .plausibility import CLOCK_STEP, LEAP_SECONDS, ImplausibleWarning, expect_ranges
from .recording import LONGEST_SAMPLE_S, Recording
from .replay import Solution, replay
from .start import MOVING_MPS, find_start, fix_epochs
from .tight import NoiseModel, TightlyCoupled

Floats = NDArray[np.float64]
ODD_M, ODD_RATIO = 500.0, 5.0
"""Residuals of fixes that are no noise, and how much they shrink without an odd satellite."""
ODD_SD_M = 1e6  # of ranges that stay in a log, not in its filter
TURN_S, TURN_RAD = 2.0, 0.1  # of what turns are compared over, and how large they must be
ALIKE = 0.8  # correlation of turns at another time that says that this is the right one
FEWEST = 20  # epochs of a piece
LONGEST_GAP_S = 10.0  # between epochs of a piece
MASK_DEG = 10.0
AT_REST_MPS = 0.5  # median speed of fixes
L1_HZ = 1575.42e6
OSCILLATOR = 3e-6  # drift of a receiver's clock beyond which it is unusual [s/s]
STATIC_STEP_S = 0.25
Solutions = list[tuple[float, Solution]]
"""GPS seconds at time zero of each piece, and what its replay estimated."""


def read_raw_log(
    files: Sequence[str | os.PathLike[str]],
    mapping: str | os.PathLike[str] | None = None,
    *,
    static: bool = False,
    **settings: Any,
) -> InnovationLog:
    """Innovations from files: observations, navigation files, and a table of inertial samples,
    whose columns `mapping` describes; without these the receiver must be `static`. `settings` are
    those of `solve_raw`."""
    first, *others = map(Path, files)
    tables = [path for path in others if is_table(path)]
    orbits = [path for path in others if path not in tables]
    require(orbits, "orbits are missing: give a RINEX navigation file after the observations")
    require(
        (len(tables), mapping is not None, static) in ((1, True, False), (0, False, True)),
        "give one table of inertial samples and a TOML file that says what its columns are "
        "(--mapping), or say that the receiver was at rest (--static)",
    )
    observations = read_observations(first)
    samples = None
    if mapping is not None:
        samples = read_inertial(tables[0], mapping, float(observations.time[0]))
    ephemerides = join_ephemerides([read_navigation(path, "".join(SIGNALS)) for path in orbits])
    model = next(filter(None, map(read_ionosphere, orbits)), None)
    return solve_raw(observations, ephemerides, samples, ionosphere=model, **settings)[0]


def solve_raw(
    observations: Observations,
    ephemerides: Ephemerides,
    samples: InertialSamples | None,
    *,
    grade: str = "consumer",
    noise_factors: tuple[float, float] = (1.0, 1.0),
    keep_odd: bool = False,
    ionosphere: Sequence[float] | None = None,
) -> tuple[InnovationLog, Solutions]:
    """Replay raw measurements, with inertial samples or, where they are None, at rest.

    `grade`: of the inertial sensors, see `TightlyCoupled`; `noise_factors` on the standard
    deviations of pseudoranges and range rates, which are those of the receiver itself, or those of
    `NoiseModel` where it says nothing; `keep_odd`: satellites that disagree by over `ODD_M` stay in
    the log with a noise of `ODD_SD_M` and as many m/s, for tests of ranges alone;
    `ionosphere`: coefficients of `compute_klobuchar`, without which it is not corrected. Times of
    the log are those since the first epoch [s]; its `about` has ``lines``: what was found,
    corrected and left out.
    """
    require(min(noise_factors) > 0.0, f"`noise_factors` must be positive, got {noise_factors}")
    measured = _Measured(observations, ephemerides, keep_odd, ionosphere)
    still = samples is None
    size = len(measured.time) * (2 * len(measured.satellites)) ** 2
    require(size <= MOST_ELEMENTS, f"covariances would have {size:,} elements: cut it into parts")
    if samples is None:
        samples, grade = _rest(measured), "aviation"
    receiver, lines = TightlyCoupled(grade=grade), measured.lines
    lines += _compare_rest(measured) if still else _compare_turns(measured, samples)
    logs, solutions = list[InnovationLog](), Solutions()
    for number, rows in enumerate(_cut_pieces(measured, samples), 1):
        try:
            place = measured.time[rows], measured.fixes[rows], samples.time
            row, initial = find_start(*place, samples.specific_force_b, FEWEST, still=still)
            start, rows = float(measured.time[rows[row]]), rows[row + 1 :]
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ImplausibleWarning)  # it is the remark
                recording = _make_recording(measured, samples, start, rows)
                solution = replay(
                    recording,
                    receiver,
                    initial=initial,
                    noise_variance=_list_variances(measured.sd[rows], noise_factors),
                    fields=FILTER,
                )
            require("not finite" not in solution.flag, solution.remark)
        except ValueError as error:
            lines.append(f"piece {number}, {len(rows)} epochs, is left out: {error}")
            continue
        after = start - float(measured.time[0])
        lines.append(f"piece {number} starts at {after:.2f} s: {len(rows)} epochs")
        lines += filter(None, [solution.remark])
        solutions.append((start, solution))
        log = InnovationLog.from_replay(solution, recording)
        logs.append(replace(log, time=log.time + after, segment=log.segment + number))
    require(logs, "; ".join(["nothing can be replayed", *reversed(lines)]))
    fields = ("time", "segment", "innovation", "innovation_cov")
    joined: dict[str, Any] = {x: np.concatenate([getattr(log, x) for log in logs]) for x in fields}
    joined["more"] = {x: np.concatenate([log.more[x] for log in logs]) for x in logs[0].more}
    joined["about"] = {"from": "raw measurements", "lines": lines}
    return replace(logs[0], **joined, channels=measured.satellites), solutions


class _Measured:
    """Observations without what is not the receiver's, satellites, and a fix of every epoch.

    - `time` (K,) GPS seconds; `pseudorange`, `range_rate` (K, n); `position`, `velocity` (K, n, 3)
      of the `satellites` (n,); `sd` (K, 2n);
    - `fixes` (K, 8) ECEF position and velocity, clock and its drift [m], [m/s]; NaN without;
    - `lines` about what was done.
    """

    def __init__(
        self,
        o: Observations,
        ephemerides: Ephemerides,
        keep_odd: bool = False,
        ionosphere: Sequence[float] | None = None,
    ) -> None:
        begin = GPS_EPOCH + timedelta(seconds=round(o.time[0]))
        runs = int(o.segment[-1] - o.segment[0]) + 1
        self.lines = [
            f"{len(o.time)} epochs from {begin} GPS time on, which runs back {runs - 1} times; "
            f"{len(o.satellites)} satellites: {' '.join(o.satellites)}",
            *(f"left out: {count} {what}" for what, count in o.left_out.items() if count),
        ]
        n = len(o.satellites)
        placed = np.stack([_place_satellite(o, j, ephemerides) for j in range(n)], axis=1)
        found = np.isfinite(placed).any(axis=(0, 2))
        read = np.array([x not in GEOSTATIONARY for x in o.satellites])
        used, unused = np.flatnonzero(found), np.flatnonzero(~found & read)
        if unused.size:
            missing = " ".join(o.satellites[j] for j in unused)
            self.lines.append(f"left out without a healthy record of the orbit: {missing}")
        if still := " ".join(sorted(GEOSTATIONARY.intersection(o.satellites))):
            self.lines.append(f"left out as geostationary, whose orbits are not read: {still}")
        self.time, self.segment = o.time, o.segment
        self.satellites = tuple(o.satellites[j] for j in used)
        placed = placed[:, used]
        self.position, self.velocity = placed[..., :3], placed[..., 3:6]
        self.pseudorange = o.pseudorange[:, used] + SPEED_OF_LIGHT * placed[..., 6]
        self.range_rate = o.range_rate[:, used] + SPEED_OF_LIGHT * placed[..., 7]
        self.sd = o.sd[:, [*used, *(n + used)]]
        self._remove_clock_steps()
        odd = self._remove_odd()
        self._remove_atmosphere(ionosphere, np.array([o.signals[j].frequency for j in used]))
        self._remove_system_offsets()
        self.fixes = self._fix_epochs()
        require(
            np.isfinite(self.fixes).any(), "; ".join(["no epoch has a fix", *reversed(self.lines)])
        )
        drift = float(np.nanmedian(self.fixes[:, 7]))
        unusual = abs(drift) > OSCILLATOR * SPEED_OF_LIGHT
        self.lines += [
            f"fixes of {np.isfinite(self.fixes[:, 0]).sum()} epochs, median residual "
            f"{self._spread(self.fixes):.3g} m; the ionosphere is "
            + ("not corrected" if ionosphere is None else "that of GPS's broadcast model"),
            f"the receiver's clock drifts by {drift:.6g} m/s, {1e6 * drift / SPEED_OF_LIGHT:.3g} "
            f"ppm{': more than that of a receiver, is it a transmitter?' * unusual}",
        ]
        fixed = np.isfinite(self.fixes[:, 0])
        for j, ranges in odd.items() if keep_odd else ():  # the filter has no more epochs by it
            self.pseudorange[fixed, j], self.sd[:, [j, len(used) + j]] = ranges[fixed], ODD_SD_M

    def _remove_clock_steps(self) -> None:
        """Ranges without the steps of whole milliseconds by which a receiver puts its clock right:
        what all of them change by beyond their rates."""
        rate, step = self.range_rate, np.diff(self.time)[:, None]
        change = np.diff(self.pseudorange, axis=0) - 0.5 * (rate[1:] + rate[:-1]) * step
        common = np.zeros(len(change))
        some = np.isfinite(change).any(axis=1) & (np.diff(self.segment) == 0)
        common[some] = np.nanmedian(change[some], axis=1)
        count = np.round(common / CLOCK_STEP)
        self.pseudorange[1:] -= CLOCK_STEP * np.cumsum(count)[:, None]
        if (steps := np.count_nonzero(count)) > 0:
            self.lines.append(f"{steps} steps of the receiver's clock by whole ms are taken out")

    def _fix_epochs(self, without: int = -1) -> Floats:
        use = np.arange(len(self.satellites)) != without
        arrays = self.pseudorange, self.range_rate, self.position, self.velocity
        return fix_epochs(*(x[:, use] for x in arrays))

    def _list_residuals(self, fixes: Floats) -> tuple[Floats, Floats]:
        """(K, n) of the pseudoranges [m], and (K, n, 3) lines of sight."""
        r, s = fixes[:, None, :3], self.position
        left = self.pseudorange - expect_ranges(s, r) - fixes[:, 6, None]
        return left, (s - r) / np.linalg.norm(s - r, axis=-1)[..., None]

    def _spread(self, fixes: Floats, without: int = -1) -> float:
        """Median residual of fixes of more than four satellites [m]."""
        left = np.delete(self._list_residuals(fixes)[0], [without] if without >= 0 else [], axis=1)
        left = left[np.isfinite(left).sum(axis=1) > 4]
        return float(np.nanmedian(np.abs(left))) if left.size else 0.0

    def _remove_odd(self) -> dict[int, Floats]:
        """Drop satellites without which the others agree, and epochs that still do not; returns
        the ranges of these satellites by their number."""
        self.fixes, odd = self._fix_epochs(), dict[int, Floats]()
        while (now := self._spread(self.fixes)) > ODD_M:
            trials = [self._fix_epochs(j) for j in range(len(self.satellites))]
            spreads = [self._spread(fixes, j) or now for j, fixes in enumerate(trials)]
            j = int(np.argmin(spreads))
            if spreads[j] > now / ODD_RATIO:
                break
            self.fixes = trials[j]
            off = self._list_residuals(self.fixes)[0][:, j]
            self.lines.append(
                f"left out: {self.satellites[j]}, whose pseudoranges are off by "
                f"{np.nanmedian(off):.6g} m (median of {np.isfinite(off).sum()} epochs)"
            )
            odd[j] = self.pseudorange[:, j].copy()
            self.pseudorange[:, j] = np.nan
        few = np.isfinite(self.pseudorange).sum(axis=1) < 5
        apart = self._disagree(self.fixes) | ~np.isfinite(self.fixes[:, 0])
        apart |= few & self._disagree(self._carry_fixes(~(few | apart)))
        require(not apart.all(), "; ".join(["no epoch has a fix", *reversed(self.lines)]))
        if apart.any():
            self.pseudorange[apart] = self.fixes[apart] = np.nan
            self.lines.append(
                f"left out: {apart.sum()} epochs without a fix, or with ranges that disagree by "
                f"over {ODD_M:g} m"
            )
        return odd

    def _disagree(self, fixes: Floats) -> NDArray[np.bool_]:
        """(K,) epochs with a range that is off its fix by over `ODD_M`."""
        return np.asarray((np.abs(self._list_residuals(fixes)[0]) > ODD_M).any(axis=1))

    def _carry_fixes(self, good: NDArray[np.bool_]) -> Floats:
        """Fix of the nearest `good` epoch, moved by its rates: four ranges always agree with their
        own. Their own where none is near."""
        rows, near = np.flatnonzero(good), np.arange(len(good))
        if rows.size:
            near = rows[np.searchsorted(0.5 * (rows[1:] + rows[:-1]), near)]
        away = self.time - self.time[near]
        near = np.where(np.abs(away) <= LONGEST_GAP_S, near, np.arange(len(good)))
        moved = self.fixes[near] + 0.0
        rates = moved[:, [3, 4, 5, 7]] * (self.time - self.time[near])[:, None]
        moved[:, [0, 1, 2, 6]] += rates
        return moved

    def _remove_atmosphere(self, ionosphere: Sequence[float] | None, frequency: Floats) -> None:
        """Ranges without the delays of a standard atmosphere and of the broadcast ionosphere, and
        without low satellites."""
        latitude, longitude, height = ecef_to_geodetic(self.fixes[:, :3])
        C_en = dcm_e_from_n(latitude, longitude)
        looks = elevation, _ = look_angles(self.position, self.fixes[:, :3], C_en)
        place = latitude[:, None], longitude[:, None]
        self.pseudorange -= compute_saastamoinen(elevation, place[0], height[:, None])
        if ionosphere is not None:
            delay = compute_klobuchar(ionosphere, self.time[:, None], *place, *looks)
            self.pseudorange -= delay * (L1_HZ / frequency) ** 2
        low = np.isfinite(self.pseudorange) & (elevation < np.radians(MASK_DEG))
        self.pseudorange[low] = np.nan
        if low.any():
            self.lines.append(f"left out: {low.sum()} observations below {MASK_DEG:g} deg")

    def _remove_system_offsets(self) -> None:
        """Ranges without what the clock of each further system is off by, a constant: the least
        squares of all epochs, each with a position and a clock of its own."""
        names = sorted({x[0] for x in self.satellites}, key=[*SIGNALS].index)
        left, sight = self._list_residuals(self._fix_epochs())
        there = np.isfinite(left)[..., None]
        G = np.where(there, np.concatenate([-sight, np.ones((*left.shape, 1))], axis=2), 0.0)
        own = np.array([[x[0] == name for name in names[1:]] for x in self.satellites], dtype=float)
        H = np.where(there, own, 0.0)
        projected = H - G @ (np.linalg.pinv(G) @ H)
        normal = np.einsum("kni,knj->ij", projected, H)
        right = np.einsum("kni,kn->i", projected, np.nan_to_num(left))
        offsets = np.linalg.lstsq(normal, right, rcond=None)[0]
        self.pseudorange -= own @ offsets
        for name, value in zip(names[1:], offsets, strict=True):
            self.lines.append(f"the clock of system {name} is {value:.2f} m off that of {names[0]}")


def _place_satellite(o: Observations, j: int, e: Ephemerides) -> Floats:
    """(K, 8) position, velocity, clock and its drift of a satellite when its signal leaves it;
    NaN where it has no healthy record near enough [m], [m/s], [s], [s/s]."""
    placed = np.full((len(o.time), 8), np.nan)
    records = np.flatnonzero(e.healthy & (e.satellite_id == o.satellites[j]))
    if not records.size:
        return placed
    time = o.time - o.pseudorange[:, j] / SPEED_OF_LIGHT
    ages = np.abs(time[:, None] - e.time_of_ephemeris[records])
    rows = np.flatnonzero(ages.min(axis=1) <= VALIDITY)
    time, record = time[rows], records[ages[rows].argmin(axis=1)]
    drift, rate = e.clock_drift[record], e.clock_drift_rate[record]

    def clock(elapsed: Floats) -> Floats:
        return np.asarray(e.clock_bias[record] + (drift + rate * elapsed) * elapsed)

    left = time - clock(time - e.time_of_clock[record])
    elapsed = left - e.time_of_clock[record]
    position, velocity = propagate_orbits(e, record, left - e.time_of_ephemeris[record])
    relativity = -2.0 * (position * velocity).sum(axis=-1) / SPEED_OF_LIGHT**2
    bias = clock(elapsed) + relativity - o.signals[j].delays * e.group_delay[record]
    placed[rows] = np.column_stack([position, velocity, bias, drift + 2.0 * rate * elapsed])
    return placed


def compute_saastamoinen(elevation: Floats, latitude: Floats, height: Floats) -> Floats:
    r"""Delay by a standard atmosphere of half its humidity [m].

    .. math:: \frac{0.0022768\, p}{\cos z\,(1 - 0.00266 \cos 2\varphi - 0.00028\, h)} +
        \frac{0.002277}{\cos z}\left(\frac{1255}{T} + 0.05\right) e

    `elevation` and `latitude` [rad]; `height` [m], used from sea level to 10 km, `h` in km.
    Saastamoinen (1972), "Atmospheric correction for the troposphere and stratosphere in radio
    ranging satellites"; the atmosphere is that of RTKLIB, manual E.5.
    """
    h = np.clip(height, 0.0, 10_000.0)
    pressure = 1013.25 * (1.0 - 2.2557e-5 * h) ** 5.2568
    kelvin = 288.15 - 6.5e-3 * h
    vapour = 0.5 * 6.108 * np.exp((17.15 * kelvin - 4684.0) / (kelvin - 38.45))
    dry = 0.0022768 * pressure / (1.0 - 0.00266 * np.cos(2.0 * latitude) - 2.8e-7 * h)
    wet = 0.002277 * (1255.0 / kelvin + 0.05) * vapour
    return np.asarray((dry + wet) / np.sin(np.maximum(elevation, np.radians(1.0))))


def compute_klobuchar(
    coefficients: Sequence[float],
    time: Floats,
    latitude: Floats,
    longitude: Floats,
    elevation: Floats,
    azimuth: Floats,
) -> Floats:
    r"""Delay at L1 by the ionosphere that GPS broadcasts [m].

    .. math:: c F \left(5\,\text{ns} + A \left(1 - \frac{x^2}{2} + \frac{x^4}{24}\right)\right),
        \quad x = 2 \pi (t - 50400\,\text{s}) / P

    with the second term by day alone, where :math:`|x| < 1.57`; the amplitude A and the period P
    are polynomials of the geomagnetic latitude with the `coefficients` (8,), t is the local time
    where the signal passes, F the obliquity. `time` in GPS seconds, angles [rad]. IS-GPS-200,
    20.3.3.5.2.5.
    """
    phi, lam, E = (np.asarray(x) / np.pi for x in (latitude, longitude, elevation))
    psi = 0.0137 / (E + 0.11) - 0.022
    phi = np.clip(phi + psi * np.cos(azimuth), -0.416, 0.416)
    lam = lam + psi * np.sin(azimuth) / np.cos(np.pi * phi)
    magnetic = phi + 0.064 * np.cos(np.pi * (lam - 1.617))
    amplitude = np.maximum(np.polyval(coefficients[3::-1], magnetic), 0.0)
    period = np.maximum(np.polyval(coefficients[:3:-1], magnetic), 72_000.0)
    x = 2.0 * np.pi * ((43_200.0 * lam + time) % 86_400.0 - 50_400.0) / period
    day = np.where(np.abs(x) < 1.57, amplitude * (1.0 - x**2 / 2.0 + x**4 / 24.0), 0.0)
    obliquity = 1.0 + 16.0 * (0.53 - E) ** 3
    return np.asarray(SPEED_OF_LIGHT * obliquity * (5e-9 + day))


def _rest(measured: _Measured) -> InertialSamples:
    """Samples of a perfect sensor at rest, its axes north, east and down."""
    steps = np.arange(measured.time.min() - 1.0, measured.time.max() + 1.0, STATIC_STEP_S)
    place = np.nanmedian(measured.fixes[:, :3], axis=0)
    latitude, longitude, _ = ecef_to_geodetic(place)
    C_en = dcm_e_from_n(latitude, longitude)
    force = -np.array(gravity(*place)) @ C_en
    rate = np.array([0.0, 0.0, EARTH_RATE]) @ C_en
    still = np.tile([[force], [rate]], (1, len(steps), 1))
    return InertialSamples(steps, still[0], still[1], 0)


def _cut_pieces(measured: _Measured, samples: InertialSamples) -> list[NDArray[np.intp]]:
    """Epochs that one replay runs through: between jumps of time, and gaps of either."""
    ends = samples.time
    lengths = np.diff(ends, prepend=-np.inf)
    during = np.clip(np.searchsorted(ends, measured.time), 0, len(ends) - 1)
    covered = (measured.time <= ends[-1]) & (lengths[during] <= LONGEST_SAMPLE_S)
    rows = np.flatnonzero(covered)
    require(
        rows.size,
        f"no epoch is at a time of an inertial sample: these are of {ends[0]:.3f} to "
        f"{ends[-1]:.3f} s GPS time, those of {measured.time[0]:.3f} to {measured.time[-1]:.3f} s; "
        "is `time.scale` right?",
    )
    apart = np.diff(measured.segment[rows]) != 0
    apart |= np.diff(np.cumsum(lengths > LONGEST_SAMPLE_S)[during[rows]]) != 0
    apart |= np.diff(measured.time[rows]) > LONGEST_GAP_S
    return np.split(rows, np.flatnonzero(apart) + 1)


def _compare_rest(measured: _Measured) -> list[str]:
    """Line about a receiver at rest whose fixes move."""
    speed = float(np.nanmedian(np.linalg.norm(measured.fixes[:, 3:6], axis=1)))
    moves = (
        f"fixes move at {speed:.2g} m/s (median), and at most {AT_REST_MPS:g} m/s at rest: is it?"
    )
    return [moves] if speed > AT_REST_MPS else []


def _compare_turns(measured: _Measured, samples: InertialSamples) -> list[str]:
    """Line about turns of the sensor that are not those of the velocity, with their cause."""
    rows = np.flatnonzero(np.isfinite(measured.fixes[:, 0]))
    latitude, longitude, _ = ecef_to_geodetic(measured.fixes[rows, :3])
    local = np.einsum("kji,kj->ki", dcm_e_from_n(latitude, longitude), measured.fixes[rows, 3:6])
    heading, time = np.unwrap(np.arctan2(local[:, 1], local[:, 0])), measured.time[rows]
    felt = samples.specific_force_b.mean(axis=0)
    rate = samples.angular_rate_b @ (-felt / np.linalg.norm(felt))  # about what is down
    angle = np.cumsum(rate * np.diff(samples.time, prepend=samples.time[0]))
    after = np.minimum(np.searchsorted(time, time + TURN_S), len(time) - 1)
    still = np.cumsum(np.hypot(local[:, 0], local[:, 1]) < MOVING_MPS)
    apart = np.abs(time[after] - time - TURN_S) > 0.5 * TURN_S
    moves, turned = ~apart & (still[after] == still), heading[after] - heading

    def compare(later: float = 0.0) -> tuple[float, float]:
        """Correlation of both, and how many times as large those of the sensor are."""
        at = time + later
        good = moves & (at >= samples.time[0]) & (at <= samples.time[-1])
        sensed = (lambda x: x[after] - x)(np.interp(at, samples.time, angle))[good]
        x, y, xy = turned[good] @ turned[good], sensed @ sensed, turned[good] @ sensed
        if good.sum() < FEWEST or x < good.sum() * TURN_RAD**2 or y == 0.0:
            return 0.0, 1.0
        return float(xy / np.sqrt(x * y)), float(np.sqrt(y / x))

    alike, ratio = compare()
    found = f"the sensor turns by {math.copysign(ratio, alike):.3g} times what the velocity does"
    cause = "is an axis turned round, or are the axes left-handed" if alike < -0.5 else ""
    if abs(alike) > 0.5 and not 0.1 < ratio < 10.0:
        cause = "is the unit of the axis that points down right (deg/s for rad/s)"
    shifts = {later: abs(compare(later)[0]) for later in (LEAP_SECONDS, -LEAP_SECONDS)}
    later = max(shifts, key=lambda x: shifts[x])
    if abs(alike) < 0.5 and shifts[later] > ALIKE:
        found = f"turns of the sensor are those of the velocity {later:+g} s away"
        cause = "is `time.scale` right (unix for unix-gps, or the other way round)"
    return [f"{found}: {cause}?"] if cause else []


def _make_recording(
    measured: _Measured, samples: InertialSamples, start: float, rows: NDArray[np.intp]
) -> Recording:
    """Epochs after the start, and the samples during them."""
    epochs = np.round(measured.time[rows] - start, 6)
    ends = np.round(samples.time - start, 6)
    during = slice(np.searchsorted(ends, 0.0, "right"), np.searchsorted(ends, epochs[-1]) + 1)
    return Recording(
        imu_time=ends[during],
        specific_force_b=samples.specific_force_b[during],
        angular_rate_b=samples.angular_rate_b[during],
        gnss_time=epochs,
        pseudorange=measured.pseudorange[rows],
        range_rate=measured.range_rate[rows],
        satellite_position_e=measured.position[rows],
        satellite_velocity_e=measured.velocity[rows],
    )


def _list_variances(sd: Floats, factors: tuple[float, float]) -> Floats:
    """(K, 2n) of the measurements, those of `NoiseModel` where the receiver says nothing."""
    model, n = NoiseModel(), sd.shape[1] // 2
    usual = np.repeat([model.pseudorange_sd, model.range_rate_sd], n)
    believed = np.where(np.isfinite(sd) & (sd > 0.0), sd, usual)
    return np.asarray((believed * np.repeat(factors, n)) ** 2)
