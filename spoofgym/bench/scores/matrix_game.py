"""Zero-sum matrix games of spoofers and detectors: payoffs, equilibria, and how sure they are.

Rows are spoofers, which want a large payoff, columns detectors, which want a small one, all on the
same runs.  The runs are drawn again, and the game is solved in each of the samples (`efron1979`).
The payoff needs no alarm budget, which would depend on the detectors that are met: so it is a
number for every pair, and a mix is worth what its members are on average.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...core.declared import setting, settings_record
from ..runs.players import Mixture, PlayerSpec, Strategy, mixture
from .scores import select_clusters
from .statistics import Estimate, FloatArray, draw_resamples, percentiles

GAP = 1e-7  # largest part of the range of the payoffs by which both sides' guarantees may differ


class Equilibrium(NamedTuple):
    """Mixed strategies (m,) of rows, (n,) of columns in equilibrium; `pure`: of one each."""

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
        When the matrix is empty, is not two-dimensional, or has an entry that is not finite.
    RuntimeError
        When the solver fails.

    Examples
    --------
    >>> from spoofgym.bench.scores.matrix_game import solve
    >>> found = solve([[1.0, -1.0], [-1.0, 1.0]])
    >>> found.spoofer.tolist(), found.detector.tolist(), found.value, found.pure
    ([0.5, 0.5], [0.5, 0.5], 0.0, False)
    """
    a = checked_payoff(payoff)
    worst, most = a.min(axis=1), a.max(axis=0)
    i, j = int(np.argmax(worst)), int(np.argmin(most))
    if worst[i] == most[j]:
        rows, columns = (np.eye(size)[k] for size, k in zip(a.shape, (i, j), strict=True))
        return Equilibrium(rows, columns, float(worst[i]), True)
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
    a = np.asarray(payoff, dtype=np.float64)
    if a.ndim != 2 or 0 in a.shape:
        raise ValueError(
            f"a payoff matrix must have at least one row and one column, got shape {a.shape}"
        )
    if not np.isfinite(a).all():
        i, j = np.argwhere(~np.isfinite(a))[0]
        raise ValueError(f"every payoff must be a finite number, got {a[i, j]} at ({i}, {j})")
    return a


class Spread(NamedTuple):
    """An equilibrium with intervals over bootstrap samples; `pure`: share of pure ones."""

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


def bootstrap_equilibrium(payoff: ArrayLike, resampled: ArrayLike) -> Spread:
    """Solve a game (m, n) again in every bootstrap sample (S, m, n) without gaps: 95 %
    intervals."""
    found, drawn = solve(payoff), np.asarray(resampled, dtype=np.float64)
    shape = len(found.spoofer), len(found.detector)
    if drawn.ndim != 3 or drawn.shape[1:] != shape:
        raise ValueError(
            f"`resampled` must have shape (S, {shape[0]}, {shape[1]}), got {drawn.shape}"
        )
    games = [solve(each) for each in drawn if np.isfinite(each).all()]
    if not games:
        raise ValueError("no bootstrap sample has all of its entries: there are too few runs")
    rows, columns, values, pure = (np.array(part) for part in zip(*games, strict=True))
    return Spread(
        percentiles(found.value, values),
        tuple(percentiles(float(p), each) for p, each in zip(found.spoofer, rows.T, strict=True)),
        tuple(
            percentiles(float(p), each) for p, each in zip(found.detector, columns.T, strict=True)
        ),
        float(pure.mean()),
        len(games),
    )


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


PAYOFFS = ("stealth", "hmi")
RESAMPLES = 400


@settings_record(frozen=True)
class RunPayoff:
    """What a run is worth to the spoofer, in [0, 1]."""

    kind: str = setting(
        default="stealth",
        one_of=PAYOFFS,
        help="The undetected displacement in parts of the alert limit, at most 1, and 0 in a run "
        "with an alarm from the onset to the end of the time to alert; or whether the undetected "
        "displacement exceeds the limit, also where an alarm follows later.",
    )
    limit_m: float = setting(default=40.0, above=0.0, unit="m", help="Alert limit, or a length.")

    def worth(self, displacement: FloatArray, alarmed: NDArray[np.bool_]) -> FloatArray:
        """Payoff of runs by undetected displacements [m] and alarms, of any shape."""
        if self.kind == "hmi":
            return np.asarray(displacement > self.limit_m).astype(np.float64)
        part = np.minimum(displacement, self.limit_m) / self.limit_m
        return np.asarray(np.where(alarmed, 0.0, part))


