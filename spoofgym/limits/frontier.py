r"""The detectability frontier: the displacement that even a perfect detector would allow.

With R the whitened map from the commands u to the analyst's innovations and n that from them to the
victim's displacement at the end of the command phase,

.. math:: \max n^T u \quad \text{subject to} \quad |R u| \le d
    \qquad\Rightarrow\qquad d \sqrt{n^T (R^T R)^{-1} n}

by the triangular factor of R, without a ridge, since a ridge makes a larger feasible set score
less.  It has no end where n leaves the range of :math:`R^T R`: such commands move the victim and
leave no trace.  Where limits of rate or acceleration bind, it is a second-order cone program.

Where every channel can be commanded freely there is a closed form: the shift per d is
:math:`\sigma_{ss}`, the spread of solution separation, :math:`\sigma_{ss}^2 = c^T (P_{coast} -
P) c`; a restricted attack stays below it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular

from .commands import Commands
from .convex import Program
from .linear import LinearRun, Response, respond, white
from .restricted import Attacker, hold_motion, lead_to

FloatArray = NDArray[np.float64]
SINGULAR = 1e-9
"""Smallest pivot of R, as a part of the largest, that is not taken for 0."""


@dataclass(frozen=True)
class WorldFrontier:
    """The frontier of one world.

    Attributes
    ----------
    commands : Commands
        Of the attack.
    whitened : ndarray
        (K, m, J) R by epoch.
    victim : Response
        Of the victim to the unit commands.
    last : int
        Epoch, from the onset, at which the displacement counts.
    coasting : ndarray
        (2, 2) :math:`P_{coast} - P` at `last`, north and east [m^2].
    """

    commands: Commands
    whitened: FloatArray
    victim: Response
    last: int
    coasting: FloatArray

    def factor(self, epochs: int | None = None) -> FloatArray:
        """(J, J) triangular factor of R over some first epochs, all by default."""
        rows = self.whitened[:epochs].reshape(-1, self.whitened.shape[2])
        return np.asarray(np.linalg.qr(rows, mode="r"))

    def per_deflection(self, last: int | None = None, hold: int | None = None) -> FloatArray:
        """(2, 2) matrix M whose c' M c is the square of the frontier at d = 1 along c [m^2].
        Infinite where the frontier has no end. `last`, `hold`: epoch at which the displacement
        counts, and how many are tested after it; `self.last` and all by default."""
        last = self.last if last is None else last
        epochs = None if hold is None else last + 1 + hold
        n = self.victim.position[last, :2]
        # commands so far, with those that move the victim and leave no trace
        used = np.abs(self.whitened[:epochs]).max(axis=(0, 1)) + np.abs(n).max(axis=0) > 0.0
        rows = self.whitened[:epochs][:, :, used].reshape(-1, int(used.sum()))
        return reachable(rows, n[:, used])

    def course(self, lasts: Sequence[int], hold: int) -> FloatArray:
        """(E, 2, 2) what `per_deflection` gives for E epochs in order, with one factor for all."""
        found, done = np.empty((len(lasts), 2, 2)), 0
        R = np.zeros((0, self.whitened.shape[2]))
        for e, last in enumerate(lasts):
            until = last + 1 + hold
            rows = self.whitened[done:until].reshape(-1, R.shape[1])
            R, done = np.asarray(np.linalg.qr(np.vstack([R, rows]), mode="r")), until
            found[e] = reachable(R, self.victim.position[last, :2])
        return found

    def best(self, direction: FloatArray, deflection: float) -> FloatArray:
        """(J,) commands that reach the frontier along a direction, (2,) north and east [m/s]."""
        n = direction @ self.victim.position[self.last, :2]
        _, sizes, axes = np.linalg.svd(self.factor())
        seen = sizes > SINGULAR * sizes[0]  # the others do nothing, where there is an end
        y = (axes[seen] @ n) / sizes[seen]
        return np.asarray(axes[seen].T @ (y / sizes[seen]) * deflection / np.linalg.norm(y))

    def within_limits(self, commands: FloatArray) -> bool:
        """Whether commands keep the attack's limits."""
        limits, rates = self.commands, self.commands.rates @ commands
        change = np.diff(rates, axis=0, prepend=0.0)
        size = np.linalg.norm if limits.together else np.max
        slack = 1.0 + 1e-6
        return bool(
            size(np.abs(rates), axis=1).max() <= slack * limits.rate_limit_mps
            and size(np.abs(change), axis=1).max() <= slack * limits.change_limit_mps
        )

    def limited(self, direction: FloatArray, deflection: float) -> tuple[float, FloatArray]:
        """Frontier within the attack's limits of rate and acceleration [m], and its commands. It
        takes the closed form where that keeps them, and a second-order cone program elsewhere."""
        n = direction @ self.victim.position[self.last, :2]
        if np.isfinite(self.per_deflection()).all():
            u = self.best(direction, deflection)
            if self.within_limits(u):
                return float(n @ u), u
        limits, program = self.commands, Program()
        ids = program.variables(np.ones(len(n), dtype=np.bool_))
        program.maximize(ids, n)
        motion = limits.rate_limit_mps, limits.change_limit_mps, limits.together
        hold_motion(program, ids, Attacker(self.victim, limits.rates, *motion))
        seen = program.variables(np.ones(len(n), dtype=np.bool_))
        lead_to(program, ids, self.factor(), seen)
        program.ball(seen, deflection)
        found = program.solve()
        if found.x is None:
            return math.inf, np.full(len(n), np.nan)
        u = found.x[ids]
        return float(n @ u), u


def world_frontier(
    commands: Commands, victim: LinearRun, analyst: LinearRun, coasting: FloatArray, last: int
) -> WorldFrontier:
    """Frontier of one world from a run of the victim's and of the analyst's filter."""
    seen = respond(analyst, commands.offsets).innovation
    return WorldFrontier(
        commands,
        white(analyst.innovation_cov, seen),
        respond(victim, commands.offsets),
        last,
        coasting[last, :2, :2],
    )


def reachable(rows: FloatArray, n: FloatArray) -> FloatArray:
    """(2, 2) n (R'R)^-1 n' of rows R (k, J) and n (2, J); infinite where n leaves their range."""
    R, pivots = qr(np.linalg.qr(rows, mode="r"), mode="r", pivoting=True)  # few rows to pivot
    R = R[: rows.shape[1]]
    sizes_ = np.abs(np.diag(R))
    rank = int((sizes_ > SINGULAR * sizes_[0]).sum()) if sizes_.size else 0
    n = n[:, pivots]
    y = solve_triangular(R[:rank, :rank], n[:, :rank].T, trans="T")
    if rank < n.shape[1]:
        # what commands without a trace would do
        left = n[:, rank:] - y.T @ R[:rank, rank:]
        if np.abs(left).max() > SINGULAR * np.abs(n).max():
            return np.full((2, 2), np.inf)
    return np.asarray(y.T @ y)
