"""The receiver's clock: two states, driven by white noise."""

from __future__ import annotations

import math

from ..core.compile import inline_njit
from ..core.declared import setting, settings_record
from ..core.simd import sqrt
from ..earth.wgs84 import SPEED_OF_LIGHT


@settings_record(frozen=True, kw_only=True)
class ReceiverClock:
    """Two-state clock in units of range; Groves (2013), section 9.4.2."""

    offset_m: float = setting(default=10_000.0, unit="m", help="Offset at the start.")
    drift_mps: float = setting(default=100.0, unit="m/s", help="Drift at the start.")
    phase_psd: float = setting(
        default=0.0, least=0.0, unit="m^2/s", help="Power spectral density of phase noise."
    )
    frequency_psd: float = setting(
        default=0.0, least=0.0, unit="m^2/s^3", help="Power spectral density of frequency noise."
    )


def clock_of_allan(h0: float, h_2: float) -> ReceiverClock:
    r"""Clock of an oscillator that is known by two coefficients of its Allan variance.

    .. math:: S_p = \tfrac12 c^2 h_0, \qquad S_f = 2 \pi^2 c^2 h_{-2}

    `h0`: white frequency noise [s]; `h_2`: random walk of the frequency [1/s].
    Brown and Hwang (2012), section 9.3, `brownhwang2012`; the flicker noise is left out.
    """
    c2 = SPEED_OF_LIGHT**2
    return ReceiverClock(phase_psd=0.5 * c2 * h0, frequency_psd=2.0 * math.pi**2 * c2 * h_2)


TCXO = clock_of_allan(2e-19, 2e-20)  # `brownhwang2012`: 0.0090 m^2/s, 0.035 m^2/s^3


@inline_njit
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

    `bias`, `drift`: before the interval [m], [m/s]; `tau`: its length [s]; `phase_psd`,
    `frequency_psd`: S_p [m^2/s] and S_f [m^2/s^3]. Groves (2013), eq. 9.151.
    """
    frequency = sqrt(frequency_psd * tau) * a
    own = sqrt(phase_psd * tau + frequency_psd * tau * tau * tau * (1.0 / 12.0)) * b
    return bias + tau * (drift + 0.5 * frequency) + own, drift + frequency
