"""Whether a recording can be, before its replay; whether its innovations fit the filter, after.

`check_recording` refuses what no receiver on or above the Earth measures, and names the likeliest
cause.  `flag_epochs` marks epochs, and `explain_flags` repeats the start of the replay with one
common mistake at a time undone: the likeliest cause is the one whose innovations fit.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.registry import require
from ..earth.wgs84 import (
    DEGREE,
    EARTH_RATE,
    GRAVITATIONAL_CONSTANT,
    SPEED_OF_LIGHT,
    STANDARD_GRAVITY,
    dcm_e_from_n,
    ecef_to_geodetic,
)
from .recording import IN_SAMPLES, MAY_BE_NAN, SOLVED, AnyRecording, PositionRecording, Recording
from .snapshot import Fix, least_squares_fix
from .tight import NavState

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Fields = dict[str, Any]
Mistake = tuple[str, Fields, Fields]
RECEIVER_RADII = 6.3e6, 5e7  # distances from the Earth's centre [m]
SATELLITE_RADII = 6.5e6, 1e8
OPAQUE_RADIUS = 6.33e6  # a signal passes no nearer to the Earth's centre, refraction included [m]
FASTEST = 12_000.0  # of any receiver or satellite [m/s]
LARGEST_FORCE, LARGEST_MEDIAN = 5e3, 5e2  # of a shock, and of half of the samples [m/s^2]
FREE_FALL_RADIUS = 6.478e6  # from the Earth's centre, below which nothing falls freely at first [m]
RANGE_SPREAD, SPREAD_RATE = 1e6, 8_000.0  # of what geometry leaves of ranges [m], its growth [m/s]
MEASURED_RANGES = 1e7, 1e8  # of satellites, the receiver's clock included [m]
SLOWEST_RANGE = 50.0  # of which a rate tells its unit and its sign [m/s]
ALIKE = 20.0  # of a satellite's velocity and of how it moves [m/s]
PULLED = 0.2  # of an orbit's acceleration, of which the axes' rotation makes 0.5 [m/s^2]
SLOPE = 0.3  # by which ranges may grow otherwise than by their rates, as a part
HELD = 0.1  # of velocities, by which positions move that are held
SMALLEST_SD = 1e-4  # of a range [m] or a range rate [m/s], below those of carrier phases
CLOCK_STEP = 1e-3 * SPEED_OF_LIGHT  # that receivers put their clocks right by [m]
UNITS = {
    "km": 1e3,
    "s": SPEED_OF_LIGHT,
    "ms": CLOCK_STEP,
    "us": 1e-6 * SPEED_OF_LIGHT,
    "ns": 1e-9 * SPEED_OF_LIGHT,
    "feet": 0.3048,
    "cycles of L1": SPEED_OF_LIGHT / 1575.42e6,
}
"""Of ranges [m]."""
BEYOND, SUSTAINED, AT_ONCE = 100.0, 5, 1e4
"""Mean square of whitened innovations that is a fault over so many epochs, and over one."""
MISFIT, WINDOW = 9.0, 20
"""Mean of it over a window from which on standard deviations do not fit."""
LEAP_SECONDS = 18.0  # between GPS time and UTC since 2017
DAILY_S = 235.9  # by which a GPS satellite comes by earlier from day to day
ROTATION = 5e-3  # by which the square of an attitude may be off the identity
TRIED_EPOCHS = 600
SHIFT_S, LONGEST_SHIFT_S = 10.0, 2e3  # over which an orbit is a parabola; of what is tried


LONGEST_STEP_S, TOGETHER_S, FAST, FEW_PAIRS, MOVED_OFTEN = 2.0, 5.0, 3.0, 5, 0.7
"""Of epochs, of their means, and of velocities [m/s] with which positions are compared, and how far
they may differ."""
LIKELY, MOVED_BADLY = 0.5, 0.2  # of a cause by which they differ less, and how far they may then


class ImplausibleWarning(UserWarning):
    """A replay's innovations are not what its filter believes, or its solution is not finite."""


def check_measured(recording: AnyRecording, measured: Bools, variance: Floats) -> None:
    """Raise a ValueError that names the likeliest cause where measurements can't be, wherever the
    receiver is. `measured` (K, 2n) what is there, and `variance` (K, 2n) of its noise."""
    low = measured & ~((variance >= SMALLEST_SD**2) & np.isfinite(variance))
    for k, j in np.argwhere(low)[:1]:
        raise ValueError(
            f"a noise variance must be finite and at least {SMALLEST_SD**2:g}, got "
            f"{variance[k, j]:g} in column {j} at {_time(recording, k)}"
        )
    visible = _split(measured)
    if isinstance(recording, PositionRecording):
        _check_places(recording)
    elif not visible.any():
        there = {name: bool(np.isfinite(getattr(recording, name)).any()) for name in MAY_BE_NAN}
        require(
            not any(there.values()) or all(there.values()),
            "a channel is measured where all of its fields are, but "
            f"{' and '.join(f'`{name}`' for name in there if not there[name])} is NaN everywhere",
        )
    else:
        _check_absent(recording, visible)
        _check_satellites(recording, visible)
        _check_rates(recording, visible)


