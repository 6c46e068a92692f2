"""Data sets to train a detector on, and of a spoofer's episodes for Minari."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer import Argument, Option

from . import options as opt
from .app import print_json, print_lines, progress
from .options import WorldOptions, with_options
from .suites import make_world, refuse_decided, state_reality

if TYPE_CHECKING:
    from ..bench.experiments.dataset import Plan

FORMATS = EPOCHS, MINARI = "epochs", "minari"
OF_EPOCHS: tuple[str, ...] = ("term", "family", "validation", "test", "file_runs")
OF_EPOCHS += ("alert_limit_m", "overwrite", "threads", "jobs", "backend", "shard")
"""Options of the first format alone."""


@with_options
def dataset(
    out: Path = Argument(help="Folder of the data set; its id with --format minari."),
    *,
    kind: str = Option(
        EPOCHS,
        "--format",
        help="epochs: to train a detector. minari: observations, actions and rewards of spoofers, "
        "to learn from offline; --train episodes of each --spoofer, and OUT is the id of the data "
        "set, such as spoofgym/ramps-v0.",
    ),
    knowledge: str | None = Option(
        None, help="What observations show with --format minari. Default: the environment's."
    ),
    task: str | None = Option(
        None,
        help="Task whose world and detector are taken, S1 to S3 or T1 to T6. Attacks decide at "
        "every epoch.",
    ),
    detector: str | None = Option(
        None,
        help="Passive detector whose statistic the feedback attacks see. Default: the task's; "
        f"without a detector there are no such attacks. {opt.SPEC_HELP}",
    ),
    term: list[str] | None = Option(
        None,
        help="Observation term of a learned detector, may be repeated; by default all. "
        f"{opt.SPEC_HELP}",
    ),
    family: list[str] | None = Option(
        None, help="Family of attacks, may be repeated; by default all that can be made."
    ),
    spoofer: list[str] | None = Option(
        None,
        help="Further spoofer, such as an .onnx file, may be repeated; its amplitude is drawn. "
        f"{opt.SPEC_HELP}",
    ),
    train: int = Option(
        768, min=1, max=opt.LARGEST_RUNS, help="Training runs, each with and without the attack."
    ),
    validation: int = Option(256, min=1, max=opt.LARGEST_RUNS, help="Validation runs."),
    test: int = Option(256, min=1, max=opt.LARGEST_RUNS, help="Test runs, for the final score."),
    file_runs: int = Option(64, min=1, max=4096, help="Runs in each file."),
    alert_limit_m: float | None = Option(
        None, help="Alert limit in m, around which attacks are drawn. Default: the task's, else 40."
    ),
    overwrite: bool = Option(False, "--overwrite", help="Replace another data set in the folder."),
    as_json: opt.Json = False,
    options: WorldOptions,
    seed: opt.Seed = 0,
    threads: opt.Threads = None,
    jobs: opt.Processes = 1,
    backend: opt.Backend = "local",
    shard: opt.Shard = None,
) -> None:
    """Write labelled episodes to train a detector on (resumable).

    A run has two episodes, with and without the attack, together 4 bytes for each epoch and
    observation; reading needs twice that in memory. Where the domain draws ages (`age_s`) all
    episodes are as long as the oldest: by default a run takes 3 MB, with an hour before the attack.
    """
    from ..bench.experiments import Store
    from ..bench.report.results import DATASET
    from ..core.registry import check_choice

    check_choice("format", kind, FORMATS)
    if kind == MINARI:
        refuse_decided(options, "--format minari", OF_EPOCHS)
        _collect(options, str(out), task, detector, spoofer, train, seed, knowledge, as_json)
        return
    refuse_decided(options, "--format epochs", ("knowledge",))

    chosen: dict[str, Any] = {"families": family, "entropy": seed, "shard": file_runs, "task": task}
    chosen["runs"] = {"train": train, "validation": validation, "test": test}
    chosen["spoofers"] = opt.parse_specs(spoofer or ())
    if term:
        chosen["terms"] = opt.parse_specs(term)
    plan = _plan(options, detector, alert_limit_m, chosen, threads)
    if overwrite:
        Store(out).open(plan.name, plan.config, overwrite=True)
    results = opt.finish_experiment(
        plan, out, jobs=jobs, backend=backend, shard=shard, threads=threads
    )
    notes = state_reality(options)
    summary = {"folder": str(out), **plan.report(results), **({"notes": notes} if notes else {})}
    if as_json:
        print_json(summary)
        return
    parts = [{"split": part, **found} for part, found in summary["splits"].items()]
    DATASET.print(f"{out}: {plan.setup.name}, digest {summary['digest']}", parts)
    print_lines(notes)


def _plan(
    options: WorldOptions,
    detector: str | None,
    alert_limit_m: float | None,
    chosen: dict[str, Any],
    threads: int | None,
) -> Plan:
    """The plan of the options, its detector calibrated; `chosen`: what it takes as it is."""
    from ..bench.experiments.calibration import calibrate_players
    from ..bench.experiments.dataset import Plan
    from ..bench.experiments.suite import ALERT_LIMIT_M
    from ..bench.report.tasks import load_optima
    from ..bench.runs.players import specify_detectors
    from ..core.declared import check_number
    from ..tasks import get_task

    task = chosen["task"]
    played, guard, limit = make_world(options, task), None, None
    if task is not None:
        played = played.copy_with(decision_interval_s=None, between="hold")
        guard, limit = get_task(task).detector, get_task(task).alert_limit_m
    if detector is not None:
        (guard,) = opt.parse_specs([detector])
    if alert_limit_m is not None:
        check_number("alert_limit_m", alert_limit_m, above=0.0)
    limit = alert_limit_m or limit or ALERT_LIMIT_M
    optima = load_optima(task) if task else ()
    plan = Plan(played.setup, limit, detector=guard, optima=optima, **chosen)
    if guard is not None:
        calibrate_players(played, specify_detectors([guard]), threads=threads, progress=progress)
    return plan


def _collect(
    options: WorldOptions,
    name: str,
    task: str | None,
    detector: str | None,
    spoofers: list[str] | None,
    episodes: int,
    seed: int,
    knowledge: str | None,
    as_json: bool,
) -> None:
    from ..bench.experiments.calibration import calibrate_players
    from ..bench.experiments.offline import collect_episodes
    from ..bench.report.table import FIELDS
    from ..bench.runs.players import specify_detectors
    from ..tasks import get_task

    if not spoofers:
        raise ValueError("--format minari needs a --spoofer whose episodes are recorded")
    played = make_world(options, task)
    guard = None if task is None else get_task(task).detector
    if detector is not None:
        (guard,) = opt.parse_specs([detector])
    guard = played.detector if guard is None else guard
    calibrate_players(played, specify_detectors([guard]), threads=None, progress=progress)
    specs = opt.parse_specs(spoofers)
    with progress(episodes * len(specs)) as bar:
        shared: dict[str, Any] = {"episodes": episodes, "seed": seed, "knowledge": knowledge}
        found = collect_episodes(name, played, guard, specs, **shared, progress=bar)
    notes = state_reality(options)
    if as_json:
        print_json({**found, **({"notes": notes} if notes else {})})
        return
    FIELDS.print(f"{name}, a data set of Minari", found.items())
    print_lines(notes)
