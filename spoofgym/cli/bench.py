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
from .suites import specs_of, suite_of, tuning_of


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
    threads: opt.Threads = None,
) -> None:
    """Find the strongest ramp that keeps to an alarm budget, on training runs."""
    from ..bench.campaign import search, search_work, training_start
    from ..bench.entries import TUNED, build_spoofer
    from ..bench.tuning_table import tuning_head, tuning_rows

    specs = specs_of(spoofer or ["ramp", "accelerating-ramp"])
    for spec in specs:
        untuned = {key: value for key, value in spec.items() if value != TUNED}
        tunable = build_spoofer(untuned).tunable
        if tunable is None:
            raise ValueError(f"spoofer {spec['name']!r} has no setting to tune")
        spec[tunable] = TUNED
    suite, _ = suite_of(
        world,
        detector,
        spoofers=specs,
        entropy=seed,
        tuning=tuning_of(training_seeds, budget),
        allow_oracles=allow_oracles,
    )
    if not as_json:
        print_lines(suite.notes)
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
            f"{result.spoofer} against {result.detector}: alarm rate at most {100 * budget:g} % "
            f"above {100 * result.clean_alarm_rate:.1f} %, after a margin of {result.margin:g} "
            f"standard errors; {result.runs} training runs, fewer only sift, without a margin",
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
    detector: Annotated[
        list[str] | None,
        typer.Option(
            help="Detector, may be repeated. Default: snapshot-chi2 and ewma, or those that suit "
            f"the victim. {opt.SPEC_HELP}"
        ),
    ] = None,
    spoofer: Annotated[
        list[str] | None,
        typer.Option(
            help="Spoofer, may be repeated; a setting may be `tuned`, as in "
            "step:size_m=tuned, and a ramp without settings is; a shipped spoofer by its name, a "
            "learned one by its .onnx file. Default: none, step, ramp, accelerating-ramp, and the "
            "shipped ones that fit."
        ),
    ] = None,
    seeds: Annotated[
        int,
        typer.Option(
            min=2, max=opt.LARGEST_RUNS, help="Evaluation runs of every cell, the same for all."
        ),
    ] = 200,
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("results"),
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the results of another campaign.")
    ] = False,
    as_json: opt.Json = False,
    world: World,
    budget: opt.Budget = 0.05,
    training_seeds: opt.Training = 1024,
    seed: opt.Seed = 0,
    allow_oracles: opt.Oracles = False,
    threads: opt.Threads = None,
) -> None:
    """Play detectors against spoofers on the same runs; interrupted, it goes on when run again."""
    from ..bench.campaign import expected_work, run_campaign
    from ..bench.store import ResultsFolder

    spoofers = _tuned_by_default(specs_of(spoofer)) if spoofer else None
    suite, reports = suite_of(
        world,
        detector,
        task=task,
        spoofers=spoofers,
        runs=seeds,
        entropy=seed,
        tuning=tuning_of(training_seeds, budget),
        allow_oracles=allow_oracles,
    )
    folder = ResultsFolder(out)
    folder.open(suite, overwrite=overwrite)
    if not as_json:
        print_lines((*(() if task else suite.notes), *suite.left_out))
    try:
        with progress(expected_work(suite, folder)) as bar:
            run_campaign(suite, folder, threads=threads, progress=bar)
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
    """Names without settings as the benchmark plays them by default."""
    from ..bench.entries import DEFAULT_SPOOFERS

    usual = {spec["name"]: spec for spec in DEFAULT_SPOOFERS}
    return [usual.get(spec["name"], spec) if len(spec) == 1 else spec for spec in specs]


def _report(folder: Any, as_json: bool, reports: Any) -> None:
    """Write table, scores and picture, and print the tables."""
    from ..bench import tables
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
    head = tables.attacks_head(summary)
    print_table(f"{summary['scenario']}: attacks", head, tables.attack_rows(summary), names=2)
    if rows := tables.rival_rows(summary):
        print_table("spoofers compared, run by run", tables.RIVALS_HEAD, rows, names=2)
        print_lines(tables.reference_lines(summary))
    print_table("without attack", tables.CLEAN_HEAD, tables.clean_rows(summary))
    if summary["missing"]:
        typer.echo(f"not finished: {', '.join(summary['missing'])}")
    typer.echo(f"written: {', '.join(str(path) for path in written)}")
