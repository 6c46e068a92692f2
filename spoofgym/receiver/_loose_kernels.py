"""The compiled halves of a loosely coupled receiver's epoch, over a batch of receivers."""

import math
from collections import namedtuple

import numpy as np

from ..core.compile import inline_njit, njit
from ..earth.wgs84 import EARTH_RATE, gravity, radii_of_curvature
from .adaptive import FIXED, LARGEST_SCALE, process_factor, windowed_covariance
from .loose_states import (
    fill_dynamics,
    fill_local_axes,
    fill_transition,
    geodetic_point,
    gravity_size,
)
from .strapdown import strapdown_step

# What the receivers remember:
# - `position_e`, `velocity_e` (B, 3) ECEF [m], [m/s]; `C_eb` (B, 3, 3) attitude;
# - `bias` (B, 6) of gyros [rad/s] and accelerometers [m/s^2];
# - `covariance` (B, 15, 15) in the order of `loose_states`;
# - `innovation`, `innovation_cov` (B, 3) and (B, 3, 3) of the epoch, GNSS minus prediction; east,
#   north, up [m];
# - `measurement_cov` (B, 3, 3) R of the next update [m^2]; `process_scale` (B,) factor on Q;
# - `residuals`, `innovations` (B, w, 3) windows [m]; the second only where Q adapts, else w = 0;
# - `seen` (B,) int64, updates so far.
LooseState = namedtuple(
    "LooseState",
    "position_e velocity_e C_eb bias covariance innovation innovation_cov measurement_cov "
    "process_scale residuals innovations seen",
)


@inline_njit
def _to_local(C_el, x, y, z):
    return (
        C_el[0, 0] * x + C_el[1, 0] * y + C_el[2, 0] * z,
        C_el[0, 1] * x + C_el[1, 1] * y + C_el[2, 1] * z,
        C_el[0, 2] * x + C_el[1, 2] * y + C_el[2, 2] * z,
    )


@njit
def first_estimate(state, position_e, velocity_e, C_eb, error):
    """Begin at the truth, apart from the errors of the alignment. `state`: position, velocity and
    attitude are written; `position_e`, `velocity_e`, `C_eb` (B, 3), (B, 3) and (B, 3, 3) truth;
    `error` (B, 15) in the order of the states; the biases are not looked at."""
    C_el = np.empty((3, 3))
    x = np.empty(15)
    for b in range(error.shape[0]):
        for i in range(3):
            state.position_e[b, i] = position_e[b, i]
            state.velocity_e[b, i] = velocity_e[b, i]
            for j in range(3):
                state.C_eb[b, i, j] = C_eb[b, i, j]
        for i in range(15):
            x[i] = -error[b, i] if i < 9 else 0.0
        feed_back(state, b, x, C_el)


@njit
def propagate_loose(P, Phi, noise_psd, tau, work):
    r"""Propagate the covariance over one interval, in place.

    .. math:: P \leftarrow \Phi (P + Q/2) \Phi^T + Q/2, \qquad Q = \mathrm{PSD} \, \tau

    `P` (15, 15) symmetric, overwritten; `Phi` (15, 15); `noise_psd` (15,) of the noise that drives
    each state; `tau`: length of the interval [s]; `work` (15, 15) scratch memory.
    """
    for i in range(15):
        P[i, i] += 0.5 * tau * noise_psd[i]
    for i in range(9):
        row = work[i]
        for j in range(15):
            row[j] = 0.0
        for k in range(15):
            factor = Phi[i, k]
            for j in range(15):
                row[j] += factor * P[k, j]
    for i in range(9):
        for j in range(i, 9):
            total = 0.0
            for k in range(15):
                total += work[i, k] * Phi[j, k]
            P[i, j] = total
            P[j, i] = total
        for j in range(9, 15):
            P[i, j] = work[i, j]
            P[j, i] = work[i, j]
    for i in range(15):
        P[i, i] += 0.5 * tau * noise_psd[i]


