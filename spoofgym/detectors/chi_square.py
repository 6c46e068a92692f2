r"""Chi-square tests of the innovations of one epoch, of a window, and of all epochs so far.

The innovations of an epoch, normalized by the covariance that the filter believes in, are
chi-square distributed when nothing is wrong, and so is their sum over epochs,

.. math:: q_k = \sum_i z_i^T S_i^{-1} z_i \sim \chi^2\Big(\sum_i d_i\Big)

Symbols: z innovation, S its covariance, d rows measured in an epoch, N epochs of a window,
:math:`\alpha` false-alarm probability of one epoch.

Assumptions: innovations are white, normal and of covariance S.  Correlated errors of GNSS, and a
filter that doesn't believe in the noise that there is, change the rate of false alarms.

**Snapshot** (`barshalom2001`, section 5.4): i is the present epoch alone, so that a slow drift to
which the filter gets used passes.

**Window** (`shadmehri2025`, eqs. 14 to 16): i runs over the last N epochs, so that an offset too
small for any one epoch adds up.  A window that is not full yet gives no verdict: statistic 0.

Where S is itself estimated from a window of w epochs (``covariance="estimated"``), as a
self-tuning receiver does, the sum has heavier tails.  With the covariance of w white innovations
of p coordinates, independent of the one tested, :math:`w^{-1} q` is Hotelling's generalized
:math:`T_0^2` (`hotelling1931`), and by `mckeon1974`

.. math:: T = w K F^{-1}(1 - \alpha; pN, D), \quad
    K = \frac{pN}{w - p - 1} \frac{D - 2}{D}, \quad
    D = 4 + \frac{pN + 2}{B - 1}, \quad
    B = \frac{(w + N - p - 1)(w - 1)}{(w - p - 3)(w - p)}

matches its first two moments.  With N = 1 it is exact: for p = 3, a false alarm in 1e5 epochs and
w = 20, 30, 50, 100 the threshold is 61.5, 44.5, 35.3 and 30.1 instead of 25.9.

Deviations from `shadmehri2025`:

1. The paper compares the mean over N epochs with chi-square of 3 degrees of freedom, and states
   3 (N + 1): neither is right but for N = 1.  Here it is the sum, with 3 N.
2. The paper has no threshold for an estimated covariance.
3. No verdict before the window is full, and with an estimated covariance before N epochs were
   judged with one of a full window.

**Sequential** (`mehra1971`; against spoofing `zhong2025`, section 2.3): i runs over all epochs so
far, or over a window that takes what there is.  The longer the sum, the less a short attack shows
in it: the test that takes all history goes blind with time.  Alarms of neighbouring epochs are
those of nearly the same sum, so that a run has fewer but longer alarms than an independent test of
the same :math:`\alpha`.
"""

from __future__ import annotations

from typing import ClassVar, cast

import numpy as np
from scipy import special

from ..core.compile import njit
from ..core.declared import setting, settings_record
from ..receiver.epoch import Epoch
from ..receiver.kalman import normalized_innovation_squared
from .base import BoolArray, DetectorContext, FloatArray, IntArray, Verdict, compare
from .innovation import (
    InnovationTest,
    alarm_probability,
    both_sides,
    chi2_lower_thresholds,
    chi2_thresholds,
    count_epochs,
    first_window,
    remember_squares,
    signals_to_test,
    window_epochs,
)
from .own_filter import filter_to_test


def chi2_verdict(
    statistic: FloatArray, upper: FloatArray, lower: FloatArray | None, judged: BoolArray
) -> Verdict:
    r"""Verdict on chi-squares (B,).

    With a lower limit the statistic is :math:`\max(q / T_u, T_l / q)`, 0 where nothing is judged.
    """
    if lower is None:
        return compare(statistic[:, None], upper[:, None])
    ratio = np.maximum(statistic / upper, lower / np.maximum(statistic, 1e-300))
    return compare(np.where(judged, ratio, 0.0)[:, None], 1.0)


