"""How fast the environments are here."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from . import options as opt
from .output import print_json, print_table


def perf(
    num_envs: Annotated[int, typer.Option(min=1, help="Receivers of the vector environment.")] = 64,
    threads: opt.Threads = None,
    duration: Annotated[
        float, typer.Option(help="Shortest time of each measurement, in seconds.")
    ] = 10.0,
    as_json: opt.Json = False,
) -> None:
    """Measure how fast this machine steps the environments, resets included."""
    from ..bench.perf import machine, overhead, single_speed, vector_speed

    found: dict[str, Any] = {
        "machine": machine(),
        "single": single_speed(duration),
        "vector": vector_speed(num_envs, threads, duration),
        "overhead": [overhead(1), overhead(max(num_envs, 2))],
    }
    if as_json:
        print_json(found)
        return
    rows = [
        (key, *(str(found[kind].get(key, "-")) for kind in ("single", "vector")))
        for key in found["vector"]
    ]
    print_table("speed", ("", "single", "vector"), rows)
    more = found["overhead"]
    print_table(
        "a step of the environment on top of its engine, one thread",
        ("", "single", "vector"),
        [(key, *(str(each[key]) for each in more)) for key in more[0]],
    )
