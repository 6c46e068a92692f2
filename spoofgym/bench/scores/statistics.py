r"""Intervals of proportions and means over runs, bootstrap, and the alarm budget.

Intervals are two-sided with 95 % confidence.  Sources, keys in
references.bib: `wilson1927` (proportions), `clopper1934` (exact, for rare alarms), `korn1998`
(epochs that come in runs), `efron1979` (bootstrap).

The alarm budget says how often a spoofer may be noticed where chance alone would be silent.  With k
alarms in n runs that count (`record.mask_valid_runs`), the largest probability of an alarm that is
not refuted at the level :math:`\alpha` is (one-sided, `clopper1934`)

.. math:: \bar p = B_{1 - \alpha}(k + 1, n - k)

a quantile of the beta distribution.  A spoofer that is chosen on these runs keeps the budget b
where :math:`\bar p \le b`, so that other runs, most likely, keep it too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special, stats

FloatArray = NDArray[np.float64]
CONFIDENCE = 0.95
RESAMPLES = 2000
AT_ONCE = 256  # bootstrap samples whose runs are sorted and summed up together


class Estimate(NamedTuple):
    """A number and the ends of its interval; NaN where there is nothing to estimate from, and
    `high` alone where nothing bounds it."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, data: Mapping[str, float | None]) -> Estimate:
        return cls(**{key: math.nan if (x := data[key]) is None else x for key in cls._fields})

    def as_json(self) -> dict[str, float | None]:
        return {
            name: None if math.isnan(number) else round(number, 6)
            for name, number in self._asdict().items()
        }

    def __str__(self) -> str:
        return interval(self.as_json())


NOTHING = Estimate(math.nan, math.nan, math.nan)


def format_number(value: float) -> str:
    """Number as text, with as many digits as suit its size."""
    return f"{value:.{_digits(abs(value))}f}"


def interval(estimate: Mapping[str, float | None], digits: int | None = None) -> str:
    """Number with its interval as text, from ``value``, ``low`` and ``high``, None where unknown.
    `digits`: after the point; as many as suit the size by default. One without a width at these
    digits is printed as what they leave open: ``8.7 (within 0.05)``."""
    value, *ends = (estimate[key] for key in ("value", "low", "high"))
    if value is None:
        return "-"
    if digits is None:
        digits = _digits(max((abs(end) for end in ends if end is not None), default=abs(value)))
    low, high = ("?" if end is None else f"{end:.{digits}f}" for end in ends)
    where = f"{low} or more" if ends[0] is not None and ends[1] is None else f"{low} to {high}"
    if None not in ends and float(low) == float(high):
        unit = 10.0**-digits
        where = f"within {(0.5 + round(abs(float(low) - round(value, digits)) / unit)) * unit:g}"
    return f"{value:.{digits}f} ({where})"


def in_percent(estimate: Mapping[str, float | None]) -> dict[str, float | None]:
    """Proportion and the ends of its interval, in per cent."""
    found = {key: estimate[key] for key in ("value", "low", "high")}
    return {key: None if x is None else 100.0 * x for key, x in found.items()}


def percent(estimate: Mapping[str, float | None], digits: int = 1) -> str:
    """Proportion with its interval, in per cent."""
    return interval(in_percent(estimate), digits)


def _digits(size: float) -> int:
    return 0 if size >= 100.0 else 1 if size >= 1.0 else 2


def wilson(events: int, trials: int) -> Estimate:
    r"""Proportion with Wilson's score interval.

    .. math:: \frac{1}{1 + z^2/n} \left( \hat p + \frac{z^2}{2n}
        \pm z \sqrt{\frac{\hat p (1 - \hat p)}{n} + \frac{z^2}{4 n^2}} \right)
    """
    if trials == 0:
        return NOTHING
    interval = stats.binomtest(events, trials).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(events / trials, float(interval.low), float(interval.high))


