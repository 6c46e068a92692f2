"""Limits of a world: what even a perfect detector allows, what no attack exceeds unseen."""

from __future__ import annotations

from pathlib import Path

import typer
from typer import Option

from . import options as opt
from .app import print_json, print_lines, progress
from .options import SuiteOptions, with_options
from .suites import build_suite, calibrate_suite, make_tuning

MOST_WORLDS, BOUND_WORLDS = 1024, 8


@with_options
def limits(
    *,
    task: opt.Task = None,
    detector: list[str] | None = Option(
        None,
        help="Detector to compute the zero-alarm bound of, may be repeated; `all` for all that "
        f"suit the victim. Default: none. {opt.SPEC_HELP}",
    ),
    spoofer: str | None = Option(
        None,
        help="Spoofer to compute the bound by divergence for, where it holds. Default: none. "
        f"{opt.SPEC_HELP}",
    ),
    worlds: int | None = Option(
        None,
        min=1,
        max=MOST_WORLDS,
        help="Worlds to draw. Default: one under every sky of the domain for the floor, and "
        f"{BOUND_WORLDS} for zero-alarm bounds.",
    ),
    sensors: str = Option(
        "unknown",
        help="Whether the perfect detector knows the constants of the inertial sensors: known "
        "or unknown.",
    ),
    figure: Path | None = Option(
        None, help="File of a picture of the floor over time, .png, .svg or .pdf."
    ),
    as_json: opt.Json = False,
    options: SuiteOptions,
    alarm_budget: float = Option(
        0.05, help="Alarm budget of a stealthy attack, on top of the false alarms."
    ),
    nominal: bool = Option(
        False, "--nominal", help="Compute the bounds of detectors at the published thresholds."
    ),
    threads: opt.Threads = None,
) -> None:
    """Compute how far an attack can go unseen: floors of a perfect detector, zero-alarm bounds.

    As in `bench`, sky, heading, onset and turn-on constants of the sensors are drawn for every
    world, unless --set domain=... says otherwise, and detectors are calibrated to one rate of false
    alarms.  A task has its own world and detectors.

    Examples: `spoofgym limits` for the default world; `spoofgym limits --set domain={}` without
    drawn skies, headings and onsets;
    `spoofgym limits --detector snapshot-chi2 --detector aime` with the bounds of two detectors;
    `spoofgym limits --task T3 --figure floor.png` for a task, with a picture.

    The default world, S1, takes two to three minutes of a processor: each of 32 worlds begins when
    the receiver is switched on, up to an hour before the attack; `--worlds 4` takes some twenty
    seconds. Progress is printed on stderr.
    """
    from ..bench.report import limits as report
    from ..core.plots import check_picture
    from ..core.registry import check_choice
    from ..detectors.calibrated import STANDARD_RATE
    from ..limits.floor import check_linear_victim, compute_frontier

    rate = options.false_alarms_per_hour
    rate = STANDARD_RATE if rate is None else rate
    check_choice("knowledge of the inertial sensors' constants", sensors, report.SENSORS)
    picture = None if figure is None else check_picture(figure)
    suite, reports = build_suite(
        options,
        detector or ["never"],
        task=task,
        nominal=nominal,
        headline=True,
        spoofers=opt.parse_specs([spoofer] if spoofer else []),
        tuning=make_tuning(opt.LARGEST_RUNS, alarm_budget),
    )
    setup = check_linear_victim(suite.world.setup)
    report.per_run(rate, setup)
    count = worlds or setup.bounds.worlds
    minutes = max(report.expect_floor(setup, count) / 60.0, 1.0)
    if not setup.bounds.single:
        what = f"floor of {count} worlds, each from switch-on on"
        typer.echo(f"{what}: some {minutes:.0f} min of a processor", err=True)
    with progress(1.0) as bar:
        frontier = compute_frontier(
            setup,
            worlds=worlds,
            sensors_known=report.SENSORS[sensors],
            entropy=options.seed,
            times=0 if picture is None else report.TIMES,
            tick=lambda part: bar.advance(part, "floor"),
        )
    record = report.build_limit_record(
        setup, frontier, false_alarms_per_hour=rate, budget=alarm_budget, seed=options.seed
    )
    if spoofer:
        record["divergence"] = report.divergence_record(
            setup, frontier, suite.spoofer_players[-1], record["p_fa"], alarm_budget
        )
    if detector or task:
        suite = calibrate_suite(suite, detector, threads)
        drawn = worlds or min(BOUND_WORLDS, record["worlds"])
        report.add_bounds(record, suite, progress, drawn)
    notes = [*suite.notes, *suite.captions]
    if "zero_alarm" in record and nominal:
        notes.append("detectors have their thresholds as published, not the floor's rate")
    record |= {"notes": notes, "input": reports}
    if picture is not None:
        record["figure"] = str(report.draw_lower_limits(record, picture))
    if as_json:
        print_json(record)
        return
    print_lines(notes)
    report.print_limits(record)
    if picture is not None:
        typer.echo(f"written: {record['figure']}")
