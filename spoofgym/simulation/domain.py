"""What is drawn per episode; combinations of worlds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from ..core.declared import setting, settings_record
from ..core.registry import build_record, check_choice, require
from ..earth.attitude import euler_to_dcm
from ..receiver import TightlyCoupled
from ..receiver.augmented import FilterModel, SignalModel, signal_model
from ..receiver.matching import (
    Motion,
    compute_assumed_noise,
    compute_assumed_variance,
    compute_motion,
    depends_on_motion,
)
from ..receiver.tight import NoiseModel
from ..truth.events import BenignEvents
from ..truth.gnss_errors import ERRORS, GnssErrors
from ..truth.run import GroundTruth
from ..truth.satellites import CircularConstellation, Constellation
from ..truth.scenario import TURN_ON, Scenario
from ..truth.sensors import IMU_GRADES, ImuGrade

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
MOST_WORLDS = 256
MOST_TIME_S = 1e8  # three years; beyond, the rounding of the time shows in positions of satellites
CHOICES = ("world", "start_s", "imu", "errors", "target_heading_deg", "age_s")
"""What a reset may be given."""


@settings_record(frozen=True, kw_only=True)
class Domain:
    """Ranges and lists from which every episode draws its circumstances.

    Every receiver draws for itself, from its own stream, uniformly.  By default nothing differs.
    """

    start_s: tuple[float, float | None] = setting(
        default=(0.0, 0.0),
        unit="s",
        help="Earliest and latest time of the flight at which the receiver is switched on; the "
        "attack starts a warm-up later.  None as the latest: as late as the flight allows.",
    )
    age_s: tuple[float, float] | None = setting(
        default=None,
        omitted=True,
        unit="s",
        help="Range of the age of receiver and detectors at the onset, the time since they were "
        "switched on, of which the logarithm is uniform; by default the warm-up of the timeline.  "
        "Detectors are live from the same time after switch-on as there.",
    )
    turned_deg: tuple[float, float] = setting(
        default=(0.0, 0.0),
        unit="deg",
        help="Range of the turn of the whole flight about the vertical where it begins, clockwise.",
    )
    constellation_time_s: tuple[float, float] = setting(
        default=(0.0, 0.0),
        unit="s",
        help="Range of what is added to the time of the constellation; within 1e8 s.",
    )
    worlds: int | None = setting(
        default=None,
        least=1,
        most=MOST_WORLDS,
        help="Number of worlds, pairs of a turn and a time of the constellation, that are computed "
        "once and drawn from; 1 where none of these has a range; by default 16 where one has.",
    )
    turns: int | None = setting(
        default=None,
        least=1,
        most=MOST_WORLDS,
        omitted=True,
        help="Number of different turns among the worlds, which take them in rotation; by default "
        "each has its own.  Worlds of one turn share the samples of the inertial sensors, a third "
        "of their memory.",
    )
    world_seed: int = setting(default=0, least=0, help="Seed of these pairs.")
    imu: tuple[str, ...] = setting(
        default=(),
        help="Grades of the inertial sensors; by default only the scenario's.  The receiver "
        "is tuned for the grade that it has.",
    )
    errors: tuple[str, ...] = setting(
        default=(),
        help="GNSS errors; by default only the scenario's.  A matched receiver assumes each.",
    )
    turn_on: str | None = setting(
        default=None,
        one_of=TURN_ON,
        omitted=True,
        help="Constants of the inertial sensors; as in the scenario by default.",
    )
    events: BenignEvents | None = setting(
        default=None,
        omitted=True,
        help="Events that look like spoofing but are not; as in the scenario by default.",
    )

    def __post_init__(self) -> None:
        if self.events is not None:
            object.__setattr__(self, "events", build_record("events", BenignEvents, self.events))
        for name in ("start_s", "turned_deg", "constellation_time_s"):
            object.__setattr__(self, name, _range(name, getattr(self, name), name == "start_s"))
        require(
            self.start_s[0] >= 0.0, f"`start_s` must not begin before 0 s, got {self.start_s[0]}"
        )
        if self.age_s is not None:
            object.__setattr__(self, "age_s", _range("age_s", self.age_s, False))
            require(self.age_s[0] > 0.0, f"`age_s` must be above 0 s, got {self.age_s}")
        for name, valid in (("imu", IMU_GRADES), ("errors", ERRORS)):
            given = getattr(self, name)
            given = (given,) if isinstance(given, str) else given
            if not isinstance(given, Sequence):
                raise ValueError(f"`{name}` must be a name or a list of names, got {given!r}")
            given = tuple(given)
            for each in given:
                check_choice("imu grade" if name == "imu" else name, each, valid)
            object.__setattr__(self, name, given)
        require(
            self.worlds in (None, 1) or self.varies,
            f"`worlds` {self.worlds} would all be the same: give `turned_deg` or "
            "`constellation_time_s` a range",
        )
        require(
            max(map(abs, self.constellation_time_s)) <= MOST_TIME_S,
            f"`constellation_time_s` must be -{MOST_TIME_S:g} to {MOST_TIME_S:g}, got "
            f"{self.constellation_time_s}",
        )

    @property
    def varies(self) -> bool:
        return any(high > low for low, high in (self.turned_deg, self.constellation_time_s))

    def pairs(self) -> list[tuple[float, float]]:
        """Turn [deg] and time of the constellation [s] of every world."""
        count = self.worlds if self.worlds is not None else (16 if self.varies else 1)
        rng = np.random.default_rng(self.world_seed)
        turns = rng.uniform(*self.turned_deg, count)
        turns = turns[np.arange(count) % (self.turns or count)]
        times = rng.uniform(*self.constellation_time_s, count)
        return list(zip(turns.tolist(), times.tolist(), strict=True))


def _range(name: str, given: Any, open_end: bool) -> tuple[float, float | None]:
    if isinstance(given, str) or not isinstance(given, Sequence) or len(given) != 2:
        raise ValueError(f"`{name}` must be a pair of numbers, least and largest, got {given!r}")
    low, high = given
    if open_end and high is None:
        high = math.inf
    for value in (low, high):
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            raise ValueError(f"`{name}` must be a pair of numbers, got {given!r}")
    require(
        math.isfinite(low) and low <= high and (open_end or math.isfinite(high)),
        f"`{name}` must be finite, the least first, got {given!r}",
    )
    return float(low), None if math.isinf(high) else float(high)


class Choice(NamedTuple):
    """Circumstances of some receivers' episodes, (b,) each. `world`, `grade`, `error`: index of the
    world, and in `Domain.imu` and `Domain.errors`; `start`: epoch of the world at which the episode
    starts; `heading`: direction in which displacement counts, clockwise from north [rad]; `age`:
    epochs from the start to the onset."""

    world: IntArray
    grade: IntArray
    error: IntArray
    start: IntArray
    heading: FloatArray
    age: IntArray


class DomainBounds(NamedTuple):
    """Among how many of each an episode chooses, its starts, its heading, None if drawn, and its
    least and largest age."""

    worlds: int
    grades: int
    errors: int
    first: int
    last: int
    heading: float | None
    youngest: int
    oldest: int

    @property
    def single(self) -> bool:
        starts, ages = self.last - self.first + 1, self.oldest - self.youngest + 1
        counts = (self.worlds, self.grades, self.errors, starts, ages)
        return max(counts) == 1 and self.heading is not None


def draw(bounds: DomainBounds, keys: NDArray[np.uint64]) -> Choice:
    """Draw the circumstances of episodes, each from its random key, (b, 2)."""
    count = len(keys)
    whole = np.zeros((4, count), dtype=np.int64)
    whole[3] = bounds.first
    age = np.full(count, bounds.youngest)
    heading = np.full(count, 0.0 if bounds.heading is None else bounds.heading)
    if not bounds.single:
        for i, key in enumerate(keys.tolist()):
            u = np.random.default_rng(key).random(6)
            # all are drawn, so that one does not depend on whether another has a range
            sizes = (bounds.worlds, bounds.grades, bounds.errors, bounds.last - bounds.first + 1)
            whole[:, i] = [int(x * size) for x, size in zip(u[:4], sizes, strict=True)]
            whole[3, i] += bounds.first
            if bounds.heading is None:
                heading[i] = 2.0 * np.pi * u[4]
            if bounds.youngest < bounds.oldest:
                age[i] = round(bounds.youngest * (bounds.oldest / bounds.youngest) ** u[5])
    return Choice(whole[0], whole[1], whole[2], whole[3], heading, age)


def apply_choices(
    given: Mapping[str, Any],
    drawn: Choice,
    bounds: DomainBounds,
    names: Mapping[str, Sequence[str]],
    interval_s: float,
) -> Choice:
    """Circumstances as `given`, some of `CHOICES`, one value or (b,); those drawn elsewhere."""
    count = len(drawn.start)
    for name in given:
        check_choice("choice of a reset", name, CHOICES)
    values = {name: expand_values(name, value, count) for name, value in given.items()}
    world, grade, error, start, heading, age = drawn
    if "world" in values:
        world = _whole("world", values["world"], 0, bounds.worlds - 1)
    if "start_s" in values:
        starts = bounds.first, bounds.last
        start = _epochs("start_s", given["start_s"], count, starts, interval_s)
    if "age_s" in values:
        ages = bounds.youngest, bounds.oldest
        age = _epochs("age_s", given["age_s"], count, ages, interval_s)
    if "imu" in values:
        grade = _index("imu", values["imu"], names["imu"])
    if "errors" in values:
        error = _index("errors", values["errors"], names["errors"])
    if "target_heading_deg" in values:
        require(
            bounds.heading is None,
            "a reset can be given `target_heading_deg` only where it is 'random'",
        )
        heading = np.radians(_numbers("target_heading_deg", values["target_heading_deg"]))
    return Choice(world, grade, error, start, heading, age)


def _epochs(name: str, given: Any, count: int, span: tuple[int, int], step_s: float) -> IntArray:
    """Times that are given [s] as (count,) numbers of epochs within a span of them."""
    epochs = [x / step_s for x in _numbers(name, expand_values(name, given, count))]
    first, last = (k * step_s for k in span)
    require(
        all(first - 1e-6 <= x * step_s <= last + 1e-6 for x in epochs),
        f"`{name}` must be {first:g} to {last:g}, got {given}",
    )
    whole = [round(x) for x in epochs]
    require(
        all(abs(x - k) <= 1e-6 for x, k in zip(epochs, whole, strict=True)),
        f"`{name}` must be a multiple of the interval between epochs, {step_s:g} s, got {given}",
    )
    return np.array(whole, dtype=np.int64)


def expand_values(name: str, value: Any, count: int) -> list[Any]:
    if isinstance(value, str) or np.ndim(value) == 0:
        return [value] * count
    values = list(value)
    require(
        len(values) == count, f"`{name}` must be one value or {count} of them, got {len(values)}"
    )
    return values


def _numbers(name: str, values: Sequence[Any]) -> list[float]:
    numbers = []
    for value in values:
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = math.nan
        require(math.isfinite(number), f"`{name}` must be finite numbers, got {value!r}")
        numbers.append(number)
    return numbers


def _whole(name: str, values: Sequence[Any], low: int, high: int) -> IntArray:
    numbers = _numbers(name, values)
    for number in numbers:
        require(
            number.is_integer() and low <= number <= high,
            f"`{name}` must be whole numbers, {low} to {high}, got {number:g}",
        )
    return np.array(numbers, dtype=np.int64)


def _index(name: str, values: Sequence[Any], names: Sequence[str]) -> IntArray:
    for value in values:
        check_choice(name, str(value), names)
    return np.array([list(names).index(str(value)) for value in values], dtype=np.int64)


class Assumption(NamedTuple):
    """What the victim assumes of the signals in one combination of world, grade and errors.

    `bias_sd` (n,) of the satellites' constant biases [m]; `noise_variance` (2n,) R;
    `epoch_variance` (2n,) what it assumes of one epoch alone; `assumed` errors of the signals, and
    `assumed_bias_sd` (n,) of their constants [m]; `victim` with the `grade` of its inertial
    sensors.
    """

    grade: str
    errors: GnssErrors
    bias_sd: FloatArray
    noise_variance: FloatArray
    epoch_variance: FloatArray
    assumed: GnssErrors
    assumed_bias_sd: FloatArray
    victim: TightlyCoupled


class Combination(NamedTuple):
    """One combination of world, grade and errors in which an episode takes place: what its sensors
    are, and what the victim assumes. `noise` of clock and inertial sensors; `noise_psd` (17,) of
    its states; `covariance` (17, 17) at the start; the others as in `Assumption`."""

    grade: ImuGrade
    errors: GnssErrors
    bias_sd: FloatArray
    noise_variance: FloatArray
    noise: NoiseModel
    noise_psd: FloatArray
    covariance: FloatArray
    assumed_grade: str


HELD_BYTES = 256e6  # size up to which worlds are held for setups to come, though none has them
_in_use: WeakValueDictionary[Any, GroundTruth] = WeakValueDictionary()
_held: dict[Any, GroundTruth] = {}  # the last two


def build_worlds(scenario: Scenario, domain: Domain) -> tuple[GroundTruth, int]:
    """All worlds of a domain, one after the other, and how many; setups alive share them."""
    if not domain.varies and domain.worlds is None and domain.pairs() == [(0.0, 0.0)]:
        return scenario.world(), 1
    skies = _list_skies(scenario, domain)
    if not isinstance(scenario.flight, str):
        return scenario.chained_world(skies), len(skies)
    key = scenario.bare, skies
    worlds = _held.pop(key, None) or _in_use.get(key) or scenario.bare.chained_world(skies)
    _in_use[key] = worlds
    if worlds.nbytes <= HELD_BYTES:
        _held[key] = worlds
        for old in list(_held)[:-2]:
            del _held[old]
    return worlds, len(skies)


def share_worlds(scenario: Scenario, domain: Domain, worlds: GroundTruth) -> None:
    """Let setups to come have worlds that came with a setup from another process."""
    if worlds.worlds > 1 and isinstance(scenario.flight, str):
        _in_use.setdefault((scenario.bare, _list_skies(scenario, domain)), worlds)


def _list_skies(scenario: Scenario, domain: Domain) -> tuple[tuple[float, Constellation], ...]:
    """Direction [deg] and satellites of every world."""
    base = scenario.constellation
    if not isinstance(base, CircularConstellation):
        raise ValueError(
            f"`domain` can move a CircularConstellation alone in time, got {type(base).__name__}"
        )
    return tuple(
        (turn, replace(base, time_offset_s=base.time_offset_s + time))
        for turn, time in domain.pairs()
    )


class Combinations:
    """All combinations of world, grade and errors. `epochs`: of an episode, which a matched
    receiver knows; `flown`: epochs of the flight that any episode may come to; `world`: all
    `worlds`, one after the other; `names`: of the grades, ``"imu"``, and of the errors,
    ``"errors"``."""

    def __init__(
        self,
        world: GroundTruth,
        worlds: int,
        scenario: Scenario,
        receiver: TightlyCoupled,
        domain: Domain,
        epochs: int,
        flown: int,
    ) -> None:
        self.world, self.worlds = world, worlds
        self.names = {"imu": domain.imu or (scenario.imu,), "errors": domain.errors or ("own",)}
        named = [ERRORS[name] for name in domain.errors]
        errors = named or [scenario.gnss_errors]
        assumed = named or [scenario.assumed_errors]
        self.drawn = (scenario.turn_on if domain.turn_on is None else domain.turn_on) == "drawn"
        self.wandering = scenario.in_run == "wandering"
        events = scenario.events if domain.events is None else domain.events
        self.events = events if events is not None and events.any else None
        self.with_signals = self.events is not None or any(each.signals for each in errors)
        self._grades = [IMU_GRADES[name] for name in self.names["imu"]]
        self.grades, self.errors = len(self._grades), len(errors)
        self._interval_s = scenario.epoch_interval_s
        self._step_s = float(world.epoch_time[1] - world.epoch_time[0])
        self._length, self._flown = epochs, flown
        self._turned = domain.turned_deg[0] < domain.turned_deg[1]
        grades = self.names["imu"]
        self.victims = [replace(receiver, grade=g) if domain.imu else receiver for g in grades]
        self._made: dict[int, Combination] = {}
        self._all = [
            self._assume(elevation, grade, victim, *errors_)
            for elevation in world.list_first_elevations()
            for grade, victim in zip(grades, self.victims, strict=True)
            for errors_ in zip(errors, assumed, strict=True)
        ]

    def _assume(
        self,
        elevation: FloatArray,
        grade: str,
        victim: TightlyCoupled,
        errors: GnssErrors,
        assumed: GnssErrors,
    ) -> Assumption:
        bias_sd, believed = errors.bias_sd(elevation), assumed.bias_sd(elevation)
        world = elevation, self._step_s, self._length
        variance = compute_assumed_variance(victim, assumed, believed, *world)
        single = variance
        if victim.matches:
            rates = np.full(len(bias_sd), assumed.rate_sd(self._step_s) ** 2)
            single = np.concatenate([assumed.epoch_variance(elevation), rates])
        return Assumption(grade, errors, bias_sd, variance, single, assumed, believed, victim)

    def index(
        self, world: NDArray[np.int64], grade: NDArray[np.int64], error: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """(b,) index, for `__getitem__`, of combinations of a `Choice`."""
        return (world * self.grades + grade) * self.errors + error

    @property
    def _model_alike(self) -> bool:
        """Whether one augmented filter fits all combinations."""
        first = self._all[0]
        return all(
            case.assumed == first.assumed
            and case.grade == first.grade
            and np.array_equal(case.assumed_bias_sd, first.assumed_bias_sd)
            for case in self._all
        )

    def signal_model(self, interval_s: float) -> SignalModel:
        """States of the signals of an augmented filter; a ValueError where combinations differ."""
        first = self._all[0]
        require(
            self._model_alike,
            "a receiver with `tuning` 'augmented' takes one grade of inertial sensors and "
            "one kind of errors, with the same constants in all worlds of the domain",
        )
        wandering = IMU_GRADES[first.victim.grade] if self.wandering else None
        return signal_model(first.assumed, first.assumed_bias_sd, interval_s, wandering)

    @cached_property
    def filter_model(self) -> FilterModel | None:
        """What a filter beside the victim's assumes, by the assumed errors and the victim's grade;
        None where combinations differ."""
        if not self._model_alike:
            return None
        first = self._all[0]
        victim = TightlyCoupled(grade=first.victim.grade, tuning="augmented")
        known = victim, first.assumed, first.assumed_bias_sd, np.zeros(0), self._step_s, 0
        variance = compute_assumed_variance(*known)
        noise = compute_assumed_noise(victim, first.assumed, self._step_s, Motion)
        return FilterModel(
            signals=self.signal_model(self._interval_s),
            noise_psd=victim.noise_psd(noise),
            noise_variance=variance,
            covariance=victim.initial_covariance(noise),
            grade=victim.grade,
        )

    def __getitem__(self, index: int) -> Combination:
        """One in a world that has been built."""
        if index not in self._made:
            self._made[index] = self._complete(index)
        return self._made[index]

    def _complete(self, index: int) -> Combination:
        given = self._all[index]
        world = self.world.at_hand.take(index // (self.grades * self.errors))  # its motion alone
        motion = partial(compute_motion, world, self._flown)
        belief = given.victim, given.assumed, self._step_s, motion, self.wandering
        noise, sheet = compute_assumed_noise(*belief), IMU_GRADES[given.grade]
        sheet = sheet._replace(  # the increments are quantized before they are summed up
            accel_quantization=sheet.accel_quantization / world.decimation,
            gyro_quantization=sheet.gyro_quantization / world.decimation,
        )
        psd, covariance = given.victim.noise_psd(noise), given.victim.initial_covariance(noise)
        errors = given.errors, given.bias_sd, given.noise_variance
        return Combination(sheet, *errors, noise, psd, covariance, given.victim.grade)

    @property
    def assume_alike(self) -> bool:
        """Whether a victim assumes the same noise in all combinations."""
        first = self._all[0]
        turned = self._turned and any(map(depends_on_motion, self.victims))
        return not turned and all(
            np.array_equal(case.noise_variance, first.noise_variance)
            and case.victim == first.victim
            and case.assumed == first.assumed
            for case in self._all
        )

    @property
    def sense_alike(self) -> bool:
        first = self._all[0]
        return not self.drawn and all(
            case.grade == first.grade and case.errors == first.errors for case in self._all
        )

    @property
    def largest_epoch_variance(self) -> FloatArray:
        return np.asarray(np.max([case.epoch_variance for case in self._all], axis=0))

    @property
    def largest_variance(self) -> FloatArray:
        return np.asarray(np.max([case.noise_variance for case in self._all], axis=0))

    def first_C_eb(self, grade: NDArray[np.int64], epochs: NDArray[np.int64]) -> FloatArray:
        """(b, 3, 3) attitudes, to ECEF from body axes, with which receivers start at `epochs`, with
        the first error of their grades."""
        turns = [euler_to_dcm(*(-np.radians(each.attitude_error_deg))) for each in self._grades]
        errors = np.array(turns)[grade]
        world = self.world.at_hand
        C_en, C_eb = world.C_en[epochs], world.C_eb[epochs]
        # the error turns the local axes: C_nb (estimated) = dC C_nb
        C_ne = np.ascontiguousarray(C_en.transpose(0, 2, 1))
        return np.asarray(C_en @ (errors.transpose(0, 2, 1) @ (C_ne @ C_eb)))
