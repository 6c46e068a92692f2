"""The search for the edge of the alarm budget."""

from __future__ import annotations

import numpy as np
import pytest

from spoofgym.bench.scores.statistics import halve, largest_within


class Edge:
    """Keeps the budget up to a factor, and remembers what was tried."""

    def __init__(self, edge: float) -> None:
        self.edge = edge
        self.tried: list[float] = []

    def keeps(self, factor: float) -> bool:
        self.tried.append(factor)
        return factor <= self.edge

    @property
    def best(self) -> float:
        return max(factor for factor in self.tried if factor <= self.edge)


@pytest.mark.parametrize("edge", np.geomspace(0.6, 1.7, 23))
def test_the_edge_is_found_to_the_last_halving(edge: float) -> None:
    search = Edge(edge)
    largest_within(search.keeps, 1.0, step=1.15, walks=4, halvings=3)
    assert edge / 1.15 ** (1 / 8) <= search.best * (1.0 + 1e-12)
    assert len(search.tried) <= 1 + 4 + 3
    assert len(set(search.tried)) == len(search.tried)


def test_without_an_edge_in_reach_it_only_walks() -> None:
    up, down = Edge(100.0), Edge(0.0)
    for search in (up, down):
        largest_within(search.keeps, 1.0, step=2.0, walks=3, halvings=5)
    assert up.tried == [1.0, 2.0, 4.0, 8.0]
    assert down.tried == [1.0, 0.5, 0.25, 0.125]


def test_it_begins_elsewhere_just_as_well() -> None:
    one, other = Edge(1.0), Edge(300.0)
    largest_within(one.keeps, 1.1)
    largest_within(other.keeps, 330.0)
    np.testing.assert_allclose(other.tried, 300.0 * np.array(one.tried), rtol=1e-12)


def test_halving_stays_between_the_two() -> None:
    search = Edge(3.0)
    halve(search.keeps, 1.0, 16.0, 4)
    np.testing.assert_allclose(search.tried, [4.0, 2.0, 8.0**0.5, 2.0**1.75])
