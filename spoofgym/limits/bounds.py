r"""Zero-alarm bounds of a detector: in one run, and over the worlds that a setup draws.

A *free* attack may do anything to the measurements.  A *restricted* one is linear in its commands
u: with the response of the innovations to a unit of each (`linear.respond`), the displacement n' u
is largest where the test raises no alarm, and

.. math:: |\dot D_i| \le r, \qquad |\dot D_i - \dot D_{i-1}| \le a \tau, \qquad \dot D_{-1} = 0

for the rates of its false position along one heading, which are linear in u, too.  That is a linear
program for tests of single channels, and a second-order cone program for chi-square tests.  The
commands that attain it can be played.

Over worlds the attack is restricted to the limits of the setup's own, a false position along one
heading.  Both bounds are means, as what they bound is a mean: the displacement of any spoofer,
feedback included, averaged over runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from ..detectors import Calibrated, Detector, SolutionSeparation
from ..detectors.base import FloatArray, IntArray
from ..simulation.monitors import PassiveDetectors
from ..simulation.setup import make_generators, seeds_of_runs
from ..simulation.tight import TightlyCoupledSetup
from .convex import Optimum, Program
from .floor import check_linear_victim
from .linear import (
    Commands,
    LinearRun,
    Response,
    observer,
    record,
    respond,
    unit_commands,
    unused_seed,
)
from .no_alarm import Judged, NoBoundError, Timing, judged_by
from .zero_alarm import Bound, Kind, Sensitivity, checked_direction, sensitivity

WorkCallback = Callable[[float], None]
HATS = 24  # hat functions of the rate of a restricted attack
ASSUMPTIONS = (
    "a zero-alarm bound is of the mean displacement over runs, in one direction, of any spoofer, "
    "feedback included; of no quantile and no single run",
    "the gains of the filter stay as they are, to first order around a clean run; an alarm that "
    "noise raises is not counted",
    "a free attack may do anything to the measurements; a restricted one is a false position along "
    "one heading, within the limits of the world's own attack",
)
UNSEEN = 1e-9  # part of a sensitivity outside the rows that are judged from which on it counts


class Attacker(NamedTuple):
    """What a restricted attack can do.

    Attributes
    ----------
    response : Response
        What each of J unit commands does to the filter, over K epochs.
    rates : ndarray
        (E, J) rate of the false position at each epoch, per unit command [m/s].
    rate_limit_mps : float
        r, limit of the size of the rate [m/s]; infinite for none.
    change_limit_mps : float
        a tau, limit of its change from one epoch to the next [m/s]; infinite for none.
    """

    response: Response
    rates: FloatArray
    rate_limit_mps: float = math.inf
    change_limit_mps: float = math.inf


def compute_zero_alarm(
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
    return (
        _bound_unrestricted(test, of)
        if attacker is None
        else _bound_restricted(test, epoch, direction, attacker)
    )


def _bound_unrestricted(test: Judged, of: Sensitivity) -> Bound:
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
        return report_unattained(found, of.epoch, of.direction)
    y = np.append(found.x, 0.0)[ids]
    y = y * along if test.rotates else y
    return of.bound(found.value, "exact", np.einsum("kmr,kr->km", inverse, y))


def _bound_restricted(test: Judged, epoch: int, direction: ArrayLike, attacker: Attacker) -> Bound:
    north, east = checked_direction(direction)
    n = np.array([north, east]) @ attacker.response.position[epoch, :2]
    program = Program()
    commands = program.variables(np.ones(len(n), dtype=np.bool_))
    program.maximize(commands, n)
    hold_motion(program, commands, attacker)
    active = np.asarray(test.matrix.any(axis=2))
    ids = program.variables(active)
    lead_to(program, commands, test.transform(attacker.response.innovation)[active], ids[active])
    test.hold(program, ids)
    found = program.solve()
    if found.x is None:
        return report_unattained(found, epoch, (north, east))
    u = found.x[commands]
    innovation = attacker.response.innovation @ u
    return Bound(float(n @ u), "exact", epoch, (north, east), innovation, u)


def report_unattained(found: Optimum, epoch: int, direction: tuple[float, float]) -> Bound:
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
    every, top = np.ones(len(attacker.rates), dtype=np.bool_), attacker.rate_limit_mps
    rate = program.variables(every, -top, top)
    lead_to(program, commands, attacker.rates, rate)
    if math.isinf(attacker.change_limit_mps):
        return
    change = program.variables(every, -attacker.change_limit_mps, attacker.change_limit_mps)
    columns = np.column_stack([rate, np.append(-1, rate[:-1]), change])
    program.equal(columns, np.array([[1.0, -1.0, -1.0]]))


class WorldSample(NamedTuple):
    """One drawn world: the victim's filter, its response to commands, its seed."""

    run: LinearRun
    attacker: Attacker | None
    seed: np.random.SeedSequence


