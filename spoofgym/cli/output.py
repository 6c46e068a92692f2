"""What commands print: JSON, tables, and how far they are."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from typing import Any

import typer

from ..core.progress import ProgressCallback, show_progress
from .app import signals


def print_json(value: Any) -> None:
    """Print JSON; neither NaN nor infinity is."""
    typer.echo(json.dumps(value, indent=2, allow_nan=False))


def print_lines(lines: Iterable[str]) -> None:
    """Print some lines, or nothing."""
    for line in lines:
        typer.echo(line)


def print_table(
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


def progress(total: float) -> AbstractContextManager[ProgressCallback]:
    """Show how far a command is, until it ends."""
    start = "compiling, a minute the first time"
    return show_progress(total, start=start, interrupted=lambda: signals)
