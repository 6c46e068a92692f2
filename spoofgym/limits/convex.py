r"""A linear or second-order cone program, put together piece by piece.

.. math:: \max_x c^T x \quad\text{with}\quad A x = b, \quad C x \le d, \quad l \le x \le u, \quad
    |x_i| \le r_i, \quad |x_i|^2 \le \rho_i^2 x_{e_i}

where :math:`x_i` is a choice of the variables.  Without the last two kinds it is linear and goes to
HiGHS, which SciPy has; with them it goes to Clarabel, of the extra ``limits``.
Variables are numbers of their columns; -1 is one that is always 0.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize, sparse

from ..detectors.base import BoolArray, FloatArray, IntArray

LARGEST_PART = 1e-3  # part of an upper bound that the infeasibility of its dual may make up
MOST_ROUNDS = 60
"""Rounds of added rows before the search is given up; the scans of tests took fewer than 20."""


class SparseRows(NamedTuple):
    """Rows of a sparse matrix: (p, q) columns and values, (p,) right-hand sides."""

    columns: IntArray
    values: FloatArray
    rhs: FloatArray


class Optimum(NamedTuple):
    """Largest value, infinite without one, and where it is attained. With a note it is an
    upper bound, which is attained nowhere, and the note says why."""

    value: float
    x: FloatArray | None
    note: str = ""


Cuts = Callable[[FloatArray], SparseRows | None]
"""Rows that a point violates, or None; the point has a 0 at its end, which is variable -1."""


class Program:
    """Variables, what they are worth, and what holds them."""

    def __init__(self) -> None:
        self._lower: list[FloatArray] = []
        self._upper: list[FloatArray] = []
        self.size = 0
        self._worth: list[tuple[IntArray, FloatArray]] = []
        self._equal: list[SparseRows] = []
        self._below: list[SparseRows] = []
        self._second_order: list[SparseRows] = []
        self._cuts: list[Cuts] = []
        self._far: list[tuple[IntArray, float]] = []

    def variables(
        self,
        active: BoolArray,
        lower: FloatArray | float = -np.inf,
        upper: FloatArray | float = np.inf,
    ) -> IntArray:
        """New variables where `active`, of any shape, -1 elsewhere; bounds of that shape."""
        ids = np.full(active.shape, -1, dtype=np.int64)
        count = int(active.sum())
        ids[active] = self.size + np.arange(count)
        self.size += count
        self._lower.append(np.broadcast_to(lower, active.shape)[active])
        self._upper.append(np.broadcast_to(upper, active.shape)[active])
        return ids

    def maximize(self, ids: IntArray, worth: FloatArray) -> None:
        self._worth.append((ids[ids >= 0], worth[ids >= 0]))

    def equal(self, columns: IntArray, values: FloatArray) -> None:
        self._equal.append(_rows(columns, values, 0.0))

    def below(self, columns: IntArray, values: FloatArray, rhs: FloatArray | float) -> None:
        self._below.append(_rows(columns, values, rhs))

    def ball(self, ids: IntArray, radius: float) -> None:
        chosen = ids[ids >= 0]
        if len(chosen) and np.isfinite(radius):
            columns, rhs = np.append(-1, chosen), np.append(radius, np.zeros(len(chosen)))
            self._second_order.append(_rows(columns[:, None], -1.0, rhs))

    def energy(self, ids: IntArray, energy: int, unit: float = 1.0) -> None:
        """Hold the squared norm of some variables below another one, in units of `unit` squared;
        the solver finds an optimum more often where energies are near 1."""
        chosen = ids[ids >= 0]  # |(2 x / unit, e - 1)| <= e + 1
        values = np.append([-1.0, -1.0], np.full(len(chosen), -2.0 / unit))
        rhs = np.append([1.0, -1.0], np.zeros(len(chosen)))
        columns = np.append([energy, energy], chosen)
        self._second_order.append(_rows(columns[:, None], values[:, None], rhs))

    def lazily(self, cuts: Cuts, ids: IntArray, far: float) -> None:
        """Hold many rows, which are added when they are violated. Some variables are held below
        a large size, so that there is an optimum while rows are missing; if one of them reaches
        that size in the end, there is no optimum."""
        self._cuts.append(cuts)
        self._far.append((ids[ids >= 0], far))
        for sign in (1.0, -1.0):
            self.below(ids[ids >= 0][:, None], np.array([[sign]]), far)

    def solve(self) -> Optimum:
        for _ in range(MOST_ROUNDS):
            found = self._by_cones() if self._second_order else self._linearly()
            if found.x is None:
                return found
            point = np.append(found.x, 0.0)
            added = [rows for rows in (cuts(point) for cuts in self._cuts) if rows is not None]
            if not added:
                far = any((np.abs(point[ids]) > 0.99 * size).any() for ids, size in self._far)
                return Optimum(np.inf, None) if far else found
            self._below += added
        raise RuntimeError(f"rows were still violated after {MOST_ROUNDS} rounds of adding them")

    def _objective(self) -> FloatArray:
        worth = np.zeros(self.size)
        for ids, values in self._worth:
            np.add.at(worth, ids, values)
        return worth

    def _linearly(self) -> Optimum:
        equal, equals = _matrix(self._equal, self.size)
        below, limits = _matrix(self._below, self.size)
        bounds = np.column_stack([np.concatenate(self._lower), np.concatenate(self._upper)])
        sides = below, limits if len(limits) else None, equal, equals if len(equals) else None
        found = optimize.linprog(-self._objective(), *sides, bounds, method="highs-ipm")
        if found.status == 3 or "unbounded" in found.message.lower():
            return Optimum(np.inf, None)  # 0 is feasible: "unbounded or infeasible" is unbounded
        if found.status != 0:
            raise RuntimeError(f"HiGHS found no optimum: {found.message}")
        return Optimum(-float(found.fun), np.asarray(found.x))

    def _by_cones(self) -> Optimum:
        clarabel = clarabel_module()
        matrix, rhs, cones = self._cones(clarabel)
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        nothing = sparse.csc_matrix((self.size, self.size))
        solver = clarabel.DefaultSolver(nothing, -self._objective(), matrix, rhs, cones, settings)
        found = solver.solve()
        status = str(found.status)
        if status.endswith("DualInfeasible"):
            return Optimum(np.inf, None)
        if status == "Solved":
            return Optimum(-float(found.obj_val), np.asarray(found.x))
        note = f"Clarabel found no optimum: {status}"
        dual, x = np.asarray(found.z), np.asarray(found.x)
        upper = upper_by_dual(matrix, rhs, self._objective(), dual, x)
        if upper is None or self._far:
            raise RuntimeError(note)
        return Optimum(upper, None, f"{note}; upper bound by the dual")

    def _cones(self, clarabel: Any) -> tuple[Any, FloatArray, list[Any]]:
        """Everything as :math:`b - A x` in a product of cones."""
        pieces = self._equal, [*self._below, *self._bounds()], self._second_order
        parts = [_matrix(each, self.size) for each in pieces]
        kinds = clarabel.ZeroConeT, clarabel.NonnegativeConeT
        cones = [kind(len(rhs)) for kind, (_, rhs) in zip(kinds, parts, strict=False) if len(rhs)]
        cones += [clarabel.SecondOrderConeT(len(each.rhs)) for each in self._second_order]
        matrices = [matrix for matrix, _ in parts if matrix is not None]
        return sparse.vstack(matrices, format="csc"), np.concatenate([p[1] for p in parts]), cones

    def _bounds(self) -> list[SparseRows]:
        found = []
        for sign, sides in ((1.0, self._upper), (-1.0, self._lower)):
            limits = np.concatenate(sides)
            ids = np.flatnonzero(np.isfinite(limits))[:, None]
            found.append(_rows(ids, np.full(ids.shape, sign), sign * limits[ids[:, 0]]))
        return found


def upper_by_dual(
    matrix: Any, rhs: FloatArray, worth: FloatArray, dual: FloatArray, x: FloatArray
) -> float | None:
    r"""Upper bound by the point z of the dual cone where a solver stopped; None if useless.

    .. math:: c^T x = (A^T z)^T x + (c - A^T z)^T x \le b^T z + |c - A^T z|^T |x|

    `x`: where the solver stopped; the last term, of which variables are free, is taken there.
    An almost solved point itself was once 1 % too large, and alarmed.
    """
    if not (np.isfinite(dual).all() and np.isfinite(x).all()):
        return None
    slack = float(np.abs(worth - matrix.T @ dual) @ np.abs(x))
    value = max(float(rhs @ dual), float(worth @ x)) + slack
    return value if slack <= LARGEST_PART * value else None


def clarabel_module() -> Any:
    try:
        import clarabel
    except ImportError as error:
        raise ImportError(
            "the bound of this test is a second-order cone program, which Clarabel solves: "
            "pip install 'spoofgym[limits]'"
        ) from error
    return clarabel


def _rows(columns: IntArray, values: FloatArray | float, rhs: FloatArray | float) -> SparseRows:
    return SparseRows(
        columns, np.broadcast_to(values, columns.shape), np.broadcast_to(rhs, len(columns))
    )


def _matrix(pieces: list[SparseRows], size: int) -> tuple[Any, FloatArray]:
    pieces = [each for each in pieces if len(each.columns)]
    if not pieces:
        return None, np.zeros(0)
    rows, columns, values, start = [], [], [], 0
    for each in pieces:
        used = (each.columns >= 0) & (each.values != 0.0)
        rows.append(start + np.nonzero(used)[0])
        columns.append(each.columns[used])
        values.append(each.values[used])
        start += len(each.columns)
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    matrix = sparse.coo_matrix(entries, shape=(start, size)).tocsr()
    return matrix, np.concatenate([each.rhs for each in pieces])
