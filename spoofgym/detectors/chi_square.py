r"""Snapshot, windowed and sequential chi-square tests.

Snapshot chi-square test of the innovation.

The innovations of one epoch, normalized by the covariance that the filter believes in, are
chi-square distributed when nothing is wrong:

.. math:: q_k = z_k^T S_k^{-1} z_k \sim \chi^2(d)

with one degree of freedom for every visible row.  The test knows only the present epoch, so that a
slow drift to which the filter gets used passes; and its false-alarm rate is the stated one only
where the belief S is right, which the receiver of the papers' tables is far from.

Source: `barshalom2001`, section 5.4, in references.bib.

Chi-square test of the innovations of a window of epochs.

The normalized innovations of the last epochs are summed up, and compared with chi-square of as many
degrees of freedom as were measured in them,

.. math:: q_k = \sum_{i=k-N+1}^{k} z_i^T S_i^{-1} z_i \sim \chi^2\left(\sum_i d_i\right)

so that an offset too small for any one epoch adds up.  A window that is not full yet gives no
verdict: statistic 0, no alarm; so does one that is longer than the run, for ever.

Where S is itself estimated from a window of w epochs (``covariance="estimated"``), as a
self-tuning receiver does, the sum has heavier tails.  With the covariance of w white innovations
of p coordinates, :math:`w^{-1} q` is Hotelling's generalized :math:`T_0^2`, and

.. math:: T = w K F^{-1}(1 - \alpha; pN, D), \quad
    K = \frac{pN}{w - p - 1} \frac{D - 2}{D}, \quad
    D = 4 + \frac{pN + 2}{B - 1}, \quad
    B = \frac{(w + N - p - 1)(w - 1)}{(w - p - 3)(w - p)}

matches its first two moments.  With N = 1 this is exact, the F distribution of Hotelling's
:math:`T^2`, :math:`T = \frac{p w}{w - p + 1} F^{-1}(1 - \alpha; p, w - p + 1)`: for p = 3, a false
alarm in 1e5 epochs and w = 20, 30, 50, 100 it is 61.5, 44.5, 35.3 and 30.1 instead of 25.9.

Symbols: z innovation, S its covariance, d rows measured in an epoch, N epochs of the window, w
epochs of the covariance's, p coordinates of an epoch, :math:`\alpha` false-alarm probability of one
epoch.

Assumptions: innovations are white and of the covariance that the filter believes in; with an
estimated covariance, that is the mean of w outer products, independent of the innovation tested.
Correlated errors of GNSS break the first, and a self-tuning filter the second somewhat: a measured
false-alarm rate is then above the stated one.

Deviations from `shadmehri2025`, whose detector this is:

1. The paper compares the mean over N epochs with chi-square of 3 degrees of freedom, and states
   3 (N + 1): neither is right but for N = 1.  Here it is the sum, with 3 N.
2. The paper has no threshold for an estimated covariance.
3. No verdict before the window is full, and with an estimated covariance before N epochs were
   judged with one of a full window.

Source: `shadmehri2025`, eqs. 14 to 16; the distributions are from `hotelling1931` and `mckeon1974`.

Sequential innovation test: chi-square of all innovations so far, or of a window of them.

The normalized innovations squared of many epochs are added up, and so are their degrees of freedom,

.. math:: q_k = \sum_i z_i^T S_i^{-1} z_i \sim \chi^2\Big(\sum_i d_i\Big)

where i runs over all epochs so far, or over the last ones.  Innovations of a filter whose belief is
right are white, so that the sum has this distribution at every epoch.  The longer the sum, the less
a short attack shows in it: the test that takes all history goes blind with time.

Symbols: z innovation, S innovation covariance, d rows that take part, :math:`\alpha` false-alarm
probability of one epoch.

Assumptions: innovations are white, normal and of the covariance that the filter believes in.

Alarms of neighbouring epochs are those of nearly the same sum, so that a run has fewer but longer
alarms than an independent test of the same :math:`\alpha`.

Source: `mehra1971`; as a baseline against spoofing `zhong2025`, section 2.3.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy import special

from ..core.compile import njit
from ..core.settings import OMITTED
from ..receiver.epoch import Epoch
from ..receiver.kalman import normalized_innovation_squared
from .base import Detector, DetectorContext, Verdict
from .innovation import (
    FloatArray,
    InnovationTest,
    check_epochs,
    check_probability,
    check_signals,
    chi2_lower_thresholds,
    chi2_thresholds,
    epochs_of,
    outside_ratio,
    remember_squares,
)


@dataclass
class SnapshotChi2(InnovationTest):
    """Chi-square test of the present epoch, for the whole receiver; monitor only.

    Parameters
    ----------
    false_alarm : float
        Probability of an alarm in one epoch where the filter's belief is right, in (0, 1).
    signals : {"both", "pseudorange", "range_rate"}
        Innovations to test.
    bias_window_s : float
        Length of the first window whose mean innovation is taken away from every channel, which is
        not judged before; 0 for none.
    two_sided : bool
        Whether innovations that are too small alarm, too, each side with half of `false_alarm`: a
        counterfeit signal may have less noise than nature.  The statistic is then the ratio to the
        limit that is nearer, and the threshold 1.
    """

    described_as = "SnapshotChi2"
    false_alarm: float = 1e-5
    signals: str = "both"
    bias_window_s: float = 0.0
    two_sided: bool = field(default=False, metadata=OMITTED)

    paper: ClassVar[str] = "barshalom2001"
    needs: ClassVar[frozenset[str]] = frozenset({"innovation_cov"})

    def bind(self, context: DetectorContext) -> None:
        """Prepare the thresholds for every number of visible satellites."""
        super().bind(context)
        each = self._per_satellite
        each_side = 0.5 * self.false_alarm if self.two_sided else self.false_alarm
        self._thresholds = chi2_thresholds(each_side, each * context.channels)[::each]
        degrees = each * np.arange(context.channels + 1.0)
        self._lower = chi2_lower_thresholds(each_side, degrees)

    def judge(self, epoch: Epoch) -> Verdict:
        """Test one epoch: (B, 1) statistic, threshold and alarm; no weights."""
        innovation, judged = self._without_bias(epoch)
        belief = cast(FloatArray, epoch.innovation_cov)
        if self._bias_window > 0:
            rows = np.hstack([judged, judged])
            belief = np.where(rows[:, :, None] & rows[:, None, :], belief, np.eye(rows.shape[1]))
        statistic = normalized_innovation_squared(innovation, belief, *self._rows)[:, None]
        seen = judged.sum(axis=1)
        if self.two_sided:
            limits = self._lower[seen], self._thresholds[seen]
            statistic = outside_ratio(statistic[:, 0], *limits, seen > 0)
            return Verdict(statistic, np.ones_like(statistic), statistic > 1.0)
        threshold = self._thresholds[seen][:, None]
        return Verdict(statistic, threshold, statistic > threshold)


COVARIANCES = ("known", "estimated")


def estimated_covariance_thresholds(
    false_alarm: float, window: int, covariance_window: int, rows: FloatArray
) -> FloatArray:
    """Thresholds of the sum where the covariance is the mean of a window's outer products.
    `false_alarm`: alpha, in (0, 1); `covariance_window`: w, epochs of the covariance; at least 4
    more than an epoch has rows. McKeon (1974); for N = 1 Hotelling (1931)."""
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
    rows: NDArray[np.int64],
    hold: int,
    past: FloatArray,
    past_rows: NDArray[np.int64],
    seen: NDArray[np.int64],
    total: FloatArray,
    degrees: NDArray[np.int64],
) -> None:
    """Put an epoch into the windows, and sum them up where they are full. `nis`, `rows` (B,) of the
    epoch: normalized innovation squared, and rows measured; `past`, `past_rows` (B, N) memory,
    overwritten; `seen` (B,) memory, overwritten: epochs so far; `total` (B,), written: the sum, 0
    where there is no verdict yet; `degrees` (B,), written: degrees of freedom in the window."""
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


@dataclass
class WindowedChi2(Detector):
    """Chi-square test of a window of epochs, for the whole receiver; monitor only.

    Parameters
    ----------
    window : int
        N, epochs of the sum, 1 to 100000.
    false_alarm : float
        Probability of an alarm in one epoch where the filter's belief is right, in (0, 1).
    signals : {"both", "pseudorange", "range_rate"}
        Innovations to test, of a receiver that measures ranges.
    covariance : {"known", "estimated"}
        Whether the innovation covariance is known or the mean of a window of epochs.
    covariance_window : int
        w, that window of a self-tuning receiver; only with ``covariance="estimated"``.
    two_sided : bool
        Whether innovations that are too small alarm, too, each side with half of `false_alarm`: a
        counterfeit signal may have less noise than nature.  It takes a known covariance.  The
        statistic is then the ratio to the limit that is nearer, and the threshold 1.
    """

    described_as = "WindowedChi2"
    window: int = 10
    false_alarm: float = 1e-5
    signals: str = "both"
    covariance: str = "known"
    covariance_window: int = 100
    two_sided: bool = field(default=False, metadata=OMITTED)

    paper: ClassVar[str] = "shadmehri2025"
    needs: ClassVar[frozenset[str]] = frozenset({"design", "innovation_cov"})
    measures: ClassVar[str] = "any"

    def __post_init__(self) -> None:
        check_probability("false_alarm", self.false_alarm)
        for name in ("window", "covariance_window"):
            check_epochs(name, getattr(self, name))
        check_signals(self.signals)
        if self.covariance not in COVARIANCES:
            raise ValueError(
                f"`covariance` must be one of {', '.join(map(repr, COVARIANCES))}, "
                f"got {self.covariance!r}"
            )
        if self.two_sided and self.covariance != "known":
            raise ValueError(
                f"`two_sided` takes a known covariance, got `covariance` {self.covariance!r}"
            )

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        n, m = context.channels, len(context.noise_variance)
        if n == 0 and self.signals != "both":
            raise ValueError(
                f"`signals` must be 'both' for a receiver that measures a position, got "
                f"{self.signals!r}"
            )
        self._rows = {"pseudorange": (0, n), "range_rate": (n, 2 * n), "both": (0, m)}[self.signals]
        self._per_satellite = 2 if self.signals == "both" else 1
        most = self._rows[1] - self._rows[0]
        self._hold = self.window - 1
        if self.covariance == "known":
            each_side = 0.5 * self.false_alarm if self.two_sided else self.false_alarm
            self._thresholds = chi2_thresholds(each_side, most * self.window)
            self._lower = chi2_lower_thresholds(each_side, np.arange(most * self.window + 1.0))
        else:
            if self.covariance_window < most + 4:
                raise ValueError(
                    f"`covariance_window` must be at least {most + 4} for {most} rows, got "
                    f"{self.covariance_window}"
                )
            self._hold += self.covariance_window
            rows = np.maximum(np.arange(most * self.window + 1), 1).astype(np.float64)
            self._thresholds = estimated_covariance_thresholds(
                self.false_alarm, self.window, self.covariance_window, rows
            )
        self.silent_epochs = self._hold
        self.memory_epochs = self._hold + 1
        self.memory.declare("past", np.zeros((context.receivers, self.window)))
        self.memory.declare("past_rows", np.zeros((context.receivers, self.window), dtype=np.int64))
        self.memory.declare("seen", np.zeros(context.receivers, dtype=np.int64))

    def judge(self, epoch: Epoch) -> Verdict:
        """Test one epoch. Returns (B, 1) statistic, threshold and alarm; no weights. While there is
        no verdict yet, the statistic is 0."""
        belief = cast(FloatArray, epoch.innovation_cov)
        nis = normalized_innovation_squared(epoch.innovation, belief, *self._rows)
        if epoch.visible.shape[1]:
            rows = self._per_satellite * epoch.visible.sum(axis=1)
        else:
            design = cast(FloatArray, epoch.design)
            rows = (design != 0.0).any(axis=2).sum(axis=1)  # none where the fix is missing
        total, degrees = np.empty(len(nis)), np.empty(len(nis), dtype=np.int64)
        window_sum(
            nis,
            rows.astype(np.int64),
            self._hold,
            self.memory["past"],
            self.memory["past_rows"],
            self.memory["seen"],
            total,
            degrees,
        )
        if self.two_sided:
            full = (self.memory["seen"] > self._hold) & (degrees > 0)
            ratio = outside_ratio(total, self._lower[degrees], self._thresholds[degrees], full)
            return Verdict(ratio, np.ones_like(ratio), ratio > 1.0)
        threshold = self._thresholds[degrees]
        return Verdict(total[:, None], threshold[:, None], (total > threshold)[:, None])


@njit
def add_to_sums(
    white: FloatArray, judged: NDArray[np.bool_], each: int, total: FloatArray, degrees: FloatArray
) -> None:
    """Add the squares of an epoch to the sums of all history. `white` (B, r) whitened innovations;
    `judged` (B, n) bool; `total`, `degrees` (B,) memory, overwritten: sum of squares, and degrees
    of freedom."""
    for b in range(white.shape[0]):
        for r in range(white.shape[1]):
            total[b] += white[b, r] * white[b, r]
        for j in range(judged.shape[1]):
            if judged[b, j]:
                degrees[b] += each


@njit
def add_to_window(
    white: FloatArray,
    judged: NDArray[np.bool_],
    each: int,
    squares: FloatArray,
    counts: FloatArray,
    place: NDArray[np.int64],
    total: FloatArray,
    degrees: FloatArray,
) -> None:
    """Add the squares of an epoch to a window, and sum the window up. `white` (B, r) whitened
    innovations; `judged` (B, n) bool; `squares`, `counts` (B, W), `place` (B,) memory of
    `remember_squares`; `total`, `degrees` (B,) written: sums over the window."""
    remember_squares(white, judged, each, squares, counts, place)
    for b in range(white.shape[0]):
        total[b] = degrees[b] = 0.0
        for i in range(squares.shape[1]):
            total[b] += squares[b, i]
            degrees[b] += counts[b, i]


@dataclass
class SequentialChi2(InnovationTest):
    """Chi-square of all innovations so far, or of a window, for the whole receiver.

    Parameters
    ----------
    false_alarm : float
        Probability of an alarm in one epoch where the filter's belief is right, in (0, 1).
    window_s : float or None
        Length of the window; None for all history.  While a run is younger than its window the
        test takes what there is.
    signals : {"pseudorange", "range_rate", "both"}
        Innovations to test.
    bias_window_s : float
        Length of the first window whose mean innovation is taken away from every channel, which is
        not judged before; 0 for none.
    two_sided : bool
        Whether innovations that are too small alarm, too, each side with half of `false_alarm`: a
        counterfeit signal may have less noise than nature.  The statistic is then the ratio to the
        limit that is nearer, and the threshold 1.
    """

    described_as = "SequentialChi2"
    false_alarm: float = 1e-5
    window_s: float | None = None
    signals: str = "pseudorange"
    bias_window_s: float = 0.0
    two_sided: bool = field(default=False, metadata=OMITTED)

    paper: ClassVar[str] = "mehra1971"
    needs: ClassVar[frozenset[str]] = frozenset({"innovation_cov"})

    def __post_init__(self) -> None:
        if self.window_s is not None and not (np.isfinite(self.window_s) and self.window_s > 0.0):
            raise ValueError(f"`window_s` must be finite and > 0, or None, got {self.window_s}")
        super().__post_init__()

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        b = context.receivers
        if self.window_s is None:
            self.memory.declare("total", np.zeros(b))
            self.memory.declare("degrees", np.zeros(b))
        else:
            window = epochs_of(self.window_s, context)
            self.memory_epochs = self._bias_window + window
            self.memory.declare("squares", np.zeros((b, window)))
            self.memory.declare("counts", np.zeros((b, window)))
            self.memory.declare("place", np.zeros(b, dtype=np.int64))

    def judge(self, epoch: Epoch) -> Verdict:
        """Test one epoch: (B, 1) statistic, threshold and alarm; no weights."""
        white, judged = self._whitened(epoch)
        statistic, degrees = self._sums(white, judged)
        if self.two_sided:
            each_side, some = 0.5 * self.false_alarm, np.maximum(degrees, 1.0)
            limits = chi2_lower_thresholds(each_side, some), special.chdtri(some, each_side)
            ratio = outside_ratio(statistic, *limits, degrees > 0.0)
            return Verdict(ratio, np.ones_like(ratio), ratio > 1.0)
        threshold = special.chdtri(np.maximum(degrees, 1.0), self.false_alarm)[:, None]
        return Verdict(statistic[:, None], threshold, statistic[:, None] > threshold)

    def _sums(self, white: FloatArray, judged: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
        """Sum of squares and degrees of freedom, with the present epoch."""
        memory, each = self.memory, self._per_satellite
        if self.window_s is None:
            add_to_sums(white, judged, each, memory["total"], memory["degrees"])
            return memory["total"].copy(), memory["degrees"].copy()
        total, degrees = np.empty(len(white)), np.empty(len(white))
        ring = (memory["squares"], memory["counts"], memory["place"])
        add_to_window(white, judged, each, *ring, total, degrees)
        return total, degrees
