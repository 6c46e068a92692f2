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
displacement there is no finite bound, unless the attack itself is restricted (`restricted`).

Source: zero-alarm attacks are from Murguia and Ruths (arXiv 1710.04407), worst sequences from
`tanil2018`; the closed forms are ours, each checked against a solver.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, special, stats

from .convex import Program
from .linear import PLACE, LinearRun

FloatArray = NDArray[np.float64]
Kind = Literal["exact", "upper", "unbounded"]


@dataclass(frozen=True)
class Bound:
    """Largest displacement without an alarm.

    Attributes
    ----------
    value_m : float
        The bound [m]; infinite where there is none.
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
    """What each innovation does to the displacement at one epoch in one direction. `direction`:
    unit vector, north and east; `rows`: (K, m) g, so that the displacement is the sum of g' r; 0
    after T; `factor`: (K, m, m) L, Cholesky's factor of S."""

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
        """A bound at this epoch in this direction."""
        kind = kind if np.isfinite(value) else "unbounded"
        return Bound(float(value), kind, self.epoch, self.direction, innovation)

    def along(self, size: FloatArray) -> FloatArray:
        """(K, m) innovations of (K,) whitened sizes in the directions that count most."""
        w = self.weights
        scale = np.divide(size, w, out=np.zeros_like(w), where=w > 0.0)
        return np.asarray(np.einsum("kij,kj->ki", self.factor, self.white * scale[:, None]))


def sensitivity(run: LinearRun, epoch: int, direction: ArrayLike) -> Sensitivity:
    """Go backwards from a displacement to the innovations that lead to it.

    Parameters
    ----------
    run : LinearRun
        A filter over K epochs.
    epoch : int
        T, 0 to K - 1.
    direction : array_like
        (2,) unit vector, north and east.

    Returns
    -------
    Sensitivity
        Exact, as `linear.respond` is.

    Raises
    ------
    ValueError
        When the epoch is not one of the run, or the direction no unit vector.
    """
    epochs = len(run.gain)
    if not 0 <= epoch < epochs:
        raise ValueError(f"`epoch` must be 0 to {epochs - 1}, got {epoch}")
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
    """North and east of a unit vector; a ValueError unless it is one."""
    given = np.asarray(direction, dtype=np.float64)
    if given.shape != (2,) or not abs(np.linalg.norm(given) - 1.0) <= 1e-9:
        raise ValueError(f"`direction` must be a unit vector, north and east, got {direction!r}")
    return float(given[0]), float(given[1])


def snapshot_sizes(weights: FloatArray, thresholds: ArrayLike) -> FloatArray:
    """(K,) whitened sizes that attain the snapshot bound."""
    return np.asarray(np.sqrt(np.broadcast_to(thresholds, weights.shape)) * (weights > 0.0))


def snapshot_bound(of: Sensitivity, thresholds: ArrayLike) -> Bound:
    r"""Snapshot chi-square over all rows, exact: :math:`\sum_k \sqrt{\tau_k} w_k`.

    `thresholds`: of one epoch, a number or (K,).
    """
    size = snapshot_sizes(of.weights, thresholds)
    return of.bound(float(of.weights @ size), "exact", of.along(size))


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


def windowed_upper(of: Sensitivity, window: int, thresholds: ArrayLike) -> Bound:
    r"""Chi-square of a window of epochs over all rows, upper bound by blocks of one window.

    .. math:: \sum_\text{blocks} \sqrt{\tau} \, |w_\text{block}|

    `thresholds`: of the window that ends at an epoch, a number or (K,), infinite where there is no
    verdict.  The smallest over all ways to lay the blocks.
    """
    w = of.weights
    tau, epochs = np.broadcast_to(np.asarray(thresholds, dtype=np.float64), w.shape), len(w)

    def block(first: int, last: int) -> float:  # every window that holds it bounds its energy
        norm = float(np.linalg.norm(w[first : last + 1]))
        return norm * float(np.sqrt(tau[last : min(first + window, epochs)].min())) if norm else 0.0

    def total(offset: int) -> float:
        edges = [*range(offset - window if offset else 0, epochs, window), epochs]
        return sum(block(max(first, 0), end - 1) for first, end in pairwise(edges))

    return of.bound(min(map(total, range(min(window, epochs)))), "upper")


