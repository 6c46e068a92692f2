"""Spoofgym bench, and its report."""

from __future__ import annotations

from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from . import options as opt
from .app import print_json, print_lines, print_written
from .options import SuiteOptions, with_options
from .suites import Reports, build_suite, calibrate_suite, make_tuning

if TYPE_CHECKING:
    from ..bench.experiments import Reader
    from ..bench.experiments.campaign import CampaignResults
    from ..bench.experiments.suite import Suite

WIDTH = 100
"""Characters of a line of the answer."""
Verbose = Annotated[
    bool, Option("--verbose", "-v", help="Print the report with all tables and settings.")
]


@with_options
def bench(
    *,
    task: opt.Task = None,
    detector: list[str] | None = Option(
        None,
        help="Detector, may be repeated; `all` for all that suit the victim. Default: the "
        "twelve of the standard suite; in another world those that suit its victim, with the "
        "controls never and lottery. In the default world both controls always play. "
        f"{opt.SPEC_HELP}",
    ),
    spoofer: list[str] | None = Option(
        None,
        help="Spoofer, may be repeated. Its amplitude, or the rate of a plain ramp, is fitted "
        "to the alarm budget; with step:size_m=tuned that setting is fitted, with "
        "step:amplitude=1 nothing is. A shipped spoofer by its name, a learned one by "
        "its .onnx file. Default: ramp, accelerating-ramp, open-loop and feedback; in another "
        "world: none, step, ramp, accelerating-ramp, open-loop, and the shipped ones that fit.",
    ),
    budget: opt.Budget = "standard",
    runs: opt.Runs = None,
    out: Path = Option(Path("results"), help="Folder of the results."),
    overwrite: bool = Option(False, "--overwrite", help="Replace the results of another campaign."),
    fit_only: bool = Option(
        False,
        "--fit-only",
        help="Fit spoofers to the alarm budget, print what was tried, and stop; the same "
        "command without it goes on from there.",
    ),
    as_json: opt.Json = False,
    verbose: Verbose = False,
    options: SuiteOptions,
    alarm_budget: float = Option(
        0.05, help="Share of runs without a false alarm that may alarm under attack; see --rule."
    ),
    training_runs: int | None = Option(
        None,
        min=2,
        max=opt.LARGEST_RUNS,
        help="Training runs for tuned spoofers; they share no noise with the evaluation runs.",
    ),
    rule: str | None = Option(
        None,
        help="How amplitudes are fitted to the alarm budget. exact: the evaluation runs alarm "
        "at just that rate, and intervals include the fit. upper-limit: the upper 95 % limit of "
        "the rate on the training runs keeps the budget. Default: exact; upper-limit in a task "
        "of the first suite.",
    ),
    nominal: bool = Option(
        False,
        "--nominal",
        help="Use the published thresholds without calibration. Detectors are then not "
        "comparable, because their false-alarm rates differ.",
    ),
    selection_runs: int | None = Option(
        None,
        min=0,
        max=opt.LARGEST_RUNS,
        help="Runs on which the worst attack of the suite is chosen. With 0 none is chosen, "
        "and the columns of the worst attack are left out.",
    ),
    device: opt.Device = "cpu",
    threads: opt.Threads = None,
    jobs: int | None = Option(
        None,
        min=1,
        help="Processes on this machine that compute in parallel. Default: 1; in the default "
        "world, the number of processors.",
    ),
    backend: opt.Backend = "local",
    shard: opt.Shard = None,
) -> None:
    """Play detectors against spoofers on the same runs (resumable).

    Without options of the world, the world is that of task S1. All detectors are calibrated to one
    rate of false alarms, 0.2 an hour unless another one is given. Sky, heading, onset and turn-on
    constants of the sensors are drawn for every run, unless --set domain=... says otherwise.
    """
    from ..bench.experiments.campaign import Campaign
    from ..bench.experiments.evaluate import get_rule
    from ..bench.experiments.suite import SPOOFERS, get_budget
    from ..bench.report.campaign import WorstRows, print_search
    from ..bench.runs.players import add_tuned_setting
    from ..bench.search.attack_suite import Selection
    from ..core.devices import check_device
    from ..simulation.engine import processors

    check_device(device)
    size = get_budget(budget, runs=runs, training_runs=training_runs, selection_runs=selection_runs)
    chosen = size.selection_runs  # a quarter of them sifts
    standard = task is None and not options.find_passed(opt.WORLD_OPTIONS)
    spoofers = opt.parse_specs(spoofer or (SPOOFERS if standard else ()))
    suite, reports = build_suite(
        options,
        detector,
        task=task,
        nominal=nominal,
        headline=True,
        standard=standard,
        spoofers=list(map(add_tuned_setting, spoofers)) or None,
        runs=size.runs,
        tuning=make_tuning(
            size.training_runs, alarm_budget, rule=rule or get_rule(task), quick=size.quick
        ),
        selection=Selection(runs=chosen, sift_runs=max(chosen // 4, 1)) if chosen else None,
        floor_worlds=size.floor_worlds,
    )
    if fit_only and not any(player.tuned for player in suite.spoofer_players):
        raise ValueError("--fit-only needs a spoofer with a setting that is tuned")
    campaign = Campaign(calibrate_suite(suite, detector, threads), fit_only, device)
    if len(campaign.lacking) == len(suite.detector_players):
        raise ValueError(next(iter(campaign.lacking.values())))
    if campaign.lacking:
        names = ", ".join(campaign.lacking)
        typer.echo(f"played on the processor, not on {device}: {names}", err=True)
    rows = WorstRows(campaign.config)

    def show(cells: Reader) -> None:
        if not as_json and not fit_only:
            print_lines(rows.list_new(campaign.results(cells)))

    results = campaign.results(
        opt.finish_experiment(
            campaign,
            out,
            jobs=jobs or (processors() if standard and device == "cpu" else 1),
            backend=backend,
            shard=shard,
            threads=threads,
            overwrite=overwrite,
            finished=show,
        )
    )
    fits = [search.as_dict() for search in results.searches.values()] if fit_only else []
    if fit_only and as_json:
        print_json(fits)
    elif fit_only:
        for search in fits:
            print_search(search)
    else:
        _report(results, as_json, reports, verbose, suite, named=bool(spoofer))


def report(
    folder: Path = Argument(Path("results"), help="Folder of the results."),
    out: Path | None = Option(
        None, help="Also write every run of a campaign as a row: to a file, .mat or .parquet."
    ),
    as_json: opt.Json = False,
    verbose: Verbose = False,
) -> None:
    """Write the report of a folder of results again, finished or not."""
    from ..bench.experiments import Store
    from ..bench.experiments.campaign import CampaignResults
    from ..bench.report.campaign import WorstRows
    from ..bench.report.detector_page import build_scores_page
    from ..bench.report.game_page import build_game_page
    from ..bench.report.page import load_output, load_replay, write_page
    from ..core.files import COLUMN_FILES, write_columns
    from ..core.registry import check_choice

    store = Store(folder)
    store.reopen()
    kind = store.config["experiment"]
    if out is not None:
        check_choice("ending of `--out`", out.suffix.lower(), COLUMN_FILES)
        check_choice("experiment with a table of runs", kind, ("campaign",))
    if kind == "campaign":
        results = CampaignResults.load(folder)
        if out is not None:
            write_columns(out, results.columns())
        if not as_json:
            print_lines(WorstRows(results.config).list_new(results))
        _report(results, as_json, None, verbose)
        return
    pages = {"game": build_game_page, "audit": build_scores_page}
    if kind not in pages:
        raise ValueError(f"{folder} holds the experiment {kind!r}, which has no report")
    scores = load_output(store)
    page = pages[kind](store, scores, load_replay(store))
    written = write_page(store, page)
    if as_json:
        print_json(scores)
    else:
        print_written(written)
        if page.missing:
            typer.echo(f"not finished: {', '.join(page.missing)}")


def _report(
    results: CampaignResults,
    as_json: bool,
    reports: Reports,
    verbose: bool,
    suite: Suite | None = None,
    *,
    named: bool = False,
) -> None:
    """Write scores and page, and print the answer, or all tables. `suite` replays the worst run;
    `named`: whether the spoofers were named, each of which gets a row."""
    from ..bench.experiments.campaign import summarize
    from ..bench.report.campaign import list_spoofer_rows, print_campaign, state_answer
    from ..bench.report.campaign_page import build_page, replay_worst
    from ..bench.report.page import load_replay, write_page
    from ..data.recorded import ONLY_TRAJECTORY

    summary = summarize(results)
    if not summary["cells"]:
        raise ValueError(f"{results.path} holds no finished cell yet")
    if suite is not None:
        replay_worst(suite, results, summary)
    written = write_page(results.store, build_page(results, summary, load_replay(results.store)))
    if as_json:
        print_json({**summary, "folder": str(results.path), "input": reports})
        return
    if verbose:
        print_campaign(summary)
    else:
        print_lines(list_spoofer_rows(summary) if named else [])
        if summary["missing"]:
            typer.echo(f"not finished: {', '.join(summary['missing'])}")
    real = [note for note in results.config["notes"] if note == ONLY_TRAJECTORY]
    answer = " ".join([state_answer(summary), *real, f"Report: {written[-1]}"])
    print_lines(wrap(answer, WIDTH, break_long_words=False, break_on_hyphens=False))
