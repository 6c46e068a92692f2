"""The receiver's clock: two states, driven by white noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from .._jit import inlined


@dataclass(frozen=True, kw_only=True)
class ReceiverClock:
    """Two-state clock in units of range.

    Parameters
    ----------
    offset_m, drift_mps : float
        At time zero.
    phase_psd, frequency_psd : float
        Power spectral densities of phase [m^2/s] and frequency noise [m^2/s^3].

    Notes
    -----
    Groves (2013), section 9.4.2.
    """

    offset_m: float = 10_000.0
    drift_mps: float = 100.0
    phase_psd: float = 0.0
    frequency_psd: float = 0.0

    def __post_init__(self) -> None:
        """Check the values."""
        for item in fields(self):
            value = getattr(self, item.name)
            if not math.isfinite(value) or (item.name.endswith("psd") and value < 0.0):
                raise ValueError(f"`{item.name}` must be finite, a PSD also >= 0, got {value}")


@inlined
def advance_clock(
    bias: float,
    drift: float,
    tau: float,
    phase_psd: float,
    frequency_psd: float,
    a: float,
    b: float,
) -> tuple[float, float]:
    r"""Clock after one interval.

    .. math:: Q = \begin{pmatrix} S_p \tau + S_f \tau^3 / 3 & S_f \tau^2 / 2\\
        S_f \tau^2 / 2 & S_f \tau \end{pmatrix}

    Parameters
    ----------
    bias, drift : float
        Before the interval [m], [m/s].
    tau : float
        Its length [s].
    phase_psd, frequency_psd : float
        S_p [m^2/s] and S_f [m^2/s^3].
    a, b : float
        Two standard normal deviates.

    Returns
    -------
    bias, drift : float
        After the interval.

    Notes
    -----
    Groves (2013), eq. 9.151.
    """
    frequency = math.sqrt(frequency_psd * tau) * a
    own = math.sqrt(phase_psd * tau + frequency_psd * tau * tau * tau / 12.0) * b
    return bias + tau * (drift + 0.5 * frequency) + own, drift + frequency
