"""Score of any spoofer by the benchmark's rule, without a campaign and its folder."""

from __future__ import annotations

import hashlib
from contextlib import nullcontext
from functools import cached_property
from typing import Any

from ...core.progress import NullProgress, ProgressCallback, show_on_terminal
from ...core.registry import check_keywords, whole_number
from ...spoofers.scaled import AMPLITUDE, Scaled
from ...tasks import get_task
from ..runs.panel import Panel, PanelAttack
from ..runs.players import FITTED, PlayerSpec, refuse_oracles, specify_detector, specify_policy
from ..runs.record import MEASURES
from ..runs.world import WORLD, World, read_training_world
from ..scores import statistics
from ..scores.scores import score_stealth, select_clusters
from ..scores.spoofer import SpooferScore
from ..search.amplitude import EXACT, UPPER_LIMIT, Tuning, TuningResult, search_work, with_rates
from ..search.bounds import DisplacementBounds
from ..search.open_loop import Optima, fit

RUNS = 400
"""Evaluation runs by default."""
FIT_RUNS = 128
"""Training runs by default, on which amplitudes are fitted."""
SIFTED = 16
"""Share of the training runs that sift the amplitudes, as one in so many."""


def get_rule(task: str | None) -> str:
    """How amplitudes are fitted to the budget: of a task its own, else exactly."""
    return EXACT if task is None else get_task(task).rule