def sequential_sizes(weights: FloatArray, thresholds: ArrayLike) -> FloatArray:
    r"""(K,) whitened sizes that attain the sequential bound.

    The energy that is spent up to an epoch, over the cumulated :math:`w^2`, is the greatest convex
    minorant of the thresholds, since earlier ones bind, too.
    """
    w, tau = weights, np.broadcast_to(thresholds, weights.shape)
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
    return np.asarray(w * np.sqrt(slope[part]))


def sequential_bound(of: Sensitivity, thresholds: ArrayLike) -> Bound:
    """Chi-square of all epochs so far over all rows, exact; `thresholds` (K,) of each epoch."""
    size = sequential_sizes(of.weights, thresholds)
    return of.bound(float(of.weights @ size), "exact", of.along(size))


def sequential_upper(of: Sensitivity, thresholds: ArrayLike) -> Bound:
    r"""Chi-square of all epochs so far, upper bound :math:`|w| \sqrt{\tau_T}`."""
    tau = np.broadcast_to(thresholds, of.weights.shape)[of.epoch]
    return of.bound(float(np.linalg.norm(of.weights) * np.sqrt(tau)), "upper")


def energy_cusum_upper(of: Sensitivity, drift: float, limit: float) -> Bound:
    r"""CUSUM of u'u, upper bound :math:`|w| \sqrt{h + b N}` with N epochs up to T."""
    return of.bound(
        float(np.linalg.norm(of.weights)) * np.sqrt(limit + drift * (of.epoch + 1)), "upper"
    )


def energy_cusum_bound(of: Sensitivity, drift: float, limit: float) -> Bound:
    r"""CUSUM of u'u, exact, by a cone program over the energies z of the epochs.

    .. math:: \max \sum_k w_k \sqrt{z_k}, \qquad C_k \ge C_{k-1} + z_k - b, \quad 0 \le C_k \le h
    """
    program, w = Program(), of.weights
    every = np.ones(len(w), dtype=np.bool_)
    size, energy = program.variables(every), program.variables(every)
    total = program.variables(every, 0.0, limit)
    before = np.append(-1, total[:-1])
    program.below(np.column_stack([before, energy, total]), np.array([[1.0, 1.0, -1.0]]), drift)
    for k in range(len(w)):
        program.energy(size[k : k + 1], int(energy[k]))
    program.maximize(size, w)
    found = program.solve()
    innovation = None if found.x is None else of.along(found.x[size])
    return of.bound(found.value, "exact", innovation)


def sequential_worst_hmi(
    of: Sensitivity, threshold: float, degrees: float, alert_limit_m: float, sd_m: float
) -> tuple[float, float]:
    r"""Largest probability of hazardously misleading information past a sequential chi-square test.

    .. math:: \max_\mu \left[Q\left(\frac{A - g \mu}{\sigma}\right)
        + Q\left(\frac{A + g \mu}{\sigma}\right)\right] F_{\chi^2(d, \mu^2)}(\tau), \qquad g = |w|

    `threshold`, `degrees`: tau and d at the epoch; `alert_limit_m`, `sd_m`: A, and the standard
    deviation of the position error.  Error and test statistic are taken for independent.  Returns
    the probability and mu.  After `joerger2013`.
    """
    gain = float(np.linalg.norm(of.weights))

    def missed(mu: float) -> float:
        ends = (-(alert_limit_m - gain * mu) / sd_m, -(alert_limit_m + gain * mu) / sd_m)
        passed = (
            stats.ncx2.cdf(threshold, degrees, mu * mu) if mu else special.chdtr(degrees, threshold)
        )
        return float(special.ndtr(ends).sum() * passed)

    most = np.sqrt(threshold) + 10.0  # 10 SD beyond the limit nothing passes
    grid = np.linspace(0.0, most, 401)
    best = int(np.argmax([missed(mu) for mu in grid]))
    around = grid[max(best - 1, 0)], grid[min(best + 1, 400)]
    found = optimize.minimize_scalar(lambda mu: -missed(mu), bounds=around, method="bounded")
    return max((missed(float(found.x)), float(found.x)), (missed(grid[best]), float(grid[best])))
