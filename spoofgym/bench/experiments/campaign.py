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
from typing import Any, ClassVar

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
from ..search.amplitude import TuningResult, fit, search_work, with_rates
from ..search.attack_suite import SuiteAttack
from ..search.open_loop import AIMS, Optima
from ..search.worst_attack import WorstAttacks, expected_plays, play_winners
from .runner import Context, Experiment, run
from .store import Cell, Reader, Result, Store
from .suite import Suite
from .summary import OUTPUTS, CampaignResults, keys_of

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
    campaign, store = Campaign(suite), Store(path)
    if overwrite:
        campaign.open(store, overwrite=True)
    show = None if progress is None else lambda _: nullcontext(progress)
    return campaign.results(run(campaign, store, jobs=jobs, threads=threads, progress=show))


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

    def open(self, store: Store, *, overwrite: bool = False) -> None:
        """Start in a folder, or go on there."""
        store.open(self.name, self.config, outputs=self.outputs, overwrite=overwrite)

    def results(self, reader: Reader) -> CampaignResults:
        """What cells hold, by detector and spoofer."""
        return CampaignResults(reader.store, self.config)

    def report(self, results: Reader) -> dict[str, Any]:
        """Scores of all finished cells."""
        return self.results(results).summary()

    @cached_property
    def panels(self) -> list[list[PlayerSpec]]:
        """Detectors that are played together."""
        setup = self.suite.world.setup
        passive: list[PlayerSpec] = []
        others: list[PlayerSpec] = []
        for entry in self.suite.detector_entries:
            judge = entry.build()
            resolve(judge, setup)
            (others if weighs(setup, judge) else passive).append(entry)
        count = -(-len(passive) // PANEL)
        return [*(passive[k::count] for k in range(count)), *([entry] for entry in others)]

    @cached_property
    def parts(self) -> dict[str, tuple[str, PlayerSpec | None, PlayerSpec | None]]:
        """Kind, detector and spoofer of every cell, by its key."""
        suite = self.suite
        detectors: dict[str | None, PlayerSpec] = {
            each.label: each for each in suite.detector_entries
        }
        spoofers: dict[str | None, PlayerSpec] = {
            each.label: each for each in suite.spoofer_entries
        }
        return {
            key: (kind, detectors.get(detector), spoofers.get(spoofer))
            for key, (kind, detector, spoofer) in keys_of(self.config).items()
        }

    def cells(self) -> Iterator[Cell]:
        """Detectors of a panel are a group: searches, runs, worst attacks, bounds of each."""
        suite, keys = self.suite, {part: key for key, part in keys_of(self.config).items()}
        searches = [each for each in suite.spoofer_entries if each.tuned]
        yield Cell(keys["floor", None, None], {}, 1.0)
        for panel in self.panels:
            group = ", ".join(each.label for each in panel)
            found = tuple(
                keys["search", detector.label, spoofer.label]
                for spoofer in searches
                for detector in panel
                if spoofer.searched
            )
            for kind, several in (
                ("search", searches),
                ("runs", suite.spoofer_entries),
                ("protection", () if suite.selection is None else (None,)),
                ("bound", (None,)),
            ):
                for spoofer in several:
                    label = None if spoofer is None else spoofer.label
                    for detector in panel:
                        after = found if kind == "protection" else ()
                        if kind == "runs" and spoofer in searches:
                            after = (keys["search", detector.label, label],)
                        key = keys[kind, detector.label, label]
                        yield Cell(key, {}, self._work(kind, spoofer), after, group)

    def _work(self, kind: str, spoofer: PlayerSpec | None) -> float:
        """Work of a cell, in runs of an attack, roughly."""
        suite, settings = self.suite, self.suite.selection
        if kind == "search":
            assert spoofer is not None  # of whom it is
            return search_work(suite.tuning) * (5.25 if spoofer.searched else 1.0)
        if kind == "runs":
            assert spoofer is not None
            return suite.runs * (1.0 if spoofer.label != "none" else WARM_UP)
        if kind == "protection" and settings is not None:
            return expected_plays(len(suite.members), settings, suite.runs)
        return 1.0

    def run(self, cell: Cell, results: Reader, context: Context) -> Result:
        """Compute one cell alone."""
        return next(self.run_group([cell], results, context))

    def run_group(
        self, cells: Sequence[Cell], results: Reader, context: Context
    ) -> Iterator[Result]:
        """Compute cells of detectors that are played together."""
        optima: Optima = context.cache.setdefault("optima", self.suite.optima(context.threads))
        labels = {entry.label: entry for cell in cells if (entry := self.parts[cell.key][1])}
        play = _Players(self.suite, list(labels.values()), self.results(results), context, optima)
        for (kind, spoofer), some in groupby(cells, lambda cell: self.parts[cell.key][::2]):
            detectors = [entry for cell in some if (entry := self.parts[cell.key][1])]
            if kind == "floor":
                yield Result(record=optima.brackets.floor())
            elif kind == "bound":
                for each in detectors:
                    yield Result(record=optima.brackets.zero_alarm(each).as_json())
            elif kind == "protection":
                yield from (Result(*each.parts()) for each in play.protections(detectors))
            elif spoofer is not None and kind == "search":
                yield from (Result(record=x.as_dict()) for x in play.searches(detectors, spoofer))
            elif spoofer is not None:
                yield from (Result(*each.parts()) for each in play.records(detectors, spoofer))


class _Players:
    """Detectors that are played together, at the onsets of the runs of every split."""

    def __init__(
        self,
        suite: Suite,
        detectors: list[PlayerSpec],
        results: CampaignResults,
        context: Context,
        optima: Optima,
    ) -> None:
        self.suite, self.detectors, self.results = suite, detectors, results
        self.context, self.optima = context, optima
        self._panels: dict[str, Panel] = {}

    def _panel(self, split: str, runs: int) -> Panel:
        """Runs of a split at their onset."""
        if split not in self._panels:
            suite, world = self.suite, self.suite.world
            self._panels[split] = Panel(
                world.setup,
                [each.build() for each in self.detectors],
                lambda: suite.generators(split, runs),
                self.context.threads,
                world.watched_for(suite.spoofer_entries),
            )
        return self._panels[split]

    def _numbers(self, detectors: Sequence[PlayerSpec]) -> dict[int, PlayerSpec]:
        return {self.detectors.index(each): each for each in detectors}

    def searches(
        self, detectors: Sequence[PlayerSpec], spoofer: PlayerSpec
    ) -> Iterator[TuningResult]:
        """What is found for a spoofer against each detector."""
        panel = self._panel("training", self.suite.tuning.runs)
        numbers, optima = self._numbers(detectors), lambda: self.optima
        return fit(panel, numbers, spoofer, self.suite.tuning, optima, self.context.tick)

    def records(self, detectors: Sequence[PlayerSpec], spoofer: PlayerSpec) -> Iterator[RunRecord]:
        """What a spoofer does in the evaluation runs of each detector."""
        suite, panel = self.suite, self._panel("evaluation", self.suite.runs)
        numbers, specs, within = self._numbers(detectors), [], []
        for detector in detectors:
            found = self.results.search(detector.label, spoofer.label) if spoofer.tuned else None
            specs.append(spoofer.spec if found is None else played_spec(spoofer, found))
            within.append(None if found is None else found.within_budget)
        played = [panel.clean[k] for k in numbers]
        if spoofer.label != "none":
            asked = [(Attack(x, suite.runs), k) for x, k in zip(specs, numbers, strict=True)]
            played = panel.play(asked, drop=False, tick=self.context.tick)
        players = zip(numbers.items(), specs, within, played, strict=True)
        for (number, detector), spec, keeps, attacked in players:
            head = {
                "detector": detector.label,
                "spoofer": spoofer.label,
                "detector_settings": detector.spec,
                "spoofer_settings": spec,
                "knowledge": knowledge_of(spoofer, panel.setup, detector),
                "attack": panel.setup.attack.label,
                "tuned_within_budget": keeps,
                "judges_channels": panel.judges[number].scope == "channel",
            }
            early = panel.warmup_alarm[:, number]
            twin, limit_m = panel.clean[number], suite.alert_limit_m
            yield record_runs(panel.setup, head, early, attacked, twin, limit_m)

    def protections(self, detectors: Sequence[PlayerSpec]) -> Iterator[Protection]:
        """What the worst attacks of the suite do against each detector."""
        suite, tick = self.suite, self.context.tick
        assert suite.selection is not None  # as the cell says
        panel, numbers = self._panel("selection", suite.selection.runs), self._numbers(detectors)
        searches = [
            WorstAttacks(
                panel,
                k,
                (*suite.members, *found_optima(suite, self.results, each)),
                suite.selection,
            )
            for k, each in numbers.items()
        ]
        asked = [(each.number, each.winners(suite.alert_limits_m)) for each in searches]
        found = list(zip(searches, play_searches(panel, asked, tick), strict=True))
        panel = self._panel("evaluation", suite.runs)
        for (search, _), winners in zip(found, play_winners(panel, found, tick), strict=True):
            head, counts = {"detector": numbers[search.number].label}, panel.counts
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


def played_spec(spoofer: PlayerSpec, found: TuningResult) -> dict[str, Any]:
    """A spoofer with what a search has found for it."""
    if found.found is not None:
        spoofer = with_rates(spoofer, found.found["played"]["rates_mps"])
    return spoofer.with_value(found.value)


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
