"""GNSS measurement errors: what stays with a satellite for a run, and white noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from .clock import ReceiverClock


@dataclass(frozen=True, kw_only=True)
class GnssErrors:
    r"""Errors of pseudoranges and range rates.

    Each satellite has one constant bias a run, of variance

    .. math:: \sigma_{SIS}^2 + \frac{\sigma_{iono}^2}{1 - 0.899 \cos^2 E}
        + \frac{\sigma_{tropo}^2}{1 - 0.998 \cos^2 E}

    at elevation E, and white noise at every epoch.

    Parameters
    ----------
    code_sd_m, range_rate_sd_mps : float
        White noise of pseudoranges and range rates.
    signal_in_space_sd_m, zenith_iono_sd_m, zenith_tropo_sd_m : float
        Constant part.
    clock : ReceiverClock
        The receiver's own clock.

    Notes
    -----
    Groves (2013), section 9.3, as its software simulates it.
    """

    code_sd_m: float
    range_rate_sd_mps: float
    signal_in_space_sd_m: float
    zenith_iono_sd_m: float
    zenith_tropo_sd_m: float
    clock: ReceiverClock = field(default_factory=ReceiverClock)

    def __post_init__(self) -> None:
        """Check that the standard deviations are finite and not negative."""
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name != "clock" and not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"`{item.name}` must be finite and >= 0, got {value}")

    def bias_sd(self, elevation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Standard deviation of the constant biases.

        Parameters
        ----------
        elevation : ndarray
            Elevation of the satellites, any shape [rad].

        Returns
        -------
        ndarray
            Of the same shape [m].
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
}
"""GNSS errors by name: the book's software (`groves2013`), which is also what comes nearest to
`ke2022`; `zhong2025`; and no biases at all."""
