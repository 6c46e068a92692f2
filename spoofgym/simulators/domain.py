"""What differs from episode to episode: world, start, sensors, errors, target; not the noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._describe import OMITTED
from .._registry import build_record, check_choice
from ..sim.benign_events import BenignEvents
from ..sim.gnss import ERRORS, RENAMED
from ..sim.imu import IMU_GRADES
from ..sim.scenario import TURN_ON

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
MOST_WORLDS = 256
MOST_TIME_S = 1e8
"""Three years; beyond them a float's rounding of the time shows in positions of satellites."""
CHOICES = ("world", "start_s", "imu", "errors", "target_heading_deg")
"""What a reset may be given for every receiver."""


@dataclass(frozen=True, kw_only=True)
class Domain:
    """Ranges and lists from which every episode draws its circumstances.

    Every receiver draws for itself, from its own stream, uniformly.  By default nothing differs.

    Parameters
    ----------
    start_s : tuple of float
        Earliest and latest time of the flight at which the receiver is switched on; the attack
        starts a warm-up later.  None as the latest: as late as the flight allows.
    turned_deg : tuple of float
        Range of the turn of the whole flight about the vertical where it begins, clockwise.
    constellation_time_s : tuple of float
        Range of what is added to the time of the constellation, within 1e8 s.
    worlds : int, optional
        Number of worlds, pairs of a turn and a time of the constellation, that are computed once
        and drawn from, 1 to 256, and 1 where none of these has a range; by default 16 where one
        has.
    world_seed : int
        Seed of these pairs, at least 0.
    imu : tuple of str
        Grades of the inertial sensors; that of the scenario alone by default.  The receiver is
        tuned for the grade that it has.
    errors : tuple of str
        GNSS errors; those of the scenario alone by default.  A matched receiver assumes each.
    turn_on : {"specimen", "drawn"}, optional
        Constants of the inertial sensors; as in the scenario by default.
    events : mapping or BenignEvents, optional
        What looks like spoofing and is none; as in the scenario by default.
    """

    described_as = "Domain"
    start_s: tuple[float, float | None] = (0.0, 0.0)
    turned_deg: tuple[float, float] = (0.0, 0.0)
    constellation_time_s: tuple[float, float] = (0.0, 0.0)
    worlds: int | None = None
    world_seed: int = 0
    imu: tuple[str, ...] = ()
    errors: tuple[str, ...] = ()
    turn_on: str | None = field(default=None, metadata=OMITTED)
    events: BenignEvents | None = field(default=None, metadata=OMITTED)

    def __post_init__(self) -> None:
        self._check_options()
        for name in ("start_s", "turned_deg", "constellation_time_s"):
            object.__setattr__(self, name, _range(name, getattr(self, name), name == "start_s"))
        if self.start_s[0] < 0.0:
            raise ValueError(f"`start_s` must not begin before 0 s, got {self.start_s[0]}")
        for name, valid in (("imu", IMU_GRADES), ("errors", ERRORS)):
            given = getattr(self, name)
            given = (given,) if isinstance(given, str) else given
            if not isinstance(given, Sequence):
                raise ValueError(f"`{name}` must be a name or a list of names, got {given!r}")
            given = tuple(given)
            for each in given:
                check_choice("imu grade" if name == "imu" else name, each, valid, RENAMED)
            object.__setattr__(self, name, given)
        if self.worlds is not None and not 1 <= self.worlds <= MOST_WORLDS:
            raise ValueError(f"`worlds` must be 1 to {MOST_WORLDS}, got {self.worlds}")
        if self.worlds is not None and self.worlds > 1 and not self.varies:
            raise ValueError(
                f"`worlds` {self.worlds} would all be the same: give `turned_deg` or "
                "`constellation_time_s` a range"
            )
        if max(map(abs, self.constellation_time_s)) > MOST_TIME_S:
            raise ValueError(
                f"`constellation_time_s` must be -{MOST_TIME_S:g} to {MOST_TIME_S:g}, got "
                f"{self.constellation_time_s}"
            )
        if self.world_seed < 0:
            raise ValueError(f"`world_seed` must be at least 0, got {self.world_seed}")

    def _check_options(self) -> None:
        if self.turn_on is not None:
            check_choice("turn_on", self.turn_on, TURN_ON)
        if self.events is not None:
            events = build_record("events", BenignEvents, self.events)
            object.__setattr__(self, "events", events)

    @property
    def varies(self) -> bool:
        """Whether turns or times of the constellation have a range."""
        pairs = (self.turned_deg, self.constellation_time_s)
        return any(high > low for low, high in pairs)

    def pairs(self) -> list[tuple[float, float]]:
        """Turn [deg] and time of the constellation [s] of every world."""
        count = self.worlds if self.worlds is not None else (16 if self.varies else 1)
        rng = np.random.default_rng(self.world_seed)
        turns = rng.uniform(*self.turned_deg, count)
        times = rng.uniform(*self.constellation_time_s, count)
        return list(zip(turns.tolist(), times.tolist(), strict=True))


