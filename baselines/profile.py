"""Optimised open-loop profiles: ``python -m baselines.profile --detector ewma --out ewma.json``.

A blind spoofer that plans one curve of the rate for all runs, tuned by CMA-ES.  A learned blind
policy that does not reach it has not learned anything.

1. The ramps are tuned on the runs of the choice, by `spoofgym.bench.search.amplitude`.
2. The search begins between the two ramps, or at a given card, on runs of its own.
3. The shapes that it offers are scaled to the alarm budget on the runs of the choice.

All runs are of the training split, so that evaluation runs share no noise with them.  After every
generation the record of the search is written beside the card; the same command goes on from there.
"""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.report.table import ALARMS_HEAD, alarm_texts
from spoofgym.bench.scores.statistics import BUDGET
from spoofgym.bench.search.amplitude import Tuning
from spoofgym.cli import INTERRUPTED, clear_errors
from spoofgym.cli.bench import calibrate_with_progress
from spoofgym.cli.options import given_options
from spoofgym.core.progress import ProgressCallback, show_progress
from spoofgym.core.registry import parse_spec, refuse_given
from spoofgym.simulation import Timeline
from spoofgym.tasks import task_of

from .profile_card import profile_card, rivals
from .profile_choice import Choice
from .profile_run import Bounds, ProfileRun, RunSettings, Tell
from .profile_settings import SearchSettings

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


UNTOLD = {"threads", "resume", "as_json"}
"""Options that change nothing in the card."""
FILES = {"out", "start"}
"""Options of which the card tells the name of the file only, not where it lay."""


