"""Zero-sum matrix games: equilibria by linear programming, and how sure they are.

Rows are spoofers, who want a large payoff, columns detectors, who want a small one.  Payoffs that
are estimated from runs are noisy, and so are the equilibrium and its value: the runs are drawn
again, and the game is solved in each of the samples (`efron1979`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..bench.metrics import Estimate, percentiles

FloatArray = NDArray[np.float64]
GAP = 1e-7
"""Largest part of the range of the payoffs by which both sides' guarantees may differ."""


class Equilibrium(NamedTuple):
    """Mixes of both sides from which neither gains by leaving.

    - `spoofer` (m,) probability of every row, `detector` (n,) of every column;
    - `value`: expected payoff;
    - `pure`: whether one row and one column solve the game.
    """

    spoofer: FloatArray
    detector: FloatArray
    value: float
    pure: bool


def solve(payoff: ArrayLike) -> Equilibrium:
    """Solve a zero-sum matrix game.

    Parameters
    ----------
    payoff : array_like
        (m, n) what the row player is paid, and the column player loses.

    Returns
    -------
    Equilibrium
        One of them; a pure one where there is any.

    Raises
    ------
    ValueError
        When the matrix is empty, is none, or has an entry that is no finite number.
    RuntimeError
        When the solver fails.

    Examples
    --------
    >>> from spoofgym.duel.matrix_game import solve
    >>> found = solve([[1.0, -1.0], [-1.0, 1.0]])
    >>> found.spoofer.tolist(), found.detector.tolist(), found.value, found.pure
    ([0.5, 0.5], [0.5, 0.5], 0.0, False)
    """
    a = checked_payoff(payoff)
    worst, most = a.min(axis=1), a.max(axis=0)
    i, j = int(np.argmax(worst)), int(np.argmin(most))
    if worst[i] == most[j]:
        return Equilibrium(_unit(a.shape[0], i), _unit(a.shape[1], j), float(worst[i]), True)
    low, size = float(a.min()), float(a.max() - a.min())
    rows, columns = _program((a - low) / size)
    guaranteed, conceded = float((rows @ a).min()), float((a @ columns).max())
    if conceded - guaranteed > GAP * size:
        raise RuntimeError(
            f"no equilibrium was found: the row player is sure of {guaranteed:g}, the column "
            f"player of {conceded:g}"
        )
    return Equilibrium(rows, columns, 0.5 * (guaranteed + conceded), False)


def checked_payoff(payoff: ArrayLike) -> FloatArray:
    """Return a matrix of finite payoffs, or raise a ValueError."""
    a = np.asarray(payoff, dtype=np.float64)
    if a.ndim != 2 or 0 in a.shape:
        raise ValueError(
            f"a payoff matrix must have at least one row and one column, got shape {a.shape}"
        )
    if not np.isfinite(a).all():
        i, j = np.argwhere(~np.isfinite(a))[0]
        raise ValueError(f"every payoff must be a finite number, got {a[i, j]} at ({i}, {j})")
    return a


def gains(payoff: ArrayLike, spoofer: ArrayLike, detector: ArrayLike) -> tuple[float, float]:
    """Most that each side gains within the matrix by leaving a pair of mixes alone. `payoff`: (m,
    n); `spoofer`, `detector`: (m,) and (n,) probabilities; returns `spoofer, detector`, not
    negative; their sum is the exploitability within the matrix."""
    a, x, y = checked_payoff(payoff), np.asarray(spoofer), np.asarray(detector)
    value = float(x @ a @ y)
    return float((a @ y).max()) - value, value - float((x @ a).min())


class Spread(NamedTuple):
    """An equilibrium with intervals over bootstrap samples.

    - `value`, and `spoofer` and `detector`, one estimate for each probability;
    - `pure`: part of the samples that a pure pair solves;
    - `samples`: how many were solved.
    """

    value: Estimate
    spoofer: tuple[Estimate, ...]
    detector: tuple[Estimate, ...]
    pure: float
    samples: int

    def as_json(self) -> dict[str, Any]:
        mixes = {
            name: [each.as_json() for each in getattr(self, name)]
            for name in ("spoofer", "detector")
        }
        return {"value": self.value.as_json(), **mixes, "pure": self.pure, "samples": self.samples}


def spread(payoff: ArrayLike, resampled: ArrayLike) -> Spread:
    """Solve a game again in every bootstrap sample. `payoff`: (m, n) of all runs; `resampled`: (S,
    m, n) of the samples; those with an entry that is no number are left out; returns percentile
    intervals, 95 %."""
    found, drawn = solve(payoff), np.asarray(resampled, dtype=np.float64)
    shape = len(found.spoofer), len(found.detector)
    if drawn.ndim != 3 or drawn.shape[1:] != shape:
        raise ValueError(
            f"`resampled` must have shape (S, {shape[0]}, {shape[1]}), got {drawn.shape}"
        )
    games = [solve(each) for each in drawn if np.isfinite(each).all()]
    if not games:
        raise ValueError("no bootstrap sample has all of its entries: there are too few runs")
    values, rows, columns, pure = (np.array(part) for part in zip(*_parts(games), strict=True))
    return Spread(
        percentiles(found.value, values),
        tuple(percentiles(float(p), each) for p, each in zip(found.spoofer, rows.T, strict=True)),
        tuple(
            percentiles(float(p), each) for p, each in zip(found.detector, columns.T, strict=True)
        ),
        float(pure.mean()),
        len(games),
    )


def _parts(games: list[Equilibrium]) -> list[tuple[float, FloatArray, FloatArray, bool]]:
    return [(each.value, each.spoofer, each.detector, each.pure) for each in games]


def _unit(size: int, k: int) -> FloatArray:
    return np.asarray(np.eye(size)[k])


def _program(a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mixes of both sides: the row player's program, and its marginals."""
    from scipy.optimize import linprog

    m, n = a.shape
    found = linprog(
        np.r_[np.zeros(m), -1.0],  # the value, as large as can be
        A_ub=np.c_[-a.T, np.ones(n)],  # which every column pays at least
        b_ub=np.zeros(n),
        A_eq=np.r_[np.ones(m), 0.0][None],
        b_eq=[1.0],
        bounds=[*[(0.0, None)] * m, (None, None)],
        method="highs",
    )
    if found.status != 0:
        raise RuntimeError(f"no equilibrium was found: {found.message}")
    rows, columns = np.clip(found.x[:m], 0.0, None), np.clip(-found.ineqlin.marginals, 0.0, None)
    return rows / rows.sum(), columns / columns.sum()
