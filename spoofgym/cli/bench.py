"""Spoofgym bench, and its report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from . import options as opt
from .app import print_json, print_lines, print_written
from .options import SuiteOptions, with_options
from .suites import (
    Reports,
    build_suite,
    calibrate_suite,
    make_selection,
    make_tuning,
    refuse_decided,
    standard_suite,
)

if TYPE_CHECKING:
    from ..bench.experiments.campaign import CampaignResults
    from ..bench.experiments.suite import Suite


@with_options
def bench(
    *,
    task: Annotated[
        str | None,
        Option(
            help="Task, S1 to S3 or T1 to T6 of the first suite, which sets scenario, receiver, "
            "attack, times and detectors; see `spoofgym tasks`."
        ),
    ] = None,
    suite_name: Annotated[
        str | None,
        Option(
            "--suite",
            help="Suite by name: `standard` plays twelve detectors in the world of task S1 at 0.2 "
            "false alarms an hour against four spoofers, in about an hour of processor time; with "
            "--detector those that are named, such as your own, and the negative controls. It "
            "decides all but detectors, seeds, sizes and folder.",
        ),
    ] = None,
    detector: Annotated[
        list[str] | None,
        Option(
            help="Detector, may be repeated; `all` for all that suit the victim. Default: "
            "snapshot-chi2 and ewma, or those that suit the victim, and the negative controls "
            f"never and lottery. {opt.SPEC_HELP}"
        ),
    ] = None,
    spoofer: Annotated[
        list[str] | None,
        Option(
            help="Spoofer, may be repeated. One setting is fitted to the alarm budget: that which "
            "is `tuned`, as in step:size_m=tuned, the rate of a plain ramp, and else the amplitude "
            "of all that it commands, unless one is given, as in step:amplitude=1. A shipped "
            "spoofer by its name, a learned one by its .onnx file. Default: none, step, ramp, "
            "accelerating-ramp, open-loop, and the shipped ones that fit."
        ),
    ] = None,
    seeds: Annotated[
        int,
        Option(
            min=2, max=opt.LARGEST_RUNS, help="Evaluation runs of every cell, the same for all."
        ),
    ] = 1000,
    out: Annotated[Path, Option(help="Folder of the results.")] = Path("results"),
    overwrite: Annotated[
        bool, Option("--overwrite", help="Replace the results of another campaign.")
    ] = False,
    as_json: opt.Json = False,
    options: SuiteOptions,
    budget: opt.Budget = 0.05,
    training_seeds: opt.Training = 256,
    rule: Annotated[
        str | None,
        Option(
            help="How amplitudes are fitted to the budget: exact, on the evaluation runs, with "
            "intervals that include the fit, or upper-limit, a pass mark, by the upper 95 % limit "
            "of the alarm rate on the training runs. Default: exact, and upper-limit in a task of "
            "the first suite."
        ),
    ] = None,
    nominal: Annotated[
        bool,
        Option(
            "--nominal",
            help="Play thresholds as published and nothing else: no calibration, and no comparison "
            "of detectors, whose rates of false alarms differ. A task does so anyway.",
        ),
    ] = False,
    selection_seeds: Annotated[
        int,
        Option(
            min=0,
            max=opt.LARGEST_RUNS,
            help="Runs on which the worst attack of the attack suite is chosen; 0 to leave the "
            "protection out.",
        ),
    ] = 192,
    threads: opt.Threads = None,
    jobs: opt.Jobs = None,
    backend: opt.Backend = "local",
    shard: opt.Shard = None,
) -> None:
    """Play detectors against spoofers on the same runs; interrupted, it goes on when run again.

    All detectors are calibrated to one rate of false alarms, 0.2 an hour unless another one is
    given, in a world whose sky, heading, onset and turn-on constants of the sensors are drawn for
    every run, unless --set domain=... says otherwise.
    """
    from ..bench.experiments.campaign import Campaign
    from ..bench.experiments.evaluate import get_rule
    from ..bench.experiments.suite import SIZES, SPOOFERS, SUITES
    from ..bench.runs.players import add_tuned_setting
    from ..core.registry import check_choice
    from ..simulation.engine import processors

    sizes = {"seeds": seeds, "training_seeds": training_seeds, "selection_seeds": selection_seeds}
    if suite_name is not None:
        check_choice("suite", suite_name, SUITES)
        refuse_decided(options, "--suite", opt.SUITE_OPTIONS)
        sizes = {**SIZES, **{key: sizes[key] for key in options.find_passed(SIZES)}}
        spoofer = [*SPOOFERS]
    settings: dict[str, Any] = {
        "spoofers": list(map(add_tuned_setting, opt.parse_specs(spoofer))) if spoofer else None,
        "runs": sizes["seeds"],
        "tuning": make_tuning(sizes["training_seeds"], budget, rule or get_rule(task)),
        "selection": make_selection(sizes["selection_seeds"]),
    }
    if suite_name is not None:
        settings |= {"entropy": options.seed, "allow_oracles": options.allow_oracles}
        suite, reports = standard_suite(detector, settings), None
    else:
        settings |= {"task": task, "nominal": nominal, "headline": True}
        suite, reports = build_suite(options, detector, **settings)
    suite = calibrate_suite(suite, detector, threads)
    campaign = Campaign(suite)
    at_once = jobs or (processors() if suite_name else 1)
    if not as_json:
        print_lines((*(() if task else suite.notes), *suite.captions, *suite.left_out))
    handed: dict[str, Any] = {"jobs": at_once, "backend": backend, "shard": shard}
    results = opt.finish_experiment(campaign, out, threads=threads, overwrite=overwrite, **handed)
    _report(campaign.results(results), as_json, reports, suite)


def report(
    folder: Annotated[Path, Argument(help="Folder of the results.")] = Path("results"),
    as_json: opt.Json = False,
) -> None:
    """Score the finished cells of a folder again, and write its report."""
    from ..bench.experiments import Store
    from ..bench.experiments.campaign import CampaignResults
    from ..bench.report.detector_page import build_scores_page
    from ..bench.report.game_page import build_game_page
    from ..bench.report.page import load_output, load_replay, write_page

    store = Store(folder)
    store.reopen()
    kind = store.config["experiment"]
    if kind == "campaign":
        _report(CampaignResults.load(folder), as_json, None)
        return
    pages = {"game": build_game_page, "protect": build_scores_page, "audit": build_scores_page}
    if kind not in pages:
        raise ValueError(f"{folder} holds the experiment {kind!r}, which has no report")
    scores = load_output(store)
    written = write_page(store, pages[kind](store, scores, load_replay(store)))
    if as_json:
        print_json(scores)
    else:
        print_written(written)


def _report(
    results: CampaignResults, as_json: bool, reports: Reports, suite: Suite | None = None
) -> None:
    """Write scores and page, and print the tables. `suite`: plays the worst run again."""
    from ..bench.experiments.campaign import summarize
    from ..bench.report.campaign import print_campaign
    from ..bench.report.campaign_page import build_page, replay_worst
    from ..bench.report.page import load_replay, write_page

    summary = summarize(results)
    if not summary["cells"]:
        raise ValueError(f"{results.path} holds no finished cell yet")
    if suite is not None:
        replay_worst(suite, results, summary)
    written = write_page(results.store, build_page(results, summary, load_replay(results.store)))
    if as_json:
        print_json({**summary, "folder": str(results.path), "input": reports})
        return
    print_campaign(summary)
    print_written(written)
