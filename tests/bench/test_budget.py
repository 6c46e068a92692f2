"""The alarm budget, and the search for its edge."""

from __future__ import annotations

import numpy as np
import pytest

from spoofgym.bench.budget import Excess, excess_of, halve, largest_within, reach


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


def test_the_excess_is_that_of_paired_runs() -> None:
    alarm = np.array([1, 1, 1, 0, 0, 0, 0, 0], dtype=np.bool_)
    clean = np.array([1, 0, 0, 1, 0, 0, 0, 0], dtype=np.bool_)
    excess = excess_of(alarm, clean)
    assert excess.value == 0.125
    assert excess.error == pytest.approx(np.std([0, 1, 1, -1, 0, 0, 0, 0]) / 8**0.5)
    assert excess_of(clean, clean) == Excess(0.0, 0.0)


@pytest.mark.parametrize(("margin", "kept"), [(0.0, True), (2.0, True), (2.1, False)])
def test_a_margin_is_counted_in_standard_errors(margin: float, kept: bool) -> None:
    assert Excess(0.03, 0.01).keeps(0.05, margin) is kept


def test_a_search_aims_below_the_budget_by_the_margin() -> None:
    assert reach(0.05, 2.0, 0.01) == pytest.approx(0.03)
    assert reach(0.05, 0.0, 0.01) == 0.05
    assert reach(0.05, 2.0, 0.1) == pytest.approx(0.01)  # never far below
