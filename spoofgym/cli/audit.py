"""Audit of a detector or a spoofer, on the command line."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from . import options as opt
from .app import print_json, progress
from .options import with_options
from .suites import calibrate_suite, make_tuning

if TYPE_CHECKING:
    from ..bench.experiments import Experiment, Reader


@dataclass(frozen=True, kw_only=True)
class AuditOptions:
    """Options of an audit of either side."""

    task: Annotated[
        list[str] | None,
        Option(help="Task for detectors, D1 to D3, may be repeated. Default: D1."),
    ] = None
    budget: Annotated[
        str,
        Option(
            help="Size of all that is played: quick, standard or full, some 1, 3 or 12 minutes of "
            "a processor for a plain detector in D1."
        ),
    ] = "standard"
    family: Annotated[
        list[str] | None,
        Option(help="Family of attacks, may be repeated. Default: all of the task."),
    ] = None
    runs: Annotated[
        int | None,
        Option(
            min=2,
            max=opt.LARGEST_RUNS,
            help="Evaluation runs of every family, or of a spoofer. Default: those of the budget.",
        ),
    ] = None
    selection_runs: Annotated[
        int | None,
        Option(
            min=4,
            max=opt.LARGEST_RUNS,
            help="Runs that the attacks of a family are chosen on. Default: those of the budget.",
        ),
    ] = None
    out: Annotated[Path, Option(help="Folder of finished parts and of the worst attacks.")] = Path(
        "results/audit"
    )
    seed: Annotated[
        int | None,
        Option(
            min=0,
            help="Seed of all runs. Default: drawn at the first audit into a folder, and printed.",
        ),
    ] = None
    threads: opt.Threads = None
    jobs: opt.Processes = 1
    backend: opt.Backend = "local"
    shard: opt.Shard = None

    @property
    def tasks(self) -> list[str]:
        return list(dict.fromkeys(self.task or ["D1"]))

    def finish(self, experiment: Experiment, folder: Path | None) -> Reader | None:
        """Results of all cells; None where a shard leaves some to others."""
        how: Any = {name: getattr(self, name) for name in ("jobs", "backend", "shard", "threads")}
        try:
            return opt.finish_experiment(experiment, folder, **how)
        except typer.Exit:  # the next task has its own
            return None


@with_options
def audit_(
    detector: Annotated[
        str | None, Argument(help=f"Detector; an .onnx file, too. {opt.SPEC_HELP}")
    ] = None,
    *,
    spoofer: Annotated[
        str | None,
        Option(
            help="Spoofer in place of a detector, against those of the standard suite; a shipped "
            f"name or an .onnx file, too. {opt.SPEC_HELP}"
        ),
    ] = None,
    options: AuditOptions,
    as_json: opt.Json = False,
) -> None:
    """Say what the worst attack known does to a detector, and how sure that is; resumable.

    It is calibrated to 0.2 false alarms an hour first, unless it requests another rate and where
    that has not been done.  The last line is the answer.

    Examples: `spoofgym audit my_module:MyDetector --budget quick`;
    `spoofgym audit ewma:smoothing=0.2 --task D1 --task D2`;
    `spoofgym audit --spoofer my.onnx --budget quick`.
    """
    from ..bench.report.audit import print_audits
    from ..bench.report.spoofer_audit import print_spoofer_audits

    if (detector is None) == (spoofer is None):
        raise ValueError("an audit is of a DETECTOR or of a --spoofer: give one of the two")
    if detector is not None:
        found, written = audit_detector(detector, options)
        records = [each.as_dict() for each in found]
    else:
        records, written = audit_spoofer(str(spoofer), options)
    if as_json and records:
        print_json(records)
    elif detector is not None:
        print_audits(found, written)
    else:
        print_spoofer_audits(records, written)


def audit_detector(text: str, options: AuditOptions) -> tuple[list[Any], list[Path]]:
    """Audits of a detector by task, and their reports."""
    from ..bench.experiments.audit import Auditor
    from ..bench.report.detector_page import build_scores_page
    from ..bench.report.page import write_page

    (spec,), found, written = opt.parse_specs([text]), [], []
    sizes: Any = {"runs": options.runs, "selection_runs": options.selection_runs}
    settings: Any = {**sizes, "families": options.family or None, "entropy": options.seed}
    settings |= {"threads": options.threads, "folder": options.out}
    auditors = [Auditor(key, options.budget, **settings) for key in options.tasks]
    for auditor in auditors:
        cells = auditor.prepare(spec, progress, partial(typer.echo, err=True))
        if (results := options.finish(cells, auditor.folder)) is None:
            continue
        found.append(cells.conclude(results))
        scores = {"detectors": [found[-1].as_dict()]}
        written.append(write_page(results.store, build_scores_page(results.store, scores))[-1])
    return found, written


def audit_spoofer(text: str, options: AuditOptions) -> tuple[list[dict[str, Any]], list[Path]]:
    """Audits of a spoofer by task, and their reports: a campaign beside the usual attacks."""
    from ..bench.experiments.audit import draw_entropy
    from ..bench.experiments.campaign import Campaign, summarize
    from ..bench.experiments.suite import (
        Suite,
        get_budget,
        list_standard_detectors,
        standard_kwargs,
    )
    from ..bench.report.campaign_page import build_page, replay_worst
    from ..bench.report.page import load_replay, write_page
    from ..bench.report.spoofer_audit import REFERENCES, write_spoofer_audit
    from ..bench.runs.players import add_tuned_setting, specify_spoofer
    from ..core.registry import slug
    from ..tasks import get_detector_task

    if options.family or options.selection_runs:
        raise ValueError("--family and --selection-runs are options of a detector's audit")
    size, (spec,), found, written = (
        get_budget(options.budget, runs=options.runs),
        opt.parse_specs([text]),
        [],
        [],
    )
    player = specify_spoofer(add_tuned_setting(spec))
    if player.label == "none":
        raise ValueError("the spoofer none attacks nothing: there is nothing to audit")
    for task in map(get_detector_task, options.tasks):
        others = [add_tuned_setting(name) for name in REFERENCES if name != player.spec["name"]]
        entropy = draw_entropy(options.out) if options.seed is None else options.seed
        suite = Suite(
            **standard_kwargs(task),
            detectors=list_standard_detectors(task.task),
            spoofers=[player.spec, *others],
            runs=size.runs,
            entropy=entropy,
            tuning=make_tuning(
                size.training_runs, 0.05, rule="exact", generations=size.generations
            ),
            floor_worlds=size.floor_worlds,
        )
        suite.world.check_fit((), suite.spoofer_players)
        campaign = Campaign(calibrate_suite(suite, None, options.threads))
        folder = options.out / f"{task.key}-{slug(player.label)}"
        if (results := options.finish(campaign, folder)) is None:
            continue
        cells = campaign.results(results)
        summary = summarize(cells)
        replay_worst(campaign.suite, cells, summary)
        found.append(write_spoofer_audit(summary, player.label, task.key, options.budget))
        page = build_page(cells, summary, load_replay(cells.store))
        written.append(write_page(cells.store, page)[-1])
    return found, written