@settings_record
class SnapshotChi2(InnovationTest):
    """Chi-square test of the present epoch, for the whole receiver; monitor only."""

    false_alarm: float = alarm_probability()
    signals: str = signals_to_test("both")
    bias_window_s: float = first_window()
    two_sided: bool = both_sides()
    filter: str = filter_to_test()

    paper: ClassVar[str] = "barshalom2001"
    needs: ClassVar[frozenset[str]] = frozenset({"innovation_cov"})

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        each, n = self._per_satellite, context.channels
        each_side = 0.5 * self.false_alarm if self.two_sided else self.false_alarm
        self._thresholds = chi2_thresholds(each_side, each * n)[::each]
        self._lower = chi2_lower_thresholds(each_side, each * np.arange(n + 1.0))

    def judge(self, epoch: Epoch) -> Verdict:
        epoch = self.filter_epoch(epoch)
        innovation, judged = self._without_bias(epoch)
        belief = cast(FloatArray, epoch.innovation_cov)
        if self._bias_window > 0:
            rows = np.hstack([judged, judged])
            belief = np.where(rows[:, :, None] & rows[:, None, :], belief, np.eye(rows.shape[1]))
        statistic = normalized_innovation_squared(innovation, belief, *self._rows)
        seen = judged.sum(axis=1)
        lower = self._lower[seen] if self.two_sided else None
        return chi2_verdict(statistic, self._thresholds[seen], lower, seen > 0)


def estimated_covariance_thresholds(
    false_alarm: float, window: int, covariance_window: int, rows: FloatArray
) -> FloatArray:
    """Thresholds of the sum where the covariance is the mean of the outer products of a window of w
    epochs, at least 4 more than an epoch has rows. `rows`: degrees of freedom of the sum."""
    n, w = float(window), float(covariance_window)
    p = rows / n
    b = (w + n - p - 1.0) * (w - 1.0) / ((w - p - 3.0) * (w - p))
    d = 4.0 + (rows + 2.0) / (b - 1.0)
    k = rows / (w - p - 1.0) * (d - 2.0) / d
    # the quantile of F by that of the beta distribution, complemented: 1 - alpha loses digits
    x = special.betaincinv(0.5 * d, 0.5 * rows, false_alarm)
    return np.asarray(w * k * d * (1.0 - x) / (rows * x))


@njit
def window_sum(
    nis: FloatArray,
    rows: IntArray,
    hold: int,
    past: FloatArray,
    past_rows: IntArray,
    seen: IntArray,
    total: FloatArray,
    degrees: IntArray,
) -> None:
    """Put an epoch into the windows, and sum them up where they are full. `nis`, `rows` (B,)
    normalized innovation squared of the epoch, and rows measured; `past`, `past_rows` (B, N) and
    `seen` (B,) memory, `seen`: epochs so far; `total`, `degrees` (B,) written: the sum, 0 where
    there is no verdict yet, and its degrees of freedom."""
    length = past.shape[1]
    for b in range(nis.shape[0]):
        slot = seen[b] % length
        past[b, slot] = nis[b]
        past_rows[b, slot] = rows[b]
        seen[b] += 1
        value, count = 0.0, 0
        for i in range(length):
            value += past[b, i]
            count += past_rows[b, i]
        degrees[b] = count
        total[b] = value if seen[b] > hold else 0.0


@settings_record
class WindowedChi2(InnovationTest):
    """Chi-square test of a window of epochs, for the whole receiver; monitor only."""

    window: int = window_epochs(10, "N: length of the sum.")
    false_alarm: float = alarm_probability()
    signals: str = signals_to_test(
        "both", "Innovations to test, of a receiver that measures ranges."
    )
    covariance: str = setting(
        default="known",
        one_of=("known", "estimated"),
        help="Whether the innovation covariance is known or the mean of a window of epochs.",
    )
    covariance_window: int = window_epochs(
        100, 'Window w of a self-tuning receiver; only with ``covariance="estimated"``.'
    )
    two_sided: bool = both_sides("  It takes a known covariance.")
    filter: str = filter_to_test()

    paper: ClassVar[str] = "shadmehri2025"
    needs: ClassVar[frozenset[str]] = frozenset({"design", "innovation_cov"})
    measures: ClassVar[str] = "any"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.two_sided and self.covariance != "known":
            raise ValueError(
                f"`two_sided` takes a known covariance, got `covariance` {self.covariance!r}"
            )

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        b, m = context.receivers, len(context.noise_variance)
        if context.channels == 0:
            if self.signals != "both":
                raise ValueError(
                    f"`signals` must be 'both' for a receiver that measures a position, got "
                    f"{self.signals!r}"
                )
            self._rows = (0, m)
        most = self._rows[1] - self._rows[0]
        degrees = np.arange(most * self.window + 1)
        hold = self.window - 1
        if self.covariance == "known":
            each_side = 0.5 * self.false_alarm if self.two_sided else self.false_alarm
            self._thresholds = chi2_thresholds(each_side, most * self.window)
            self._lower = chi2_lower_thresholds(each_side, degrees.astype(np.float64))
        else:
            if self.covariance_window < most + 4:
                raise ValueError(
                    f"`covariance_window` must be at least {most + 4} for {most} innovations, "
                    f"got {self.covariance_window}"
                )
            hold += self.covariance_window
            self._thresholds = estimated_covariance_thresholds(
                self.false_alarm,
                self.window,
                self.covariance_window,
                np.maximum(degrees, 1).astype(np.float64),
            )
        self.silent_epochs, self.memory_epochs = hold, hold + 1
        self.memory.declare_all(
            past=np.zeros((b, self.window)),
            past_rows=np.zeros((b, self.window), dtype=np.int64),
            seen=np.zeros(b, dtype=np.int64),
        )

    def judge(self, epoch: Epoch) -> Verdict:
        epoch = self.filter_epoch(epoch)
        belief = cast(FloatArray, epoch.innovation_cov)
        nis = normalized_innovation_squared(epoch.innovation, belief, *self._rows)
        if epoch.visible.shape[1]:
            rows = self._per_satellite * epoch.visible.sum(axis=1)
        else:
            design = cast(FloatArray, epoch.design)
            rows = (design != 0.0).any(axis=2).sum(axis=1)  # none where the fix is missing
        total, degrees = np.empty(len(nis)), np.empty(len(nis), dtype=np.int64)
        past, past_rows, seen = (self.memory[name] for name in ("past", "past_rows", "seen"))
        hold = self.silent_epochs
        window_sum(nis, rows.astype(np.int64), hold, past, past_rows, seen, total, degrees)
        lower = self._lower[degrees] if self.two_sided else None
        full = (seen > hold) & (degrees > 0)
        return chi2_verdict(total, self._thresholds[degrees], lower, full)


