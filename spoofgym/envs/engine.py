"""The engine: B receivers in step, and one epoch in two halves."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from ..attacks import AttackContext
from ..detectors import Detector, DetectorContext, PooledDetector, Verdict
from ..receiver import _kernels
from ..receiver.epoch import Epoch, epoch_view
from ..receiver.state import LANES, ReceiverBuffers
from ..sim.noise import padded
from ..sim.sensors import SOURCES, SensorBuffers
from .domain import draw, told
from .prefetch import STOCK, NextEpisodes
from .setup import Setup, check_settles
from .witness import Witness
from .workers import Workers

FloatArray = NDArray[np.float64]
T = TypeVar("T")
W = TypeVar("W", bound=Witness)
RECEIVERS_PER_THREAD = 16
KEPT = 8
"""Largest size of the batches that are kept for the time to alert of a few receivers."""
PIECE = 64
"""Epochs of single receivers that are run between two chances to wait: less than a millisecond."""


class Batch:
    """Some receivers that go through their episodes in step with one another.

    Parameters
    ----------
    setup : Setup
        What all batches share.
    receivers : int
        B.
    run : callable
        ``run(f, B)`` calls ``f(lo, hi)`` over slices of the receivers, possibly in threads.

    Attributes
    ----------
    clean : ndarray or None
        (B,) bool, receivers whose measurements the attack leaves alone, whatever it is commanded;
        None for none.
    """

    def __init__(
        self, setup: Setup, receivers: int, run: Callable[[Callable[[int, int], None], int], None]
    ) -> None:
        self.setup, self.receivers, self._run = setup, receivers, run
        world = setup.world
        self.buffers = ReceiverBuffers(receivers, world.channels, world.most_samples)
        self.sensors = SensorBuffers(receivers, world.channels)
        self._imu_noise = padded(6 * world.most_samples)
        self._gnss_noise = padded(2 * world.channels)
        self.epoch: Epoch = epoch_view(self.buffers)
        self.ones = np.ones((receivers, 2 * world.channels))
        self.weights = self.ones
        self.verdict: Verdict | None = None
        self._action: FloatArray | None = None
        self.clean: NDArray[np.bool_] | None = None
        self.memory = Memory(receivers)
        for name in ("first", "onset", "case"):
            self.memory.declare(name, np.zeros(receivers, dtype=np.int64))
        self.memory.declare("heading", np.zeros(receivers))
        self.attack = copy.deepcopy(setup.attack)
        self.attack.bind(AttackContext(receivers, world))
        self.detector = copy.deepcopy(setup.detector)
        self.bind_detector(self.detector)
        self.witnesses = [copy.deepcopy(witness) for witness in setup.witnesses]
        for witness in self.witnesses:
            witness.bind(self)

    def bind_detector(self, detector: Detector) -> None:
        """Bind a detector to these receivers."""
        setup = self.setup
        detector.bind(
            DetectorContext(
                self.receivers,
                setup.world.channels,
                setup.scenario.epoch_interval_s,
                setup.cases.largest_variance,
                setup.world.satellite_ids,
            )
        )
        check_settles(detector, setup.live + setup.steps + setup.hold)

    def witness(self, kind: type[W]) -> W:
        """Witness of a kind."""
        for witness in self.witnesses:
            if isinstance(witness, kind):
                return witness
        raise LookupError(f"no {kind.__name__} looks at these epochs")

    def __getstate__(self) -> dict[str, Any]:
        """State without the view of the epoch, which a copy makes anew of its own buffers."""
        return {name: value for name, value in self.__dict__.items() if name != "epoch"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the state, and view the epoch."""
        self.__dict__.update(state)
        self.epoch = epoch_view(self.buffers)

    @property
    def epochs(self) -> NDArray[np.int64]:
        """(B,) the epoch of the world that each receiver is at."""
        return self.sensors.epoch

    @property
    def onset(self) -> NDArray[np.int64]:
        """(B,) the epoch of the world after which each receiver's attack begins."""
        onset: NDArray[np.int64] = self.memory["onset"]
        return onset

    @property
    def heading(self) -> FloatArray:
        """(B,) direction in which displacement counts, clockwise from north [rad]."""
        heading: FloatArray = self.memory["heading"]
        return heading

    def begin(
        self, rngs: Sequence[np.random.Generator], given: Mapping[str, Any] | None = None
    ) -> None:
        """Begin a new episode in every receiver: errors, first fix, attitude, empty memories."""
        setup, b = self.setup, self.receivers
        rows = np.arange(b)
        self.sensors.draw_keys(rows, rngs)
        grade = self._settle(given)
        self.attack.memory.reset()
        spoofer_keys = self.sensors.keys[SOURCES.index("spoofer")]
        self.attack.begin(rows, spoofer_keys, self.onset)
        self.detector.reset()
        if isinstance(self.detector, PooledDetector):
            self.detector.draw(self.sensors.keys[SOURCES.index("domain")])
        for witness in self.witnesses:
            witness.begin()
        self._begin_cases()
        self._measure_first()
        first = self.memory["first"]
        _kernels.first_fix(
            self.buffers.floats,
            self.buffers.flags,
            setup.world.position_e[first],
            b,
            setup.world.channels,
            0,
            b,
        )
        state = self.buffers.state
        state.C_eb[:] = setup.cases.first_C_eb(grade, first)
        state.accel_bias_b[:] = 0.0
        state.gyro_bias_b[:] = 0.0
        self.verdict, self.weights = None, self.ones

    def _settle(self, given: Mapping[str, Any] | None) -> NDArray[np.int64]:
        """Choose the circumstances of new episodes; (B,) their grades."""
        setup, bounds = self.setup, self.setup.bounds
        choice = draw(bounds, self.sensors.keys[SOURCES.index("domain")])
        if given:
            interval = setup.scenario.epoch_interval_s
            choice = told(given, choice, bounds, setup.cases.names, interval)
        first = choice.world * setup.epochs_each + choice.start
        self.sensors.epoch[:] = first
        self.memory["first"][:] = first
        self.memory["onset"][:] = first + setup.onset
        self.memory["case"][:] = setup.cases.index(choice.world, choice.grade, choice.error)
        self.memory["heading"][:] = choice.heading
        return choice.grade

    def _begin_cases(self) -> None:
        """Draw the errors, and tell the victims what they assume."""
        cases = self.memory["case"]
        state, measured = self.buffers.state, self.buffers.measured
        for index in np.unique(cases).tolist():
            case, rows = self.setup.cases[index], np.flatnonzero(cases == index)
            self.sensors.begin(rows, case.grade, case.errors, case.bias_sd)
            measured.noise_variance[rows] = case.noise_variance
            self.buffers.noise_psd[rows] = case.noise_psd
            state.covariance[rows] = case.covariance

    def _measure_first(self) -> None:
        world, buffers, sensors = self.setup.world, self.buffers, self.sensors
        _kernels.measure(
            sensors.floats,
            sensors.keys,
            sensors.epoch,
            buffers.floats,
            buffers.flags,
            buffers.block,
            buffers.samples,
            world.run,
            world.epoch_time,
            world.epoch_end,
            world.satellites,
            self.receivers,
            world.channels,
            self._imu_noise,
            self._gnss_noise,
            0,
            0,
            self.receivers,
        )

    def _epochs(self, what: int, count: int, lo: int, hi: int) -> None:
        buffers, sensors = self.buffers, self.sensors
        world, receiver = self.setup.world, self.setup.receiver
        _kernels.run_epochs(
            buffers.floats,
            buffers.flags,
            buffers.block,
            buffers.samples,
            self.weights,
            sensors.floats,
            sensors.keys,
            sensors.epoch,
            world.run,
            world.epoch_time,
            world.epoch_end,
            world.satellites,
            self.receivers,
            world.channels,
            self._imu_noise,
            self._gnss_noise,
            receiver.covariance_code,
            receiver.min_satellites,
            receiver.orthonormalize,
            what,
            count,
            lo,
            hi,
        )

    def _advance(self, lo: int, hi: int) -> None:
        self._epochs(_kernels.MEASURE + _kernels.PREDICT, 1, lo, hi)

    def _update(self, lo: int, hi: int) -> None:
        self._epochs(_kernels.UPDATE, 1, lo, hi)

    def _attack_and_advance(self, lo: int, hi: int) -> None:
        sensors = self.sensors.state
        self.attack.command(
            self._action, self.epochs, sensors.range_offset, sensors.rate_offset, lo, hi
        )
        if self.attack.replaces_errors:
            sensors.authentic[lo:hi] = self.attack.memory["authentic"][lo:hi]
        if self.clean is not None:
            spared = lo + np.flatnonzero(self.clean[lo:hi])
            sensors.range_offset[spared] = sensors.rate_offset[spared] = 0.0
            sensors.authentic[spared] = 1.0
        self._advance(lo, hi)

    def advance(self) -> Epoch:
        """First half of a clean epoch: measure, mechanize, predict, form the innovation."""
        self._run(self._advance, self.receivers)
        return self.epoch

    def advance_attacked(self, action: FloatArray | None) -> Epoch:
        """First half of an epoch under attack.

        `action` (B, a) in [-1, 1], C-contiguous; None holds the present rate.
        """
        self._action = action
        self._run(self._attack_and_advance, self.receivers)
        return self.epoch

    def judge(self) -> Verdict:
        """Let the detector judge the epoch."""
        self.verdict = self.detector.judge(self.epoch)
        for witness in self.witnesses:
            witness.see(self)
        return self.verdict

    def update(self, weights: FloatArray | None) -> None:
        """Second half of an epoch: the update with the weighted gain.

        `weights` (B, 2n) in [0, 1], C-contiguous; None for all 1.
        """
        self.weights = self.ones if weights is None else weights
        self._run(self._update, self.receivers)

    def quiet_epochs(self, count: int, *, between: Callable[[], None] | None = None) -> None:
        """Run clean epochs without a detector."""
        self.weights = self.ones
        what = _kernels.MEASURE + _kernels.PREDICT + _kernels.UPDATE
        piece = count if between is None else max(1, PIECE // self.receivers)
        for begun in range(0, count, max(piece, 1)):
            if between is not None:
                between()
            self._run(partial(self._epochs, what, min(piece, count - begun)), self.receivers)

    def live_epochs(
        self,
        count: int,
        *,
        holding: bool = False,
        between: Callable[[], None] | None = None,
    ) -> NDArray[np.bool_]:
        """Run epochs with the detector, without new commands.

        Returns (count, B) bool, whether any channel alarmed.
        """
        self._action = None
        first = self._attack_and_advance if holding else self._advance

        def onwards(lo: int, hi: int) -> None:
            """Update of one epoch, and measurements of the next."""
            self._update(lo, hi)
            first(lo, hi)

        alarms = np.zeros((count, self.receivers), dtype=np.bool_)
        for k in range(count):
            if between is not None:
                between()
            self._run(onwards if k else first, self.receivers)
            verdict = self.judge()
            alarms[k] = verdict.alarm.any(axis=1)
            self.weights = self.ones if verdict.weights is None else verdict.weights
        if count:
            self._run(self._update, self.receivers)
        return alarms

    def copy_rows(self, to: NDArray[np.intp], other: Batch, rows: NDArray[np.intp]) -> None:
        """Take over receivers of another batch, with all that they remember.

        `to`: rows of this batch that are overwritten.
        """
        pairs: list[tuple[Any, Any]] = [
            (self.buffers.state, other.buffers.state),
            (self.buffers.measured, other.buffers.measured),
            (self.sensors.state, other.sensors.state),
        ]
        for mine, theirs in pairs:
            for target, source in zip(mine, theirs, strict=True):
                target[to] = source[rows]
        self.buffers.noise_psd[to] = other.buffers.noise_psd[rows]
        self.buffers.block[:, to] = other.buffers.block[:, rows]
        self.sensors.keys[:, to] = other.sensors.keys[:, rows]
        self.sensors.epoch[to] = other.sensors.epoch[rows]
        self.memory.copy_rows(to, other.memory, rows)
        self.attack.memory.copy_rows(to, other.attack.memory, rows)
        self.detector.memory.copy_rows(to, other.detector.memory, rows)
        if self.witnesses:  # nobody watches a clean twin
            for mine, theirs in zip(self.witnesses, other.witnesses, strict=True):
                mine.copy_rows(to, theirs, rows)
        weights = self.weights.copy()
        weights[to] = other.weights[rows]
        self.weights = weights
        if other.verdict is not None:
            self.verdict = _merge(self.verdict, other.verdict, to, rows, self.receivers)
        elif self.verdict is not None:
            # nothing has been judged in the new episode; the verdict of the old one is over
            statistic, alarm = self.verdict.statistic.copy(), self.verdict.alarm.copy()
            statistic[to], alarm[to] = 0.0, False
            self.verdict = self.verdict._replace(statistic=statistic, alarm=alarm)


def _merge(
    mine: Verdict | None,
    theirs: Verdict,
    to: NDArray[np.intp],
    rows: NDArray[np.intp],
    receivers: int,
) -> Verdict:
    """Verdict with some rows of another."""
    merged: list[Any] = []
    for k, source in enumerate(theirs):
        if source is None:
            merged.append(None)
            continue
        target = np.zeros((receivers, *source.shape[1:]), dtype=source.dtype)
        if mine is not None and mine[k] is not None:
            target[:] = mine[k]
        target[to] = source[rows]
        merged.append(target)
    return Verdict(*merged)


def _warm_up(
    batch: Batch,
    rngs: Sequence[np.random.Generator],
    between: Callable[[], None] | None = None,
    given: Mapping[str, Any] | None = None,
) -> NDArray[np.bool_]:
    """Begin new episodes, and run them to the onset; (B,) bool, who alarmed."""
    batch.begin(rngs, given)
    batch.quiet_epochs(batch.setup.quiet, between=between)
    alarms = batch.live_epochs(batch.setup.live, between=between)
    alarmed: NDArray[np.bool_] = np.logical_or.reduce(alarms, axis=0)
    return alarmed


def run_serially(work: Callable[[int, int], None], receivers: int) -> None:
    """Call ``work(lo, hi)`` once over all receivers."""
    work(0, receivers)


def _warmed_up(
    setup: Setup, rngs: Sequence[np.random.Generator], between: Callable[[], None]
) -> tuple[Batch, NDArray[np.bool_]]:
    """Batch at the onset, by one thread."""
    batch = Batch(setup, len(rngs), run_serially)
    return batch, _warm_up(batch, rngs, between)


class Engine:
    """B receivers under attack, each in its own episode.

    Parameters
    ----------
    receivers : int
        B, at least 1.
    setup : Setup
        World, victim, attack, detector and timeline.
    threads : int, optional
        Threads for the compiled halves; by default as many as processors, with at least
        `RECEIVERS_PER_THREAD` receivers each.
    prefetch : bool
        Whether to warm up every receiver's next episodes while the present one runs.  They have the
        same bits, but for a detector whose bits depend on the size of the batch: which receivers
        are warmed up together depends on timing, so its runs cannot be reproduced
        (`check_detector` checks that it is none).  One thread more than `threads` computes, also
        with ``threads=1``.
    twin : bool
        Whether a clean twin runs beside every receiver: the same flight, noise and detector, but no
        attack.  It shares the warm-up.

    Attributes
    ----------
    batch : Batch
        The receivers.
    twin : Batch or None
        The same receivers, not attacked.
    warmup_alarm : ndarray
        (B,) bool, whether the detector alarmed before the attack: a false alarm.
    """

    def __init__(
        self,
        receivers: int,
        setup: Setup,
        *,
        threads: int | None = None,
        prefetch: bool = False,
        twin: bool = False,
    ) -> None:
        if receivers < 1:
            raise ValueError(f"`receivers` must be at least 1, got {receivers}")
        if threads is not None and threads < 1:
            raise ValueError(f"`threads` must be at least 1, got {threads}")
        self.receivers, self.setup = receivers, setup
        self.threads = threads if threads is not None else available_threads(receivers)
        self._workers = Workers(self.threads - 1)
        self.batch = Batch(setup, receivers, self._run)
        self.twin = Batch(setup.altered(witnesses=()), receivers, self._run) if twin else None
        self.warmup_alarm: NDArray[np.bool_] = np.zeros(receivers, dtype=np.bool_)
        self._everyone = np.arange(receivers)
        self._few: dict[tuple[bool, int], Batch] = {}
        self._next = (
            NextEpisodes(Batch(setup, STOCK * receivers, run_serially), partial(_warmed_up, setup))
            if prefetch
            else None
        )

    def close(self) -> None:
        """End the threads; they are started again when they are needed."""
        self._workers.close()
        if self._next is not None:
            self._next.close()

    def _run(self, work: Callable[[int, int], None], receivers: int) -> None:
        """Call ``work(lo, hi)`` over slices of whole lanes."""
        if self.threads == 1 or receivers <= LANES:
            work(0, receivers)
            return
        groups = -(-receivers // LANES)
        parts = min(self.threads, groups)
        bounds = [LANES * ((groups * part) // parts) for part in range(parts)] + [receivers]
        self._workers.run(work, bounds)

    def reset(
        self,
        rngs: Sequence[np.random.Generator],
        rows: NDArray[np.intp] | None = None,
        given: Mapping[str, Any] | None = None,
    ) -> None:
        """Begin new episodes and run their warm-up.

        `given`: circumstances of these episodes that are not to be drawn, one value, or one per
        row; see `domain.CHOICES`.
        """
        where = self._everyone if rows is None else rows
        if given:
            # before anything has been begun
            nothing = draw(self.setup.bounds, np.zeros((len(where), 2), dtype=np.uint64))
            interval = self.setup.scenario.epoch_interval_s
            told(given, nothing, self.setup.bounds, self.setup.cases.names, interval)
        self._reset(rngs, where, given)
        if self.twin is not None:
            self.twin.copy_rows(where, self.batch, where)

    def _reset(
        self,
        rngs: Sequence[np.random.Generator],
        where: NDArray[np.intp],
        given: Mapping[str, Any] | None,
    ) -> None:
        if self._next is None:
            self._begin(rngs, where, given)
            return
        if given:
            self._begin(self._next.instead(where, rngs), where, given)
            self._next.prepare(where, rngs)
            return
        prepared = self._next.prepared(where, rngs)
        if prepared.any():
            ready = where[prepared]
            self.warmup_alarm[ready] = self._next.take(ready, self.batch)
        if not prepared.all():
            others = [
                rng for rng, is_prepared in zip(rngs, prepared, strict=True) if not is_prepared
            ]
            self._begin(others, where[~prepared])
        self._next.prepare(where, rngs)

    def _begin(
        self,
        rngs: Sequence[np.random.Generator],
        rows: NDArray[np.intp],
        given: Mapping[str, Any] | None = None,
    ) -> None:
        """Begin new episodes and run their warm-up here and now."""
        if len(rows) == self.receivers:
            self.warmup_alarm = _warm_up(self.batch, rngs, given=given)
            return
        batch = Batch(self.setup, len(rngs), self._run)
        self.warmup_alarm[rows] = _warm_up(batch, rngs, given=given)
        self.batch.copy_rows(rows, batch, np.arange(len(rows)))

    def predict(self, action: FloatArray | None) -> Epoch:
        """First half of a step: command, measure, mechanize, predict.

        `action` (B, a) in [-1, 1]; None holds the present rates.
        """
        return self.batch.advance_attacked(action)

    def judge(self) -> Verdict:
        """Let the engine's own detector judge the epoch."""
        return self.batch.judge()

    def update(self, verdict: Verdict) -> None:
        """Second half of a step: the update with the verdict's weights.

        `verdict`: its weights are used; None are all 1.
        """
        self.batch.update(verdict.weights)

    def step(self, action: FloatArray | None) -> Verdict:
        """Both halves with the engine's own detector.

        `action` (B, a) in [-1, 1]; None holds the present rates.
        """
        if self._next is None:
            return self._step(action)
        with self._next.kept_waiting():
            return self._step(action)

    def _step(self, action: FloatArray | None) -> Verdict:
        self.predict(action)
        verdict = self.judge()
        self.update(verdict)
        return verdict

    def step_twin(self) -> Verdict:
        """Run the epoch of the clean twins, with their own detector."""
        if self.twin is None:
            raise RuntimeError("this engine has no clean twins; make it with `twin=True`")
        self.twin.advance()
        verdict = self.twin.judge()
        self.twin.update(verdict.weights)
        return verdict

    def hold(self, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Let some receivers, and their twins, run the time to alert after the command phase.

        Returns (hold, b) bool, alarms by epoch.
        """
        count = self.setup.hold
        if self.twin is not None:
            self._apart(self.twin, rows, lambda batch: batch.live_epochs(count))
        return self.apart(rows, lambda batch: batch.live_epochs(count, holding=True))

    def apart(self, rows: NDArray[np.intp], work: Callable[[Batch], T]) -> T:
        """Do something with some receivers, while the others wait."""
        return self._apart(self.batch, rows, work)

    def _apart(self, whole: Batch, rows: NDArray[np.intp], work: Callable[[Batch], T]) -> T:
        """`apart` of the receivers, or of their twins."""
        if len(rows) == self.receivers:
            return work(whole)
        batch, here = self._batch_of(whole, len(rows)), np.arange(len(rows))
        batch.copy_rows(here, whole, rows)
        done = work(batch)
        whole.copy_rows(rows, batch, here)
        return done

    def _batch_of(self, whole: Batch, receivers: int) -> Batch:
        """Batch whose rows are all to be overwritten; a small one is made once."""
        key = (whole is self.twin, receivers)
        if key not in self._few:
            batch = Batch(whole.setup, receivers, self._run)
            if receivers > KEPT:
                return batch
            self._few[key] = batch
        return self._few[key]


def available_threads(receivers: int) -> int:
    """Threads worth their while."""
    try:
        processors = len(os.sched_getaffinity(0))
    except AttributeError:
        processors = os.cpu_count() or 1
    return max(1, min(processors, receivers // RECEIVERS_PER_THREAD))
