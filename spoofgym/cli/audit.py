"""Audit of a detector or a spoofer, on the command line."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from typer import Argument, Option

from ..core.registry import require
from . import options as opt
from .app import print_json, print_lines, progress
from .options import with_options
from .suites import calibrate_suite, leave_uncalibrated, make_tuning

if TYPE_CHECKING:
    from ..bench.experiments import Experiment, Reader
    from ..bench.runs.players import PlayerSpec


@dataclass(frozen=True, kw_only=True)
class AuditOptions:
    """Options of an audit of either side."""

    task: list[str] | None = Option(
        None, help="Task for detectors, D1 to D3, may be repeated. Default: D1."
    )
    budget: str | None = Option(
        None,
        help="How much is played: quick, standard or full, some 1, 4 or 12 minutes of a "
        "processor for a plain detector in D1. A class of your own plays in a process of its own "
        "and takes longer; it is first calibrated, once, in some 3 minutes. Default: standard; "
        "quick with --check.",
    )
    family: list[str] | None = Option(
        None,
        help="Family of attacks, may be repeated: those that `spoofgym list D1` names, or shipped. "
        "Default: all of the task.",
    )
    runs: int | None = Option(
        None,
        min=2,
        max=opt.LARGEST_RUNS,
        help="Evaluation runs of every family, or of a spoofer. Default: as many as --budget says.",
    )
    selection_runs: int | None = Option(
        None,
        min=4,
        max=opt.LARGEST_RUNS,
        help="Runs that the attacks of a family are chosen on. Default: as many as --budget says.",
    )
    log: Path | None = Option(
        None,
        help="Log of a receiver, with the matrices of its filter. Its clean windows are played "
        "in place of a task, with thresholds from these windows.",
    )
    false_alarms_per_hour: float | None = Option(
        None, help="With --log: rate of the thresholds. Default: what a detector requests."
    )
    alert_limit_m: float | None = Option(
        None, help="With --log: error that must not be exceeded unnoticed, in m. Default: 30."
    )
    attack_s: float | None = Option(
        None, help="With --log: length of an attack, in seconds. Default: 150."
    )
    time_to_alert_s: float | None = Option(
        None, help="With --log: an alarm counts at most this long after the error. Default: 10 s."
    )
    out: Path = Option(
        Path("results/audit"), help="Folder of finished parts and of the worst attacks."
    )
    seed: int | None = Option(
        None,
        min=0,
        help="Seed of all runs. Default: drawn at the first audit into a folder, and printed.",
    )
    threads: opt.Threads = None
    jobs: opt.Processes = 1
    backend: opt.Backend = "local"
    shard: opt.Shard = None

    @property
    def size(self) -> str:
        return self.budget or "standard"

    @property
    def of_log(self) -> dict[str, float]:
        """Options that go with a log alone, those that are there."""
        names = "false_alarms_per_hour", "alert_limit_m", "attack_s", "time_to_alert_s"
        return {x: getattr(self, x) for x in names if getattr(self, x) is not None}

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


Audited = tuple[list[dict[str, Any]], list[list[str]], list[Path]]
"""Audits as JSON, their screens, and files of reports."""


@with_options
def audit_(
    detector: list[str] | None = Argument(
        None, help=f"Detectors, one or more; an .onnx file, too. {opt.SPEC_HELP}"
    ),
    *,
    spoofer: str | None = Option(
        None,
        help="Audit a spoofer instead, against the detectors of the standard suite; a shipped "
        f"name or an .onnx file, too. {opt.SPEC_HELP}",
    ),
    check: Path | None = Option(
        None,
        metavar="ENTRY",
        help="Folder of an entry: check its format and files, audit it, and say whether the "
        "figures that it claims lie in the intervals. Exit code 1 where one does not.",
    ),
    options: AuditOptions,
    as_json: opt.Json = False,
) -> None:
    """Say what the worst attack known does to a detector, and how sure that is; resumable.

    The detector is first calibrated to the rate that it requests, 0.2 false alarms an hour by
    default, unless that has been done.  The last line is the answer.

    Examples: `spoofgym audit my_module:MyDetector --budget quick`;
    `spoofgym audit ewma:smoothing=0.2 --task D1 --task D2`;
    `spoofgym audit --spoofer my.onnx --budget quick`; `spoofgym audit --check my-entry`.
    """
    from ..bench.report.audit import print_audits

    if [detector or None, spoofer, check].count(None) != 2:
        raise ValueError("give one thing to audit: a DETECTOR, a --spoofer or an entry (--check)")
    if check is not None:
        check_entry(check, options, as_json)
        return
    if detector:
        records, screens, written = audit_detectors(detector, options)
    else:
        records, screens, written = audit_spoofer(str(spoofer), options)
    if as_json and records:
        print_json(records)
    elif records:
        print_audits(screens, written, [each["answer"] for each in records])


def check_log_options(options: AuditOptions) -> None:
    for name in () if options.log else options.of_log:
        raise ValueError(f"--{name.replace('_', '-')} goes with --log; a task has its own")


def check_entry(folder: Path, options: AuditOptions, as_json: bool) -> None:
    """Check an entry, audit it from its folder, and compare what it claims."""
    from ..bench.experiments.entry import Entry, compare_figures
    from ..bench.report.table import Table, interval, yes_no

    entry = Entry.load(folder)
    if options.task or options.shard or options.log:
        raise ValueError(
            "--task, --shard and --log don't go with --check: the entry names its task"
        )
    out, budget = options.out.resolve() / entry.name, options.budget or "quick"
    options = replace(options, task=[entry.task], out=out, budget=budget)
    with contextlib.chdir(folder):
        audited = (
            audit_detectors([entry.player], options, entry.figures)
            if entry.side == "detector"
            else audit_spoofer(entry.player, options, entry.figures)
        )
        (record,), _, written = audited
    figures = list(compare_figures(entry.figures, record))
    false = [each.name for each in figures if not each.holds]
    answer = f"{entry.name} by {entry.who}: all {len(figures)} figures hold"
    if false:
        answer = f"{entry.name} by {entry.who}: claims what is not found: {', '.join(false)}"
    rows = [{**each._asdict(), "holds": each.holds} for each in figures]
    if as_json:
        print_json({"entry": entry.model_dump(), "figures": rows, "audit": record})
    else:
        Table(
            ("figure", "name"),
            ("claimed", "claimed", "{:.4g}".format),
            ("played", dict, interval),
            ("holds", "holds", yes_no),
        ).print(f"{entry.task}, {budget}, seed {record['entropy']}", rows)
        print_lines([*(f"Report: {path}" for path in written), answer])
    raise typer.Exit(bool(false))


def audit_detectors(
    texts: list[str], options: AuditOptions, claimed: dict[str, Any] | None = None
) -> Audited:
    """Audit detectors by task; `claimed`: figures, whose names are checked first."""
    from ..bench.experiments.audit import Auditor
    from ..bench.experiments.entry import compare_figures, list_detector_figures
    from ..bench.experiments.log_audit import LogAuditor
    from ..bench.report.audit import format_screen
    from ..bench.report.detector_page import build_scores_page, replay_worst_attack
    from ..bench.report.page import load_replay, store_replay, write_page

    specs, found, written = opt.parse_specs(texts), [], []
    sizes: Any = {"runs": options.runs, "selection_runs": options.selection_runs}
    settings: Any = {"families": options.family or None, "threads": options.threads}
    settings["folder"] = options.out
    auditors: list[Any]
    check_log_options(options)
    if options.log is None:
        sizes["entropy"] = options.seed
        auditors = [Auditor(key, options.size, **sizes, **settings) for key in options.tasks]
    else:
        for name, value in {"task": options.task, "seed": options.seed, **sizes}.items():
            given = f"--{name.replace('_', '-')}"
            require(value is None, f"{given} does not go with --log, whose windows are the runs")
        settings |= options.of_log
        auditors = [LogAuditor(options.log, options.size, **settings)]
    if claimed:
        keys = auditors[0].list_families(specs[0]["name"])
        list(compare_figures(claimed, list_detector_figures(keys)))
    for auditor in auditors:
        own, stores = [], []
        for spec in specs:
            cells = auditor.prepare(spec, progress, partial(typer.echo, err=True))
            if (results := options.finish(cells, auditor.folder)) is not None:
                own.append(cells.conclude(results))
                stores.append(results.store)
        if own:
            scores, store = {"detectors": [each.as_dict() for each in own]}, stores[-1]
            if isinstance(auditor, Auditor):
                families = own[-1].score.families
                store_replay(
                    store, replay_worst_attack(auditor, cells.detectors[0].player, families)
                )
            page = build_scores_page(store, scores, load_replay(store))
            written.append(write_page(store, page)[-1])
        found += own
    return [each.as_dict() for each in found], [*map(format_screen, found)], written


def audit_spoofer(
    text: str, options: AuditOptions, claimed: dict[str, Any] | None = None
) -> Audited:
    """Audit a spoofer by task: a campaign beside the usual attacks; `claimed` as of a detector."""
    from ..bench.experiments.audit_cells import choose_entropy
    from ..bench.experiments.audit_worlds import Worlds
    from ..bench.experiments.campaign import Campaign, summarize
    from ..bench.experiments.entry import compare_figures, list_spoofer_figures
    from ..bench.experiments.suite import (
        Suite,
        find_stored_floor,
        find_task_card,
        get_budget,
        list_standard_detectors,
        standard_kwargs,
    )
    from ..bench.report.audit import REFERENCES, format_reach, write_spoofer_audit
    from ..bench.report.campaign_page import build_page, replay_worst
    from ..bench.report.page import load_replay, write_page
    from ..bench.runs.players import add_tuned_setting, specify_spoofer
    from ..core.registry import slug
    from ..detectors import detector_in_world
    from ..envs.spoofer_binding import MisfitError
    from ..tasks import get_detector_task

    check_log_options(options)
    if options.family or options.selection_runs or options.log:
        raise ValueError("--family, --selection-runs and --log are options of a detector's audit")
    size, (spec,), found, written = (
        get_budget(options.size, runs=options.runs),
        opt.parse_specs([text]),
        [],
        [],
    )
    player = specify_spoofer(add_tuned_setting(spec))
    if player.label == "none":
        raise ValueError("the spoofer none attacks nothing: there is nothing to audit")
    for task in map(get_detector_task, options.tasks):
        others = [add_tuned_setting(name) for name in REFERENCES if name != player.spec["name"]]
        suite = Suite(
            **standard_kwargs(task),
            detectors=list_standard_detectors(task.task),
            spoofers=[player.spec, *others],
            runs=size.runs,
            entropy=choose_entropy(options.out, options.seed),
            tuning=make_tuning(size.training_runs, 0.05, rule="exact", quick=size.quick),
            floor_worlds=size.floor_worlds,
            floor=find_stored_floor(task),
            curves=find_task_card(task).get("optima_mps"),
        )
        try:
            suite.world.check_fit((), suite.spoofer_players)
        except MisfitError as error:
            if not error.options:
                raise
            raise ValueError(
                f"{error} to `spoofgym bench`: an audit plays in the world of {task.key} alone"
            ) from error
        worlds = Worlds(task, suite.entropy, options.threads)

        def expect(entry: PlayerSpec, worlds: Worlds = worlds) -> str:
            return worlds.expect_calibration(entry.spec, detector_in_world(entry.spec), 1)[0]

        suite, text = leave_uncalibrated(suite, None if options.size == "quick" else expect)
        if claimed:
            labels = (each.label for each in suite.detector_players)
            names = (name for name in REFERENCES if name != player.spec["name"])
            list(compare_figures(claimed, list_spoofer_figures(labels, names)))
        if text:
            typer.echo(f"{task.key}: {text}", err=True)
        campaign = Campaign(calibrate_suite(suite, None, options.threads))
        folder = options.out / f"{task.key}-{slug(player.label)}"
        if (results := options.finish(campaign, folder)) is None:
            continue
        cells = campaign.results(results)
        summary = summarize(cells)
        replay_worst(campaign.suite, cells, summary)
        found.append(write_spoofer_audit(summary, player.label, task.key, options.size))
        page = build_page(cells, summary, load_replay(cells.store))
        written.append(write_page(cells.store, page)[-1])
    return found, [*map(format_reach, found)], written
