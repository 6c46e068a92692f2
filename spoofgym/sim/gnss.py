"""GNSS measurement errors: what stays with a satellite, what wanders slowly, and white noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from .clock import TCXO, ReceiverClock


@dataclass(frozen=True, kw_only=True)
class GnssErrors:
    r"""Errors of pseudoranges and range rates.

    Each satellite has one constant bias a run, of variance

    .. math:: \sigma_{SIS}^2 + \frac{\sigma_{iono}^2}{1 - 0.899 \cos^2 E}
        + \frac{\sigma_{tropo}^2}{1 - 0.998 \cos^2 E}

    at elevation E, an error of the code that wanders (first-order Gauss-Markov, stationary from the
    first epoch, independent of the other satellites), and white noise at every epoch.

    What wanders in the code is multipath and delay, to which the carrier is nearly immune.  A
    receiver takes range rates from the carrier, so that the derivative of the code error, which
    would not even be finite, is no part of them: their error is white noise of its own.

    - `code_sd_m`, `range_rate_sd_mps`: white noise of pseudoranges and range rates;
    - `correlated_sd_m`: wandering part of the pseudoranges; 0 for none;
    - `correlation_s`: time in which its correlation falls to 1/e, above 0.

    Notes
    -----
    Groves (2013), section 9.3, as its software simulates it.
    """

    code_sd_m: float
    range_rate_sd_mps: float
    signal_in_space_sd_m: float
    zenith_iono_sd_m: float
    zenith_tropo_sd_m: float
    correlated_sd_m: float = 0.0
    correlation_s: float = 35.0
    clock: ReceiverClock = field(default_factory=ReceiverClock)

    def __post_init__(self) -> None:
        """Check that the standard deviations are finite and not negative."""
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name != "clock" and not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"`{item.name}` must be finite and >= 0, got {value}")
        if self.correlation_s == 0.0:
            raise ValueError("`correlation_s` must be finite and > 0, got 0")

    def bias_sd(self, elevation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Standard deviation of the constant biases.

        `elevation`: elevation of the satellites, any shape [rad]; returns the same shape [m].
        """
        cos2 = np.cos(elevation) ** 2
        return np.sqrt(
            self.signal_in_space_sd_m**2
            + self.zenith_iono_sd_m**2 / (1.0 - 0.899 * cos2)
            + self.zenith_tropo_sd_m**2 / (1.0 - 0.998 * cos2)
        )


ERRORS: dict[str, GnssErrors] = {
    "groves": GnssErrors(
        code_sd_m=1.0,
        range_rate_sd_mps=0.02,
        signal_in_space_sd_m=1.0,
        zenith_iono_sd_m=2.0,
        zenith_tropo_sd_m=0.2,
    ),
    "ke2022": GnssErrors(
        code_sd_m=1.0,
        range_rate_sd_mps=0.02,
        signal_in_space_sd_m=1.0,
        zenith_iono_sd_m=2.0,
        zenith_tropo_sd_m=0.2,
    ),
    "zhong2025": GnssErrors(
        code_sd_m=1.0,
        range_rate_sd_mps=0.02,
        signal_in_space_sd_m=1.0,
        zenith_iono_sd_m=0.0,
        zenith_tropo_sd_m=0.0,
    ),
    "white": GnssErrors(
        code_sd_m=1.0,
        range_rate_sd_mps=0.02,
        signal_in_space_sd_m=0.0,
        zenith_iono_sd_m=0.0,
        zenith_tropo_sd_m=0.0,
    ),
    "realistic": GnssErrors(
        code_sd_m=0.5,
        range_rate_sd_mps=0.08,
        signal_in_space_sd_m=0.85,
        zenith_iono_sd_m=0.0,
        zenith_tropo_sd_m=0.0,
        correlated_sd_m=0.75,
        correlation_s=35.0,
        clock=TCXO,
    ),
}
"""GNSS errors by name: the book's software (`groves2013`), which is also what comes nearest to
`ke2022`; `zhong2025`; no biases at all; and `realistic`, as 15,340 errors of a professional
receiver against carrier-phase truth had them."""
