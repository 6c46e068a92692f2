"""Worlds of a task for detectors: its detectors with their thresholds, its attacks and its runs."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ...calibration.clean_runs import weighs
from ...core.settings import describe, digest_of
from ...detectors import Calibrated, Detector, LearnedDetector, detector_in_world
from ...detectors.calibrated import resolve
from ...envs.spoofer_binding import spoofer_context
from ...simulation.setup import Setup
from ...tasks import CANDIDATES, AttackFamily, DetectorTask
from ..runs.panel import NearAlarm, Panel, generators, in_any_world, numbers_of
from ..runs.players import (
    ATTACK,
    TUNED,
    PlayerSpec,
    check_labels,
    fitted,
    refuse_oracles,
    specify_detector,
    specify_spoofer,
)
from ..runs.world import World
from ..scores.paired import CONTROLS
from ..search.attack_suite import ORACLES, SuiteAttack, fitting_members
from .dataset import QUIET_TASKS

SHIPPED = ("ewma-profile", "snapshot-chi2-profile")
"""Profiles of the letter c."""
KEPT_PANELS = 24
"""Panels that are held in memory, the youngest ones."""


class Defence(NamedTuple):
    """A detector with its thresholds, and whether it shares passes of the engine."""

    entry: PlayerSpec
    judge: Detector
    passive: bool


def sharing(defences: Sequence[Defence], family: AttackFamily | None) -> list[list[Defence]]:
    """Groups of detectors that share their passes of a family; None for runs without an attack."""
    alone = family is not None and (
        any(letter in ORACLES for letter in family.letters) or family.onset == "chance-alarm"
    )
    shared = [each for each in defences if each.passive and not alone]
    others = [[each] for each in defences if each not in shared]
    return [*([shared] if shared else []), *others]


def entries_of(detectors: Iterable[Any]) -> tuple[PlayerSpec, ...]:
    """Detectors that may be scored together."""
    entries = tuple(map(specify_detector, detectors))
    if not entries:
        raise ValueError("no detector is given")
    check_labels(entries)
    refuse_oracles(entries)
    return entries


def held_out_but_met(judge: Detector, task: DetectorTask) -> str | None:
    """Family that a task holds out, and that a detector has learned from, as its card has it."""
    inner = judge.detector if isinstance(judge, Calibrated) else judge
    training = inner.card.training if isinstance(inner, LearnedDetector) else {}
    if "held_out" not in training:  # not learned, or not from a data set of spoofgym
        return None
    met = "quiet" if training.get("task") in QUIET_TASKS else "inherited"
    return met if met in {family.key for family in task.held_out} else None


class Worlds:
    """Worlds of one task, with and without an attack, and runs in them at their onsets.

    - `task`: which one;
    - `entropy`: seed of all runs;
    - `threads`: of the engine; None for all.
    """

    def __init__(self, task: DetectorTask, entropy: int, threads: int | None) -> None:
        self.task, self.entropy, self.threads = task, entropy, threads
        self._setups: dict[str, Setup] = {}
        self._panels: dict[Any, Panel] = {}

    @cached_property
    def world(self) -> World:
        """The task's world."""
        return World(given=self.task.world_kwargs)

    def setup(self, **overrides: Any) -> Setup:
        """World of a family, or with an event, without a defence."""
        key = digest_of(describe(overrides))
        if key not in self._setups:
            self._setups[key] = self.world.altered(**overrides).setup
        return self._setups[key]

    def defences(self, detectors: Iterable[Any]) -> list[Defence]:
        """Detectors with their thresholds of the task's world. `detectors`: as of
        `evaluate_detector`; `UserWarning`: of a detector that has learned from what the task holds
        out, as its card has it."""
        specs = list(detectors)
        entries, world, found = entries_of(specs), self.world.setup, []
        for entry, spec in zip(entries, specs, strict=True):
            judge = detector_in_world(spec)
            resolve(judge, world)
            if met := held_out_but_met(judge, self.task):
                warnings.warn(
                    f"{entry.label} has learned from {met} counterfeits, which {self.task.key} "
                    "holds out: its score is not that of a detector that has never met them",
                    UserWarning,
                    stacklevel=2,
                )
            settled = in_any_world(judge)
            alone = entry.spec["name"] in CONTROLS or weighs(world, settled)
            found.append(Defence(entry, settled, not alone))
        return found

    def panel(
        self, family: AttackFamily | None, group: Sequence[Defence], split: str, runs: int
    ) -> Panel:
        """Runs of a split at their onsets, for detectors that share them."""
        overrides = {} if family is None else family.overrides
        onset = None if family is None else family.onset
        # two files may have one label; a panel keeps its judges, and so their ids
        judged = tuple(id(each.judge) for each in group)
        key = digest_of(describe({"of": overrides, "onset": onset})), judged, split, runs
        if key not in self._panels:
            while len(self._panels) >= KEPT_PANELS:  # families in the same world share theirs
                del self._panels[next(iter(self._panels))]
            setup, judges = self.setup(**overrides), [each.judge for each in group]
            near = onset == "chance-alarm"
            asked = (CANDIDATES if near else 1) * runs
            numbers = numbers_of(setup, self.entropy, split, asked, None if near else onset)

            def rngs() -> list[np.random.Generator]:
                return generators(setup, self.entropy, split, numbers)

            threads = self.threads
            self._panels[key] = (
                NearAlarm(setup, judges[0], rngs, threads)
                if near
                else Panel(setup, judges, rngs, threads)
            )
        return self._panels[key]

    def members(self, family: AttackFamily) -> tuple[SuiteAttack, ...]:
        """Attacks of a family. Returns each has one setting that is looked for."""
        found: list[SuiteAttack] = []
        if family.letters == "m":
            spec = {**(family.attack or {}), "antenna_m": TUNED}
            return (SuiteAttack("m", PlayerSpec("meaconer", ATTACK, spec, "antenna_m"), False),)
        setup = self.setup(**family.overrides)
        for member in fitting_members(setup, spoofer_context(setup)):
            if member.letter in family.letters:
                found.append(member)
        if "c" in family.letters:
            found += [SuiteAttack("c", specify_spoofer(fitted(name)), False) for name in SHIPPED]
        return tuple(found)

    def with_event(self, event: str, group: Sequence[Defence], runs: int) -> Panel:
        """The clean evaluation runs, all of them with an event; the noise is the same."""
        domain = {**self.task.world_kwargs["domain"], "events": {event: 1.0}}
        setup, numbers = self.setup(domain=domain), np.arange(runs)
        judges = [each.judge for each in group]
        return Panel(
            setup,
            judges,
            lambda: generators(setup, self.entropy, "evaluation", numbers),
            self.threads,
        )
