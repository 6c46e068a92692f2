"""Spoofgym tune."""

from __future__ import annotations

import functools
from typing import Annotated

import typer
from typer import Option

from . import options as opt
from .app import print_json, print_lines, progress
from .options import SuiteOptions, with_options
from .suites import build_suite, calibrate_suite, make_tuning


@with_options
def tune(
    *,
    detector: Annotated[
        list[str] | None, Option(help=f"Detector, may be repeated. {opt.SPEC_HELP}")
    ] = None,
    spoofer: Annotated[
        list[str] | None,
        Option(help="Spoofer, may be repeated: ramp, accelerating-ramp, step, or your own."),
    ] = None,
    budget: opt.Budget = 0.05,
    training_seeds: opt.Training = 1024,
    as_json: opt.Json = False,
    options: SuiteOptions,
    threads: opt.Threads = None,
) -> None:
    """Find the strongest ramp that keeps to an alarm budget, on training runs."""
    from ..bench.report.campaign import tuning_table
    from ..bench.runs.panel import Panel
    from ..bench.runs.players import TUNED
    from ..bench.search.amplitude import TuningResult, search_work
    from ..bench.search.open_loop import fit
    from ..spoofers import make_spoofer
    from ..spoofers.scaled import AMPLITUDE

    specs = opt.parse_specs(spoofer or ["ramp", "accelerating-ramp"])
    for spec in specs:
        untuned = {key: value for key, value in spec.items() if value != TUNED}
        spec[make_spoofer(untuned).tunable or AMPLITUDE] = TUNED
    tuning = make_tuning(training_seeds, budget)
    suite, _ = build_suite(options, detector, spoofers=specs, tuning=tuning)
    suite = calibrate_suite(suite, detector, threads)
    if not as_json:
        print_lines((*suite.notes, *suite.captions))
    entries = [entry for entry in suite.spoofer_players if entry.tuned]
    each = 2.0 * suite.tuning.runs + len(entries) * search_work(suite.tuning)
    results: list[TuningResult] = []
    optima, watched = suite.optima(), suite.world.watched_for(entries)
    rngs = functools.partial(suite.generators, "training", suite.tuning.runs)
    with progress(each * len(suite.detector_players)) as bar:
        for judge in suite.detector_players:
            judges = [judge.build()]
            panel = Panel(suite.world.setup, judges, rngs, threads, watched)
            for entry in entries:
                now = f"{judge.label}: tuning {entry.label}"
                tick = functools.partial(bar.advance, now=now)
                results += fit(panel, {0: judge}, entry, suite.tuning, lambda: optima, tick)
    if as_json:
        print_json([result.as_dict() for result in results])
        return
    for result in results:
        table = result.as_dict()
        tuning_table(table).print(
            f"{result.spoofer} against {result.detector}: P(alarm | silent twin) at most "
            f"{100 * budget:g} %, by its upper limit on the {result.counted} of {result.runs} "
            "training runs that count; fewer only sift, by the rate itself",
            table["trials"],
        )
        if not result.within_budget:
            typer.echo(f"nothing is within the budget; the smallest value is {result.value:g}")