def clopper_pearson(events: float, trials: float) -> Estimate:
    r"""Proportion with the exact interval, by quantiles of the beta distribution.

    SciPy's own takes whole numbers alone, and `clustered_proportion` counts parts of runs.

    .. math:: B_{\alpha/2}(k, n - k + 1), \quad B_{1 - \alpha/2}(k + 1, n - k)
    """
    if trials == 0:
        return NOTHING
    tail = 0.5 * (1.0 - CONFIDENCE)
    rest = trials - events
    low = 0.0 if events == 0 else float(special.betaincinv(events, rest + 1.0, tail))
    high = 1.0 if rest == 0 else float(special.betaincinv(events + 1.0, rest, 1.0 - tail))
    return Estimate(events / trials, low, high)


def clustered_proportion(events: ArrayLike, trials: int) -> Estimate:
    r"""Proportion of epochs (R,), which come in runs, with an exact interval for as many as they
    count, by the design effect (`korn1998`, without their correction by quantiles of t): the
    variance between runs over that of independent epochs. Without any event, or anything else, only
    the runs count."""
    per_run = np.asarray(events, dtype=np.float64)
    runs = len(per_run)
    if runs == 0 or trials == 0:
        return NOTHING
    p = float(per_run.sum()) / (runs * trials)
    effective = float(runs)
    if 0.0 < p < 1.0 and runs > 1:
        between = float(np.var(per_run / trials, ddof=1)) / runs
        independent = p * (1.0 - p) / (runs * trials)
        effective = runs * trials / max(between / independent, 1.0)
    interval = clopper_pearson(p * effective, effective)
    return Estimate(p, interval.low, interval.high)


def draw_resamples(clusters: ArrayLike, count: int = RESAMPLES) -> FloatArray:
    """(S, R) how often bootstrap samples draw each run: whole clusters (R,), such as skies, are
    drawn with replacement, as many as there are. They depend on the clusters alone, so that what
    has the same stays paired."""
    return _draw_cached(np.asarray(clusters, dtype=np.int64).tobytes(), count)


@lru_cache(maxsize=4)
def _draw_cached(clusters: bytes, count: int) -> FloatArray:
    of = np.frombuffer(clusters, dtype=np.int64)
    names, where = np.unique(of, return_inverse=True)
    if not len(names):
        return np.zeros((count, 0))
    chances, rng = np.full(len(names), 1.0 / len(names)), np.random.default_rng(len(of))
    return rng.multinomial(len(names), chances, size=count)[:, where].astype(np.float64)


def bootstrap_mean(values: ArrayLike, samples: FloatArray) -> Estimate:
    """Mean over runs with its percentile interval; unknown without runs. `values` (R,) one of each
    run; a difference between two cells is paired this way; `samples` (S, R) of `draw_resamples`."""
    x = np.asarray(values, dtype=np.float64)
    if not len(x):
        return NOTHING
    return percentiles(float(x.mean()), samples @ x / samples.sum(axis=1))


def bounded_mean(values: ArrayLike, clusters: ArrayLike, least: float) -> Estimate:
    r"""Mean over runs of what lies between `least` and 1, with its percentile interval.

    Where all runs have the same value c, a bootstrap has an interval without width. Then others
    may come with a probability up to q, the exact limit of `clopper_pearson` for none in as many
    trials as there are clusters:

    .. math:: c - q (c - \mathrm{least}), \quad c + q (1 - c)

    `values`, `clusters` (R,) as those of `bootstrap_mean` and `draw_resamples`.
    """
    x = np.asarray(values, dtype=np.float64)
    if not len(x) or np.ptp(x) > 0.0:
        return bootstrap_mean(x, draw_resamples(clusters))
    value, q = float(x[0]), clopper_pearson(0.0, len(np.unique(clusters))).high
    return Estimate(value, value - q * (value - least), value + q * (1.0 - value))


def largest_of_share(values: ArrayLike, share: float, samples: FloatArray) -> FloatArray:
    """(S,) largest value of (R,) that at least a share of the runs reach, in bootstraps (S, R)."""
    x = np.asarray(values, dtype=np.float64)
    order = np.argsort(-x, kind="stable")

    def find(part: FloatArray) -> FloatArray:
        reached = np.cumsum(part[:, order], axis=1)
        needed = np.maximum(np.ceil(share * reached[:, -1] - 1e-9), 1.0)
        return np.asarray(x[order][np.argmax(reached >= needed[:, None], axis=1)])

    return map_samples(find, samples)