class ZeroAlarm(NamedTuple):
    """Bounds of one detector.

    - `free_m`, `restricted_m`: means over the worlds [m]; infinite without a bound; None where
      nothing is known;
    - `kind`: of the restricted one, or of the free one where there is no other: ``"exact"``,
      ``"upper"`` or ``"unbounded"``;
    - `why`: why nothing is known, and what holds instead, or why it is an upper bound; or "";
    - `rates_mps`: (W, Q) rates of the restricted attacks at equally spaced times;
    - `reason`: why nothing is known, without what holds instead; or "" for all of `why`.
    """

    free_m: float | None
    restricted_m: float | None
    kind: str
    why: str
    rates_mps: list[FloatArray]
    reason: str = ""

    def as_json(self) -> dict[str, Any]:
        """JSON-able; infinities as the word "unbounded"."""
        sizes = {"free_m": self.free_m, "restricted_m": self.restricted_m}
        words = {key: "unbounded" if value == math.inf else value for key, value in sizes.items()}
        return {**words, "kind": self.kind, "why": self.why, "reason": self.reason or self.why}


def draw_worlds(
    setup: TightlyCoupledSetup, worlds: int, entropy: int = 0, tick: WorkCallback | None = None
) -> list[WorldSample]:
    check_linear_victim(setup)
    advance = tick or (lambda part: None)
    seeds = seeds_of_runs(entropy, "selection", setup.name, range(worlds))
    runs = record(setup, make_generators([unused_seed(seed) for seed in seeds]))
    cases = []
    for seed, run in zip(seeds, runs, strict=True):
        commands = unit_commands(setup, run.onset, HATS)
        cases.append(WorldSample(run, make_attacker(commands, run, get_heading(setup)), seed))
        advance(1.0 / worlds)
    return cases


def get_heading(setup: TightlyCoupledSetup) -> float:
    """Where scripted spoofers push: the target direction, or east where that is drawn [rad]."""
    fixed = setup.target_heading_deg
    return math.pi / 2.0 if isinstance(fixed, str) else math.radians(fixed)


def make_attacker(commands: Commands, run: LinearRun, heading: float) -> Attacker | None:
    """An attack along one heading, within its limits; None where it moves no position."""
    if commands.heading is None or np.any(commands.idle):
        return None
    aim = commands.heading @ np.array([math.cos(heading), math.sin(heading)])
    each = commands.offsets.reshape(*commands.offsets.shape[:2], -1, commands.axes)
    hats = np.eye(commands.decisions) if commands.hats is None else commands.hats
    limits = commands.rate_limit_mps, commands.change_limit_mps
    return Attacker(respond(run, each @ aim), hats, *limits)


def zero_alarm_bounds(
    setup: TightlyCoupledSetup,
    detector: Detector,
    cases: Sequence[WorldSample],
    tick: WorkCallback | None = None,
) -> ZeroAlarm:
    """Bounds of a detector whose factors are known; if absent, the result states why."""
    inner = detector.detector if isinstance(detector, Calibrated) else detector
    if isinstance(inner, SolutionSeparation):
        return _separation(setup, detector, inner, cases)
    heading = get_heading(setup)
    try:
        timing = Timing.of(setup)
    except ValueError as error:
        return ZeroAlarm(None, None, "", str(error), [], "ages are drawn")
    direction = math.cos(heading), math.sin(heading)
    runs = [case[:2] for case in cases]
    return bound_displacement(detector, runs, timing, setup.steps - 1, direction, tick)


