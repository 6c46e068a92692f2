"""The 17 states of the error-state filter, and how their errors grow between two epochs.

Order: attitude (ECEF axes), velocity, position, accelerometer biases, gyro biases, clock bias,
clock drift.  The state is the error of the estimate: estimate minus truth for attitude, velocity
and position, truth minus estimate for biases and clock.
"""

import numpy as np
from numpy.typing import NDArray

from ..core.compile import inline_njit, njit
from ..core.simd import load, sqrt, store
from ..earth.wgs84 import EARTH_RATE, geocentric_surface_radius, gravity
from ..truth._kernels import load3, store3

STATES = 17
ATTITUDE, VELOCITY, POSITION, ACCEL_BIAS, GYRO_BIAS = 0, 3, 6, 9, 12
CLOCK_BIAS, CLOCK_DRIFT = 15, 16
SIZES = (3, 3, 3, 3, 3, 1, 1)  # of these, in order


PACKED = STATES * (STATES + 1) // 2  # of a symmetric matrix, row by row from its diagonal on


def _packed_index() -> NDArray[np.int64]:
    index = np.zeros((STATES, STATES), dtype=np.int64)
    index[np.triu_indices(STATES)] = np.arange(PACKED)
    return np.maximum(index, index.T)


INDEX = _packed_index()  # (17, 17) place of every element of a packed symmetric matrix
IN_ORDER = np.arange(STATES)
TERMS = 21  # of the transition matrix, neither 0 nor 1 nor times: C tau, C f tau, G tau


@njit
def transition_terms(C, r, f, tau, terms):
    r"""Write what differs from interval to interval in the transition matrix, first order in tau.

    .. math::
        \Phi = \begin{pmatrix}
        I - \Omega\tau & 0 & 0 & 0 & C\tau & 0\\
        -[f_e\times]\tau & I - 2\Omega\tau & G\tau & C\tau & 0 & 0\\
        0 & I\tau & I & 0 & 0 & 0\\
        0 & 0 & 0 & I & 0 & 0\\
        0 & 0 & 0 & 0 & I & 0\\
        0 & 0 & 0 & 0 & 0 & \begin{smallmatrix}1 & \tau\\ 0 & 1\end{smallmatrix}
        \end{pmatrix}, \qquad G = -\frac{2 g(r)\, r^T}{r_{eS} |r|}

    `C`, `r`: attitude to ECEF, row by row, and position [m] at the end of the interval; `f`: last
    bias-corrected specific force, body axes [m/s^2]; `terms`: lane array, written: C tau (9),
    f_e tau (3), G tau (9).

    Notes
    -----
    Groves (2013), eqs. 14.48 to 14.50.
    """
    for i in range(9):
        store(terms, i, C[i] * tau)
    for i in range(3):
        f_e = C[3 * i] * f[0] + C[3 * i + 1] * f[1] + C[3 * i + 2] * f[2]
        store(terms, 9 + i, f_e * tau)
    x, y, z = r
    g = gravity(x, y, z)
    k = -2.0 * tau / (geocentric_surface_radius(x, y, z) * sqrt(x * x + y * y + z * z))
    for i in range(3):
        for j in range(3):
            store(terms, 12 + 3 * i + j, k * g[i] * r[j])


@inline_njit
def _matrix_times(terms, first, b):
    x, y, z = load3(terms, first), load3(terms, first + 3), load3(terms, first + 6)
    c0, c1 = x[0] * b[0] + x[1] * b[1] + x[2] * b[2], y[0] * b[0] + y[1] * b[1] + y[2] * b[2]
    return c0, c1, z[0] * b[0] + z[1] * b[1] + z[2] * b[2]


@inline_njit
def transition_product(terms, tau, x, first, index):
    r"""Those elements of :math:`y = \Phi x` that differ from x: y_0 to y_8, and y_15.

    `x`, `first`: lane array and row from which `index` (17,) gives the places of the elements.
    """
    w = EARTH_RATE * tau
    w2 = 2.0 * w
    a0, a1, a2 = load(x, first + index[0]), load(x, first + index[1]), load(x, first + index[2])
    v0, v1, v2 = load(x, first + index[3]), load(x, first + index[4]), load(x, first + index[5])
    p0, p1, p2 = load(x, first + index[6]), load(x, first + index[7]), load(x, first + index[8])
    b0, b1, b2 = load(x, first + index[9]), load(x, first + index[10]), load(x, first + index[11])
    g0, g1, g2 = load(x, first + index[12]), load(x, first + index[13]), load(x, first + index[14])
    ex, ey, ez = load3(terms, 9)
    c0, c1, c2 = _matrix_times(terms, 0, (b0, b1, b2))  # C tau b, C tau g and G tau p
    d0, d1, d2 = _matrix_times(terms, 0, (g0, g1, g2))
    e0, e1, e2 = _matrix_times(terms, 12, (p0, p1, p2))
    return (
        (a0 + w * a1) + d0,
        (a1 - w * a0) + d1,
        a2 + d2,
        (ez * a1 - ey * a2) + (v0 + w2 * v1) + e0 + c0,
        (ex * a2 - ez * a0) + (v1 - w2 * v0) + e1 + c1,
        (ey * a0 - ex * a1) + v2 + e2 + c2,
        p0 + tau * v0,
        p1 + tau * v1,
        p2 + tau * v2,
        load(x, first + index[15]) + tau * load(x, first + index[16]),
    )


@inline_njit
def _store_nine(work, first, step, y):
    """Write the first nine elements of a product, so many rows apart."""
    store3(work, first, y[:3], step)
    store3(work, first + 3 * step, y[3:6], step)
    store3(work, first + 6 * step, y[6:9], step)


@njit
def propagate_covariance(P, first, terms, tau, noise_psd, first_psd, work):
    r"""Propagate a packed covariance over one interval, in place.

    .. math:: P \leftarrow \Phi (P + Q/2) \Phi^T + Q/2

    `P`, `first`: lane array and first of the `PACKED` rows; `noise_psd`, `first_psd`: the same for
    the (17,) power spectral density of the noise on each state; Q = PSD tau; `work`: scratch memory
    of 187 rows: rows 0 to 8 and 15 of Phi P, and one row more.

    Notes
    -----
    Groves (2013), eq. 3.46.
    """
    for i in range(17):
        k = first + INDEX[i, i]
        store(P, k, load(P, k) + 0.5 * tau * load(noise_psd, first_psd + i))
    for j in range(17):
        y = transition_product(terms, tau, P, first, INDEX[j])
        _store_nine(work, j, 17, y)
        store(work, 153 + j, y[9])
    for i in range(9):  # each row of Phi P as a column, since (Phi P) Phi' is symmetric
        o = 17 * i
        y = transition_product(terms, tau, work, o, IN_ORDER)
        _store_nine(work, 170, 1, y)
        store(work, o + 15, y[9])
        k = first + INDEX[i, i]
        for j in range(i, 9):
            store(P, k, load(work, 170 + j))
            k += 1
        for j in range(9, 17):
            store(P, k, load(work, o + j))
            k += 1
    for i in range(9, 15):
        store(P, first + INDEX[i, 15], load(work, 153 + i))
    store(P, first + INDEX[15, 15], load(work, 168) + tau * load(work, 169))
    store(P, first + INDEX[15, 16], load(work, 169))
    for i in range(17):
        k = first + INDEX[i, i]
        store(P, k, load(P, k) + 0.5 * tau * load(noise_psd, first_psd + i))
