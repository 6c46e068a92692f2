"""Sizes and runs of audits: a task's worlds at their onsets, one detector at several ages."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...calibration.thresholds import PASSIVE_RUNS, WEIGHING_RUNS
from ...core.children import release_free_memory
from ...core.settings import compute_digest, describe
from ...detectors import Detector, LearnedDetector, detector_in_world
from ...detectors.build import bare_detector
from ...detectors.calibrated import resolve_thresholds, unwrap
from ...detectors.isolated import is_foreign, isolate
from ...envs.context import spoofer_context
from ...policies import SpooferCard, load_card
from ...simulation.setup import Setup
from ...simulation.simulator import weighs
from ...tasks import CANDIDATES, AttackFamily, DetectorTask
from ..runs.panel import NearAlarm, Panel, generators, in_any_world, select_runs
from ..runs.play import Runs, WarmStart, play, play_side_by_side
from ..runs.players import (
    ATTACK,
    TUNED,
    PlayerSpec,
    add_tuned_setting,
    fitting,
    specify_detectors,
    specify_spoofer,
)
from ..runs.record import MEASURES, record_runs
from ..runs.world import World
from ..scores.audit import AgeProbe
from ..scores.statistics import BUDGET
from ..search.amplitude import Tuning, with_rates
from ..search.attack_suite import SuiteAttack, list_fitting_attacks
from ..search.bounds import DisplacementBounds, expect_onset
from ..search.open_loop import OpenLoopSearch, Optima
from .training_attacks import QUIET_TASKS


class AuditBudget(NamedTuple):
    """Size of an audit: evaluation `runs` of every family, and those that its attacks are chosen
    on; the `search` of profiles; runs of every age (`twins`), and how many of `AGES_S`; worlds of
    the floor where none is stored, None for all, 0 for no floor."""

    runs: int
    selection_runs: int
    search: OpenLoopSearch
    twins: int
    ages: int
    floor_worlds: int | None


BUDGETS = {
    "quick": AuditBudget(40, 24, OpenLoopSearch(runs=96, batch=24, generations=6), 16, 4, 0),
    "standard": AuditBudget(400, 96, OpenLoopSearch(runs=256), 64, 5, 4),
    "full": AuditBudget(1500, 384, OpenLoopSearch(), 192, 5, None),
}
"""Sizes by their names: about 1, 4 and 12 minutes of a processor for a plain detector in D1."""
SEARCHED = "o"
"""Letter of a family whose profiles are looked for against each detector."""
AGES_S, LIVE_AFTER_S = (30.0, 180.0, 600.0, 1800.0, 5400.0), 10.0
"""From switch-on to the onsets at which a detector meets the same ramps, and until it is live."""
RAMPS = (0.6, 1.2, 2.4, 4.8, 9.6)
"""How far these ramps displace by the end of the attack, in parts of the alert limit."""
FALSE_ALARMS, AGES, FLOOR = "false alarms", "ages", "floor"
"""Cells that are of no family."""
AGAIN, ALIKE = 8, 1e-6
"""Runs that are judged twice, and the largest difference of the two, in parts."""
SHIPPED = ("ewma-profile", "snapshot-chi2-profile")
"""Profiles of the letter c."""
TRAINED = AttackFamily("shipped", "spoofers of the package, trained against it beforehand", "s")
"""Family of an audit alone, where there are some, and not of a task's score."""
CACHED_BYTES = 2e8
"""What detectors may remember of the panels that are held in memory: the last ones used."""
NEAR_ALARM = "chance-alarm"
"""Onset of which every detector has its own runs."""
TIMED, TIMED_EPOCHS = 64, 40
"""Receivers and epochs by which a detector's time is measured."""


class ScoredDetector(NamedTuple):
    """A detector with its thresholds, and whether it shares passes of the engine."""

    player: PlayerSpec
    judge: Detector
    passive: bool


def find_trained_holdout(judge: Detector, task: DetectorTask) -> str | None:
    """Family that a task holds out, and that a detector has learned from, as its card has it."""
    inner = unwrap(judge)
    training = inner.card.training if isinstance(inner, LearnedDetector) else {}
    if "held_out" not in training:  # not learned, or not from a data set of spoofgym
        return None
    met = "quiet" if training.get("task") in QUIET_TASKS else "inherited"
    return met if met in {family.key for family in task.held_out} else None


