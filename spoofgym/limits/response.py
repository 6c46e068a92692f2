"""Response replay: verdicts of passive detectors on an attack, without the engine.

The innovations of a passive detector's victim are those of the clean run plus the response of the
closed loop, :math:`z + A u`, with the gains of the clean run.  So clean runs are recorded once, and
any open-loop attack is added to them and judged by the detector's own `judge`.  It is exact to
first order for detectors that leave the filter alone; for one that takes weight off measurements
the gains would change, and it is refused.

An attack whose errors are its own, such as a quiet one, has runs in which it is commanded nothing
in place of clean ones.  Runs of one sky and start share their response: one of them is computed.

Solution separation reads the filter's matrices, which makes its `judge` slow; its separations are
linear in the innovations, so that it judges every hat function once, and attacks are sums.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..core.children import release_free_memory
from ..core.memory import Memory
from ..detectors import Detector, DetectorContext, PooledDetector, SolutionSeparation, Verdict
from ..detectors.base import BoolArray, FloatArray, IntArray, check_needs, judge_epoch
from ..detectors.calibrated import unwrap
from ..receiver.epoch import ALWAYS, Epoch
from ..simulation._kernels import turn
from ..simulation.engine import available_threads
from ..simulation.monitors import PassiveDetectors
from ..simulation.setup import make_generators
from ..simulation.tight import TightlyCoupledSetup
from .linear import (
    LinearRun,
    get_rate_limits,
    hat_functions,
    observer,
    record,
    respond,
    unit_commands,
    unused_seed,
)

HATS = 40  # hat functions of the rate by which the response is known, over the attack window
UNKNOWN_RESPONSES = {"gnss_position", "auxiliary_position", "cn0_dbhz"}
MATRICES = {"transition", "predicted_cov", "design", "innovation_cov"}
"""Fields that are stored in single precision, as the responses are."""
SYMMETRIC = {"predicted_cov", "innovation_cov"}  # of which the lower triangles are stored
RUNS_AT_ONCE = 8  # whose matrices are held in memory together
SEPARATED_AT_ONCE = 64  # runs and attacks whose separations are judged together
JUDGED_AT_ONCE = 576  # runs and attacks that other detectors judge together


class Replayed(NamedTuple):
    """P attacks on N runs.

    - `first_alarm` (P, N) epoch from 1 on; 0 for none;
    - `peak` (P, N) largest ratio of statistic to threshold in the judged window;
    - `error` (K, P, N) induced horizontal error, a distance [m].
    """

    first_alarm: IntArray
    peak: FloatArray
    error: FloatArray


class LinearBank(NamedTuple):
    """A bank of solutions over the K epochs of N runs, whose statistic is a largest square.

    - `clean` (N, K, J, 2) whitened separations without an attack, in units of the threshold's root;
    - `units` (G, K J 2, Q) their change by hat functions of the rate along the target direction, of
      one run of each group with the same response and direction; `group` (N,) of the runs.
    """

    clean: FloatArray
    units: NDArray[np.float32]
    group: NDArray[np.intp]

    def judge(
        self, attacks: FloatArray, rows: NDArray[np.intp], scale: FloatArray | None = None
    ) -> Iterator[tuple[int, NDArray[np.float32]]]:
        """For each run in `rows` (r,), where it stands there, and its (K, P) largest squares under
        attacks (Q, P), times the run's `scale` (r,)."""
        coefficients = attacks.astype(np.float32)
        for group in np.unique(self.group[rows]).tolist():
            moved = self.units[group] @ coefficients
            moved = moved.reshape(*self.clean.shape[1:], -1)  # (K, J, 2, P)
            for at in np.flatnonzero(self.group[rows] == group).tolist():
                own = moved if scale is None else moved * np.float32(scale[at])
                own = own + self.clean[rows[at]][..., None]
                yield at, np.square(own).sum(axis=2).max(axis=1)


class NotReplayable(ValueError):
    """A detector or an attack whose response is not linear."""


def check_replayable(detector: Detector) -> None:
    inner = unwrap(detector)
    if isinstance(inner, PooledDetector):
        for member in inner.judges:
            check_replayable(member)
    unknown = sorted(UNKNOWN_RESPONSES & check_needs(detector))
    if unknown:
        raise NotReplayable(
            f"{type(inner).__name__} looks at {', '.join(unknown)}, whose response to an attack is "
            "not linear: play it on the engine"
        )