def map_samples(function: Callable[[FloatArray], FloatArray], samples: FloatArray) -> FloatArray:
    """What a function makes of bootstrap samples (S, R), each by itself, some at a time: (S,)."""
    parts = np.array_split(samples, max(math.ceil(len(samples) / AT_ONCE), 1))
    return np.concatenate([function(part) for part in parts])


def weighted_quantile(values: ArrayLike, share: float, samples: FloatArray) -> FloatArray:
    """(S,) largest value of (R,) that at most a share of the runs does not exceed, between two of
    them in proportion, in bootstrap samples (S, R)."""
    x = np.asarray(values, dtype=np.float64)
    order = np.argsort(x, kind="stable")
    below = np.cumsum(samples[:, order], axis=1)
    wanted = share * below[:, -1]
    whole = np.floor(wanted + 1e-9)
    ends = np.clip([whole, whole + 1.0], 1.0, below[:, -1])
    lower, upper = (x[order][np.argmax(below >= end[:, None], axis=1)] for end in ends)
    return np.asarray(lower + np.maximum(wanted - whole, 0.0) * (upper - lower))


def percentiles(value: float, drawn: FloatArray) -> Estimate:
    """Percentile interval of a bootstrap. `drawn` (S,) estimates of the samples; NaN of those that
    hold nothing to estimate from."""
    known = drawn[np.isfinite(drawn)]
    if math.isnan(value) or not len(known):
        return NOTHING
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(known, [tail, 100.0 - tail])
    return Estimate(value, float(low), float(high))


def bound_above(found: Estimate, share: float, runs: int) -> Estimate:
    """What a share of the runs exceeds, without an upper end where they are too few for one: with
    the confidence of the interval none of them may lie beyond it."""
    bounded = (1.0 - share) ** runs <= 0.5 * (1.0 - CONFIDENCE)
    return found if bounded else Estimate(found.value, found.low, math.nan)


def exceedance(values: ArrayLike, levels: ArrayLike) -> list[Estimate]:
    """Probability that a value (R,) exceeds each level (L,), with Wilson's interval; of undetected
    displacements that is P(HMI) by alert limit."""
    x = np.asarray(values, dtype=np.float64)
    each = np.asarray(levels, dtype=np.float64)
    return [wilson(int(np.sum(x > level)), len(x)) for level in each]


BUDGET = 0.05
"""Default: an alarm in at most five of a hundred runs that are silent without the spoofer."""
LEVEL = 0.05  # probability with which the limit of an alarm rate is too low


def alarm_limit(alarms: int, runs: int) -> float:
    """Upper 95 % limit of the probability of an alarm; 1 where no run counts."""
    if alarms >= runs:
        return 1.0
    return float(special.betaincinv(alarms + 1.0, runs - alarms, 1.0 - LEVEL))


def keeps(alarms: int, runs: int, budget: float) -> bool:
    return alarm_limit(alarms, runs) <= budget + 1e-9


def fewest_runs(budget: float) -> int:
    """Runs without any alarm that it takes to keep a budget."""
    return math.ceil(math.log(LEVEL) / math.log1p(-budget) - 1e-9)


def most_alarms(runs: int, budget: float) -> int:
    """Alarms with which so many runs keep a budget; -1 where they are too few."""
    return next((k for k in range(runs, -1, -1) if keeps(k, runs, budget)), -1)


def aim(runs: int, budget: float) -> float:
    """Alarm rate that a search or a training aims at, so that its choice on so many runs keeps it.
    At least a fifth of the budget, since there is nothing to find far below it."""
    return max(most_alarms(runs, budget) / max(runs, 1), 0.2 * budget)


def build_log_grid(low: float, high: float, count: int) -> list[float]:
    return [rounded_down(value) for value in np.geomspace(low, high, count)]


def rounded_down(value: float) -> float:
    """Number rounded down to four digits, so that a choice can be written down."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 3.0)
    return float(f"{math.floor(value / digit + 1e-6) * digit:.6g}")
