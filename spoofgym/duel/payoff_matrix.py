"""Matrices of payoffs: what every spoofer gets against every detector, on the same runs.

The payoff needs no alarm budget, which would depend on the detectors that are met: so it is a
number for every pair, and a mix is worth what its members are on average.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._registry import check_choice, check_finite
from ..bench.metrics import Estimate, percentiles, resamples_of
from ..bench.scores import clusters_of
from .matrix_game import Equilibrium, Spread, solve, spread
from .members import Member, Mixture, Strategy, mixture

FloatArray = NDArray[np.float64]
PAYOFFS = ("stealth", "hmi")
RESAMPLES = 400


class Played(NamedTuple):
    """R runs of a spoofer against a detector.

    - `displacement` undetected [m], `alarmed` in the judged window, `counts` whether the run does.
    """

    displacement: FloatArray
    alarmed: NDArray[np.bool_]
    counts: NDArray[np.bool_]


@dataclass(frozen=True)
class RunPayoff:
    """What a run is worth to the spoofer, in [0, 1]. `kind`: the undetected displacement in parts
    of the alert limit, at most 1, and 0 in a run with an alarm from the onset to the end of the
    time to alert; or whether the undetected displacement exceeds the limit, also where an alarm
    follows later; `limit_m`: alert limit, or a length [m]."""

    kind: str = "stealth"
    limit_m: float = 40.0

    def __post_init__(self) -> None:
        check_choice("payoff", self.kind, PAYOFFS)
        check_finite("limit_m", self.limit_m, "> 0")

    def worth(self, displacement: FloatArray, alarmed: NDArray[np.bool_]) -> FloatArray:
        """Payoff of runs by undetected displacements [m] and alarms, of any shape."""
        if self.kind == "hmi":
            return np.asarray(displacement > self.limit_m).astype(np.float64)
        part = np.minimum(displacement, self.limit_m) / self.limit_m
        return np.asarray(np.where(alarmed, 0.0, part))


@dataclass(frozen=True, repr=False)
class PayoffMatrix:
    """Payoffs of rows, spoofers, against columns, detectors; all on the same runs.

    - `spoofers`, `detectors`: strategies; `payoff`: what a run is worth;
    - `rows` (m, p), `columns` (n, q): weights of the pure `members` in each of them;
    - `displacement`, `alarmed` (p, q, R), `counts` (q, R): of the pure ones;
    - `sky` (R,) under which each run flew;
    - `seeds`: entropy and split of the runs.
    """

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
        """Who plays whom, and on which runs; not the runs themselves."""
        who, whom = ([each.label for each in side] for side in (self.spoofers, self.detectors))
        return f"PayoffMatrix({who} x {whom}, {len(self.sky)} runs of {self.seeds})"

    @property
    def values(self) -> FloatArray:
        """(m, n) mean payoffs over the runs that count; NaN where none does."""
        return np.asarray(self.resampled(np.ones((1, len(self.sky))))[0])

    def resampled(self, samples: FloatArray) -> FloatArray:
        """(S, m, n) payoffs of bootstrap samples (S, R), as of `bench.metrics.resamples`."""
        worth = self.payoff.worth(self.displacement, self.alarmed) * self.counts
        runs = (samples @ self.counts.T.astype(np.float64))[:, None, :]
        with np.errstate(invalid="ignore"):
            pure = np.einsum("sr,pqr->spq", samples, worth, optimize=True) / runs
        unknown = (self.rows > 0.0) @ np.isnan(pure).astype(np.float64) @ (self.columns > 0.0).T
        mixed = self.rows @ np.nan_to_num(pure) @ self.columns.T
        return np.asarray(np.where(unknown > 0.0, np.nan, mixed))

    def samples(self, count: int = RESAMPLES) -> FloatArray:
        """(S, R) bootstrap samples of the runs, whole skies at a time."""
        return resamples_of(clusters_of(self.sky), count)

    def solve(self) -> Equilibrium:
        return solve(self._finite())

    def spread(self, count: int = RESAMPLES) -> Spread:
        """Equilibrium with intervals: the runs are drawn again, the game is solved again. Returns
        percentile intervals, 95 %."""
        return spread(self._finite(), self.resampled(self.samples(count)))

    def mixes(self, found: Equilibrium) -> tuple[Mixture, Mixture]:
        """Mixes of an equilibrium as strategies, which these runs have decided on."""
        seeds = frozenset({self.seeds})
        return (
            mixture("spoofers' mix", _pure(self.spoofers), found.spoofer, seeds),
            mixture("detectors' mix", _pure(self.detectors), found.detector, seeds),
        )

    def contrast(self, weights: ArrayLike) -> Estimate:
        """Sum of all entries with weights (m, n), such as a difference of two, with its interval.
        It is paired, since all entries have the same runs."""
        w = np.asarray(weights, dtype=np.float64)
        drawn = np.tensordot(self.resampled(self.samples()), w, axes=2)
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
        """JSON-able: strategies, payoffs, and what runs of pure strategies came to."""
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


def _pure(strategies: Sequence[Strategy]) -> list[Member]:
    found = [each for each in strategies if isinstance(each, Member)]
    if len(found) < len(strategies):
        raise ValueError("a mix of mixtures is not made: solve the game of their members")
    return found
