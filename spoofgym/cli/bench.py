"""Spoofgym bench."""

from __future__ import annotations

import functools
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import options as opt
from .options import (
    ENV,
    SCENARIO_OPTIONS,
    SUITE_OPTIONS,
    TASK_OPTIONS,
    TIMES,
    World,
    calibrate_with_progress,
    specs_of,
    with_world,
)
from .output import print_json, print_lines, print_table, progress

if TYPE_CHECKING:
    from datetime import date

    from ..bench.experiments.campaign import CampaignResults
    from ..bench.experiments.suite import Suite
    from ..bench.runs.players import PlayerSpec
    from ..bench.runs.world import World as Played
    from ..bench.search.amplitude import Tuning, TuningResult
    from ..bench.search.attack_suite import Selection
    from ..core.progress import ProgressCallback
    from ..core.registry import Spec
    from ..truth.scenario import Scenario

OPTIONS_OF = {
    "scenario": ("scenario", "errors", "imu", "track", "ephemeris"),
    "receiver": ("tuning",),
    "timeline": TIMES,
}
"""Options that make settings of the victim, which `--set` may give in their place."""
LEFT_OUT = " is left out: "
"""In a note, between the label of a detector and the reason."""
Reports = dict[str, Any] | None
"""Of real input, as `RealInput` has them."""


def suite_of(
    world: World,
    detectors: Sequence[str] | None,
    *,
    task: str | None = None,
    named: str | None = None,
    asked: Spec | None = None,
    threads: int | None = None,
    headline: bool = False,
    **settings: Any,
) -> tuple[Suite, Reports]:
    """The suite of the options, of a task or by name, calibrated, and the reports of real input.

    `threads`: of the calibration; all else as of `uncalibrated`.
    """
    if named is not None:
        return calibrated(standard_suite(detectors, settings), detectors, threads), None
    given: dict[str, Any] = {"task": task, "asked": asked, "headline": headline, **settings}
    suite, reports = uncalibrated(world, detectors, **given)
    return calibrated(suite, detectors, threads), reports


def calibrated(suite: Suite, detectors: Sequence[str] | None, threads: int | None) -> Suite:
    """A suite whose detectors all have thresholds; of `all`, those that can't are left out."""
    # of what `all` means, those without a calibration are left out
    given = {spec["name"] for spec in specs_of(detectors)} if detectors else {"all"}
    labels = [entry.label for entry in suite.detector_entries if entry.spec["name"] not in given]
    optional = labels if "all" in given else ()
    refused = calibrate_with_progress(suite.world, suite.detector_entries, threads, optional)
    if refused:
        kept = [e.spec for e in suite.detector_entries if e.label not in refused]
        notes = (*suite.notes, *(f"{label}{LEFT_OUT}{why}" for label, why in refused.items()))
        suite = replace(suite, detectors=kept, notes=notes)
    suite.check_fit()
    return suite


def uncalibrated(
    world: World,
    detectors: Sequence[str] | None,
    *,
    task: str | None = None,
    asked: Spec | None = None,
    headline: bool = False,
    **settings: Any,
) -> tuple[Suite, Reports]:
    """The suite of the options or of a task, and the reports of real input; nothing is looked up.

    `asked`: of the thresholds of detectors that ask for none of their own, by default nothing;
    `headline`: whether there are negative controls, and a drawn world, where nothing else is asked
    for; `settings`: those of a suite that no task decides.
    """
    from ..bench.experiments.suite import Suite
    from ..tasks import SUITE, task_of

    reports = None
    if task is None:
        decided, reports = _victim(world)
        specs = specs_of(detectors) if detectors else None
        if headline:
            specs = _with_controls(world, specs, "false_alarms_per_hour" in (asked or {}))
            if world.env == ENV and world.track is None and "domain" not in decided["settings"]:
                from ..bench.runs.world import HEADLINE_DOMAIN

                decided["domain"] = HEADLINE_DOMAIN
        decided["detectors"] = specs if asked is None else _asking(world, specs, asked)
    else:
        refuse_decided(world, "--task", TASK_OPTIONS)
        chosen = task_of(task)
        notes = (f"task {chosen.key} of {SUITE}: {chosen.title}",)
        decided = {**chosen.suite_kwargs, "notes": notes}
    return Suite(**decided, **settings), reports


def refuse_decided(world: World, option: str, names: Collection[str]) -> None:
    """Raise where an option is given that another one decides."""
    from ..core.registry import refuse_given

    refuse_given(option, world.given(names).values())


