"""Spoofers against detectors as a matrix game."""

from __future__ import annotations

from pathlib import Path

from typer import Option

from . import options as opt
from .app import print_json, print_written


def game(
    *,
    spoofer: list[str] = Option(help=f"Spoofer, may be repeated. {opt.SPEC_HELP}"),
    detector: list[str] = Option(help=f"Detector, may be repeated. {opt.SPEC_HELP}"),
    task: str = Option(help="Task whose world and alert limit are taken, S1 to S3 or T1 to T6."),
    payoff: str = Option(
        "stealth",
        help="What a run is worth: `stealth`, the undetected displacement over the alert "
        "limit, at most 1, and 0 after an alarm; or `hmi`, 1 where it exceeds the limit.",
    ),
    limit_m: float | None = Option(None, help="Alert limit, in m. Default: that of the task."),
    budget: opt.Budget = "standard",
    runs: opt.Runs = None,
    oracles: bool = Option(
        False, help="Compare spoofers that observe the detector's statistics with others."
    ),
    out: Path | None = Option(
        None, help="Folder of finished pairs; the same command goes on from there."
    ),
    as_json: opt.Json = False,
    seed: opt.Seed = 0,
    threads: opt.Threads = None,
    jobs: opt.Processes = 1,
    backend: opt.Backend = "local",
    shard: opt.Shard = None,
) -> None:
    """Solve the game of spoofers against detectors: payoff matrix, optimal mixed strategies."""
    from ..bench.experiments.game import Game
    from ..bench.experiments.suite import get_budget
    from ..bench.report.game_page import build_game_page, print_game
    from ..bench.report.page import write_page

    runs = get_budget(budget, runs=runs).runs
    pairs = Game(task, payoff=payoff, limit_m=limit_m, runs=runs, entropy=seed).pairs(
        opt.parse_specs(spoofer), opt.parse_specs(detector), oracles=oracles
    )
    results = opt.finish_experiment(
        pairs, out, jobs=jobs, backend=backend, shard=shard, threads=threads
    )
    found = pairs.report(results)
    written = (
        [] if out is None else write_page(results.store, build_game_page(results.store, found))
    )
    if as_json:
        print_json(found)
        return
    print_game(task, found)
    print_written(written)
