r"""The search for an open-loop profile: CMA-ES with common random numbers under an alarm budget.

A candidate x is a vector of rates at the knots, in units of the largest rate of the curve that the
search starts at.  Every generation plays all its candidates on the same part of the runs, and the
next generation on another part, so that the mean of the search distribution does not learn the
noise of a few runs by heart.  What is maximised is a Lagrangian,

.. math:: L(x) = \bar D_u(x) - \lambda \bar A(x)

with the mean undetected displacement and the alarm rate, both over the runs that count, which are
silent without attack.  Counted alarms are coarse on a few runs: a run without alarm counts for
:math:`\exp(-(1 - p) / w)` where its peak ratio p came close to 1, and what that adds on the
average is taken off again.  The price follows the alarms, by a moving average over generations,

.. math:: \lambda = \lambda_0 \exp(\kappa (\bar A - b) / b)

so that the search stays near the budget b; how fast the curve may be in the end is decided
afterwards, on other runs (`profile_choice`).  CMA-ES is that of `hansen2006`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from cmaes import CMA
from numpy.typing import NDArray

from spoofgym.spoofers import Profile
from spoofgym.spoofers.profile import sampled

from .profile_settings import Generation, SearchSettings, Start
from .runs import Outcome, RunPool

FloatArray = NDArray[np.float64]
PRICE, GAIN, FOLLOW = 6.0, 0.7, 0.2
"""lambda_0 in units of the displacement at the start; kappa; weight of the newest generation."""
CLOSE = 0.1
"""w, how close to its threshold a statistic counts as half an alarm."""
FINE, SAFE = 1000, 0.999
"""Samples of two curves that are compared with the attack's limit, and how close they may come."""
SMOOTH_LENGTH = 0.25
"""Part of the window over which neighbouring knots vary together."""


