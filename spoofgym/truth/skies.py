"""Skies: worlds of one flight in several directions and at several times of the constellation, each
built piece by piece when it is first needed.

What is known of all from the start is which satellite has which slot, when each is visible, and how
high it is when it comes into view.  It takes only the epochs at which a satellite is near the mask.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..earth.wgs84 import dcm_e_from_n, ecef_to_geodetic, look_angles
from .flight import Headings
from .run import (
    Compute,
    FloatArray,
    GroundTruth,
    fill_slots,
    find_epochs,
    follow_flight,
    look_along,
    place_satellites,
)
from .satellites import Constellation

MOTION = ("position_e", "velocity_e", "C_eb", "C_en")
AT_EPOCHS = ("epoch_time", "epoch_end", "satellites", "visible", *MOTION)
KNOWN = ("name", "satellite_ids", "imu_time", "epoch_time", "epoch_end", "decimation")
PIECE_EPOCHS = 512  # of a world that are built together
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
    `GroundTruth`, `visible` (K, n), and `geometry` (E, 4n) at `probe_epochs`."""

    satellite_ids: tuple[str, ...]
    first_elevation: FloatArray
    visible: NDArray[np.bool_]
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
    return SkyFacts(ids, heights, seen, geometry)


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

    def fly(self, run: int) -> dict[str, FloatArray]:
        """`follow_flight` in the direction of a run."""
        headings = self.get_headings()
        end = find_epochs(headings.time, self.rules.epoch_interval_s)
        return follow_flight(headings.trajectory(self.angles[run]), end)

    def forget(self, flown: int) -> None:
        """Let go of the flight once all directions have been flown."""
        if flown == len(self.angles):
            self._made = None


