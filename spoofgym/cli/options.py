"""Options of several commands, each written once."""

from __future__ import annotations

import functools
import inspect
import os
import sys
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer
from typer import Option

from .app import progress

if TYPE_CHECKING:
    from ..bench.experiments import Experiment, Reader

ENV, PLAIN = "spoofgym/TightlyCoupled-v0", "spoofgym/Zhong2025-v0"
"""Environment where none is named, and of another scenario."""
LARGEST_RUNS = 1_000_000
"""More are a slip of the keyboard."""
SPEC_HELP = (
    "A name (see `spoofgym list`), with settings as name:key=value,key=value or as JSON "
    '{"name": ..., "key": value}; or module:Class of your own, looked for in this folder too.'
)
Json = Annotated[bool, Option("--json", help="Print JSON, and nothing else.")]
Task = Annotated[
    str | None,
    Option(
        help="Task, S1 to S3 or T1 to T6 of the first suite, which sets scenario, receiver, "
        "attack, times and detectors; see `spoofgym list tasks`."
    ),
]
Seed = Annotated[int, Option(help="Seed of the random number generators.")]
Threads = Annotated[
    int | None, Option(min=1, help="Threads of the engine. Default: all useful cores.")
]
Device = Annotated[
    str,
    Option(
        help="Where runs are played: cpu, or cuda for all that a GPU can play, with the same bits."
    ),
]
Processes = Annotated[
    int, Option("--jobs", min=1, help="Processes on this machine that compute in parallel.")
]
Backend = Annotated[
    str,
    Option(
        help="Where it computes: local; dask or ray, on this machine, or with :address on a "
        "cluster that runs already."
    ),
]
Shard = Annotated[
    str | None,
    Option(
        metavar="I/N",
        help="Compute the i-th of n parts alone, such as 1/4; others fill the same folder.",
    ),
]
Budget = Annotated[
    str,
    Option(
        help="How much is played: quick, standard or full. It scales tuning, searches and runs "
        "that are scored; an option for one of them overrides it."
    ),
]
Runs = Annotated[
    int | None,
    Option(min=2, max=LARGEST_RUNS, help="Evaluation runs, the same for all. Default: --budget's."),
]


def parse_specs(texts: Sequence[str]) -> list[dict[str, Any]]:
    """Names and settings; a class of the user's may lie in the working directory."""
    from ..core.registry import parse_spec

    specs = [parse_spec(text) for text in texts]
    if any(":" in spec["name"] for spec in specs) and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    return specs


def finish_experiment(
    experiment: Experiment,
    out: Path | None,
    *,
    jobs: int,
    backend: str,
    shard: str | None,
    threads: int | None,
    overwrite: bool = False,
    finished: Callable[[Reader], None] = lambda _: None,
) -> Reader:
    """Compute what a folder lacks; a shard that leaves cells to others ends the command here."""
    from ..bench.experiments import Interrupted, MemoryStore, Store, parse_shard, run_experiment

    if out is None and (jobs, backend, shard) != (1, "local", None):
        raise ValueError("--jobs, --backend and --shard need a folder of results: --out")
    try:
        results = run_experiment(
            experiment,
            MemoryStore() if out is None else Store(out),
            jobs=jobs,
            backend=backend,
            threads=threads,
            shard=None if shard is None else parse_shard(shard),
            progress=progress,
            finished=finished,
            overwrite=overwrite,
        )
    except Interrupted:
        if out is None:  # nothing goes on
            raise KeyboardInterrupt from None
        raise
    if left := len(results.missing):
        typer.echo(f"shard {shard} is finished; cells left by others in {out}: {left}", err=True)
        raise typer.Exit
    return results