class Evaluator:
    """Scores spoofers on the same runs; their warm-up and clean twins are simulated once.

    Its arguments are those of `evaluate`, but for the spoofer's. Trainings choose by it, so that
    amplitudes are fitted on training runs unless another rule is given.

    Examples
    --------
    >>> from spoofgym.bench.experiments.evaluate import Evaluator
    >>> times = {"warmup_s": 8, "live_s": 5, "attack_s": 10, "time_to_alert_s": 2}
    >>> world = {"scenario": "zhong2025", "timeline": times}
    >>> detector = {"name": "snapshot-chi2", "thresholds": "nominal"}
    >>> judge = Evaluator(detector=detector, runs=4, fit_runs=80, **world)
    >>> ramp = judge.score({"name": "ramp", "rate_mps": 0.1})
    >>> ramp.runs, ramp.knowledge
    (4, 'blind')
    """

    def __init__(
        self,
        task: str | None = None,
        *,
        runs: int = RUNS,
        fit_runs: int = FIT_RUNS,
        rule: str = UPPER_LIMIT,
        entropy: int = 0,
        threads: int | None = None,
        device: str = "cpu",
        progress: ProgressCallback | None = None,
        **world: Any,
    ) -> None:
        detector = world.pop("detector", None) if task is None else get_task(task).detector
        check_keywords("evaluate", world, (*WORLD, "env", "settings"))
        self.world = World.of(task, **world)
        self.detector = specify_detector(self.world.detector if detector is None else detector)
        refuse_oracles((self.detector,))
        fit_runs = whole_number("`fit_runs`", fit_runs, statistics.fewest_runs(statistics.BUDGET))
        self.runs = whole_number("`runs`", runs, 2)
        self.entropy = whole_number("`entropy`", entropy)
        self.tuning = Tuning(runs=fit_runs, sift_runs=max(fit_runs // SIFTED, 1), rule=rule)
        self.task, self.threads, self.device = task, threads, device
        self.progress = progress or NullProgress()
        self.world.check_fit([self.detector])
        self._panels: dict[tuple[str, tuple[type, ...]], Panel] = {}

    @cached_property
    def optima(self) -> Optima:
        brackets = DisplacementBounds(self.world, [self.detector], self.entropy)
        return Optima(brackets, self.tuning, threads=self.threads, device=self.device)

    def _panel(self, split: str, entry: PlayerSpec) -> Panel:
        """Runs of a split, shared by all spoofers that need the same to be watched."""
        watched = self.world.watched_for([entry])
        key = split, tuple(map(type, watched))
        if key not in self._panels:
            runs = self.tuning.runs if split == "training" else self.runs
            self.progress.advance(0.0, f"{self.detector.label}: {split} runs")
            judges = [self.detector.build()]
            rngs = lambda: self.world.generators(self.entropy, split, runs)  # noqa: E731
            known = self.world.setup, judges, rngs, self.threads, watched, self.device
            self._panels[key] = Panel(*known)
        return self._panels[key]

    def _fit_player(self, entry: PlayerSpec) -> TuningResult:
        panel = self._panel(self.tuning.split, entry)
        now = f"{self.detector.label}: tuning {entry.label}"
        tick = lambda work: self.progress.advance(work, now)  # noqa: E731
        optima = lambda: self.optima  # noqa: E731
        return next(fit(panel, {0: self.detector}, entry, self.tuning, optima, tick))

    def fit(self, policy: Any, *, knowledge: str | None = None) -> TuningResult:
        """Fit the amplitude of a spoofer on the training runs; its `score` is of these."""
        return self._fit_player(specify_policy(policy, FITTED, knowledge))

    def check(self, policy: Any) -> None:
        """Raise where a spoofer, in text or a file, does not fit this world, before it plays."""
        self.world.check_fit([self.detector], [specify_policy(policy, FITTED)])

    def score(
        self,
        policy: Any,
        *,
        amplitude: float | str | None = FITTED,
        knowledge: str | None = None,
        label: str | None = None,
        largest_amplitude: float | None = None,
    ) -> SpooferScore:
        """Score of one spoofer on the evaluation runs, as `evaluate` returns it."""
        return self.play(specify_policy(policy, amplitude, knowledge, label, largest_amplitude))

    def expect_work(self, entry: PlayerSpec) -> float:
        """Runs that a score takes, roughly."""
        searched = search_work(self.tuning, self.runs, curves=entry.needs_search)
        return self.runs + (0.0 if entry.tuned is None else searched)

    def play(self, entry: PlayerSpec) -> SpooferScore:
        """Score of one spoofer, as `score` has specified it."""
        setting, spec, within, value = entry.tuned, entry.fixed_spec, None, None
        exact: dict[str, Any] | None = None
        if setting is not None:
            found = self._fit_player(entry)
            if found.found is not None:
                entry = with_rates(entry, found.found["played"]["rates_mps"])
            spec, within, value = entry.with_value(found.value), found.within_budget, found.value
            exact = found.at_budget
        elif isinstance(entry.thing, Scaled):
            setting, value = AMPLITUDE, entry.thing.amplitude
        panel, now = self._panel("evaluation", entry), f"{entry.label}: evaluation runs"
        tick = lambda work: self.progress.advance(work, now)  # noqa: E731
        (attacked,) = panel.play([(PanelAttack(spec, self.runs), 0)], drop=False, tick=tick)
        record = panel.record(0, attacked, {})
        moved, counts = record.displacement_m, record.counts
        stealth = score_stealth(moved, record.alarmed, counts)
        samples = statistics.draw_resamples(select_clusters(record.sky)[counts])
        budget, mean = self.tuning.budget, statistics.bootstrap_mean(moved[counts], samples)
        return SpooferScore(
            task=self.task,
            world=self.world.title,
            detector=self.detector.label,
            spoofer=entry.label,
            knowledge=entry.build().knowledge,
            setting=setting,
            value=value,
            runs=self.runs,
            counted=stealth.runs,
            stealthy_displacement_m=mean
            if exact is None
            else statistics.Estimate.of(exact[MEASURES[0]]),
            alarm_rate=statistics.wilson(stealth.alarms, stealth.runs),
            clean_alarm_rate=float((panel.twin_alarm[:, 0] > 0).mean()),
            budget=budget,
            within_budget=exact is not None or stealth.seems_to_keep(budget),
            fit_within_budget=within,
            displacement_m=moved,
            alarmed=record.alarmed,
            counts=counts,
            sky=record.sky,
            at_budget=exact,
            twins=hashlib.sha256(panel.clean[0].position.tobytes()).hexdigest(),
        )


def evaluate(
    policy: Any,
    task: str | None = None,
    *,
    runs: int = RUNS,
    fit_runs: int = FIT_RUNS,
    amplitude: float | str | None = FITTED,
    knowledge: str | None = None,
    label: str | None = None,
    largest_amplitude: float | None = None,
    rule: str | None = None,
    entropy: int = 0,
    threads: int | None = None,
    device: str = "cpu",
    progress: ProgressCallback | None = None,
    **world: Any,
) -> SpooferScore:
    """Score a spoofer by the rule of the benchmark.

    A policy that is shipped, or another one in a file, may have been chosen with these very runs in
    view; its card says so (``decided_on``, `spoofgym list`).  Then take another `entropy`.

    The score is the stealthy displacement: the mean undetected displacement over the runs that are
    silent before the onset and without an attack, of which at most 5 % may alarm.  The amplitude of
    the commands is fitted to that, and the interval includes the fit.

    Parameters
    ----------
    policy : object
        A model of stable-baselines3, with the ``VecNormalize`` of its environment folded in, which
        a model that was loaded has only if it was given ``env=`` (else it is refused); a torch
        module; a function of (B, o) observations that returns (B, a) actions; a `Spoofer`;
        its name, or name and settings; or the path of an ``.onnx`` file with its card.
    task : str, optional
        ``"S1"`` to ``"S3"``, or ``"T1"`` to ``"T6"``.
    runs : int
        Evaluation runs. By the rule ``"exact"`` they decide the amplitude, else nothing.
    fit_runs : int
        Training runs, on which an amplitude is fitted by the upper limit; at least 59, since fewer
        can't show that a budget of 5 % is met.  With more of them scores of other runs lie closer
        together, and every spoofer gets farther: 128 allow 2 alarms, 1024 allow 39.
    amplitude : {"fitted"}, float or None
        Factor on all commands, fitted by default; None for the commands as they are.  A scripted
        spoofer by its name alone has its usual setting fitted, as a ramp its rate.
    knowledge : str, optional
        What a model observes: by default what the environment that it has been trained in gave it,
        ``"blind"`` where none is known.
    label : str, optional
        Name of a model in the score.
    largest_amplitude : float, optional
        Of a model whose amplitude is fitted, the largest one that is tried; 10 by default.  A
        network that has not learned answers by some hundredths, and needs a thousand.
    rule : {"exact", "upper-limit"}, optional
        Whether an amplitude is fitted to exactly the budget on the evaluation runs, where the
        interval includes the fit and the threshold, and `fit_runs` only say how many runs sift; or
        the upper 95 % limit of the alarm rate keeps the budget on the training runs, a pass mark.
        By default exact, and the upper limit in the tasks of the first suite.
    entropy : int
        Seed of all runs.
    threads : int, optional
        Threads of the engine.
    device : str
        Where the engine plays: ``"cpu"``, or a GPU such as ``"cuda"``, with the same bits, for
        what there is on a device.
    progress : ProgressCallback, optional
        Shows how far it is; by default a bar does where stderr is a terminal.
    **world
        Without a task: ``detector``, ``env``, the id of an environment, and what differs from its
        settings, such as ``scenario``, ``receiver``, ``attack``, ``timeline`` and ``domain``; all
        others, such as ``basis``, are a mapping ``settings``, in which None replaces a setting of
        the id by the victim's default.  With none of them but the detector it is the world that
        the model was trained in, as its environment or its card says, and for a scripted spoofer
        ``spoofgym/TightlyCoupled-v0``.  With a ``scenario`` and no ``env`` all else has the
        defaults of the victim.

    Returns
    -------
    Score
        Also whether the budget is met; a displacement over it is no score.

    Raises
    ------
    TypeError
        When the policy is something else.
    ValueError
        When it does not fit the task, returns NaN or infinity, remembers, or is a pickled file; or
        the rate of false alarms requested of the detector is one it is not calibrated for here; the
        message has the command that does so.

    Examples
    --------
    >>> import numpy as np
    >>> import spoofgym
    >>> times = {"warmup_s": 8, "live_s": 5, "attack_s": 10, "time_to_alert_s": 2}
    >>> world = {"scenario": "zhong2025", "timeline": times}
    >>> detector = {"name": "snapshot-chi2", "thresholds": "nominal"}
    >>> score = spoofgym.evaluate(
    ...     lambda seen: np.full((len(seen), 1), 0.1), detector=detector, runs=4, amplitude=None,
    ...     label="mine", **world
    ... )
    >>> score.spoofer, score.runs, score.keeps_budget
    ('mine', 4, True)
    """
    if task is None and not {*world} - {"detector"}:
        world = {**read_training_world(policy), **world}
    sizes: dict[str, Any] = {"runs": runs, "fit_runs": fit_runs, "threads": threads}
    how: dict[str, Any] = {"rule": rule or get_rule(task), "device": device, **sizes}
    judge = Evaluator(task, entropy=entropy, **how, **world)
    entry = specify_policy(policy, amplitude, knowledge, label, largest_amplitude)
    show = show_on_terminal if progress is None else lambda _: nullcontext(progress)
    with show(judge.expect_work(entry)) as judge.progress:
        return judge.play(entry)
