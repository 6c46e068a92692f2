"""Scores of detectors in a task of their own, on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from . import options as opt
from .app import print_json, print_written, progress


def protect(
    *,
    task: Annotated[str, Option(help="Task for detectors, as D1; see `spoofgym tasks`.")],
    detector: Annotated[list[str], Option(help=f"Detector, may be repeated. {opt.SPEC_HELP}")],
    family: Annotated[
        list[str] | None,
        Option(help="Family of attacks, may be repeated. Default: all of the task."),
    ] = None,
    seeds: Annotated[
        int, Option(min=2, max=opt.LARGEST_RUNS, help="Evaluation runs of every family.")
    ] = 400,
    selection_seeds: Annotated[
        int,
        Option(
            min=4, max=opt.LARGEST_RUNS, help="Runs that the attacks of a family are chosen on."
        ),
    ] = 96,
    out: Annotated[Path, Option(help="Folder of finished parts.")] = Path("results/detectors"),
    seed: opt.Seed = 0,
    threads: opt.Threads = None,
    jobs: opt.Processes = 1,
    backend: opt.Backend = "local",
    shard: opt.Shard = None,
    as_json: opt.Json = False,
) -> None:
    """Score detectors by the worst family of attacks of a task, most of which none has met."""
    from ..bench.experiments.calibration import calibrate_players
    from ..bench.experiments.protect import DetectorEvaluator, specify_detectors
    from ..bench.report.detector_page import build_scores_page
    from ..bench.report.page import write_page
    from ..bench.report.tasks import print_scores

    specs = opt.parse_specs(detector)
    evaluator = DetectorEvaluator(
        task, runs=seeds, selection_runs=selection_seeds, families=family or None, entropy=seed
    )
    world, entries = evaluator.worlds.world, specify_detectors(specs)
    calibrate_players(world, entries, threads=threads, progress=progress)
    found, where = evaluator.protections(specs), out / evaluator.task.key
    results = opt.finish_experiment(
        found, where, jobs=jobs, backend=backend, shard=shard, threads=threads
    )
    report = found.report(results)
    written = write_page(results.store, build_scores_page(results.store, report))
    if as_json:
        print_json(report["detectors"])
    else:
        print_scores(report["detectors"])
        print_written(written)
