"""The engine: B receivers, each in its own episode, with threads, prefetched warm-ups and twins."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_number
from ..core.registry import whole_number
from ..core.simd import LANES
from ..detectors import Verdict
from ..receiver.epoch import Epoch
from .domain import FloatArray, apply_choices, draw
from .prefetch import PIECE, STOCK, NextEpisodes
from .setup import Setup
from .simulator import (
    FixedChoices,
    Rngs,
    Rows,
    Sequel,
    Simulator,
    domain_keys,
    draw_ages,
    episode_seeds,
    run_serially,
)
from .threads import Workers

T = TypeVar("T")
RECEIVERS_PER_THREAD = 16
SLICES_PER_THREAD, LEAST_SLICE = 4, 32  # of a step, so that none waits long; least receivers of one
POOL_SEED = 0x9A57  # receiver k of every pool is seeded ``SeedSequence(POOL_SEED, spawn_key=(k,))``
MAX_CACHED = 8  # largest size of the simulators stored for the time to alert of a few receivers


def _warming(setup: Setup, rngs: Rngs) -> Iterator[Simulator]:
    simulator: Simulator = setup.simulator(len(rngs), run_serially)
    yield simulator
    for _ in simulator.warming(rngs, piece=PIECE):
        yield simulator


def seed_pasts(rows: Rows) -> list[np.random.Generator]:
    seeds = (np.random.SeedSequence(POOL_SEED, spawn_key=(k,)) for k in rows.tolist())
    return [np.random.default_rng(seed) for seed in seeds]


def _run_slices(
    workers: Workers, threads: int, work: Callable[[int, int], None], receivers: int
) -> None:
    """Do work on all receivers, in slices that threads share."""
    parts = min(SLICES_PER_THREAD * threads, receivers // LEAST_SLICE)
    if threads == 1 or parts < 2:
        work(0, receivers)
        return
    groups = -(-receivers // LANES)
    bounds = [LANES * ((groups * part) // parts) for part in range(parts)] + [receivers]
    workers.run(work, bounds)


class Engine:
    """B receivers under attack, each in its own episode.

    Parameters
    ----------
    receivers : int
        B, at least 1.
    setup : Setup
        World, victim, attack, detector and timeline.
    threads : int, optional
        Threads for the compiled halves; by default all useful cores, with at least
        `RECEIVERS_PER_THREAD` receivers each.  A victim without threads uses one.
    prefetch : bool
        Whether to warm up every receiver's next episodes while the present one runs, in the spare
        time of the same threads; with ``threads=1`` by one more, which does nothing else.  They
        have the same bits, but for a detector whose bits depend on the size of the batch: which
        receivers are warmed up together depends on timing, so its runs cannot be reproduced
        (`check_detector` rejects such a detector).
    twin : bool
        Whether a clean twin of every receiver runs, too: the same flight, noise and detector, but
        no attack.  It shares the warm-up.
    warm_pool : int, optional
        Number M of warm-ups that all episodes share, with seeds that are the same for every engine
        (`POOL_SEED`); by default every episode has its own.  An episode starts as a copy of the one
        that its seed picks, satellite biases, domain and ``warmup_alarm`` included, and has its own
        noise from the onset on.  Each is computed when it is first needed.  Runs differ from those
        without a pool, and are the same bits for the same M and seed in any batch.  `prefetch` has
        no effect then; a reset with fixed circumstances (`given`) takes a warm-up of its own.  For
        training only: a score of 1024 episodes from 32 warm-ups is as uncertain as one of some 36
        independent episodes.

    Attributes
    ----------
    simulator : Simulator
        The receivers.
    twin : Simulator or None
        The same receivers, not attacked.
    to_onset : bool
        Whether a reset runs the whole warm-up, as by default, or the filter-only part alone.
    """

    def __init__(
        self,
        receivers: int,
        setup: Setup,
        *,
        threads: int | None = None,
        prefetch: bool = False,
        twin: bool = False,
        warm_pool: int | None = None,
    ) -> None:
        if threads is not None:
            check_number("threads", threads, least=1, whole=True)
        self.receivers, self.setup = receivers, setup
        useful = available_threads(receivers) if threads is None else min(threads, processors())
        self.threads = useful if setup.threaded else 1
        self.warm_pool = None if warm_pool is None else whole_number("`warm_pool`", warm_pool, 1)
        prefetch = prefetch and warm_pool is None
        self._workers = Workers(max(self.threads - 1, int(prefetch)))
        # not a method: simulators would hold their engine, and large arrays wait for the collector
        self._run = partial(_run_slices, self._workers, self.threads)
        self.simulator: Simulator = setup.simulator(receivers, self._run)
        self.twin: Simulator | None = (
            setup.copy_with(monitors=()).simulator(receivers, self._run) if twin else None
        )
        self.to_onset = True
        self._all_rows = np.arange(receivers)
        self._few: dict[tuple[bool, int], Simulator] = {}
        self._pool: Simulator | None = None
        self._flown = np.zeros(self.warm_pool or 0, dtype=np.bool_)
        self._next: NextEpisodes | None = None
        if prefetch:
            waiting = setup.simulator(STOCK * receivers, run_serially)
            self._next = NextEpisodes(waiting, partial(_warming, setup), self._workers)

    @property
    def warmup_alarm(self) -> NDArray[np.bool_]:
        return self.simulator.memory["warmup_alarm"]

    def close(self) -> None:
        """End the threads, and let go of `warm_pool`; both are there again when they are needed."""
        self._workers.close()
        self._pool = None
        self._flown[:] = False

    def reset(
        self, rngs: Rngs, rows: Rows | None = None, given: FixedChoices | None = None
    ) -> None:
        """Start new episodes of some receivers, all by default, and run their warm-up. `rngs` has
        one generator a row; `given` are circumstances that are not to be drawn, one value, or one
        per row (see `domain.CHOICES`)."""
        self._workers.settle()
        where = self._all_rows if rows is None else rows
        if given:
            # refused before any episode has been started
            setup = self.setup
            nothing = draw(setup.bounds, np.zeros((len(where), 2), dtype=np.uint64))
            apply_choices(given, nothing, setup.bounds, setup.combination_names, setup.interval_s)
        try:
            self._reset(rngs, where, given)
        except Exception:
            raise
        except BaseException:  # an interrupt may have left the next episodes halfway
            if self._next is not None:
                self._next.forget()
            raise
        if self.twin is not None:
            self.twin.copy_rows(where, self.simulator, where)

    def take_over(self, other: Engine, rows: Rows) -> None:
        """Let all receivers be as those of another engine."""
        self.simulator.copy_rows(self._all_rows, other.simulator, rows)
        if other.simulator.clean is not None:
            self.simulator.clean = other.simulator.clean[rows]

    def _reset(self, rngs: Rngs, where: Rows, given: FixedChoices | None) -> None:
        if self.warm_pool is not None and not given:
            episodes = episode_seeds(rngs)
            picked = domain_keys(episodes)[:, 0] % np.uint64(self.warm_pool)
            rows = picked.astype(np.intp)
            self.simulator.start_from(self._fly_pasts(rows), where, episodes, rows)
            return
        if self._next is None:
            self._warm_up_rows(rngs, where, given)
            return
        if given:
            self._warm_up_rows(self._next.instead(where, rngs), where, given)
            self._next.prepare(where, rngs)
            return
        prepared = self._next.find_prepared(where, rngs)
        if prepared.any():
            self._next.take(where[prepared], self.simulator)
        if not prepared.all():
            others = [rng for rng, ready in zip(rngs, prepared, strict=True) if not ready]
            self._warm_up_rows(others, where[~prepared])
        self._next.prepare(where, rngs)

    def _warm_up_rows(self, rngs: Rngs, rows: Rows, given: FixedChoices | None = None) -> None:
        whole = len(rows) == self.receivers
        part: Simulator = self.simulator if whole else self.setup.simulator(len(rngs), self._run)
        if self.to_onset:
            part.warm_up(rngs, given)
        else:
            part.switch_on(rngs, given)
        if not whole:
            self.simulator.copy_rows(rows, part, np.arange(len(rows)))

    def _fly_pasts(self, picked: Rows) -> Simulator:
        """The pool, in which those that are picked have come to their onset."""
        if self._pool is None:
            self._pool = self.setup.simulator(len(self._flown), self._run)
        lacking = np.unique(picked[~self._flown[picked]])
        if len(lacking):
            rows = self._fill_lanes(lacking)
            part: Simulator = self.setup.simulator(len(rows), self._run)
            part.warm_up(seed_pasts(rows))
            self._pool.copy_rows(rows, part, np.arange(len(rows)))
            self._flown[rows] = True
        return self._pool

    def _fill_lanes(self, lacking: Rows) -> Rows:
        """Pasts that are to be flown, and for the rest of their lanes the next younger ones."""
        oldest_first = np.argsort(-self._pool_ages, kind="stable")
        rank = np.argsort(oldest_first)
        waiting = oldest_first[~self._flown[oldest_first]]
        younger = waiting[(rank[waiting] > rank[lacking].max()) | (len(lacking) > LANES)]
        others = younger[~np.isin(younger, lacking)][: -len(lacking) % LANES]
        rows = np.concatenate([lacking, others])
        return np.asarray(rows[np.argsort(rank[rows])])

    @cached_property
    def _pool_ages(self) -> NDArray[np.int64]:
        """(M,) of all pasts at their onset [epochs]."""
        return draw_ages(self.setup, seed_pasts(np.arange(len(self._flown))))

    def predict(self, command: FloatArray | None) -> Epoch:
        return self.simulator.predict(command)

    def judge(self) -> Verdict:
        return self.simulator.judge()

    def update(self, verdict: Verdict) -> None:
        self.simulator.update(verdict.weights)

    def step(self, command: FloatArray | None, sequel: Sequel | None = None) -> Verdict:
        verdict = self.simulator.step(command, sequel=sequel)
        if self.twin is not None:
            self.step_twin()
        return verdict

    def step_twin(self) -> Verdict:
        if self.twin is None:
            raise RuntimeError("this engine has no clean twins; make it with `twin=True`")
        return self.twin.step(attacked=False)

    def hold(self, rows: Rows) -> tuple[NDArray[np.bool_], NDArray[np.bool_] | None]:
        """Run the time to alert of some receivers and their twins; (hold, b) alarms of both."""
        count, of_twin = self.setup.hold, None
        if self.twin is not None:
            of_twin = self.apart(rows, lambda part: part.live_epochs(count), self.twin)
        return self.apart(rows, lambda part: part.live_epochs(count, holding=True)), of_twin

    def apart(
        self, rows: Rows, work: Callable[[Simulator], T], whole: Simulator | None = None
    ) -> T:
        """Do something with a simulator of some receivers, or twins, alone; the others wait."""
        whole = self.simulator if whole is None else whole
        if len(rows) == self.receivers:
            return work(whole)
        part, here = self._get_part(whole, len(rows)), np.arange(len(rows))
        part.copy_rows(here, whole, rows)
        done = work(part)
        whole.copy_rows(rows, part, here)
        return done

    def _get_part(self, whole: Simulator, receivers: int) -> Simulator:
        """Simulator whose rows are all to be overwritten; a small one is made once."""
        key = (whole is self.twin, receivers)
        if key not in self._few:
            part: Simulator = whole.setup.simulator(receivers, self._run)
            if receivers > MAX_CACHED:
                return part
            self._few[key] = part
        return self._few[key]


def available_threads(receivers: int) -> int:
    return max(1, min(processors(), receivers // RECEIVERS_PER_THREAD))


def processors() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
