r"""Self-tuning noise of a filter: covariances matched to what the last epochs showed.

The measurement noise is what the residuals of a window leave, and what the estimate adds,

.. math:: R_k = \frac1w \sum_{i=0}^{w-1} v_{k-i} v_{k-i}^T + H P_k H^T, \qquad
    v_k = z_k - H \hat x_k

It is positive definite by construction, and takes effect at the next epoch, since the estimate has
to be there first.  Until the window is full the stated noise stays.

The process noise may be scaled by the ratio of seen and believed innovations,

.. math:: Q_k = Q_{k-1} \sqrt{\alpha}, \qquad
    \alpha = \frac{\mathrm{tr}(C_\gamma - R_k)}{\mathrm{tr}(H P_{k|k-1} H^T)}

This is off by default, because it is not stable: the factors multiply from one epoch to the next
while the window keeps showing what an earlier Q brought about, so that there is no level to which
Q returns; and where :math:`\mathrm{tr}\,C_\gamma < \mathrm{tr}\,R_k`, which correlated noise brings
about some dozen times in 30 s, the root is not real.

A fix that a detector rejects goes into the window like any other: the noise then grows until
fixes are believed again.  In a filter that did not adapt meanwhile, one false alarm would stop
the adaptation for ever.

Source: `shadmehri2025`, eqs. 8 to 13; the covariance matching is from `ding2007`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..core.compile import inline_njit, njit
from ..core.declared import setting, settings_record

FloatArray = NDArray[np.float64]
FIXED, RAW, SKIP, CLAMPED = 0, 1, 2, 3
PROCESS = {"fixed": FIXED, "raw": RAW, "skip": SKIP, "clamped": CLAMPED}
LARGEST_SCALE = 1e12  # bound of the scale of Q, so that an unstable run shows without an overflow


@settings_record(frozen=True, kw_only=True)
class SelfTuning:
    """Settings of the self-tuning noise."""

    window: int = setting(
        default=100,
        least=2,
        most=100_000,
        unit="epochs",
        help="Length w of the window of residuals. The innovation covariance is then itself an "
        "estimate, so that short windows raise false alarms (`windowed-chi2` has a threshold for "
        "that) and take the onset of an attack for noise within w epochs.",
    )
    process: str = setting(
        default="fixed",
        one_of=PROCESS,
        help='What becomes of Q.  ``"fixed"``: nothing.  ``"raw"``: the paper\'s rule, the root '
        'of a negative number taken as 0, which Q never leaves again.  ``"skip"``: an epoch with a '
        'negative ratio changes nothing.  ``"clamped"``: no epoch more than doubles or halves it. '
        "None of the three is stable.",
    )
    floor_m: float = setting(
        default=0.0,
        least=0.0,
        unit="m",
        help="Least standard deviation of a coordinate; the paper has none.",
    )


@njit
def windowed_covariance(window: FloatArray, out: FloatArray) -> None:
    r"""Mean of the outer products in a window.

    .. math:: C = \frac1w \sum_i v_i v_i^T

    `window` (w, 3); `out` (3, 3), written.
    """
    c00, c01, c02, c11, c12, c22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(window.shape[0]):
        x, y, z = window[i, 0], window[i, 1], window[i, 2]
        c00 += x * x
        c01 += x * y
        c02 += x * z
        c11 += y * y
        c12 += y * z
        c22 += z * z
    each = 1.0 / window.shape[0]
    out[0, 0], out[0, 1], out[0, 2] = each * c00, each * c01, each * c02
    out[1, 0], out[1, 1], out[1, 2] = each * c01, each * c11, each * c12
    out[2, 0], out[2, 1], out[2, 2] = each * c02, each * c12, each * c22


@inline_njit
def process_factor(rule: int, ratio: float) -> float:
    root = math.sqrt(max(ratio, 0.0))
    if rule == CLAMPED:
        return min(max(root, 0.5), 2.0)
    if rule == SKIP and ratio < 0.0:
        return 1.0
    return root
