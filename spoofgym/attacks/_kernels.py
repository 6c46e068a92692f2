"""Compiled loops of attacks."""

from __future__ import annotations

from .._jit import njit
from ..earth.ranging import range_and_rate


@njit
def false_position(displacement_e, rate_e, epochs, satellites, position_e, velocity_e, captured, d_range, d_rate):
    """Offsets that make every captured range that of a displaced antenna.

    Both ranges are computed by the same instructions; without displacement and rate the offset is
    exactly zero.

    Parameters
    ----------
    displacement_e, rate_e : ndarray
        (B, 3) displacement of the counterfeit position and its rate, ECEF [m], [m/s].
    epochs : ndarray
        (B,) epoch that each receiver is about to measure.
    satellites : ndarray
        (K, n, 8) truth, as `World.satellites`.
    position_e, velocity_e : ndarray
        (K, 3) true antenna.
    captured : ndarray
        (n,) bool, which channels are the spoofer's.
    d_range, d_rate : ndarray
        (B, n), written: offsets [m], [m/s].
    """
    for b in range(displacement_e.shape[0]):
        d, e, k = displacement_e[b], rate_e[b], epochs[b]
        still = (
            d[0] == 0.0
            and d[1] == 0.0
            and d[2] == 0.0
            and e[0] == 0.0
            and e[1] == 0.0
            and e[2] == 0.0
        )
        for s in range(captured.shape[0]):
            d_range[b, s] = 0.0
            d_rate[b, s] = 0.0
            p = satellites[k, s]
            if still or not captured[s] or p[6] == 0.0:
                continue
            for counterfeit in range(2):
                f = float(counterfeit)
                rho, rate, _, _, _ = range_and_rate(
                    p[0],
                    p[1],
                    p[2],
                    p[3],
                    p[4],
                    p[5],
                    position_e[k, 0] + f * d[0],
                    position_e[k, 1] + f * d[1],
                    position_e[k, 2] + f * d[2],
                    velocity_e[k, 0] + f * e[0],
                    velocity_e[k, 1] + f * e[1],
                    velocity_e[k, 2] + f * e[2],
                )
                d_range[b, s] += (2.0 * f - 1.0) * rho
                d_rate[b, s] += (2.0 * f - 1.0) * rate
