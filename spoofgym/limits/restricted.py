r"""Zero-alarm bound for a detector, of an attack that may do anything or is held by its commands.

A restricted attack is linear in its commands u: with the response of the innovations to a unit of
each (`linear.respond`), the displacement n' u is largest where the test raises no alarm, and

.. math:: |\dot D_i| \le r, \qquad |\dot D_i - \dot D_{i-1}| \le a \tau, \qquad \dot D_{-1} = 0

for the rates of its false position at every epoch, which are linear in u, too.  That is a linear
program for tests of single channels, and a second-order cone program for chi-square tests or
commands of two axes.  The commands that attain it can be played.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..detectors import Detector
from ..detectors.base import FloatArray, IntArray
from .convex import Optimum, Program
from .linear import LinearRun, Response
from .no_alarm import Judged, Timing, judged_by
from .zero_alarm import Bound, Kind, Sensitivity, checked_direction, sensitivity

UNSEEN = 1e-9
"""Part of a sensitivity outside the rows that are judged from which on it counts."""


class Attacker(NamedTuple):
    """What a restricted attack can do.

    Attributes
    ----------
    response : Response
        What each of J unit commands does to the filter, over K epochs.
    rates : ndarray
        (E, a, J) rate of the false position at each epoch along each axis, per unit command [m/s].
    rate_limit_mps : float
        r, limit of the size of the rate [m/s]; infinite for none.
    change_limit_mps : float
        a tau, limit of its change from one epoch to the next [m/s]; infinite for none.
    together : bool
        Whether the limits hold for the vector of all axes, not for each of them.
    """

    response: Response
    rates: FloatArray
    rate_limit_mps: float = math.inf
    change_limit_mps: float = math.inf
    together: bool = True

    def profile(self, commands: FloatArray) -> FloatArray:
        """(E, a) rates of (J,) commands [m/s]."""
        return np.asarray(self.rates @ commands)


def zero_alarm_of(
    detector: Detector,
    run: LinearRun,
    timing: Timing,
    *,
    epoch: int,
    direction: ArrayLike,
    attacker: Attacker | None = None,
) -> Bound:
    """Largest displacement at an epoch along a direction that raises no alarm at any epoch.

    Parameters
    ----------
    detector : Detector
        Passive, with a convex no-alarm set; `Calibrated` with its factors.
    run : LinearRun
        K epochs, all of which are tested.
    timing : Timing
        How long the detector has been live.
    epoch : int
        T, 0 to K - 1.
    direction : array_like
        (2,) unit vector, north and east.
    attacker : Attacker, optional
        What the attack can do; any shift of the measurements by default.

    Returns
    -------
    Bound
        Exact to the solver's tolerance, 1e-8, or unbounded; an upper bound, with a note, where the
        solver stopped short of it.

    Raises
    ------
    ValueError
        When the detector has no bound of this kind, with what holds instead; or an argument is out
        of range.
    RuntimeError
        When the solver finds neither an optimum nor an upper bound.
    """
    of = sensitivity(run, epoch, direction)
    test = judged_by(detector, run, timing)
    return _free(test, of) if attacker is None else _restricted(test, epoch, direction, attacker)


def _free(test: Judged, of: Sensitivity) -> Bound:
    worth = np.zeros(test.matrix.shape[:2])
    inverse = np.asarray(np.linalg.pinv(test.matrix))
    for k, g in enumerate(of.rows):
        worth[k] = inverse[k].T @ g
        if np.linalg.norm(test.matrix[k].T @ worth[k] - g) > UNSEEN * np.linalg.norm(g):
            return of.bound(np.inf)
    if test.closed is not None:
        return test.closed(of)
    w = np.linalg.norm(worth, axis=1)
    along = np.divide(worth, w[:, None], out=np.zeros_like(worth), where=w[:, None] > 0.0)
    program, active = Program(), np.asarray(test.matrix.any(axis=2))
    if test.rotates:
        active = np.asarray(active.any(axis=1, keepdims=True))
    ids = program.variables(active)
    program.maximize(ids, w[:, None] if test.rotates else worth)
    test.hold(program, ids)
    found = program.solve()
    if found.x is None:
        return not_attained(found, of.epoch, of.direction)
    y = np.append(found.x, 0.0)[ids]
    y = y * along if test.rotates else y
    return of.bound(found.value, "exact", np.einsum("kmr,kr->km", inverse, y))


def _restricted(test: Judged, epoch: int, direction: ArrayLike, attacker: Attacker) -> Bound:
    north, east = checked_direction(direction)
    n = np.array([north, east]) @ attacker.response.position[epoch, :2]
    program = Program()
    commands = program.variables(np.ones(len(n), dtype=np.bool_))
    program.maximize(commands, n)
    hold_motion(program, commands, attacker)
    active = np.asarray(test.matrix.any(axis=2))
    ids = program.variables(active)
    lead_to(program, commands, test.seen(attacker.response.innovation)[active], ids[active])
    test.hold(program, ids)
    found = program.solve()
    if found.x is None:
        return not_attained(found, epoch, (north, east))
    u = found.x[commands]
    innovation = attacker.response.innovation @ u
    return Bound(float(n @ u), "exact", epoch, (north, east), innovation, u)


def not_attained(found: Optimum, epoch: int, direction: tuple[float, float]) -> Bound:
    kind: Kind = "upper" if np.isfinite(found.value) else "unbounded"
    return Bound(found.value, kind, epoch, direction, note=found.note)


def lead_to(program: Program, commands: IntArray, matrix: FloatArray, ids: IntArray) -> None:
    """Variables (p,) that are a matrix (p, J) times the commands."""
    columns = np.column_stack([np.tile(commands, (len(ids), 1)), ids])
    program.equal(columns, np.column_stack([matrix, np.full(len(ids), -1.0)]))


def hold_motion(program: Program, commands: IntArray, attacker: Attacker) -> None:
    for name in ("rate_limit_mps", "change_limit_mps"):
        if not getattr(attacker, name) > 0.0:
            raise ValueError(f"`{name}` must be > 0, got {getattr(attacker, name)}")
    epochs, axes, _ = attacker.rates.shape
    single = axes == 1 or not attacker.together
    top = attacker.rate_limit_mps if single else math.inf
    rate = program.variables(np.ones((epochs, axes), dtype=np.bool_), -top, top)
    lead_to(program, commands, attacker.rates.reshape(epochs * axes, -1), rate.ravel())
    if not single:
        for row in rate:
            program.ball(row, attacker.rate_limit_mps)
    if math.isinf(attacker.change_limit_mps):
        return
    before = np.vstack([np.full((1, axes), -1), rate[:-1]])
    top = attacker.change_limit_mps if single else math.inf
    change = program.variables(np.ones((epochs, axes), dtype=np.bool_), -top, top)
    columns = np.column_stack([each.ravel() for each in (rate, before, change)])
    program.equal(columns, np.array([[1.0, -1.0, -1.0]]))
    if not single:
        for row in change:
            program.ball(row, attacker.change_limit_mps)