@njit
def add_to_sums(
    white: FloatArray, judged: BoolArray, each: int, total: FloatArray, degrees: FloatArray
) -> None:
    """Add the squares of an epoch, `white` (B, r), to the sums of all history. `total`, `degrees`
    (B,) memory: sum of squares, and degrees of freedom."""
    for b in range(white.shape[0]):
        for r in range(white.shape[1]):
            total[b] += white[b, r] * white[b, r]
        for j in range(judged.shape[1]):
            if judged[b, j]:
                degrees[b] += each


@njit
def add_to_window(
    white: FloatArray,
    judged: BoolArray,
    each: int,
    squares: FloatArray,
    counts: FloatArray,
    place: IntArray,
    total: FloatArray,
    degrees: FloatArray,
) -> None:
    """Add the squares of an epoch to a window, with the memory of `remember_squares`, and write its
    sums to `total`, `degrees` (B,)."""
    remember_squares(white, judged, each, squares, counts, place)
    for b in range(white.shape[0]):
        total[b] = degrees[b] = 0.0
        for i in range(squares.shape[1]):
            total[b] += squares[b, i]
            degrees[b] += counts[b, i]


@settings_record
class SequentialChi2(InnovationTest):
    """Chi-square of all innovations so far, or of a window, for the whole receiver."""

    false_alarm: float = alarm_probability()
    window_s: float | None = setting(
        default=None,
        above=0.0,
        unit="s",
        help="Length of the window; None for all history.  While a run is younger than its "
        "window the test takes what there is.",
    )
    signals: str = signals_to_test("pseudorange")
    bias_window_s: float = first_window()
    two_sided: bool = both_sides()
    filter: str = filter_to_test()

    paper: ClassVar[str] = "mehra1971"
    needs: ClassVar[frozenset[str]] = frozenset({"innovation_cov"})

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        b = context.receivers
        if self.window_s is None:
            self.memory.declare_all(total=np.zeros(b), degrees=np.zeros(b))
        else:
            window = count_epochs(self.window_s, context)
            self.memory_epochs = self._bias_window + window
            self._declare_squares(b, window)
        self._each_side = 0.5 * self.false_alarm if self.two_sided else self.false_alarm
        self._thresholds = chi2_thresholds(self._each_side, 0)

    def _thresholds_at(self, degrees: FloatArray) -> FloatArray:
        """Thresholds (B,) by degrees of freedom, which are whole, from a table that grows."""
        most = int(degrees.max())
        if most >= len(self._thresholds):
            self._thresholds = chi2_thresholds(self._each_side, 2 * most)
        return self._thresholds[degrees.astype(np.intp)]

    def judge(self, epoch: Epoch) -> Verdict:
        white, judged = self._whiten_rows(epoch)
        each = self._per_satellite
        if self.window_s is None:
            total, degrees = self.memory["total"], self.memory["degrees"]
            add_to_sums(white, judged, each, total, degrees)
        else:
            total, degrees = np.empty(len(white)), np.empty(len(white))
            add_to_window(white, judged, each, *self._squares, total, degrees)
        lower = chi2_lower_thresholds(self._each_side, degrees) if self.two_sided else None
        return chi2_verdict(total.copy(), self._thresholds_at(degrees), lower, degrees > 0.0)