@dataclass(frozen=True, kw_only=True)
class WorldOptions:
    """Options of the victim and of what it meets, and the command line that they are on."""

    context: typer.Context
    env: str | None = Option(
        None,
        help=f"Environment; the other options change its settings. Default: {ENV}, the world "
        f"of task S1; with --scenario or --track, {PLAIN}, whose settings are those of the "
        "papers. See `spoofgym list envs`.",
    )
    settings: list[str] | None = Option(
        None,
        "--set",
        help="Setting of the victim that has no option of its own, may be repeated: name=value, "
        "the value as JSON, as in satellites=10 or domain='{\"start_s\": [0, 60]}'.",
    )
    scenario: str | None = Option(
        None, help="Scenario: a name, with settings as for a detector. Default: the environment's."
    )
    errors: str | None = Option(
        None, help="GNSS errors instead of the scenario's own: groves, zhong2025 ..."
    )
    imu: str | None = Option(
        None, help="Inertial sensors instead of the scenario's: aviation, tactical, consumer."
    )
    tuning: str | None = Option(
        None,
        help="Noise that the receiver assumes: as the papers print it (paper), as the world has it "
        "(matched), or that with states for lasting errors (augmented).",
    )
    attack: str | None = Option(None, help=f"What the spoofer can do. {SPEC_HELP}")
    track: Path | None = Option(
        None,
        help="Recorded flight (.csv, .json, .jsonl, .parquet; .gz too) to fly instead of the "
        "scenario's. Needs --ephemeris.",
    )
    ephemeris: list[Path] | None = Option(
        None,
        help="RINEX 2, 3 or 4 navigation file with the GPS satellites; may be repeated, for the "
        "files of two days, hours or stations.",
    )
    aircraft: str | None = Option(
        None, help="Aircraft of a track that holds several, as its file writes it."
    )
    altitude_unit: str | None = Option(
        None, help="Unit of the track's altitude: ft, m, fl. Default: by the column's name."
    )
    interpolated: str = Option(
        "drop",
        help="Positions exactly between their neighbours, as trackers fill gaps: drop, or keep "
        "(simulated tracks).",
    )
    from_s: float | None = Option(
        None,
        "--from",
        help="Start, in seconds after the first row of the track. Default: that of the longest "
        "airborne stretch without a gap.",
    )
    duration: float | None = Option(
        None, help="Duration of the flight in seconds. Default: ten minutes."
    )
    day: str | None = Option(
        None, "--date", help="Day of the flight, YYYY-MM-DD. Default: the day of the ephemerides."
    )
    warmup_s: float | None = Option(
        None,
        help="Clean run before the attack, in seconds. The defaults of the times are those of the "
        "environment.",
    )
    live_s: float | None = Option(
        None, help="Last part of the clean run, in which detectors may alarm, in seconds."
    )
    attack_s: float | None = Option(None, help="Time that the attack lasts, in seconds.")
    time_to_alert_s: float | None = Option(
        None,
        help="Time to alert, in seconds: displacement induced within this time before an alarm "
        "does not count.",
    )

    def find_passed(self, names: Container[str | None]) -> dict[str, str]:
        """Which of some options are on the command line, as they are written there."""
        return list_passed_options(self.context, names)


def list_passed_options(context: typer.Context, names: Container[str | None]) -> dict[str, str]:
    """Which of some options are on the command line, as they are written there, by their names."""
    found = {}
    for option in context.command.params:
        source = context.get_parameter_source(str(option.name))
        if option.name in names and source is not None and source.name == "COMMANDLINE":
            found[str(option.name)] = option.opts[0]
    return found


@dataclass(frozen=True, kw_only=True)
class SuiteOptions(WorldOptions):
    """Options of the runs of detectors and spoofers in a world."""

    seed: Seed = 0
    allow_oracles: bool = Option(
        False,
        "--allow-oracles",
        help="Admit detectors whose settings reveal the attack; results are marked.",
    )
    false_alarms_per_hour: float | None = Option(
        None,
        help="Rate of false alarms of all detectors whose settings give no rate or thresholds; "
        "calibrated here where that has not been done. Default: 0.2.",
    )


TIMES = ("warmup_s", "live_s", "attack_s", "time_to_alert_s")
WORLD_OPTIONS = WorldOptions.__dataclass_fields__.keys()
SCENARIO_OPTIONS = WORLD_OPTIONS - {"context", "env", "settings", *TIMES}
"""Options of the tightly coupled receiver alone."""
TASK_OPTIONS = {*WORLD_OPTIONS, "detector", "false_alarms_per_hour"}
"""Options that a task decides."""


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Write the fields of a command's record of options into its signature, in its place."""
    signature = inspect.signature(command, eval_str=True)
    parameters: list[inspect.Parameter] = []
    for parameter in signature.parameters.values():
        if is_dataclass(parameter.annotation):
            record = parameter
            hints = get_type_hints(record.annotation, include_extras=True)
            fields = inspect.signature(record.annotation).parameters
            parameters += [x.replace(annotation=hints[name]) for name, x in fields.items()]
        else:
            parameters.append(parameter)

    @functools.wraps(command)
    def wrapper(**arguments: Any) -> None:
        options = record.annotation(**{name: arguments.pop(name) for name in fields})
        command(**{record.name: options}, **arguments)

    wrapper.__annotations__ = {each.name: each.annotation for each in parameters}
    vars(wrapper)["__signature__"] = signature.replace(parameters=parameters)
    return wrapper
