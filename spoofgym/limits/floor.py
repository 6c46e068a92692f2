r"""The floor: the displacement that even a perfect detector would allow, over worlds of a setup.

With R the whitened map from the commands u to the analyst's innovations and n that from them to the
victim's displacement at the end of the command phase, the detectability frontier of a world is

.. math:: \max n^T u \quad \text{subject to} \quad |R u| \le d
    \qquad\Rightarrow\qquad d \sqrt{n^T (R^T R)^{-1} n}

by the triangular factor of R, without a ridge, since a ridge makes a larger feasible set score
less.  It has no end where n leaves the range of :math:`R^T R`: such commands move the victim and
leave no trace.

Where every channel can be commanded freely there is a closed form: the shift per d is
:math:`\sigma_{ss}`, the spread of solution separation, :math:`\sigma_{ss}^2 = c^T (P_{coast} -
P) c`; a restricted attack stays below it.

The floor is the frontier over drawn worlds, in metres at a stated probability of a false alarm and
of detection.  A task whose floor lies above its alert limit cannot be defended, and a best attack
that stays below the floor says that the search for it has failed.

**The analyst** is the perfect detector's filter, which knows the world.  The innovations of a
filter that believes in other noise than there is are not white, so that a sum of
:math:`\rho^T S^{-1} \rho` over epochs says nothing of how well an attack can be seen.  The analyst
has the true noise, and states for constant and wandering errors of satellites, for the clock, and
for the constants of the inertial sensors.  Its innovations are white with covariance :math:`S^*`.
With :math:`\rho^*` the shift that an attack brings to them,

.. math:: d^2 = \sum_k \rho_k^{*T} S_k^{*-1} \rho_k^*

is the deflection of the likelihood-ratio test that knows the attack.  The victim's innovations, by
any gain and any weights, are an invertible function of the same measurements, so that no detector
does better; the victim's gain decides how far it is moved, and not whether it can be seen.  This is
for benchmarks alone: no detector may see what the analyst knows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import qr, solve_triangular

from ..core.registry import whole_number
from ..detectors import Never
from ..detectors.base import FloatArray
from ..receiver import TightlyCoupled
from ..receiver.augmented import FIRST
from ..receiver.states import ACCEL_BIAS, STATES
from ..simulation.setup import make_generators, seeds_of_runs
from ..simulation.simulator import FixedChoices
from ..simulation.tight import TightlyCoupledSetup, TightlyCoupledSimulator
from ..truth.events import BenignEvents
from .linear import (
    PLACE,
    Commands,
    LinearRun,
    Response,
    as_it_happens,
    observer,
    record,
    record_from,
    respond,
    run_to_onset,
    unit_commands,
    white,
)
from .power import deflection_for

WorkCallback = Callable[[float], None]
HATS = 60  # hat functions of the rate, by axis; as many decisions lose 0.1 to 1 % of the frontier
HEADINGS = 24  # of a target direction that is drawn
QUANTILES = (0.1, 0.5, 0.9)
RESAMPLES = 2000  # of worlds, for the interval of their median
ASSUMPTIONS = (
    "the detector sees pseudoranges, range rates and the inertial sensors: no signal strength, "
    "barometer or second antenna",
    "the noise of the world and the parameters of its errors are known to it; no benign event",
    "first order around a clean run, normal errors",
    "the attack is open-loop, tracks its target perfectly and leaves the authentic errors in "
    "place; anything else is seen more easily",
)
SENSORS = {
    False: "the constants of the inertial sensors are drawn by their data sheet, and not known",
    True: "the constants of the inertial sensors are known",
}
SINGULAR = 1e-9  # smallest pivot of R, as a part of the largest, that is not taken for 0
SENSOR_CONSTANTS = np.r_[ACCEL_BIAS : STATES - 2, STATES:FIRST]


class AnalystRun(NamedTuple):
    r"""The analyst's filter over one run, from the onset on.

    `coasting` (K, 3, 3) is :math:`P_{coast} - P`, north, east, down [m^2]: what a filter that takes
    no measurement since the onset does not know of the position, and this one does.
    """

    linear: LinearRun
    coasting: FloatArray


class Analyst:
    """The filter that knows the world of a setup.

    Parameters
    ----------
    setup : TightlyCoupledSetup
        World, attack and timeline; its receiver and detector do not matter.
    sensors_known : bool
        Whether the constants of the inertial sensors are known, and not drawn for every run.

    Attributes
    ----------
    setup : TightlyCoupledSetup
        Of the analyst's own filter, which is fed the same measurements as the victim's.

    Raises
    ------
    ValueError
        When the domain has several grades or errors, or other constants from world to world.
    """

    def __init__(self, setup: TightlyCoupledSetup, *, sensors_known: bool = False) -> None:
        domain = replace(setup.domain, events=BenignEvents())
        scenario = replace(setup.scenario, assumed=None, events=None)
        self.sensors_known = sensors_known
        self.setup = TightlyCoupledSetup(
            scenario=scenario,
            detector=Never(),
            attack=setup.attack,
            receiver=TightlyCoupled(grade=_grade(setup), tuning="augmented"),
            timeline=setup.timeline,
            domain=replace(domain, imu=()),
            target_heading_deg=setup.target_heading_deg,
            decision_interval_s=setup.decision_interval_s,
            between=setup.between,
        )
        # which refuses worlds that the filter does not fit
        self.setup.combinations.signal_model(self.setup.interval_s)

    def start_simulator(
        self, rngs: Sequence[np.random.Generator], given: FixedChoices | None = None
    ) -> TightlyCoupledSimulator:
        simulator = observer(self.setup, len(rngs))
        simulator.start_episodes(rngs, given)
        if self.sensors_known:
            P = simulator.memory["augmented_covariance"]
            P[:, SENSOR_CONSTANTS] = 0.0
            P[:, :, SENSOR_CONSTANTS] = 0.0
        return simulator

    def record(
        self, rngs: Sequence[np.random.Generator], given: FixedChoices | None = None
    ) -> list[AnalystRun]:
        """Record the filter over clean runs, from the onset on."""
        simulator = self.start_simulator(rngs, given)
        blind = np.zeros(0)
        blocks: list[FloatArray] = []

        def look(epoch: LinearRun) -> None:
            nonlocal blind
            blind = _propagate_coasting(simulator, epoch.transition, blind)
            lost = (blind - simulator.memory["augmented_covariance"])[:, PLACE, PLACE]
            blocks.append(epoch.axes.transpose(0, 2, 1) @ lost @ epoch.axes)

        run_to_onset(simulator)
        blind = simulator.memory["augmented_covariance"].copy()
        runs = record_from(simulator, look)
        coasting = np.stack(blocks, axis=1)
        world = self.setup.world.at_hand
        return [
            AnalystRun(as_it_happens(run, world), own)
            for run, own in zip(runs, coasting, strict=True)
        ]


def _record_pairs(
    setup: TightlyCoupledSetup, analyst: Analyst, entropy: int, count: int, every_sky: bool
) -> Iterator[tuple[LinearRun, AnalystRun]]:
    """Victim and analyst of runs, two at a time: more take more memory, and of a single one see
    `keep_company`."""
    for first in range(0, count, 2):
        numbers = range(first, min(first + 2, count))
        given = {"world": np.array(numbers)} if every_sky else None
        victim, again = (
            make_generators(seeds_of_runs(entropy, "selection", setup.name, numbers))
            for _ in range(2)
        )
        yield from zip(record(setup, victim, given), analyst.record(again, given), strict=True)


def _grade(setup: TightlyCoupledSetup) -> str:
    (grade, *others) = setup.domain.imu or (setup.scenario.imu,)
    if others:
        raise ValueError(
            "limits are known for one grade of inertial sensors at a time, but the domain's `imu` "
            f"has {', '.join(setup.domain.imu)}"
        )
    return grade


def _propagate_coasting(
    simulator: TightlyCoupledSimulator, transition: FloatArray, P: FloatArray
) -> FloatArray:
    """Covariance that is propagated by one epoch, without measurements."""
    half = np.zeros((simulator.receivers, P.shape[1]))
    psd = simulator.buffers.assumed["noise_psd"]
    half[:, :STATES] = 0.5 * simulator.buffers.interval[:, None] * psd
    index = np.arange(P.shape[1])
    P = P.copy()
    P[:, index, index] += half
    P = transition @ P @ transition.transpose(0, 2, 1)
    P[:, index, index] += half
    if simulator.augmented is not None:
        P[:, FIRST:, FIRST:] += simulator.augmented.model.driving
    return P


@dataclass(frozen=True)
class WorldFrontier:
    """The detectability frontier of one world; symbols are those of the module.

    Attributes
    ----------
    commands : Commands
        Commands of the attack.
    whitened : ndarray
        (K, m, J) R: whitened innovations of the analyst per unit command, by epoch.
    victim : Response
        Response of the victim to the unit commands.
    last : int
        Epoch, counted from the onset, at which the displacement is taken.
    coasting : ndarray
        (2, 2) :math:`P_{coast} - P` at `last`, north and east [m^2].
    """

    commands: Commands
    whitened: FloatArray
    victim: Response
    last: int
    coasting: FloatArray

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
        return self._by_world(self.coasting if free else self.per_deflection).ravel()

    def _by_world(self, matrices: FloatArray) -> FloatArray:
        """(W, H) frontiers at d = 1 by world and heading [m]."""
        if self.any_direction:
            bad = np.asarray(~np.isfinite(matrices).all(axis=(1, 2)))
            largest = np.linalg.eigvalsh(np.where(bad[:, None, None], 0.0, matrices))[:, -1]
            return np.sqrt(np.where(bad, np.inf, np.maximum(largest, 0.0)))[:, None]
        angles = np.array([self.heading])
        if self.heading is None:
            angles = np.arange(HEADINGS) * (np.pi / HEADINGS)
        c = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        with np.errstate(invalid="ignore"):
            squares: FloatArray = np.einsum("hi,wij,hj->wh", c, matrices, c)
        return np.sqrt(np.where(np.isfinite(squares), squares, np.inf))

    def lower_limit_m(
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

    def lower_limit_interval_m(
        self, p_fa: float, p_d: float, *, heading: str = "unknown"
    ) -> tuple[float, float]:
        """Confidence interval of the median over worlds.

        Parameters
        ----------
        p_fa, p_d, heading
            As of `lower_limit_m`.

        Returns
        -------
        tuple of float
            95 % interval [m], by the bootstrap of whole worlds; of one world the value itself.
        """
        sizes = self._by_world(self.per_deflection)
        rows = np.random.default_rng(0).integers(len(sizes), size=(RESAMPLES, len(sizes)))
        drawn = np.quantile(sizes[rows].reshape(RESAMPLES, -1), 0.5, axis=1, method="nearest")
        d = deflection_for(p_fa, p_d, heading=heading)
        low, high = d * np.quantile(drawn, (0.025, 0.975), method="nearest")
        return float(low), float(high)

    def course_m(
        self, p_fa: float, p_d: float, *, heading: str = "unknown", quantile: float = 0.5
    ) -> FloatArray:
        """(E,) floors of attacks that aim at `times_s` [m]; arguments as of `floor_m`."""
        d = deflection_for(p_fa, p_d, heading=heading)
        each = (self._by_world(self.course[:, e]) for e in range(len(self.times_s)))
        return np.array([d * np.quantile(of, quantile, method="nearest") for of in each])

    @property
    def assumptions(self) -> tuple[str, ...]:
        return (*ASSUMPTIONS, SENSORS[self.sensors_known])


def compute_frontier(
    setup: TightlyCoupledSetup,
    *,
    worlds: int | None = None,
    sensors_known: bool = False,
    entropy: int = 0,
    times: int = 0,
    tick: WorkCallback | None = None,
) -> Frontier:
    """Compute the detectability frontier of a setup.

    Parameters
    ----------
    setup : TightlyCoupledSetup
        World, victim, attack and timeline; the detector does not matter.
    worlds : int, optional
        Runs whose worlds are drawn, at least 1; by default one under every sky of the domain.  One
        is enough where nothing is drawn.
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
    >>> from spoofgym.limits import compute_frontier
    >>> from spoofgym.simulation import TightlyCoupledSetup
    >>> found = compute_frontier(TightlyCoupledSetup(detector="never"))
    >>> round(found.lower_limit_m(0.01, 0.5), 1)
    4.7
    """
    check_linear_victim(setup)
    every = setup.bounds.worlds
    count = every if worlds is None else whole_number("`worlds`", worlds, 1)
    times, steps = whole_number("`times`", times, 0), setup.steps
    lasts = sorted({round(steps * (k + 1) / times) - 1 for k in range(times)} - {-1})
    if setup.bounds._replace(heading=0.0).single:
        count = 1
    advance = tick or (lambda part: None)
    analyst = Analyst(setup, sensors_known=sensors_known)
    found: list[WorldFrontier] = []
    matrices, coasting, course = [], [], []
    for victim, its_analyst in _record_pairs(setup, analyst, entropy, count, worlds is None):
        commands = unit_commands(setup, victim.onset, HATS)
        if np.any(commands.idle):
            raise ValueError(
                f"no floor is known for {setup.attack.label!r}: it changes the measurements when "
                "it is commanded nothing, and a floor counts only what commands do"
            )
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


def check_linear_victim(setup: Any) -> TightlyCoupledSetup:
    if not isinstance(setup, TightlyCoupledSetup):
        raise ValueError(
            f"limits are known for tightly coupled receivers alone, not for {setup.whose}"
        )
    return setup
