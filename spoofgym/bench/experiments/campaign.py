"""A campaign: detectors x spoofers, the worst attacks of the suite, and limits; the standard suite.

Passive detectors share the passes of the engine, a few of them at a time.  A detector that takes
weight off measurements has passes of its own.

The standard suite is every detector that suits one task's world, against the usual spoofers.  Tests
of range rates are there a second time where their defaults test pseudoranges, or both.  World and
alert limit are those of the task, the rate of false alarms is the standard one, and the sizes are
such that two idle cores play it in a quarter of an hour.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any, ClassVar, NamedTuple

from ...calibration.clean_runs import weighs
from ...calibration.thresholds import suitable_detectors
from ...core.progress import ProgressCallback
from ...detectors.build import spec_of_judge
from ...detectors.calibrated import STANDARD_RATE, resolve
from ...simulation.setup import Setup
from ...tasks import RANGE_RATE_TESTS, SUITE, task_of
from ..runs.panel import Attack, Panel, play_searches
from ..runs.players import PlayerSpec, knowledge_of
from ..runs.record import Protection, RunRecord, record_runs
from ..runs.world import CONTROLS
from ..search.amplitude import fit, search_work, with_rates
from ..search.attack_suite import SuiteAttack
from ..search.open_loop import AIMS, Optima
from ..search.worst_attack import WorstAttacks, expected_plays, play_winners
from .runner import Context, Experiment, run
from .store import Cell, Reader, Result, Store
from .suite import Suite
from .summary import (
    BOUND,
    FLOOR,
    OUTPUTS,
    PROTECTION,
    RUNS,
    SEARCH,
    CampaignResults,
    key_of,
    summarize,
)

PANEL = 4
"""Passive detectors that share passes; they are finished together, and by one process."""
WARM_UP = 2.0
"""Work of a warm-up and of the clean twins, in runs of an attack."""


def run_campaign(
    suite: Suite,
    path: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    threads: int | None = None,
    jobs: int = 1,
    progress: ProgressCallback | None = None,
) -> CampaignResults:
    """Run all parts of a campaign that are not finished yet, each written as soon as it is.

    Parameters
    ----------
    suite : Suite
        What is run.
    path : path-like
        Folder of the results.
    overwrite : bool
        Whether to replace the results of another campaign.
    threads : int, optional
        As in `Engine`, in each process.
    jobs : int
        Processes of this machine.
    progress : ProgressCallback, optional
        Shows how far it is.

    Returns
    -------
    CampaignResults
        What `summarize` takes.
    """
    campaign, show = Campaign(suite), None if progress is None else lambda _: nullcontext(progress)
    settings: dict[str, Any] = {"jobs": jobs, "threads": threads, "overwrite": overwrite}
    return campaign.results(run(campaign, Store(path), progress=show, **settings))


@dataclass(frozen=True)
class Campaign(Experiment):
    """What every detector and spoofer of a suite do, and what limits them."""

    name: ClassVar[str] = "campaign"
    outputs: ClassVar[tuple[str, ...]] = OUTPUTS
    suite: Suite

    @property
    def config(self) -> dict[str, Any]:
        """Everything that the results depend on; nothing is left for single cells to say."""
        return self.suite.config

    def results(self, reader: Reader) -> CampaignResults:
        """What cells hold, by detector and spoofer."""
        return CampaignResults(reader.store, self.config)

    def report(self, results: Reader) -> dict[str, Any]:
        """Scores of all finished cells."""
        return summarize(self.results(results))

    @cached_property
    def panels(self) -> list[list[PlayerSpec]]:
        """Detectors that are played together."""
        setup, passive, others = self.suite.world.setup, list[PlayerSpec](), list[PlayerSpec]()
        for entry in self.suite.detector_entries:
            judge = entry.build()
            resolve(judge, setup)
            (others if weighs(setup, judge) else passive).append(entry)
        count = -(-len(passive) // PANEL)
        return [*(passive[k::count] for k in range(count)), *([entry] for entry in others)]

    @cached_property
    def parts(self) -> dict[str, _Part]:
        """Cells by key; those of detectors that are played together are a group."""
        suite, found = self.suite, {key_of(FLOOR): _Part(Cell(key_of(FLOOR), {}), FLOOR)}
        players = suite.spoofer_entries
        steps: list[tuple[str, PlayerSpec | None]] = [(SEARCH, x) for x in players if x.tuned]
        steps += [(RUNS, each) for each in players]
        steps += [] if suite.selection is None else [(PROTECTION, None)]
        for panel in self.panels:
            group = ", ".join(each.label for each in panel)
            for kind, spoofer in (*steps, (BOUND, None)):
                for detector in panel:
                    before = [each for each in players if each.searched and kind == PROTECTION]
                    before += [spoofer] if spoofer and spoofer.tuned and kind == RUNS else []
                    after = tuple(key_of(SEARCH, detector, each) for each in before)
                    key, work = key_of(kind, detector, spoofer), self._work(kind, spoofer)
                    cell = Cell(key, {}, work, after, group)
                    found[key] = _Part(cell, kind, detector, spoofer, panel)
        return found

    def cells(self) -> Iterator[Cell]:
        """Searches, runs, worst attacks and a bound of every detector, and the floor."""
        return (part.cell for part in self.parts.values())

    def _work(self, kind: str, spoofer: PlayerSpec | None) -> float:
        """Work of a cell, in runs of an attack, roughly."""
        suite = self.suite
        if kind == SEARCH:
            return search_work(suite.tuning) * (5.25 if spoofer and spoofer.searched else 1.0)
        if kind == RUNS:
            return suite.runs * (WARM_UP if spoofer and spoofer.label == "none" else 1.0)
        if kind == PROTECTION and suite.selection is not None:
            return expected_plays(len(suite.members), suite.selection, suite.runs)
        return 1.0

    def run(self, cell: Cell, results: Reader, context: Context) -> Result:
        """Compute one cell alone."""
        return next(self.run_group([cell], results, context))

    def run_group(
        self, cells: Sequence[Cell], results: Reader, context: Context
    ) -> Iterator[Result]:
        """Compute cells of detectors that are played together."""
        optima: Optima = context.cache.setdefault("optima", self.suite.optima(context.threads))
        parts = [self.parts[cell.key] for cell in cells]
        play = _Players(self.suite, parts[0].panel, self.results(results), context)
        for (kind, spoofer), some in groupby(parts, lambda part: (part.kind, part.spoofer)):
            numbers = {play.detectors.index(each): each for _, _, each, *_ in some if each}
            if kind == FLOOR:
                yield Result(record=optima.brackets.floor())
            elif kind == BOUND:
                bounds = map(optima.brackets.zero_alarm, numbers.values())
                yield from (Result(record=each.as_json()) for each in bounds)
            elif spoofer is None:
                yield from (Result(*each.parts()) for each in play.protections(numbers))
            elif kind == SEARCH:
                panel, tuning = play.panel("training", self.suite.tuning.runs), self.suite.tuning
                found = fit(panel, numbers, spoofer, tuning, lambda: optima, context.tick)
                yield from (Result(record=each.as_dict()) for each in found)
            else:
                yield from (Result(*each.parts()) for each in play.records(numbers, spoofer))


class _Part(NamedTuple):
    """A cell, what it is of, and which detectors are played together."""

    cell: Cell
    kind: str
    detector: PlayerSpec | None = None
    spoofer: PlayerSpec | None = None
    panel: Sequence[PlayerSpec] = ()


class _Players(NamedTuple):
    """Detectors that are played together."""

    suite: Suite
    detectors: Sequence[PlayerSpec]
    results: CampaignResults
    context: Context

    def panel(self, split: str, runs: int) -> Panel:
        """Runs of a split at their onset; those of the last detectors are kept."""
        suite, panels = self.suite, self.context.cache.setdefault("panels", {})
        labels = tuple(each.label for each in self.detectors)
        if (labels, split) not in panels:
            for key in [key for key in panels if key[0] != labels]:
                del panels[key]
            panels[labels, split] = Panel(
                suite.world.setup,
                [each.build() for each in self.detectors],
                lambda: suite.generators(split, runs),
                self.context.threads,
                suite.world.watched_for(suite.spoofer_entries),
            )
        found: Panel = panels[labels, split]
        return found

    def records(self, detectors: Mapping[int, PlayerSpec], spoofer: PlayerSpec) -> list[RunRecord]:
        """What a spoofer does in the evaluation runs of detectors, by their numbers."""
        suite, panel = self.suite, self.panel("evaluation", self.suite.runs)
        heads = [self._head(panel, number, spoofer) for number in detectors]
        played = [panel.clean[number] for number in detectors]
        if spoofer.label != "none":
            attacks = [Attack(head["spoofer_settings"], suite.runs) for head in heads]
            asked = list(zip(attacks, detectors, strict=True))
            played = panel.play(asked, drop=False, tick=self.context.tick)
        return [
            record_runs(
                panel.setup,
                head,
                panel.warmup_alarm[:, number],
                attacked,
                panel.clean[number],
                suite.alert_limit_m,
            )
            for number, head, attacked in zip(detectors, heads, played, strict=True)
        ]

    def _head(self, panel: Panel, number: int, spoofer: PlayerSpec) -> dict[str, Any]:
        """Who plays, and how."""
        detector, spec, within = self.detectors[number], spoofer.spec, None
        found = self.results.search(detector.label, spoofer.label) if spoofer.tuned else None
        if found is not None:
            chosen = spoofer
            if found.found is not None:
                chosen = with_rates(spoofer, found.found["played"]["rates_mps"])
            spec, within = chosen.with_value(found.value), found.within_budget
        return {
            "detector": detector.label,
            "spoofer": spoofer.label,
            "detector_settings": detector.spec,
            "spoofer_settings": spec,
            "knowledge": knowledge_of(spoofer, panel.setup, detector),
            "attack": panel.setup.attack.label,
            "tuned_within_budget": within,
            "judges_channels": panel.judges[number].scope == "channel",
        }

    def protections(self, detectors: Mapping[int, PlayerSpec]) -> Iterator[Protection]:
        """What the worst attacks of the suite do against detectors, by their numbers."""
        suite, tick = self.suite, self.context.tick
        assert suite.selection is not None  # as the cell says
        panel = self.panel("selection", suite.selection.runs)
        searches = []
        for number, each in detectors.items():
            members = *suite.members, *found_optima(suite, self.results, each)
            searches.append(WorstAttacks(panel, number, members, suite.selection))
        asked = [(each.number, each.winners(suite.alert_limits_m)) for each in searches]
        found = list(zip(searches, play_searches(panel, asked, tick), strict=True))
        panel = self.panel("evaluation", suite.runs)
        for (search, _), winners in zip(found, play_winners(panel, found, tick), strict=True):
            head, counts = {"detector": detectors[search.number].label}, panel.counts
            yield Protection(head, winners, counts[:, search.number], panel.sky, search.skies)


def found_optima(suite: Suite, results: CampaignResults, detector: PlayerSpec) -> list[SuiteAttack]:
    """Curves that were found against a detector, as members of the attack suite."""
    members: list[SuiteAttack] = []
    for entry in suite.spoofer_entries:
        result = results.search(detector.label, entry.label) if entry.searched else None
        if result is not None and result.found is not None:
            each = (result.found["played"], *(result.found["aims"][name] for name in AIMS))
            curves = [with_rates(entry, curve["rates_mps"]) for curve in each]
            own = [curve for k, curve in enumerate(curves) if curve not in curves[:k]]
            members += [SuiteAttack("c", curve, True) for curve in own]
    return members


STANDARD = "standard"
SUITES = (STANDARD,)
"""Names of `spoofgym bench --suite`."""
TASK = "T3"
RATE = STANDARD_RATE
"""False alarms an hour of all detectors."""
SPOOFERS = ("ramp", "accelerating-ramp", "snapshot-chi2-profile", "blind-optimum", "feedback")
"""Each is fitted to the alarm budget."""
SIZES = {"seeds": 400, "training_seeds": 128, "selection_seeds": 48}
"""Evaluation, training and selection runs, where no others are given."""


def everyone_in(setup: Setup, rescaled: bool = False) -> list[dict[str, Any]]:
    """The controls and all classics that suit a world; `rescaled`: also with their innovations."""
    found = [dict(each) for each in CONTROLS]
    for each in suitable_detectors(setup):
        own = {"name": spec_of_judge(each)["name"]}
        if own not in found:
            found.append(own)
        if rescaled and each.drifts:
            found.append({**own, "thresholds": "rescaled"})
    return found


def in_order(everyone: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Controls, solution separation, tests of range rates, which are added, and the others."""
    controls = [dict(spec) for spec in CONTROLS]
    first = [*controls, {"name": "solution-separation"}, *map(dict, RANGE_RATE_TESTS)]
    return [*first, *(dict(spec) for spec in everyone if spec not in first)]


def standard_kwargs() -> dict[str, Any]:
    """Keyword arguments of a `Suite`, but for its detectors."""
    task = task_of(TASK)
    limit = {} if task.alert_limit_m is None else {"alert_limit_m": task.alert_limit_m}
    note = f"suite {STANDARD}: the world of task {task.key} of {SUITE}"
    return {**task.world_kwargs, **limit, "notes": (note,)}
