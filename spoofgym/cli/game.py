"""Spoofers against detectors as a matrix game."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from . import options as opt
from .options import specs_of
from .output import print_json, print_table

if TYPE_CHECKING:
    from ..bench.scores.matrix_game import PayoffMatrix


def game(
    *,
    spoofer: Annotated[list[str], Option(help=f"Spoofer, may be repeated. {opt.SPEC_HELP}")],
    detector: Annotated[list[str], Option(help=f"Detector, may be repeated. {opt.SPEC_HELP}")],
    task: Annotated[str, Option(help="Task whose world and alert limit are taken, T1 to T6.")],
    payoff: Annotated[
        str,
        Option(
            help="What a run is worth: `stealth`, the undetected displacement in parts of the "
            "alert limit, 0 after an alarm; or `hmi`, whether it exceeds the limit."
        ),
    ] = "stealth",
    limit_m: Annotated[float | None, Option(help="Alert limit. Default: that of the task.")] = None,
    runs: Annotated[int, Option(min=2, max=opt.LARGEST_RUNS, help="Runs of every pair.")] = 200,
    oracles: Annotated[
        bool, Option(help="Compare spoofers that observe the detector's statistics with others.")
    ] = False,
    out: Annotated[
        Path | None, Option(help="Folder of finished pairs; the same command goes on from there.")
    ] = None,
    as_json: opt.Json = False,
    seed: opt.Seed = 0,
    threads: opt.Threads = None,
    jobs: opt.Processes = 1,
    backend: opt.Backend = "local",
    shard: opt.Shard = None,
) -> None:
    """Solve the game of spoofers against detectors: payoffs on paired runs, mixes of both sides."""
    from ..bench.experiments.game import Game

    pairs = Game(task, payoff=payoff, limit_m=limit_m, runs=runs, entropy=seed).pairs(
        specs_of(spoofer), specs_of(detector), oracles=oracles
    )
    results = opt.finished(pairs, out, jobs=jobs, backend=backend, shard=shard, threads=threads)
    if as_json:
        print_json(pairs.report(results))
        return
    matrix = pairs.matrix(results)
    spread = matrix.spread()
    shown = _figures([spread.value])[0]
    solved = "a pure pair solves it" if matrix.solve().pure else "no pure pair solves it"
    rows = _rows(matrix, _figures(spread.spoofer), _figures(spread.detector))
    print_table(
        f"{task}: value {shown}, {solved}; {payoff} by {matrix.payoff.limit_m:g} m, {runs} runs",
        ("spoofer", "observes", "mix", *(each.label for each in matrix.detectors)),
        rows,
    )


def _figures(estimates: Sequence[Any]) -> list[str]:
    from ..bench.report.table import interval

    return [interval(each.as_json(), 2) for each in estimates]


def _rows(matrix: PayoffMatrix, who: list[str], whom: list[str]) -> list[tuple[str, ...]]:
    """Rows of the table: the mix of the detectors, and every spoofer with its payoffs."""
    rows = [("mix", "", "", *whom)]
    for spoofer, part, values in zip(matrix.spoofers, who, matrix.values, strict=True):
        cells = (f"{value:.3f}" for value in values)
        rows.append((spoofer.label, spoofer.knowledge, part, *cells))
    return rows
