r"""The blind optimum: the best open-loop attack found against a detector.

A curve of the rate through knots is looked for by CMA-ES (`hansen2006`).  Its candidates are played
on response replay, which adds an attack to recorded clean runs and asks the detector itself; on the
engine where a detector de-weights, so that replay does not hold.

Every generation is played on another part of the runs, so that the mean of the search does not
learn the noise of a few of them by heart.  Every candidate is scored at the amplitude that its
share of alarms allows.  For each run the amplitude at which its largest ratio of statistic to
threshold comes to 1 is interpolated between two that are judged; the score is the displacement at
the quantile of these, by a line through the smaller ones against normal scores, which a single run
moves less than the quantile itself.

What comes out is a curve.  Its amplitude is fitted on the engine, as that of every spoofer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import special

from .._registry import whole_number
from ..spoofers.profile import MOST_KNOTS, sampled

FloatArray = NDArray[np.float64]
Rows = NDArray[np.intp]
Tick = Callable[[float], None]
LADDER = np.geomspace(1e-3, 1.0, 13)
"""Parts of the largest rate at which the first curves are tried."""
PAIR = (0.93, 1.075)
"""Amplitudes at which a candidate is judged, around that of the best so far."""
STEEPEST, FLATTEST = 4.0, 0.1
"""Largest and smallest power of the amplitude by which a largest ratio is taken to grow."""
FEWEST = 2
"""Runs that a search takes."""
AT_ONCE = 24
"""Attacks that are judged together."""
SPREAD, SMOOTH_LENGTH, SMOOTH = 0.035, 0.2, 0.98
"""Standard deviation of the first candidates, in units of the largest rate; part of the window over
which neighbouring knots vary together, and for how much of the variance."""
LOWER_PART = 0.3
"""Part of the runs above the share whose amplitudes decide on the quantile, too."""
FREE = 0.95
"""Part of the farthest reach of the attack from which on a search is over before it begins."""
SHAPES: dict[str, Callable[[FloatArray], FloatArray]] = {
    "constant": lambda t: np.ones_like(t),
    "smooth entry": lambda t: np.where(t < 0.5, t * t * (12.0 - 16.0 * t), 1.0),
    "linear": lambda t: t,
    "quadratic": lambda t: t * t,
    "late": lambda t: t**4,
    "half linear": lambda t: 0.3 + 0.7 * t,
    "late linear": lambda t: np.clip(2.0 * t - 1.0, 0.0, None),
}
"""Rates over the attack window of the curves that a search starts from."""


@dataclass(frozen=True, kw_only=True)
class BlindSearch:
    """How a blind optimum is looked for. `runs`, `batch`: clean runs that it is looked for on, of a
    split of their own, and how many of them play a generation; `knots`: of the curve, 2 to 64;
    `population`, `generations`: of CMA-ES; no generations for the best of the first curves."""

    runs: int = 144
    batch: int = 48
    knots: int = 24
    population: int = 12
    generations: int = 12
    seed: int = 0

    def __post_init__(self) -> None:
        leasts = {"runs": 8, "batch": 4, "knots": 2, "population": 4, "generations": 0, "seed": 0}
        for name, least in leasts.items():
            value = whole_number(f"`blind_search.{name}`", getattr(self, name), least)
            object.__setattr__(self, name, value)
        if self.knots > MOST_KNOTS:
            raise ValueError(f"`blind_search.knots` must be at most {MOST_KNOTS}, got {self.knots}")


class Player(Protocol):
    """Plays sampled curves on runs that count, which are silent without an attack."""

    @property
    def runs(self) -> int:
        """N."""

    @property
    def steps(self) -> int:
        """Values of a sampled curve."""

    @property
    def limits(self) -> tuple[float, float]:
        """Largest rate, and its largest change between two values, which may be infinite [m/s]."""

    def play(self, curves: FloatArray, rows: Rows) -> tuple[FloatArray, FloatArray]:
        """Largest ratios (P, n), and mean over the runs of the farthest error (P,) [m]."""


class BlindOptimum(NamedTuple):
    """A curve that a search has found.

    - `rates_mps` (knots,) at the amplitude that the share of alarms allows on the runs;
    - `displacement_m` it gets there, by the score of the search;
    - `start`: shape that the search began at, and `start_m` what that gets;
    - `free`: whether it gets as far as any attack, so that nothing was left to search for.
    """

    rates_mps: FloatArray
    displacement_m: float
    start: str
    start_m: float
    free: bool = False


class BlindOptimizer:
    """Search for the curve that gets farthest while some share of the runs may alarm."""

    def __init__(self, player: Player, share: float, settings: BlindSearch) -> None:
        self.player, self.share, self.settings = player, share, settings
        self.everyone = np.arange(player.runs)

    def search(
        self, others: Mapping[str, FloatArray] | None = None, tick: Tick | None = None
    ) -> BlindOptimum:
        """Search, from the best of some shapes, with `others` (n,) among them, by their names. With
        fewer than two runs nothing can be told of any share of them: that is the slowest of the
        first curves. The rates are within the attack's limit, as they were judged."""
        advance = tick or (lambda part: None)
        found, (limit, _) = self._search(others or {}, advance), self.player.limits
        return found._replace(rates_mps=np.clip(found.rates_mps, -limit, limit))

    def _search(self, others: Mapping[str, FloatArray], advance: Tick) -> BlindOptimum:
        """Search; what is found may be beyond the attack's limit."""
        t = np.linspace(0.0, 1.0, self.settings.knots)
        if self.player.runs < FEWEST:
            slowest = np.full(len(t), LADDER[0] * self.player.limits[0])
            return BlindOptimum(slowest, 0.0, "constant", 0.0)
        if (fastest := self._unseen(len(t))) is not None:
            return fastest
        shapes = {name: shape(t) for name, shape in SHAPES.items()}
        for name, other in others.items():
            at_knots = np.interp(t, np.linspace(0.0, 1.0, len(other)), other)
            shapes[name] = at_knots / np.abs(at_knots).max()
        found, free = self._ladder(shapes)
        advance(0.2)
        if free:
            return found._replace(free=True)
        means = [found.rates_mps, *self._generations(found.rates_mps, advance)]
        third = np.array(means[-max(len(means) // 3, 1) :])
        scores, rates = self._pairs(
            np.array([means[0], *third, third.mean(axis=0)]), means[0].mean(), self.everyone
        )
        best = int(np.argmax(scores))
        return found._replace(rates_mps=rates[best], displacement_m=float(scores[best]))

    def _unseen(self, knots: int) -> BlindOptimum | None:
        """The fastest curve of all, where no run alarms at it: nothing gets farther."""
        fastest = np.full(knots, self.player.limits[0])
        peak, reach = self._judge(fastest[None], self._batch(0))
        if (peak > 1.0).any():
            return None
        return BlindOptimum(fastest, float(reach[0]), "constant", float(reach[0]), True)

    def _ladder(self, shapes: dict[str, FloatArray]) -> tuple[BlindOptimum, bool]:
        """Best of some shapes over all amplitudes, and whether it gets as far as any attack."""
        limit, _ = self.player.limits
        scales, count = LADDER * limit, len(LADDER)
        tried = [scale * shape for shape in shapes.values() for scale in scales]
        peak, reach = self._judge(np.array(tried), self._batch(0))
        found = BlindOptimum(np.zeros(0), -1.0, "", -1.0)
        for k, (name, shape) in enumerate(shapes.items()):
            own = slice(k * count, (k + 1) * count)
            edges = np.array([crossing(scales, column) for column in peak[own].T])
            scale = self._allowed(edges)
            score = float(np.interp(math.log(scale), np.log(scales), reach[own]))
            if score > found.displacement_m:
                found = BlindOptimum(scale * shape, score, name, score)
        return found, found.displacement_m >= FREE * float(reach.max())

    def _allowed(self, edges: FloatArray) -> float:
        """Amplitude that a share of alarms allows, by (N,) those at which single runs alarm."""
        count = len(edges)
        lowest = min(max(4, math.ceil((self.share + LOWER_PART) * count)), count)
        normal = special.ndtri((np.arange(lowest) + 0.5) / count)
        slope, level = np.polyfit(normal, np.log(np.sort(edges)[:lowest]), 1)
        return float(np.exp(level + slope * special.ndtri(self.share)))

    def _batch(self, turn: int) -> Rows:
        """Runs of a turn; all have theirs before any comes again."""
        size = min(self.settings.batch, len(self.everyone))
        parts = max(len(self.everyone) // size, 1)
        again, part = divmod(turn, parts)
        order = np.random.default_rng([self.settings.seed, again]).permutation(self.everyone)
        return np.asarray(np.sort(order[part * size : (part + 1) * size]))

    def _judge(self, rates: FloatArray, rows: Rows) -> tuple[FloatArray, FloatArray]:
        """Play (P, knots) rates, as the attack's limits let them be followed."""
        curves = self.curves(rates)
        starts = range(0, len(rates), AT_ONCE)
        parts = [self.player.play(curves[k : k + AT_ONCE], rows) for k in starts]
        peak, reach = (np.concatenate(each) for each in zip(*parts, strict=True))
        return peak, reach

    def curves(self, rates: FloatArray) -> FloatArray:
        """Sampled curves (P, steps) of rates at knots (P, knots), within the attack's limits."""
        steps, (limit, most) = self.player.steps, self.player.limits
        wanted = np.array([sampled(tuple(rate.tolist()), steps) for rate in rates])
        wanted = np.clip(wanted, -limit, limit)
        if math.isinf(most):
            return np.asarray(wanted)
        now: FloatArray = np.zeros(len(wanted))
        out: FloatArray = np.empty(wanted.shape)
        for k in range(steps):
            now = now + np.clip(wanted[:, k] - now, -most, most)
            out[:, k] = now
        return out

    def _generations(self, start: FloatArray, advance: Tick) -> Iterator[FloatArray]:
        """Means of CMA-ES, each at the amplitude of its score."""
        try:
            from cmaes import CMA
        except ImportError as error:
            raise ImportError(
                "the search for a blind optimum needs cmaes: pip install 'spoofgym[limits]'"
            ) from error
        settings, unit = self.settings, float(np.abs(start).max())
        t = np.linspace(0.0, 1.0, settings.knots)
        near = np.exp(-0.5 * ((t[:, None] - t) / SMOOTH_LENGTH) ** 2)
        cov = SMOOTH * near + (1.0 - SMOOTH) * np.eye(len(t))
        size = settings.population
        cma = CMA(start / unit, SPREAD, seed=settings.seed, cov=cov, population_size=size)
        moved = float(start.mean())
        for turn in range(settings.generations):
            # the mean is one of the candidates: it learns the noise of a few runs the least
            asked = [cma.mean.copy(), *(cma.ask() for _ in range(size - 1))]
            scores, rates = self._pairs(np.array(asked) * unit, moved, self._batch(turn))
            cma.tell([(x, -score) for x, score in zip(asked, scores.tolist(), strict=True)])
            moved = float(rates[0].mean())
            advance(0.8 / settings.generations)
            yield rates[0]

    def _pairs(self, rates: FloatArray, moved: float, rows: Rows) -> tuple[FloatArray, FloatArray]:
        """Scores of (P, knots) rates, and these at the amplitudes of the scores. All are brought to
        the same mean rate first, so that they are judged near their amplitude."""
        mean = rates.mean(axis=1)
        rates = (
            rates * np.where(mean * moved > 0.0, moved / np.where(mean, mean, 1.0), 1.0)[:, None]
        )
        peak, reach = self._judge(np.concatenate([factor * rates for factor in PAIR]), rows)
        low, high = np.log(np.maximum(peak, 1e-300)).reshape(2, len(rates), -1)
        width, middle = math.log(PAIR[1] / PAIR[0]), math.sqrt(PAIR[0] * PAIR[1])
        power = np.clip((high - low) / width, FLATTEST, STEEPEST)
        edges = middle * np.exp(np.clip(-0.5 * (low + high) / power, -1.5, 1.5))
        scale = np.array([self._allowed(each) for each in edges])
        near, far = reach.reshape(2, -1)
        growth = np.clip(np.log(far / near) / width, 0.0, 1.5)
        score = np.sqrt(near * far) * (scale / middle) ** growth
        return score, rates * scale[:, None]


def crossing(amplitudes: FloatArray, peak: FloatArray) -> float:
    """Amplitude at which a largest ratio comes to 1, between those that were judged."""
    above = np.flatnonzero(peak > 1.0)
    if not len(above):
        return float(amplitudes[-1])
    k = int(above[0])
    if k == 0:
        return float(amplitudes[0])
    low, high = (math.log(max(float(peak[j]), 1e-12)) for j in (k - 1, k))
    ratio = float(amplitudes[k] / amplitudes[k - 1])
    return float(amplitudes[k - 1] * ratio ** min(max(-low / max(high - low, 1e-12), 0.0), 1.0))
