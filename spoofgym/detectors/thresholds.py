"""Thresholds and weights that several detectors share."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

from .._jit import inlined

FloatArray = NDArray[np.float64]


def check_probability(name: str, value: float) -> None:
    """Raise unless a value is a probability between 0 and 1, both excluded."""
    if not 0.0 < value < 1.0:
        raise ValueError(f"`{name}` must lie between 0 and 1, both excluded, got {value}")


def check_epochs(name: str, value: int, most: int = 100_000) -> None:
    """Raise unless a length in epochs is a whole number in range."""
    if not 1 <= value <= most:
        raise ValueError(f"`{name}` must be 1 to {most} epochs, got {value}")
    if isinstance(value, bool) or int(value) != value:
        raise ValueError(f"`{name}` must be a whole number of epochs, got {value}")


def epochs_to_settle(smoothing: float) -> int:
    """Epochs until what an exponential average began with has fallen to a hundredth."""
    return 1 if smoothing >= 1.0 else math.ceil(math.log(0.01) / math.log(1.0 - smoothing))


def run_length(drift: float, threshold: float) -> float:
    r"""Mean number of epochs until a cumulative sum exceeds its threshold where nothing changes.

    .. math:: L = \frac{e^{2 \kappa b} - 2 \kappa b - 1}{2 \kappa^2}, \qquad b = h + 1.166

    `drift`, `threshold`: kappa, above 0, and h, of standard normal samples.

    Notes
    -----
    `siegmund1985`, by a Brownian motion whose limit is moved by the mean overshoot.
    """
    exponent = 2.0 * drift * (threshold + 1.166)
    return (math.exp(exponent) - exponent - 1.0) / (2.0 * drift * drift)


def two_sided_quantile(false_alarm: float) -> float:
    """Quantile that a standard normal deviate exceeds in size with a given probability.
    `false_alarm`: probability, in (0, 1)."""
    return float(-special.ndtri(0.5 * false_alarm))


def chi2_thresholds(false_alarm: float, most: int) -> FloatArray:
    """Chi-square thresholds by degrees of freedom. `false_alarm`: probability of exceeding it, in
    (0, 1); returns (most + 1,) threshold for 0 to `most` degrees; with 0 there is nothing to exceed
    it, and the entry is that of one degree, so that it stays finite."""
    return np.asarray(special.chdtri(np.maximum(np.arange(most + 1), 1), false_alarm))


def chi2_lower_thresholds(false_alarm: float, degrees: FloatArray) -> FloatArray:
    """Value below which chi-square falls with a given probability, by degrees of freedom.
    `false_alarm`: in (0, 1); `degrees`: any shape; below 1 as 1, so that it stays above 0."""
    return np.asarray(2.0 * special.gammaincinv(0.5 * np.maximum(degrees, 1.0), false_alarm))


def outside_ratio(
    statistic: FloatArray, lower: FloatArray, upper: FloatArray, judged: NDArray[np.bool_]
) -> FloatArray:
    r"""How far a statistic lies outside an interval, as a ratio that exceeds 1 there.

    .. math:: \max\left(\frac{q}{T_u}, \frac{T_l}{q}\right)

    All (B,); returns (B, 1), 0 where nothing is `judged`.
    """
    ratio = np.maximum(statistic / upper, lower / np.maximum(statistic, 1e-300))
    return np.asarray(np.where(judged, ratio, 0.0))[:, None]


@inlined
def igg3_weight(size: float, accept: float, reject: float) -> float:
    r"""IGG-III equivalent weight.

    .. math:: w = \begin{cases} 1 & |x| \le k_0 \\
        \frac{k_0}{|x|} \left(\frac{k_1 - |x|}{k_1 - k_0}\right)^2 & k_0 < |x| \le k_1 \\
        0 & |x| > k_1 \end{cases}

    Returns in [0, 1].

    Notes
    -----
    `yang2002` in references.bib.
    """
    if size <= accept:
        return 1.0
    if size > reject:
        return 0.0
    inside = (reject - size) / (reject - accept)
    return accept / size * inside * inside


@inlined
def ewma_threshold(sd: float, decay: float, smoothing: float, quantile: float) -> float:
    r"""Threshold of an EWMA chart after some epochs.

    .. math:: T = z \sigma \sqrt{\tfrac{\lambda}{2 - \lambda} (1 - (1 - \lambda)^{2k})}

    `sd`: standard deviation of the innovation [m]; returns T [m].

    Notes
    -----
    `roberts1959` in references.bib.
    """
    return quantile * sd * math.sqrt(smoothing / (2.0 - smoothing) * (1.0 - decay))
