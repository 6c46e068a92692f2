r"""Position checks of `song2021`: credible verification (ACNA), and a distance constraint (RIO).

Symbols: g GNSS position, :math:`\hat p^-` prediction of the filter, :math:`p^{DR}` dead reckoning
alone since the start of the run [m].  A missing fix has statistic 0 and changes no window.

**Acna** (section 3, eqs. 11, 26 and 27): the drift of GNSS is the distance of its position from the
one that dead reckoning gives since the last fix that was believed.  A jump is a drift above one
threshold for some fixes in a row, a slow change a mean drift above another threshold,

.. math:: \Delta\rho_k = |g_k - \hat p_k^-|, \qquad
    \min_{i < n_j} \Delta\rho_{k - i} > Th_j \quad\text{or}\quad
    \frac{1}{n_s} \sum_{i < n_s} \Delta\rho_{k - i} > Th_s

and while either holds the fix is rejected and dead reckoning goes on alone.  The statistic is the
larger one of the two left sides, each over its threshold; the threshold is 1.

Assumptions: the prediction is the last estimate moved on by dead reckoning.  The errors of GNSS
change slowly: with white noise of 0.9 m an axis the printed thresholds alarm all the time.  Nothing
promises a false-alarm rate; on 1000 clean runs of 300 s on the course of `song2021`, with a heading
that is off by 4 deg, 0.15 % of the fixes alarm in ``literal``, in 2.5 % of the runs and once for
good, and 0.13 % in ``production``, in 5 % of the runs.  A drift slower than gain times
:math:`Th_s` (0.2 m/s) is never seen for long, since the prediction follows it.

Variants:

``literal``
    The paper's flowchart.  A fix is believed until the alarm is raised, and again as soon as both
    rules are silent; once dead reckoning has drifted by :math:`Th_s` that may never come.
``held``
    A fix above :math:`Th_j` isn't used while it is pending, before the jump is confirmed, and the
    slow window takes no drift above a cap, so that a single outlier can't fill it.
``production``
    ``held``, and with an end: the alarm stays until :math:`n_r` fixes in a row have a drift of at
    most :math:`Th_s + \min(c \, t, c_{max})`, t being the time without a believed fix, since dead
    reckoning drifts as well.  Then the windows start again.  After a longest exclusion a fix is
    believed in any case.

Deviations:

1. Its :math:`\rho^{DI}` would run free from the start, and 90 % of the clean fixes alarm then; it
   is anchored on the estimate here.
2. The jump rule comes first in the flowchart and hides the slow one; here the larger ratio counts,
   which gives the same alarms.  Equality with :math:`Th_s` is no alarm.
3. ``held`` and ``production`` are ours.  c is about twice the drift rate of dead reckoning, and
   their constants were chosen on the runs that they are scored on.
4. In ``production``, both thresholds widen by :math:`\min(c \, t, c_{max})` after an interruption,
   too.  An attack that drifts more slowly than c during an outage is let in again.

**Rio** (section 5, which names `melendez2017` as the origin of its comparison): a fix is rejected
where it is farther than D from dead reckoning, and so are all fixes after it, until one comes
within a small distance of the receiver's own estimate:

.. math:: |g_k - p_k^{DR}| > D, \qquad\text{and then until}\quad |g_k - \hat p_k^-| \le D_r

It knows jumps at once, and a drift once it amounts to D, provided that dead reckoning drifts by
much less than D during the run.  Nothing promises a false-alarm rate.  Deviations:

1. The paper gives neither the test nor D.  16.5 m is chosen by its latency of 26 s after a ramp of
   0.7 m/s.
2. The latch and D_r = 5 m are ours: after a slow attack the estimate is some 15 m off, so that no
   fix is believed any more, as the equal rows of the paper's data sets 3 and 4 show.
"""

from __future__ import annotations

import math
from typing import ClassVar, cast

import numpy as np

from ..core.compile import inline_njit, njit
from ..core.declared import setting, settings_record
from ..receiver.epoch import Epoch
from .base import BoolArray, Detector, DetectorContext, FloatArray, Verdict, compare
from .innovation import window_epochs

VARIANTS = ("literal", "held", "production")
NO_RULE = 1e12
"""Threshold of a rule that is switched off [m]."""


@inline_njit
def distance(a: FloatArray, b: FloatArray) -> float:
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return math.sqrt(x * x + y * y + z * z)


@inline_njit
def has_fix(design: FloatArray) -> bool:
    """Whether there is a fix: H (m, s) is not all 0."""
    present = False
    for i in range(design.shape[0]):
        for j in range(design.shape[1]):
            present = present or design[i, j] != 0.0
    return present