def _range(name: str, given: Any, open_end: bool) -> tuple[float, float | None]:
    """Pair of a least and a largest number."""
    if isinstance(given, str) or not isinstance(given, Sequence) or len(given) != 2:
        raise ValueError(f"`{name}` must be a pair of numbers, least and largest, got {given!r}")
    low, high = given
    if open_end and high is None:
        high = math.inf
    for value in (low, high):
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            raise ValueError(f"`{name}` must be a pair of numbers, got {given!r}")
    if not (math.isfinite(low) and low <= high and (open_end or math.isfinite(high))):
        raise ValueError(f"`{name}` must be finite, the least first, got {given!r}")
    return float(low), None if math.isinf(high) else float(high)


class Choice(NamedTuple):
    """Circumstances of some receivers' episodes, (b,) each. `world`, `grade`, `error`: index of the
    world, and in `Domain.imu` and `Domain.errors`; `start`: epoch of the world at which the episode
    starts; `heading`: direction in which displacement counts, clockwise from north [rad]."""

    world: IntArray
    grade: IntArray
    error: IntArray
    start: IntArray
    heading: FloatArray


class Bounds(NamedTuple):
    """Among how many of each an episode chooses, its starts, and its heading, None if drawn."""

    worlds: int
    grades: int
    errors: int
    first: int
    last: int
    heading: float | None

    @property
    def single(self) -> bool:
        """Whether there is nothing to choose."""
        counts = (self.worlds, self.grades, self.errors, self.last - self.first + 1)
        return max(counts) == 1 and self.heading is not None


def draw(bounds: Bounds, keys: NDArray[np.uint64]) -> Choice:
    """Draw the circumstances of episodes, each from its key of the source of chance, (b, 2)."""
    count = len(keys)
    whole = np.zeros((4, count), dtype=np.int64)
    whole[3] = bounds.first
    heading = np.full(count, 0.0 if bounds.heading is None else bounds.heading)
    if not bounds.single:
        for i, key in enumerate(keys.tolist()):
            rng = np.random.default_rng(key)
            u = rng.random(5)
            # all are drawn, so that one does not depend on whether another has a range
            sizes = (bounds.worlds, bounds.grades, bounds.errors, bounds.last - bounds.first + 1)
            whole[:, i] = [int(x * size) for x, size in zip(u[:4], sizes, strict=True)]
            whole[3, i] += bounds.first
            if bounds.heading is None:
                heading[i] = 2.0 * np.pi * u[4]
    return Choice(whole[0], whole[1], whole[2], whole[3], heading)


def given_choice(
    given: Mapping[str, Any],
    drawn: Choice,
    bounds: Bounds,
    names: Mapping[str, Sequence[str]],
    interval_s: float,
) -> Choice:
    """Circumstances as `given`, some of `CHOICES`, one value or (b,); those drawn elsewhere."""
    count = len(drawn.start)
    for name in given:
        check_choice("choice of a reset", name, CHOICES)
    values = {name: each_of(name, value, count) for name, value in given.items()}
    world, grade, error, start, heading = drawn
    if "world" in values:
        world = _whole("world", values["world"], 0, bounds.worlds - 1)
    if "start_s" in values:
        epochs = [x / interval_s for x in _numbers("start_s", values["start_s"])]
        span = (bounds.first * interval_s, bounds.last * interval_s)
        if not all(span[0] - 1e-6 <= x * interval_s <= span[1] + 1e-6 for x in epochs):
            raise ValueError(
                f"`start_s` must be {span[0]:g} to {span[1]:g}, got {given['start_s']}"
            )
        start = np.array([round(x) for x in epochs], dtype=np.int64)
        if any(abs(x - k) > 1e-6 for x, k in zip(epochs, start.tolist(), strict=True)):
            raise ValueError(
                f"`start_s` must be a multiple of the interval between epochs, {interval_s:g} s, "
                f"got {given['start_s']}"
            )
    if "imu" in values:
        grade = _index("imu", values["imu"], names["imu"])
    if "errors" in values:
        error = _index("errors", values["errors"], names["errors"])
    if "target_heading_deg" in values:
        if bounds.heading is not None:
            raise ValueError("a reset can be given `target_heading_deg` only where it is 'random'")
        heading = np.radians(_numbers("target_heading_deg", values["target_heading_deg"]))
    return Choice(world, grade, error, start, heading)


def each_of(name: str, value: Any, count: int) -> list[Any]:
    if isinstance(value, str) or np.ndim(value) == 0:
        return [value] * count
    values = list(value)
    if len(values) != count:
        raise ValueError(f"`{name}` must be one value or {count} of them, got {len(values)}")
    return values


def _numbers(name: str, values: Sequence[Any]) -> list[float]:
    numbers = []
    for value in values:
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number):
            raise ValueError(f"`{name}` must be finite numbers, got {value!r}")
        numbers.append(number)
    return numbers


def _whole(name: str, values: Sequence[Any], low: int, high: int) -> IntArray:
    numbers = _numbers(name, values)
    for number in numbers:
        if not (number.is_integer() and low <= number <= high):
            raise ValueError(f"`{name}` must be whole numbers, {low} to {high}, got {number:g}")
    return np.array(numbers, dtype=np.int64)


def _index(name: str, values: Sequence[Any], names: Sequence[str]) -> IntArray:
    for value in values:
        check_choice(name, str(value), names)
    return np.array([list(names).index(str(value)) for value in values], dtype=np.int64)
