"""Zero-sum matrix games: known equilibria, guarantees of both sides, and bad input."""

import numpy as np
import pytest

from spoofgym.bench.scores.matrix_game import bootstrap_equilibrium, solve


@pytest.mark.parametrize(
    ("payoff", "rows", "columns", "value"),
    [
        ([[0, -1, 1], [1, 0, -1], [-1, 1, 0]], [1 / 3] * 3, [1 / 3] * 3, 0.0),
        ([[1.0, -1.0], [-1.0, 1.0]], [0.5, 0.5], [0.5, 0.5], 0.0),
        # the third row is dominated by the first, the third column by the second
        ([[3.0, 0.0, 4.0], [1.0, 2.0, 5.0], [2.0, -1.0, 3.0]], [0.25, 0.75, 0], [0.5, 0.5, 0], 1.5),
        ([[2.0, 1.0], [0.0, 5.0]], [5 / 6, 1 / 6], [2 / 3, 1 / 3], 5 / 3),
        # saddle points
        ([[4.0, 1.0, 3.0], [5.0, 2.0, 2.5]], [0, 1], [0, 1, 0], 2.0),
        ([[7.0]], [1], [1], 7.0),
        ([[0.0, 0.0], [0.0, 0.0]], [1, 0], [1, 0], 0.0),
    ],
)
def test_known_games_have_their_mixes(payoff, rows, columns, value):
    found = solve(payoff)
    np.testing.assert_allclose(found.spoofer, rows, atol=1e-9)
    np.testing.assert_allclose(found.detector, columns, atol=1e-9)
    assert (found.value, found.pure) == (pytest.approx(value, abs=1e-9), max(rows) == 1)


@pytest.mark.parametrize("seed", range(8))
def test_neither_side_gains_by_leaving_a_random_game(seed):
    rng = np.random.default_rng(seed)
    payoff = rng.normal(size=rng.integers(1, 12, 2)) * 10.0 ** rng.integers(-3, 4)
    found, size = solve(payoff), np.abs(payoff).max()
    for mix in (found.spoofer, found.detector):
        assert mix.min() >= 0.0
        assert mix.sum() == pytest.approx(1.0)
    # what each is sure of is the same, and no pure strategy is sure of more
    assert (found.spoofer @ payoff).min() == pytest.approx(found.value, abs=1e-6 * size)
    assert (payoff @ found.detector).max() == pytest.approx(found.value, abs=1e-6 * size)
    assert payoff.min(axis=1).max() <= found.value + 1e-6 * size
    assert payoff.max(axis=0).min() >= found.value - 1e-6 * size


def test_value_moves_with_the_payoffs():
    payoff = np.random.default_rng(5).uniform(size=(4, 3))
    plain, moved = solve(payoff), solve(3.0 * payoff - 2.0)
    assert moved.value == pytest.approx(3.0 * plain.value - 2.0)
    assert solve(-payoff.T).value == pytest.approx(-plain.value)  # the sides are exchanged
    for bad, words in (
        (np.zeros((0, 3)), "shape"),
        ([1.0, 2.0], "shape"),
        ([[1.0, np.nan]], "nan at"),
        ([[1.0], [np.inf]], "inf at"),
    ):
        with pytest.raises(ValueError, match=words):
            solve(bad)


def test_intervals_are_as_wide_as_the_samples_differ():
    payoff = np.array([[2.0, 1.0], [0.0, 5.0]])
    found = bootstrap_equilibrium(payoff, np.repeat(payoff[None], 7, axis=0))
    for each in (found.value, *found.spoofer, *found.detector):
        assert each.low == pytest.approx(each.value, abs=1e-9)
        assert each.high == pytest.approx(each.value, abs=1e-9)
    assert (found.pure, found.samples) == (0.0, 7)
    payoff = np.array([[1.0, -1.0], [-1.0, 1.0]])
    found = bootstrap_equilibrium(payoff, np.array([payoff, payoff, [[3.0, 2.0], [0.0, 0.0]]]))
    assert found.value.high > 1.5
    assert found.pure == pytest.approx(1 / 3)
    unknown = np.full((2, 2), np.nan)  # is left out, or refused where all are
    assert bootstrap_equilibrium(payoff, np.array([payoff, unknown])).samples == 1
    with pytest.raises(ValueError, match="too few runs"):
        bootstrap_equilibrium(payoff, unknown[None])
    with pytest.raises(ValueError, match="shape"):
        bootstrap_equilibrium(payoff, np.zeros((3, 2, 1)))
