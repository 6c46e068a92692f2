"""Compiled loops of the authentic world."""

from __future__ import annotations

import math

from .._jit import njit
from ..earth.ranging import range_and_rate
from .clock import advance_clock
from .imu import quantize, sense
from .noise import normals


@njit
def fill_ranges(satellites, visible, position_e, velocity_e):
    """Write true range and range rate of all visible satellites into columns 6 and 7.

    `satellites` (K, n, 8) position, velocity, range, range rate; `visible` (K, n) bool;
    `position_e`, `velocity_e` (K, 3) antenna.
    """
    for k in range(satellites.shape[0]):
        r, v = position_e[k], velocity_e[k]
        for s in range(satellites.shape[1]):
            if visible[k, s]:
                p = satellites[k, s]
                rho, rate, _, _, _ = range_and_rate(
                    p[0], p[1], p[2], p[3], p[4], p[5], r[0], r[1], r[2], v[0], v[1], v[2]
                )
                p[6] = rho
                p[7] = rate


@njit
def imu_block(sensors, b, keys, epoch, truth, root_rate, noise, samples):
    """Measure one receiver's samples of one interval.

    `keys` (2,) key of the sensor noise; `truth` (S,) each: true samples; `root_rate` (S,) one over
    the square root of their lengths [Hz^0.5]; `noise` (P,) scratch memory for the deviates;
    `samples` (6, S or more), written: measured specific force and angular rate.
    """
    normals(keys[0], keys[1], epoch, noise)
    n = root_rate.shape[0]
    level = sensors.imu_noise[b]
    for c in range(6):
        if c < 3:
            m = sensors.accel_matrix[b, c]
            row = (m[0], m[1], m[2], 0.0, 0.0, 0.0)
            bias = sensors.accel_bias[b, c]
        else:
            g, m = sensors.g_dependence[b, c - 3], sensors.gyro_matrix[b, c - 3]
            row = (g[0], g[1], g[2], m[0], m[1], m[2])
            bias = sensors.gyro_bias[b, c - 3]
        deviates = noise[c * n : (c + 1) * n]
        sense(truth, deviates, root_rate, row, bias, level[c // 3], samples[c, :n])
    quantize(samples, n, level[2], level[3], sensors.residual[b])


@njit
def advance_correlated(sensors, b, keys, epoch, tau, noise):
    r"""Correlated code errors of one receiver at its next epoch: first-order Gauss-Markov.

    .. math:: c^+ = \alpha c + \sigma \sqrt{1 - \alpha^2}\, w, \qquad \alpha = e^{-\tau / T}

    which is exact for any interval, and stationary since it begins with :math:`\sigma w`.

    `keys` (2,) key of the source; `tau`: time since the epoch before [s]; 0 for the first epoch;
    `noise` (P,) scratch memory for the deviates, at least n.
    """
    sd, time_constant = sensors.correlated_noise[b, 0], sensors.correlated_noise[b, 1]
    alpha = math.exp(-tau / time_constant) if tau > 0.0 else 0.0
    driving = sd * math.sqrt(1.0 - alpha * alpha)
    normals(keys[0], keys[1], epoch, noise)
    for s in range(sensors.correlated.shape[1]):
        sensors.correlated[b, s] = alpha * sensors.correlated[b, s] + driving * noise[s]


@njit
def replace_errors(sensors, b, noise, out_range, out_rate):
    """Take the authentic errors from the channels whose counterfeit signals bring their own.

    `out_range`, `out_rate` (n,), overwritten [m], [m/s].
    """
    n = out_range.shape[0]
    for s in range(n):
        code, rate = sensors.authentic[b, s], sensors.authentic[b, n + s]
        if code != 1.0:
            error = sensors.satellite_bias[b, s] + sensors.gnss_noise[b, 0] * noise[s]
            out_range[s] -= (1.0 - code) * (error + sensors.correlated[b, s])
        if rate != 1.0:
            out_rate[s] -= (1.0 - rate) * sensors.gnss_noise[b, 1] * noise[n + s]


@njit
def gnss_epoch(
    sensors,
    b,
    gnss_keys,
    clock_keys,
    correlated_keys,
    epoch,
    tau,
    satellites,
    noise,
    out_range,
    out_rate,
):
    """Measure one receiver's pseudoranges and range rates at one epoch.

    `gnss_keys`, `clock_keys`, `correlated_keys` (2,) keys of the three sources; `tau`: time since
    the epoch before [s]; 0 leaves the clock alone; `satellites` (n, 8) truth of the epoch; `noise`
    (P,) scratch memory for the deviates, at least 2 n; `out_range`, `out_rate` (n,), written, for
    all slots, visible or not [m], [m/s].
    """
    if tau > 0.0:
        p, f = sensors.clock_psd[b, 0], sensors.clock_psd[b, 1]
        a, w = 0.0, 0.0
        if p > 0.0 or f > 0.0:
            normals(clock_keys[0], clock_keys[1], epoch, noise)
            a, w = noise[0], noise[1]
        sensors.clock[b, 0], sensors.clock[b, 1] = advance_clock(
            sensors.clock[b, 0], sensors.clock[b, 1], tau, p, f, a, w
        )
    correlated = sensors.correlated_noise[b, 0] > 0.0
    if correlated:
        advance_correlated(sensors, b, correlated_keys, epoch, tau, noise)
    normals(gnss_keys[0], gnss_keys[1], epoch, noise)
    n = satellites.shape[0]
    for s in range(n):
        authentic = satellites[s, 6] + sensors.satellite_bias[b, s] + sensors.clock[b, 0]
        out_range[s] = authentic + sensors.gnss_noise[b, 0] * noise[s] + sensors.range_offset[b, s]
        out_rate[s] = (
            satellites[s, 7]
            + sensors.clock[b, 1]
            + sensors.gnss_noise[b, 1] * noise[n + s]
            + sensors.rate_offset[b, s]
        )
    if correlated:
        for s in range(n):
            out_range[s] += sensors.correlated[b, s]
    replace_errors(sensors, b, noise, out_range, out_rate)