def judge_passive(detector: Detector, epoch: Epoch) -> Verdict:
    verdict = judge_epoch(detector, epoch)
    if verdict.weights is not None:
        raise NotReplayable(
            f"{type(unwrap(detector)).__name__} takes weight off measurements, which changes "
            "the gains of the filter: play it on the engine"
        )
    return verdict


def shorten(name: str, array: NDArray[Any]) -> NDArray[Any]:
    """Copy of a field of an epoch (B, ...), as it is stored."""
    if name in SYMMETRIC:
        array = array[(slice(None), *np.tril_indices(array.shape[-1]))]
    return np.array(array, dtype=np.float32 if name in MATRICES else array.dtype)


def unpack_symmetric(triangles: NDArray[np.float32]) -> NDArray[np.float32]:
    """(B, n, n) of lower triangles (B, n (n + 1) / 2), row by row."""
    n = math.isqrt(2 * triangles.shape[1])
    row, column = np.indices((n, n))
    low, high = np.minimum(row, column), np.maximum(row, column)
    return triangles[:, high * (high + 1) // 2 + low]


class _Watch(PassiveDetectors):
    """Detectors that are to be replayed, over the warm-up."""

    judge = staticmethod(judge_passive)


class LinearReplay:
    """Clean runs, and the responses of their filters to hat functions of the rate.

    A subclass sets what they are:

    - `detectors` (D,) passive ones, with their memory at the onset; `needs` fields that they read;
      `warmup_alarm` (D, N) alarms before it;
    - `runs` N, `epochs` K from the onset to the end of the time to alert, of which the first
      `attack_epochs` have `steps` decisions; `limits` of the rate and of its change between them;
    - `heading` (N,) of the false position [rad]; `hats` (steps, Q); `group` (N,) of runs that share
      a response in `_units`; `_epochs` fields of (N, ...) by name, one for each epoch.
    """

    detectors: Sequence[Detector]
    needs: frozenset[str]
    warmup_alarm: BoolArray
    runs: int
    epochs: int
    attack_epochs: int
    steps: int
    limits: tuple[float, float]
    heading: FloatArray
    hats: FloatArray
    group: IntArray
    threads: int
    judge = staticmethod(judge_passive)
    _context: DetectorContext
    _epochs: Mapping[str, Sequence[NDArray[Any]]]
    _banks: dict[tuple[int, bytes], LinearBank]
    _units: list[dict[str, NDArray[np.float32]]]

    def _add_unit(self, run: LinearRun, offsets: FloatArray) -> None:
        """Add the response of one run to (K, m, 2 Q) `offsets` by hat function, those north
        first."""
        found = respond(run, offsets)._asdict()
        found["position"] = found["position"][:, :2]
        if self.needs & {"pseudorange", "range_rate"}:
            found["offset"] = offsets
        self._units.append({name: array.astype(np.float32) for name, array in found.items()})

    def _coefficients(self, rates: FloatArray) -> FloatArray:
        """(Q, P) of the hat functions that come nearest to rates."""
        return np.asarray(np.linalg.lstsq(self.hats, rates.T, rcond=None)[0])

    def sums(self, number: int) -> bool:
        """Whether attacks on a detector are sums of what hat functions do, and not judged."""
        return isinstance(unwrap(self.detectors[number]), SolutionSeparation)

    def play(
        self,
        number: int,
        rates: FloatArray,
        *,
        rows: NDArray[np.intp] | None = None,
        scale: FloatArray | float = 1.0,
    ) -> Replayed:
        """Let one of the detectors judge P attacks on some runs, all by default. `rates` (P,
        decisions) along each run's target direction [m/s]; `scale`: factor for each run."""
        rows = np.arange(self.runs) if rows is None else rows
        each = np.broadcast_to(np.asarray(scale, dtype=np.float64), rows.shape)
        one = self._play_bank if self.sums(number) else self._play
        if self.sums(number):
            self.find_bank(number)  # once, before threads use it
        parts = np.array_split(rates, min(self.threads, len(rates)))
        if len(parts) == 1:
            return one(number, rates, rows, each)
        with ThreadPoolExecutor(len(parts)) as pool:
            found = list(pool.map(lambda part: one(number, part, rows, each), parts))
        return Replayed(
            np.concatenate([part.first_alarm for part in found]),
            np.concatenate([part.peak for part in found]),
            np.concatenate([part.error for part in found], axis=1),
        )

    def _play(
        self, number: int, rates: FloatArray, rows: NDArray[np.intp], scale: FloatArray
    ) -> Replayed:
        count = min(math.ceil(len(rates) * len(rows) / JUDGED_AT_ONCE), len(rows))
        if count > 1:  # which changes no bits, as other attacks beside them might
            some = zip(np.array_split(rows, count), np.array_split(scale, count), strict=True)
            parts = [self._play(number, rates, *each) for each in some]
            return Replayed(*(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True)))
        moved, error = self.compute_shifts(rates, rows, check_needs(self.detectors[number]))
        if not np.all(scale == 1.0):
            moved = {name: array * scale[:, None] for name, array in moved.items()}
        first = np.zeros(len(rates) * len(rows), dtype=np.int64)
        peak = np.zeros(len(first))
        for k, (_, verdict) in enumerate(self._judge_epochs(number, moved, rows, len(rates))):
            np.maximum(peak, (verdict.statistic / verdict.threshold).max(axis=1), out=peak)
            first[verdict.alarm.any(axis=1) & (first == 0)] = k + 1
        shape = len(rates), len(rows)
        return Replayed(first.reshape(shape), peak.reshape(shape), error * scale)

    def _play_bank(
        self, number: int, rates: FloatArray, rows: NDArray[np.intp], scale: FloatArray
    ) -> Replayed:
        bank, attacks = self.find_bank(number), self._coefficients(rates)
        shape = len(rates), len(rows)
        first, peak = np.zeros(shape, dtype=np.int64), np.zeros(shape)
        for at, ratio in bank.judge(attacks, rows, scale):
            peak[:, at] = ratio.max(axis=0)
            above = ratio > 1.0
            first[:, at] = np.where(above.any(axis=0), above.argmax(axis=0) + 1, 0)
        return Replayed(first, peak, self.errors(rates, rows) * scale)

    def find_bank(self, number: int) -> LinearBank:
        """Separations of a detector that is judged by sums, of all runs along their headings."""
        key = number, self.heading.tobytes()
        if key not in self._banks:
            pairs = np.stack([self.group, self.heading], axis=1)
            _, ones, group = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
            nothing, hats = np.zeros((1, len(self.hats))), self.hats.T
            parts = [*self._whiten(number, nothing, np.arange(self.runs))]
            clean, done = np.concatenate(parts, axis=1)[0], 0
            units = np.empty((len(ones), clean[0].size, len(hats)), dtype=np.float32)
            for found in self._whiten(number, hats, ones):
                rows = slice(done, done := done + found.shape[1])
                change = (found - clean[ones[rows]]).transpose(1, 2, 3, 4, 0)
                units[rows] = change.reshape(-1, *units.shape[1:])
            self._banks[key] = LinearBank(clean, units, group.ravel())
        return self._banks[key]

    def _whiten(
        self, number: int, rates: FloatArray, rows: NDArray[np.intp]
    ) -> Iterator[FloatArray]:
        """(P, N, K, J, 2) whitened separations under attacks, of some runs at a time."""
        count = math.ceil(len(rows) * len(rates) / SEPARATED_AT_ONCE)
        parts = np.array_split(rows, min(count, len(rows)))
        with ThreadPoolExecutor(self.threads) as pool:
            yield from pool.map(lambda rows: self._whiten_some(number, rates, rows), parts)

    def _whiten_some(self, number: int, rates: FloatArray, rows: NDArray[np.intp]) -> FloatArray:
        moved, _ = self.compute_shifts(rates, rows, check_needs(self.detectors[number]))
        judged = self._judge_epochs(number, moved, rows, len(rates))
        stored = []
        for k, (detector, verdict) in enumerate(judged):
            inner = cast(SolutionSeparation, unwrap(detector))
            place = np.tile(self._epochs["predicted_position"][k][rows], (len(rates), 1))
            size = np.sqrt(verdict.threshold[:, :, None])
            stored.append((inner.whiten(place) / size).reshape(len(rates), len(rows), -1, 2))
        return np.ascontiguousarray(np.array(stored).transpose(1, 2, 0, 3, 4))

    def compute_shifts(
        self, rates: FloatArray, rows: NDArray[np.intp], needs: frozenset[str]
    ) -> tuple[dict[str, FloatArray], FloatArray]:
        """What attacks add to the fields that a detector reads, and the induced horizontal errors.
        (K, P, N or 1, x) by name, one row for all runs where they have one sky and one heading; (K,
        P, N) [m]."""
        heading, group = self.heading[rows], self.group[rows]
        alike = len(self._units) == 1 and bool(np.all(heading == heading[0]))
        some = 1 if alike else len(rows)
        aim = np.stack([np.cos(heading), np.sin(heading)], axis=1)[:some]
        u, count = self._coefficients(rates), self._epochs["visible"][0].shape[1]
        changed = {  # to first order, as far as a detector can see: part of a response, and rows
            "innovation": ("innovation", slice(None)),
            "pseudorange": ("offset", slice(0, count)),
            "range_rate": ("offset", slice(count, None)),
            "predicted_position": ("predicted", slice(0, 3)),
            "predicted_velocity": ("predicted", slice(3, 6)),
        }
        moved = {
            name: self._along(part, where, u, group[:some], aim)
            for name, (part, where) in sorted(changed.items())
            if name in ALWAYS | needs
        }
        return moved, self.errors(rates, rows)

    def respond_positions(self, rows: NDArray[np.intp]) -> FloatArray:
        """(N, K, 2, Q) induced errors north and east of runs by hat function [m]."""
        aim = np.stack([np.cos(self.heading[rows]), np.sin(self.heading[rows])], axis=1)
        each = np.eye(self.hats.shape[1])
        found = self._along("position", slice(0, 2), each, self.group[rows], aim)
        return found.transpose(2, 0, 3, 1)

    def errors(self, rates: FloatArray, rows: NDArray[np.intp]) -> FloatArray:
        """Induced horizontal errors (K, P, N) of attacks [m], `rates` as of `play`."""
        aim = np.stack([np.cos(self.heading[rows]), np.sin(self.heading[rows])], axis=1)
        group, u = self.group[rows], self._coefficients(rates)
        position = self._along("position", slice(0, 2), u, group, aim)
        return np.asarray(np.hypot(position[..., 0], position[..., 1]))

    def _along(
        self, part: str, where: slice, u: FloatArray, group: NDArray[np.intp], aim: FloatArray
    ) -> FloatArray:
        """(K, P, N, x) part of the responses to `u` (Q, P), of runs by their groups and aims."""
        hats, attacks = u.shape
        out: FloatArray | None = None
        for g in np.unique(group).tolist():
            unit = self._units[g][part][:, where]  # (K, x, 2Q)
            both = (unit.reshape(-1, 2, hats) @ u).reshape(*unit.shape[:2], 2, attacks)
            if out is None:
                out = np.empty((len(unit), attacks, len(aim), unit.shape[1]))
            both = np.ascontiguousarray(both.transpose(0, 3, 2, 1))  # (K, P, 2, x)
            turn(both, aim, np.flatnonzero(group == g), out)
        assert out is not None  # there is at least one run
        return out

    def _judge_epochs(
        self, number: int, moved: dict[str, FloatArray], rows: NDArray[np.intp], attacks: int
    ) -> Iterator[tuple[Detector, Verdict]]:
        """A copy of a detector, and its verdicts epoch by epoch: of all runs, attack by attack."""
        source, everyone = self.detectors[number], np.tile(rows, attacks)
        detector = copy.deepcopy(source, {id(source.memory): Memory()})  # which `bind` makes
        detector.bind(self._context._replace(receivers=len(everyone)))
        detector.memory.copy_rows(np.arange(len(everyone)), source.memory, everyone)
        buffers: dict[str, NDArray[Any]] = {}
        for k in range(self.epochs):
            arrays = {}
            for name in ALWAYS | detector.needs:
                array = self._epochs[name][k][rows]
                if name in SYMMETRIC:
                    array = unpack_symmetric(array)
                if name not in buffers:
                    dtype = np.float64 if name in MATRICES else array.dtype
                    buffers[name] = np.empty((attacks, *array.shape), dtype=dtype)
                out = buffers[name]
                if name in moved:
                    np.add(array, moved[name][k], out=out)
                else:
                    out[:] = array
                arrays[name] = out.reshape(-1, *array.shape[1:])
            yield detector, self.judge(detector, Epoch(**arrays))