@dataclass(frozen=True, repr=False)
class PayoffMatrix:
    """Payoffs of strategies, spoofers by rows and detectors by columns, on the same runs of `sky`
    (R,). `rows` (m, p), `columns` (n, q): weights of the pure members in each of them, of which
    `displacement`, `alarmed` (p, q, R) and `counts` (q, R) are; `seeds`: entropy and split."""

    spoofers: tuple[Strategy, ...]
    detectors: tuple[Strategy, ...]
    payoff: RunPayoff
    rows: FloatArray
    columns: FloatArray
    displacement: FloatArray
    alarmed: NDArray[np.bool_]
    counts: NDArray[np.bool_]
    sky: NDArray[np.int64]
    seeds: tuple[int, str]

    def __repr__(self) -> str:
        rows, columns = ([each.label for each in side] for side in (self.spoofers, self.detectors))
        return f"PayoffMatrix({rows} x {columns}, {len(self.sky)} runs of {self.seeds})"

    @property
    def values(self) -> FloatArray:
        """(m, n) mean payoffs over the runs that count; NaN where none does."""
        return np.asarray(self.resample_payoffs(np.ones((1, len(self.sky))))[0])

    def resample_payoffs(self, samples: FloatArray) -> FloatArray:
        """(S, m, n) payoffs of bootstrap samples (S, R), as of `draw_resamples`."""
        worth = self.payoff.worth(self.displacement, self.alarmed) * self.counts
        runs = (samples @ self.counts.T.astype(np.float64))[:, None, :]
        with np.errstate(invalid="ignore"):
            pure = np.einsum("sr,pqr->spq", samples, worth, optimize=True) / runs
        unknown = (self.rows > 0.0) @ np.isnan(pure).astype(np.float64) @ (self.columns > 0.0).T
        mixed = self.rows @ np.nan_to_num(pure) @ self.columns.T
        return np.asarray(np.where(unknown > 0.0, np.nan, mixed))

    def samples(self, count: int = RESAMPLES) -> FloatArray:
        return draw_resamples(select_clusters(self.sky), count)

    def solve(self) -> Equilibrium:
        return solve(self._finite())

    def spread(self, count: int = RESAMPLES) -> Spread:
        """Equilibrium with intervals: the runs are drawn again, the game is solved again. Returns
        percentile intervals, 95 %."""
        return bootstrap_equilibrium(self._finite(), self.resample_payoffs(self.samples(count)))

    def mixes(self, found: Equilibrium) -> tuple[Mixture, Mixture]:
        seeds = frozenset({self.seeds})
        return (
            mixture("spoofers' mix", _pure(self.spoofers), found.spoofer, seeds),
            mixture("detectors' mix", _pure(self.detectors), found.detector, seeds),
        )

    def contrast(self, weights: ArrayLike) -> Estimate:
        """Sum of all entries with weights (m, n), such as a difference of two, with its interval.
        It is paired, since all entries have the same runs."""
        w = np.asarray(weights, dtype=np.float64)
        drawn = np.tensordot(self.resample_payoffs(self.samples()), w, axes=2)
        return percentiles(float((self.values * w).sum()), drawn)

    def _finite(self) -> FloatArray:
        values = self.values
        for i, j in np.argwhere(~np.isfinite(values)):
            raise ValueError(
                f"{self.spoofers[i].label} against {self.detectors[j].label} has no payoff: of "
                f"{len(self.sky)} runs none is silent before the onset and without an attack"
            )
        return values

    def as_json(self) -> dict[str, Any]:
        alarms = (self.alarmed & self.counts).sum(axis=2) / np.maximum(self.counts.sum(axis=1), 1)
        return {
            "payoff": {"kind": self.payoff.kind, "limit_m": self.payoff.limit_m},
            "runs": len(self.sky),
            "entropy": self.seeds[0],
            "split": self.seeds[1],
            "spoofers": [each.as_json() for each in self.spoofers],
            "detectors": [each.as_json() for each in self.detectors],
            "values": [[round(float(x), 6) for x in row] for row in self._finite()],
            "alarm_rates": np.round(alarms, 6).tolist(),
            "counted": self.counts.sum(axis=1).tolist(),
        }


def _pure(strategies: Sequence[Strategy]) -> list[PlayerSpec]:
    found = [each for each in strategies if isinstance(each, PlayerSpec)]
    if len(found) < len(strategies):
        raise ValueError("can't mix strategies that are mixes: solve the game of their members")
    return found
