"""Populations of spoofers and detectors in one world, and the matrix game between them.

All entries have the same runs, with the same seeds.  A run counts for a detector that is silent
before the onset and without an attack, as in the benchmark.

Passive detectors change nothing of what a spoofer does that observes none of their statistics: they
share one pass of the engine as monitors.  A detector that takes weight off measurements has a pass
of its own with every spoofer, and a spoofer that observes statistics one with every detector.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...calibration.clean_runs import Progress, Silent, weighs
from ...core.registry import check_choice, check_keywords, whole_number
from ...detectors import Detector, Never, detector_in_world
from ...detectors.calibrated import resolve
from ...envs.terms.observation import REPORTED
from ...simulation.monitors import Monitor, Monitored, PassiveDetectors, PastPositions
from ...simulation.setup import SPLITS, Setup
from ...simulation.simulator import Simulator
from ...tasks import task_of
from ..runs.play import Runs, WarmStart, induced_error, play
from ..runs.world import WORLD, World
from ..scores.matrix_game import PayoffMatrix, Played, RunPayoff
from ..scores.scores import counted, undetected_displacement
from .game_entries import KeptEntries
from .members import DETECTOR, SPOOFER, Member, Mixture, Strategy, strategy_of

FloatArray = NDArray[np.float64]
SPLIT = "game"
"""Runs on which matrices are solved."""
RUNS = 200
FIELDS = 4
"""Warm-ups that are kept in memory."""


class EpochAlarms(PassiveDetectors):
    """Passive detectors, of which the alarms of the last epoch are known, and those before it."""

    def bind(self, simulator: Monitored) -> None:
        super().bind(simulator)
        self.memory.declare("so_far", np.zeros(self.memory["alarmed"].shape, dtype=np.bool_))

    def update(self, simulator: Monitored) -> None:
        self.memory["alarmed"][:] = False
        super().update(simulator)
        self.memory["so_far"] |= self.memory["alarmed"]


class _Field(NamedTuple):
    """Runs at the onset in front of D detectors: their twins, and (D, R) which of them count."""

    start: WarmStart
    twin: Runs
    counts: NDArray[np.bool_]


class Game:
    """Spoofers against detectors in one world, on one set of runs.

    Parameters
    ----------
    task : str, optional
        ``"T1"`` to ``"T6"``, whose world and alert limit it takes; not its detector.
    payoff : {"stealth", "hmi"}
        As in `RunPayoff`.
    limit_m : float, optional
        Alert limit or length; that of the task by default.
    runs, entropy, split : optional
        Evaluation runs, their seed, and what they are for, of `SPLITS`.
    folder : path, optional
        Where every entry is kept as soon as it is finished; a killed process goes on from there.
    threads : int, optional
        Threads of the engine.
    progress : Progress, optional
        Shows how far it is, in passes of the engine.
    **world
        Without a task: settings of the environment as `World.of` takes them.

    Raises
    ------
    ValueError
        When the task is unknown, no length is known, or the split is that of calibrations.

    Examples
    --------
    >>> from spoofgym.bench.experiments.game import Game
    >>> world = {"timeline": {"warmup_s": 8, "live_s": 5, "attack_s": 10, "time_to_alert_s": 2}}
    >>> nominal = {"thresholds": "nominal"}
    >>> game = Game(limit_m=5.0, runs=4, **world)
    >>> matrix = game.matrix(
    ...     ["none", {"name": "ramp", "rate_mps": 0.2}],
    ...     [{"name": "snapshot-chi2", **nominal}, {"name": "cusum", **nominal}],
    ... )
    >>> matrix.values.shape
    (2, 2)
    """

    def __init__(
        self,
        task: str | None = None,
        *,
        payoff: str = "stealth",
        limit_m: float | None = None,
        runs: int = RUNS,
        entropy: int = 0,
        split: str = SPLIT,
        folder: str | Path | None = None,
        threads: int | None = None,
        progress: Progress | None = None,
        **world: Any,
    ) -> None:
        check_choice("split", split, [name for name in SPLITS if name != "calibration"])
        if task is None:
            check_keywords("Game", world, (*WORLD, "env", "settings"))
        self.world = World.of(task, **world)
        if task is not None and limit_m is None:
            limit_m = task_of(task).alert_limit_m
        if limit_m is None:
            raise ValueError("`limit_m` is needed: this world has no alert limit of its own")
        self._world = {**world, "task": task} if task is None else {"task": task}
        self._world |= {"payoff": payoff, "limit_m": limit_m, "folder": folder}
        self._world |= {"threads": threads, "progress": progress}
        self.runs, entropy = whole_number("`runs`", runs, 2), whole_number("`entropy`", entropy)
        self.task, self.payoff, self.seeds = task, RunPayoff(payoff, limit_m), (entropy, split)
        self._kept = (
            None if folder is None else KeptEntries(Path(folder), self.world, self.runs, self.seeds)
        )
        self.threads, self.progress = threads, progress or Silent()
        self._judges: dict[str, tuple[Detector, bool]] = {}
        self._fields: dict[tuple[str, ...], _Field] = {}
        self._played: dict[tuple[str, str], tuple[Played, NDArray[np.int64]]] = {}
        self._members: dict[tuple[str, str], Member] = {}

    @property
    def setup(self) -> Setup:
        """The world, without a defence."""
        return self.world.setup

    def on(self, split: str, runs: int | None = None, entropy: int | None = None) -> Game:
        """The same game on runs of another split.

        Parameters
        ----------
        split : str
            What they are for.
        runs, entropy : int, optional
            How many, and their seed; those of this one by default.

        Returns
        -------
        Game
            With the same folder and payoff.
        """
        count = self.runs if runs is None else runs
        seed = self.seeds[0] if entropy is None else entropy
        return Game(**self._world, runs=count, entropy=seed, split=split)

    def detector(self, member: Member) -> Detector:
        """Detector of a member, with the thresholds that it has in this world."""
        return self._judge(member)[0]

    def is_passive(self, member: Member) -> bool:
        """Whether a detector leaves the filter alone."""
        return not self._judge(member)[1]

    def matrix(
        self, spoofers: Sequence[Any], detectors: Sequence[Any], *, oracles: bool = False
    ) -> PayoffMatrix:
        """Payoffs of all pairs.

        Parameters
        ----------
        spoofers, detectors : sequence
            Names, names with settings, paths of ``.onnx`` files, objects, `Member`, `Mixture`, or
            mixes as mappings of names to weights.
        oracles : bool
            Whether spoofers that observe the detector's statistics may be compared with others.

        Returns
        -------
        PayoffMatrix
            In the order that was given.

        Raises
        ------
        ValueError
            When a list is empty, a name is unknown, a member does not fit the world, oracles and
            others meet without `oracles`, or somebody was trained or chosen on these runs.
        """
        rows = [strategy_of(each, SPOOFER) for each in _listed(spoofers, SPOOFER)]
        columns = [strategy_of(each, DETECTOR) for each in _listed(detectors, DETECTOR)]
        for each in (*rows, *columns):
            self._check_fresh(each)
        who, of_rows = self._pure_of(rows)
        whom, of_columns = self._pure_of(columns)
        if not oracles:
            _check_oracles(who)
        self._play(who, whom)
        found = [[self._played[a.label, b.label] for b in whom] for a in who]
        return PayoffMatrix(
            tuple(rows),
            tuple(columns),
            self.payoff,
            of_rows,
            of_columns,
            np.array([[each.displacement for each, _ in row] for row in found]),
            np.array([[each.alarmed for each, _ in row] for row in found]),
            np.array([each.counts for each, _ in found[0]]),
            found[0][0][1],
            self.seeds,
        )

    def _check_fresh(self, strategy: Strategy) -> None:
        if self.seeds in strategy.decided_on:
            entropy, split = self.seeds
            raise ValueError(
                f"{strategy.label} was trained or chosen on the runs of the split {split!r} with "
                f"entropy {entropy}: it can't be scored on them; take another split or entropy"
            )

    def _pure_of(self, strategies: Sequence[Strategy]) -> tuple[list[Member], FloatArray]:
        """All pure members, each once, and their weights in every strategy."""
        parts = [
            ((each,), (1.0,)) if isinstance(each, Member) else (each.members, each.weights)
            for each in strategies
        ]
        everyone: dict[str, Member] = {}
        for members, _ in parts:
            for member in members:
                known = self._members.setdefault((member.side, member.label), member)
                if (known.spec, known.thing) != (member.spec, member.thing):
                    raise ValueError(f"two {member.side}s are called {member.label!r}")
                everyone.setdefault(member.label, member)
        where = {label: k for k, label in enumerate(everyone)}
        weights = np.zeros((len(parts), len(everyone)))
        for row, (members, chances) in zip(weights, parts, strict=True):
            for member, chance in zip(members, chances, strict=True):
                row[where[member.label]] += chance
        return list(everyone.values()), weights

    # --- playing ---------------------------------------------------------------------------------

    def passes(self, spoofers: Sequence[Member], detectors: Sequence[Member]) -> int:
        """Passes of the engine that pure members still take, but for warm-ups and clean twins."""
        return sum(len(who) for _, who, _ in self._groups(spoofers, detectors))

    def _groups(
        self, spoofers: Sequence[Member], detectors: Sequence[Member]
    ) -> Iterator[tuple[list[Member], list[Member], bool]]:
        """Detectors and spoofers of shared passes that are left, and whether it is one alone."""
        missing = {
            (a.label, b.label) for a in spoofers for b in detectors if not self._is_known(a, b)
        }
        passive = [each for each in detectors if not self._judge(each)[1]]
        blind = [each for each in spoofers if not each.sees_statistics]
        shared = [b for b in passive if any((a.label, b.label) in missing for a in blind)]
        who = [a for a in blind if any((a.label, b.label) in missing for b in shared)]
        if who:
            yield shared, who, False
        for b in detectors:
            left = [a for a in spoofers if (a.label, b.label) in missing]
            alone = [a for a in left if a.sees_statistics] if b in passive else left
            if alone:
                yield [b], alone, True

    def _play(self, spoofers: Sequence[Member], detectors: Sequence[Member]) -> None:
        for whom, who, alone in self._groups(spoofers, detectors):
            field = self._field(whom, alone, any(REPORTED in each.knowledge for each in who))
            for spoofer in who:
                now = f"{spoofer.label} against {whom[0].label if alone else len(whom)}"
                self._attack(field, spoofer, whom, alone, now)

    def _judge(self, member: Member) -> tuple[Detector, bool]:
        """Detector with its thresholds, and whether it takes weight off measurements."""
        if member.label not in self._judges:
            made = detector_in_world(member.given)
            resolve(made, self.setup)
            self._judges[member.label] = made, weighs(self.setup, made)
        return self._judges[member.label]

    def _field(self, detectors: Sequence[Member], alone: bool, reported: bool = False) -> _Field:
        """Runs at the onset, and their clean twins; `reported`: with the victims' reports."""
        names = [each.label for each in detectors]
        key = (str(alone), str(reported), *names)
        if key not in self._fields:
            judges = [self._judge(each)[0] for each in detectors]
            self.progress.advance(0.0, f"warm-up of {', '.join(names)}")
            monitors: list[Monitor] = [PastPositions()] if reported else []
            if alone:
                setup = self.setup.altered(detector=judges[0], monitors=monitors)
            else:
                monitors = [EpochAlarms(judges), *monitors]
                setup = self.setup.altered(detector=Never(), monitors=monitors)
            rngs = self.world.generators(*self.seeds, self.runs)
            start = WarmStart(setup, rngs, threads=self.threads)
            early = start.warmup_alarm[None]
            if not alone:
                early = start.engine().simulator.monitor(EpochAlarms).memory["so_far"].T
            twin, alarms = self._pass(start, "none", len(judges), alone, None)
            while len(self._fields) >= FIELDS:
                del self._fields[next(iter(self._fields))]
            self._fields[key] = _Field(start, twin, counted(early, alarms))
        return self._fields[key]

    def _pass(
        self, start: WarmStart, spec: Any, detectors: int, alone: bool, now: str | None
    ) -> tuple[Runs, NDArray[np.int64]]:
        """One attack on all runs, and (D, R) the first alarms, from 1 on; 0 for none."""
        first = np.zeros((detectors, start.receivers), dtype=np.int64)

        def watch(epoch: int, rows: NDArray[np.intp], simulator: Simulator) -> NDArray[np.bool_]:
            alarmed = simulator.monitor(EpochAlarms).memory["alarmed"].T
            first[:, rows] = np.where(alarmed & (first[:, rows] == 0), epoch + 1, first[:, rows])
            return np.asarray(alarmed.all(axis=0))

        def tick(part: float) -> None:
            if now is not None:
                self.progress.advance(part, now)

        runs = play(start, spec, tick=tick, watch=None if alone else watch)
        return runs, runs.first_alarm[None] if alone else first

    def _attack(
        self, field: _Field, spoofer: Member, detectors: Sequence[Member], alone: bool, now: str
    ) -> None:
        setup = field.start.setup
        runs, alarms = self._pass(field.start, spoofer.given, len(detectors), alone, now)
        error = induced_error(setup, runs, field.twin)[: setup.steps]
        sky = np.asarray(field.twin.onset // setup.epochs_each)
        for detector, first, counts in zip(detectors, alarms, field.counts, strict=True):
            moved = undetected_displacement(error, first, setup.hold)
            played = Played(moved, first > 0, counts)
            self._played[spoofer.label, detector.label] = played, sky
            if self._kept is not None:
                self._kept.keep(spoofer, detector, self.detector(detector), played, sky)

    def _is_known(self, spoofer: Member, detector: Member) -> bool:
        """Whether an entry has been played, here or in the folder."""
        key = spoofer.label, detector.label
        if key not in self._played and self._kept is not None:
            found = self._kept.load(spoofer, detector, self.detector(detector))
            if found is not None:
                self._played[key] = found
        return key in self._played


def _listed(given: Any, side: str) -> list[Any]:
    if isinstance(given, str | Mapping | Member | Mixture) or not isinstance(given, Sequence):
        raise TypeError(f"`{side}s` must be a list, got {given!r}")
    if not given:
        raise ValueError(f"`{side}s` must have at least one strategy, got none")
    return list(given)


def _check_oracles(spoofers: Sequence[Member]) -> None:
    """Raise where spoofers that observe the detector's statistics are compared with others."""
    seeing = [each.label for each in spoofers if each.sees_statistics]
    others = [each for each in spoofers if not each.sees_statistics and each.label != "none"]
    if seeing and others:
        raise ValueError(
            f"{', '.join(seeing)}: an oracle, which observes the detector's statistics while it "
            f"attacks; it is not compared with {others[0].label} ({others[0].knowledge}) unless "
            "that is asked for (`oracles=True`, --oracles); tables say what each of them observes"
        )
