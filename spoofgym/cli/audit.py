"""Audit of a detector, on the command line."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from ..core.registry import require
from . import options as opt
from .app import print_json, progress


def audit_(
    detector: Annotated[str, Argument(help=f"Detector; an .onnx file, too. {opt.SPEC_HELP}")],
    *,
    task: Annotated[
        list[str] | None,
        Option(help="Task for detectors, D1 to D3, may be repeated. Default: D1."),
    ] = None,
    budget: Annotated[
        str,
        Option(
            help="Size of all that is played: quick, standard or full, some 1, 3 or 12 minutes of "
            "a processor for a plain detector in D1."
        ),
    ] = "standard",
    family: Annotated[
        list[str] | None,
        Option(help="Family of attacks, may be repeated. Default: all of the task."),
    ] = None,
    runs: Annotated[
        int | None,
        Option(
            min=2,
            max=opt.LARGEST_RUNS,
            help="Evaluation runs of every family. Default: those of the budget.",
        ),
    ] = None,
    selection_runs: Annotated[
        int | None,
        Option(
            min=4,
            max=opt.LARGEST_RUNS,
            help="Runs that the attacks of a family are chosen on. Default: those of the budget.",
        ),
    ] = None,
    log: Annotated[
        Path | None,
        Option(
            help="Log of a receiver with the matrices of its filter, on whose clean windows it "
            "plays in place of a task; thresholds are those of its own windows."
        ),
    ] = None,
    out: Annotated[Path, Option(help="Folder of finished parts and of the worst attacks.")] = Path(
        "results/audit"
    ),
    seed: Annotated[
        int | None,
        Option(
            min=0,
            help="Seed of all runs. Default: drawn at the first audit into a folder, and printed.",
        ),
    ] = None,
    threads: opt.Threads = None,
    jobs: opt.Processes = 1,
    backend: opt.Backend = "local",
    shard: opt.Shard = None,
    as_json: opt.Json = False,
) -> None:
    """Say what the worst attack known does to a detector, and how sure that is; resumable.

    It is calibrated to 0.2 false alarms an hour first, unless it requests another rate and where
    that has not been done.  The last line is the answer.

    Examples: `spoofgym audit my_module:MyDetector --budget quick`;
    `spoofgym audit ewma:smoothing=0.2 --task D1 --task D2`.
    """
    from ..bench.experiments.audit import Auditor
    from ..bench.experiments.log_audit import LogAuditor
    from ..bench.report.audit import print_audits
    from ..bench.report.detector_page import build_scores_page
    from ..bench.report.page import write_page

    (spec,), found, written = opt.parse_specs([detector]), [], []
    tasks = ["D1"] if task is None else task
    sizes: Any = {"runs": runs, "selection_runs": selection_runs, "families": family or None}
    settings: Any = {**sizes, "entropy": seed, "threads": threads, "folder": out}
    auditors: list[Any] = [Auditor(key, budget, **settings) for key in dict.fromkeys(tasks)]
    if log is not None:
        for name, value in (("task", task), ("runs", runs), ("selection-runs", selection_runs)):
            require(not value, f"--{name} does not go with --log, whose windows are the runs")
        own = {name: settings[name] for name in ("families", "threads", "folder")}
        auditors = [LogAuditor(log, budget, **own)]
    say = partial(typer.echo, err=True)
    for auditor in auditors:
        cells = auditor.prepare(spec, progress, say)
        try:
            results = opt.finish_experiment(
                cells, auditor.folder, jobs=jobs, backend=backend, shard=shard, threads=threads
            )
        except typer.Exit:  # a shard that leaves cells to others; the next task has its own
            continue
        found.append(cells.conclude(results))
        scores = {"detectors": [found[-1].as_dict()]}
        page = build_scores_page(results.store, scores)
        written.append(write_page(results.store, page)[-1])
    if not found:
        return
    if as_json:
        print_json([each.as_dict() for each in found])
    else:
        print_audits(found, written)
