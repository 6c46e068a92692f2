"""The five papers by key, and what their modules have to keep."""

from __future__ import annotations

import importlib
import inspect
import json
import math
import numbers
from collections.abc import Sequence
from typing import Any, cast

from spoofgym._registry import check_choice

from .frame import Paper, Part, Row, Settings

KEYS = ("ke2022", "shadmehri2025", "song2021", "wu2024", "zhong2025")
ALL = "all"
NAMES = ("TITLE", "CLAIMS", "FOUND", "READINGS", "parts", "rows", "figures")
NUMBERS = ("paper", "ours", "low", "high")


def load_paper(key: str) -> Paper:
    """Module of a paper.

    Parameters
    ----------
    key : str
        One of `KEYS`.

    Returns
    -------
    Paper
        The module.

    Raises
    ------
    ValueError
        When the key is unknown, or the module lacks something.
    """
    check_choice("paper", key, (*KEYS, ALL))
    module = importlib.import_module(f"baselines.papers.{key}")
    missing = [name for name in NAMES if not hasattr(module, name)]
    if missing:
        raise ValueError(f"baselines.papers.{key} must have {', '.join(missing)}")
    return cast("Paper", module)


def parts_of(paper: Paper, settings: Settings) -> list[Part]:
    """Parts of a paper, checked.

    Parameters
    ----------
    paper : Paper
        Its module.
    settings : Settings
        Of the run.

    Returns
    -------
    list of Part
        In the order in which they begin.

    Raises
    ------
    ValueError
        When there are none, two have the same name, or one could not be run elsewhere.
    """
    parts = paper.parts(settings)
    if not parts:
        raise ValueError(f"{paper.TITLE} has no parts")
    names = [part.name for part in parts]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"two parts of {paper.TITLE} have the same name: {', '.join(twice)}")
    for part in parts:
        where = f"part {part.name!r} of {paper.TITLE}"
        name = getattr(part.function, "__qualname__", "")
        found = getattr(inspect.getmodule(part.function), name, None)
        if found is not part.function:
            raise ValueError(f"{where}: its function must be one of a module, got {part.function}")
        try:
            same = json.loads(json.dumps(part.settings, allow_nan=False)) == part.settings
        except (TypeError, ValueError) as error:
            raise ValueError(f"{where}: its settings cannot be written as JSON: {error}") from error
        if not same:
            raise ValueError(f"{where}: its settings change when written as JSON: {part.settings}")
        if not (math.isfinite(part.weight) and part.weight > 0.0):
            raise ValueError(f"{where}: `weight` must be positive, got {part.weight}")
    return parts


def rows_of(paper: Paper, data: dict[str, dict[str, Any]], settings: Settings) -> list[Row]:
    """Rows of a paper, checked.

    Parameters
    ----------
    paper : Paper
        Its module.
    data : dict
        What each part returned, by its name.
    settings : Settings
        Of the run.

    Returns
    -------
    list of Row
        In the order of the tables.

    Raises
    ------
    ValueError
        As `check_rows` does.
    """
    rows = paper.rows(data, settings)
    check_rows(rows)
    return rows


def check_rows(rows: Sequence[Row]) -> None:
    """Raise unless every row has a key of its own, finite numbers and a band in order.

    Parameters
    ----------
    rows : sequence of Row
        Of a paper.

    Raises
    ------
    ValueError
        Names the row.
    """
    seen: set[tuple[str, str, str]] = set()
    for row in rows:
        key = (row.table, row.row, row.quantity)
        where = f"row {', '.join(key)}"
        if key in seen:
            raise ValueError(f"{where}: stands there twice")
        seen.add(key)
        for name in NUMBERS:
            value = getattr(row, name)
            number = isinstance(value, numbers.Real) and not isinstance(value, bool)
            if value is not None and not (number and math.isfinite(value)):
                raise ValueError(f"{where}: `{name}` must be a finite number or None, got {value}")
        if row.low is not None and row.high is not None and row.low > row.high:
            raise ValueError(f"{where}: its band is empty, from {row.low} to {row.high}")


def row_record(row: Row) -> dict[str, Any]:
    """Row as JSON.

    Parameters
    ----------
    row : Row
        Checked.

    Returns
    -------
    dict
        Its fields, and whether ours lies inside the band.
    """
    told = {name: getattr(row, name) for name in NUMBERS}
    values = {name: None if value is None else float(value) for name, value in told.items()}
    return {
        "table": row.table,
        "row": row.row,
        "quantity": row.quantity,
        **values,
        "inside": None if row.inside is None else bool(row.inside),
        "note": row.note,
    }


def runs_of(parts: Sequence[Part], data: dict[str, dict[str, Any]]) -> int:
    """How many runs a reproduction has simulated.

    Parameters
    ----------
    parts : sequence of Part
        Of the paper.
    data : dict
        What each of them returned.

    Returns
    -------
    int
        Sum over the parts of `runs` or `cases`, told in the result or among the settings; 1 for a
        part that tells none.
    """
    told = [{"runs": 1} | part.settings | data[part.name] for part in parts]
    return sum(int(part["cases"] if "cases" in part else part["runs"]) for part in told)
