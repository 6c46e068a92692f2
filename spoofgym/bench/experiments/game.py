"""Populations of spoofers and detectors in one world, and the matrix game between them.

All entries have the same runs, with the same seeds.  A run counts for a detector that is silent
before the onset and without an attack, as in the benchmark.

Passive detectors change nothing of what a spoofer does that observes none of their statistics: they
share one pass of the engine as monitors.  A detector that takes weight off measurements has a pass
of its own with every spoofer, and a spoofer that observes statistics one with every detector.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, ClassVar, cast

import numpy as np

from ...core.progress import NullProgress, ProgressCallback
from ...core.registry import check_choice, check_keywords, whole_number
from ...core.settings import compute_digest, outside_sources
from ...detectors import Detector
from ...detectors.calibrated import list_factors
from ...policies.card import DETECTOR, SPOOFER
from ...simulation.monitors import PastPositions
from ...simulation.setup import SPLITS, Setup
from ...simulation.simulator import weighs
from ...spoofers.base import REPORTED
from ...tasks import get_task
from ..runs.panel import Panel, PanelAttack
from ..runs.play import FloatArray
from ..runs.players import Mixture, PlayerSpec, Strategy, specify_strategy
from ..runs.record import RunRecord
from ..runs.world import WORLD, World
from ..scores.matrix_game import PayoffMatrix, RunPayoff
from .runner import Context, Experiment, run_experiment
from .store import Cell, MemoryStore, Reader, Result, Store

SPLIT = "game"  # runs on which matrices are solved
RUNS = 200


@dataclass(frozen=True)
class Pairs(Experiment):
    """What all pairs of a game do; a spoofer meets the passive detectors in one pass. `strategies`:
    of both sides; `mixes`: weights of the pure `spoofers` and `detectors` in them."""

    name: ClassVar[str] = "game"
    game: Game
    strategies: tuple[Sequence[Strategy], Sequence[Strategy]]
    spoofers: Sequence[PlayerSpec]
    detectors: Sequence[PlayerSpec]
    mixes: tuple[FloatArray, FloatArray]

    @property
    def config(self) -> dict[str, Any]:
        """World of the game; runs are of the cells, so that all splits may be in one folder."""
        world = self.game.world
        named = {
            name: world.config[name] for name in (*WORLD, "env", "settings") if name in world.config
        }
        return {**named, "outside": outside_sources(*world.parts)}

    @cached_property
    def pairs(self) -> dict[str, tuple[Cell, PlayerSpec, PlayerSpec]]:
        """Cells by key, each with its spoofer and detector; shared passes come first."""
        passive = sum(map(self.game.is_passive, self.detectors))
        found = {}
        for b, a in sorted(product(self.detectors, self.spoofers), key=self._is_alone):
            alone = self._is_alone((b, a))
            group = f"{a.label} against {b.label if alone else f'{passive} detectors'}"
            key, identity = self._identity(a, b)
            found[key] = Cell(key, identity, 1.0 if alone else 1.0 / passive, group=group), a, b
        return found

    def _is_alone(self, pair: tuple[PlayerSpec, PlayerSpec]) -> bool:
        detector, spoofer = pair
        return spoofer.sees_statistics or not self.game.is_passive(detector)

    def _identity(
        self, spoofer: PlayerSpec, detector: PlayerSpec
    ) -> tuple[str, dict[str, Any] | None]:
        """Key of a pair, and all that it depends on; None where no text says that."""
        judge, runs = self.game.detector(detector), [self.game.runs, *self.game.seeds]
        key = " ".join(map(str, (*runs, spoofer.label, detector.label)))
        outside = outside_sources(judge, spoofer.spec, detector.spec)
        if None in (
            spoofer.spec,
            detector.spec,
            *outside.values(),
            *self.config["outside"].values(),
        ):
            return key, None
        named = {"runs": runs, "spoofer": spoofer.spec, "sources": outside}
        named["detector"] = [detector.spec, *list_factors(judge)]
        return f"{key} {compute_digest(named)[:8]}", named

    def cells(self) -> Iterator[Cell]:
        return (cell for cell, _, _ in self.pairs.values())

    def run_group(
        self, cells: Sequence[Cell], results: Reader, context: Context
    ) -> Iterator[Result]:
        """Let one spoofer play against detectors that share its pass."""
        _, (spoofer, *_), detectors = zip(*(self.pairs[cell.key] for cell in cells), strict=True)
        work, alone = sum(cell.work for cell in cells), self._is_alone((detectors[0], spoofer))
        panel = self._panel(detectors, alone, context)
        tick = lambda part: context.tick(part * work / panel.runs / len(cells))  # noqa: E731
        attack = PanelAttack(spoofer.fixed_spec, panel.runs)
        requests = [(attack, k) for k in range(len(detectors))]
        for k, runs in enumerate(panel.play(requests, drop=False, tick=tick)):
            yield Result(*panel.record(k, runs).parts())

    def _panel(self, detectors: Sequence[PlayerSpec], alone: bool, context: Context) -> Panel:
        """Runs at the onset in front of detectors that share them."""
        game, panels = self.game, cast("dict[Any, Panel]", context.cache)
        key = (alone, *(each.label for each in detectors))
        if key not in panels:
            reported = any(REPORTED in each.knowledge for each in self.spoofers)
            panels.clear()  # what shares them comes together
            panels[key] = Panel(
                game.setup,
                [game.detector(each) for each in detectors],
                lambda: game.world.generators(*game.seeds, game.runs),
                context.threads,
                [PastPositions()] if reported else [],
            )
        return panels[key]

    def matrix(self, results: Reader) -> PayoffMatrix:
        keys = {(a.label, b.label): key for key, (_, a, b) in self.pairs.items()}
        found = [
            [RunRecord.from_parts(*results[keys[a.label, b.label]][:2]) for b in self.detectors]
            for a in self.spoofers
        ]
        moved, alarmed, counts = (
            np.array([[getattr(each, name) for each in row] for row in found])
            for name in ("displacement_m", "alarmed", "counts")
        )
        spoofers, detectors = self.strategies
        return PayoffMatrix(
            tuple(spoofers),
            tuple(detectors),
            self.game.payoff,
            *self.mixes,
            moved,
            alarmed,
            counts[0],
            found[0][0].sky,
            self.game.seeds,
        )

    def report(self, results: Reader) -> dict[str, Any]:
        matrix = self.matrix(results)
        return {**matrix.as_json(), "equilibrium": matrix.spread().as_json()}


class Game:
    """Spoofers against detectors in one world, on one set of runs.

    Parameters
    ----------
    task : str, optional
        ``"T1"`` to ``"T6"``; its world and alert limit are used, not its detector.
    payoff : {"stealth", "hmi"}
        As in `RunPayoff`.
    limit_m : float, optional
        Alert limit of the payoff [m]; that of the task by default, needed in another world.
    runs, entropy : int, optional
        Number of runs of every pair, at least 2, and their seed.
    split : str, optional
        What the runs are for: one of `SPLITS` except ``"calibration"``.
    folder : path, optional
        Where every entry is stored as soon as it is finished; a killed process goes on from there.
    threads : int, optional
        Threads of the engine.
    progress : ProgressCallback, optional
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
        folder: str | os.PathLike[str] | None = None,
        threads: int | None = None,
        progress: ProgressCallback | None = None,
        **world: Any,
    ) -> None:
        check_choice("split", split, [name for name in SPLITS if name != "calibration"])
        if task is None:
            check_keywords("Game", world, (*WORLD, "env", "settings"))
        self.world = World.of(task, **world)
        if task is not None and limit_m is None:
            limit_m = get_task(task).alert_limit_m
        if limit_m is None:
            raise ValueError("`limit_m` is needed: this world has no alert limit of its own")
        self._world = {**world, "task": task} if task is None else {"task": task}
        self._world |= {"payoff": payoff, "limit_m": limit_m, "folder": folder}
        self._world |= {"threads": threads, "progress": progress}
        self.runs, entropy = whole_number("`runs`", runs, 2), whole_number("`entropy`", entropy)
        self.task, self.payoff, self.seeds = task, RunPayoff(payoff, limit_m), (entropy, split)
        self.store = MemoryStore(None if folder is None else Store(folder))
        self.threads, self.progress = threads, progress or NullProgress()
        self._judges: dict[str, Detector] = {}
        self._passive: dict[str, bool] = {}
        self._players: dict[tuple[str, str], PlayerSpec] = {}

    @property
    def setup(self) -> Setup:
        """The world, without a defence."""
        return self.world.setup

    def on(self, split: str, runs: int | None = None, entropy: int | None = None) -> Game:
        """The same game, with its folder and payoff, on runs of another split, number or seed."""
        count = self.runs if runs is None else runs
        seed = self.seeds[0] if entropy is None else entropy
        return Game(**self._world, runs=count, entropy=seed, split=split)

    def detector(self, member: PlayerSpec) -> Detector:
        """Detector of a member, with the thresholds that it has in this world."""
        if member.label not in self._judges:
            self._judges[member.label] = self.world.judge(member)
        return self._judges[member.label]

    def is_passive(self, member: PlayerSpec) -> bool:
        """Whether a detector leaves the filter alone."""
        if member.label not in self._passive:
            self._passive[member.label] = not weighs(self.setup, self.detector(member))
        return self._passive[member.label]

    def matrix(
        self, spoofers: Sequence[Any], detectors: Sequence[Any], *, oracles: bool = False
    ) -> PayoffMatrix:
        """Payoffs of all pairs.

        Parameters
        ----------
        spoofers, detectors : sequence
            Names, names with settings, paths of ``.onnx`` files, objects, `PlayerSpec`, `Mixture`,
            or mixes as mappings of names to weights.
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
            others meet without `oracles`, or a member was trained or chosen on these runs.
        """
        pairs = self.pairs(spoofers, detectors, oracles=oracles)
        show = lambda _: nullcontext(self.progress)  # noqa: E731
        return pairs.matrix(run_experiment(pairs, self.store, threads=self.threads, progress=show))

    def pairs(
        self, spoofers: Sequence[Any], detectors: Sequence[Any], *, oracles: bool = False
    ) -> Pairs:
        """The experiment that `matrix` runs: every spoofer against every detector."""
        rows = [specify_strategy(each, SPOOFER) for each in _check_strategies(spoofers, SPOOFER)]
        columns = [
            specify_strategy(each, DETECTOR) for each in _check_strategies(detectors, DETECTOR)
        ]
        for each in (*rows, *columns):
            if self.seeds in each.decided_on:
                entropy, split = self.seeds
                raise ValueError(
                    f"{each.label} was trained or chosen on the runs of the split {split!r} with "
                    f"entropy {entropy}: it can't be scored on them; take another split or entropy"
                )
        spoofers_used, of_rows = self._expand_mixtures(rows)
        detectors_used, of_columns = self._expand_mixtures(columns)
        if not oracles:
            _check_oracles(spoofers_used)
        return Pairs(self, (rows, columns), spoofers_used, detectors_used, (of_rows, of_columns))

    def _expand_mixtures(
        self, strategies: Sequence[Strategy]
    ) -> tuple[list[PlayerSpec], FloatArray]:
        """All pure members, each once, and their weights in every strategy."""
        parts = [
            ((each,), (1.0,)) if isinstance(each, PlayerSpec) else (each.members, each.weights)
            for each in strategies
        ]
        everyone: dict[str, PlayerSpec] = {}
        for members, _ in parts:
            for member in members:
                known = self._players.setdefault((member.side, member.label), member)
                if (known.spec, known.thing) != (member.spec, member.thing):
                    raise ValueError(f"two {member.side}s are called {member.label!r}")
                everyone.setdefault(member.label, member)
        where = {label: k for k, label in enumerate(everyone)}
        weights = np.zeros((len(parts), len(everyone)))
        for row, (members, chances) in zip(weights, parts, strict=True):
            for member, chance in zip(members, chances, strict=True):
                row[where[member.label]] += chance
        return list(everyone.values()), weights


def _check_strategies(given: Any, side: str) -> list[Any]:
    if isinstance(given, str | Mapping | PlayerSpec | Mixture) or not isinstance(given, Sequence):
        raise TypeError(f"`{side}s` must be a list, got {given!r}")
    if not given:
        raise ValueError(f"`{side}s` must have at least one strategy, got none")
    return list(given)


def _check_oracles(spoofers: Sequence[PlayerSpec]) -> None:
    """Raise where spoofers that observe the detector's statistics are compared with others."""
    seeing = [each.label for each in spoofers if each.sees_statistics]
    others = [each for each in spoofers if not each.sees_statistics and each.label != "none"]
    if seeing and others:
        raise ValueError(
            f"{', '.join(seeing)}: an oracle, which observes the detector's statistics while it "
            f"attacks; it is not compared with {others[0].label} ({others[0].knowledge}) unless "
            "`oracles=True` (--oracles) is set; tables say what each of them observes"
        )
