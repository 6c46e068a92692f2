"""Scores of detectors in a task of their own, on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import options as opt
from .output import print_json
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
    jobs: opt.Processes = 1,
    backend: opt.Backend = "local",
    shard: opt.Shard = None,
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
    )
    calibrate_with_progress(evaluator.worlds.world, entries_of(specs), threads)
    found, where = evaluator.protections(specs), out / evaluator.task.key
    results = opt.finished(found, where, jobs=jobs, backend=backend, shard=shard, threads=threads)
    rows = found.report(results)["detectors"]
    (print_json if as_json else print_scores)(rows)
