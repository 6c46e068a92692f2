"""Spoofgym list."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from typer import Argument

from . import options as opt
from .app import print_json, print_lines


def list_(
    name: str | None = Argument(
        None,
        help="Kind: envs, scenarios, attacks, detectors, spoofers, shipped or tasks. Or one of "
        "them: an attack, detector or spoofer, whose settings are listed, and what is valid; "
        "an environment or scenario; a task and its scores; a shipped policy, or an .onnx or "
        ".json file, with what it fits and how it was made. Default: all kinds but tasks.",
    ),
    as_json: opt.Json = False,
) -> None:
    """List what there is, or show one thing by its name: its settings, scores, how it was made."""
    value, show = _list_kinds() if name is None else _find(name)
    if as_json:
        print_json(value)
    else:
        show()


Found = tuple[Any, Callable[[], None]]
"""What is found, JSON-able, and what prints it."""


def _list_kinds(name: str | None = None) -> Found:
    """Everything of a kind, or of all."""
    from ..bench.report.catalogue import KINDS, NOTES, select_table

    found = {each: rows() for each, rows in KINDS.items() if name in {None, each}}

    def show() -> None:
        for each, rows in found.items():
            select_table(each).print(each, rows)
            print_lines([NOTES[each]] if each in NOTES else [])

    return found, show


def _find(name: str) -> Found:
    """A kind, or one thing of any kind."""
    from ..bench.report import tasks
    from ..bench.report.catalogue import CLASSES, KINDS, SETTINGS, list_settings
    from ..bench.report.table import FIELDS

    if name in KINDS:
        return _list_kinds(name)
    every = {row["key"]: row for row in tasks.list_tasks()}
    if name == "tasks":
        return [*every.values()], tasks.print_tasks
    if name in every:
        return every[name], partial(tasks.print_tasks, [name])
    for kind in CLASSES:
        if name in CLASSES[kind]:
            rows = list_settings(kind, name)
            return rows, partial(SETTINGS.print, name, rows)
    named = {row["name"]: row for kind in ("envs", "scenarios") for row in KINDS[kind]()}
    if name in named:
        title = f"{name}: {named[name]['summary']}"
        return named[name], partial(FIELDS.print, title, named[name]["settings"].items())
    classes = (key for each in CLASSES.values() for key in each)
    return _find_card(name, [*KINDS, "tasks", *every, *classes, *named])


def _find_card(name: str, others: Sequence[str]) -> Found:
    """The card of a policy by its name or file; `others`: what else a name could have been."""
    from ..bench.report.catalogue import SCORES, card_rows, find_card
    from ..bench.report.table import FIELDS
    from ..core.registry import suggest_name
    from ..policies import SpooferCard, list_shipped

    if not Path(name).suffix and name not in (shipped := list_shipped()):
        hint = suggest_name(name, [*others, *shipped])
        raise ValueError(f"there is no {name!r}; `spoofgym list` shows all names{hint}")
    found = find_card(name)

    def show() -> None:
        FIELDS.print(found.name, card_rows(found))
        if isinstance(found, SpooferCard) and found.scores:
            SCORES.print("scores", found.scores)

    return found.model_dump(mode="json"), show
