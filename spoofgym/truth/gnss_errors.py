"""Errors of pseudoranges, and of GNSS positions: first-order Gauss-Markov along each axis.

A receiver that hands out positions smooths them, and atmosphere and orbits change over minutes, so
that one error is much like the next.  How much decides what a monitor of the innovations can see:
white noise of 3.7 m hides an offset of some decimetres, correlated noise of that size does not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..core.compile import inline_njit
from ..core.declared import setting, settings_record
from ..core.registry import build_record, require
from .clock import TCXO, ReceiverClock
from .signal_errors import SIGNAL_ERRORS, SignalErrors


@settings_record(frozen=True, kw_only=True)
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
    Groves (2013), section 9.3, as its software simulates it.
    """

    code_sd_m: float = setting(least=0.0, unit="m", help="White noise of pseudoranges.")
    range_rate_sd_mps: float = setting(least=0.0, unit="m/s", help="White noise of range rates.")
    signal_in_space_sd_m: float = setting(
        least=0.0, unit="m", help="Sigma_SIS: part of the biases by orbit and satellite clock."
    )
    zenith_iono_sd_m: float = setting(
        least=0.0, unit="m", help="Sigma_iono: part by the ionosphere, in the zenith."
    )
    zenith_tropo_sd_m: float = setting(
        least=0.0, unit="m", help="Sigma_tropo: part by the troposphere, in the zenith."
    )
    correlated_sd_m: float = setting(
        default=0.0, least=0.0, unit="m", help="Wandering part of the pseudoranges; 0 for none."
    )
    correlation_s: float = setting(
        default=35.0, above=0.0, unit="s", help="Time in which its correlation falls to 1/e."
    )
    clock: ReceiverClock = setting(default_factory=ReceiverClock, help="The receiver's clock.")
    signals: SignalErrors | None = setting(
        default=None,
        omitted=True,
        help="Errors that come with the signals of an airborne receiver, on top; with a "
        "`carrier_sd_m` the range rates are differences of carriers, and `range_rate_sd_mps` is 0.",
    )

    def __post_init__(self) -> None:
        if isinstance(self.signals, Mapping):
            object.__setattr__(self, "signals", build_record("signals", SignalErrors, self.signals))
        require(
            not (self.carrier_sd_m > 0.0 and self.range_rate_sd_mps > 0.0),
            "`range_rate_sd_mps` must be 0 where range rates are differences of carriers, got "
            f"{self.range_rate_sd_mps}",
        )

    @property
    def carrier_sd_m(self) -> float:
        """Noise of a reading of the carrier whose differences are range rates; 0 for none [m]."""
        return 0.0 if self.signals is None else self.signals.carrier_sd_m

    def rate_sd(self, interval_s: float) -> float:
        return math.hypot(self.range_rate_sd_mps, math.sqrt(2.0) * self.carrier_sd_m / interval_s)

    def epoch_variance(self, elevation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Variance of one pseudorange, the clock left out [m^2]; `elevation`: any shape [rad]."""
        total = self.code_sd_m**2 + self.correlated_sd_m**2 + self.bias_sd(elevation) ** 2
        return total if self.signals is None else total + self.signals.code_variance(elevation)

    def bias_sd(self, elevation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Standard deviation of the constant biases. `elevation`: elevation of the satellites, any
        shape [rad]; returns the same shape [m]."""
        cos2 = np.cos(elevation) ** 2
        return np.sqrt(
            self.signal_in_space_sd_m**2
            + self.zenith_iono_sd_m**2 / (1.0 - 0.899 * cos2)
            + self.zenith_tropo_sd_m**2 / (1.0 - 0.998 * cos2)
        )


_GROVES = GnssErrors(
    code_sd_m=1.0,
    range_rate_sd_mps=0.02,
    signal_in_space_sd_m=1.0,
    zenith_iono_sd_m=2.0,
    zenith_tropo_sd_m=0.2,
)
ERRORS: dict[str, GnssErrors] = {
    "groves": _GROVES,
    "ke2022": _GROVES,
    "zhong2025": replace(_GROVES, zenith_iono_sd_m=0.0, zenith_tropo_sd_m=0.0),
    "white": replace(
        _GROVES, signal_in_space_sd_m=0.0, zenith_iono_sd_m=0.0, zenith_tropo_sd_m=0.0
    ),
    "trolley": GnssErrors(
        code_sd_m=0.5,
        range_rate_sd_mps=0.08,
        signal_in_space_sd_m=0.85,
        zenith_iono_sd_m=0.0,
        zenith_tropo_sd_m=0.0,
        correlated_sd_m=0.75,
        correlation_s=35.0,
        clock=TCXO,
    ),
    **{
        name: GnssErrors(
            code_sd_m=signals.carrier_sd_m,
            range_rate_sd_mps=0.0,
            signal_in_space_sd_m=0.0,
            zenith_iono_sd_m=0.0,
            zenith_tropo_sd_m=0.0,
            clock=TCXO,
            signals=signals,
        )
        for name, signals in SIGNAL_ERRORS.items()
    },
}
"""GNSS errors by name.

- `groves`: the book's software (`groves2013`), which is also what comes nearest to `ke2022`;
- `zhong2025`: as in the paper; `white`: no biases at all;
- `trolley`: fitted on one recording on the ground, of a survey receiver on a trolley with
  carrier-phase truth (`trolley-recording`).  1060 epochs at 1 Hz, GPS, GLONASS and BeiDou above 10
  deg gave 15,340 errors of the *ionosphere-free* code, the clock of each system taken out of every
  epoch by the median.  Their mean by satellite has an SD of 0.85 m, what varies within a satellite
  one of 0.90 m, with autocorrelations of 0.73, 0.47, 0.32, 0.18 and 0.02 at 1, 10, 30, 60 and 120
  s; range rates 0.139 (10 to 20 deg of elevation) to 0.084 m/s (60 to 90 deg).  These are eighteen
  minutes at one place near the ground: each constant is a single realisation, and nothing of it is
  airborne;
- `aviation-actual`, `aviation-overbound`: codes smoothed by carriers in the air, what happens and
  what a receiver has to assume (`signal_errors.SIGNAL_ERRORS`).  What is white in a smoothed code
  is the carrier's.
"""


@settings_record(frozen=True, kw_only=True)
class PositionErrors:
    r"""Gauss-Markov GNSS position errors.

    .. math:: e_k = \beta e_{k-1} + \sigma \sqrt{1 - \beta^2} \, n_k, \qquad
        e_0 = \sigma n_0, \qquad n_k \sim N(0, 1)

    The defaults are those of the receiver model that `shadmehri2025` names, 1.6 m, 3 m and 0.999 at
    each sample; the paper does not say whether it changed them.
    """

    horizontal_sd_m: float = setting(
        default=1.6,
        least=0.0,
        unit="m",
        help="Standard deviation of the errors to the east and to the north.",
    )
    vertical_sd_m: float = setting(
        default=3.0, least=0.0, unit="m", help="Standard deviation of the error upwards."
    )
    decay: float = setting(
        default=0.999,
        least=0.0,
        below=1.0,
        help="Correlation of one epoch's error with the next one's, beta; 0 for white noise.",
    )

    @property
    def sd(self) -> NDArray[np.float64]:
        return np.array([self.horizontal_sd_m, self.horizontal_sd_m, self.vertical_sd_m])


@inline_njit
def gauss_markov_step(error: float, decay: float, sd: float, deviate: float) -> float:
    """Next error of one axis [m] by the last one, as of `PositionErrors`; `sd` is sigma [m]."""
    return decay * error + sd * math.sqrt(1.0 - decay * decay) * deviate
