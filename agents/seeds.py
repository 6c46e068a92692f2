"""Results of a training with several seeds: their table, and the policy that is kept."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from statistics import median
from typing import Any, Protocol, TypeVar

from rich.table import Table

from spoofgym._files import write_file
from spoofgym.bench.tables import interval
from spoofgym.spoofers.card import Card


class Known(Protocol):
    """What says what it observes."""

    @property
    def knowledge(self) -> str:
        """As in `Score`."""


Who = TypeVar("Who", bound=Known)


def comparable(rivals: Mapping[str, Who], knowledge: str) -> dict[str, Who]:
    """Rivals that a spoofer of some knowledge is compared with: oracles only where it is one."""
    oracle = knowledge.startswith("oracle")
    return {
        name: who
        for name, who in rivals.items()
        if oracle or not who.knowledge.startswith("oracle")
    }


def table_of(results: Mapping[str, Any]) -> Table:
    """Scores of all seeds, with what the network got before it learned, and of the rivals."""
    scores = [row["score"] for row in results["seeds"] if row["score"]]
    reached = [score["stealthy_displacement_m"]["value"] for score in scores]
    middle = f"; median of {len(reached)} seeds {median(reached):.2f} m" if reached else ""
    table = Table(title=f"against {results['detector']}, evaluation runs{middle}")
    for head in ("spoofer", "observes"):
        table.add_column(head)
    for head in ("stealthy displacement [m]", "alarms [%]", "untrained [m]", "minutes"):
        table.add_column(head, justify="right")
    for name, score in results["rivals"].items():
        table.add_row(name, score["knowledge"], *_cells(score))
    for row in results["seeds"]:
        cells = _cells(row["score"]) if row["score"] else ("none within the budget", "")
        untrained = row["untrained"]
        before = untrained["stealthy_displacement_m"]["value"]
        further = f"{before:.2f}", f"{row['wall_s'] / 60.0:.1f}"
        table.add_row(f"PPO, seed {row['seed']}", untrained["knowledge"], *cells, *further)
    return table


def _cells(score: Mapping[str, Any]) -> tuple[str, str]:
    """Displacement with its interval, marked where it is over the budget, and alarms."""
    keeps = score["within_budget"] and score["fit_within_budget"] is not False
    rate = 100.0 * score["alarm_rate"]["value"]
    return interval(score["stealthy_displacement_m"]) + ("" if keeps else "*"), f"{rate:.1f}"


def copy_policy(source: Path, target: Path, training: Mapping[str, Any]) -> None:
    """Write a policy and its card under another name, with further fields of its training."""
    content = source.read_bytes()
    card = Card.load(source.with_suffix(".json"))
    if card.file is None:
        raise ValueError(f"{source} is no policy of a file: its card is of {card.kind}")
    own = {
        "name": target.stem,
        "file": card.file.model_copy(update={"name": target.name}),
        "training": {**card.training, **training},
    }
    write_file(target, content)
    card.model_copy(update=own).save(target.with_suffix(".json"))
