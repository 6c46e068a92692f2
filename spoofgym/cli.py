"""The command line: ``spoofgym list | card | run | render | tune | bench | report | perf``.

Nothing that is slow to load is imported before a command needs it.
"""

from __future__ import annotations

import functools
import json
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ParamSpec, TypeVar

import typer

if TYPE_CHECKING:
    from datetime import date

    from .bench.campaign import Progress
    from .bench.entries import Entry
    from .bench.real import RealInput
    from .bench.suite import Suite
    from .sim.scenario import Scenario

_signals: list[int] = []
"""What has asked the program to end."""
P = ParamSpec("P")
R = TypeVar("R")
TRACEBACK_VARIABLE = "SPOOFGYM_TRACEBACK"
ENV = "spoofgym/TightlyCoupled-v0"
LARGEST_RUNS = 1_000_000
"""More are a slip of the keyboard."""
INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""

app = typer.Typer(
    name="spoofgym",
    help="GNSS spoofing and its detection as a game: a benchmark, for defence research.",
    epilog=f"With {TRACEBACK_VARIABLE}=1 in the environment an error shows where it came from.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

SPEC_HELP = (
    "A name (see `spoofgym list`), with settings as name:key=value,key=value or as JSON "
    '{"name": ..., "key": value}; or module:Class of your own, looked for in this folder too.'
)
KindArgument = Annotated[
    str | None,
    typer.Argument(help="envs, scenarios, attacks, detectors, spoofers or shipped; all of them."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON, and nothing else.")]
EnvOption = Annotated[
    str,
    typer.Option(
        help="Environment whose victim is attacked: spoofgym/TightlyCoupled-v0, "
        "spoofgym/LooselyCoupled-v0, spoofgym/Snapshot-v0 or spoofgym/WheeledRobot-v0."
    ),
]
SettingsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Setting of the victim that has no option of its own, may be repeated: name=value, "
        "the value as JSON, as in satellites=10 or domain='{\"start_s\": [0, 60]}'.",
    ),
]
ScenarioOption = Annotated[
    str, typer.Option(help="Scenario: a name, with settings as for a detector.")
]
ErrorsOption = Annotated[
    str | None,
    typer.Option(help="GNSS errors instead of the scenario's own: groves, zhong2025 ..."),
]
ImuOption = Annotated[
    str | None,
    typer.Option(help="Grade of the inertial sensors instead: aviation, tactical, consumer."),
]
TuningOption = Annotated[
    str,
    typer.Option(
        help="Noise that the receiver assumes: as the papers print it, or as the world "
        "has it (matched)."
    ),
]
DetectorOption = Annotated[
    str | None,
    typer.Option(help=f"Detector. Default: ewma, or one that suits the victim. {SPEC_HELP}"),
]
AttackOption = Annotated[str, typer.Option(help=f"What the spoofer can do. {SPEC_HELP}")]
TrackOption = Annotated[
    Path | None,
    typer.Option(
        help="Recorded flight (.csv, .json, .parquet; .gz too) to fly instead of the "
        "scenario's. Needs --ephemeris."
    ),
]
EphemerisOption = Annotated[
    Path | None, typer.Option(help="RINEX 2 or 3 navigation file with the GPS satellites.")
]
FromOption = Annotated[
    float | None,
    typer.Option(
        "--from",
        help="Start, in seconds after the first row of the track. Default: that of the "
        "longest airborne stretch without a gap.",
    ),
]
DurationOption = Annotated[
    float | None, typer.Option(help="Duration of the flight in seconds. Default: ten minutes.")
]
DateOption = Annotated[
    str | None,
    typer.Option(
        "--date", help="Day of the flight, YYYY-MM-DD. Default: the day of the ephemerides."
    ),
]
WarmupOption = Annotated[
    float,
    typer.Option(
        help="Clean run before the attack, in seconds. The defaults of the times are those of "
        "spoofgym/TightlyCoupled-v0; the others have their own."
    ),
]
LiveOption = Annotated[
    float, typer.Option(help="Its last part, with the detectors live, in seconds.")
]
AttackTimeOption = Annotated[float, typer.Option(help="Command phase of the attack, in seconds.")]
AlertOption = Annotated[
    float,
    typer.Option(
        help="Time to alert, in seconds: what was induced this short before an alarm "
        "does not count."
    ),
]
SeedOption = Annotated[int, typer.Option(help="Seed of the random number generators.")]
ThreadsOption = Annotated[
    int | None, typer.Option(min=1, help="Threads of the engine. Default: all useful cores.")
]
BudgetOption = Annotated[
    float,
    typer.Option(
        help="Alarm budget of tuned spoofers: how much more often than without attack an "
        "alarm may come, as a part of the runs."
    ),
]
TrainingOption = Annotated[
    int,
    typer.Option(
        min=2,
        max=LARGEST_RUNS,
        help="Training runs for tuned spoofers; they share no noise with the evaluation runs.",
    ),
]
OraclesOption = Annotated[
    bool,
    typer.Option(
        "--allow-oracles",
        help="Let detectors play that know the attack by their settings; the results say so.",
    ),
]
TaskOption = Annotated[
    str | None,
    typer.Option(
        help="Task of spoofgym-bench-v1, T1 to T6, which sets scenario, receiver, attack, times "
        "and detectors; see `spoofgym tasks`."
    ),
]
RunOption = Annotated[
    int,
    typer.Option(
        "--run", min=0, max=LARGEST_RUNS - 1, help="Which of the benchmark's evaluation runs."
    ),
]
OutOption = Annotated[Path, typer.Option(help="Folder of the results.")]


def clear_errors(function: Callable[P, R]) -> Callable[P, R]:
    """Print what users did wrong in one line, and leave with exit code 2."""

    @functools.wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        """Call the command."""
        try:
            return function(*args, **kwargs)
        except (ValueError, TypeError, ImportError, OSError) as error:
            if os.environ.get(TRACEBACK_VARIABLE) or isinstance(error, BrokenPipeError):
                raise
            text = " ".join(str(error).split())
            if isinstance(error, OSError) and error.filename and error.strerror:
                text = f"{error.filename}: {error.strerror}"
            typer.echo(f"spoofgym: error: {text}", err=True)
            raise typer.Exit(2) from error

    return wrapped


@app.callback(invoke_without_command=True)
def _main(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """GNSS spoofing and its detection as a game: a benchmark, for defence research."""
    if version:
        from . import __version__

        typer.echo(__version__)
        raise typer.Exit


def _print_json(value: Any) -> None:
    typer.echo(json.dumps(value, indent=2, allow_nan=False))


def _print_table(
    title: str, head: Sequence[str], rows: Sequence[Sequence[str]], *, names: int = 1
) -> None:
    """Print a table whose first columns, names, are never broken."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    if not console.is_terminal:
        console = Console(width=180)
    # as Text, since rich takes a unit in brackets for a style
    table = Table(title=Text(title), title_justify="left", box=box.SIMPLE_HEAD)
    for k, name in enumerate(head):
        table.add_column(Text(name), overflow="fold", no_wrap=k < names)
    for row in rows:
        table.add_row(*map(Text, row))
    console.print(table)


def _specs(texts: Sequence[str]) -> list[dict[str, Any]]:
    """Names and settings; a class of the user's may lie in the working directory."""
    from .bench.specs import parse_spec

    specs = [parse_spec(text) for text in texts]
    if any(":" in spec["name"] for spec in specs) and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    return specs


def _world(
    scenario: str,
    errors: str | None,
    imu: str | None,
    track: Path | None,
    ephemeris: Path | None,
    from_s: float | None,
    duration: float | None,
    day: str | None,
) -> tuple[Scenario, RealInput | None]:
    """The scenario of the options, and the reports of real input."""
    from .sim.scenario import make_scenario

    (spec,) = _specs([scenario])
    changes = {key: value for key, value in (("errors", errors), ("imu", imu)) if value is not None}
    if track is None and ephemeris is None:
        for name, given in (("--from", from_s), ("--duration", duration), ("--date", day)):
            if given is not None:
                raise ValueError(f"{name} cuts a recorded track; there is no --track")
        return make_scenario({**spec, **changes}), None
    if track is None or ephemeris is None:
        raise ValueError("--track and --ephemeris belong together: a flight needs its satellites")
    from .bench.real import real_scenario

    named = make_scenario({**spec, **changes})
    real = real_scenario(
        track,
        ephemeris,
        from_s=from_s,
        duration_s=duration,
        day=None if day is None else _day(day),
        errors=named.errors,
        imu=named.imu,
        epoch_interval_s=named.epoch_interval_s,
        channels=named.channels,
        mask_deg=named.mask_deg,
    )
    return real.scenario, real


def _day(text: str) -> date:
    from datetime import date

    try:
        return date.fromisoformat(text)
    except ValueError as error:
        raise ValueError(f"--date must be YYYY-MM-DD, got {text!r}") from error


class _Bar:
    """Progress of a campaign on the terminal."""

    def __init__(self, total: float) -> None:
        """Show it, empty."""
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        self.bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
        )
        self.task = self.bar.add_task("compiling, a minute the first time", total=total)

    def advance(self, amount: float, now: str) -> None:
        """Show it; end here where an interrupt was lost, as in a destructor."""
        if _signals:
            raise KeyboardInterrupt
        if amount > 0.0:
            self.bar.update(self.task, advance=amount, description=now)


@contextmanager
def _progress(total: float) -> Iterator[Progress]:
    bar = _Bar(max(total, 1e-9))
    with bar.bar:
        yield bar


@app.command("list")
@clear_errors
def list_(kind: KindArgument = None, as_json: JsonOption = False) -> None:
    """List what there is: environments, scenarios, attacks, detectors, spoofers, shipped ones."""
    from ._registry import check_choice
    from .bench.listing import KINDS, table_of

    if kind is not None:
        check_choice("kind", kind, KINDS)
    found = {name: rows() for name, rows in KINDS.items() if kind in {None, name}}
    if as_json:
        _print_json(found)
        return
    for name, rows in found.items():
        _print_table(name, *table_of(name, rows))


@app.command()
@clear_errors
def card(
    name: Annotated[
        str, typer.Argument(help="A shipped spoofer, or a card or an ONNX file that has one.")
    ],
    as_json: JsonOption = False,
) -> None:
    """Show the card of a spoofer: what it fits, what it knows, how it was made, what it reached."""
    from .bench.cards import SCORES_HEAD, card_rows, find_card, score_rows

    found = find_card(name)
    if as_json:
        _print_json(found.model_dump(mode="json"))
        return
    _print_table(found.name, ("", ""), card_rows(found))
    if found.scores:
        _print_table("scores", SCORES_HEAD, score_rows(found))


@app.command()
@clear_errors
def run(
    context: typer.Context,
    detector: DetectorOption = None,
    spoofer: Annotated[
        str, typer.Option(help=f"Spoofer; a shipped name or an .onnx file, too. {SPEC_HELP}")
    ] = "ramp",
    number: RunOption = 0,
    out: Annotated[Path, typer.Option(help="File of the picture; .png without an ending.")] = Path(
        "episode.png"
    ),
    picture: Annotated[bool, typer.Option(help="Draw the picture.")] = True,
    as_json: JsonOption = False,
    env: EnvOption = ENV,
    settings: SettingsOption = None,
    scenario: ScenarioOption = "zhong2025",
    errors: ErrorsOption = None,
    imu: ImuOption = None,
    tuning: TuningOption = "paper",
    attack: AttackOption = "false-position",
    track: TrackOption = None,
    ephemeris: EphemerisOption = None,
    from_s: FromOption = None,
    duration: DurationOption = None,
    day: DateOption = None,
    warmup_s: WarmupOption = 200.0,
    live_s: LiveOption = 60.0,
    attack_s: AttackTimeOption = 150.0,
    time_to_alert_s: AlertOption = 10.0,
    seed: SeedOption = 0,
    allow_oracles: OraclesOption = False,
) -> None:
    """Play one run of the benchmark and its clean twin: a summary, and a picture."""
    from .bench.episode import draw_episode, play_episode

    suite, real = _suite(context, [detector] if detector else None, _specs([spoofer]))
    player = _untuned(suite)
    if not as_json:
        _print_lines(real)
    episode = play_episode(suite, suite.detector_entries[-1], player, number)
    summary = episode.summary()
    if picture:
        summary["picture"] = str(draw_episode(episode, out))
    if as_json:
        _print_json({**summary, "input": None if real is None else real.reports})
        return
    rows = [(key, "-" if value is None else str(value)) for key, value in summary.items()]
    _print_table(f"{player.label} against {suite.detector_entries[-1].label}", ("", ""), rows)


@app.command()
@clear_errors
def render(
    context: typer.Context,
    detector: DetectorOption = None,
    spoofer: Annotated[
        str, typer.Option(help=f"Spoofer; a shipped name or an .onnx file, too. {SPEC_HELP}")
    ] = "ramp",
    number: RunOption = 0,
    out: Annotated[
        Path, typer.Option(help="File of the animation, .gif or .mp4 (needs FFmpeg).")
    ] = Path("run.gif"),
    fps: Annotated[
        float, typer.Option(help="Frames a second; 2 is real time with epochs of 0.5 s.")
    ] = 25.0,
    every: Annotated[int, typer.Option(min=1, help="A frame for every so many epochs.")] = 1,
    env: EnvOption = ENV,
    settings: SettingsOption = None,
    scenario: ScenarioOption = "zhong2025",
    errors: ErrorsOption = None,
    imu: ImuOption = None,
    tuning: TuningOption = "paper",
    attack: AttackOption = "false-position",
    track: TrackOption = None,
    ephemeris: EphemerisOption = None,
    from_s: FromOption = None,
    duration: DurationOption = None,
    day: DateOption = None,
    warmup_s: WarmupOption = 200.0,
    live_s: LiveOption = 60.0,
    attack_s: AttackTimeOption = 150.0,
    time_to_alert_s: AlertOption = 10.0,
    seed: SeedOption = 0,
    allow_oracles: OraclesOption = False,
) -> None:
    """Draw one run of the benchmark as a animation: flight, satellites, statistic, error."""
    from .bench.animate import frame_count, play_frames
    from .envs.rendering import save_animation

    suite, real = _suite(context, [detector] if detector else None, _specs([spoofer]))
    judge, player = suite.detector_entries[-1], _untuned(suite)
    _print_lines(real)
    with _progress(frame_count(suite, judge, every)) as progress:

        def frames() -> Iterator[Any]:
            """Frames, counted."""
            for frame in play_frames(suite, judge, player, number, every=every):
                yield frame
                progress.advance(1.0, "drawing")

        save_animation(frames(), out, fps)
    typer.echo(f"written: {out}")


@app.command()
@clear_errors
def tune(
    context: typer.Context,
    detector: Annotated[
        list[str] | None, typer.Option(help=f"Detector, may be repeated. {SPEC_HELP}")
    ] = None,
    spoofer: Annotated[
        list[str] | None,
        typer.Option(help="Spoofer, may be repeated: ramp, accelerating-ramp, step, or your own."),
    ] = None,
    budget: BudgetOption = 0.05,
    training_seeds: TrainingOption = 1024,
    as_json: JsonOption = False,
    env: EnvOption = ENV,
    settings: SettingsOption = None,
    scenario: ScenarioOption = "zhong2025",
    errors: ErrorsOption = None,
    imu: ImuOption = None,
    tuning: TuningOption = "paper",
    attack: AttackOption = "false-position",
    track: TrackOption = None,
    ephemeris: EphemerisOption = None,
    from_s: FromOption = None,
    duration: DurationOption = None,
    day: DateOption = None,
    warmup_s: WarmupOption = 200.0,
    live_s: LiveOption = 60.0,
    attack_s: AttackTimeOption = 150.0,
    time_to_alert_s: AlertOption = 10.0,
    seed: SeedOption = 0,
    allow_oracles: OraclesOption = False,
    threads: ThreadsOption = None,
) -> None:
    """Find the strongest ramp that keeps to an alarm budget, on training runs."""
    from .bench.campaign import Silent, search, search_work, training_start
    from .bench.entries import TUNED, build_spoofer
    from .bench.tuning_table import tuning_head, tuning_rows

    specs = _specs(spoofer or ["ramp", "accelerating-ramp"])
    for spec in specs:
        untuned = {key: value for key, value in spec.items() if value != TUNED}
        tunable = build_spoofer(untuned).tunable
        if tunable is None:
            raise ValueError(f"spoofer {spec['name']!r} has no setting to tune")
        spec[tunable] = TUNED
    suite, real = _suite(context, detector, specs)
    if not as_json:
        _print_lines(real)
    entries = [entry for entry in suite.spoofer_entries if entry.tuned]
    each = 2.0 * suite.tuning.runs + len(entries) * search_work(suite)
    results = []
    with _progress(each * len(suite.detector_entries)) as progress:
        for judge in suite.detector_entries:
            start, clean = training_start(suite, judge, threads, progress or Silent())
            results += [search(suite, judge, entry, start, clean, progress) for entry in entries]
    if as_json:
        _print_json([result.as_dict() for result in results])
        return
    for result in results:
        table = result.as_dict()
        _print_table(
            f"{result.spoofer} against {result.detector}: alarm rate at most {100 * budget:g} % "
            f"above {100 * result.clean_alarm_rate:.1f} %, after a margin of {result.margin:g} "
            f"standard errors; {result.runs} training runs, fewer only sift, without a margin",
            tuning_head(table),
            tuning_rows(table),
        )
        if not result.within_budget:
            typer.echo(f"nothing is within the budget; the smallest value is {result.value:g}")


@app.command()
@clear_errors
def bench(
    context: typer.Context,
    task: TaskOption = None,
    detector: Annotated[
        list[str] | None,
        typer.Option(
            help="Detector, may be repeated. Default: snapshot-chi2 and ewma, or those that suit "
            f"the victim. {SPEC_HELP}"
        ),
    ] = None,
    spoofer: Annotated[
        list[str] | None,
        typer.Option(
            help="Spoofer, may be repeated; a setting may be `tuned`, as in "
            "step:size_m=tuned, and a ramp without settings is; a shipped spoofer by its name, a "
            "learned one by its .onnx file. Default: none, step, ramp, accelerating-ramp, and the "
            "shipped ones that fit."
        ),
    ] = None,
    seeds: Annotated[
        int,
        typer.Option(
            min=2, max=LARGEST_RUNS, help="Evaluation runs of every cell, the same for all."
        ),
    ] = 200,
    out: OutOption = Path("results"),
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the results of another campaign.")
    ] = False,
    as_json: JsonOption = False,
    env: EnvOption = ENV,
    settings: SettingsOption = None,
    scenario: ScenarioOption = "zhong2025",
    errors: ErrorsOption = None,
    imu: ImuOption = None,
    tuning: TuningOption = "paper",
    attack: AttackOption = "false-position",
    track: TrackOption = None,
    ephemeris: EphemerisOption = None,
    from_s: FromOption = None,
    duration: DurationOption = None,
    day: DateOption = None,
    warmup_s: WarmupOption = 200.0,
    live_s: LiveOption = 60.0,
    attack_s: AttackTimeOption = 150.0,
    time_to_alert_s: AlertOption = 10.0,
    budget: BudgetOption = 0.05,
    training_seeds: TrainingOption = 1024,
    seed: SeedOption = 0,
    allow_oracles: OraclesOption = False,
    threads: ThreadsOption = None,
) -> None:
    """Play detectors against spoofers on the same runs; interrupted, it goes on when run again."""
    from .bench.campaign import expected_work, run_campaign
    from .bench.store import ResultsFolder

    spoofers = _tuned_by_default(_specs(spoofer)) if spoofer else None
    real = None
    if task is None:
        suite, real = _suite(context, detector, spoofers)
    else:
        _refuse_world(context)
        suite = _suite_of_task(task, spoofers, seed, budget, training_seeds, seeds)
        suite.check_fit()
    folder = ResultsFolder(out)
    folder.open(suite, overwrite=overwrite)
    if not as_json:
        _print_lines(real)
        for line in suite.left_out:
            typer.echo(line)
    try:
        with _progress(expected_work(suite, folder)) as progress:
            run_campaign(suite, folder, threads=threads, progress=progress)
    except KeyboardInterrupt:
        done = sum(
            folder.has_cell(judge.label, player.label)
            for judge in suite.detector_entries
            for player in suite.spoofer_entries
        )
        total = len(suite.detector_entries) * len(suite.spoofer_entries)
        typer.echo(
            f"interrupted: {done} of {total} cells are finished and kept in {out}; the same "
            "command goes on from there",
            err=True,
        )
        raise typer.Exit(INTERRUPTED) from None
    _report(folder, as_json, None if real is None else real.reports)


