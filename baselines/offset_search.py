r"""Open-loop attacks in the action space of `Offsets`: nested searches on the linear response.

An attack is a curve of the rate of every axis, linear between some knots, as `ActionCurves` plays
it.  What each knot does to the victim is known to first order (`spoofgym.limits.response`), with
the geometry of every epoch; CMA-ES looks for the attack as it does for one along a heading, from
the best attack of a smaller space and from ramps.

The line that authentic satellites do not see: with the unit vectors :math:`u_i` to the satellites
that are *not* captured, a displacement D and a common offset b of the captured ones fit them where

.. math:: -u_i \cdot D + b = 0

for all i, which up to three of them leave a line for.  Of more, the line is the horizontal
displacement of length 1 whose inconsistency is least, with the best vertical part and offset.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from spoofgym.attacks import Offsets
from spoofgym.bench.runs.play import FloatArray
from spoofgym.bench.search.backends import ReplayBackend, Rows
from spoofgym.bench.search.open_loop import OpenLoopAttack, OpenLoopOptimizer
from spoofgym.limits.linear import hat_functions, unit_commands
from spoofgym.limits.response import Replay
from spoofgym.simulation.setup import Setup

SPACES: dict[str, tuple[str, ...]] = {
    "direction": ("east",),
    "position": ("north", "east", "down"),
    "position+clock": ("north", "east", "down", "clock"),
    "satellites": (),
}
"""Nested spaces by the axes that they have; the last one has all."""
KNOTS = 12


class OffsetsReplay(Replay):
    """A replay of attacks by `Offsets`: P attacks are (P, a Q) rates [m/s], axis by axis, at Q
    knots; detectors and runs as of a `Replay`, in a world of one sky and start."""

    knots = KNOTS

    def _offsets(self, onset: int) -> FloatArray:
        """(K, m, a Q) offsets of the measurements, by axis and knot."""
        probed = copy.copy(self.setup)  # no sum of its commands reaches a limit
        probed.attack = replace(self.setup.attack, scales_mps=Offsets.scales_mps)
        commands = unit_commands(probed, onset)
        each = commands.offsets.reshape(*commands.offsets.shape[:2], commands.decisions, -1)
        shapes = knot_curves(commands.decisions, self.knots)
        self.hats = np.eye(each.shape[3] * self.knots)
        offsets = np.einsum("kmda,dq->kmaq", each, shapes, optimize=True)
        return np.asarray(offsets.reshape(*each.shape[:2], -1))

    def _along(
        self, part: str, where: slice, u: FloatArray, group: Rows, aim: FloatArray
    ) -> FloatArray:
        """As of a `Replay`; (K, P, N, x), the same for all runs, which share their response."""
        unit = self._units[0][part][:, where]
        moved = np.ascontiguousarray((unit @ u.astype(np.float32)).transpose(0, 2, 1))
        shape = (*moved.shape[:2], len(aim), moved.shape[2])
        return np.broadcast_to(moved[:, :, None], shape).astype(np.float64)


class OffsetsBackend(ReplayBackend):
    """A detector of a replay against attacks in a space: rates of some axes, the others still."""

    def __init__(self, replay: OffsetsReplay, number: int, space: str) -> None:
        self._columns = select_columns(replay.setup, space, replay.knots)
        super().__init__(replay, number, "target")
        self.steps = len(self._columns)

    def play(self, curves: FloatArray, rows: Rows) -> tuple[FloatArray, FloatArray]:
        return super().play(self.embed(curves), rows)

    def embed(self, curves: FloatArray) -> FloatArray:
        """(P, a Q) rates of all axes, of those (P, n) of the space."""
        every = np.zeros((len(curves), len(self.replay.hats)))
        every[:, self._columns] = curves
        return every

    def restrict(self, every: FloatArray) -> FloatArray:
        """Inverse of `embed`, of one attack (a Q,)."""
        return every[self._columns]


class OffsetsOptimizer(OpenLoopOptimizer):
    """Search in a space of offsets, from attacks that are given."""

    def search_from(self, starts: Mapping[str, FloatArray]) -> OpenLoopAttack:
        """The best attack (a Q,) that is found from the best of some starts (a Q,)."""
        backend = self.backend
        assert isinstance(backend, OffsetsBackend)
        own = {name: backend.restrict(start) for name, start in starts.items()}
        self._main = next(iter(own.values()))
        found = self.search(own)
        return found._replace(rates_mps=backend.embed(found.rates_mps[None])[0])

    def _shapes(self, t: FloatArray, others: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        return {name: each / np.abs(each).max() for name, each in others.items()}

    def _ladder(self, shapes: dict[str, FloatArray]) -> tuple[OpenLoopAttack, bool]:
        found, free = super()._ladder(shapes)
        self._main = found.rates_mps
        return found, free

    def _size(self, rates: FloatArray) -> FloatArray:
        """Part along the attack that the search began at."""
        return np.asarray(rates @ self._main / (self._main @ self._main))

    def _try_fastest(self, knots: int) -> None:
        return None

    def curves(self, rates: FloatArray) -> FloatArray:
        limit, _ = self.backend.limits
        return np.clip(rates, -limit, limit)


def knot_curves(steps: int, knots: int) -> FloatArray:
    """(steps, Q) curves that are 1 at one knot, at the ends of the epochs, as `ActionCurves`."""
    return hat_functions(steps + 1, knots)[1:]


def list_offset_axes(setup: Setup) -> list[str]:
    assert isinstance(setup.attack, Offsets)
    return list(setup.attack.axis_names(setup.world))


def select_columns(setup: Setup, space: str, knots: int) -> Rows:
    """Which of the (a Q,) rates belong to a space."""
    axes = list_offset_axes(setup)
    own = [axes.index(name) for name in SPACES[space]] or range(len(axes))
    return np.concatenate([axis * knots + np.arange(knots) for axis in own])


def coherent_curve(setup: Setup, knots: int, axis: str, shape: FloatArray) -> FloatArray:
    """(a Q,) rates of one axis alone, `shape` (Q,)."""
    rates = np.zeros((len(list_offset_axes(setup)), knots))
    rates[list_offset_axes(setup).index(axis)] = shape
    return rates.ravel()


def unseen_line(setup: Setup, captured: Rows, epoch: int) -> FloatArray:
    """(4,) displacement north, east, down and common offset [m], of a horizontal length of 1, that
    the satellites in view that are not `captured` see least, or not at all."""
    world = setup.world
    others = np.setdiff1d(np.flatnonzero(world.visible[epoch]), captured)
    sight = world.satellites[epoch, others, :3] - world.position_e[epoch]
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    seen = np.column_stack([-sight @ world.C_en[epoch], np.ones(len(others))])
    flat, rest = seen[:, :2], seen[:, 2:]
    hidden = np.linalg.pinv(rest)
    left = flat - rest @ (hidden @ flat)
    across = np.linalg.svd(left)[2][1]
    return np.concatenate([across, -hidden @ (flat @ across)])


def unseen_ramp(setup: Setup, captured: Rows, onset: int, knots: int) -> FloatArray:
    """(a Q,) rates [m/s] of a ramp of 1 m/s along the line that authentic satellites do not see,
    which turns with the geometry of every epoch."""
    steps = setup.steps
    lines = np.array([unseen_line(setup, captured, onset + 1 + k) for k in range(steps)])
    sign = np.sign((lines[:, :2] * lines[0, :2]).sum(axis=1))
    way = lines * (sign * np.arange(1, steps + 1))[:, None] * setup.interval_s
    rate = np.diff(way, axis=0, prepend=np.zeros((1, 4))) / setup.interval_s
    shapes = knot_curves(steps, knots)
    rates = np.zeros((len(list_offset_axes(setup)), knots))
    rates[:4] = np.linalg.lstsq(shapes, rate, rcond=None)[0].T
    return rates.ravel()