def bound_displacement(
    detector: Detector,
    cases: Sequence[tuple[LinearRun, Attacker | None]],
    timing: Timing,
    epoch: int,
    direction: tuple[float, float],
    tick: WorkCallback | None = None,
) -> ZeroAlarm:
    """Bounds at an epoch along a direction, over filters that are recorded."""
    advance = tick or (lambda part: None)
    at: dict[str, Any] = {"epoch": epoch, "direction": direction}

    def bound(run: LinearRun, attacker: Attacker | None = None) -> Bound | str:
        try:
            return compute_zero_alarm(detector, run, timing, attacker=attacker, **at)
        except RuntimeError as error:
            return str(error)

    found: dict[str, list[Bound | str]] = {"free": [], "restricted": []}
    try:
        for run, attacker in cases:
            found["free"].append(bound(run))
            if attacker is not None:
                found["restricted"].append(bound(run, attacker))
            advance(1.0 / len(cases))
    except NoBoundError as none:
        return ZeroAlarm(None, None, "", f"{none.reason}; {none.instead}", [], none.reason)
    except (ValueError, ImportError) as error:
        return ZeroAlarm(None, None, "", str(error), [])
    (free_m, free_kind), (restricted_m, kind) = map(_mean, found.values())
    notes = {  # each once
        f"{name}: {each.note if isinstance(each, Bound) else each}": None
        for name, bounds in found.items()
        for each in bounds
        if not isinstance(each, Bound) or each.note
    }
    known = [each for each in found["restricted"] if isinstance(each, Bound)]
    rates = [each.commands for each in known if each.commands is not None]
    return ZeroAlarm(free_m, restricted_m, kind or free_kind, "; ".join(notes), rates)


def _mean(found: Sequence[Bound | str]) -> tuple[float | None, str]:
    """Mean over the worlds [m], and the weakest kind; None and "" where a world has no bound."""
    known = [each for each in found if isinstance(each, Bound)]
    if not known or len(known) < len(found):
        return None, ""
    kinds = {each.kind for each in known}
    kind = next(kind for kind in ("unbounded", "upper", "exact") if kind in kinds)
    return float(np.mean([each.value_m for each in known])), kind


def _separation(
    setup: TightlyCoupledSetup,
    detector: Detector,
    inner: SolutionSeparation,
    cases: Sequence[WorldSample],
) -> ZeroAlarm:
    """Bound of solution separation: its threshold in metres, at the end of the command phase. It
    shifts by the induced error of any attack, so that the bound is the same for a free one; it is
    an upper one, since a bank has other solutions, too."""
    scale = detector.scale if isinstance(detector, Calibrated) else 1.0
    if scale is None:
        raise ValueError("the factor on the thresholds is not known yet")
    attack_s = setup.steps * setup.interval_s
    simulator = observer(setup, len(cases), inner.needs, [PassiveDetectors([inner])])
    bank = cast(SolutionSeparation, simulator.monitor(PassiveDetectors).detectors[0])
    why = _explain_unbounded(setup, bank, attack_s)
    if why:
        return ZeroAlarm(None, None, "", why, [])
    simulator.warm_up(make_generators([unused_seed(case.seed) for case in cases]))
    for _ in range(setup.steps):
        simulator.step(attacked=False)
    mean = float(np.mean(math.sqrt(scale) * bank.bound_m(attack_s)))
    return ZeroAlarm(mean, mean, "upper" if math.isfinite(mean) else "unbounded", "", [])


def _explain_unbounded(
    setup: TightlyCoupledSetup, bank: SolutionSeparation, attack_s: float
) -> str:
    """Why a bound bank says nothing of the victim after an attack, "" where it does."""
    if bank.filter == "augmented" and setup.receiver.tuning != "augmented":
        return "its threshold bounds the solution of the filter beside the victim's, not the victim"
    if attack_s > bank.covers_s + 1e-9:
        return (
            f"an attack of {attack_s:g} s is longer than the {bank.covers_s:g} s that its bank "
            "covers, so that its threshold bounds nothing"
        )
    return ""