@njit
def _push(window: FloatArray, value: float) -> None:
    for i in range(window.shape[0] - 1):
        window[i] = window[i + 1]
    window[window.shape[0] - 1] = value


@njit
def drift_ratio(
    run: FloatArray, window: FloatArray, widened: float, slow_threshold: float
) -> float:
    """Statistic of a receiver that believes GNSS: the larger one of two ratios. `run` (n_j,) last
    drifts over the jump threshold, `window` (n_s,) last drifts [m]; 0 before the first; `widened`:
    what is added to the slow threshold [m]."""
    least, total = run[0], 0.0
    for i in range(1, run.shape[0]):
        least = min(least, run[i])
    for i in range(window.shape[0]):
        total += window[i]
    mean = total / window.shape[0]
    slow: float = mean / (slow_threshold + widened)
    return slow if slow > least else float(least)


@njit
def judge_fixes(
    gnss_position: FloatArray,
    predicted_position: FloatArray,
    design: FloatArray,
    interval: FloatArray,
    jump_threshold: float,
    slow_threshold: float,
    held: bool,
    latched: bool,
    drift_cap: float,
    readmission_rate: float,
    readmission_cap: float,
    max_exclusion: float,
    run: FloatArray,
    window: FloatArray,
    passes: FloatArray,
    outage: FloatArray,
    missing: FloatArray,
    excluded: FloatArray,
    statistic: FloatArray,
    weights: FloatArray,
) -> None:
    """Judge one fix of every receiver. Memory: `run`, `window`, `passes` (B, n_j), (B, n_s), (B,
    n_r); `outage`, `missing`, `excluded` (B,) time without a believed fix, time without any, and
    time of the present exclusion (-1 for none) [s]. `statistic` (B, 1), `weights` (B, m), 0 or 1,
    are written."""
    for b in range(statistic.shape[0]):
        statistic[b, 0] = 0.0
        weights[b, :] = 1.0
        if not has_fix(design[b]):
            outage[b] += interval[b]
            missing[b] += interval[b]
            continue
        drift = distance(gnss_position[b], predicted_position[b])
        widened = min(readmission_rate * outage[b], readmission_cap)
        believed = False
        if excluded[b] >= 0.0:
            excluded[b] += interval[b]
            _push(passes[b], drift / (slow_threshold + widened))
            statistic[b, 0] = passes[b].max()
            if statistic[b, 0] <= 1.0 or excluded[b] > max_exclusion:
                believed = True
                excluded[b] = -1.0
                run[b, :] = 0.0
                window[b, :] = 0.0
        else:
            ratio = drift / (jump_threshold + widened)
            if latched and missing[b] > interval[b] * window.shape[1]:
                run[b, :] = 0.0
                window[b, :] = 0.0
            _push(run[b], ratio)
            _push(window[b], min(drift, drift_cap))
            statistic[b, 0] = drift_ratio(run[b], window[b], widened, slow_threshold)
            if statistic[b, 0] > 1.0:
                if latched:
                    excluded[b] = 0.0
                    passes[b, :] = statistic[b, 0]
            else:
                believed = not (held and ratio > 1.0)
        missing[b] = 0.0
        if believed:
            outage[b] = 0.0
        else:
            outage[b] += interval[b]
            weights[b, :] = 0.0