class ProfileSearch:
    """A search that can be stopped after every generation, and taken up again from its record.

    - `record`: generations of an interrupted search with the same settings, which goes on after
      them;
    - `finished`: whether the last restart has converged.
    """

    def __init__(
        self,
        pool: RunPool,
        settings: SearchSettings,
        start: Start,
        record: Sequence[Generation] = (),
    ) -> None:
        if settings.batch > pool.runs:
            raise ValueError(f"`batch` = {settings.batch} is more than the {pool.runs} runs")
        if len(start.rates_mps) != settings.knots:
            raise ValueError(
                f"the start must have {settings.knots} rates, got {len(start.rates_mps)}"
            )
        self.pool, self.settings, self.start = pool, settings, start
        self.generations: list[Generation] = []
        self.finished, self._left = False, settings.restarts
        self._alarms, self._softness = settings.budget, 0.0
        self._cma = begin(settings, start, start_point(settings, start), settings.seed)
        self._means: list[FloatArray] = []
        for past in record:
            self._replay(past)

    @property
    def price(self) -> float:
        """Displacement that an alarm in every run costs [m]."""
        beyond = np.clip(self._alarms / self.settings.budget - 1.0, -4.0, 4.0)
        return float(PRICE * self.start.displacement_m * np.exp(GAIN * beyond))

    def rows(self) -> NDArray[np.intp]:
        """Runs of the coming generation; all have their turn before any comes again."""
        per_round = self.pool.runs // self.settings.batch
        turn, part = divmod(len(self.generations), per_round)
        order = np.random.default_rng([self.settings.seed, turn]).permutation(self.pool.runs)
        size = self.settings.batch
        return np.sort(order[part * size : (part + 1) * size])

    def profile(self, point: FloatArray, scale: float = 1.0) -> Profile:
        """Spoofer of a candidate."""
        limit = self.pool.setup.attack.rate_limit_mps
        return profile_at(self.settings, point * self.start.unit_mps * scale, limit)

    def step(self) -> Generation:
        """Try one generation."""
        points = [self._cma.ask() for _ in range(self.settings.population)]
        outcome = self.pool.play([self.profile(point) for point in points], self.rows())
        counted, soft = outcome.alarm_rate, soft_alarms(outcome)
        displacement = outcome.mean_m
        self._follow(float(counted.mean()), float(soft.mean()))
        losses = self.price * (soft - self._softness) - displacement
        done = Generation(
            [point.tolist() for point in points],
            losses.tolist(),
            float(displacement.mean()),
            float(counted.mean()),
            float(soft.mean()),
        )
        self._learn(points, done)
        return done

    def _follow(self, counted: float, soft: float) -> None:
        """Moving averages of the alarms, and of what runs that came close add to them."""
        weight = FOLLOW if self.generations else 1.0
        self._softness += weight * (soft - counted - self._softness)
        self._alarms += FOLLOW * (counted - self._alarms)

    def _learn(self, points: list[FloatArray], done: Generation) -> None:
        """Tell CMA-ES, and keep the record."""
        self._cma.tell(list(zip(points, done.losses, strict=True)))
        self.generations.append(done)
        self._means.append(self._cma.mean.copy())
        if self._cma.should_stop():
            self.finished = self._left == 0
            if not self.finished:
                self._left -= 1
                seed = self.settings.seed + self.settings.restarts - self._left
                self._cma = begin(self.settings, self.start, self._means[-1], seed)

    def _replay(self, past: Generation) -> None:
        """Take up a generation that was played before the search was interrupted."""
        points = [self._cma.ask() for _ in range(self.settings.population)]
        if [point.tolist() for point in points] != past.points:
            raise ValueError(
                f"generation {len(self.generations)} of the record is not what this search "
                "would have tried: it comes from other settings, or from another machine"
            )
        self._follow(past.alarm_rate, past.soft_alarms)
        self._learn(points, past)

    def shapes(self) -> dict[str, FloatArray]:
        """Curves that are worth a choice, by what they are. Returns the last mean of the search
        distribution, its average over the last third of the generations, and the best candidate of
        the last generation."""
        if not self.generations:
            raise ValueError("the search has not begun")
        last = self.generations[-1]
        third = self._means[-max(len(self._means) // 3, 1) :]
        return {
            "mean": self._means[-1],
            "averaged mean": np.mean(third, axis=0),
            "best of the last generation": np.array(last.points[int(np.argmin(last.losses))]),
        }


def soft_alarms(outcome: Outcome) -> FloatArray:
    """Alarm rate in which runs that came close count in part. Returns (P,) mean over the runs that
    count."""
    close = np.exp(-np.maximum(1.0 - outcome.peak, 0.0) / CLOSE)
    part = np.where(outcome.alarm, 1.0, close)
    return np.asarray(part[:, outcome.counts].mean(axis=1))


def start_point(settings: SearchSettings, start: Start) -> FloatArray:
    """First mean of the search: the curve of the start, and nothing across. Returns (knots,), or (2
    knots,) with a second curve."""
    point = np.asarray(start.rates_mps, dtype=np.float64) / start.unit_mps
    return np.concatenate([point, np.zeros(len(point) if settings.cross else 0)])


def begin(settings: SearchSettings, start: Start, mean: FloatArray, seed: int) -> CMA:
    """CMA-ES around a point, with curves that are smooth for a good part. `start`: tells the
    standard deviation, and how smooth the curves are."""
    t = np.linspace(0.0, 1.0, settings.knots)
    near = np.exp(-0.5 * ((t[:, None] - t) / SMOOTH_LENGTH) ** 2)
    block = start.smooth * near + (1.0 - start.smooth) * np.eye(len(t))
    cov = np.kron(np.eye(2 if settings.cross else 1), block)
    size = settings.population
    return CMA(mean=mean, sigma=start.sigma, seed=seed, cov=cov, population_size=size)


def profile_at(settings: SearchSettings, rates_mps: FloatArray, limit_mps: float) -> Profile:
    """Spoofer of one curve, or of one along and one across the heading. `rates_mps`: (knots,) or (2
    knots,); `limit_mps`: of the attack; what is beyond is shortened."""
    curves = np.reshape(rates_mps, (-1, settings.knots))
    curves = curves * (limit_mps / np.maximum(np.linalg.norm(curves, axis=0), limit_mps))
    if len(curves) == 2:
        # two curves within the limit at their knots may leave it a little between them
        between = [sampled(tuple(curve.tolist()), FINE) for curve in curves]
        curves = curves * min(1.0, SAFE * limit_mps / np.hypot(*between).max())
    along, *across = [tuple(curve.tolist()) for curve in curves]
    return Profile(
        rates_mps=along,
        cross_rates_mps=across[0] if across else (),
        heading_deg=settings.heading_deg,
    )