class Replay(LinearReplay):
    """Clean runs of a world, and the responses of their filters.

    Parameters
    ----------
    setup : TightlyCoupledSetup
        World, attack, timeline and target direction; its detector is not used.
    detectors : sequence of Detector
        Passive ones, in one list so that they share the runs; copied.
    seeds : sequence of SeedSequence
        Of the runs.
    threads : int, optional
        That judge attacks; all useful cores by default.
    given : mapping, optional
        Circumstances that are not to be drawn, as of a reset, one value a run.

    Attributes
    ----------
    runs, epochs : int
        N, and K, from the onset to the end of the time to alert.
    warmup_alarm : ndarray
        (D, N) bool, alarms before the onset.
    onset_ratio : ndarray
        (D, N) largest statistics over thresholds at the last epoch before the onset.

    Raises
    ------
    NotReplayable
        When a detector de-weights, or looks at what is not linear.
    """

    def __init__(
        self,
        setup: TightlyCoupledSetup,
        detectors: Sequence[Detector],
        seeds: Sequence[np.random.SeedSequence],
        *,
        threads: int | None = None,
        given: Mapping[str, Sequence[Any]] | None = None,
    ) -> None:
        self.setup, self.runs, self.given = setup, len(seeds), given or {}
        self.steps, self.limits = setup.steps // setup.repeat, get_rate_limits(setup)
        self.attack_epochs = setup.steps
        self._banks = {}
        self.threads = available_threads(10**9) if threads is None else threads
        for each in detectors:
            check_replayable(each)
        self.needs = frozenset().union(*map(check_needs, detectors))
        self._record(detectors, seeds)
        self._respond(seeds)
        release_free_memory()

    def _record(
        self, detectors: Sequence[Detector], seeds: Sequence[np.random.SeedSequence]
    ) -> None:
        simulator = observer(self.setup, self.runs, self.needs, [_Watch(detectors)])
        world = simulator.setup
        simulator.warm_up(make_generators(seeds), self.given)
        self._context = simulator._context()
        watch = simulator.monitor(_Watch)
        self.detectors, self.warmup_alarm = watch.detectors, watch.memory["alarmed"].T.copy()
        self.onset_ratio = watch.memory["ratio"].T.copy()
        self.onset, self.heading = simulator.onset.copy(), simulator.heading.copy()
        self.first = simulator.memory["first"].copy()
        self.sky = self.onset // world.epochs_each
        self._combination = simulator.memory["combination"].copy()
        stored: dict[str, list[NDArray[Any]]] = {}
        idle = simulator.advance if world.attack.idle_is_clean else lambda: simulator.predict(None)
        for _ in range(world.steps + world.hold):
            epoch = idle()
            for name, array in epoch._asdict().items():
                if array is not None:
                    stored.setdefault(name, []).append(shorten(name, array))
            simulator.update(None)
        self._epochs, self.epochs = stored, len(stored["time"])

    def _respond(self, seeds: Sequence[np.random.SeedSequence]) -> None:
        """Responses to hat functions of the rate, once for all runs of a sky, start, age, sensors
        and view."""
        views: dict[bytes, int] = {}
        seen = np.array(self._epochs["visible"]).transpose(1, 0, 2)
        circumstances = zip(self.first, self.onset, self._combination, seen, strict=True)
        keys = [b"".join(part.tobytes() for part in each) for each in circumstances]
        self.group = np.array([views.setdefault(key, len(views)) for key in keys])
        ones = [int(np.flatnonzero(self.group == g)[0]) for g in range(len(views))]
        self.hats = hat_functions(self.steps, HATS)
        self._units = []
        for at in range(0, len(ones), RUNS_AT_ONCE):
            part = ones[at : at + RUNS_AT_ONCE]
            again = make_generators([unused_seed(seeds[b]) for b in part])
            given = {name: [values[b] for b in part] for name, values in self.given.items()}
            for b, run in zip(part, record(self.setup, again, given), strict=True):
                offsets = self._offsets(int(self.onset[b])) * np.tile(run.visible, 2)[:, :, None]
                self._add_unit(run, offsets)

    def _offsets(self, onset: int) -> FloatArray:
        """(K, m, 2 Q) offsets of the measurements by hat function, those north first."""
        commands = unit_commands(self.setup, onset, HATS)
        if commands.heading is None or not np.array_equal(commands.heading, np.eye(2)):
            raise NotReplayable(
                "the replay moves a false position north and east, and "
                f"{self.setup.attack.label!r} commands {', '.join(self.setup.action_names)}"
            )
        if np.any(commands.idle):
            raise NotReplayable(
                f"{self.setup.attack.label!r} changes the measurements without a command"
            )
        return np.concatenate([commands.offsets[:, :, axis::2] for axis in (0, 1)], axis=2)