class _Laid(GroundTruth):
    """Worlds one after the other, of which those pieces that have been built are there; where each
    satellite is visible is known of all."""

    _recipe: _Recipe
    _slots: list[list[int]]  # satellites of each world, by slot
    _flown: dict[int, int]  # world that has the motion of each run
    _moved: NDArray[np.bool_]  # (W,) worlds that have their motion
    _built: NDArray[np.bool_]  # (W, P) pieces that have their satellites
    _computed: dict[Any, Compute]

    @property
    def worlds(self) -> int:
        return len(self._built)

    @property
    def _each(self) -> int:
        return self.epochs // self.worlds

    def build(self, worlds: Iterable[int]) -> None:
        for w in worlds:
            self._fill(w, range(self._built.shape[1]))

    def build_epochs(self, first: NDArray[np.int64], last: NDArray[np.int64]) -> None:
        (w, begin), end = np.divmod(first, self._each), last % self._each
        begin, end = np.maximum(begin - 1, 0), np.minimum(end + 1, self._each - 1)
        spans = np.stack([w, begin // PIECE_EPOCHS, end // PIECE_EPOCHS], axis=1)
        for world, low, high in np.unique(spans, axis=0).tolist():
            self._fill(world, range(low, high + 1))

    def fly(self, worlds: Iterable[int]) -> None:
        """Have the motion of some worlds, all of it."""
        for w in worlds:
            if not self._moved[w]:
                with _lock:
                    if not self._moved[w]:
                        self._move(w)
                        self._moved[w] = True

    def _move(self, w: int) -> None:
        recipe, run, rows = self._recipe, self._recipe.runs[w], self._rows(w)
        if run in self._flown:
            like = self._rows(self._flown[run])
            motion = {name: getattr(self, name)[like] for name in MOTION}
        else:
            motion = recipe.fly(run)
            samples = motion["run"].shape[1]
            self.run[:, run * samples : (run + 1) * samples] = motion["run"]
        for name in MOTION:
            getattr(self, name)[rows] = motion[name]
        self._flown.setdefault(run, w)
        recipe.forget(len(self._flown))

    def _fill(self, w: int, pieces: Iterable[int]) -> None:
        if all(self._built[w, p] for p in pieces):
            return
        self.fly([w])
        with _lock:
            for p in pieces:
                if not self._built[w, p]:
                    part = self._view(self._rows(w, p))
                    states = self._recipe.places[w][1].states(part.epoch_time)
                    seen = part.visible, part.position_e, part.velocity_e
                    part.satellites[:] = place_satellites(states, self._slots[w], *seen)
                    for key in self._computed:
                        self._compute(key, w, p)
                    self._built[w, p] = True

    def _rows(self, w: int, piece: int | None = None) -> slice:
        """Epochs of a world, or of a piece of it."""
        first, last = w * self._each, (w + 1) * self._each
        if piece is None:
            return slice(first, last)
        begin = first + piece * PIECE_EPOCHS
        return slice(begin, min(begin + PIECE_EPOCHS, last))

    def _compute(self, key: Any, w: int, piece: int) -> None:
        rows = self._rows(w, piece)
        self._tables[key][rows] = self._computed[key](self._view(rows))

    def _view(self, rows: slice) -> GroundTruth:
        views: dict[str, Any] = {name: getattr(self, name)[rows] for name in AT_EPOCHS}
        views |= {name: getattr(self, name) for name in KNOWN if name not in AT_EPOCHS}
        return GroundTruth(**views, run=self.run)

    def take(self, w: int) -> GroundTruth:
        world = self._view(self._rows(w))
        first, samples = int(world.epoch_end[0]), len(self.imu_time) - 1
        run = self.run[:, first : first + samples]
        return replace(world, epoch_end=world.epoch_end - first, run=run)

    def tabulate(self, key: Any, shape: tuple[int, ...], compute: Compute) -> FloatArray:
        with _lock:
            if key not in self._tables:
                self._tables[key] = np.zeros((self.epochs, *shape))
                self._computed[key] = compute
                for w, piece in np.argwhere(self._built).tolist():
                    self._compute(key, w, piece)
        return self._tables[key]


class Skies(GroundTruth):
    """`GroundTruth` in which the epochs of some worlds follow one another. World w of K epochs each
    has the epochs ``w K`` to ``(w + 1) K - 1``. Times start again with each; nothing may cross from
    one to the next. An array that is read here has all worlds, which are built for that; those of
    `at_hand` only what `build` or `build_epochs` has been called for, the same to the last bit in
    any order.

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
        if name in ("run", *MOTION):
            self._laid.fly(range(self.worlds))
        elif name != "visible":
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

    def build(self, worlds: Iterable[int]) -> None:
        self._laid.build(worlds)

    def build_epochs(self, first: NDArray[np.int64], last: NDArray[np.int64]) -> None:
        self._laid.build_epochs(first, last)

    def take(self, w: int) -> GroundTruth:
        self.build([w])
        return self._laid.take(w)

    def probe(self) -> tuple[NDArray[np.int64], FloatArray]:
        epochs = probe_epochs(self.epochs // self.worlds)
        return epochs, np.array([each.geometry for each in self._facts])

    def list_first_elevations(self) -> FloatArray:
        return np.array([each.first_elevation for each in self._facts])

    def tabulate(self, key: Any, shape: tuple[int, ...], compute: Compute) -> FloatArray:
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
        visible=np.concatenate([fact.visible for fact in facts]),
        **{name: np.zeros((count * each, *shape)) for name, shape in shapes.items()},
        **{name: np.zeros((count * each, 3, 3)) for name in ("C_eb", "C_en")},
        decimation=headings.count,
    )
    number = [{name: j for j, name in enumerate(sky.satellite_ids)} for _, sky in recipe.places]
    slots = [
        [of[name] for name in fact.satellite_ids if name]
        for of, fact in zip(number, facts, strict=True)
    ]
    state = {
        "_recipe": recipe,
        "_slots": slots,
        "_flown": {},
        "_moved": np.zeros(count, dtype=np.bool_),
        "_built": np.zeros((count, -(-each // PIECE_EPOCHS)), dtype=np.bool_),
        "_computed": {},
    }
    for name, value in state.items():
        object.__setattr__(laid, name, value)
    return laid
