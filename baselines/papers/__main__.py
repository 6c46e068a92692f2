"""Reproduce the tables of the five papers: ``python -m baselines.papers KEY``.

Every part of the work runs in a process of its own and is stored when it is done; the same command
goes on where it was interrupted.  A value that is not met is a finding, not an error.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from spoofgym.cli import clear_errors
from spoofgym.cli.app import print_json
from spoofgym.core.progress import show_progress

from .frame import Settings
from .paper import ALL, KEYS, load_paper
from .run import PaperRun
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
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Run all parts anew, also those of other sources.")
    ] = False,
) -> None:
    """Reproduce a paper: its tables with our values, bands, and where these come from."""
    settings = Settings(quick=quick, seed=seed)
    if key != ALL:
        load_paper(key)
    runs = [PaperRun(each, settings, out) for each in (KEYS if key == ALL else (key,))]
    if figures:
        figures.mkdir(
            parents=True, exist_ok=True
        )  # what can't be written to is told before the work
    most = jobs or os.cpu_count() or 1
    found = [run.play(most, show_progress, overwrite=overwrite) for run in runs]
    records = [run.record(data) for run, data in zip(runs, found, strict=True)]
    if as_json:
        print_json(records if key == ALL else records[0])
    else:
        for run, record in zip(runs, records, strict=True):
            print_tables(load_paper(run.key).TITLE, record)
    if figures is not None:
        for run, data in zip(runs, found, strict=True):
            for path in run.draw(data, figures / run.key):
                typer.echo(f"drawn: {path}", err=True)


if __name__ == "__main__":
    app()
