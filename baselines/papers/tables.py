"""Tables of a reproduction, for the terminal and for pages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

HEAD = (
    *("row", "quantity", "paper", "ours", "band", "from"),
    *("printed inside", "agrees", "kept", "note"),
)
COUNTS = {
    "printed_inside": "{yes} of {all} printed values lie inside the tolerance of the reproduction",
    "agrees": "{yes} of {all} of our values agree with an independent implementation",
    "kept": "{yes} of {all} keep a limit from theory or of our own",
}
"""What is counted, by the verdict of a row."""


def number_text(value: float | None) -> str:
    """Number with four digits. Returns ``"-"`` for None."""
    return "-" if value is None else f"{value:.4g}"


def band_text(low: float | None, high: float | None) -> str:
    """Band in words. Returns ``"-"`` where there is none."""
    if low is None and high is None:
        return "-"
    if high is None:
        return f"at least {number_text(low)}"
    if low is None:
        return f"at most {number_text(high)}"
    return f"{number_text(low)} to {number_text(high)}"


ANSWERS = {True: "yes", False: "NO", None: "-"}


def cells(row: Mapping[str, Any]) -> list[str]:
    """Texts of a row under `HEAD`."""
    return [
        row["row"],
        row["quantity"],
        number_text(row["paper"]),
        number_text(row["ours"]),
        band_text(row["low"], row["high"]),
        row["origin"] or "-",
        *(ANSWERS[row[name]] for name in COUNTS),
        row["note"],
    ]


def by_table(rows: Iterable[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """Rows of every table."""
    tables: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        tables.setdefault(row["table"], []).append(row)
    return tables


def count(rows: Sequence[Mapping[str, Any]], verdict: str) -> tuple[int, int]:
    """How many rows say yes, of how many that say anything."""
    told = [row[verdict] for row in rows if row[verdict] is not None]
    return sum(told), len(told)


def counts_text(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """What the rows of a paper say in all; a row may be in more than one count. Returns a sentence
    for each count that has rows, and one for the rows without a band."""
    lines = []
    for verdict, text in COUNTS.items():
        yes, every = count(rows, verdict)
        if every:
            lines.append(f"{text.format(yes=yes, all=every)}.")
    rest = sum(row["origin"] is None for row in rows)
    return [*lines, f"{rest} of {len(rows)} rows have no band."]


def print_tables(title: str, record: Mapping[str, Any]) -> None:
    """Print a reproduction."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    if not console.is_terminal:
        console = Console(width=180)
    for name, members in by_table(record["rows"]).items():
        # as Text, since rich takes a unit in brackets for a style
        heading = Text(f"{title}, {name}")
        table = Table(title=heading, title_justify="left", box=box.SIMPLE_HEAD)
        for column in HEAD:
            numeric = column in HEAD[2:5]
            table.add_column(Text(column), justify="right" if numeric else "left", overflow="fold")
        for row in members:
            style = "bold red" if any(row[name] is False for name in COUNTS) else ""
            table.add_row(*map(Text, cells(row)), style=style)
        console.print(table)
    for letter, origin in record["origins"].items():
        console.print(Text(f"Bands {letter} ({origin['kind']}): {origin['text']}"))
    console.print(Text(f"{title}: {' '.join(counts_text(record['rows']))}"))
