"""Skies: worlds of one flight in several directions and at several times of the constellation, each
built when it is first needed.

What is known of all from the start is the little that receivers and detectors assume of them: which
slots there are, how many satellites are in view, and how high each is when it comes into view.  It
takes only the epochs at which a satellite is near the mask.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..earth.wgs84 import dcm_e_from_n, ecef_to_geodetic, look_angles
from .flight import Headings
from .run import (
    FloatArray,
    GroundTruth,
    build_world,
    fill_slots,
    find_epochs,
    look_along,
    see_satellites,
)
from .satellites import Constellation

MOTION = ("position_e", "velocity_e", "C_eb", "C_en")
AT_EPOCHS = ("epoch_time", "epoch_end", "satellites", "visible", *MOTION)
KNOWN = ("name", "satellite_ids", "imu_time", "epoch_time", "epoch_end", "decimation")
STRIDE = 8  # epochs between two looks at satellites that are far from the mask
MARGIN = 2.0  # by which a line of sight may turn faster between two looks than at them
_lock = threading.RLock()


def _renew_lock() -> None:
    """A forked process has no thread that would release it."""
    global _lock
    _lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_lock)


class Rules(NamedTuple):
    """Settings of `build_world`."""

    epoch_interval_s: float
    channels: int
    mask_deg: float


class SkyFacts(NamedTuple):
    """What is known of a world that has not been built: `satellite_ids` and `first_elevation` as of
    `GroundTruth`, `in_view` (K,) int8, and `geometry` (E, 4n) at `probe_epochs`."""

    satellite_ids: tuple[str, ...]
    first_elevation: FloatArray
    in_view: NDArray[np.int8]
    geometry: FloatArray


PROBES = 16


def probe_epochs(epochs: int) -> NDArray[np.int64]:
    return np.linspace(0, epochs - 1, PROBES).astype(np.int64)


def look_up(
    constellation: Constellation,
    time: FloatArray,
    position_e: FloatArray,
    channels: int,
    mask_deg: float,
) -> SkyFacts:
    """Facts of a world. `time` (K,) of its epochs [s]; `position_e` (K, 3) there [m]."""
    visible = find_visible(constellation, time, position_e, np.radians(mask_deg))
    chosen, ids, seen = fill_slots(constellation, time, visible, channels, mask_deg)
    first = np.argmax(seen, axis=0)[: len(chosen)]
    elevation, _, _ = _look(constellation, time[first], position_e[first])
    heights = np.full(channels, np.pi / 2)
    heights[: len(chosen)] = elevation[np.arange(len(chosen)), chosen]
    at = probe_epochs(len(time))
    places, C_en = np.zeros((PROBES, channels, 3)), _local_axes(position_e[at])
    places[:, : len(chosen)] = np.nan_to_num(constellation.states(time[at]).position_e[:, chosen])
    geometry = look_along(places, position_e[at], C_en, seen[at])
    return SkyFacts(ids, heights, seen.sum(axis=1).astype(np.int8), geometry)


def _local_axes(position_e: FloatArray) -> FloatArray:
    return np.ascontiguousarray(dcm_e_from_n(*ecef_to_geodetic(position_e)[:2]))


def _look(
    constellation: Constellation, time: FloatArray, position_e: FloatArray
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Elevation [rad], largest rate of it [rad/s], and whether it is known, (K, S) each."""
    states = constellation.states(time)
    elevation, _ = look_angles(states.position_e, position_e, _local_axes(position_e))
    distance = np.linalg.norm(states.position_e - position_e[:, None], axis=-1)
    speed = np.linalg.norm(states.velocity_e, axis=-1)
    return elevation, speed / distance, np.isfinite(distance) & np.isfinite(speed)


def find_visible(
    constellation: Constellation, time: FloatArray, position_e: FloatArray, mask: float
) -> NDArray[np.bool_]:
    """(K, S) whether satellites are above a mask [rad]; the vehicle is slow beside them."""
    some = np.unique([*range(0, len(time), STRIDE), len(time) - 1])
    elevation, rate, known = _look(constellation, time[some], position_e[some])
    above = known & (elevation > mask)
    apart = MARGIN * np.maximum(rate[1:], rate[:-1]) * np.diff(time[some])[:, None]
    far = known & (np.abs(elevation - mask) > np.vstack([apart, apart[-1:]]))
    certain = (far[:-1] & far[1:] & (above[:-1] == above[1:])) | ~(known[:-1] | known[1:])
    visible = np.repeat(above, np.diff([*some, len(time)]), axis=0)
    left = np.repeat(~certain.all(axis=1), np.diff(some))
    rows = np.flatnonzero(left)
    elevation, _, known = _look(constellation, time[rows], position_e[rows])
    visible[rows] = known & (elevation > mask)
    return visible