@app.command()
@clear_errors
def main(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="Card of the profile, a .json file.")],
    task: Annotated[
        str | None,
        typer.Option(
            help="Task of spoofgym-bench-v1, T1 to T5, which decides detector, scenario, attack "
            "and times."
        ),
    ] = None,
    detector: Annotated[
        str, typer.Option(help="Detector: a name, with settings as name:key=value or JSON.")
    ] = "ewma",
    scenario: Annotated[str, typer.Option(help="Scenario, likewise.")] = "zhong2025",
    attack: Annotated[str, typer.Option(help="Attack, likewise.")] = "false-position",
    heading: Annotated[
        float, typer.Option(help="Direction of the profile, in degrees clockwise from north.")
    ] = 90.0,
    knots: Annotated[int, typer.Option(help="Knots of the curve, 8 to 16.")] = 12,
    cross: Annotated[
        bool, typer.Option("--cross/--no-cross", help="Search for a curve across the heading too.")
    ] = False,
    seconds: Annotated[
        float | None,
        typer.Option(
            help="Time of the search, interruptions not counted. Default: 120, or no limit where "
            "--generations is given."
        ),
    ] = None,
    generations: Annotated[
        int | None, typer.Option(min=1, help="Stop after so many generations.")
    ] = None,
    population: Annotated[int, typer.Option(help="Candidates of a generation.")] = 12,
    runs: Annotated[int, typer.Option(help="Training runs of the search.")] = 128,
    batch: Annotated[
        int, typer.Option(help="Runs that a generation plays, in turn; all of them at most.")
    ] = 32,
    select_runs: Annotated[
        int, typer.Option(help="Training runs of the choice, which the search does not see.")
    ] = 512,
    budget: Annotated[
        float,
        typer.Option(
            help="Largest P(alarm | silent without attack), which its upper 95 % limit keeps."
        ),
    ] = BUDGET,
    restarts: Annotated[
        int, typer.Option(help="How often a search that has converged begins again.")
    ] = 0,
    seed: Annotated[int, typer.Option(help="All chance follows from this number.")] = 0,
    start: Annotated[
        Path | None, typer.Option(help="Card of a profile to begin at, instead of the ramps.")
    ] = None,
    warmup_s: Annotated[float, typer.Option(help="Clean run before the attack, in seconds.")] = 200,
    live_s: Annotated[float, typer.Option(help="Its last part, with the detector live.")] = 180.0,
    attack_s: Annotated[float, typer.Option(help="Command phase, in seconds.")] = 150.0,
    time_to_alert_s: Annotated[float, typer.Option(help="Time to alert, in seconds.")] = 10.0,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads of the engine. Default: as many as pay.")
    ] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume/--overwrite", help="Go on with a search that was interrupted."),
    ] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, and nothing else.")] = False,
) -> None:
    """Search for the open-loop profile that gets farthest within an alarm budget."""
    settings = RunSettings(
        search=SearchSettings(
            knots=knots,
            cross=cross,
            heading_deg=heading,
            population=population,
            batch=batch,
            restarts=restarts,
            budget=budget,
            seed=seed,
        ),
        runs=runs,
        select_runs=select_runs,
    )
    if task is None:
        world: dict[str, Any] = {
            "scenario": parse_spec(scenario),
            "attack": parse_spec(attack),
            "detectors": [parse_spec(detector)],
            "timeline": Timeline(
                warmup_s=warmup_s,
                live_s=live_s,
                attack_s=attack_s,
                time_to_alert_s=time_to_alert_s,
            ),
        }
    else:
        world = _world_of_task(context, task)
    suite = Suite(
        **world,
        spoofers=[
            {"name": "ramp", "rate_mps": "tuned", "heading_deg": heading},
            {"name": "accelerating-ramp", "acceleration_mps2": "tuned", "heading_deg": heading},
        ],
        entropy=seed,
        tuning=Tuning(runs=select_runs, sift_runs=max(select_runs // 16, 1), budget=budget),
    )
    calibrate_with_progress(suite.world, suite.detector_entries, threads)
    bounds = Bounds.of(seconds, generations)
    run = ProfileRun(suite, settings, out, start=start, threads=threads, resume=resume)
    try:
        with show_progress(1.0) as bar:
            choice = run.play(bounds, _teller(bar))
    except KeyboardInterrupt:
        typer.echo(
            f"interrupted: what is finished is kept in {run.path}; the same command goes on from "
            "there",
            err=True,
        )
        raise typer.Exit(INTERRUPTED) from None
    card = profile_card(run, choice, _command(context))
    card.save(out)
    run.path.unlink()
    if as_json:
        typer.echo(json.dumps(card.model_dump(), indent=1, allow_nan=False))
        return
    _print_table(run, choice)
    typer.echo(f"written: {out}")


DECIDED = {"detector", "scenario", "attack", "warmup_s", "live_s", "attack_s", "time_to_alert_s"}
"""Options that a task decides."""


def _world_of_task(context: typer.Context, task: str) -> dict[str, Any]:
    """What a task tells a `Suite`."""
    refuse_given("--task", given_options(context, DECIDED).values())
    return task_of(task).suite_kwargs


def _command(context: typer.Context) -> str:
    """Command line that makes the card again, in the folder of its files."""
    words = ["python", "-m", "baselines.profile"]
    for option in context.command.params:
        name = str(option.name)
        source = context.get_parameter_source(name)
        if name in UNTOLD or source is None or source.name != "COMMANDLINE":
            continue
        value = context.params[name]
        if isinstance(value, bool):
            words.append((option.opts if value else option.secondary_opts)[0])
        else:
            words += [option.opts[0], Path(value).name if name in FILES else str(value)]
    return shlex.join(words)


def _teller(bar: ProgressCallback) -> Tell:
    """What is told which part of the search is done, and what is going on."""
    done = 0.0

    def tell(part: float, now: str) -> None:
        nonlocal done
        bar.advance(part - done, now)
        done = part

    return tell


def _print_table(run: ProfileRun, choice: Choice) -> None:
    """The profile beside the ramps, on the runs of the choice."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    if not console.is_terminal:
        console = Console(width=120)
    title = (
        f"{run.settings.select_runs} training runs against {run.detector.label}, of which "
        f"{choice.fit.counted} are silent without attack; of these at most {100 * run.budget:g} % "
        "may alarm, by the upper 95 % limit"
    )
    table = Table(title=Text(title), title_justify="left", box=box.SIMPLE_HEAD)
    for name in ("spoofer", *ALARMS_HEAD, "stealthy displacement [m]"):
        table.add_column(Text(name))
    for row in rivals(run, choice):
        table.add_row(
            str(row["spoofer"]) + ("" if row["within_budget"] else " (beyond the budget)"),
            *alarm_texts(row),
            f"{row['stealthy_displacement_m']:.2f}",
        )
    console.print(table)


if __name__ == "__main__":
    app()
