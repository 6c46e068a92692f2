"""Limits of a world: what even a perfect detector allows, what no attack exceeds unseen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import options as opt
from .bench import at_rate, calibrated, tuning_of, uncalibrated
from .options import World, specs_of, with_world
from .output import print_json, print_lines, print_table, progress

if TYPE_CHECKING:
    from ..bench.experiments.suite import Suite
    from ..core.progress import ProgressCallback
    from ..limits import Frontier

MOST_WORLDS = 1024


@with_world
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
    world: World,
    budget: Annotated[
        float,
        typer.Option(help="Alarm budget of a stealthy attack, on top of the false alarms."),
    ] = 0.05,
    seed: opt.Seed = 0,
    allow_oracles: opt.Oracles = False,
    false_alarms_per_hour: opt.Rate = None,
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
    from ..bench.report.limits import sensors_known
    from ..core.plots import check_picture
    from ..detectors.calibrated import STANDARD_RATE

    if nominal and false_alarms_per_hour is not None:
        raise ValueError("--nominal and --false-alarms-per-hour can't both be given")
    known = sensors_known(sensors)
    picture = None if figure is None else check_picture(figure)
    rate = STANDARD_RATE if false_alarms_per_hour is None else false_alarms_per_hour
    suite, reports = uncalibrated(
        world,
        detector or ["never"],
        task=task,
        asked={"thresholds": "nominal"} if nominal else at_rate(rate),
        headline=task is None,
        spoofers=specs_of([spoofer] if spoofer else []),
        entropy=seed,
        tuning=tuning_of(opt.LARGEST_RUNS, budget),
        allow_oracles=allow_oracles,
    )
    record, frontier = _floors(suite, rate, worlds, known, drawn=picture is not None)
    if spoofer:
        record["divergence"] = _divergence(suite, frontier, record)
    if detector or task:
        suite = calibrated(suite, detector, threads)
        _add_bounds(suite, record)
    notes = [*suite.notes, *suite.captions]
    if "zero_alarm" in record and nominal:
        notes.append("detectors have their thresholds as published, not the floor's rate")
    record |= {"notes": notes, "input": reports}
    if picture is not None:
        from ..bench.report.limits import draw_floors

        record["figure"] = str(draw_floors(record, picture))
    if as_json:
        print_json(record)
        return
    _print(record)


def _floors(
    suite: Suite, rate: float, worlds: int, known: bool, *, drawn: bool
) -> tuple[dict[str, Any], Frontier]:
    from ..bench.report.limits import TIMES, floor_record, per_run
    from ..limits.floor import check_linear_victim, frontier_of

    setup = check_linear_victim(suite.world.setup)
    per_run(rate, setup)
    with progress(1.0) as bar:
        frontier = frontier_of(
            setup,
            worlds=worlds,
            sensors_known=known,
            entropy=suite.entropy,
            times=TIMES if drawn else 0,
            tick=lambda part: bar.advance(part, "floor"),
        )
    settings: dict[str, Any] = {"false_alarms_per_hour": rate, "budget": suite.tuning.budget}
    return floor_record(setup, frontier, **settings, seed=suite.entropy), frontier


def _divergence(suite: Suite, frontier: Frontier, record: dict[str, Any]) -> dict[str, Any]:
    """What the bound by divergence says of the suite's spoofer."""
    from ..bench.report.limits import divergence_record

    player = suite.spoofer_entries[-1]
    return divergence_record(suite.world.setup, frontier, player, record["p_fa"], record["budget"])


def _add_bounds(suite: Suite, record: dict[str, Any]) -> None:
    """Add the zero-alarm bounds of all detectors."""
    from ..bench.report.limits import zero_alarm_record

    brackets, entries = suite.brackets(worlds=record["worlds"]), suite.detector_entries

    def ticking(bar: ProgressCallback, text: str) -> Any:
        return lambda part: bar.advance(part, text)

    with progress(1.0 + len(entries)) as bar:
        brackets.cases(ticking(bar, "worlds"))
        found = {
            each.label: brackets.zero_alarm(each, ticking(bar, each.label)) for each in entries
        }
    points = {each.label: suite.world.points(each) for each in entries}
    bounds = zero_alarm_record(found, points)
    record["zero_alarm"] = bounds["zero_alarm"]
    record["assumptions"] |= bounds["assumptions"]


def _print(record: dict[str, Any]) -> None:
    from ..bench.report import limits as tables

    print_lines(record["notes"])
    head, rows = tables.floor_head(record), tables.floor_rows(record)
    print_table(tables.floor_title(record), head, rows)
    print_lines([tables.check_line(record)])
    if "zero_alarm" in record:
        rows = tables.zero_alarm_rows(record)
        print_table(tables.zero_alarm_title(record), tables.ZERO_ALARM_HEAD, rows)
    if "divergence" in record:
        if record["divergence"]["holds"]:
            head, rows = tables.divergence_head(record), tables.divergence_rows(record)
            print_table(tables.divergence_title(record), head, rows)
        else:
            print_lines([f"{record['divergence']['spoofer']}: {record['divergence']['why']}"])
    print_lines(tables.assumption_lines(record))
    if "figure" in record:
        typer.echo(f"written: {record['figure']}")
