"""Reproduce the tables of the five papers: ``python -m baselines.papers KEY``.

Every part of the work runs in a process of its own and is stored when it is done; the same command
goes on where it was interrupted.  A value that is not met is a finding, not an error.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from spoofgym.cli import INTERRUPTED, clear_errors

from .frame import Settings
from .paper import ALL, KEYS, load_paper
from .run import PaperRun, Tick, run_papers
from .tables import print_tables

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
@clear_errors
def main(
    key: Annotated[str, typer.Argument(help=f"{', '.join(KEYS)}; or all of them.")],
    quick: Annotated[
        bool, typer.Option("--quick", help="With few runs: a minute a paper, not ten.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="All chance follows from this number.")] = 0,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes. Default: one per processor.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, and nothing else.")] = False,
    figures: Annotated[
        Path | None, typer.Option(help="Folder for the papers' figures, drawn from our runs.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder in which finished parts are kept.")] = Path(
        "results/papers"
    ),
) -> None:
    """Reproduce a paper: its tables with our values, bands, and where these come from."""
    settings = Settings(quick=quick, seed=seed)
    if key != ALL:
        load_paper(key)
    runs = [PaperRun(each, settings, out) for each in (KEYS if key == ALL else (key,))]
    for folder in [run.store.folder for run in runs] + ([figures] if figures else []):
        folder.mkdir(
            parents=True, exist_ok=True
        )  # what can't be written to is told before the work
    try:
        with _progress() as tick:
            found = run_papers(
                runs, jobs or os.cpu_count() or 1, tick, lambda text: typer.echo(text, err=True)
            )
    except KeyboardInterrupt:
        typer.echo(
            f"interrupted: what is finished is kept in {out}; the same command goes on from there",
            err=True,
        )
        raise typer.Exit(INTERRUPTED) from None
    records = [each.record() for each in found]
    if as_json:
        typer.echo(json.dumps(records if key == ALL else records[0], indent=1, allow_nan=False))
    else:
        for each, record in zip(found, records, strict=True):
            print_tables(each.paper.TITLE, record)
    if figures is not None:
        for each in found:
            for path in each.draw(figures / each.key):
                typer.echo(f"drawn: {path}", err=True)


@contextmanager
def _progress() -> Iterator[Tick]:
    """A bar on the terminal, with the part that was done last."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    bar = Progress(
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
        console=Console(stderr=True),
        transient=True,
    )
    task = bar.add_task("", total=1.0)
    with bar:
        yield lambda part, now: bar.update(task, advance=part, description=now)


if __name__ == "__main__":
    app()