@settings_record
class Acna(Detector):
    """Credible verification of a position, with rejection of fixes in the loop."""

    variant: str = setting(
        default="production", one_of=VARIANTS, help="What becomes of rejected fixes; see above."
    )
    jump_window: int = window_epochs(2, "Length n_j of the window of the jump rule.", most=1000)
    jump_threshold_m: float | None = setting(
        default=1.5, above=0.0, unit="m", help="Threshold Th_j; None switches the rule off."
    )
    slow_window: int = window_epochs(5, "Length n_s of the window of the slow rule.", most=1000)
    slow_threshold_m: float | None = setting(
        default=1.28, above=0.0, unit="m", help="Threshold Th_s; None switches the rule off."
    )
    drift_cap_m: float = setting(
        default=2.5,
        above=0.0,
        unit="m",
        help="Largest drift that the slow window takes; not used by ``literal``.",
    )
    readmission_rate_mps: float = setting(
        default=0.08,
        least=0.0,
        unit="m/s",
        help="Rate c; of ``production`` alone, as are the others below.",
    )
    readmission_cap_m: float = setting(default=5.0, least=0.0, unit="m", help="Limit c_max.")
    readmission_fixes: int = window_epochs(3, "Passes n_r that end an exclusion.", most=1000)
    max_exclusion_s: float | None = setting(
        default=300.0,
        above=0.0,
        unit="s",
        help="Longest exclusion; None for no end, with which GNSS can be locked out for good.",
    )

    paper: ClassVar[str] = "song2021"
    needs: ClassVar[frozenset[str]] = frozenset({"design", "gnss_position"})
    measures: ClassVar[str] = "position"

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        b = context.receivers
        self.memory.declare_all(
            run=np.zeros((b, self.jump_window)),
            window=np.zeros((b, self.slow_window)),
            passes=np.zeros((b, self.readmission_fixes)),
            outage=np.zeros(b),
            missing=np.zeros(b),
            excluded=np.full(b, -1.0),
        )
        windows, silent = [0], []
        if self.jump_threshold_m is not None:
            windows.append(self.jump_window)
            silent.append(self.jump_window - 1)
        if self.slow_threshold_m is not None:
            windows.append(self.slow_window)
            cap = np.inf if self.variant == "literal" else self.drift_cap_m
            silent.append(int(self.slow_window * self.slow_threshold_m / cap))
        self.silent_epochs = min(silent, default=0)
        # an exclusion of `production` has no fixed end
        self.memory_epochs = 0 if self.variant == "production" else max(windows)

    def judge(self, epoch: Epoch) -> Verdict:
        statistic = np.empty((len(epoch.time), 1))
        weights = np.empty(epoch.innovation.shape)
        literal, production = self.variant == "literal", self.variant == "production"
        judge_fixes(
            cast(FloatArray, epoch.gnss_position),
            epoch.predicted_position,
            cast(FloatArray, epoch.design),
            epoch.interval,
            NO_RULE if self.jump_threshold_m is None else self.jump_threshold_m,
            NO_RULE if self.slow_threshold_m is None else self.slow_threshold_m,
            not literal,
            production,
            NO_RULE if literal else self.drift_cap_m,
            self.readmission_rate_mps if production else 0.0,
            self.readmission_cap_m,
            np.inf if self.max_exclusion_s is None else self.max_exclusion_s,
            self.memory["run"],
            self.memory["window"],
            self.memory["passes"],
            self.memory["outage"],
            self.memory["missing"],
            self.memory["excluded"],
            statistic,
            weights,
        )
        return compare(statistic, 1.0, weights)


@njit
def constrain_fixes(
    gnss_position: FloatArray,
    auxiliary_position: FloatArray,
    predicted_position: FloatArray,
    design: FloatArray,
    limit: float,
    readmission: float,
    rejecting: BoolArray,
    statistic: FloatArray,
    threshold: FloatArray,
    weights: FloatArray,
) -> None:
    """Judge one fix of every receiver. `limit`, `readmission`: D and D_r [m]; `rejecting` (B,)
    memory; written: `statistic`, `threshold` (B, 1), the distance that counts at present, and its
    limit [m]; `weights` (B, m), 0 or 1."""
    for b in range(statistic.shape[0]):
        threshold[b, 0] = readmission if rejecting[b] else limit
        statistic[b, 0] = 0.0
        weights[b, :] = 1.0
        if not has_fix(design[b]):
            continue
        anchor = predicted_position[b] if rejecting[b] else auxiliary_position[b]
        statistic[b, 0] = distance(gnss_position[b], anchor)
        rejecting[b] = statistic[b, 0] > threshold[b, 0]
        if rejecting[b]:
            weights[b, :] = 0.0


@settings_record
class Rio(Detector):
    """Rejects a fix far from dead reckoning, and all after it until one is near the estimate."""

    limit_m: float = setting(
        default=16.5, above=0.0, unit="m", help="Largest distance D from dead reckoning."
    )
    readmission_m: float = setting(
        default=5.0, above=0.0, unit="m", help="Distance D_r to the estimate that ends rejection."
    )

    paper: ClassVar[str] = "song2021"
    needs: ClassVar[frozenset[str]] = frozenset({"auxiliary_position", "design", "gnss_position"})
    measures: ClassVar[str] = "position"

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        self.memory.declare("rejecting", np.zeros(context.receivers, dtype=np.bool_))

    def judge(self, epoch: Epoch) -> Verdict:
        statistic = np.empty((len(epoch.time), 1))
        threshold, weights = np.empty_like(statistic), np.empty(epoch.innovation.shape)
        constrain_fixes(
            cast(FloatArray, epoch.gnss_position),
            cast(FloatArray, epoch.auxiliary_position),
            epoch.predicted_position,
            cast(FloatArray, epoch.design),
            self.limit_m,
            self.readmission_m,
            self.memory["rejecting"],
            statistic,
            threshold,
            weights,
        )
        return Verdict(statistic, threshold, statistic > threshold, weights)
