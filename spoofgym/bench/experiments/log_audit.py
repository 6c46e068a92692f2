"""Audit of a detector on the clean noise of a log, by the linear response of the log's own filter.

It ends with the score, the screen and the report of an audit in simulation.  Runs are the log's
windows: attacks are chosen on every second one and play the others.  Families that need a victim
that answers, other signals or other worlds are left out.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...calibration.log import judge_log
from ...core.declared import check_number
from ...core.files import check_writable
from ...core.progress import ProgressBar
from ...core.registry import check_choice, slug
from ...core.settings import compute_digest, describe
from ...detectors import detector_in_world
from ...detectors.calibrated import find_requested_rate
from ...limits.log_replay import FEWEST_WINDOWS, RATE_LIMIT_MPS, LogReplay
from ...receiver.log import InnovationLog
from ...tasks import AttackFamily, get_detector_task
from ..runs.panel import PanelAttack, play_searches
from ..runs.players import add_tuned_setting, specify_detector, specify_spoofer
from ..runs.record import MEASURES, Protection, mask_valid_runs, undetected_displacement
from ..scores.audit import AgeProbe, Audit
from ..scores.detector import CLEAN, WINDOW, DetectorScore, FamilyScore
from ..search import attack_suite
from ..search.amplitude import Tuning, with_rates
from ..search.backends import ReplayBackend
from ..search.log_attack import make_context, play_spoofer
from ..search.open_loop import search_aims
from .audit_cells import write_attacks
from .audit_worlds import (
    AGAIN,
    AGES,
    AGES_S,
    ALIKE,
    BUDGETS,
    FALSE_ALARMS,
    RAMPS,
    SEARCHED,
    check_contract,
)
from .runner import Context, Experiment
from .store import Cell, Reader, Result

FAMILIES = ("ramps", "profiles", "dashes", "open-loop")
TIMES: dict[str, Any] = {
    "attack_s": 150.0,
    "time_to_alert_s": 10.0,
    "rate_limit_mps": RATE_LIMIT_MPS,
}
ALERT_LIMIT_M = 30.0


class LogPanel:
    """Some windows of a log, in the place of the runs of a `Panel`, in front of one detector."""

    def __init__(self, replay: LogReplay, rows: NDArray[np.intp]) -> None:
        self.replay, self.rows, self.runs, self.sky = replay, rows, len(rows), rows.astype(np.int64)
        quiet = replay.play(0, np.zeros((1, replay.steps)), rows=rows)
        self.twin_alarm, self.warmup_alarm = quiet.first_alarm[0], replay.warmup_alarm[0, rows]
        self.counts = mask_valid_runs(self.warmup_alarm, self.twin_alarm)[:, None]
        self.context = make_context(replay)

    def play(self, attacks: Sequence[tuple[PanelAttack, int]], **_: Any) -> list[Any]:
        """(R',) undetected displacement under each attack [m]."""
        return [
            play_spoofer(self.replay, attack.spec, self.rows[: attack.runs])[0]
            for attack, _number in attacks
        ]


class LogAttacks(attack_suite.FamilyAttacks):
    """The search for the worst attacks of a family on a log."""

    def measure(self, panel: Any, attacked: Any) -> dict[str, NDArray[np.float64]]:
        return {MEASURES[0]: np.round(attacked, 6)}


class LogAuditor:
    """Audits detectors on a log; arguments as of `audit`, an alert limit, a rate in place of what a
    detector requests, and `times` of `LogReplay`."""

    def __init__(
        self,
        log: InnovationLog | str | os.PathLike[str],
        budget: str = "standard",
        *,
        families: Sequence[str] | None = None,
        alert_limit_m: float = ALERT_LIMIT_M,
        false_alarms_per_hour: float | None = None,
        threads: int | None = None,
        folder: str | os.PathLike[str] | None = None,
        **times: float,
    ) -> None:
        check_choice("budget", budget, BUDGETS)
        name = "log" if isinstance(log, InnovationLog) else Path(log).stem
        self.log = log if isinstance(log, InnovationLog) else InnovationLog.load(Path(log))
        self.key, self.budget, self.threads = slug(name), budget, threads
        check_number("alert_limit_m", alert_limit_m, above=0.0)
        self.alert_limit_m, self.times = alert_limit_m, {**TIMES, **times}
        self.requested_per_hour = false_alarms_per_hour
        task = get_detector_task("D1")
        for each in families or ():
            check_choice("family of attacks on a log", each, FAMILIES)
        self.families = [task.family(key) for key in dict.fromkeys(families or FAMILIES)]
        self.folder = None if folder is None else Path(folder) / self.key
        if self.folder is not None:
            check_writable(self.folder)

    def prepare(
        self,
        detector: Any,
        show: ProgressBar | None = None,
        say: Callable[[str], None] = lambda _: None,
    ) -> LogAudit:
        """Cells of a detector, with thresholds of the log's own windows."""
        spec, broken = check_contract(detector, say)
        rate = self.requested_per_hour or find_requested_rate(detector_in_world(spec))
        factor = 1.0
        if rate is not None:
            window_s = self.times["attack_s"] + self.times["time_to_alert_s"]
            factor = judge_log(self.log, [spec], rate, window_s)[0].factor
        return LogAudit(self, spec, specify_detector(spec).label, rate, factor, broken)


@dataclass(frozen=True)
class LogAudit(Experiment):
    """Worst attacks of every family on a detector, false alarms, what it finds at several ages."""

    name: ClassVar[str] = "audit"
    of: LogAuditor
    detector: Any
    label: str
    requested_per_hour: float | None
    factor: float
    broken: str | None = None

    @property
    def config(self) -> dict[str, Any]:
        log = self.of.log
        parts = log.time, log.innovation, log.innovation_cov, dict(log.more)
        return {
            "task": self.of.key,
            "world": {"log": compute_digest(describe(parts)), **self.of.times},
            "alert_limit_m": self.of.alert_limit_m,
        }

    def build_replay(self, **changed: Any) -> LogReplay:
        times = {**self.of.times, "threads": self.of.threads, **changed}
        return LogReplay(self.of.log, self.detector, self.factor, **times)

    @cached_property
    def panels(self) -> tuple[LogPanel, LogPanel, LogPanel]:
        """Windows that attacks are chosen on, that they play, and all."""
        replay = self.build_replay()
        rows = np.arange(replay.runs)
        return LogPanel(replay, rows[::2]), LogPanel(replay, rows[1::2]), LogPanel(replay, rows)

    def cells(self) -> Iterator[Cell]:
        for part in (*self.of.families, FALSE_ALARMS, AGES):
            family = isinstance(part, AttackFamily)
            key = part.key if isinstance(part, AttackFamily) else part
            identity = {
                "family": asdict(part) if isinstance(part, AttackFamily) else part,
                "detector": [describe(specify_detector(self.detector).spec), self.factor],
                "runs": [self.of.budget],
                "selection": FEWEST_WINDOWS,
            }
            yield Cell(f"{key} {self.label}", identity, 4.0 if family else 1.0)

    def run(self, cell: Cell, results: Reader, context: Context) -> Result:
        named = cell.identity["family"] if cell.identity else None
        if named == FALSE_ALARMS:
            every = self.panels[2]
            window = every.twin_alarm > 0
            return Result({WINDOW: window, CLEAN: window | every.warmup_alarm})
        if named == AGES:
            return Result(self._probe_ages()._asdict())
        family = next(each for each in self.of.families if each.key == named["key"])  # type: ignore[index]
        return Result(*self._play_family(family).parts())

    def _play_family(self, family: AttackFamily) -> Protection:
        chosen_on, played, _ = self.panels
        limit = self.of.alert_limit_m
        head: dict[str, Any] = {"detector": self.label}
        suite = attack_suite.list_suite_attacks(chosen_on.context)
        attacks = [member for member in suite if member.letter in family.letters]
        if SEARCHED in family.letters:
            backend = ReplayBackend(chosen_on.replay, 0, "target")
            backend.rows = np.intersect1d(backend.rows, chosen_on.rows)
            backend.runs = len(backend.rows)
            found = search_aims(backend, Tuning(), BUDGETS[self.of.budget].search, limit)
            spoofer = specify_spoofer(add_tuned_setting({"name": "open-loop"}))
            curves = sorted({tuple(each["rates_mps"]) for each in found.values()})
            attacks += [
                attack_suite.SuiteAttack("c", with_rates(spoofer, [*curve])) for curve in curves
            ]
            head["zero_alarm"] = chosen_on.replay.bound_zero_alarm().as_json()
        sizes = attack_suite.Selection(runs=chosen_on.runs, sift_runs=chosen_on.runs)
        search = LogAttacks(chosen_on, 0, tuple(attacks), sizes, antenna_m=(1.0, 2.0))
        panels: tuple[Any, Any] = chosen_on, played
        best = play_searches(panels[0], [(0, search.winners([limit]))])
        winners = attack_suite.play_winners(panels[1], [(search, best[0])], lambda _: None)
        return Protection(head, winners[0], played.counts[:, 0], played.sky, None)

    def _probe_ages(self) -> AgeProbe:
        """Play the same ramps in the same windows, with the detector reset at several times."""
        whole, limit = self.panels[2].replay, self.of.alert_limit_m
        known_s = whole.known_s
        least = max(FEWEST_WINDOWS, whole.runs // 2)
        ages = [x for x in AGES_S if (known_s >= x).sum() >= least] or [float(known_s.min())]
        starts = whole.starts[known_s >= ages[-1]]
        attack_s, most = whole.attack_epochs * whole.interval_s, whole.limits[0]
        ramps = np.array([0.0, *(min(part * limit / attack_s, most) for part in RAMPS)])
        shape, hold, steps = (
            (len(ages), len(starts)),
            whole.epochs - whole.attack_epochs,
            whole.steps,
        )
        replays = [self.build_replay(live_s=age, starts=starts) for age in ages]
        found = [each.play(0, ramps[:, None] * np.ones(steps)) for each in replays]
        again = replays[0].play(0, np.zeros((1, steps)), rows=np.arange(AGAIN)).peak[0]
        alarm = np.stack([each.first_alarm[1:] for each in found], axis=1)
        error = np.stack([each.error[:steps, 1:] for each in found], axis=2)
        quiet = [
            mask_valid_runs(replay.warmup_alarm[0], each.first_alarm[0])
            for replay, each in zip(replays, found, strict=True)
        ]
        above = error > limit
        crossing = np.where(above.any(axis=0), above.argmax(axis=0) + 1, 0)
        moved = undetected_displacement(error.reshape(steps, -1), alarm.ravel(), hold)
        return AgeProbe(
            age_s=np.array(ages),
            rate_mps=ramps[1:],
            counts=np.array(quiet),
            found=alarm > 0,
            crossed=crossing > 0,
            missed=(crossing > 0) & ((alarm == 0) | (alarm > crossing + hold)),
            displacement=moved.reshape(-1, *shape),
            threshold=np.array([each.threshold.mean() for each in replays]),
            sky=np.arange(len(starts)),
            alike=np.array(np.allclose(again, found[0].peak[0, :AGAIN], ALIKE)),
        )

    def report(self, results: Reader) -> dict[str, Any]:
        return self.conclude(results).as_dict()

    def conclude(self, results: Reader) -> Audit:
        """Audit of the detector."""
        found = {cell.key.split(" ")[0]: results[cell.key] for cell in self.cells()}
        every, played, limit = self.panels[2], self.panels[1], self.of.alert_limit_m
        worst = [(x.key, Protection.from_parts(*found[x.key][:2])) for x in self.of.families]
        score = DetectorScore(
            task=self.of.key,
            detector=self.label,
            alert_limit_m=limit,
            runs=played.runs,
            selection_runs=self.panels[0].runs,
            entropy=None,
            families=tuple(FamilyScore(key, False, limit, each) for key, each in worst),
            false_alarms=dict(found["false"].arrays),
            window_s=every.replay.epochs * every.replay.interval_s,
        )
        title = f"{every.runs} windows of {score.window_s:g} s of a log, alert limit {limit:g} m"
        audit = Audit(
            score=score,
            title=title,
            budget=self.of.budget,
            requested_per_hour=self.requested_per_hour,
            probe=AgeProbe(**found[AGES].arrays),
            floor_m=None,
            reference=None,
            cost_us=every.replay.cost_us,
            broken=self.broken,
        )
        write_attacks(self.of.folder, audit)
        return audit
