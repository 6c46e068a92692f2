"""Compiled loops of attacks."""

from __future__ import annotations

import math

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


@njit
def kinematic_step(action, interval, vector, by_rate, unit_scale, rate_limit, displacement, rate):
    """Move the commanded offsets to the end of an interval, in place.

    Parameters
    ----------
    action : ndarray
        (B, a) in [-1, 1].
    interval : ndarray
        (B,) [s].
    vector : bool
        Whether limits apply to the length of the vector, or to each element for itself.
    by_rate : bool
        Whether an action commands the rate, or the acceleration.
    unit_scale, rate_limit : float
        What an action of 1 commands, and the limit of the rate.
    displacement, rate : ndarray
        (B, a), overwritten [m], [m/s].
    """
    axes = action.shape[1]
    for b in range(action.shape[0]):
        tau = interval[b]
        given = 1.0
        if vector:
            given = shrink(action[b], 0.0, action[b], 1.0)
        # the new rate is rate + change, shortened to its limit
        size = 1.0
        if vector and not by_rate:
            size = shrink(rate[b], given * unit_scale * tau, action[b], rate_limit)
        for i in range(axes):
            u = given * action[b, i]
            u = min(max(u, -1.0), 1.0)
            old = rate[b, i]
            if by_rate:
                new = unit_scale * u
                old = new
            else:
                new = old + unit_scale * u * tau
                new = size * new if vector else min(max(new, -rate_limit), rate_limit)
            displacement[b, i] += 0.5 * (old + new) * tau
            rate[b, i] = new


@njit
def shrink(first, factor, second, limit):
    """Factor that shortens ``first + factor * second`` to a limit of its length."""
    total = 0.0
    for i in range(first.shape[0]):
        value = first[i] + factor * second[i]
        total += value * value
    length = math.sqrt(total)
    return limit / length if length > limit else 1.0
