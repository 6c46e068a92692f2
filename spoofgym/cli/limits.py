"""Limits of a world: what even a perfect detector allows, what no attack exceeds unseen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import options as opt
from .options import SuiteOptions, with_options
from .output import print_json, print_lines, progress
from .suites import calibrated, specs_of, suite_of, tuning_of

if TYPE_CHECKING:
    from ..bench.experiments.suite import Suite

MOST_WORLDS = 1024


@with_options
def limits(
    *,
    task: Annotated[
        str | None,
        typer.Option(
            help="Task of spoofgym-bench-v1, T1 to T6, which sets scenario, receiver, attack, "
            "times and detectors; see `spoofgym tasks`."
        ),
    ] = None,
    detector: Annotated[
        list[str] | None,
        typer.Option(
            help="Detector whose zero-alarm bound is wanted, may be repeated; `all` for all that "
            f"suit the victim. Default: none. {opt.SPEC_HELP}"
        ),
    ] = None,
    spoofer: Annotated[
        str | None,
        typer.Option(
            help="Spoofer of which to say whether the bound by divergence holds for it, and what "
            f"it is. Default: none. {opt.SPEC_HELP}"
        ),
    ] = None,
    worlds: Annotated[
        int,
        typer.Option(
            min=1, max=MOST_WORLDS, help="Worlds to draw; one is enough where nothing is drawn."
        ),
    ] = 8,
    sensors: Annotated[
        str,
        typer.Option(
            help="Whether the perfect detector knows the constants of the inertial sensors: known "
            "or unknown."
        ),
    ] = "unknown",
    figure: Annotated[
        Path | None,
        typer.Option(help="File of a picture of the floor over time, .png, .svg or .pdf."),
    ] = None,
    as_json: opt.Json = False,
    options: SuiteOptions,
    budget: Annotated[
        float,
        typer.Option(help="Alarm budget of a stealthy attack, on top of the false alarms."),
    ] = 0.05,
    nominal: Annotated[
        bool,
        typer.Option("--nominal", help="Bounds of detectors with thresholds as published."),
    ] = False,
    threads: opt.Threads = None,
) -> None:
    """Compute how far an attack can go unseen: floors of a perfect detector, zero-alarm bounds.

    As in `bench`, sky, heading, onset and turn-on constants of the sensors are drawn for every
    world, unless --set domain=... says otherwise, and detectors are calibrated to one rate of false
    alarms.  A task has its own world and detectors.

    Examples: `spoofgym limits` for the flight; `spoofgym limits --set domain={}` under its one sky;
    `spoofgym limits --detector snapshot-chi2 --detector aime` with the bounds of two detectors;
    `spoofgym limits --task T3 --figure floor.png` for a task, with a picture.
    """
    from ..bench.report import limits as report
    from ..core.plots import check_picture
    from ..detectors.calibrated import STANDARD_RATE
    from ..limits.floor import check_linear_victim, frontier_of

    rate = options.false_alarms_per_hour
    rate = STANDARD_RATE if rate is None else rate
    known = report.sensors_known(sensors)
    picture = None if figure is None else check_picture(figure)
    suite, reports = suite_of(
        options,
        detector or ["never"],
        task=task,
        nominal=nominal,
        headline=True,
        spoofers=specs_of([spoofer] if spoofer else []),
        tuning=tuning_of(opt.LARGEST_RUNS, budget),
    )
    setup = check_linear_victim(suite.world.setup)
    report.per_run(rate, setup)
    with progress(1.0) as bar:
        frontier = frontier_of(
            setup,
            worlds=worlds,
            sensors_known=known,
            entropy=options.seed,
            times=0 if picture is None else report.TIMES,
            tick=lambda part: bar.advance(part, "floor"),
        )
    record = report.floor_record(
        setup, frontier, false_alarms_per_hour=rate, budget=budget, seed=options.seed
    )
    if spoofer:
        player = suite.spoofer_entries[-1]
        record["divergence"] = report.divergence_record(
            setup, frontier, player, record["p_fa"], budget
        )
    if detector or task:
        suite = calibrated(suite, detector, threads)
        _add_bounds(suite, record)
    notes = [*suite.notes, *suite.captions]
    if "zero_alarm" in record and nominal:
        notes.append("detectors have their thresholds as published, not the floor's rate")
    record |= {"notes": notes, "input": reports}
    if picture is not None:
        record["figure"] = str(report.draw_floors(record, picture))
    if as_json:
        print_json(record)
        return
    print_lines(notes)
    report.print_limits(record)
    if picture is not None:
        typer.echo(f"written: {record['figure']}")


def _add_bounds(suite: Suite, record: dict[str, Any]) -> None:
    """Add the zero-alarm bounds of all detectors."""
    from ..bench.report.limits import zero_alarm_record

    brackets, entries = suite.brackets(worlds=record["worlds"]), suite.detector_entries
    with progress(1.0 + len(entries)) as bar:

        def ticking(text: str) -> Any:
            return lambda part: bar.advance(part, text)

        brackets.cases(ticking("worlds"))
        found = {each.label: brackets.zero_alarm(each, ticking(each.label)) for each in entries}
    points = {each.label: suite.world.points(each) for each in entries}
    bounds = zero_alarm_record(found, points)
    record["zero_alarm"] = bounds["zero_alarm"]
    record["assumptions"] |= bounds["assumptions"]