def check_recording(recording: AnyRecording, initial: NavState, measured: Bools) -> None:
    """Raise where it can't be from this initial state on."""
    if isinstance(recording, PositionRecording):
        _check_motion(recording, initial)
    _check_start(initial)
    _check_force(recording, initial)
    if isinstance(recording, Recording) and (visible := _split(measured)).any():
        _check_sight(recording, initial, visible)
        _check_ranges(recording, initial, visible)


def _split(measured: Bools) -> Bools:
    """(K, n) channels that are measured."""
    return measured[:, : measured.shape[1] // 2]


def _check_places(recording: PositionRecording) -> None:
    """Raise where positions are not near the Earth, or velocities too large."""
    position, velocity = (np.asarray(getattr(recording, name)) for name in SOLVED)
    radius, speed = np.linalg.norm(position, axis=1), np.linalg.norm(velocity, axis=1)
    for k, here in enumerate(position):
        if np.isfinite(radius[k]):
            _check_place("position_e", here, f" at {_time(recording, k)}")
    fixed = np.flatnonzero(np.isfinite(radius))
    time = np.asarray(recording.gnss_time)[fixed]
    moved = np.linalg.norm(np.diff(position[fixed], axis=0), axis=1) / np.diff(time)
    for k in np.flatnonzero(moved > FASTEST)[:1]:
        raise ValueError(
            f"`position_e` must move by at most {FASTEST:g} m/s, got {moved[k]:g} up to "
            f"{time[k + 1]:g} s (what is its unit? An absent position must be NaN)"
        )
    for k in np.flatnonzero(speed > FASTEST)[:1]:
        raise ValueError(
            f"`velocity_e` must be at most {FASTEST:g} m/s, got {speed[k]:g} at "
            f"{_time(recording, k)} (what is its unit?)"
        )


def _check_motion(recording: PositionRecording, initial: NavState) -> None:
    """Velocities are how positions move."""
    position, velocity = (np.asarray(getattr(recording, name)) for name in SOLVED)
    step = np.diff(np.asarray(recording.gnss_time))[:, None]
    moved, mean = np.diff(position, axis=0) / step, 0.5 * (velocity[1:] + velocity[:-1])
    pairs = np.isfinite(moved + mean).all(axis=1) & (step[:, 0] <= LONGEST_STEP_S)
    moved, mean = moved[pairs], mean[pairs]
    fast = np.linalg.norm(mean, axis=1) > FAST
    if fast.sum() < FEW_PAIRS:
        return

    pace, speed = (float(np.median(np.linalg.norm(x[fast], axis=1))) for x in (moved, mean))
    each = max(1, round(TOGETHER_S / float(np.median(step[pairs]))))
    firsts = np.arange(0, fast.sum(), each)
    counts = np.diff(firsts, append=fast.sum())[:, None]

    def misfit(change: Callable[[Floats], Floats]) -> float:  # noise of positions cancels out
        off = np.add.reduceat(moved[fast] - change(mean[fast]), firsts) / counts
        return float(np.median(np.linalg.norm(off, axis=1)) / speed)

    axes = _local_axes(initial)
    causes: dict[str, Callable[[Floats], Floats]] = {
        "are its axes north, east and down": lambda v: v @ axes.T,
        "are its axes east, north and up": lambda v: v[:, [1, 0, 2]] * [1, 1, -1] @ axes.T,
        "is it in km/h": lambda v: v / 3.6,
        "is it in knots": lambda v: v * 1852.0 / 3600.0,
        "is it in mph": lambda v: v * 0.44704,
        "is it in ft/s": lambda v: v * 0.3048,
    }
    found, cause = misfit(lambda v: v), min(causes, key=lambda x: misfit(causes[x]))
    likely = misfit(causes[cause]) < LIKELY * found
    if pace < HELD * speed:
        cause = "are positions held from one solution to the next, or what is its unit"
        likely, found = True, 1.0 - pace / speed
    if found > (MOVED_BADLY if likely else MOVED_OFTEN):
        raise ValueError(
            "`velocity_e` must be in ECEF axes and m/s, but it differs from the motion of "
            f"the positions by {100.0 * found:.0f} % in the median "
            f"({cause if likely else 'do they belong together'}?)"
        )


def _time(recording: AnyRecording, epoch: int) -> str:
    return f"{np.asarray(recording.gnss_time)[epoch]:g} s"


def _check_place(name: str, position: Floats, when: str = "") -> None:
    """A receiver is on the Earth, or above it."""
    radius = float(np.linalg.norm(position))
    if RECEIVER_RADII[0] <= radius <= RECEIVER_RADII[1]:
        return
    cause = "is it the mark of an absent one, which is NaN here"
    if radius > RECEIVER_RADII[1]:
        cause = "what is its unit"
    elif RECEIVER_RADII[0] <= 1e3 * radius <= RECEIVER_RADII[1]:
        cause = "is it in km"
    elif position.any():
        cause = "is it latitude, longitude and height"
    raise ValueError(
        f"`{name}` must be ECEF in m, {RECEIVER_RADII[0]:g} to {RECEIVER_RADII[1]:g} from the "
        f"Earth's centre, got {position.tolist()}{when} ({cause}?)"
    )


def _check_start(initial: NavState) -> None:
    position, C = np.asarray(initial.position_e), np.asarray(initial.C_eb)
    speed = float(np.linalg.norm(initial.velocity_e))
    _check_place("initial.position_e", position)
    require(
        speed <= FASTEST,
        f"`initial.velocity_e` must be at most {FASTEST:g} m/s, got {speed:g} (what is its unit?)",
    )
    off = float(np.abs(C @ C.T - np.eye(3)).max())
    require(
        off < ROTATION and np.linalg.det(C) > 0.0,
        "`initial.C_eb` must be a rotation to ECEF from body axes, got one with "
        f"|C C' - I| = {off:.3g} and determinant {np.linalg.det(C):.3g}",
    )


def _check_force(recording: AnyRecording, initial: NavState) -> None:
    """Unit and direction of the specific force: on average it holds against gravity."""
    force = np.asarray(recording.specific_force_b)
    size = float(np.median(np.linalg.norm(force, axis=1)))
    require(
        not 0.8 < size < 1.25,
        f"`specific_force_b` must be in m/s^2, got a median of {size:.3g} (is it in g?)",
    )
    early = np.asarray(recording.imu_time) <= 1.0
    first, C = force[early].mean(axis=0), np.asarray(initial.C_eb)
    low, least = np.linalg.norm(initial.position_e) < FREE_FALL_RADIUS, np.linalg.norm(first)
    require(
        size < LARGEST_MEDIAN and not (low and least < 0.05 * STANDARD_GRAVITY),
        f"`specific_force_b` must be in m/s^2, 9.8 upwards at rest, got {least:.3g} in the first "
        f"second and a median of {size:.3g} (is it in mg, or was it turned into m/s^2 twice?)",
    )
    require(
        np.abs(force).max() < LARGEST_FORCE,
        f"`specific_force_b` must be below {LARGEST_FORCE:g} m/s^2, got {np.abs(force).max():g} "
        "(what is its unit, or is it the mark of an absent sample?)",
    )
    up = np.asarray(initial.position_e) / np.linalg.norm(initial.position_e)

    def upward(C: Floats) -> float:
        return float(up @ C @ first / np.linalg.norm(first))

    if np.linalg.norm(first) > 0.5 * STANDARD_GRAVITY and (found := upward(C)) < 0.26:
        cause = "are attitude and axes right"
        if upward(C.T) > 0.9:
            cause = "is `C_eb` transposed"
        elif upward(_local_axes(initial) @ C) > 0.9:
            cause = "is `C_eb` an attitude to local axes, north, east and down"
        elif found < -0.5:
            cause = "is its sign that of gravity"
        raise ValueError(
            "`initial.C_eb` and `specific_force_b` must hold the receiver against gravity: at rest "
            f"9.8 m/s^2 upwards, got {np.degrees(np.arccos(found)):.0f} deg from there in the "
            f"first second ({cause}?)"
        )


def _local_axes(initial: NavState) -> Floats:
    latitude, longitude, _ = ecef_to_geodetic(np.asarray(initial.position_e))
    return np.asarray(dcm_e_from_n(latitude, longitude))


def _check_absent(recording: Recording, visible: Bools) -> None:
    measured = int(visible.sum())
    for name, most in (("pseudorange", 0), ("range_rate", max(2, measured // 1000))):
        zero = visible & (np.asarray(getattr(recording, name)) == 0.0)
        if zero.sum() > most:
            k, j = np.argwhere(zero)[0]
            raise ValueError(
                f"`{name}` must be NaN where a channel has no measurement, got 0.0 in {zero.sum()} "
                f"of {measured} places, first in channel {j} at {_time(recording, k)}"
            )
    ranges, rates = np.asarray(recording.pseudorange), np.asarray(recording.range_rate)
    rows, _, pairs = _pair_epochs(recording, visible)
    held = pairs & (np.diff(ranges[rows], axis=0) == 0.0) & (np.diff(rates[rows], axis=0) == 0.0)
    if held.sum() > max(2, measured // 1000):
        k, j = np.argwhere(held)[0]
        raise ValueError(
            f"pseudorange and range rate must be new in every epoch, got the same as before in "
            f"{held.sum()} places, first in channel {j} at {_time(recording, rows[k + 1])} (are "
            "they held where there is no measurement, which is NaN here?)"
        )
    order = np.argsort(np.where(visible, ranges, np.nan), axis=1)
    twice = np.diff(np.take_along_axis(ranges, order, axis=1), axis=1) == 0.0
    twice &= np.take_along_axis(visible, order, axis=1)[:, 1:]
    if (epochs := np.flatnonzero(twice.any(axis=1))).size > 1:
        k, j = epochs[0], int(np.argmax(twice[epochs[0]]))
        raise ValueError(
            f"channels {sorted(order[k, j : j + 2].tolist())} have the same pseudorange in "
            f"{epochs.size} epochs, first at {_time(recording, k)} (is a satellite there twice?)"
        )


def _check_satellites(recording: Recording, visible: Bools) -> None:
    s, v = (np.asarray(getattr(recording, f"satellite_{x}_e")) for x in ("position", "velocity"))
    radius = np.linalg.norm(s, axis=-1)
    for name, speed in (
        ("satellite_velocity_e", np.linalg.norm(v, axis=-1)),
        ("range_rate", np.abs(recording.range_rate)),
    ):
        for k, j in np.argwhere(visible & ~(speed <= 2.0 * FASTEST))[:1]:
            raise ValueError(
                f"`{name}` must be at most {2.0 * FASTEST:g} m/s, got {speed[k, j]:g} in channel "
                f"{j} at {_time(recording, k)} (what is its unit?)"
            )

    def far(size: float) -> bool:
        return SATELLITE_RADII[0] <= size <= SATELLITE_RADII[1]

    for k, j in np.argwhere(
        visible & (abs(radius - np.mean(SATELLITE_RADII)) > np.ptp(SATELLITE_RADII) / 2.0)
    )[:1]:
        cause = " (are they in km?)" if far(1e3 * radius[k, j]) else ""
        raise ValueError(
            f"`satellite_position_e` must be ECEF in m, {SATELLITE_RADII[0]:g} to "
            f"{SATELLITE_RADII[1]:g} from the Earth's centre, got {radius[k, j]:g} in channel {j} "
            f"at {_time(recording, k)}{cause}"
        )
    _check_orbits(recording, visible)


def _check_orbits(recording: Recording, visible: Bools) -> None:
    """Satellites move with their velocities, and as orbits do."""
    s, v = (np.asarray(getattr(recording, f"satellite_{x}_e")) for x in ("position", "velocity"))
    rows, step, pairs = _pair_epochs(recording, visible)
    if pairs.sum() < FEW_PAIRS:
        return
    middle, place = (0.5 * (x[rows][1:] + x[rows][:-1]) for x in (v, s))
    moved, gained = (
        np.where(pairs[..., None], np.diff(x[rows], axis=0) / step[..., None], np.nan)
        for x in (s, v)
    )

    def misfit(velocity: Floats) -> float:
        return _take_median(moved - velocity)

    if (found := misfit(middle)) > ALIKE:
        turned = np.cross([0.0, 0.0, EARTH_RATE], place)
        with np.errstate(divide="ignore", invalid="ignore"):  # a satellite at rest
            sizes = np.linalg.norm(moved, axis=-1) / np.linalg.norm(middle, axis=-1)
        scale = float(np.nan_to_num(np.nanmedian(sizes), posinf=0.0))
        cause = "do they belong together"
        if misfit(1e3 * middle) < ALIKE:
            cause = "is it in km/s"
        elif misfit(middle - turned) < ALIKE:
            cause = "is it with respect to inertial axes"
        elif misfit(scale * middle) < ALIKE * max(scale, 1.0):
            cause = "is it, or are the times, in another unit"
        raise ValueError(
            "`satellite_velocity_e` must be ECEF in m/s, but `satellite_position_e` moves "
            f"differently, by {found:.3g} m/s in the median ({cause}?)"
        )
    _check_axes(place, middle, gained)


def _check_axes(s: Floats, v: Floats, gained: Floats) -> None:
    """Raise where satellites (K, n, 3) gain velocity as in other axes."""
    flipped = np.array([1.0, -1.0, 1.0])
    causes: dict[str, tuple[Floats, float]] = {
        "": (np.ones(3), EARTH_RATE),
        "is an axis flipped, or are two swapped": (flipped, EARTH_RATE),
        "are they in inertial axes": (np.ones(3), 0.0),
    }
    off = {
        cause: _take_median(gained * axes - _accelerate(s * axes, v * axes, rate))
        for cause, (axes, rate) in causes.items()
    }
    cause = min(off, key=off.__getitem__)
    if off[""] > PULLED and off[cause] < LIKELY * off[""]:
        raise ValueError(
            "`satellite_position_e` and `satellite_velocity_e` must be in ECEF axes, but do not "
            f"move there as orbits do, by {off['']:.2g} m/s^2 in the median ({cause}?)"
        )


def _take_median(off: Floats) -> float:
    """Of the sizes of the medians of channels (K, n, 3), of which some have no pair."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return float(np.nanmedian(np.linalg.norm(np.nanmedian(off, axis=0), axis=-1)))


def _pair_epochs(recording: Recording, visible: Bools) -> tuple[NDArray[np.intp], Floats, Bools]:
    """Epochs that have at least three channels, the times between them (K-1, 1), and which channels
    (K-1, n) are measured in both."""
    rows = np.flatnonzero(visible.sum(axis=1) > 2)
    step = np.diff(np.asarray(recording.gnss_time)[rows])[:, None]
    return rows, step, visible[rows][1:] & visible[rows][:-1] & (step <= 60.0)


def _check_sight(recording: Recording, initial: NavState, visible: Bools) -> None:
    s, r = np.asarray(recording.satellite_position_e), np.asarray(initial.position_e)
    with np.errstate(invalid="ignore"):
        sight = s - r
        along = sight @ r
        nearest = np.sqrt(np.maximum(r @ r - along**2 / (sight**2).sum(axis=-1), 0.0))
        hidden = visible & (along < 0.0) & (nearest < OPAQUE_RADIUS)
    # later the receiver may be elsewhere
    hidden[np.asarray(recording.gnss_time) > 60.0] = False
    for k, j in np.argwhere(hidden)[:1]:
        raise ValueError(
            f"the satellite in channel {j} at {_time(recording, k)} must be above the horizon of "
            "`initial.position_e`, but the Earth is between them (is it the right satellite, and "
            "the right time of its orbit?)"
        )


def _check_ranges(recording: Recording, initial: NavState, visible: Bools) -> None:
    """Ranges less geometry are the receiver's clock, and alike but for satellite clocks."""
    time, r = np.asarray(recording.gnss_time), np.asarray(initial.position_e)
    distance = np.linalg.norm(np.asarray(recording.satellite_position_e) - r, axis=-1)
    ranges = np.asarray(recording.pseudorange)
    rows = np.flatnonzero(visible.sum(axis=1) > 2)

    def spread(factor: float) -> Floats:
        left = np.where(visible, factor * ranges - distance, np.nan)[rows]
        return np.asarray(np.abs(left - np.nanmedian(left, axis=1, keepdims=True)))

    allowed = RANGE_SPREAD + SPREAD_RATE * time[rows, None]
    found = spread(1.0)
    for row, j in np.argwhere(found > allowed)[:1]:
        k = rows[row]
        cause = "do ranges, satellites and their times belong together"
        unit = min(UNITS, key=lambda x: float(np.nanmax(spread(UNITS[x])[row])))
        if np.nanmax(spread(UNITS[unit])[row]) < RANGE_SPREAD:
            cause = f"are they in {unit}"
        if np.nanmedian(found[row]) < RANGE_SPREAD and not (
            MEASURED_RANGES[0] < ranges[k, j] < MEASURED_RANGES[1]
        ):
            cause = "is it the mark of an absent measurement, which is NaN here"
        raise ValueError(
            f"`pseudorange` of {ranges[k, j]:g} in channel {j} at {_time(recording, k)} differs by "
            f"{found[row, j]:.3g} m from what the other channels and the satellite's position "
            f"leave for it ({cause}?)"
        )


def _check_rates(recording: Recording, visible: Bools) -> None:
    """The change of a range is the integral of its rate, whatever the receiver does."""
    rows, step, pairs = _pair_epochs(recording, visible)
    change, mean, common = _list_changes(recording, rows, step, pairs)
    steps = np.round(common / CLOCK_STEP)
    for row in np.flatnonzero((steps != 0) & (np.abs(common - steps * CLOCK_STEP) < 1e3))[:1]:
        raise ValueError(
            f"all pseudoranges jump by {common[row]:.0f} m at {_time(recording, rows[row + 1])}, "
            f"{steps[row]:g} ms of the receiver's clock: take its jumps out of the pseudoranges"
        )
    fast = pairs & (np.abs(mean) > SLOWEST_RANGE)
    if fast.sum() < 10:  # rates are too small, unless ranges grow by as little
        fast = pairs & (np.abs(change / step) > SLOWEST_RANGE)
        if fast.sum() < max(10, pairs.sum() // 2):
            return
    with np.errstate(divide="ignore"):
        ratio = (change / step)[fast] / mean[fast]
    slope = float(np.median(ratio))
    scatter = 1.5 * float(np.median(np.abs(ratio - slope))) / np.sqrt(ratio.size)
    if abs(slope - 1.0) > max(SLOPE, 5.0 * scatter):
        cause = "what is its unit"
        if abs(slope + 1.0) < 0.3:
            cause = "is it Doppler's sign, positive where the satellite comes nearer"
        elif 0.15 < abs(slope) < 0.26:
            cause = "is it a Doppler shift in Hz"
        elif 900.0 < slope < 1100.0:
            cause = "is it in km/s"
        unit = min(UNITS, key=lambda x: abs(slope * UNITS[x] - 1.0))
        if abs(slope * UNITS[unit] - 1.0) < 0.1:
            cause = f"are they in {unit}"
        raise ValueError(
            "`range_rate` must be the rate at which the pseudorange grows, in m/s, but the "
            f"pseudoranges grow by {slope:.3g} times as much ({cause}?)"
        )


def _list_changes(
    recording: Recording, rows: NDArray[np.intp], step: Floats, pairs: Bools
) -> tuple[Floats, Floats, Floats]:
    """(K-1, n) changes of the pseudoranges between epochs and means of their rates, and what all
    channels of an epoch (K-1,) have in common of the difference [m]; 0 where three have none."""
    ranges, rate = (np.asarray(x)[rows] for x in (recording.pseudorange, recording.range_rate))
    change = np.where(pairs, np.diff(ranges, axis=0), np.nan)
    mean = 0.5 * (rate[1:] + rate[:-1])
    common, many = np.zeros(len(change)), pairs.sum(axis=1) > 2
    common[many] = np.nanmedian((change - mean * step)[many], axis=1)
    return change, mean, common


def flag_epochs(misfit: Floats) -> NDArray[np.str_]:
    """Flags (K,) of epochs: "" where nothing is wrong, "not finite", "innovations" far beyond their
    covariance, or "sd" where standard deviations do not fit. `misfit` (K,) mean square of the
    whitened innovations, -1 without a measurement."""
    flag = np.full(misfit.shape, "", dtype="<U11")
    measured = np.flatnonzero(np.isfinite(misfit) & (misfit >= 0.0))
    value = misfit[measured]
    sums = np.cumsum(np.insert(value, 0, 0.0))
    mean = (sums[1:] - sums[np.maximum(np.arange(len(value)) + 1 - WINDOW, 0)]) / WINDOW
    flag[measured[mean > MISFIT]] = "sd"
    edges = np.flatnonzero(np.diff(np.concatenate([[False], value > BEYOND, [False]])))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        if end - first >= SUSTAINED:
            flag[measured[first:end]] = "innovations"
    flag[misfit > AT_ONCE] = "innovations"
    flag[~np.isfinite(misfit)] = "not finite"
    return flag


def _shift(position: Floats, velocity: Floats, elapsed: Any) -> tuple[Floats, Floats]:
    """Satellites (..., 3) a little later on their orbits; `elapsed` (...) or a number [s]."""
    s, v = position, velocity
    steps = max(1, int(np.ceil(np.nanmax(np.abs(elapsed)) / SHIFT_S)))
    t = np.asarray(elapsed)[..., None] / steps
    for _ in range(steps):
        acceleration = _accelerate(s, v, EARTH_RATE)
        s, v = s + v * t + 0.5 * acceleration * t * t, v + acceleration * t
    return s, v


def _accelerate(s: Floats, v: Floats, rate: float) -> Floats:
    """Acceleration (..., 3) of satellites in axes that turn at a rate about the third one."""
    turn = np.array([0.0, 0.0, rate])
    with np.errstate(invalid="ignore"):  # where none is
        pull = -GRAVITATIONAL_CONSTANT * s / np.linalg.norm(s, axis=-1, keepdims=True) ** 3
    return np.asarray(pull - 2.0 * np.cross(turn, v) - np.cross(turn, np.cross(turn, s)))


def _fit_elapsed(
    ranges: Floats, rates: Floats, position: Floats, velocity: Floats, guess: Any
) -> tuple[float, Fix]:
    """Time by which satellites are too early for the ranges of an epoch [s], and their fix then.
    Raises ValueError where it is not found."""

    def fit(later: float) -> tuple[Floats, Fix]:
        s, v = _shift(position, velocity, later)
        fix = least_squares_fix(ranges, rates, s, v, guess_e=guess)
        left = ranges - expect_ranges(s, fix.position_e) - fix.clock_bias_m
        return left[np.isfinite(left)], fix

    elapsed = 0.0
    for _ in range(6):
        now, fix = fit(elapsed)
        slope = fit(elapsed + 1.0)[0] - now
        elapsed -= float(now @ slope / (slope @ slope))
        require(abs(elapsed) < LONGEST_SHIFT_S, "the satellites fit at no time")
    return elapsed, fix


def expect_ranges(s: Floats, r: Floats) -> Floats:
    """Ranges without clocks, with the Sagnac effect to first order [m]."""
    sagnac = EARTH_RATE / SPEED_OF_LIGHT * (s[..., 0] * r[..., 1] - s[..., 1] * r[..., 0])
    return np.asarray(np.linalg.norm(s - r, axis=-1) + sagnac)


def _without_offsets(recording: Recording, initial: NavState) -> dict[str, Any]:
    """Every channel without what geometry and the receiver's clock leave of its first range."""
    ranges, s = np.asarray(recording.pseudorange), np.asarray(recording.satellite_position_e)
    moved = np.asarray(recording.gnss_time)[:, None] * np.asarray(initial.velocity_e)
    clock = initial.clock_bias_m + initial.clock_drift_mps * np.asarray(recording.gnss_time)
    left = ranges - expect_ranges(s, (initial.position_e + moved)[:, None]) - clock[:, None]
    first = np.argmax(np.isfinite(left), axis=0)
    return {"pseudorange": ranges - left[first, np.arange(left.shape[1])]}


def _list_mistakes(x: AnyRecording, start: NavState) -> Iterator[Mistake]:
    """Common mistakes, each with what undoes it in the recording and in the initial state."""
    rate, force, C = (np.asarray(v) for v in (x.angular_rate_b, x.specific_force_b, start.C_eb))
    ends, times = np.asarray(x.imu_time), np.asarray(x.gnss_time)
    for words, right in (
        ("is in deg/s", DEGREE * rate),
        ("was turned into rad/s twice", rate / DEGREE),
        ("has the opposite sign", -rate),
        ("is of increments, not of rates", rate / np.diff(ends, prepend=0.0)[:, None]),
    ):
        yield f"`angular_rate_b` {words}", {"angular_rate_b": right}, {}
    yield "`specific_force_b` is in ft/s^2", {"specific_force_b": 0.3048 * force}, {}
    yield (
        "`specific_force_b` has the sign of gravity (or other axes than `angular_rate_b`)",
        {"specific_force_b": -force},
        {"C_eb": C * [1.0, -1.0, -1.0]},  # it was levelled upside down
    )
    yield "`C_eb` is transposed", {}, {"C_eb": C.T}
    local = _local_axes(start)
    yield "`C_eb` is an attitude to local axes, north, east and down", {}, {"C_eb": local @ C}
    for angle, (c, s) in ((90, (0.0, 1.0)), (-90, (0.0, -1.0)), (180, (-1.0, 0.0))):
        turned = local @ [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]] @ local.T @ C
        words = f"attitude and axes of the inertial sensor differ by {angle} deg in heading"
        yield words, {}, {"C_eb": turned}
    for words, factor in (("twice", 2.0), ("half", 0.5)):
        fields = {"imu_time": factor * ends, **_choose(x, times <= factor * ends[-1])}
        yield f"inertial samples last {words} as long as `imu_time` says", fields, {}
    if isinstance(x, Recording):
        yield from _list_mistakes_of_ranges(x, start)
    else:
        position, velocity = np.asarray(x.position_e), np.asarray(x.velocity_e)
        for k in np.flatnonzero(np.isfinite(position + velocity).all(axis=1))[:1]:
            yield from _list_mistakes_of_start(Fix(position[k], velocity[k], 0, 0), times[k], start)


def _list_mistakes_of_start(fix: Fix, elapsed: float, start: NavState) -> Iterator[Mistake]:
    """Against the first fix, `elapsed` after the start [s]."""
    for name, right, unit in (
        ("position_e", fix.position_e - elapsed * fix.velocity_e, "m"),
        ("velocity_e", fix.velocity_e, "m/s"),
        ("clock_bias_m", fix.clock_bias_m - elapsed * fix.clock_drift_mps, "m"),
        ("clock_drift_mps", fix.clock_drift_mps, "m/s"),
    ):
        off = np.hypot.reduce(np.ravel(right - getattr(start, name)))
        yield f"`initial.{name}` is {off:.3g} {unit} from that of the first fix", {}, {name: right}


def _list_mistakes_of_ranges(x: Recording, start: NavState) -> Iterator[Mistake]:
    ranges, rates, s, v = (np.asarray(getattr(x, name)) for name in MAY_BE_NAN)
    times, names = np.asarray(x.gnss_time), MAY_BE_NAN[2:]
    right = dict(zip(names, _shift(s, v, ranges / -SPEED_OF_LIGHT), strict=True))
    yield "satellites are where they are when a signal arrives, not when it leaves them", right, {}
    visible = np.isfinite(ranges + rates + (s + v).sum(axis=-1))
    with suppress(ValueError):
        for k in np.flatnonzero(visible.sum(axis=1) > 3)[:1]:
            fix = least_squares_fix(ranges[k], rates[k], s[k], v[k], guess_e=start.position_e)
            yield from _list_mistakes_of_start(fix, times[k], start)
    with suppress(ValueError):
        for k in np.flatnonzero(visible.sum(axis=1) > 5)[:1]:
            elapsed, fix = _fit_elapsed(ranges[k], rates[k], s[k], v[k], start.position_e)
            late, days, cause = abs(elapsed), round(abs(elapsed) / DAILY_S), ""
            if abs(late - LEAP_SECONDS) < 0.5:
                cause = ": leap seconds, UTC for GPS time"
            elif abs(late / DAILY_S - days) < 0.05 * days:
                cause = ": orbits of another day"
            way = f"were {late:.3g} s before" if elapsed > 0.0 else f"will be {late:.3g} s after"
            right = dict(zip(names, _shift(s, v, elapsed), strict=True))
            position = fix.position_e - times[k] * np.asarray(start.velocity_e)
            state = {"position_e": position, "clock_bias_m": fix.clock_bias_m}
            yield f"satellites are where they {way}{cause}", right, state
    rows, step, pairs = _pair_epochs(x, visible)
    for common in (_list_changes(x, rows, step, pairs)[2],) if rows.size > 1 else ():
        at = int(np.argmax(np.abs(common)))
        words = f"all pseudoranges jump by {common[at]:.0f} m at {_time(x, rows[at + 1])}"
        later = np.arange(len(ranges)) >= rows[at + 1]
        right = {"pseudorange": ranges - common[at] * later[:, None]}
        yield f"{words}, as the receiver's clock does", right, {}
    for j in range(ranges.shape[1]):
        right = {"pseudorange": np.where(np.arange(ranges.shape[1]) == j, np.nan, ranges)}
        yield f"something in channel {j} alone: its satellite, its clock, or an attack", right, {}
    right = _without_offsets(x, start)
    yield "the satellites' clocks or delays were not taken out of the pseudoranges", right, {}


def explain_flags(
    misfit_with: Callable[[Any, NavState], Floats],
    recording: AnyRecording,
    initial: NavState,
    flag: NDArray[np.str_],
    misfit: Floats,
    by_signal: Floats,
) -> str:
    """Sentence about flagged epochs, with the likeliest cause. `misfit_with`: of a start of the
    recording; `by_signal` (K, 2) mean squares of lengths and rates alone."""
    flagged = np.flatnonzero(flag)
    first = int(flagged[0])
    finite = misfit[flagged][np.isfinite(misfit[flagged])]
    times = f"{np.sqrt(np.median(finite)):.3g} times" if finite.size else "beyond all bounds of"
    head = _cut(recording, min(2 * (first + WINDOW), len(flag), TRIED_EPOCHS))
    cause = _blame_signal(by_signal[flagged], isinstance(recording, Recording))
    if first < TRIED_EPOCHS:
        before = _average(misfit[first : len(np.asarray(head.gnss_time))])
        best = min(MISFIT, 0.1 * before)
        for words, changed, start in _list_mistakes(head, initial):
            with suppress(ValueError):  # no sensor turns so fast
                other = dataclasses.replace(head, **changed)
                again = misfit_with(other, dataclasses.replace(initial, **start))
                if (after := _average(again[first:])) < best:
                    best, cause = 0.95 * after, words  # the last ones fit others' mistakes, too
    return (
        f"{len(flagged)} of {len(flag)} epochs are flagged, first {str(flag[first])!r} at "
        f"{_time(recording, first)}: innovations are {times} what the filter believes; the "
        f"likeliest cause: {cause}"
    )


def _average(misfit: Floats) -> float:
    """Mean over measured epochs; infinity where one is not finite."""
    measured = misfit[~(misfit < 0.0)]
    return float(np.nan_to_num(measured.mean(), nan=np.inf)) if measured.size else np.inf


def _choose(x: AnyRecording, epochs: Any) -> Fields:
    names = {field.name for field in dataclasses.fields(x)} - {"imu_time", *IN_SAMPLES}
    return {name: np.asarray(getattr(x, name))[epochs] for name in names}


def _cut(x: AnyRecording, epochs: int) -> AnyRecording:
    samples = slice(int(x.epoch_samples()[epochs - 1]))
    cut: Fields = {
        name: np.asarray(getattr(x, name))[samples] for name in ("imu_time", *IN_SAMPLES)
    }
    return dataclasses.replace(x, **cut, **_choose(x, slice(epochs)))


BLAMED = {
    True: (
        "something in the pseudoranges alone: satellite clocks, orbits or their times, noise, a "
        "jump of the receiver's clock, or an attack",
        "something in the range rates alone: their noise, the satellites' velocities",
    ),
    False: (
        "something in the positions alone: a delay, jumps from one solution to the next, an attack",
        "something in the velocities alone: their noise, a delay, their axes",
    ),
}


def _blame_signal(by_signal: Floats, of_ranges: bool) -> str:
    finite = by_signal[np.isfinite(by_signal).all(axis=1)]
    lengths, rates = np.median(finite, axis=0) if len(finite) else (np.inf, np.inf)
    if lengths > 10.0 * rates:
        return BLAMED[of_ranges][0]
    if rates > 10.0 * lengths:
        return BLAMED[of_ranges][1]
    return (
        "attitude, inertial samples or their time base do not belong to the measurements, or their "
        "noise is larger than the filter's"
    )
