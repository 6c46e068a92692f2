"""A small filter with velocity and position that measures ranges and range rates."""

from functools import partial

import numpy as np

from spoofgym.limits.bounds import Attacker, compute_zero_alarm
from spoofgym.limits.linear import LinearRun, respond
from spoofgym.limits.no_alarm import Timing
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.setup import make_generators, seeds_of_runs

unwatched = partial(TightlyCoupledSetup, detector="never")
EAST = (0.0, 1.0)
TIMING = Timing(0.5, live=30, onset_s=15.0)
SIGHT = np.array([[0.8, 0.5, 0.33], [-0.6, 0.7, 0.39], [0.1, -0.9, 0.42], [0.5, -0.2, -0.84]])


def toy_run(epochs=50, satellites=4, setting=None):
    """A run in which the last satellite, if wanted, is out of view for a while."""
    n, tau = satellites, 0.5
    phi = np.eye(9)
    phi[6:9, 3:6] = tau * np.eye(3)
    Q = np.diag([0.0] * 3 + [0.01] * 3 + [1e-4] * 3)
    P = np.diag([0.0] * 3 + [0.1] * 3 + [2.0] * 3)
    parts = []
    for k in range(-100, epochs):
        visible = np.ones(n, dtype=np.bool_)
        if setting and setting[0] <= k < setting[1]:
            visible[-1] = False
        H = np.zeros((2 * n, 9))
        sight = SIGHT[:n] + 0.001 * k
        H[:n, 6:9], H[n:, 3:6] = sight, sight
        seen = np.hstack([visible, visible])
        H *= seen[:, None]
        R = np.where(seen, np.repeat([4.0, 0.01], n), 1.0)
        P = phi @ P @ phi.T + Q
        S = H @ P @ H.T + np.diag(R)
        K = np.linalg.solve(S, H @ P).T
        P = (np.eye(9) - K @ H) @ P
        if k >= 0:
            parts.append((phi, H, K, S, visible, np.eye(3)))
    return LinearRun(*(np.stack(each) for each in zip(*parts, strict=True)))


def false_position(run, stop=None, rate=1.0, change=0.05):
    """Rates of a false position at every epoch, to the east."""
    epochs, m = run.design.shape[:2]
    n, count = m // 2, stop or epochs
    rates = np.zeros((epochs, count))
    rates[np.arange(count), np.arange(count)] = 1.0
    displacement = 0.5 * np.cumsum(rates, axis=0)
    offsets = np.zeros((epochs, m, count))
    for k in range(epochs):
        sight = run.design[k, :n, 7:8]  # east
        offsets[k, :n], offsets[k, n:] = -sight * displacement[k], -sight * rates[k]
    return Attacker(respond(run, offsets), rates, rate, change)


def bound_of(detector, run=None, timing=TIMING, attacker=None):
    run = toy_run() if run is None else run
    return compute_zero_alarm(detector, run, timing, epoch=45, direction=EAST, attacker=attacker)


def rngs_of(setup, runs=1):
    return make_generators(seeds_of_runs(0, "selection", setup.name, range(runs)))


def rates_of(commands):
    """(decisions, axes, J) rate of each axis by unit command."""
    hats = np.eye(commands.decisions) if commands.hats is None else commands.hats
    each = np.einsum("dq,ab->daqb", hats, np.eye(commands.axes))
    return each.reshape(len(hats), commands.axes, -1)


def best_commands(world, direction, deflection):
    """(J,) commands that reach the frontier of a world along a direction, north and east [m/s]."""
    n = direction @ world.victim.position[world.last, :2]
    rows = world.whitened.reshape(-1, world.whitened.shape[2])
    _, sizes, axes = np.linalg.svd(np.linalg.qr(rows, mode="r"))
    seen = sizes > 1e-9 * sizes[0]  # the others do nothing, where there is an end
    y = (axes[seen] @ n) / sizes[seen]
    return axes[seen].T @ (y / sizes[seen]) * deflection / np.linalg.norm(y)


def deflection_of(world, commands):
    shift = world.whitened @ commands
    return np.sqrt(np.cumsum((shift * shift).sum(axis=1)))
