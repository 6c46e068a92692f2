"""Scores of detectors in a task of their own, on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import options as opt
from .app import INTERRUPTED
from .output import print_json, progress
from .suites import calibrate_with_progress, specs_of


def protect(
    *,
    task: Annotated[str, typer.Option(help="Task for detectors, D1 to D4; see `spoofgym tasks`.")],
    detector: Annotated[
        list[str],
        typer.Option(help=f"Detector, may be repeated. {opt.SPEC_HELP}"),
    ],
    family: Annotated[
        list[str] | None,
        typer.Option(help="Family of attacks, may be repeated. Default: all of the task."),
    ] = None,
    seeds: Annotated[
        int, typer.Option(min=2, max=opt.LARGEST_RUNS, help="Evaluation runs of every family.")
    ] = 400,
    selection_seeds: Annotated[
        int,
        typer.Option(
            min=4, max=opt.LARGEST_RUNS, help="Runs that the attacks of a family are chosen on."
        ),
    ] = 96,
    out: Annotated[Path, typer.Option(help="Folder of finished parts.")] = Path(
        "results/detectors"
    ),
    seed: opt.Seed = 0,
    threads: opt.Threads = None,
    as_json: opt.Json = False,
) -> None:
    """Score detectors by the worst family of attacks of a task, most of which none has met."""
    from ..bench.experiments.protect import DetectorEvaluator
    from ..bench.experiments.task_worlds import entries_of
    from ..bench.report.tasks import print_scores

    specs = specs_of(detector)
    evaluator = DetectorEvaluator(
        task,
        runs=seeds,
        selection_runs=selection_seeds,
        families=family or None,
        entropy=seed,
        threads=threads,
        folder=out,
    )
    calibrate_with_progress(evaluator.worlds.world, entries_of(specs), threads)
    try:
        with progress(evaluator.expected_work(specs)) as bar:
            evaluator.progress = bar
            scores = evaluator.scores(specs)
    except KeyboardInterrupt:
        typer.echo(
            f"interrupted: finished parts are kept in {out}; the same command goes on from there",
            err=True,
        )
        raise typer.Exit(INTERRUPTED) from None
    paired = [score.difference_to(scores[0]).as_json() for score in scores]
    if as_json:
        print_json([{**s.as_dict(), "less_first": p} for s, p in zip(scores, paired, strict=True)])
        return
    print_scores(scores, paired)
