"""The five papers by key, and what their modules have to keep."""

from __future__ import annotations

import importlib
import inspect
import json
import math
import numbers
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, cast

from spoofgym.core.registry import check_choice

from .frame import Band, Origin, Paper, Part, Row, Settings

KEYS = ("ke2022", "shadmehri2025", "song2021", "wu2024", "zhong2025")
ALL = "all"
NAMES = ("TITLE", "CLAIMS", "FINDINGS", "READINGS", "parts", "rows", "figures")
VERDICTS = ("printed_inside", "agrees", "kept")
"""What a row says of its values."""


def load_paper(key: str) -> Paper:
    """Module of a paper."""
    check_choice("paper", key, (*KEYS, ALL))
    module = importlib.import_module(f"baselines.papers.{key}")
    missing = [name for name in NAMES if not hasattr(module, name)]
    if missing:
        raise ValueError(f"baselines.papers.{key} must have {', '.join(missing)}")
    return cast("Paper", module)


def list_parts(paper: Paper, settings: Settings) -> list[Part]:
    """Parts of a paper, checked."""
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


def list_rows(paper: Paper, data: dict[str, dict[str, Any]], settings: Settings) -> list[Row]:
    """Rows of a paper, checked."""
    rows = paper.rows(data, settings)
    check_rows(rows)
    return rows


def check_rows(rows: Sequence[Row]) -> None:
    """Raise unless every row has a key of its own, finite numbers and a band in order."""
    seen: set[tuple[str, str, str]] = set()
    for row in rows:
        key = (row.table, row.row, row.quantity)
        where = f"row {', '.join(key)}"
        if key in seen:
            raise ValueError(f"{where}: stands there twice")
        seen.add(key)
        for name, value in list_numbers(row).items():
            number = isinstance(value, numbers.Real) and not isinstance(value, bool)
            if value is not None and not (number and math.isfinite(value)):
                raise ValueError(f"{where}: `{name}` must be a finite number or None, got {value}")
        band = row.band
        if band is None:
            continue
        if band.low is not None and band.high is not None and band.low > band.high:
            raise ValueError(f"{where}: its band is empty, from {band.low} to {band.high}")


def list_numbers(row: Row) -> dict[str, float | None]:
    """Numbers of a row by name: the two values, then the ends of the band."""
    band = row.band
    ends = {"low": band and band.low, "high": band and band.high}
    return {"paper": row.paper, "ours": row.ours, **ends}


def rows_record(rows: Sequence[Row]) -> dict[str, Any]:
    """Rows as JSON, with every origin of a band once. Returns ``origins``: kind and text by a
    letter; ``rows``: fields, ends of the band, the letter of its origin, and the verdicts."""
    letters = {row.band.origin: "" for row in rows if row.band is not None}
    letters = {origin: format_letter(number) for number, origin in enumerate(letters)}
    return {
        "origins": {letter: asdict(origin) for origin, letter in letters.items()},
        "rows": [
            {
                "table": row.table,
                "row": row.row,
                "quantity": row.quantity,
                **{
                    name: None if value is None else float(value)
                    for name, value in list_numbers(row).items()
                },
                "origin": None if row.band is None else letters[row.band.origin],
                **{name: _plain_bool(getattr(row, name)) for name in VERDICTS},
                "note": row.note,
            }
            for row in rows
        ],
    }


def rows_from_record(record: Mapping[str, Any]) -> list[Row]:
    """Rows of `rows_record`, so that what a stored row says can be derived again."""
    origins = {letter: Origin(**origin) for letter, origin in record["origins"].items()}
    rows = []
    for told in record["rows"]:
        origin = told["origin"]
        band = None if origin is None else Band(told["low"], told["high"], origins[origin])
        values = (told[name] for name in ("table", "row", "quantity", "paper", "ours"))
        rows.append(Row(*values, band, told["note"]))
    return rows


def format_letter(number: int) -> str:
    """A to Z, then AA, AB and so on."""
    first, last = divmod(number, 26)
    return (format_letter(first - 1) if first else "") + chr(ord("A") + last)


def _plain_bool(value: bool | None) -> bool | None:
    return None if value is None else bool(value)


def count_runs(parts: Sequence[Part], data: dict[str, dict[str, Any]]) -> int:
    """How many runs a reproduction has simulated. Returns sum over the parts of `runs` or `cases`,
    told in the result or among the settings; 1 for a part that tells none."""
    told = [{"runs": 1} | part.settings | data[part.name] for part in parts]
    return sum(int(part["cases"] if "cases" in part else part["runs"]) for part in told)