def standard_players(
    world: World, name: str, sizes: Mapping[str, int]
) -> tuple[list[str], dict[str, int]]:
    """Spoofers of a suite by its name, and its sizes but for those that are given.

    Raises where there is no such suite, or where an option is given that it decides.
    """
    from ..bench.experiments.suite import SIZES, SPOOFERS, SUITES
    from ..core.registry import check_choice

    check_choice("suite", name, SUITES)
    refuse_decided(world, "--suite", SUITE_OPTIONS)
    given = world.given(SIZES)
    return list(SPOOFERS), {**SIZES, **{key: sizes[key] for key in given}}


def standard_suite(detectors: Sequence[str] | None, settings: dict[str, Any]) -> Suite:
    """The standard suite, with all detectors, or with those that are given and the controls."""
    from ..bench.experiments.suite import RATE, TASK, Suite, everyone_in, in_order, standard_kwargs
    from ..bench.runs.world import CONTROLS
    from ..bench.runs.world import World as Played

    if detectors is None:
        whom = in_order(everyone_in(Played.of(TASK).setup, rescaled=True))
    else:
        given = specs_of(detectors)
        names = {spec["name"] for spec in given}
        whom = [*(dict(spec) for spec in CONTROLS if spec["name"] not in names), *given]
    specs = [{"false_alarms_per_hour": RATE, **spec} for spec in whom]
    return Suite(**standard_kwargs(), detectors=specs, **settings)


def world_of(world: World, task: str | None = None) -> Played:
    """The world of the options, or of a task."""
    from ..bench.runs.world import World as Played

    if task is not None:
        refuse_decided(world, "--task", World.__dataclass_fields__)
        return Played.of(task)
    decided = _victim(world)[0]
    decided.pop("notes", None)
    return Played.of(**decided)


def at_rate(false_alarms_per_hour: float | None) -> Spec | None:
    """What an option asks of the thresholds; None for nothing."""
    if false_alarms_per_hour is None:
        return None
    return {"false_alarms_per_hour": false_alarms_per_hour}


def _asking(world: World, specs: list[dict[str, Any]] | None, asked: Spec) -> list[dict[str, Any]]:
    """Detectors that are asked for some thresholds, but for those that ask for others."""
    from ..bench.runs.world import VICTIMS
    from ..core.registry import check_choice
    from ..detectors.build import asks

    check_choice("environment of the benchmark", world.env, VICTIMS)
    named = list(VICTIMS[world.env].detectors) if specs is None else specs
    free = [not asks(spec) or spec.get("thresholds") == "rescaled" for spec in named]
    return [{**asked, **spec} if any_ else spec for spec, any_ in zip(named, free, strict=True)]


def _with_controls(
    world: World, specs: list[dict[str, Any]] | None, rescaled: bool
) -> list[dict[str, Any]]:
    """Detectors of a headline: the usual ones and the controls by default, `all` for all.
    `rescaled`: whether tests with a drift term are among all a second time, rescaled."""
    from ..bench.experiments.suite import everyone_in
    from ..bench.runs.world import CONTROLS, VICTIMS
    from ..core.registry import check_choice

    check_choice("environment of the benchmark", world.env, VICTIMS)
    if specs is None:
        return [*CONTROLS, *VICTIMS[world.env].detectors]
    if not any(spec["name"] == "all" for spec in specs):
        return specs
    named = [spec for spec in specs if spec["name"] != "all"]
    given = {spec["name"] for spec in named}
    found = everyone_in(world_of(world).setup, rescaled)
    return [*named, *(spec for spec in found if spec["name"] not in given)]


