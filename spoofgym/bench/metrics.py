r"""Scores of a campaign, from arrays over runs: proportions, delays, displacements, intervals.

Intervals are two-sided with 95 % confidence unless another one is asked for.  Sources, keys in
references.bib: `wilson1927` (proportions), `clopper1934` (exact, for rare alarms), `korn1998`
(epochs that come in runs), `kaplan1958` (delays with missed runs), `efron1979` (bootstrap).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special, stats

from ..envs import _kernels

FloatArray = NDArray[np.float64]
CONFIDENCE = 0.95
RESAMPLES = 2000


class Estimate(NamedTuple):
    """A number and the interval around it.

    `value`, `low`, `high`: estimate and interval; NaN where there is nothing to estimate from.
    """

    value: float
    low: float
    high: float

    def as_json(self) -> dict[str, float | None]:
        """By names, None where it is unknown."""
        return {
            name: None if math.isnan(number) else round(number, 6)
            for name, number in self._asdict().items()
        }


NOTHING = Estimate(math.nan, math.nan, math.nan)


def undetected_displacement(
    error: ArrayLike, first_alarm: ArrayLike, time_to_alert: int
) -> FloatArray:
    r"""Largest induced error with no alarm up to the time to alert after it.

    .. math:: D_u = \max_{0 \le k < a - h} e_k, \qquad e_0 = 0

    with the first alarm at epoch a and h epochs to alert: what was induced within h epochs before
    the alarm, or at it, does not count.

    `error` (K, R) induced error at the epochs 1 to K after the onset [m]; what comes after the
    alarm may be NaN; `first_alarm` (R,) epoch of the first alarm after the onset, from 1 on; 0
    where there is none up to epoch K + h; returns (R,) [m].
    """
    e = np.asarray(error, dtype=np.float64)
    largest = np.maximum.accumulate(np.concatenate([np.zeros((1, e.shape[1])), e]))
    return np.asarray(
        _kernels.undetected_displacement(largest, np.asarray(first_alarm), time_to_alert)
    )


def wilson(events: int, trials: int, confidence: float = CONFIDENCE) -> Estimate:
    r"""Proportion with Wilson's score interval.

    .. math:: \frac{1}{1 + z^2/n} \left( \hat p + \frac{z^2}{2n}
        \pm z \sqrt{\frac{\hat p (1 - \hat p)}{n} + \frac{z^2}{4 n^2}} \right)
    """
    if trials == 0:
        return NOTHING
    interval = stats.binomtest(events, trials).proportion_ci(confidence, method="wilson")
    return Estimate(events / trials, float(interval.low), float(interval.high))


def clopper_pearson(events: float, trials: float, confidence: float = CONFIDENCE) -> Estimate:
    r"""Proportion with the exact interval, by quantiles of the beta distribution.

    SciPy's own takes whole numbers alone, and `clustered_proportion` counts parts of runs.

    .. math:: B_{\alpha/2}(k, n - k + 1), \quad B_{1 - \alpha/2}(k + 1, n - k)
    """
    if trials == 0:
        return NOTHING
    tail = 0.5 * (1.0 - confidence)
    rest = trials - events
    low = 0.0 if events == 0 else float(special.betaincinv(events, rest + 1.0, tail))
    high = 1.0 if rest == 0 else float(special.betaincinv(events + 1.0, rest, 1.0 - tail))
    return Estimate(events / trials, low, high)


def clustered_proportion(
    events: ArrayLike, trials: int, confidence: float = CONFIDENCE
) -> Estimate:
    r"""Proportion of epochs, which come in runs, with an exact interval for as many as they count.

    Alarms of one run hang together, so that its epochs are worth less than as many independent
    ones: by the design effect, the variance between runs over that of independent epochs,

    .. math:: D = \frac{\operatorname{var}(p_r) / R}{\hat p (1 - \hat p) / (R K)}, \qquad
        n = R K / \max(D, 1)

    Without any event, or without anything else, the design effect is unknown, and only the runs
    count, n = R.  Korn and Graubard's small correction by quantiles of t is left out.

    `events` (R,) epochs with an alarm in each run.
    """
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
    interval = clopper_pearson(p * effective, effective, confidence)
    return Estimate(p, interval.low, interval.high)


def restricted_mean_delay(
    delay: ArrayLike, detected: ArrayLike, horizon: float, weights: ArrayLike | None = None
) -> FloatArray:
    r"""Mean delay up to a horizon, with runs that were missed, by the Kaplan-Meier estimate.

    .. math:: \int_0^H S(t) \, dt, \qquad
        S(t) = \prod_{t_i \le t} \left(1 - \frac{d_i}{n_i}\right)

    with d detections at time :math:`t_i` among the n runs that were still undetected and observed;
    S is the part of the runs that has not been detected yet.

    `delay` (R,) time of the detection, or the time up to which the run was observed; `detected`
    (R,) bool, which of the two it is; `horizon`: H, a delay counts as at most this; `weights`
    (..., R) how often each run counts, such as `counts_of` bootstrap samples; once by default;
    returns (...,) in the unit of the delays; NaN where no run counts.
    """
    t = np.minimum(np.asarray(delay, dtype=np.float64), horizon)
    seen = np.asarray(detected, dtype=np.bool_)
    w = np.ones(len(t)) if weights is None else np.asarray(weights, dtype=np.float64)
    # where times are equal, detections come before those that are observed no longer
    order = np.lexsort((~seen, t))
    t, seen, w = t[order], seen[order], w[..., order]
    at_risk = np.cumsum(w[..., ::-1], axis=-1)[..., ::-1]
    leaving = np.where(seen, w, 0.0) / np.maximum(at_risk, 1.0)
    survival = np.cumprod(1.0 - leaving, axis=-1)
    ones = np.ones((*w.shape[:-1], 1))
    before = np.concatenate([ones, survival], axis=-1)
    spans = np.diff(np.concatenate([[0.0], t, [horizon]]))
    mean = (before * spans).sum(axis=-1)
    return np.asarray(np.where(w.sum(axis=-1) > 0.0, mean, np.nan))


def resamples(runs: int, rng: np.random.Generator, count: int = RESAMPLES) -> NDArray[np.int64]:
    """Bootstrap samples of runs; the same for all cells of a campaign, so that they stay paired.

    Returns (S, R) indices of runs.
    """
    return rng.integers(0, runs, size=(count, runs))


def counts_of(samples: NDArray[np.int64]) -> FloatArray:
    """How often each run is in each bootstrap sample.

    `samples` (S, R) of `resamples`; returns (S, R).
    """
    rows, runs = samples.shape
    flat = samples + runs * np.arange(rows)[:, None]
    return np.bincount(flat.ravel(), minlength=rows * runs).reshape(rows, runs).astype(np.float64)


def bootstrap_mean(
    values: ArrayLike, samples: NDArray[np.int64], confidence: float = CONFIDENCE
) -> Estimate:
    """Mean over runs with its percentile interval.

    `values` (R,) one of each run; a difference between two cells is paired this way; `samples`
    (S, R) of `resamples`.
    """
    x = np.asarray(values, dtype=np.float64)
    return percentiles(float(x.mean()), x[samples].mean(axis=1), confidence)


def percentiles(value: float, drawn: FloatArray, confidence: float = CONFIDENCE) -> Estimate:
    """Percentile interval of a bootstrap.

    `drawn` (S,) estimates of the samples; NaN of those that hold nothing to estimate from.
    """
    known = drawn[np.isfinite(drawn)]
    if math.isnan(value) or not len(known):
        return NOTHING
    tail = 50.0 * (1.0 - confidence)
    low, high = np.percentile(known, [tail, 100.0 - tail])
    return Estimate(value, float(low), float(high))


def exceedance(
    values: ArrayLike, levels: ArrayLike, confidence: float = CONFIDENCE
) -> list[Estimate]:
    """Probability that a value exceeds each level, with Wilson's interval.

    `values` (R,), such as undetected displacements: then it is the probability of hazardously
    misleading information by alert limit; `levels` (L,); returns (L,).
    """
    x = np.asarray(values, dtype=np.float64)
    return [
        wilson(int(np.sum(x > level)), len(x), confidence)
        for level in np.asarray(levels, dtype=np.float64)
    ]
