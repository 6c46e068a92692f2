"""What there is: by kind, the card of a spoofer, the tasks."""

from __future__ import annotations

from typing import Annotated

import typer

from . import options as opt
from .output import print_json, print_table


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
    from .._registry import check_choice
    from ..bench.listing import KINDS, table_of

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
        str, typer.Argument(help="A shipped spoofer, or a card or an ONNX file that has one.")
    ],
    as_json: opt.Json = False,
) -> None:
    """Show the card of a spoofer: what it fits, what it knows, how it was made, what it reached."""
    from ..bench.cards import SCORES_HEAD, card_rows, find_card, score_rows

    found = find_card(name)
    if as_json:
        print_json(found.model_dump(mode="json"))
        return
    print_table(found.name, ("", ""), card_rows(found))
    if found.scores:
        print_table("scores", SCORES_HEAD, score_rows(found))


def tasks(as_json: opt.Json = False) -> None:
    """List the tasks of spoofgym-bench-v1, with the scores that are known."""
    from ..bench.task_scores import stored_scores
    from ..tasks import TASKS

    scores = stored_scores()
    if as_json:
        print_json(
            [
                {"key": key, "env_id": task.env_id, "title": task.title, **scores.get(key, {})}
                for key, task in TASKS.items()
            ]
        )
        return
    columns = ("none", "ramp", "profile", "ppo")
    rows = []
    for key, task in TASKS.items():
        found = scores.get(key, {}).get("undetected_displacement_m", {})
        texts = (f"{found[name]:.1f}" if found.get(name) is not None else "-" for name in columns)
        rows.append((key, task.env_id, *texts, task.title))
    heads = ("task", "environment", *(f"{name} [m]" for name in columns), "what it asks for")
    print_table("spoofgym-bench-v1: mean undetected displacement", heads, rows)
