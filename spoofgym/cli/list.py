"""Spoofgym list."""

from __future__ import annotations

from typing import Annotated

from typer import Argument

from . import options as opt
from .app import print_json


def list_(
    kind: Annotated[
        str | None,
        Argument(help="envs, scenarios, attacks, detectors, spoofers or shipped; all of them."),
    ] = None,
    name: Annotated[
        str | None,
        Argument(help="An attack, detector or spoofer, whose settings are listed: what is valid."),
    ] = None,
    as_json: opt.Json = False,
) -> None:
    """List what there is: environments, scenarios, attacks, detectors, spoofers, shipped ones."""
    from ..bench.report.catalogue import KINDS, SETTINGS, list_settings, select_table
    from ..core.registry import check_choice

    if kind is not None:
        check_choice("kind", kind, KINDS)
    if kind and name:
        rows = list_settings(kind, name)
        if as_json:
            print_json(rows)
        else:
            SETTINGS.print(name, rows)
        return
    found = {each: rows() for each, rows in KINDS.items() if kind in {None, each}}
    if as_json:
        print_json(found)
        return
    for each, rows in found.items():
        select_table(each).print(each, rows)


def card(
    name: Annotated[
        str, Argument(help="A shipped spoofer or detector, or a card or an ONNX file that has one.")
    ],
    as_json: opt.Json = False,
) -> None:
    """Show the card of a spoofer or of a learned detector: what it fits, and how it was made."""
    from ..bench.report.cards import SCORES, card_rows, find_card
    from ..bench.report.table import FIELDS
    from ..policies import SpooferCard

    found = find_card(name)
    if as_json:
        print_json(found.model_dump(mode="json"))
        return
    FIELDS.print(found.name, card_rows(found))
    if isinstance(found, SpooferCard) and found.scores:
        SCORES.print("scores", found.scores)


def tasks(as_json: opt.Json = False) -> None:
    """List the tasks of both suites, with their brackets and the scores that are known."""
    from ..bench.report import tasks as stored

    if as_json:
        print_json(stored.list_tasks())
    else:
        stored.print_tasks()
