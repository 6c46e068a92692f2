"""How fast the environments are here, and what a step is made of."""

from __future__ import annotations

from typing import Annotated

import typer

from . import options as opt
from .output import print_json, print_lines, print_table, progress


def perf(
    receivers: Annotated[
        list[int] | None,
        typer.Option(
            min=1, max=65536, help="Receivers of a batch; repeatable. Default: 1 16 64 256 1024."
        ),
    ] = None,
    threads: Annotated[
        list[int] | None,
        typer.Option(min=1, max=1024, help="Threads of the engine; repeatable. Default: 1 2."),
    ] = None,
    quick: Annotated[bool, typer.Option(help="Measure in two rounds instead of seven.")] = False,
    markdown: Annotated[bool, typer.Option(help="Print the tables as Markdown.")] = False,
    as_json: opt.Json = False,
) -> None:
    """Measure what a step costs on this machine, part by part, beside the floor of its arithmetic.

    Microseconds per receiver-epoch with 100 inertial samples, 12 satellites and the detector ewma.
    The floor is the same arithmetic for one group of receivers that stays in the nearest cache.
    """
    from ..bench import perf as bench
    from ..bench.report import markdown_table

    sizes, counts = receivers or bench.RECEIVERS, threads or bench.THREADS
    rounds = bench.QUICK_ROUNDS if quick else bench.ROUNDS
    with progress(1.0) as bar:
        found = bench.measure(sizes, counts, rounds=rounds, progress=bar)
    if as_json:
        print_json(found)
        return
    print_lines([", ".join(f"{name} {value}" for name, value in found["machine"].items())])
    for title, head, rows in bench.tables(found):
        if markdown:
            print_lines(["", f"{title}:", "", *markdown_table(head, rows)])
        else:
            print_table(title, head, rows)
