"""Scores of detectors in a task of their own, on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from . import options as opt
from .options import calibrate_with_progress, specs_of
from .output import print_json, print_lines, print_table


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
    from ..bench.experiments.protect import DetectorEvaluator, entries_of

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
    if as_json:
        print_json(rows)
    else:
        _print(rows)


def _print(rows: list[dict[str, Any]]) -> None:
    """Print the scores, those by family, and the paired differences to the first detector."""
    from ..bench.report.tasks import DETECTOR_HEAD, detector_score_rows, family_rows

    first, card = rows[0], {"detectors": rows}
    task, limit, runs = (first[name] for name in ("task", "alert_limit_m", "runs"))
    print_table(
        f"{task}: P(HMI) at {limit:g} m, {runs} runs of every family",
        DETECTOR_HEAD[1:],
        [row[1:] for row in detector_score_rows({task: card})],
    )
    print_table(f"{task}: P(HMI) by family [%]", *family_rows(card))
    print_lines(
        f"{row['detector']} less {first['detector']}, paired: "
        f"{100.0 * (each['value'] or 0.0):+.1f} % of runs "
        f"({100.0 * (each['low'] or 0.0):+.1f} to {100.0 * (each['high'] or 0.0):+.1f})"
        for row in rows[1:]
        for each in (row["less_first"],)
    )
