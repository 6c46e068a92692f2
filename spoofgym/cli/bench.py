"""Campaigns of detectors against spoofers, their scores, and the search for a strongest ramp."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from . import options as opt
from .app import INTERRUPTED
from .options import World, with_world
from .output import print_json, print_lines, print_table, progress
from .suites import at_rate, selection_of, specs_of, standard_players, suite_of, tuning_of

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
    from ..bench.campaign import search, training_start
    from ..bench.entries import TUNED, build_spoofer
    from ..bench.tuning_table import tuning_head, tuning_rows
    from ..bench.work import search_work
    from ..spoofers.scaled import AMPLITUDE

    specs = specs_of(spoofer or ["ramp", "accelerating-ramp"])
    for spec in specs:
        untuned = {key: value for key, value in spec.items() if value != TUNED}
        spec[build_spoofer(untuned).tunable or AMPLITUDE] = TUNED
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
    each = 2.0 * suite.tuning.runs + len(entries) * search_work(suite)
    results = []
    with progress(each * len(suite.detector_entries)) as bar:
        for judge in suite.detector_entries:
            start, clean = training_start(suite, judge, threads, bar)
            results += [search(suite, judge, entry, start, clean, bar) for entry in entries]
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
) -> None:
    """Play detectors against spoofers on the same runs; interrupted, it goes on when run again.

    All detectors are calibrated to one rate of false alarms, 0.2 an hour unless another one is
    given, in a world whose sky, heading, onset and turn-on constants of the sensors are drawn for
    every run, unless --set domain=... says otherwise.
    """
    from ..bench.campaign import run_campaign
    from ..bench.store import ResultsFolder
    from ..bench.work import expected_work
    from ..detectors.calibrated import STANDARD_RATE
    from ..simulators.engine import processors

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
    folder = ResultsFolder(out)
    folder.open(suite, overwrite=overwrite)
    at_once = jobs or (processors() if suite_name else 1)
    if not as_json:
        print_lines((*(() if task else suite.notes), *suite.captions, *suite.left_out))
    try:
        with progress(expected_work(suite, folder)) as bar:
            run_campaign(suite, folder, threads=threads, jobs=at_once, progress=bar)
    except KeyboardInterrupt:
        done = sum(
            folder.has_cell(judge.label, player.label)
            for judge in suite.detector_entries
            for player in suite.spoofer_entries
        )
        total = len(suite.detector_entries) * len(suite.spoofer_entries)
        typer.echo(
            f"interrupted: {done} of {total} cells are finished and kept in {out}; the same "
            "command goes on from there",
            err=True,
        )
        raise typer.Exit(INTERRUPTED) from None
    _report(folder, as_json, reports)


def report(
    folder: Annotated[Path, typer.Argument(help="Folder of the results.")] = Path("results"),
    as_json: opt.Json = False,
) -> None:
    """Score the finished cells of a folder again, with table and picture."""
    from ..bench.store import ResultsFolder

    _report(ResultsFolder(folder), as_json, None)


def _tuned_by_default(specs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Every spoofer with an amplitude that is fitted, unless one is given."""
    from ..bench.entries import fitted

    return [fitted(spec) for spec in specs]


def _report(folder: Any, as_json: bool, reports: Any) -> None:
    """Write table, scores and picture, and print the tables."""
    from ..bench import tables
    from ..bench.bracket_text import bound_notes, floor_notes
    from ..bench.picture import draw_campaign
    from ..bench.report import markdown
    from ..bench.store import SUMMARY, TABLE
    from ..bench.summary import summarize

    summary = summarize(folder)
    if not summary["cells"]:
        raise ValueError(f"{folder.path} holds no finished cell yet")
    written = [
        folder.put_text(SUMMARY, json.dumps(summary, indent=1, allow_nan=False) + "\n"),
        folder.put_text(TABLE, markdown(folder.config(), summary)),
    ]
    try:
        written.append(draw_campaign(folder, summary))
    except ImportError as error:
        typer.echo(f"no picture: {error}", err=True)
    if as_json:
        print_json({**summary, "folder": str(folder.path), "input": reports})
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