def _tuned_by_default(specs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Names without settings as the benchmark plays them by default."""
    from .bench.entries import DEFAULT_SPOOFERS

    usual = {spec["name"]: spec for spec in DEFAULT_SPOOFERS}
    return [usual.get(spec["name"], spec) if len(spec) == 1 else spec for spec in specs]


@app.command()
@clear_errors
def tasks(as_json: JsonOption = False) -> None:
    """List the tasks of spoofgym-bench-v1, with the scores that are known."""
    from .bench.task_scores import stored_scores
    from .tasks import TASKS

    scores = stored_scores()
    if as_json:
        _print_json(
            [
                {"key": key, "env_id": task.env_id, "title": task.title, **scores.get(key, {})}
                for key, task in TASKS.items()
            ]
        )
        return
    columns = ("none", "ramp", "profile", "ppo")
    rows = []
    for key, task in TASKS.items():
        found = scores.get(key, {}).get("undetected_displacement_m", {})
        texts = (f"{found[name]:.1f}" if found.get(name) is not None else "-" for name in columns)
        rows.append((key, task.env_id, *texts, task.title))
    heads = ("task", "environment", *(f"{name} [m]" for name in columns), "what it asks for")
    _print_table("spoofgym-bench-v1: mean undetected displacement", heads, rows)


@app.command()
@clear_errors
def report(
    folder: Annotated[Path, typer.Argument(help="Folder of the results.")] = Path("results"),
    as_json: JsonOption = False,
) -> None:
    """Score the finished cells of a folder again, with table and picture."""
    from .bench.store import ResultsFolder

    _report(ResultsFolder(folder), as_json, None)


@app.command()
@clear_errors
def perf(
    num_envs: Annotated[int, typer.Option(min=1, help="Receivers of the vector environment.")] = 64,
    threads: ThreadsOption = None,
    duration: Annotated[
        float, typer.Option(help="Shortest time of each measurement, in seconds.")
    ] = 10.0,
    as_json: JsonOption = False,
) -> None:
    """Measure how fast this machine steps the environments, resets included."""
    from .bench.perf import machine, overhead, single_speed, vector_speed

    found: dict[str, Any] = {
        "machine": machine(),
        "single": single_speed(duration),
        "vector": vector_speed(num_envs, threads, duration),
        "overhead": [overhead(1), overhead(max(num_envs, 2))],
    }
    if as_json:
        _print_json(found)
        return
    rows = [
        (key, *(str(found[kind].get(key, "-")) for kind in ("single", "vector")))
        for key in found["vector"]
    ]
    _print_table("speed", ("", "single", "vector"), rows)
    more = found["overhead"]
    _print_table(
        "a step of the environment on top of its engine, one thread",
        ("", "single", "vector"),
        [(key, *(str(each[key]) for each in more)) for key in more[0]],
    )


SCENARIO_OPTIONS = (
    "scenario",
    "errors",
    "imu",
    "tuning",
    "attack",
    "track",
    "ephemeris",
    "from_s",
    "duration",
    "day",
)
"""Options of the tightly coupled receiver alone."""
TIMES = ("warmup_s", "live_s", "attack_s", "time_to_alert_s")
WORLD_OPTIONS = ("env", "settings", "detector", *SCENARIO_OPTIONS, *TIMES)
"""Options that a task decides."""


def _given(context: typer.Context, names: Sequence[str]) -> dict[str, str]:
    """Which of some options are on the command line, as they are written there."""
    found = {}
    for option in context.command.params:
        source = context.get_parameter_source(str(option.name))
        if option.name in names and source is not None and source.name == "COMMANDLINE":
            found[str(option.name)] = option.opts[0]
    return found


def _refuse_world(context: typer.Context) -> None:
    """Raise where an option is given that the task decides."""
    for option in _given(context, WORLD_OPTIONS).values():
        raise ValueError(f"{option} can't be given with --task, which decides it")


def _suite_of_task(
    task: str,
    spoofers: list[dict[str, Any]] | None,
    seed: int,
    budget: float,
    training: int,
    runs: int,
) -> Suite:
    """The suite of a task."""
    from .bench.suite import Suite, Tuning
    from .tasks import SUITE, task_of

    chosen = task_of(task)
    return Suite(
        **chosen.suite_kwargs,
        spoofers=spoofers,
        runs=runs,
        entropy=seed,
        tuning=Tuning(runs=training, sift_runs=max(training // 16, 1), budget=budget),
        notes=(f"task {chosen.key} of {SUITE}: {chosen.title}",),
    )


def _suite(
    context: typer.Context,
    detectors: Sequence[str] | None,
    spoofers: list[dict[str, Any]] | None,
) -> tuple[Suite, RealInput | None]:
    """The suite of the options, and the reports of real input."""
    from .bench.suite import Suite, Tuning

    options = context.params
    world, real = _world_of(context)
    training = options.get("training_seeds", 1024)
    suite = Suite(
        env=options["env"],
        **world,
        settings=_settings(options["settings"] or ()),
        detectors=_specs(detectors) if detectors else None,
        spoofers=spoofers,
        runs=options.get("seeds", 200),
        entropy=options["seed"],
        tuning=Tuning(
            runs=training, sift_runs=max(training // 16, 1), budget=options.get("budget", 0.05)
        ),
        notes=() if real is None else real.lines,
        allow_oracles=options["allow_oracles"],
    )
    suite.check_fit()
    return suite, real


def _world_of(context: typer.Context) -> tuple[dict[str, Any], RealInput | None]:
    """Settings of the victim that have options of their own, and the reports of real input."""
    options = context.params
    if options["env"] != ENV:
        for option in _given(context, SCENARIO_OPTIONS).values():
            raise ValueError(
                f"{option} is an option of {ENV}, not of {options['env']}, whose settings are "
                "given with --set"
            )
        times = {name: options[name] for name in _given(context, TIMES)}
        return ({"timeline": times} if times else {}), None
    scenario, real = _world(
        **{name: options[name] for name in SCENARIO_OPTIONS if name not in ("tuning", "attack")}
    )
    (attack,) = _specs([options["attack"]])
    return {
        "scenario": scenario,
        "receiver": {"tuning": options["tuning"]},
        "attack": attack,
        "timeline": {name: options[name] for name in TIMES},
    }, real


def _settings(texts: Sequence[str]) -> dict[str, Any]:
    """Settings by name."""
    from .bench.specs import parse_setting

    found: dict[str, Any] = {}
    for text in texts:
        name, value = parse_setting(text)
        if name in found:
            raise ValueError(f"--set {name} is given twice: {found[name]!r} and {value!r}")
        found[name] = value
    return found


def _untuned(suite: Suite) -> Entry:
    """The suite's own spoofer, which has to know all its settings."""
    player = suite.spoofer_entries[-1]
    if player.tuned:
        raise ValueError(
            f"`{player.tuned}` = tuned needs a search: take the value that `spoofgym tune` finds"
        )
    return player


def _print_lines(real: RealInput | None) -> None:
    if real is not None:
        for line in real.lines:
            typer.echo(line)


def _report(folder: Any, as_json: bool, reports: Any) -> None:
    """Write table, scores and picture, and print the tables."""
    from .bench.picture import draw_campaign
    from .bench.report import markdown
    from .bench.store import SUMMARY, TABLE
    from .bench.summary import summarize
    from .bench.tables import (
        CLEAN_HEAD,
        RIVALS_HEAD,
        attack_rows,
        attacks_head,
        clean_rows,
        reference_lines,
        rival_rows,
    )

    summary = summarize(folder)
    if not summary["cells"]:
        raise ValueError(f"{folder.path} holds no finished cell yet")
    written = [
        folder.put_text(SUMMARY, json.dumps(summary, indent=1, allow_nan=False) + "\n"),
        folder.put_text(TABLE, markdown(folder.config(), summary)),
    ]
    try:
        written.append(draw_campaign(folder, summary))
    except ImportError as error:
        typer.echo(f"no picture: {error}", err=True)
    if as_json:
        _print_json({**summary, "folder": str(folder.path), "input": reports})
        return
    head = attacks_head(summary)
    _print_table(f"{summary['scenario']}: attacks", head, attack_rows(summary), names=2)
    if rows := rival_rows(summary):
        _print_table("spoofers compared, run by run", RIVALS_HEAD, rows, names=2)
        for line in reference_lines(summary):
            typer.echo(line)
    _print_table("without attack", CLEAN_HEAD, clean_rows(summary))
    if summary["missing"]:
        typer.echo(f"not finished: {', '.join(summary['missing'])}")
    typer.echo(f"written: {', '.join(str(path) for path in written)}")


def _interrupt(number: int, _: Any) -> None:
    _signals.append(number)
    raise KeyboardInterrupt


def main() -> None:
    """Run the command line; Ctrl-C and SIGTERM end it in order, with 130 and 143."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:  # as in the background of a shell
            signal.signal(number, _interrupt)
    try:
        app()
    finally:
        if _signals:
            sys.exit(128 + _signals[0])