class _Recipe:
    """How each of some worlds is built. `runs`: which run of inertial samples each has, from 0 on;
    worlds in one direction have one."""

    def __init__(
        self,
        headings: Callable[[], Headings],
        places: Sequence[tuple[float, Constellation]],
        rules: Rules,
    ) -> None:
        self.headings, self.places, self.rules = headings, places, rules
        self.angles = list(dict.fromkeys(angle for angle, _ in places))
        self.runs = [self.angles.index(angle) for angle, _ in places]
        self._made: Headings | None = None

    def get_headings(self) -> Headings:
        self._made = self._made or self.headings()
        return self._made

    def find_facts(self) -> list[SkyFacts]:
        headings = self.get_headings()
        end = find_epochs(headings.time, self.rules.epoch_interval_s)
        time = headings.time[end]
        places = [headings.positions(angle)[end] for angle in self.angles]
        rules = self.rules.channels, self.rules.mask_deg
        return [
            look_up(constellation, time, places[run], *rules)
            for run, (_, constellation) in zip(self.runs, self.places, strict=True)
        ]

    def fly(self, w: int) -> GroundTruth:
        """World w, with a run of inertial samples of its own."""
        angle, constellation = self.places[w]
        trajectory = self.get_headings().trajectory(angle)
        return build_world(trajectory, constellation, **self.rules._asdict())

    def forget(self, built: Sequence[bool]) -> None:
        """Let go of the flight once all directions have been flown."""
        flown = {run for run, there in zip(self.runs, built, strict=True) if there}
        if len(flown) == len(self.angles):
            self._made = None

    def see(self, w: int, world: GroundTruth) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Satellites of world w, and which are visible, from a world with the same flight."""
        motion = world.epoch_time, world.position_e, world.velocity_e, world.C_en
        rules = self.rules.channels, self.rules.mask_deg
        return see_satellites(self.places[w][1], *motion, *rules)[1:]


class _Laid(GroundTruth):
    """Worlds one after the other, of which those that have been built are there."""

    _recipe: _Recipe
    _built: list[bool]
    _computed: dict[Any, Callable[[GroundTruth], FloatArray]]

    @property
    def worlds(self) -> int:
        return len(self._built)

    def build(self, worlds: Iterable[int]) -> None:
        for w in worlds:
            if not self._built[w]:
                with _lock:
                    if not self._built[w]:
                        self._fill(w)
                        self._built[w] = True
                        self._recipe.forget(self._built)

    def _rows(self, w: int) -> slice:
        each = self.epochs // self.worlds
        return slice(w * each, (w + 1) * each)

    def _fill(self, w: int) -> None:
        recipe, rows = self._recipe, self._rows(w)
        flown = recipe.runs[w]
        same = (v for v, built in enumerate(self._built) if built and recipe.runs[v] == flown)
        like = next(same, None)
        if like is None:
            world = recipe.fly(w)
            samples = world.run.shape[1]
            self.run[:, flown * samples : (flown + 1) * samples] = world.run
            satellites, visible = world.satellites, world.visible
        else:
            world = self.take(like)
            satellites, visible = recipe.see(w, world)
        for name in MOTION:
            getattr(self, name)[rows] = getattr(world, name)
        self.satellites[rows], self.visible[rows] = satellites, visible
        part = self.take(w)
        for key, compute in self._computed.items():
            self._tables[key][rows] = compute(part)

    def take(self, w: int) -> GroundTruth:
        views: dict[str, Any] = {name: getattr(self, name)[self._rows(w)] for name in AT_EPOCHS}
        first, samples = int(views["epoch_end"][0]), len(self.imu_time) - 1
        views["epoch_end"] = views["epoch_end"] - first
        views |= {name: getattr(self, name) for name in KNOWN if name not in AT_EPOCHS}
        return GroundTruth(**views, run=self.run[:, first : first + samples])

    def tabulate(
        self, key: Any, shape: tuple[int, ...], compute: Callable[[GroundTruth], FloatArray]
    ) -> FloatArray:
        with _lock:
            if key not in self._tables:
                self._tables[key] = table = np.zeros((self.epochs, *shape))
                self._computed[key] = compute
                for w in np.flatnonzero(self._built).tolist():
                    table[self._rows(w)] = compute(self.take(w))
        return self._tables[key]


class Skies(GroundTruth):
    """`GroundTruth` in which the epochs of some worlds follow one another. World w of K epochs each
    has the epochs ``w K`` to ``(w + 1) K - 1``. Times start again with each; nothing may cross from
    one to the next. An array that is read here has all worlds, which are built for that; those of
    `at_hand` only what `build` has been called for, the same to the last bit in any order.

    `headings`: of the flight; `places`: direction [rad] and satellites of each world; `rules`: as
    of `build_world`; `facts`: of the worlds, where they are known already.
    """

    _laid: _Laid
    _facts: Sequence[SkyFacts]

    def __init__(
        self,
        headings: Callable[[], Headings],
        places: Sequence[tuple[float, Constellation]],
        rules: Rules,
        facts: Sequence[SkyFacts] | None = None,
    ) -> None:
        recipe = _Recipe(headings, places, rules)
        self._set(_facts=recipe.find_facts() if facts is None else facts)
        self._set(_laid=_lay(recipe, self._facts))
        for name in KNOWN:
            self._set(**{name: getattr(self._laid, name)})

    def _set(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __getattr__(self, name: str) -> Any:
        if name not in GroundTruth.__dataclass_fields__ or "_laid" not in vars(self):
            raise AttributeError(name)
        self.build(range(self.worlds))
        return getattr(self._laid, name)

    def __reduce__(self) -> tuple[Any, ...]:
        recipe = self._laid._recipe
        return Skies, (recipe.headings, recipe.places, recipe.rules, self._facts)

    def __deepcopy__(self, memo: dict[int, Any]) -> Skies:
        return self

    @property
    def at_hand(self) -> GroundTruth:
        return self._laid

    @property
    def worlds(self) -> int:
        return self._laid.worlds

    @property
    def nbytes(self) -> int:
        return self._laid.nbytes

    @property
    def in_view(self) -> NDArray[np.integer[Any]]:
        return np.concatenate([each.in_view for each in self._facts])

    def build(self, worlds: Iterable[int]) -> None:
        self._laid.build(worlds)

    def take(self, w: int) -> GroundTruth:
        self.build([w])
        return self._laid.take(w)

    def probe(self) -> tuple[NDArray[np.int64], FloatArray]:
        epochs = probe_epochs(self.epochs // self.worlds)
        return epochs, np.array([each.geometry for each in self._facts])

    def list_first_elevations(self) -> FloatArray:
        return np.array([each.first_elevation for each in self._facts])

    def tabulate(
        self, key: Any, shape: tuple[int, ...], compute: Callable[[GroundTruth], FloatArray]
    ) -> FloatArray:
        self.build(range(self.worlds))
        return self._laid.tabulate(key, shape, compute)


def _lay(recipe: _Recipe, facts: Sequence[SkyFacts]) -> _Laid:
    """Memory of all worlds, none of which is built; most of it is taken when it is written to."""
    headings, rules = recipe.get_headings(), recipe.rules
    time, count, n = headings.time, len(recipe.places), rules.channels
    end = find_epochs(time, rules.epoch_interval_s)
    samples, each = len(time) - 1, len(end)
    ids = {fact.satellite_ids for fact in facts}
    starts = samples * np.repeat(np.array(recipe.runs, dtype=np.int64), each)
    shapes = {"satellites": (n, 8), "position_e": (3,), "velocity_e": (3,)}
    laid = _Laid(
        name=headings.name,
        satellite_ids=ids.pop() if len(ids) == 1 else tuple(f"slot{s:02d}" for s in range(n)),
        imu_time=time.copy(),
        run=np.zeros((8, len(recipe.angles) * samples)),
        epoch_time=np.tile(time[end], count),
        epoch_end=np.tile(end, count) + starts,
        visible=np.zeros((count * each, n), dtype=np.bool_),
        **{name: np.zeros((count * each, *shape)) for name, shape in shapes.items()},
        **{name: np.zeros((count * each, 3, 3)) for name in ("C_eb", "C_en")},
        decimation=headings.count,
    )
    object.__setattr__(laid, "_recipe", recipe)
    object.__setattr__(laid, "_built", [False] * count)
    object.__setattr__(laid, "_computed", {})
    return laid