def tuning_of(runs: int, budget: float) -> Tuning:
    """A search on so many training runs, of which a sixteenth sifts."""
    from ..bench.search.amplitude import Tuning

    try:
        return Tuning(runs=runs, sift_runs=max(runs // 16, 1), budget=budget)
    except ValueError as error:  # it knows its fields, not the options
        text = str(error).replace("`tuning.runs`", "--training-seeds")
        raise ValueError(text.replace("`tuning.budget`", "--budget")) from error


def selection_of(runs: int) -> Selection | None:
    """A search for the worst attack on so many runs, of which a quarter sifts; None for none."""
    from ..bench.search.attack_suite import Selection

    return Selection(runs=runs, sift_runs=max(runs // 4, 1)) if runs else None


def untuned(suite: Suite) -> PlayerSpec:
    """The suite's own spoofer, which has to know all its settings."""
    player = suite.spoofer_entries[-1]
    if player.tuned:
        raise ValueError(
            f"`{player.tuned}` = tuned needs a search: take the value that `spoofgym tune` finds"
        )
    return player


def _victim(world: World) -> tuple[dict[str, Any], Reports]:
    """Environment and settings of the options, notes, and the reports of real input."""
    decided, reports = _options(world)
    decided["settings"] = own = _settings(world.settings or ())
    for name in {*own} & {*decided}:
        if not world.given(OPTIONS_OF.get(name, (name,))):
            del decided[name]  # its option has its default
    return decided, reports


def _options(world: World) -> tuple[dict[str, Any], Reports]:
    """Environment and settings that have options of their own, and the reports of real input."""
    if world.env != ENV:
        for option in world.given(SCENARIO_OPTIONS).values():
            raise ValueError(
                f"{option} is an option of {ENV}, not of {world.env}, whose settings are "
                "given with --set"
            )
        times = {name: getattr(world, name) for name in world.given(TIMES)}
        return {"env": world.env, **({"timeline": times} if times else {})}, None
    scenario, lines, reports = _scenario(world)
    (attack,) = specs_of([world.attack])
    return {
        "env": world.env,
        "scenario": scenario,
        "receiver": {"tuning": world.tuning},
        "attack": attack,
        "timeline": {name: getattr(world, name) for name in TIMES},
        "notes": lines,
    }, reports


def _scenario(world: World) -> tuple[Scenario, tuple[str, ...], Reports]:
    """The scenario, and the lines and reports of real input."""
    from ..truth.scenario import make_scenario

    (spec,) = specs_of([world.scenario])
    own = {"errors": world.errors, "imu": world.imu}
    named = {**spec, **{name: value for name, value in own.items() if value is not None}}
    if world.track is None and world.ephemeris is None:
        cuts = {"--from": world.from_s, "--duration": world.duration, "--date": world.day}
        for option, value in cuts.items():
            if value is not None:
                raise ValueError(f"{option} cuts a recorded track; there is no --track")
        return make_scenario(named), (), None
    if world.track is None or world.ephemeris is None:
        raise ValueError("--track and --ephemeris belong together: a flight needs its satellites")
    from ..data.recorded import real_scenario

    usual = make_scenario(named)
    kept = ("errors", "imu", "epoch_interval_s", "channels", "mask_deg", "imu_rate_hz")
    real = real_scenario(
        world.track,
        world.ephemeris,
        from_s=world.from_s,
        duration_s=world.duration,
        day=None if world.day is None else _day(world.day),
        **{name: getattr(usual, name) for name in kept},
    )
    return real.scenario, real.lines, real.reports


def _day(text: str) -> date:
    from datetime import date

    try:
        return date.fromisoformat(text)
    except ValueError as error:
        raise ValueError(f"--date must be YYYY-MM-DD, got {text!r}") from error


def _settings(texts: Sequence[str]) -> dict[str, Any]:
    from ..core.registry import parse_setting

    found: dict[str, Any] = {}
    for name, value in map(parse_setting, texts):
        if name in found:
            raise ValueError(f"--set {name} is given twice: {found[name]!r} and {value!r}")
        found[name] = value
    return found


NO_BOUND = "No zero-alarm bound of {}."


@with_world
def tune(
    *,
    detector: Annotated[
        list[str] | None, typer.Option(help=f"Detector, may be repeated. {opt.SPEC_HELP}")
    ] = None,
    spoofer: Annotated[
        list[str] | None,
        typer.Option(help="Spoofer, may be repeated: ramp, accelerating-ramp, step, or your own."),
    ] = None,
    budget: opt.Budget = 0.05,
    training_seeds: opt.Training = 1024,
    as_json: opt.Json = False,
    world: World,
    seed: opt.Seed = 0,
    allow_oracles: opt.Oracles = False,
    false_alarms_per_hour: opt.Rate = None,
    threads: opt.Threads = None,
) -> None:
    """Find the strongest ramp that keeps to an alarm budget, on training runs."""
    from ..bench.report.table import tuning_head, tuning_rows
    from ..bench.runs.panel import Panel
    from ..bench.runs.players import TUNED
    from ..bench.search.amplitude import fit, search_work
    from ..spoofers import make_spoofer
    from ..spoofers.scaled import AMPLITUDE

    specs = specs_of(spoofer or ["ramp", "accelerating-ramp"])
    for spec in specs:
        untuned = {key: value for key, value in spec.items() if value != TUNED}
        spec[make_spoofer(untuned).tunable or AMPLITUDE] = TUNED
    suite, _ = suite_of(
        world,
        detector,
        spoofers=specs,
        entropy=seed,
        tuning=tuning_of(training_seeds, budget),
        allow_oracles=allow_oracles,
        threads=threads,
        asked=at_rate(false_alarms_per_hour),
    )
    if not as_json:
        print_lines((*suite.notes, *suite.captions))
    entries = [entry for entry in suite.spoofer_entries if entry.tuned]
    each = 2.0 * suite.tuning.runs + len(entries) * search_work(suite.tuning)
    results: list[TuningResult] = []
    optima, watched = suite.optima(), suite.world.watched_for(entries)
    rngs = lambda: suite.generators("training", suite.tuning.runs)  # noqa: E731
    with progress(each * len(suite.detector_entries)) as bar:
        for judge in suite.detector_entries:
            judges = [judge.build()]
            panel = Panel(suite.world.setup, judges, rngs, threads, watched)
            for entry in entries:
                now = f"{judge.label}: tuning {entry.label}"
                tick = functools.partial(_advance, bar, now)
                results += fit(panel, {0: judge}, entry, suite.tuning, lambda: optima, tick)
    if as_json:
        print_json([result.as_dict() for result in results])
        return
    for result in results:
        table = result.as_dict()
        print_table(
            f"{result.spoofer} against {result.detector}: P(alarm | silent twin) at most "
            f"{100 * budget:g} %, by its upper limit on the {result.counted} of {result.runs} "
            "training runs that count; fewer only sift, by the rate itself",
            tuning_head(table),
            tuning_rows(table),
        )
        if not result.within_budget:
            typer.echo(f"nothing is within the budget; the smallest value is {result.value:g}")


@with_world
def bench(
    *,
    task: Annotated[
        str | None,
        typer.Option(
            help="Task of spoofgym-bench-v1, T1 to T6, which sets scenario, receiver, attack, "
            "times and detectors; see `spoofgym tasks`."
        ),
    ] = None,
    suite_name: Annotated[
        str | None,
        typer.Option(
            "--suite",
            help="Suite by name: `standard` plays every detector that suits the world of task T3 "
            "at 0.2 false alarms an hour against five spoofers, in a quarter of an hour on two "
            "idle cores; with --detector those that are named, such as your own, and the negative "
            "controls. It decides all but detectors, seeds, sizes and folder.",
        ),
    ] = None,
    detector: Annotated[
        list[str] | None,
        typer.Option(
            help="Detector, may be repeated; `all` for all that suit the victim. Default: "
            "snapshot-chi2 and ewma, or those that suit the victim, and the negative controls "
            f"never and lottery. {opt.SPEC_HELP}"
        ),
    ] = None,
    spoofer: Annotated[
        list[str] | None,
        typer.Option(
            help="Spoofer, may be repeated. One setting is fitted to the alarm budget: that which "
            "is `tuned`, as in step:size_m=tuned, the rate of a plain ramp, and else the amplitude "
            "of all that it commands, unless one is given, as in step:amplitude=1. A shipped "
            "spoofer by its name, a learned one by its .onnx file. Default: none, step, ramp, "
            "accelerating-ramp, blind-optimum, and the shipped ones that fit."
        ),
    ] = None,
    seeds: Annotated[
        int,
        typer.Option(
            min=2, max=opt.LARGEST_RUNS, help="Evaluation runs of every cell, the same for all."
        ),
    ] = 1000,
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("results"),
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the results of another campaign.")
    ] = False,
    as_json: opt.Json = False,
    world: World,
    budget: opt.Budget = 0.05,
    training_seeds: opt.Training = 256,
    seed: opt.Seed = 0,
    allow_oracles: opt.Oracles = False,
    false_alarms_per_hour: opt.Rate = None,
    nominal: Annotated[
        bool,
        typer.Option(
            "--nominal",
            help="Play thresholds as published and nothing else: no calibration, and no comparison "
            "of detectors, whose rates of false alarms differ. A task does so anyway.",
        ),
    ] = False,
    selection_seeds: Annotated[
        int,
        typer.Option(
            min=0,
            max=opt.LARGEST_RUNS,
            help="Runs on which the worst attack of the attack suite is chosen; 0 to leave the "
            "protection out.",
        ),
    ] = 192,
    threads: opt.Threads = None,
    jobs: opt.Jobs = None,
    backend: opt.Backend = "local",
    shard: opt.Shard = None,
) -> None:
    """Play detectors against spoofers on the same runs; interrupted, it goes on when run again.

    All detectors are calibrated to one rate of false alarms, 0.2 an hour unless another one is
    given, in a world whose sky, heading, onset and turn-on constants of the sensors are drawn for
    every run, unless --set domain=... says otherwise.
    """
    from ..bench.experiments.campaign import Campaign
    from ..detectors.calibrated import STANDARD_RATE
    from ..simulation.engine import processors

    sizes = {"seeds": seeds, "training_seeds": training_seeds, "selection_seeds": selection_seeds}
    if suite_name is not None:
        spoofer, sizes = standard_players(world, suite_name, sizes)
    if nominal and false_alarms_per_hour is not None:
        raise ValueError("--nominal and --false-alarms-per-hour can't both be given")
    rate = STANDARD_RATE if false_alarms_per_hour is None else false_alarms_per_hour
    spoofers = _tuned_by_default(specs_of(spoofer)) if spoofer else None
    suite, reports = suite_of(
        world,
        detector,
        task=task,
        named=suite_name,
        spoofers=spoofers,
        runs=sizes["seeds"],
        entropy=seed,
        tuning=tuning_of(sizes["training_seeds"], budget),
        allow_oracles=allow_oracles,
        threads=threads,
        asked={"thresholds": "nominal"} if nominal else at_rate(rate),
        headline=task is None,
        selection=selection_of(sizes["selection_seeds"]),
    )
    campaign = Campaign(suite)
    at_once = jobs or (processors() if suite_name else 1)
    if not as_json:
        print_lines((*(() if task else suite.notes), *suite.captions, *suite.left_out))
    settings: dict[str, Any] = {"jobs": at_once, "backend": backend, "shard": shard}
    results = opt.finished(campaign, out, threads=threads, overwrite=overwrite, **settings)
    _report(campaign.results(results), as_json, reports)


def report(
    folder: Annotated[Path, typer.Argument(help="Folder of the results.")] = Path("results"),
    as_json: opt.Json = False,
) -> None:
    """Score the finished cells of a folder again, with table and picture."""
    from ..bench.experiments.campaign import CampaignResults

    _report(CampaignResults.load(folder), as_json, None)


def _tuned_by_default(specs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Every spoofer with an amplitude that is fitted, unless one is given."""
    from ..bench.runs.players import fitted

    return [fitted(spec) for spec in specs]


def _advance(bar: ProgressCallback, now: str, work: float) -> None:
    bar.advance(work, now)


def _report(results: CampaignResults, as_json: bool, reports: Reports) -> None:
    """Write table, scores and picture, and print the tables."""
    from ..bench.experiments.campaign import SUMMARY, TABLE, summarize
    from ..bench.report import table as tables
    from ..bench.report.bounds import bound_notes, floor_notes
    from ..bench.report.campaign import markdown
    from ..bench.report.figures import draw_campaign

    summary, store = summarize(results), results.store
    if not summary["cells"]:
        raise ValueError(f"{results.path} holds no finished cell yet")
    text = markdown(results, summary)
    written = [
        store.write(SUMMARY, (json.dumps(summary, indent=1, allow_nan=False) + "\n").encode()),
        store.write(TABLE, text.encode()),
    ]
    try:
        written.append(draw_campaign(results, summary))
    except ImportError as error:
        typer.echo(f"no picture: {error}", err=True)
    if as_json:
        print_json({**summary, "folder": str(results.path), "input": reports})
        return
    notes = (*floor_notes(summary), *map(NO_BOUND.format, bound_notes(summary)), "")
    for number, group in enumerate(tables.groups(summary)):
        name = f"{summary['scenario']}, {group.title}"
        rows = tables.detector_rows(summary, group)
        print_table(f"{name}: detectors", tables.DETECTORS_HEAD, rows)
        print_lines(() if number else notes)
        if rows := tables.attack_rows(summary, group):
            print_table(f"{name}: stealthy attacks", tables.ATTACKS_HEAD, rows, names=2)
        print_table(f"{name}: price", tables.CLEAN_HEAD, tables.clean_rows(summary, group))
    if summary["missing"]:
        typer.echo(f"not finished: {', '.join(summary['missing'])}")
    typer.echo(f"written: {', '.join(str(path) for path in written)}")
