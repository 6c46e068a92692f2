"""Table of many trained spoofers, and of their rivals: who gets how far, and what each knows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from spoofgym.bench.report.table import Table, interval

from .seeds import find_median_seed, mark_displacement, reached_by

KNOWLEDGE = ("blind", "blind+reported", "oracle")
"""What a trained spoofer observes, in the order of the columns."""
RIVALS = ("ramp", "accelerating-ramp", "open-loop")
"""Whom policies are compared with, each fitted to the budget on the same training runs."""
FEEDBACK, BEST = "feedback", "open-loop"


def page(table: Mapping[str, Any]) -> str:
    """Table of all cells, a line for each detector; what needs the victim's statistics is last.
    `table`: results of trainings by ``"world/detector/knowledge"``."""
    heads = (
        *("world", "detector", *(_head(table, name) for name in RIVALS)),
        *("PPO (blind)", f"of the {BEST}", "PPO (blind+reported)"),
        *(_head(table, FEEDBACK), "PPO (oracle)"),
    )
    rows = []
    for case in dict.fromkeys(cell.rpartition("/")[0] for cell in table):
        blind, reported, oracle = (table.get(f"{case}/{known}") for known in KNOWLEDGE)
        rivals = {} if blind is None else blind["rivals"]
        rows.append(
            (
                *(*case.split("/"), *(_score(rivals.get(name)) for name in RIVALS)),
                *(_seeds(blind), _ratio(blind), _seeds(reported)),
                *(_score(rivals.get(FEEDBACK)), _seeds(oracle)),
            )
        )
    return Table.of_texts(*heads).markdown(rows) + "\n"


def _head(table: Mapping[str, Any], name: str) -> str:
    """A rival, and what it observes where it has played."""
    scores = (cell["rivals"].get(name) for cell in table.values())
    known = next((score["knowledge"] for score in scores if score), None)
    return name if known is None else f"{name} ({known})"


def _score(score: Mapping[str, Any] | None) -> str:
    """Displacement with its interval, `*` where it is over the budget; "-" where there is none."""
    return mark_displacement(score) if score else "-"


def _seeds(results: Mapping[str, Any] | None) -> str:
    return "-" if results is None else reached_by(results["seeds"])


def _ratio(results: Mapping[str, Any] | None) -> str:
    """The median seed's ratio to the best profile that is known, paired by runs."""
    if results is None or BEST not in results["rivals"]:
        return "-"
    middle = find_median_seed(results["seeds"], BEST)
    return interval(middle["ratios"][BEST], 2) if middle["score"] else "0"