@njit
def predict(state, samples, lengths, tau, fix_e, noise_psd, transition, imu_delta):
    """Mechanize one block of samples, propagate, and form innovation and covariance.

    `samples` (B, S, 6) measured specific force and angular rate, body axes; `lengths` (S,) of the
    samples, which are `tau` together [s]; `fix_e` (B, 3) GNSS position, ECEF [m]; `noise_psd` (15,)
    of the noise that drives each state; `transition` (B, 15, 15), written; its rows of the biases
    must hold those of the identity; `imu_delta` (B, 6), written: bias-corrected delta-v [m/s] and
    delta-theta [rad].
    """
    count = samples.shape[1]
    F, work = np.empty((9, 9)), np.empty((15, 15))
    C_el, middle, psd = np.empty((3, 3)), np.empty((3, 3)), np.empty(15)
    for b in range(fix_e.shape[0]):
        r, v, C, bias = state.position_e[b], state.velocity_e[b], state.C_eb[b], state.bias[b]
        r0, r1, r2, v0, v1, v2 = r[0], r[1], r[2], v[0], v[1], v[2]
        delta = imu_delta[b]
        delta[:] = 0.0
        A = C[0, 0], C[0, 1], C[0, 2], C[1, 0], C[1, 1], C[1, 2], C[2, 0], C[2, 1], C[2, 2]
        V, X = (v0, v1, v2), (r0, r1, r2)
        for i in range(count):
            m = samples[b, i]
            f = (m[0] - bias[3], m[1] - bias[4], m[2] - bias[5])
            w = (m[3] - bias[0], m[4] - bias[1], m[5] - bias[2])
            interval = lengths[i]
            A, V, X = strapdown_step(A, V, X, f, w, interval)
            for c in range(3):
                delta[c] += f[c] * interval
                delta[3 + c] += w[c] * interval
        for i in range(3):
            r[i], v[i] = X[i], V[i]
            for j in range(3):
                middle[i, j] = 0.5 * (C[i, j] + A[3 * i + j])
                C[i, j] = A[3 * i + j]
        # ---- errors, with what held in the middle of the interval
        x, y, z = 0.5 * (r0 + r[0]), 0.5 * (r1 + r[1]), 0.5 * (r2 + r[2])
        latitude, longitude, height = geodetic_point(x, y, z)
        fill_local_axes(latitude, longitude, C_el)
        gx, gy, gz = gravity(x, y, z)
        fx = (v[0] - v0) / tau - gx - EARTH_RATE * (v1 + v[1])
        fy = (v[1] - v1) / tau - gy + EARTH_RATE * (v0 + v[0])
        fz = (v[2] - v2) / tau - gz
        f_l = _to_local(C_el, fx, fy, fz)
        v_l = _to_local(C_el, 0.5 * (v0 + v[0]), 0.5 * (v1 + v[1]), 0.5 * (v2 + v[2]))
        fill_dynamics(F, v_l, f_l, latitude, height, gravity_size(x, y, z))
        Phi, P = transition[b], state.covariance[b]
        fill_transition(Phi, F, middle, C_el, tau)
        for i in range(15):
            psd[i] = state.process_scale[b] * noise_psd[i]
        propagate_loose(P, Phi, psd, tau, work)
        # ---- innovation
        latitude, longitude, height = geodetic_point(r[0], r[1], r[2])
        fill_local_axes(latitude, longitude, C_el)
        apart = _to_local(C_el, fix_e[b, 0] - r[0], fix_e[b, 1] - r[1], fix_e[b, 2] - r[2])
        for i in range(3):
            state.innovation[b, i] = apart[i]
            for j in range(3):
                state.innovation_cov[b, i, j] = P[6 + i, 6 + j] + state.measurement_cov[b, i, j]


@njit
def invert(S, out):
    """Inverse of a symmetric positive definite (3, 3) matrix, by cofactors. `S`, `out` (3, 3);
    `out` is written."""
    a = S[1, 1] * S[2, 2] - S[1, 2] * S[1, 2]
    b = S[0, 2] * S[1, 2] - S[0, 1] * S[2, 2]
    c = S[0, 1] * S[1, 2] - S[0, 2] * S[1, 1]
    d = 1.0 / (S[0, 0] * a + S[0, 1] * b + S[0, 2] * c)
    out[0, 0], out[0, 1], out[0, 2] = a * d, b * d, c * d
    out[1, 0], out[2, 0] = out[0, 1], out[0, 2]
    out[1, 1] = (S[0, 0] * S[2, 2] - S[0, 2] * S[0, 2]) * d
    out[1, 2] = (S[0, 1] * S[0, 2] - S[0, 0] * S[1, 2]) * d
    out[2, 1] = out[1, 2]
    out[2, 2] = (S[0, 0] * S[1, 1] - S[0, 1] * S[0, 1]) * d


@njit
def joseph(P, G, R, M, GR):
    r"""Covariance after an update with any gain, in place.

    With :math:`G = -K W`, which acts on position errors, and E the choice of the position,

    .. math:: P \leftarrow (I - G E) P (I - G E)^T + G R G^T

    `P` (15, 15) symmetric, overwritten; `G` (15, 3); `R` (3, 3); `M`, `GR` (15, 15) and (15, 3)
    scratch memory.
    """
    for i in range(15):
        g0, g1, g2 = G[i, 0], G[i, 1], G[i, 2]
        for j in range(15):
            M[i, j] = P[i, j] - (g0 * P[6, j] + g1 * P[7, j] + g2 * P[8, j])
        for j in range(3):
            GR[i, j] = g0 * R[0, j] + g1 * R[1, j] + g2 * R[2, j]
    for i in range(15):
        for j in range(i, 15):
            value = M[i, j] - (M[i, 6] * G[j, 0] + M[i, 7] * G[j, 1] + M[i, 8] * G[j, 2])
            value += GR[i, 0] * G[j, 0] + GR[i, 1] * G[j, 1] + GR[i, 2] * G[j, 2]
            P[i, j] = value
            P[j, i] = value


