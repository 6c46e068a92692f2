"""What commands print: JSON, tables, and how far they are."""

from __future__ import annotations

import json
from collections.abc import Iterable
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


def progress(total: float) -> AbstractContextManager[ProgressCallback]:
    """Show how far a command is, until it ends."""
    start = "compiling, a minute the first time"
    return show_progress(total, start=start, interrupted=lambda: signals)
