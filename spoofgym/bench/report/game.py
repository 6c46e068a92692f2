"""A matrix game as a table."""

from __future__ import annotations

from ..scores.matrix_game import PayoffMatrix
from .table import Table, interval


def print_game(task: str, matrix: PayoffMatrix, payoff: str, runs: int) -> None:
    """Print the mix of the detectors, and every spoofer with its part and its payoffs."""
    spread = matrix.spread()
    value = interval(spread.value.as_json(), 2)
    solved = "a pure pair solves it" if matrix.solve().pure else "no pure pair solves it"
    mixes = ([interval(p.as_json(), 2) for p in side] for side in (spread.spoofer, spread.detector))
    spoofers, detectors = mixes
    rows = [("mix", "", "", *detectors)]
    for spoofer, part, values in zip(matrix.spoofers, spoofers, matrix.values, strict=True):
        rows.append((spoofer.label, spoofer.knowledge, part, *(f"{x:.3f}" for x in values)))
    labels = (each.label for each in matrix.detectors)
    title = f"{task}: value {value}, {solved}; {payoff} by {matrix.payoff.limit_m:g} m, {runs} runs"
    Table.of_texts("spoofer", "observes", "mix", *labels).print(title, rows)
