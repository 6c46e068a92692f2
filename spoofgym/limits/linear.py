r"""Attack to filter response, first order.

With e the shift of the filter's error, :math:`\rho` that of its innovation and a the attack on the
measurements, epoch by epoch,

.. math:: e_k^- = \Phi_k e_{k-1}, \qquad \rho_k = a_k + H_k e_k^-, \qquad
    e_k = e_k^- - K_k \rho_k

so that all of it is linear in a, and a is linear in the commands of the attack.  Matrices are those
of one clean run of the simulator.  The gains are the filter's; the shift of a victim goes through
what its mechanization and its measurements do (`mechanize_transition`, `complete_design`), which
its filter takes for less.  It holds for a filter whose gains an attack does not change: not for one
whose detector takes weight off measurements.

Commands are rates of the attack's axes, one vector for every decision; the last one is held over
the time to alert, as the environment does.  An attack that is commanded by acceleration comes to
the rate of a decision at the end of it, along a line.  What a command adds to the measurements is
found by commanding the attack itself, one unit at a time, so that any attack has it: its geometry,
satellites that rise and set, a capture that comes late.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..attacks import Attack, AttackContext
from ..detectors import Never
from ..detectors.base import BoolArray, FloatArray
from ..receiver.states import POSITION, STATES
from ..simulation.monitors import Monitor
from ..simulation.setup import Setup
from ..simulation.simulator import FixedChoices, run_serially
from ..simulation.tight import TightlyCoupledSetup, TightlyCoupledSimulator
from ..truth.run import GroundTruth

PLACE = slice(POSITION, POSITION + 3)
NEEDED = frozenset({"transition", "design", "predicted_cov", "innovation_cov"})


class LinearRun(NamedTuple):
    """A filter over the K epochs of an attack and of the time to alert.

    Attributes
    ----------
    transition : ndarray
        (K, s, s) Phi, to the epoch from the one before; of a victim as `mechanize_transition` gives
        it.
    design : ndarray
        (K, m, s) H, pseudoranges first; of a victim as `complete_design` gives it.
    gain : ndarray
        (K, s, m) K.
    innovation_cov : ndarray
        (K, m, m) S; row and column of the identity where a slot is not visible.
    visible : ndarray
        (K, n) bool, m = 2n.
    axes : ndarray
        (K, 3, 3) to ECEF from north, east, down at the true position, as of the position error,
        states 6 to 8.
    onset : int
        Epoch of the world after which the attack starts.
    """

    transition: FloatArray
    design: FloatArray
    gain: FloatArray
    innovation_cov: FloatArray
    visible: BoolArray
    axes: FloatArray
    onset: int = 0


def get_rate_limits(setup: Setup) -> tuple[float, float]:
    """Largest rate, and its largest change between two decisions [m/s]."""
    attack = setup.attack
    largest = float(np.min(attack.rate_limit_mps))
    if attack.control == "rate":
        return largest, math.inf
    return largest, attack.acceleration_limit_mps2 * setup.interval_s * setup.repeat


class Response(NamedTuple):
    """What J attacks do to a filter.

    Attributes
    ----------
    innovation : ndarray
        (K, m, J) shift of the innovations [m], [m/s].
    position : ndarray
        (K, 3, J) shift of the estimate after the update, north, east, down [m].
    predicted : ndarray
        (K, 6, J) shift of position and velocity before the update, ECEF [m], [m/s].
    """

    innovation: FloatArray
    position: FloatArray
    predicted: FloatArray


def record(
    setup: TightlyCoupledSetup,
    rngs: Sequence[np.random.Generator],
    given: FixedChoices | None = None,
) -> list[LinearRun]:
    """Record the filters of clean runs, from the onset on.

    Parameters
    ----------
    setup : TightlyCoupledSetup
        World, victim and timeline; attack and detector do not matter.
    rngs : sequence of Generator
        One for each run.
    given : mapping, optional
        Circumstances that are not to be drawn, as of a reset.

    Returns
    -------
    list of LinearRun
        One for each run.
    """
    simulator = observer(setup, len(rngs))
    simulator.start_episodes(rngs, given)
    run_to_onset(simulator)
    return [as_it_happens(run, setup.world.at_hand) for run in record_from(simulator)]


def as_it_happens(run: LinearRun, world: GroundTruth) -> LinearRun:
    """The run with its errors as they really propagate; its `transition` is changed in place."""
    mechanize_transition(run.transition)
    return run._replace(design=complete_design(run, world))


def complete_design(run: LinearRun, world: GroundTruth) -> FloatArray:
    """(K, m, s) design of a run, with what range rates depend on the position, too [1/s]. A filter
    leaves this out, since its own errors of position are too small; 10 m change range rates by a
    millimetre per second, for as long as they last."""
    at = run.onset + 1 + np.arange(len(run.design))
    way = world.satellites[at, :, :3] - world.position_e[at, None]
    length = np.where(run.visible, np.linalg.norm(way, axis=2), 1.0)[:, :, None]
    sight = way / length
    velocity = world.satellites[at, :, 3:6] - world.velocity_e[at, None]
    across = velocity - (sight * velocity).sum(axis=2, keepdims=True) * sight
    design = run.design.copy()
    design[:, run.visible.shape[1] :, PLACE] += across / length * run.visible[:, :, None]
    return design


def mechanize_transition(transition: FloatArray) -> None:
    r"""Turn (K, s, s) a filter's :math:`I + F \tau`, in place, to errors as they really propagate.

    A filter propagates its covariance to first order of the interval.  Within it, mechanization
    makes of a tilt a velocity, and of that a position: the term of second order.  States after the
    first 17 have exact transitions.
    """
    for first in range(0, len(transition), 16):  # more take more memory
        part = transition[first : first + 16]
        by_interval = part - np.eye(part.shape[-1])
        part[:, :STATES] += 0.5 * by_interval[:, :STATES] @ by_interval


def observer(
    setup: TightlyCoupledSetup,
    receivers: int,
    fields: frozenset[str] = NEEDED,
    monitors: Sequence[Monitor] = (),
) -> TightlyCoupledSimulator:
    """Receivers without a detector in the loop, whose epochs have some optional fields."""
    bare_setup = setup.copy_with(detector=Never(), monitors=monitors)
    bare_setup.fields = setup.fields | fields
    simulator: TightlyCoupledSimulator = bare_setup.simulator(receivers, run_serially)
    return simulator


def run_to_onset(simulator: TightlyCoupledSimulator) -> None:
    """Let filters run to their onsets."""
    for part, _, epochs in simulator.ageing():
        part.run_filter_only(epochs)


def unused_seed(seed: np.random.SeedSequence) -> np.random.SeedSequence:
    """The same seed, from which nothing has been spawned."""
    return np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key)


def record_from(
    simulator: TightlyCoupledSimulator, look: Callable[[LinearRun], None] | None = None
) -> list[LinearRun]:
    """Filters of receivers at the onset; `look` is given (B, ...) of each epoch, updated."""
    setup, arrays = simulator.setup, list[NDArray[Any]]()
    for k in range(setup.steps + setup.hold):
        epoch = simulator.advance()
        named = "transition", "predicted_cov", "design", "innovation_cov"
        F, P, H, S = (getattr(epoch, name) for name in named)
        solved = np.linalg.solve(S, H @ P)  # the gain, transposed
        visible, axes = epoch.visible.astype(np.bool_), setup.C_en[simulator.epochs]
        parts = F, H, solved, S, visible, axes
        if not arrays:
            arrays = [
                np.empty((len(x), setup.steps + setup.hold, *x.shape[1:]), x.dtype) for x in parts
            ]
            runs = [arrays[0], arrays[1], arrays[2].swapaxes(2, 3), *arrays[3:]]
        for array, part in zip(arrays, parts, strict=True):
            array[:, k] = part
        simulator.update(None)
        if look is not None:
            look(LinearRun._make((*(each[:, k] for each in runs), 0)))
    onsets = simulator.onset.tolist()
    return [LinearRun._make((*(each[b] for each in runs), k)) for b, k in enumerate(onsets)]


def respond(run: LinearRun, offsets: FloatArray) -> Response:
    """Compute the response of a filter to offsets of its measurements.

    Parameters
    ----------
    run : LinearRun
        The filter.
    offsets : ndarray
        (K, m, J) of J attacks [m], [m/s]; 0 where not visible.

    Returns
    -------
    Response
        To first order.
    """
    epochs, m, count = offsets.shape
    e = np.zeros((run.transition.shape[1], count))
    innovation = np.empty((epochs, m, count))
    position, predicted = np.empty((epochs, 3, count)), np.empty((epochs, 6, count))
    for k in range(epochs):
        e = run.transition[k] @ e
        predicted[k, :3], predicted[k, 3:] = e[PLACE], e[3:6]
        innovation[k] = offsets[k] + run.design[k] @ e
        e = e - run.gain[k] @ innovation[k]
        position[k] = run.axes[k].T @ e[PLACE]
    return Response(innovation, position, predicted)


def white(innovation_cov: FloatArray, rows: FloatArray) -> FloatArray:
    r"""Rows (K, m, J) times :math:`L^{-1}`, with :math:`S = L L^T`."""
    return np.asarray(np.linalg.solve(np.linalg.cholesky(innovation_cov), rows))


TINY_S = 1e-3  # a commanded rate is reached in this time
SMALL = 0.1  # part of the limit of the rate of a unit command
LINEAR_TO = 0.02
"""Largest distance of a response to commands from the sum of its parts, as a part of it."""


class Commands(NamedTuple):
    """Offsets of the measurements by command, over the K epochs of attack and time to alert.

    Attributes
    ----------
    offsets : ndarray
        (K, m, J) by unit command of 1 m/s; J = decisions x axes, the axes of a decision together;
        or hat functions x axes.
    idle : ndarray
        (K, m) of an attack that is commanded nothing.
    axes : int
        Elements of a command.
    heading : ndarray or None
        (axes, 2) north and east of each axis, where it moves a position.
    rate_limit_mps : float
        Of a command, as the size of the vector where it moves a position.
    change_limit_mps : float
        Of the difference between the commands of neighbouring decisions; infinite for an attack
        that is commanded by rate.
    hats : ndarray or None
        (decisions, Q) hat functions that the commands are of, or None for single decisions.
    """

    offsets: FloatArray
    idle: FloatArray
    axes: int
    heading: FloatArray | None
    rate_limit_mps: float
    change_limit_mps: float
    hats: FloatArray | None = None

    @property
    def decisions(self) -> int:
        return int(self.offsets.shape[2]) // self.axes if self.hats is None else len(self.hats)


def hat_functions(decisions: int, count: int) -> FloatArray:
    """(decisions, Q) piecewise linear functions that are 1 at one of Q equally spaced decisions."""
    if decisions <= count:
        return np.eye(decisions)
    places = np.linspace(0.0, decisions - 1.0, count)
    t = np.arange(decisions)[:, None]
    width = places[1] - places[0]
    return np.asarray(np.clip(1.0 - np.abs(t - places) / width, 0.0, None))


def bare(attack: Attack, decision_s: float) -> Attack:
    """The attack with perfect equipment but for the capture, and any rate by the next decision.
    Errors of tracking, of the spoofer's clock, and others than the authentic ones only add
    divergence from clean measurements, whatever the commands are."""
    perfect: Any = {"tracking": None, "spoofer_clock": None, "errors": "inherited"}
    quick = attack.rate_limit_mps / (decision_s if attack.control == "acceleration" else TINY_S)
    return replace(attack, acceleration_limit_mps2=quick, **perfect)


def unit_commands(setup: TightlyCoupledSetup, onset: int, hats: int | None = None) -> Commands:
    """Offsets by command of an episode.

    Parameters
    ----------
    setup : TightlyCoupledSetup
        World, attack, timeline and decisions.
    onset : int
        Epoch of the world after which the attack starts, `LinearRun.onset`.
    hats : int, optional
        Where there are more decisions than these, commands are of so many hat functions of the
        rate; a decision for each would take gigabytes in long attacks.

    Returns
    -------
    Commands
        By default of every decision by itself.
    """
    repeat, decision_s = setup.repeat, setup.repeat * setup.interval_s
    attack, by_rate = bare(setup.attack, decision_s), setup.attack.control == "rate"
    axes, decisions = len(attack.action_names(setup.world)), setup.steps // repeat
    functions = hat_functions(decisions, hats) if hats and hats < decisions else None
    inputs = decisions if functions is None else functions.shape[1]
    count = axes * inputs
    size = SMALL * np.eye(count).reshape(count, inputs, axes)
    tried = np.concatenate([size, np.zeros((1, inputs, axes)), _some(inputs, axes)])
    rates = tried if functions is None else np.einsum("dq,rqa->rda", functions, tried)
    found = _offsets(setup, attack, onset, rates)
    idle = found[:, :, count]
    unit = attack.unit_rates(setup.world)
    offsets = (found[:, :, :count] - idle[:, :, None]) / (SMALL * np.tile(unit, inputs))
    _check_linear(attack, unit, offsets, idle, found[:, :, count + 1 :], tried[count + 1 :])
    names = attack.action_names(setup.world)
    places = {"north": (1.0, 0.0), "east": (0.0, 1.0), "down": (0.0, 0.0)}
    words = [name.rsplit("_", 1)[0] for name in names]
    heading = np.array([places[word] for word in words]) if set(words) <= set(places) else None
    return Commands(
        offsets,
        idle,
        axes,
        heading,
        attack.rate_limit_mps,
        math.inf
        if by_rate and attack.kind != "offsets"
        else setup.attack.acceleration_limit_mps2 * decision_s,
        functions,
    )


def _some(decisions: int, axes: int) -> FloatArray:
    """(2, decisions, axes) commands to try linearity with: one forward, one that changes."""
    t = np.linspace(0.0, 1.0, decisions)[:, None]
    turned = np.cos(2.0 * np.pi * t + np.arange(axes)) + 1.0
    return 0.25 * np.stack([np.ones((decisions, axes)), turned])


def _offsets(
    setup: TightlyCoupledSetup, attack: Attack, onset: int, rates: FloatArray
) -> FloatArray:
    """(K, m, R) offsets of R sequences of rates (R, decisions, axes), 1 the limit; 0 unseen."""
    count, world = len(rates), setup.world
    by_rate = attack.control == "rate"
    actions = rates if by_rate else np.diff(rates, axis=1, prepend=0.0)
    attack.bind(AttackContext(count, world))
    at = np.full(count, onset)
    attack.start_episodes(np.arange(count), np.zeros((count, 2), dtype=np.uint64), at.copy())
    d_range, d_rate = np.zeros((2, count, world.channels))
    out = np.empty((setup.steps + setup.hold, 2 * world.channels, count))
    before = np.zeros(actions[:, 0].shape)
    for k in range(len(out)):
        command = None
        if k < setup.steps:
            decision, epoch = divmod(k, setup.repeat)
            action = actions[:, decision]
            command = np.ascontiguousarray(setup.command(before, action, epoch))
            if epoch == setup.repeat - 1:
                before = action
        attack.command(command, at, d_range, d_rate, 0, count)
        at = at + 1
        seen = np.tile(world.visible[at[0]], 2)
        out[k] = np.concatenate([d_range, d_rate], axis=1).T * seen[:, None]
    return out


def _check_linear(
    attack: Attack,
    unit: FloatArray,
    offsets: FloatArray,
    idle: FloatArray,
    found: FloatArray,
    tried: FloatArray,
) -> None:
    commands = (tried * unit).reshape(len(tried), -1).T
    expected = offsets @ commands + idle[:, :, None]
    n = offsets.shape[1] // 2
    for rows in (slice(0, n), slice(n, None)):
        size = np.abs(found[:, rows] - idle[:, rows, None]).max()
        wrong = np.abs(expected[:, rows] - found[:, rows]).max()
        if wrong > LINEAR_TO * max(size, 1e-9):
            raise ValueError(
                f"what {attack.label!r} adds to the measurements is not linear in its commands: "
                f"{100.0 * wrong / max(size, 1e-9):.1f} % off, at most {100.0 * LINEAR_TO:g} % is "
                "taken for linear; no limit is known for it"
            )