@njit
def feed_back(state, b, x, C_el):
    """Take an estimated error out of one receiver's solution. A corrected position has other local
    axes, and the velocity and attitude errors are those in each its own axes: both turn with them.
    `x` (15,) estimated error; `C_el` (3, 3) scratch memory."""
    r, v, C = state.position_e[b], state.velocity_e[b], state.C_eb[b]
    latitude, longitude, height = geodetic_point(r[0], r[1], r[2])
    fill_local_axes(latitude, longitude, C_el)
    meridian, transverse = radii_of_curvature(latitude)
    turn_e = x[7] / (meridian + height)
    turn_n = -x[6] / (transverse + height)
    turn_u = turn_n * math.tan(latitude)
    v_e, v_n, v_u = _to_local(C_el, v[0], v[1], v[2])
    dv = (
        turn_n * v_u - turn_u * v_n - x[3],
        turn_u * v_e - turn_e * v_u - x[4],
        turn_e * v_n - turn_n * v_e - x[5],
    )
    a_e, a_n, a_u = x[0] + turn_e, x[1] + turn_n, x[2] + turn_u
    for i in range(3):
        c0, c1, c2 = C_el[i, 0], C_el[i, 1], C_el[i, 2]
        r[i] -= c0 * x[6] + c1 * x[7] + c2 * x[8]
        v[i] += c0 * dv[0] + c1 * dv[1] + c2 * dv[2]
    ax = C_el[0, 0] * a_e + C_el[0, 1] * a_n + C_el[0, 2] * a_u
    ay = C_el[1, 0] * a_e + C_el[1, 1] * a_n + C_el[1, 2] * a_u
    az = C_el[2, 0] * a_e + C_el[2, 1] * a_n + C_el[2, 2] * a_u
    for j in range(3):  # C <- (I + [a x] + [a x]^2 / 2) C
        c0, c1, c2 = C[0, j], C[1, j], C[2, j]
        d0, d1, d2 = ay * c2 - az * c1, az * c0 - ax * c2, ax * c1 - ay * c0
        C[0, j] = c0 + d0 + 0.5 * (ay * d2 - az * d1)
        C[1, j] = c1 + d1 + 0.5 * (az * d0 - ax * d2)
        C[2, j] = c2 + d2 + 0.5 * (ax * d1 - ay * d0)
    for i in range(6):
        state.bias[b, i] += x[9 + i]


@njit
def update_loose(state, weights, rule, floor):
    """Correct the predicted state with the weighted gain, feed it back, and tune the noise.
    `state`: after `predict`; corrected in place. Where the window of residuals is empty, R stays;
    `weights` (B, 3) on the columns of the gain; `floor`: least variance of a coordinate [m^2]."""
    S_inverse, G, GR = np.empty((3, 3)), np.empty((15, 3)), np.empty((15, 3))
    M, x, C_el = np.empty((15, 15)), np.empty(15), np.empty((3, 3))
    for b in range(weights.shape[0]):
        P, z, R = state.covariance[b], state.innovation[b], state.measurement_cov[b]
        believed = P[6, 6] + P[7, 7] + P[8, 8]
        invert(state.innovation_cov[b], S_inverse)
        for i in range(15):
            for j in range(3):
                total = P[i, 6] * S_inverse[0, j] + P[i, 7] * S_inverse[1, j]
                G[i, j] = weights[b, j] * (total + P[i, 8] * S_inverse[2, j])
            x[i] = -(G[i, 0] * z[0] + G[i, 1] * z[1] + G[i, 2] * z[2])
        joseph(P, G, R, M, GR)
        feed_back(state, b, x, C_el)
        state.seen[b] += 1
        window = state.residuals[b]
        if window.shape[0] == 0:
            continue
        slot = (state.seen[b] - 1) % window.shape[0]
        for i in range(3):
            window[slot, i] = z[i] + x[6 + i]
            if rule != FIXED:
                state.innovations[b, slot, i] = z[i]
        if state.seen[b] < window.shape[0]:
            continue
        windowed_covariance(window, R)
        for i in range(3):
            for j in range(3):
                R[i, j] += P[6 + i, 6 + j]
            R[i, i] = max(R[i, i], floor)
        if rule != FIXED:
            windowed_covariance(state.innovations[b], S_inverse)
            excess = 0.0
            for i in range(3):
                excess += S_inverse[i, i] - R[i, i]
            scale = state.process_scale[b] * process_factor(rule, excess / believed)
            state.process_scale[b] = min(scale, LARGEST_SCALE)
