"""Data sets to train a detector on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import options as opt
from .bench import world_of
from .options import World, calibrate_with_progress, specs_of, with_world
from .output import print_json, print_table, progress

if TYPE_CHECKING:
    from ..bench.experiments.dataset import Plan

HEAD = ("split", "runs", "episodes", "clean", "attacks by family", "shards", "MB")


@with_world
def dataset(
    out: Annotated[Path, typer.Argument(help="Folder of the data set.")],
    *,
    task: Annotated[
        str | None, typer.Option(help="World of a task, T1 to T6, and its detector.")
    ] = None,
    detector: Annotated[
        str | None,
        typer.Option(
            help="Passive detector whose statistic attacks by feedback see; the task's by default, "
            f"without one there are no such attacks. {opt.SPEC_HELP}"
        ),
    ] = None,
    term: Annotated[
        list[str] | None,
        typer.Option(
            help="Observation term of a learned detector, may be repeated; by default all. "
            f"{opt.SPEC_HELP}"
        ),
    ] = None,
    family: Annotated[
        list[str] | None,
        typer.Option(help="Family of attacks, may be repeated; by default all that can be made."),
    ] = None,
    spoofer: Annotated[
        list[str] | None,
        typer.Option(
            help="Further spoofer, such as an .onnx file, may be repeated; its amplitude is drawn. "
            f"{opt.SPEC_HELP}"
        ),
    ] = None,
    train: Annotated[
        int,
        typer.Option(min=1, max=opt.LARGEST_RUNS, help="Runs to train on, each attacked and not."),
    ] = 768,
    validation: Annotated[
        int, typer.Option(min=1, max=opt.LARGEST_RUNS, help="Runs to choose on.")
    ] = 256,
    test: Annotated[
        int, typer.Option(min=1, max=opt.LARGEST_RUNS, help="Runs to look at in the end.")
    ] = 256,
    shard: Annotated[int, typer.Option(min=1, max=4096, help="Runs of a file.")] = 64,
    alert_limit_m: Annotated[
        float | None,
        typer.Option(help="Alert limit, around which attacks are drawn; 40 m, or the task's."),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace another data set in the folder.")
    ] = False,
    as_json: opt.Json = False,
    world: World,
    seed: opt.Seed = 0,
    threads: opt.Threads = None,
) -> None:
    """Write labelled episodes to train a detector on; killed, it goes on from there."""
    from ..bench.experiments.dataset import make_room, write

    chosen: dict[str, Any] = {"families": family, "entropy": seed, "shard": shard, "task": task}
    chosen["runs"] = {"train": train, "validation": validation, "test": test}
    chosen["spoofers"] = specs_of(spoofer or ())
    if term:
        chosen["terms"] = specs_of(term)
    plan = _plan(world, detector, alert_limit_m, chosen, threads)
    make_room(out, plan, overwrite=overwrite)
    with progress(sum(plan.runs.values())) as bar:
        manifest = write(out, plan, threads=threads, progress=bar)
    summary = _summary(out, manifest)
    if as_json:
        print_json(summary)
        return
    rows = []
    for part, found in summary["splits"].items():
        attacks = ", ".join(f"{name} {count}" for name, count in found["families"].items())
        counts = (found[name] for name in ("runs", "episodes", "clean"))
        size = f"{found['bytes'] / 1e6:.1f}"
        rows.append((part, *map(str, counts), attacks, str(found["shards"]), size))
    print_table(f"{out}: {plan.setup.name}, digest {manifest['digest']}", HEAD, rows)


def _plan(
    world: World,
    detector: str | None,
    alert_limit_m: float | None,
    chosen: dict[str, Any],
    threads: int | None,
) -> Plan:
    """The plan of the options, its detector calibrated; `chosen`: what it takes as it is."""
    from ..bench.experiments.dataset import Plan
    from ..bench.experiments.protect import entries_of
    from ..bench.experiments.suite import ALERT_LIMIT_M
    from ..bench.report.tasks import optima_of
    from ..core.registry import check_finite
    from ..tasks import task_of

    task = chosen["task"]
    played, guard, limit = world_of(world, task), None, None
    if task is not None:
        guard, limit = task_of(task).detector, task_of(task).alert_limit_m
    if detector is not None:
        (guard,) = specs_of([detector])
    if alert_limit_m is not None:
        check_finite("alert_limit_m", alert_limit_m, "> 0")
    limit = alert_limit_m or limit or ALERT_LIMIT_M
    optima = optima_of(task) if task else ()
    plan = Plan(played.setup, limit, detector=guard, optima=optima, **chosen)
    if guard is not None:
        calibrate_with_progress(played, entries_of([guard]), threads)
    return plan


def _summary(out: Path, manifest: dict[str, Any]) -> dict[str, Any]:
    """What was written, JSON-able."""
    config, splits = manifest["config"], {}
    for part, shards in manifest["shards"].items():
        attacks = [sum(each) for each in zip(*(x["families"] for x in shards), strict=True)]
        splits[part] = {
            "runs": config["runs"][part],
            **{name: sum(x[name] for x in shards) for name in ("episodes", "clean", "bytes")},
            "families": dict(zip(config["families"], attacks, strict=True)),
            "shards": len(shards),
        }
    return {
        "folder": str(out),
        "digest": manifest["digest"],
        "task": config["task"],
        "observations": len(config["observation"]["names"]),
        "epochs": config["epochs"],
        "splits": splits,
    }
