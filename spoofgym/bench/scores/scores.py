r"""The scores: what a run, a spoofer and a detector are worth.

A run is one number, the **undetected displacement** (`bench.runs.record`)

.. math:: D_u = \max \{ e_k : \text{no alarm from the onset to } k + h \}

where e is the induced error, the horizontal distance from the clean twin (same seed, same detector,
no attack), and h the time to alert.

A run **counts** where nothing but the attack can have raised an alarm: it is silent before the
onset, and its clean twin is silent in the judged window.  This selection is what keeps alarms by
chance from being worth anything: a detector that alarms by lottery scores as one that never does.

- A spoofer has its **stealthy displacement**: the mean of :math:`D_u` over the runs that count, of
  a spoofer that keeps the alarm budget (`budget`).  One that does not is scaled until it does.
- A detector has its **protection**: :math:`P(\mathrm{HMI} \mid \text{attack}) = P(D_u > AL)` by
  alert limit AL, over the runs that count, the largest over the attack suite at every AL, without a
  budget; and the displacement that the worst attack exceeds in half of the runs, and in 5 % of
  them.
- **Times** separate an alarm that the attack raised from one of chance by the twin: where the twin
  has alarmed too by then, it was chance (two competing risks).
"""

from __future__ import annotations

import math
import warnings
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from ...detectors.calibration_file import hourly_rate
from ..runs.record import Mask
from .statistics import CONFIDENCE, Estimate, FloatArray, alarm_limit, keeps

SHARES = (0.5, 0.05)  # shares of the runs in which the headlines' displacements are exceeded
WORST_SKIES = 0.1  # part of the skies from which an attacker picks the day
FEWEST_SKIES = 10  # with fewer of them there is no worst tenth
ALIKE = 1e-3
"""Part of a displacement by which another one has to differ from it: a smaller difference between
attacks is no merit of a detector."""


class Stealth(NamedTuple):
    """A spoofer on the `runs` that count; mean undetected displacement, NaN where none does."""

    runs: int
    alarms: int
    displacement_m: float

    @property
    def alarm_rate(self) -> float:
        return self.alarms / self.runs if self.runs else math.nan

    @property
    def alarm_limit(self) -> float:
        return alarm_limit(self.alarms, self.runs)

    def keeps(self, budget: float) -> bool:
        return keeps(self.alarms, self.runs, budget)

    def seems_to_keep(self, budget: float) -> bool:
        """Whether the rate itself is within a budget, on runs that are too few for its limit."""
        return self.runs > 0 and self.alarm_rate <= budget + 1e-9


def score_stealth(displacement: ArrayLike, alarm: ArrayLike, counts: ArrayLike) -> Stealth:
    """Score of a spoofer by its runs. `displacement` (R,) undetected [m]; `alarm` (R,) bool,
    whether each run alarmed; `counts` (R,) of `counted`."""
    mask = np.asarray(counts, dtype=np.bool_)
    runs = int(mask.sum())
    mean = float(np.asarray(displacement, dtype=np.float64)[mask].mean()) if runs else math.nan
    return Stealth(runs, int(np.asarray(alarm, dtype=np.bool_)[mask].sum()), mean)


def worst_skies(displacement: ArrayLike, sky: ArrayLike) -> NDArray[np.int64] | None:
    """Tenth of the skies in which most is displaced, by the means; None with fewer than ten.
    `displacement`, `sky` (R,) of each run [m], and which one it flew under."""
    x, under = np.asarray(displacement, dtype=np.float64), np.asarray(sky)
    skies = np.unique(under)
    if len(skies) < FEWEST_SKIES:
        return None
    means = np.array([x[under == each].mean() for each in skies])
    order = np.argsort(-means, kind="stable")
    return np.sort(skies[order[: math.ceil(WORST_SKIES * len(skies))]])


def select_clusters(sky: ArrayLike) -> NDArray[np.int64]:
    """(R,) which runs a bootstrap draws together: those under one sky, where there are ten or more,
    else single runs, so that intervals are for these skies alone."""
    under = np.asarray(sky, dtype=np.int64)
    return under if len(np.unique(under)) >= FEWEST_SKIES else np.arange(len(under))


def per_hour(per_run: Estimate, window_s: float) -> dict[str, float | None]:
    """Rate of a probability for a run; None where every run alarms, and nothing is known."""
    rates = (hourly_rate(each, window_s) for each in per_run)
    return {
        name: round(rate, 6) if math.isfinite(rate) else None
        for name, rate in zip(Estimate._fields, rates, strict=True)
    }


def by_chance(first_alarm: ArrayLike, twin_alarm: ArrayLike) -> Mask:
    """Whether the first alarm was chance: the twin has alarmed by then. `first_alarm`,
    `twin_alarm` (R,) epochs of the first alarms after the onset, 0 for none."""
    mine, twin = np.asarray(first_alarm), np.asarray(twin_alarm)
    return np.asarray((mine > 0) & (twin > 0) & (twin <= mine))


def missed_in_time(first_alarm: ArrayLike, crossing: ArrayLike, time_to_alert: int) -> Mask:
    """(R',) of the runs that cross the alert limit: no alarm up to the time to alert after. Epochs
    (R,) of the first alarm, and of the first error above the limit, 0 for none."""
    mine, at = np.asarray(first_alarm), np.asarray(crossing)
    crossed = at > 0
    return np.asarray((mine[crossed] == 0) | (mine[crossed] > at[crossed] + time_to_alert))


class Survival(NamedTuple):
    """Share of the runs in which an attack is still undetected, by time (`kaplan1958`).

    - `time_s` (T,) after the onset, `at_risk` (T,) runs that are still observed then;
    - `share`, `low`, `high` (T,) with its 95 % interval.
    """

    time_s: FloatArray
    at_risk: NDArray[np.int64]
    share: FloatArray
    low: FloatArray
    high: FloatArray


def survival(delay_s: ArrayLike, detected: ArrayLike, times_s: ArrayLike) -> Survival:
    """Kaplan-Meier estimate, in which alarms by chance and missed runs are censored. `delay_s` (R,)
    from the onset to the alarm, or to where the run was observed last; `detected` (R,) bool,
    whether that is an alarm that the attack raised; `times_s` (T,) at which it is evaluated."""
    t, seen = np.asarray(delay_s, dtype=np.float64), np.asarray(detected, dtype=np.bool_)
    times = np.asarray(times_s, dtype=np.float64)
    at_risk = (t[None, :] >= times[:, None]).sum(axis=1)
    if not seen.any():
        # nothing to estimate a variance from: the share at the horizon, 1, by Wilson's interval
        interval = stats.binomtest(len(t), len(t)).proportion_ci(CONFIDENCE, method="wilson")
        whole = np.ones(len(times))
        return Survival(times, at_risk, whole, whole * float(interval.low), whole)
    found = stats.ecdf(stats.CensoredData(uncensored=t[seen], right=t[~seen])).sf
    # where all are detected, the formula has no bounds; the share stands for them below
    with np.errstate(divide="ignore", invalid="ignore"), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The confidence interval is undefined", RuntimeWarning)
        bounds = found.confidence_interval(CONFIDENCE, method="log-log")
    share = found.evaluate(times)
    low, high = bounds.low.evaluate(times), bounds.high.evaluate(times)
    low = np.where(np.isfinite(low), low, share)
    high = np.where(np.isfinite(high), high, share)
    return Survival(times, at_risk, share, low, high)
