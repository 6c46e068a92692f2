"""Spoofgym list."""

from __future__ import annotations

from typing import Annotated

import typer

from . import options as opt
from .output import print_json, print_lines, print_table


def list_(
    kind: Annotated[
        str | None,
        typer.Argument(
            help="envs, scenarios, attacks, detectors, spoofers or shipped; all of them."
        ),
    ] = None,
    as_json: opt.Json = False,
) -> None:
    """List what there is: environments, scenarios, attacks, detectors, spoofers, shipped ones."""
    from ..bench.report.catalogue import KINDS, table_of
    from ..core.registry import check_choice

    if kind is not None:
        check_choice("kind", kind, KINDS)
    found = {name: rows() for name, rows in KINDS.items() if kind in {None, name}}
    if as_json:
        print_json(found)
        return
    for name, rows in found.items():
        print_table(name, *table_of(name, rows))


def card(
    name: Annotated[
        str,
        typer.Argument(
            help="A shipped spoofer or detector, or a card or an ONNX file that has one."
        ),
    ],
    as_json: opt.Json = False,
) -> None:
    """Show the card of a spoofer or of a learned detector: what it fits, and how it was made."""
    from ..bench.report.cards import (
        SCORES_HEAD,
        card_rows,
        detector_card_rows,
        find_card,
        score_rows,
    )
    from ..spoofers.card import Card

    found = find_card(name)
    if as_json:
        print_json(found.model_dump(mode="json"))
        return
    if not isinstance(found, Card):
        print_table(found.name, ("", ""), detector_card_rows(found))
        return
    print_table(found.name, ("", ""), card_rows(found))
    if found.scores:
        print_table("scores", SCORES_HEAD, score_rows(found))


def tasks(as_json: opt.Json = False) -> None:
    """List the tasks of spoofgym-bench-v1, with their brackets and the scores that are known."""
    from ..bench.report import tasks as stored
    from ..tasks import DETECTOR_TASKS, SUITE, TASKS

    if as_json:
        print_json([*stored.listed(), *stored.listed_detectors()])
        return
    rows = [
        (key, task.env_id, task.title + (", historical" if task.historical else ""))
        for key, task in TASKS.items()
    ]
    print_table(SUITE, ("task", "environment", "what it asks for"), rows)
    print_table("stealthy displacement", stored.HEAD, stored.score_rows())
    print_table("admission", stored.ADMISSION_HEAD, stored.admission_rows())
    head = ("task", "environment of a learner", "world", "families that are held out")
    defended = [
        (key, each.env_id, each.title, ", ".join(family.key for family in each.held_out))
        for key, each in DETECTOR_TASKS.items()
    ]
    print_table(f"{SUITE}, for detectors", head, defended)
    cards = stored.stored_detector_cards()
    print_table("protection", stored.CARD_HEAD, stored.card_rows(cards))
    print_lines(
        f"{key} has no reference scores yet: {command}" for key, command in stored.missing().items()
    )
