r"""The noise that would mend a log: its filter, run again to first order with another R.

A log with the matrices of its filter has all that this takes.  With R = S - H P H' and the process
noise Q that leads from one P to the next, covariances follow for any R; and where gains differ, the
estimate moves by d, and the innovations with it,

.. math:: d_k^- = \Phi_k d_{k-1}, \qquad z'_k = z_k + H_k d_k^-, \qquad
    d_k = d_k^- - K'_k z'_k + K_k z_k
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .log import InnovationLog

FloatArray = NDArray[np.float64]
NEEDED = "design", "transition", "predicted_cov"
MOST_EPOCHS, ROUNDS = 2000, 25
SETTLED = 0.002  # of a factor, from one round to the next
BOUNDS = 0.02, 50.0
"""Of a factor; one that gets there mends nothing."""


class NoiseFactor(NamedTuple):
    """What would mend a signal.

    - `nis`: mean of z' S^-1 z over the degrees of freedom, 1 where innovations fit; `factor` on the
      standard deviations of R with which it would be, None where none does; `mended`: what it would
      be with the factors.
    """

    nis: float
    factor: float | None
    mended: float


def fit_noise_factors(log: InnovationLog) -> dict[str, NoiseFactor]:
    """Factors on the noise by signal, from the first `MOST_EPOCHS`; none where the log lacks
    `NEEDED`, or these do not fit its S."""
    rows = slice(0, MOST_EPOCHS)
    if not log.more.keys() >= set(NEEDED):
        return {}
    epoch, seen = log.gather_epoch(rows), log.judged[rows]
    P, H = log.more["predicted_cov"][rows], log.more["design"][rows] * seen[:, :, None]
    Phi, z, S = log.more["transition"][rows], epoch.innovation, np.asarray(epoch.innovation_cov)
    HP = H @ P
    R = S - HP @ H.transpose(0, 2, 1)
    if (np.diagonal(R, axis1=1, axis2=2) <= 0.0).any():
        return {}
    gain = log.more.get("gain", np.linalg.solve(S, HP).transpose(0, 2, 1))[rows]
    starts = np.diff(log.segment[rows], prepend=log.segment[0] - 1) != 0
    Q = P[1:] - Phi[1:] @ (P - gain @ HP)[:-1] @ Phi[1:].transpose(0, 2, 1)
    n, count = len(log.channels), np.maximum(seen.reshape(len(z), 2, -1).sum(axis=(0, 2)), 1)

    def rerun(factors: FloatArray) -> FloatArray:
        """(2,) NIS over degrees of freedom, by signal."""
        f, total = np.repeat(factors, n), np.zeros(2)
        noise, p, d = R * np.outer(f, f), P[0], np.zeros(P.shape[1])
        for k in range(len(z)):
            p, d = Phi[k] @ p @ Phi[k].T + Q[k - 1], Phi[k] @ d
            if starts[k]:
                p, d = P[k], np.zeros_like(d)
            hp, own = H[k] @ p, z[k] + H[k] @ d
            s = hp @ H[k].T + noise[k]
            new = np.linalg.solve(s, hp).T
            p, d = p - new @ hp, d - new @ own + gain[k] @ z[k]
            for j, part in enumerate((slice(0, n), slice(n, None))):
                here = np.where(seen[k, part], own[part], 0.0)
                total[j] += here @ np.linalg.solve(s[part, part], here)
        return np.asarray(total / count)

    factors, before = np.ones(2), np.zeros(2)
    first = nis = rerun(factors)
    for _ in range(ROUNDS):
        before, factors = factors, np.clip(factors * np.sqrt(np.maximum(nis, 1e-12)), *BOUNDS)
        nis = rerun(factors)
        if np.abs(np.log(factors / before)).max() < SETTLED:
            break
    mends = (factors > BOUNDS[0]) & (factors < BOUNDS[1])
    return {
        name: NoiseFactor(float(first[j]), float(factors[j]) if mends[j] else None, float(nis[j]))
        for j, name in enumerate(log.signals)
        if name in log.present_signals
    }
