r"""Zero-alarm bound: how far an attack gets that never lifts a statistic over its threshold.

The largest displacement c' e of the estimate at an epoch T that any attack reaches, feedback
included, while its own shift of the innovations keeps the statistic at or below its threshold at
every epoch.  With r the shift of the innovations (`linear`), free inertial propagation and the
gains alone lead to the displacement,

.. math:: c^T e_T = \sum_{k \le T} g_k^T r_k, \qquad g_k = -K_k^T v_k, \quad
    v_T = c, \quad v_{k-1} = \Phi_k^T v_k,

and with :math:`S_k = L_k L_k^T`, :math:`G_k = L_k^T g_k`, :math:`w_k = |G_k|` many tests have a
closed form.

What it bounds: for gains that stay as they are, a no-alarm set that is convex and symmetric, and
clean innovations of mean zero, the value is concave in the clean innovations, so that by Jensen it
is an upper bound of the *mean signed* displacement of any spoofer, even of one that knows all
noise.  It is no bound of a quantile or of a single run, and none for tests that take weight off
measurements, exclude them or are not convex.

A test leaves the innovations that it does not judge to the attack: where these lead to a
displacement there is no finite bound, unless the attack itself is restricted (`bounds`).

Source: zero-alarm attacks are from Murguia and Ruths (arXiv 1710.04407), worst sequences from
`tanil2018`; the closed forms are ours, each checked against a solver.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..core.declared import check_number
from ..detectors.base import FloatArray
from .linear import PLACE, LinearRun

Kind = Literal["exact", "upper", "unbounded"]


@dataclass(frozen=True)
class Bound:
    """Largest displacement without an alarm.

    Attributes
    ----------
    value_m : float
        The bound [m]; infinite without one.
    kind : {"exact", "upper", "unbounded"}
        Whether an attack attains it, none exceeds it, or there is no finite one.
    epoch : int
        T, epoch of the run at which the displacement is taken.
    direction : tuple of float
        Unit vector of the displacement, north and east.
    innovation : ndarray or None
        (K, m) shift of the innovations that attains it [m], [m/s].
    commands : ndarray or None
        (J,) commands that attain it, of a restricted attacker.
    note : str
        Why it is no more than an upper bound; "" where there is nothing to say.
    """

    value_m: float
    kind: Kind
    epoch: int
    direction: tuple[float, float]
    innovation: FloatArray | None = None
    commands: FloatArray | None = None
    note: str = ""


class Sensitivity(NamedTuple):
    """What each innovation does to the displacement at an epoch T along a unit vector, north and
    east. `rows`: (K, m) g, so that the displacement is the sum of g' r; 0 after T; `factor`:
    (K, m, m) L, Cholesky's factor of S."""

    epoch: int
    direction: tuple[float, float]
    rows: FloatArray
    factor: FloatArray

    @property
    def white(self) -> FloatArray:
        """(K, m) G = L' g."""
        return np.asarray(np.einsum("kij,ki->kj", self.factor, self.rows))

    @property
    def weights(self) -> FloatArray:
        """(K,) w = |G|."""
        return np.asarray(np.linalg.norm(self.white, axis=1))

    def bound(
        self, value: float, kind: Kind = "exact", innovation: FloatArray | None = None
    ) -> Bound:
        kind = kind if np.isfinite(value) else "unbounded"
        return Bound(float(value), kind, self.epoch, self.direction, innovation)

    def build_exact_bound(self, size: FloatArray) -> Bound:
        """Exact bound by innovations of (K,) whitened sizes in the directions that count most."""
        w = self.weights
        scale = np.divide(size, w, out=np.zeros_like(w), where=w > 0.0)
        innovation = np.einsum("kij,kj->ki", self.factor, self.white * scale[:, None])
        return self.bound(float(w @ size), "exact", innovation)


def sensitivity(run: LinearRun, epoch: int, direction: ArrayLike) -> Sensitivity:
    epochs = len(run.gain)
    check_number("epoch", epoch, least=0, most=epochs - 1, whole=True)
    north, east = checked_direction(direction)
    v = np.zeros(run.transition.shape[1])
    v[PLACE] = run.axes[epoch] @ np.array([north, east, 0.0])
    rows = np.zeros(run.design.shape[:2])
    for k in range(epoch, -1, -1):
        rows[k] = -run.gain[k].T @ v
        v = run.transition[k].T @ v
    factor = np.asarray(np.linalg.cholesky(run.innovation_cov))
    return Sensitivity(epoch, (north, east), rows, factor)


def checked_direction(direction: ArrayLike) -> tuple[float, float]:
    given = np.asarray(direction, dtype=np.float64)
    if given.shape != (2,) or not abs(np.linalg.norm(given) - 1.0) <= 1e-9:
        raise ValueError(f"`direction` must be a unit vector, north and east, got {direction!r}")
    return float(given[0]), float(given[1])


def snapshot_bound(of: Sensitivity, thresholds: ArrayLike) -> Bound:
    r"""Snapshot chi-square over all rows, exact: :math:`\sum_k \sqrt{\tau_k} w_k`.

    `thresholds`: tau of one epoch, a number or (K,).
    """
    w = of.weights
    return of.build_exact_bound(np.sqrt(np.broadcast_to(thresholds, w.shape)) * (w > 0.0))


def ewma_bound(of: Sensitivity, smoothing: float, limits: ArrayLike) -> Bound:
    r"""EWMA chart of every row, exact where all rows are judged.

    .. math:: \frac{1}{\lambda} \sum_{k,j} T_{k,j} |g_{k,j} - (1 - \lambda) g_{k+1,j}|

    `limits`: T, a number or (K, m), on the average of the innovation itself [m], [m/s], 0 where a
    slot is not visible; the average is 0 before the first epoch.  With `smoothing` 1 it is
    Shewhart's chart.
    """
    later = np.vstack([of.rows[1:], np.zeros_like(of.rows[:1])])
    difference = (of.rows - (1.0 - smoothing) * later) / smoothing
    average = np.sign(difference) * np.broadcast_to(limits, of.rows.shape)
    before = np.vstack([np.zeros_like(average[:1]), average[:-1]])
    innovation = (average - (1.0 - smoothing) * before) / smoothing
    return of.bound(float((difference * average).sum()), "exact", innovation)


def sequential_bound(of: Sensitivity, thresholds: ArrayLike) -> Bound:
    r"""Exact bound of the chi-square over all rows of all epochs so far; `thresholds` (K,).

    The energy that the best attack spends up to an epoch, as a function of the cumulated
    :math:`w^2`, is the greatest convex minorant of the thresholds, since earlier ones bind, too.
    """
    w, tau = of.weights, np.broadcast_to(thresholds, of.weights.shape)
    x = np.append(0.0, np.cumsum(w * w))
    y = np.append(0.0, np.minimum.accumulate(tau[::-1])[::-1])  # later ones bind what is spent
    last = int(np.flatnonzero(w > 0.0).max(initial=-1)) + 1
    corners = [0]
    for n in np.flatnonzero(w[:last] > 0.0) + 1:
        while len(corners) > 1:
            a, b = corners[-2], corners[-1]
            if (y[b] - y[a]) * (x[n] - x[b]) < (y[n] - y[b]) * (x[b] - x[a]):
                break
            corners.pop()
        corners.append(int(n))
    slope = np.append(np.diff(y[corners]) / np.diff(x[corners]), 0.0)
    part = np.searchsorted(corners[1:], np.arange(1, len(w) + 1), side="left")
    return of.build_exact_bound(w * np.sqrt(slope[part]))
