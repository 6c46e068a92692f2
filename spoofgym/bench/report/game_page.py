"""A matrix game as a table, and its page."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from operator import itemgetter
from typing import Any

from ...core.registry import format_label
from ..experiments.store import Store
from ..runs.record import RunRecord
from . import figures
from .page import Page, Picture, Sheet, list_played_settings
from .table import Table, format_number, interval, percent, share

Row = dict[str, Any]
STRATEGIES = "spoofer", "detector"


def tabulate_game(record: Row) -> tuple[Table, list[Sequence[str]]]:
    """The mix of the detectors, and every spoofer with its part and its payoffs."""
    spread = record["equilibrium"]
    spoofers, detectors = ([interval(p, 2) for p in spread[side]] for side in STRATEGIES)
    rows: list[Sequence[str]] = [("mix", "", "", *detectors)]
    for spoofer, part, values in zip(record["spoofers"], spoofers, record["values"], strict=True):
        shown = (f"{x:.3f}" for x in values)
        rows.append((spoofer["label"], spoofer.get("knowledge", ""), part, *shown))
    labels = (each["label"] for each in record["detectors"])
    return Table.of_texts("spoofer", "observes", "mix", *labels), rows


def _picture_payoffs(record: Row) -> Picture:
    spoofers, detectors = ([each["label"] for each in record[f"{side}s"]] for side in STRATEGIES)
    return Picture(
        "Payoffs",
        "Of each spoofer, a row, against each detector, a column [%]: the darker, the more the "
        "spoofer gains.",
        figures.draw_heat(spoofers, detectors, record["values"]),
        figures.heat_height(spoofers, detectors),
    )


def describe_game(record: Row) -> str:
    """Value of a game, and what it is played for."""
    spread, payoff = record["equilibrium"], record["payoff"]
    pure = {p["value"] for side in STRATEGIES for p in spread[side]} <= {0.0, 1.0}
    solved = "a pure pair solves it" if pure else "no pure pair solves it"
    return (
        f"value {interval(spread['value'], 2)}, {solved}; {payoff['kind']} by "
        f"{payoff['limit_m']:g} m, {record['runs']} runs"
    )


def print_game(task: str, record: Row) -> None:
    table, rows = tabulate_game(record)
    table.print(f"{task}: {describe_game(record)}", rows)


PAIRS = Table(
    ("spoofer", itemgetter(0)),
    ("detector", itemgetter(1)),
    ("runs", lambda row: row[2].runs),
    ("mean undetected displacement [m]", lambda row: row[2].displacement_m.mean(), format_number),
    ("alarms [% of runs]", lambda row: row[2].alarmed.mean(), share(1)),
)


def build_game_page(store: Store, scores: Row | None = None, replay: Row | None = None) -> Page:
    """Report of a game's folder; `scores`: as `Pairs.report` has them, None of what is not
    finished."""
    found = {}
    for cell, result in store.read_all():
        named = cell.identity or {}
        labels = (format_label(each, None) for each in (named["spoofer"], named["detector"][0]))
        found[tuple(labels)] = RunRecord.from_parts(*result[:2])
    every = product(*(dict.fromkeys(labels) for labels in zip(*found, strict=True)))
    rows = [(*pair, record) for pair, record in found.items()]
    shared: dict[str, Any] = {
        "title": "Game of spoofers against detectors",
        "played": list_played_settings(store),
    }
    if scores is None:
        missing = [" / ".join(pair) for pair in every if pair and pair not in found]
        why = "The game is not solved yet: the command that plays it goes on."
        return Page(**shared, verdict=[why], missing=missing, sheets=[Sheet("Pairs", PAIRS, rows)])
    table, mixes = tabulate_game(scores)
    best = [
        f"Best {side}: "
        + ", ".join(
            f"{each['label']} in {percent(p)} % of the plays"
            for each, p in zip(scores[f"{side}s"], scores["equilibrium"][side], strict=True)
            if p["value"] > 0.0
        )
        for side in STRATEGIES
    ]
    return Page(
        **shared,
        verdict=[f"Equilibrium: {describe_game(scores)}; in brackets 95 % intervals.", *best],
        pictures=[_picture_payoffs(scores)],
        sheets=[Sheet("Payoffs and mixes", table, mixes), Sheet("Pairs", PAIRS, rows, "", True)],
        replay=replay,
        scores=scores,
    )
