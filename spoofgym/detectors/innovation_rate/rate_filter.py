r"""The Kalman filter that finds the rate of a normalized innovation.

The state of `ke2022`, eqs. 32 to 34, from `bhatti2012`, is a level :math:`\hat\omega`, its rate v,
its acceleration a and a constant deviation p,

.. math::
    \dot{\hat\omega} = v, \quad \dot v = -\alpha v + a + \text{noise}, \quad \dot a = \dot p = 0,
    \qquad \omega = \hat\omega - p + \text{noise of variance } 1.

Only the difference :math:`s = \hat\omega - p` is ever observed, and it moves as
:math:`\hat\omega` does, so that the three states (s, v, a) with the first variance
:math:`P_s = P_{\hat\omega} + P_p` have the same v and the same variance of it at every epoch.

Symbols: :math:`\omega` normalized innovation, :math:`\alpha` correlation [1/s],
:math:`\varepsilon` density of the noise of v [1/s^3].

The paper prints the matrix of the differential equation as if it led from one epoch to the next;
read so, the filter has no gain.  Here the equation is integrated over the interval.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..._jit import inlined, njit
from ...sim.noise import exponential

FloatArray = NDArray[np.float64]
FIRST_COVARIANCE = (2.0, 0.0, 0.0, 1.0, 0.0, 1.0)
"""Of (s, v, a) before the first sample, upper triangle: all four states have variance 1."""


@inlined
def restart(state: FloatArray, covariance: FloatArray) -> None:
    """Forget all samples.  `state`, `covariance` (3,) and (6,), overwritten."""
    state[0] = state[1] = state[2] = 0.0
    covariance[0], covariance[1], covariance[2] = 2.0, 0.0, 0.0
    covariance[3], covariance[4], covariance[5] = 1.0, 0.0, 1.0


@njit
def advance(
    state: FloatArray,
    covariance: FloatArray,
    sample: float,
    interval: float,
    correlation: float,
    noise: float,
    growth: float,
) -> None:
    r"""Predict over an interval, and take in a sample.

    .. math::
        s &\leftarrow s + g v + r a, \qquad v \leftarrow e v + g a,

        e &= e^{-\alpha T}, \quad g = (1 - e) / \alpha, \quad r = (T - g) / \alpha

    then :math:`P \leftarrow \gamma (\Phi P \Phi^T + Q)` and the update with R = 1.

    `state` (3,) s, v, a; overwritten; `covariance` (6,) P_ss, P_sv, P_sa, P_vv, P_va, P_aa;
    overwritten; `interval`: T [s]; `correlation`, `noise`: alpha [1/s] and epsilon [1/s^3];
    `growth`: Gamma, at least 1: how much of the past is forgotten.
    """
    e = exponential(-correlation * interval)
    g = (1.0 - e) / correlation
    r = (interval - g) / correlation
    s = state[0] + g * state[1] + r * state[2]
    v = e * state[1] + g * state[2]
    ss, sv, sa = covariance[0], covariance[1], covariance[2]
    vv, va, aa = covariance[3], covariance[4], covariance[5]
    # Phi P, of which these are needed
    t_ss, t_sv, t_sa = ss + g * sv + r * sa, sv + g * vv + r * va, sa + g * va + r * aa
    t_vv, t_va = e * vv + g * va, e * va + g * aa
    ss = growth * (t_ss + g * t_sv + r * t_sa)
    sv = growth * (e * t_sv + g * t_sa)
    sa = growth * t_sa
    vv = growth * (e * t_vv + g * t_va + noise * interval)
    va = growth * t_va
    aa = growth * aa
    inverse = 1.0 / (ss + 1.0)
    surprise = (sample - s) * inverse
    state[0] = s + ss * surprise
    state[1] = v + sv * surprise
    state[2] += sa * surprise
    covariance[0] = ss * inverse
    covariance[1] = sv * inverse
    covariance[2] = sa * inverse
    covariance[3] = vv - sv * sv * inverse
    covariance[4] = va - sv * sa * inverse
    covariance[5] = aa - sa * sa * inverse
