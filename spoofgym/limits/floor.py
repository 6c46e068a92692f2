r"""The floor: the displacement that even a perfect detector would allow, over worlds of a setup.

With R the whitened map from the commands u to the analyst's innovations and n that from them to the
victim's displacement at the end of the command phase, the detectability frontier of a world is

.. math:: \max n^T u \quad \text{subject to} \quad |R u| \le d
    \qquad\Rightarrow\qquad d \sqrt{n^T (R^T R)^{-1} n}

by the triangular factor of R, without a ridge, since a ridge makes a larger feasible set score
less.  It has no end where n leaves the range of :math:`R^T R`: such commands move the victim and
leave no trace.  Where limits of rate or acceleration bind, it is a second-order cone program.

Where every channel can be commanded freely there is a closed form: the shift per d is
:math:`\sigma_{ss}`, the spread of solution separation, :math:`\sigma_{ss}^2 = c^T (P_{coast} -
P) c`; a restricted attack stays below it.

The floor is the frontier over drawn worlds, in metres at a stated probability of a false alarm and
of detection.  A task whose floor lies above its alert limit cannot be defended, and a best attack
that stays below the floor says that the search for it has failed.

What given commands show to a perfect detector, as time goes on, is their `deflection`,

.. math:: d_t^2 = \sum_{k \le t} |R_k u|^2

which bounds the delay of any detection from below, and with it the curve of what is still
undetected.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import qr, solve_triangular

from ..core.registry import whole_number
from ..detectors.base import FloatArray
from ..simulation.setup import generators_of, seeds_of_runs
from ..simulation.tight import TightlyCoupledSetup
from .analyst import Analyst
from .convex import Program
from .linear import Commands, LinearRun, Response, record, respond, unit_commands, white
from .power import deflection_for
from .restricted import Attacker, hold_motion, lead_to

Tick = Callable[[float], None]
HATS = 60
"""Hat functions of the rate, by axis; as many decisions lose 0.1 to 1 % of the frontier."""
HEADINGS = 24
"""Headings of a target direction that is drawn."""
QUANTILES = (0.1, 0.5, 0.9)
ASSUMPTIONS = (
    "the detector sees pseudoranges, range rates and the inertial sensors: no signal strength, "
    "barometer or second antenna",
    "the noise of the world and the parameters of its errors are known to it; no benign event",
    "first order around a clean run, normal errors",
    "the attack is open-loop, tracks its target perfectly and leaves the authentic errors in "
    "place; anything else is seen more easily",
)
"""Under which a floor holds, printed with every figure."""
SENSORS = {
    False: "the constants of the inertial sensors are drawn by their data sheet, and not known",
    True: "the constants of the inertial sensors are known",
}
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
        """(2, 2) matrix M whose c' M c is the square of the frontier at d = 1 along c [m^2],
        infinite where it has no end. `last`, `hold`: epoch at which the displacement counts,
        `self.last` by default, and how many are tested after it, all by default."""
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
        limits, rates = self.commands, self.commands.rates @ commands
        change = np.diff(rates, axis=0, prepend=0.0)
        size = np.linalg.norm if limits.together else np.max
        slack = 1.0 + 1e-6
        return bool(
            size(np.abs(rates), axis=1).max() <= slack * limits.rate_limit_mps
            and size(np.abs(change), axis=1).max() <= slack * limits.change_limit_mps
        )

    def limited(self, direction: FloatArray, deflection: float) -> tuple[float, FloatArray]:
        """Frontier within the attack's limits of rate and acceleration [m], and its commands: by
        the closed form where that keeps them, by a second-order cone program elsewhere."""
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
    pivot = np.abs(np.diag(R))
    rank = int((pivot > SINGULAR * pivot[0]).sum()) if pivot.size else 0
    n = n[:, pivots]
    y = solve_triangular(R[:rank, :rank], n[:, :rank].T, trans="T")
    if rank < n.shape[1]:
        # what commands without a trace would do
        left = n[:, rank:] - y.T @ R[:rank, rank:]
        if np.abs(left).max() > SINGULAR * np.abs(n).max():
            return np.full((2, 2), np.inf)
    return np.asarray(y.T @ y)


def deflection(world: WorldFrontier, commands: FloatArray) -> FloatArray:
    """Deflection of open-loop commands up to every epoch.

    Parameters
    ----------
    world : WorldFrontier
        Of the attack.
    commands : ndarray
        (J,) rates [m/s].

    Returns
    -------
    ndarray
        (K,) d.
    """
    return _accumulated(world.whitened @ commands)


def deflection_of_offsets(analyst: LinearRun, offsets: FloatArray) -> FloatArray:
    """Deflection of what an attack has added to the measurements, whatever commanded it.

    Parameters
    ----------
    analyst : LinearRun
        The analyst's filter of the same sky and flight.
    offsets : ndarray
        (K, m) what was added to pseudoranges and range rates [m], [m/s]; 0 where not visible.

    Returns
    -------
    ndarray
        (K,) d.
    """
    seen = respond(analyst, offsets[:, :, None]).innovation
    return _accumulated(white(analyst.innovation_cov, seen)[:, :, 0])


def _accumulated(y: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.cumsum((y * y).sum(axis=1))))


@dataclass(frozen=True)
class Frontier:
    """The frontier of a setup, over W drawn runs.

    Attributes
    ----------
    per_deflection : ndarray
        (W, 2, 2) matrices M; the frontier at d = 1 along a unit vector c is the root of c' M c [m];
        infinite where it has no end.
    coasting : ndarray
        (W, 2, 2) the same by the closed form, for an attack that commands every channel freely.
    heading : float or None
        Direction that counts, clockwise from north [rad]; None where it is drawn, or any one is.
    sensors_known : bool
        Whether the constants of the inertial sensors are known.
    any_direction : bool
        Whether displacement counts in any direction, so that the attack goes where it gets
        farthest.
    one : WorldFrontier
        Of the first run.
    times_s : ndarray
        (E,) times since the onset at which the frontier is known, too [s].
    course : ndarray
        (W, E, 2, 2) what `per_deflection` is for attacks that aim at these times.
    """

    per_deflection: FloatArray
    coasting: FloatArray
    heading: float | None
    sensors_known: bool
    any_direction: bool
    one: WorldFrontier
    times_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    course: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 2, 2)))

    def sizes(self, *, free: bool = False) -> FloatArray:
        """(N,) frontiers at d = 1 over worlds and headings [m]; `free` for the closed form."""
        return self._sizes(self.coasting if free else self.per_deflection)

    def _sizes(self, matrices: FloatArray) -> FloatArray:
        if self.any_direction:
            bad = np.asarray(~np.isfinite(matrices).all(axis=(1, 2)))
            largest = np.linalg.eigvalsh(np.where(bad[:, None, None], 0.0, matrices))[:, -1]
            return np.sqrt(np.where(bad, np.inf, np.maximum(largest, 0.0)))
        angles = np.array([self.heading])
        if self.heading is None:
            angles = np.arange(HEADINGS) * (np.pi / HEADINGS)
        c = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        with np.errstate(invalid="ignore"):
            squares: FloatArray = np.einsum("hi,wij,hj->wh", c, matrices, c)
        return np.sqrt(np.where(np.isfinite(squares), squares, np.inf)).ravel()

    def floor_m(
        self, p_fa: float, p_d: float, *, heading: str = "unknown", quantile: float = 0.5
    ) -> float:
        """Displacement that a perfect detector allows.

        Parameters
        ----------
        p_fa, p_d : float
            Probabilities of a false alarm, and of detection, in (0, 1).
        heading : {"known", "unknown"}
            Whether the detector knows the heading of the attack; it knows the rest.
        quantile : float
            Of the worlds, 0 to 1.

        Returns
        -------
        float
            The floor [m]; infinite where the frontier has no end.
        """
        d = deflection_for(p_fa, p_d, heading=heading)
        return float(d * np.quantile(self.sizes(), quantile, method="nearest"))

    def course_m(
        self, p_fa: float, p_d: float, *, heading: str = "unknown", quantile: float = 0.5
    ) -> FloatArray:
        """(E,) floors of attacks that aim at `times_s` [m]; arguments as of `floor_m`."""
        d = deflection_for(p_fa, p_d, heading=heading)
        each = (self._sizes(self.course[:, e]) for e in range(len(self.times_s)))
        return np.array([d * np.quantile(of, quantile, method="nearest") for of in each])

    @property
    def assumptions(self) -> tuple[str, ...]:
        return (*ASSUMPTIONS, SENSORS[self.sensors_known])


def frontier_of(
    setup: TightlyCoupledSetup,
    *,
    worlds: int = 8,
    sensors_known: bool = False,
    entropy: int = 0,
    times: int = 0,
    tick: Tick | None = None,
) -> Frontier:
    """Compute the detectability frontier of a setup.

    Parameters
    ----------
    setup : TightlyCoupledSetup
        World, victim, attack and timeline; the detector does not matter.
    worlds : int
        Runs whose worlds are drawn, at least 1; one is enough where nothing is drawn.
    sensors_known : bool
        Whether the constants of the inertial sensors are known to the perfect detector.
    entropy : int
        Seed of the random number generators.
    times : int
        At how many equally spaced times of the command phase the frontier is wanted, too.
    tick : callable, optional
        Is given the part of the work that has been done.

    Returns
    -------
    Frontier
        At the end of the command phase, with the time to alert tested, too.

    Raises
    ------
    ValueError
        When the victim has no linear model here, or the attack is not linear in its commands or
        does something without any.

    Examples
    --------
    >>> from spoofgym.limits import frontier_of
    >>> from spoofgym.simulation import TightlyCoupledSetup
    >>> found = frontier_of(TightlyCoupledSetup(detector="never"))
    >>> round(found.floor_m(0.01, 0.5), 1)
    4.7
    """
    check_linear_victim(setup)
    count = whole_number("`worlds`", worlds, 1)
    lasts = _epochs(setup.steps, whole_number("`times`", times, 0))
    if setup.bounds._replace(heading=0.0).single:
        count = 1
    advance = tick or (lambda part: None)
    analyst = Analyst(setup, sensors_known=sensors_known)
    found: list[WorldFrontier] = []
    matrices, coasting, course = [], [], []
    for run in range(count):
        seeds = seeds_of_runs(entropy, "selection", setup.name, [run])
        victim = record(setup, generators_of(seeds))[0]
        again = seeds_of_runs(entropy, "selection", setup.name, [run])
        its_analyst = analyst.record(generators_of(again))[0]
        commands = _commands(setup, victim.onset)
        last = setup.steps - 1
        each = world_frontier(commands, victim, its_analyst.linear, its_analyst.coasting, last)
        found = found or [each]
        matrices.append(each.per_deflection())
        course.append(each.course(lasts, setup.hold))
        coasting.append(each.coasting)
        advance(1.0 / count)
    fixed = setup.target_heading_deg
    heading = None if isinstance(fixed, str) else float(np.radians(fixed))
    return Frontier(
        np.array(matrices),
        np.array(coasting),
        heading,
        sensors_known,
        fixed == "worst",
        found[0],
        (np.array(lasts, dtype=np.float64) + 1.0) * setup.interval_s,
        np.array(course),
    )


def _commands(setup: TightlyCoupledSetup, onset: int) -> Commands:
    commands = unit_commands(setup, onset).in_hats(HATS)
    if np.any(commands.idle):
        raise ValueError(
            f"no floor is known for {setup.attack.label!r}: it changes the measurements when it is "
            "commanded nothing, and the frontier is of what commands do"
        )
    return commands


def _epochs(steps: int, times: int) -> list[int]:
    return sorted({round(steps * (k + 1) / times) - 1 for k in range(times)} - {-1})


def check_linear_victim(setup: Any) -> TightlyCoupledSetup:
    if not isinstance(setup, TightlyCoupledSetup):
        raise ValueError(
            f"limits are known for tightly coupled receivers alone, not for {setup.whose}"
        )
    return setup
