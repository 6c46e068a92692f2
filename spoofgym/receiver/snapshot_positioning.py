r"""Snapshot receiver: position and clock of one epoch's pseudoranges, with no memory but a guess.

.. math:: \hat x^+ = \hat x + (G^T W G)^{-1} G^T W (\tilde\rho - \hat\rho(\hat x)), \qquad
    G = (-u, 1)

is iterated from the last fix (`least_squares.fix_receivers`).  Weights W come from a detector in
the loop; those of excluded satellites are 0.  For tests of innovations, the receiver also has a
prediction: the last fix, which it trusts so little that hardly anything but the residuals of the
fit counts.

Source: `groves2013`, eqs. 9.141 and 9.143.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._jit import njit
from .least_squares import geometry

FloatArray = NDArray[np.float64]

EXPECTED_POSITION_SD_M = 1e3
EXPECTED_CLOCK_SD_M = 1e4
"""How little the last fix is trusted."""


@njit
def expect(
    pseudorange: FloatArray,
    satellites: FloatArray,
    position: FloatArray,
    clock: FloatArray,
    noise_variance: float,
    innovation: FloatArray,
    innovation_cov: FloatArray,
    design: FloatArray,
) -> None:
    r"""Innovations against the last fix, and what they are believed to be.

    .. math:: S = G P G^T + R, \qquad
        P = \mathrm{diag}(\sigma_r^2, \sigma_r^2, \sigma_r^2, \sigma_c^2)

    `pseudorange`, `satellites` (B, n), (B, n, 3), all visible; `position`, `clock` (B, 3), (B, 1)
    last fix, ECEF [m]; `noise_variance`: R of one pseudorange [m^2]; `innovation`,
    `innovation_cov`, `design` (B, 2n), (B, 2n, 2n), (B, 2n, 4), written: pseudoranges; the rows of
    range rates, which this receiver doesn't measure, are those of invisible satellites.
    """
    n = pseudorange.shape[1]
    lines, distances = np.empty((n, 3)), np.empty(n)
    place, time = EXPECTED_POSITION_SD_M**2, EXPECTED_CLOCK_SD_M**2
    innovation[:] = 0.0
    innovation_cov[:] = 0.0
    design[:] = 0.0
    for b in range(pseudorange.shape[0]):
        geometry(satellites[b], position[b], lines, distances)
        for j in range(n):
            innovation[b, j] = pseudorange[b, j] - distances[j] - clock[b, 0]
            design[b, j, :3] = lines[j]
            design[b, j, 3] = 1.0
            for i in range(n):
                along = lines[j, 0] * lines[i, 0] + lines[j, 1] * lines[i, 1]
                along += lines[j, 2] * lines[i, 2]
                innovation_cov[b, j, i] = place * along + time
            innovation_cov[b, j, j] += noise_variance
            innovation_cov[b, n + j, n + j] = 1.0