def check_contract(detector: Any, say: Callable[[str], None]) -> tuple[Any, str | None]:
    """A detector to audit: a foreign one that is given as text in a process of its own. What no run
    can do without is checked at once; of other promises that it breaks the first is returned, and
    given to `say`."""
    from ...testing.detector import check_detector, check_verdicts

    given = isolate(detector) if isinstance(detector, str | Mapping) else detector
    judge = unwrap(bare_detector(given))
    if judge.card is None and not is_foreign(judge if isinstance(detector, type) else detector):
        return given, None
    name = judge.label or type(judge).__name__
    try:
        check_verdicts(judge)
    except AssertionError as error:
        raise ValueError(f"{name}: {error}") from error
    try:
        check_detector(judge)
    except (AssertionError, RuntimeWarning) as error:
        broken = f"breaks the contract of detectors, and is audited as it is: {error}"
        say(f"{name} {broken}")
        return given, broken
    return given, None


class Worlds:
    """Worlds of one task, with and without an attack, and runs in them at their onsets."""

    def __init__(self, task: DetectorTask, entropy: int, threads: int | None) -> None:
        self.task, self.entropy, self.threads = task, entropy, threads
        self._setups: dict[str, Setup] = {}
        self._panels: dict[Any, Panel] = {}

    @cached_property
    def world(self) -> World:
        return World(settings=self.task.world_kwargs)

    def setup(self, **overrides: Any) -> Setup:
        """World of a family, or with an event, without a defence."""
        key = compute_digest(describe(overrides))
        if key not in self._setups:
            self._setups[key] = self.world.copy_with(**overrides).setup
        return self._setups[key]

    def build_detectors(self, detectors: Iterable[Any]) -> list[ScoredDetector]:
        """Detectors with their thresholds of the task's world; warns of one that has learned from
        what the task holds out, as its card has it."""
        specs = list(detectors)
        entries, world, found = specify_detectors(specs), self.world.setup, []
        for entry, spec in zip(entries, specs, strict=True):
            judge = detector_in_world(spec)
            resolve_thresholds(judge, world)
            if met := find_trained_holdout(judge, self.task):
                warnings.warn(
                    f"{entry.label} has learned from {met} counterfeits, which {self.task.key} "
                    "holds out: its score is not that of a detector that has never met them",
                    UserWarning,
                    stacklevel=2,
                )
            settled = in_any_world(judge)
            found.append(ScoredDetector(entry, settled, not weighs(world, settled)))
        return found

    def panel(
        self,
        group: Sequence[ScoredDetector],
        split: str,
        runs: int,
        onset: str | None = None,
        **overrides: Any,
    ) -> Panel:
        """Runs of a split at their onsets, for detectors that share them, in an altered world."""
        # two files may have one label; a panel keeps its judges, and so their ids
        judged = tuple(id(each.judge) for each in group)
        where, plain = (
            compute_digest(describe({"of": changed, "onset": when}))
            for changed, when in ((overrides, onset), ({}, None))
        )
        key = where, judged, split, runs
        if key in self._panels:  # families in the same world share theirs
            self._panels[key] = self._panels.pop(key)
        else:
            for other in [x for x in self._panels if x[0] not in (where, plain)]:
                del self._panels[other]  # of a family that is finished
            while sum(each.nbytes for each in self._panels.values()) > CACHED_BYTES:
                del self._panels[next(iter(self._panels))]
            setup, judges = self.setup(**overrides), [each.judge for each in group]
            near = onset == NEAR_ALARM
            count, condition = (CANDIDATES * runs, None) if near else (runs, onset)
            numbers = select_runs(setup, self.entropy, split, count, condition)
            rngs = lambda: generators(setup, self.entropy, split, numbers)  # noqa: E731
            self._panels[key] = (
                NearAlarm(setup, judges[0], rngs, self.threads)
                if near
                else Panel(setup, judges, rngs, self.threads)
            )
            release_free_memory()  # of the warm-up
        return self._panels[key]

    def release(self) -> None:
        """Let go of all runs at their onsets."""
        self._panels.clear()
        release_free_memory()

    def start_at_ages(
        self,
        judge: Detector,
        runs: int,
        ages: int,
        youngest: int = 0,
        ages_s: Sequence[float] | None = None,
    ) -> WarmStart:
        """The same runs at each of the first ages in front of a detector, those of the first age
        first; `youngest`: so many of the first age alone. All at their onset where a task draws no
        ages."""
        settings, given = self.task.world_kwargs, None
        changed, times = {}, (ages_s or AGES_S)[:ages]
        if "age_s" in settings["domain"]:
            changed["domain"] = {**settings["domain"], "age_s": [times[0], times[-1]]}
            late = min(LIVE_AFTER_S, 0.5 * times[0])
            phases = {"warmup_s": times[0], "live_s": times[0] - late}
            changed["timeline"] = {**settings["timeline"], **phases}
            given = {"age_s": np.repeat(times, runs)[: youngest or None]}
        setup = self.setup(**changed).copy_with(detector=in_any_world(judge))
        numbers = np.tile(np.arange(runs), ages if given else 1)[: youngest or None]
        rngs = generators(setup, self.entropy, "evaluation", numbers)
        return WarmStart(setup, rngs, threads=self.threads, given=given)

    def probe_ages(
        self,
        judge: Detector,
        twins: int,
        ages: int,
        ages_s: Sequence[float] | None = None,
        parts: Sequence[float] = RAMPS,
        accelerating: bool = False,
    ) -> AgeProbe:
        """Play the same ramps in so many runs at each of the first ages, and the youngest twice.
        `parts`: how far they displace, in alert limits; `accelerating`: from a rate of 0 on, which
        grows to twice the mean."""
        start = self.start_at_ages(judge, twins, ages, ages_s=ages_s)
        limit = self.task.alert_limit_m
        clean, setup = play(start, "none"), start.setup
        most, attack_s = spoofer_context(setup).rate_limit_mps, setup.steps * setup.interval_s
        rates = [min(part * limit / attack_s, most) for part in parts]
        specs: list[dict[str, Any]] = [{"name": "ramp", "rate_mps": rate} for rate in rates]
        if accelerating:
            growth = [2.0 * rate / attack_s for rate in rates]
            specs = [{"name": "accelerating-ramp", "acceleration_mps2": x} for x in growth]
        ramps = [play(start, spec) for spec in specs]
        early = start.warmup_alarm
        each = [record_runs(setup, {}, early, runs, clean, limit).records for runs in ramps]
        found = {name: np.array([records[name] for records in each]) for name in each[0]}
        first, crossing = found["first_alarm"], found["crossing"]
        late = (first == 0) | (first > crossing + setup.hold)
        judged = start.simulator.verdict
        threshold = np.full(start.receivers, np.nan)
        if judged is not None:
            threshold = judged.threshold.mean(axis=1)

        def by_age(values: NDArray[Any]) -> NDArray[Any]:
            return values.reshape(*values.shape[:-1], -1, twins)

        counts = ~early & (clean.first_alarm == 0)
        again = self.start_at_ages(judge, twins, ages, min(AGAIN, twins), ages_s)
        return AgeProbe(
            age_s=np.round(by_age(start.simulator.ages * setup.interval_s).mean(axis=1), 3),
            rate_mps=np.array(rates),
            counts=by_age(counts),
            found=by_age(first > 0),
            crossed=by_age(crossing > 0),
            missed=by_age((crossing > 0) & late),
            displacement=by_age(found[MEASURES[0]]),
            threshold=by_age(threshold).mean(axis=1),
            sky=by_age(found["sky"][0])[0],
            alike=np.array(_compare_twice(start, clean, again, specs, ramps)),
        )

    def measure_cost(self, judge: Detector, ages: int) -> tuple[float, float]:
        """Time of a processor that a detector takes for an epoch of a receiver, and the whole
        simulation [us]."""
        simulator = self.start_at_ages(judge, TIMED, ages, TIMED).engine().simulator
        spent = begun = 0.0
        for k in range(TIMED_EPOCHS + 1):
            if k == 1:  # the first epoch compiles, or starts a process
                spent, begun = 0.0, time.process_time()
            simulator.advance()
            now = time.process_time()
            verdict = simulator.judge()
            spent += time.process_time() - now
            simulator.update(verdict.weights)
        scale = 1e6 / (TIMED * TIMED_EPOCHS)
        return scale * spent, scale * (time.process_time() - begun)

    def expect_calibration(self, detector: Any, judge: Detector, ages: int) -> tuple[str, float]:
        """What a calibration of a detector takes, in words, "" where it has thresholds; and the
        time of its simulation [us]. `judge`: the detector in a world."""
        world, bare = self.world.setup, unwrap(bare_detector(detector))
        _, whole_us = self.measure_cost(bare, ages)
        try:
            resolve_thresholds(judge, world)
        except ValueError:
            runs = WEIGHING_RUNS if weighs(world, bare) else PASSIVE_RUNS
            epochs = runs * (expect_onset(world) + world.steps + world.hold)
            minutes = max(epochs * whole_us / 6e7, 1.0)
            return f"{runs} clean runs, some {minutes:.0f} min of a processor", whole_us
        return "", whole_us

    def search_open_loop(
        self, detector: ScoredDetector, settings: OpenLoopSearch, tick: Callable[[float], None]
    ) -> tuple[tuple[SuiteAttack, ...], dict[str, Any]]:
        """Best profiles that a search finds against a detector, for each of its aims; and the
        zero-alarm bound."""
        bounds = DisplacementBounds(self.world, [detector.player], self.entropy, BUDGET)
        limit = self.task.alert_limit_m
        optima = Optima(
            bounds, Tuning(), threads=self.threads, alert_limit_m=limit, settings=settings
        )
        spoofer = specify_spoofer(add_tuned_setting({"name": "open-loop"}))
        found = optima.find(detector.player, spoofer, tick)["aims"]
        del optima  # whose replays are large
        release_free_memory()
        curves = {tuple(each["rates_mps"]) for each in found.values()}
        attacks = tuple(SuiteAttack("c", with_rates(spoofer, [*x])) for x in sorted(curves))
        return attacks, bounds.zero_alarm(detector.player).as_json()

    @cached_property
    def shipped(self) -> dict[str, set[str]]:
        """Shipped spoofers that fit the task's world, with the detectors that each was made for."""
        made_for = {}
        for name in fitting(self.world.setup)[0]:
            detector = load_card(name, SpooferCard).env_kwargs["detector"]
            made_for[name] = {x["name"] for x in (detector, *detector.get("members", ()))}
        return made_for

    def list_attacks(self, family: AttackFamily, detector: PlayerSpec) -> tuple[SuiteAttack, ...]:
        """Attacks of a family on a detector, each with one setting that is looked for; none of one
        whose profiles are looked for, too."""
        if family == TRAINED:
            names = [x for x, made_for in self.shipped.items() if detector.spec["name"] in made_for]
            return tuple(SuiteAttack("s", specify_spoofer(add_tuned_setting(x))) for x in names)
        if family.letters == "m":
            spec = {**(family.attack or {}), "antenna_m": TUNED}
            return (SuiteAttack("m", PlayerSpec("meaconer", ATTACK, spec, "antenna_m")),)
        setup = self.setup(**self.task.get_overrides(family))
        suite = list_fitting_attacks(setup, spoofer_context(setup))
        found = [member for member in suite if member.letter in family.letters]
        if "c" in family.letters:
            shipped = (specify_spoofer(add_tuned_setting(name)) for name in SHIPPED)
            found += [SuiteAttack("c", player) for player in shipped]
        return tuple(found)


def _compare_twice(
    start: WarmStart, clean: Runs, again: WarmStart, specs: Sequence[Any], ramps: Sequence[Runs]
) -> bool:
    """Whether a detector says the same of the same epochs in a smaller batch, and of attacks on the
    same runs side by side, as of each alone."""
    few = again.receivers
    which = np.repeat(np.arange(len(specs)), few)
    beside = again.take(np.tile(np.arange(few), len(specs)))
    (found,) = play_side_by_side(beside, specs, which)
    same = np.array_equal(again.warmup_alarm, start.warmup_alarm[:few])
    pairs = [(play(again, "none"), clean)]
    pairs += [(found.take(np.flatnonzero(which == k)), each) for k, each in enumerate(ramps)]
    for twin, whole in pairs:
        same &= np.array_equal(twin.first_alarm, whole.first_alarm[:few])
        same &= np.allclose(twin.peak, whole.peak[:few], rtol=ALIKE, equal_nan=True)
    return bool(same)
