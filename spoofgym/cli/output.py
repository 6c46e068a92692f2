"""What commands print: JSON, tables, and how far they are."""

from __future__ import annotations

import functools
import json
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import typer

from .. import _threads
from .app import signals

if TYPE_CHECKING:
    from ..bench.campaign import Progress


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


REFRESH_S = 0.1
"""How often the time in a progress bar is drawn anew."""


@dataclass(frozen=True)
class _Bar:
    """Progress of a campaign on the terminal, by `update` of its task."""

    update: Callable[..., None]

    def advance(self, amount: float, now: str) -> None:
        """Show it; end here where an interrupt was lost, as in a destructor."""
        if signals:
            raise KeyboardInterrupt
        if amount > 0.0:
            self.update(advance=amount, description=now)


@contextmanager
def progress(total: float) -> Iterator[Progress]:
    """Show how far a command is, until it ends."""
    import rich.progress as bars
    from rich.console import Console

    shown = bars.Progress(
        bars.TextColumn("{task.description}"),
        bars.BarColumn(),
        bars.TextColumn("{task.percentage:3.0f} %"),
        bars.TimeElapsedColumn(),
        bars.TextColumn("left"),
        bars.TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        auto_refresh=False,  # its thread is one that nobody waits for
    )
    task = shown.add_task("compiling, a minute the first time", total=max(total, 1e-9))
    over = threading.Event()

    def refresh() -> None:
        while not over.wait(REFRESH_S):
            shown.refresh()

    with shown:
        thread = _threads.start(refresh, over.set, "spoofgym-progress")
        try:
            yield _Bar(functools.partial(shown.update, task))
        finally:
            over.set()
            thread.join()
