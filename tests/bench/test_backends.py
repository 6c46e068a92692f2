"""Backends of a search for blind optima: a pool plays as its members do, each on its runs."""

from __future__ import annotations

import numpy as np
import pytest

from spoofgym.bench.search.backends import MixedBackend


class Known:
    """Largest ratio and error are products of the curve's last value and the run's number."""

    steps, limits = 4, (1.0, np.inf)

    def __init__(self, factor, runs):
        self.factor, self.runs = factor, runs

    def play(self, curves, rows):
        found = self.factor * curves[:, -1:] * (1.0 + rows)
        return found, found.mean(axis=1)


CURVES = np.linspace(0.1, 1.0, 8).reshape(2, 4)


def test_a_pool_of_one_is_its_backend():
    one, rows = Known(2.0, 10), np.array([1, 4, 9])
    mixed = MixedBackend([one], [3.0]).play(CURVES, rows)
    for mine, its in zip(mixed, one.play(CURVES, rows), strict=True):
        np.testing.assert_allclose(mine, its)


def test_runs_are_shared_by_the_weights():
    a, b = Known(1.0, 10), Known(100.0, 8)
    mixed = MixedBackend([a, b], [0.75, 0.25])
    assert (mixed.runs, mixed.steps, mixed.limits) == (8, 4, (1.0, np.inf))
    rows = np.arange(8)
    peak, reach = mixed.play(CURVES, rows)
    np.testing.assert_allclose(peak[:, :6], a.play(CURVES, rows[:6])[0])
    np.testing.assert_allclose(peak[:, 6:], b.play(CURVES, rows[6:])[0])
    np.testing.assert_allclose(reach, peak.mean(axis=1))


@pytest.mark.parametrize("rows", [[0, 1], [7], [3, 6]])
def test_a_part_of_the_runs_is_played_as_among_all(rows):
    mixed = MixedBackend([Known(1.0, 8), Known(100.0, 8)], [1.0, 1.0])
    whole, _ = mixed.play(CURVES, np.arange(8))
    part, _ = mixed.play(CURVES, np.array(rows))
    np.testing.assert_array_equal(part, whole[:, rows])
