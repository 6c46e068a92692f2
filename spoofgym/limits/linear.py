r"""What an attack does to a filter, to first order, epoch by epoch.

With e the shift of the filter's error, :math:`\rho` that of its innovation and a the attack on the
measurements,

.. math:: e_k^- = \Phi_k e_{k-1}, \qquad \rho_k = a_k + H_k e_k^-, \qquad
    e_k = e_k^- - K_k \rho_k

so that all of it is linear in a, and a is linear in the commands of the attack.  Matrices are those
of one clean run of the simulator.  The gains are the filter's; the shift of a victim goes through
what its mechanization and its measurements do (`mechanized`, `measured`), which its filter takes
for less.  It holds for a filter whose gains an attack does not change: not for one whose detector
takes weight off measurements.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..detectors import Never
from ..receiver.error_model import POSITION, STATES
from ..sim.world import World
from ..simulators.base import Given, run_serially
from ..simulators.tightly_coupled import TightlyCoupledSetup, TightlyCoupledSimulator

FloatArray = NDArray[np.float64]
PLACE = slice(POSITION, POSITION + 3)
"""States of the position error."""
NEEDED = frozenset({"transition", "design", "predicted_cov", "innovation_cov"})


class LinearRun(NamedTuple):
    """A filter over the K epochs of an attack and of the time to alert.

    Attributes
    ----------
    transition : ndarray
        (K, s, s) Phi, to the epoch from the one before; of a victim as `mechanized` gives it.
    design : ndarray
        (K, m, s) H, pseudoranges first; of a victim as `measured` gives it.
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
    visible: NDArray[np.bool_]
    axes: FloatArray
    onset: int = 0


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
    setup: TightlyCoupledSetup, rngs: Sequence[np.random.Generator], given: Given | None = None
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
    simulator = unattacked(setup, len(rngs))
    simulator.begin(rngs, given)
    simulator.quiet_epochs(setup.onset)
    return [as_it_happens(run, setup.world) for run in record_from(simulator)]


def as_it_happens(run: LinearRun, world: World) -> LinearRun:
    """A filter's run with shifts that propagate and are measured as they really are."""
    return run._replace(transition=mechanized(run.transition), design=measured(run, world))


def measured(run: LinearRun, world: World) -> FloatArray:
    """(K, m, s) design of a run, with what range rates say of the position, too [1/s]. A filter
    leaves this out, since its own errors of position are too small for it. A victim that is 10 m
    away finds its range rates changed by a millimetre per second, for as long as it is."""
    at = run.onset + 1 + np.arange(len(run.design))
    way = world.satellites[at, :, :3] - world.position_e[at, None]
    length = np.where(run.visible, np.linalg.norm(way, axis=2), 1.0)[:, :, None]
    sight = way / length
    velocity = world.satellites[at, :, 3:6] - world.velocity_e[at, None]
    across = velocity - (sight * velocity).sum(axis=2, keepdims=True) * sight
    design = run.design.copy()
    design[:, run.visible.shape[1] :, PLACE] += across / length * run.visible[:, :, None]
    return design


def mechanized(transition: FloatArray) -> FloatArray:
    r"""Errors as they really propagate, by (K, s, s) a filter's :math:`I + F \tau`.

    A filter propagates its covariance to first order of the interval.  Its mechanization integrates
    many times in between: of a tilt it makes a velocity, and of that a position, within one epoch.
    The term of second order has that.  States after the first 17 have exact transitions.
    """
    by_interval = transition - np.eye(transition.shape[-1])
    found = transition.copy()
    found[:, :STATES] += 0.5 * by_interval[:, :STATES] @ by_interval
    return found


def unattacked(setup: TightlyCoupledSetup, receivers: int) -> TightlyCoupledSimulator:
    """Receivers that nobody attacks or defends, whose epochs show what is recorded."""
    told = setup.altered(detector=Never(), monitors=())
    told.fields = setup.fields | NEEDED
    simulator: TightlyCoupledSimulator = told.simulator(receivers, run_serially)
    return simulator


def record_from(
    simulator: TightlyCoupledSimulator, look: Callable[[LinearRun], None] | None = None
) -> list[LinearRun]:
    """Filters of receivers at the onset; `look` is given (B, ...) of each epoch, updated."""
    setup = simulator.setup
    kept: list[LinearRun] = []
    for _ in range(setup.steps + setup.hold):
        epoch = simulator.advance()
        P, H, S = (getattr(epoch, name) for name in ("predicted_cov", "design", "innovation_cov"))
        gain = np.linalg.solve(S, H @ P).transpose(0, 2, 1)
        part = epoch.transition, H, gain, S, epoch.visible, setup.C_en[simulator.epochs]
        transition, H, gain, S, visible, axes = (np.array(each) for each in part)
        kept.append(LinearRun(transition, H, gain, S, visible.astype(np.bool_), axes))
        simulator.update(None)
        if look is not None:
            look(kept[-1])
    arrays = [np.stack(each, axis=1) for each in zip(*(part[:6] for part in kept), strict=True)]
    runs = []
    for b, onset in enumerate(simulator.onset.tolist()):
        transition, design, gain, S, visible, axes = (each[b] for each in arrays)
        runs.append(LinearRun(transition, design, gain, S, visible.astype(np.bool_), axes, onset))
    return runs


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
