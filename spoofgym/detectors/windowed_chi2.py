r"""Chi-square test of the innovations of a window of epochs.

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
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy import special

from .._describe import OMITTED
from .._jit import njit
from ..receiver.epoch import Epoch
from ..receiver.nis import normalized_innovation_squared
from .base import Detector, DetectorContext, Verdict
from .innovation_test import check_signals
from .thresholds import (
    check_epochs,
    check_probability,
    chi2_lower_thresholds,
    chi2_thresholds,
    outside_ratio,
)

FloatArray = NDArray[np.float64]
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
