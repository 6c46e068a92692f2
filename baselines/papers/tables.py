"""Tables of a reproduction, for the terminal and for pages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

HEAD = ("row", "quantity", "paper", "ours", "band", "inside", "note")


def number_text(value: float | None) -> str:
    """Number with four digits.

    Parameters
    ----------
    value : float or None
        Any.

    Returns
    -------
    str
        ``"-"`` for None.
    """
    return "-" if value is None else f"{value:.4g}"


def band_text(low: float | None, high: float | None) -> str:
    """Band in words.

    Parameters
    ----------
    low, high : float or None
        Its ends.

    Returns
    -------
    str
        ``"-"`` where there is none.
    """
    if low is None and high is None:
        return "-"
    if high is None:
        return f"at least {number_text(low)}"
    if low is None:
        return f"at most {number_text(high)}"
    return f"{number_text(low)} to {number_text(high)}"


def inside_text(inside: bool | None) -> str:
    """Whether a value lies in its band.

    Parameters
    ----------
    inside : bool or None
        None where there is no band.

    Returns
    -------
    str
        ``"yes"``, ``"no"`` or ``"-"``.
    """
    return {True: "yes", False: "NO", None: "-"}[inside]


def cells(row: Mapping[str, Any]) -> list[str]:
    """Texts of a row under `HEAD`.

    Parameters
    ----------
    row : mapping
        As JSON has it.

    Returns
    -------
    list of str
        One a column.
    """
    return [
        row["row"],
        row["quantity"],
        number_text(row["paper"]),
        number_text(row["ours"]),
        band_text(row["low"], row["high"]),
        inside_text(row["inside"]),
        row["note"],
    ]


def by_table(rows: Iterable[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """Rows of every table.

    Parameters
    ----------
    rows : iterable of mapping
        As JSON has them.

    Returns
    -------
    dict
        Rows by table, in their order.
    """
    tables: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        tables.setdefault(row["table"], []).append(row)
    return tables


def verdict(rows: Sequence[Mapping[str, Any]]) -> str:
    """How many values lie in their bands.

    Parameters
    ----------
    rows : sequence of mapping
        As JSON has them.

    Returns
    -------
    str
        A sentence.
    """
    banded = [row for row in rows if row["inside"] is not None]
    inside = sum(row["inside"] for row in banded)
    rest = len(rows) - len(banded)
    return f"{inside} of {len(banded)} values lie in their bands; {rest} have none."


def print_tables(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print a reproduction.

    Parameters
    ----------
    title : str
        Of the paper.
    rows : sequence of mapping
        As JSON has them.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    if not console.is_terminal:
        console = Console(width=180)
    for name, members in by_table(rows).items():
        # as Text, since rich takes a unit in brackets for a style
        heading = Text(f"{title}, {name}")
        table = Table(title=heading, title_justify="left", box=box.SIMPLE_HEAD)
        for column in HEAD:
            numeric = column in HEAD[2:5]
            table.add_column(Text(column), justify="right" if numeric else "left", overflow="fold")
        for row in members:
            style = "bold red" if row["inside"] is False else ""
            table.add_row(*map(Text, cells(row)), style=style)
        console.print(table)
    console.print(Text(f"{title}: {verdict(rows)}"))
