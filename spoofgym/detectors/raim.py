r"""Receiver autonomous integrity monitoring: residual, residual-vector and traversal RAIM.

A fit of position and clock to all pseudoranges leaves residuals, and these are too large when the
satellites do not agree; after such an alarm each detector searches for groups that do,

.. math:: \mathrm{SSE}(S) = \sqrt{\frac{r_S^T r_S}{|S| - 4}} < \mathrm{TH}(|S|) =
    \sigma \sqrt{\frac{\chi^2_p(|S| - 4)}{|S| - 4}}, \qquad
    r = \left(I - G (G^T G)^{-1} G^T\right) y

Symbols: y pseudorange minus the range from the predicted position [m], G = (-u, 1) with lines of
sight u, r_S residuals of a fit to the subset S, :math:`\sigma` noise of a pseudorange, p confidence
of the search; the alarm of all in view has its own false-alarm probability.

Assumptions: white Gaussian noise, the same for all satellites; what all measurements have in
common, the receiver's clock above all, is part of the fit.  Spoofing of all satellites by the same
position and clock is consistent, and passes: "consistent" is not "authentic".  Which of two groups
is authentic is not decided.  With fewer than 5 satellites, or a singular geometry, there is no
verdict: statistic 0.

**Raim** (`brown1992`, section on the least-squares-residuals method; `wu2024`, eq. 23): one
satellite that is wrong alone can be found, since without it the others agree; satellites that are
wrong together can only be noticed.  To blame is the one with the largest
:math:`r_i^2 / (1 - h_{ii})`, h being the diagonal of the projection on G: that without which the
residual is smallest.  With 5 satellites none can be blamed.

**SRV-RAIM** (`wu2024`, algorithm 1, eqs. 9, 15, 20 to 23): residuals are made vectors along the
rows of the geometry.  Those of authentic and of spoofed satellites point to different sides of
space, so that along one of 40 directions v the five largest or the five smallest
:math:`v^T r_i g_i` are likely of one kind; five that agree are a seed, which takes in whatever
agrees with it, and what is left over has to agree, too.  Some 20 fits are enough, where a search of
all subsets takes thousands.  The first group is the one that was found first.  It was made for 12
satellites; with errors of the paper it is right in some 80 % of the cases with 10 satellites and in
half with 8, and with fewer than 10 a second group of less than 5 is accepted untested.  Groups
found in ECEF and in north-east-down axes may differ; the latter serve for any local frame, whose
axes are the same but for order and sign.  Deviations:

1. The growth of the seed (steps 12 to 19 of the printed algorithm) is repeated until a pass adds
   nothing; the printed single pass gives nearly twice the false separations of the paper's table 5
   with one spoofed satellite.
2. Step 39, whether the groups stay consistent for some seconds, is left out, as in the paper.

**Traversal RAIM** (`wu2024`, section 3, tables 7 and 8, where it is the method to compare with):
all subsets are left out in turn, the smaller ones first; the first one that leaves satellites that
agree, and agrees itself where it has 5 or more, is the second group.  It finds whatever the test of
consistency can find, and takes thousands of fits where half of the satellites are spoofed.
Deviations:

1. Nothing left out comes first, "no spoofing"; it costs one fit, which the paper's counts for one
   spoofed satellite seem to lack.
2. The second group has at most `largest_group` satellites: 6 is all there is with 12 in view, while
   20 would take half a million fits without it.

Both search only after an alarm; ``false_alarm = 0.05`` is the paper's confidence.
"""

from __future__ import annotations

from abc import abstractmethod
from itertools import product
from typing import Any, ClassVar, cast

import numpy as np

from ..core.compile import njit
from ..core.declared import setting, settings_record
from ..earth.wgs84 import dcm_e_from_n, ecef_to_geodetic
from ..receiver.epoch import Epoch
from ..receiver.snapshot import PRODUCTS, add, solve_fix, squared_residual, squared_residual_of_both
from .base import BoolArray, Detector, DetectorContext, FloatArray, IntArray, Verdict
from .consistency import (
    MIN_SATELLITES,
    SearchData,
    fit_thresholds,
    line_up_all,
    search_data,
    write_groups,
)
from .innovation import alarm_probability

MAX_SATELLITES = 63  # as many fit into a mask
LARGEST_GROUP = 6  # half of 12 satellites


def exclusion(help: str) -> Any:
    return setting(
        default=False,
        help=f"Whether {help} weights 0, pseudorange and range rate, as long as the alarm lasts.",
    )


@settings_record
class ConsistencyTest(Detector):
    """Residual test of all satellites in view; after an alarm, a search of groups that agree."""

    sigma_m: float | None = setting(
        default=None,
        above=0.0,
        unit="m",
        help="Noise of a pseudorange; None takes what the receiver assumes.",
    )
    confidence: float = setting(
        default=0.95,
        above=0.0,
        below=1.0,
        help="Probability that satellites that agree pass for it in the search.",
    )
    false_alarm: float = alarm_probability(help="Probability of an alarm in one epoch.")

    exclude, frame = False, "ecef"  # settings of subclasses
    needs: ClassVar[frozenset[str]] = frozenset({"pseudorange", "satellite_position"})

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        b, n = context.receivers, context.channels
        if n > MAX_SATELLITES:
            raise ValueError(f"at most {MAX_SATELLITES} channels can be searched, got {n}")
        sigma_m, most = self.sigma_m, max(n, MIN_SATELLITES)
        if sigma_m is None:
            sd, variance = context.single_epoch_sd, context.noise_variance
            sigma_m = float((np.sqrt(variance) if sd is None else sd)[:n].max())
        self._limit = fit_thresholds(sigma_m, 1.0 - self.confidence, most)
        self._alarm_limit = fit_thresholds(sigma_m, self.false_alarm, most)
        self._data = search_data(b, n)  # overwritten at every epoch
        self.memory.declare("group", np.zeros((b, n), dtype=np.int8))

    @abstractmethod
    def search(self, data: SearchData) -> None:
        """Divide the satellites of every receiver with an alarm: `found` and `mask`."""

    def _axes(self, position_e: FloatArray) -> FloatArray:
        """(B, 3, 3) from the frame of the search to ECEF."""
        if self.frame == "ecef":
            return np.tile(np.eye(3), (len(position_e), 1, 1))
        latitude, longitude, _ = ecef_to_geodetic(position_e)
        return np.ascontiguousarray(dcm_e_from_n(latitude, longitude))

    def judge(self, epoch: Epoch) -> Verdict:
        """Test one epoch: (B, 1) SSE of all in view [m], threshold and alarm; (B, 2n) weights with
        `exclude`."""
        b, n = epoch.visible.shape
        statistic, threshold, weights = np.empty((b, 1)), np.empty((b, 1)), np.empty((b, 2 * n))
        line_up_all(
            cast(FloatArray, epoch.pseudorange),
            cast(FloatArray, epoch.satellite_position),
            epoch.visible,
            epoch.predicted_position,
            self._axes(epoch.predicted_position),
            self._alarm_limit,
            self._data,
            statistic,
            threshold,
            self.memory["group"],
            weights,
        )
        alarm: BoolArray = statistic > threshold
        if alarm.any():
            self.search(self._data)
            write_groups(self._data, epoch.visible, self.memory["group"], weights)
        return Verdict(statistic, threshold, alarm, weights if self.exclude else None)


@njit
def blame(n: int, table: FloatArray, limit: FloatArray, sums: FloatArray) -> int:
    """The one satellite without which the others agree, -1 for none. `table` (N + 1, PRODUCTS)
    products; `limit`: limit of s^2 by number of satellites [m^2]; `sums` (1, PRODUCTS) scratch."""
    best, least = -1, limit[n - 1]
    for i in range(n if n > MIN_SATELLITES else 0):
        sums[:] = 0.0
        for k in range(n):
            if k != i:
                add(sums, 0, table, k, sums, 0)
        s2 = squared_residual(sums, 0)
        if s2 < least:
            best, least = i, s2
    return best


@njit
def blame_all(data: SearchData, limit: FloatArray) -> None:
    sums = np.empty((1, PRODUCTS))
    for b in range(data.alarm.shape[0]):
        if data.alarm[b]:
            worst = blame(data.rows[b], data.table[b], limit, sums)
            if worst >= 0:
                data.solved[b] = True
                data.mask[b] -= 1 << worst


@settings_record
class Raim(ConsistencyTest):
    """Least-squares residual of all satellites in view.

    Notes
    -----
    ``memory["group"]`` is (B, n): 1 for satellites that agree, 2 for the one to blame, 0 for
    what is not known.
    """

    exclude: bool = exclusion("the satellite to blame has")

    paper: ClassVar[str] = "brown1992"

    def search(self, data: SearchData) -> None:
        blame_all(data, self._limit)


SEED = 5  # satellites, the least number that can disagree


def search_vectors() -> FloatArray:
    r"""The 40 vectors of S3, in the order of the paper: S1 are the first 12, S2 the first 24.

    Returns (40, 4) all vectors of :math:`\{-1, 0, 1\}^4` but 0, one of every pair v, -v.

    Examples
    --------
    >>> from spoofgym.detectors.raim import search_vectors
    >>> search_vectors()[[0, 4, 12, 24]]
    array([[1., 0., 0., 0.],
           [1., 1., 1., 1.],
           [1., 1., 0., 0.],
           [1., 1., 1., 0.]])
    """
    pairs = [(0, 1), (1, 2), (2, 3), (0, 2), (1, 3), (0, 3)]
    triples = [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]
    vectors = [np.eye(4)]
    for places in [(0, 1, 2, 3), *pairs, *triples]:
        signs = np.array(list(product((1.0, -1.0), repeat=len(places) - 1)))[:, ::-1]
        block = np.zeros((len(signs), 4))
        block[:, places[0]] = 1.0
        block[:, places[1:]] = signs
        vectors.append(block)
    return np.concatenate(vectors)


SEARCH_VECTORS = search_vectors()


@njit
def project(
    n: int,
    lines: FloatArray,
    residual: FloatArray,
    vectors: FloatArray,
    v: int,
    projection: FloatArray,
    order: IntArray,
) -> None:
    """Projections of the residual vectors [m], written to (N,), and `order` (N,), written: rows by
    falling projection, equal ones by index. `lines`, `residual` (N, 3), (N,) g and r [m]."""
    for i in range(n):
        along = vectors[v, 3]
        for j in range(3):
            along += vectors[v, j] * lines[i, j]
        value = along * residual[i]
        projection[i] = value
        k = i
        while k > 0 and projection[order[k - 1]] < value:
            order[k] = order[k - 1]
            k -= 1
        order[k] = i


@njit
def grow(
    n: int, table: FloatArray, limit: FloatArray, order: IntArray, first: int, sums: FloatArray
) -> tuple[bool, int, int]:
    """Test a seed, let it grow, and test what is left: whether both agree, mask of the first group,
    fits. `limit`: of s^2 by number of satellites [m^2]; `order` (N,) rows by projection; `sums` (1,
    PRODUCTS) scratch."""
    sums[:] = 0.0
    mask = 0
    for k in range(first, first + SEED):
        mask |= 1 << order[k]
        add(sums, 0, table, order[k], sums, 0)
    if not squared_residual(sums, 0) < limit[SEED]:
        return False, mask, 1
    fits, size, grown = 1, SEED, True
    while grown:
        grown = False
        for k in range(n):
            i = order[k]
            if (mask >> i) & 1:
                continue
            fits += 1
            if squared_residual_of_both(sums, 0, table, i) < limit[size + 1]:
                add(sums, 0, table, i, sums, 0)
                mask |= 1 << i
                size += 1
                grown = True
    if n - size < MIN_SATELLITES:
        return True, mask, fits
    sums[:] = 0.0
    for i in range(n):
        if not (mask >> i) & 1:
            add(sums, 0, table, i, sums, 0)
    return squared_residual(sums, 0) < limit[n - size], mask, fits + 1


@njit
def search(
    n: int,
    lines: FloatArray,
    offsets: FloatArray,
    table: FloatArray,
    limit: FloatArray,
    vectors: FloatArray,
    order: IntArray,
    scratch: FloatArray,
) -> tuple[bool, int, int]:
    """Search two groups that agree among n >= 5 satellites of a geometry that isn't singular:
    whether they were found, mask of the first, number of fits, that of all in view included.
    `order` (N,) and `scratch` (3, at least N and PRODUCTS) are overwritten."""
    projection, solution, sums = scratch[0], scratch[1], scratch[2:]
    solve_fix(table, table.shape[0] - 1, solution)
    for i in range(n):
        offsets[i] -= solution[3]
        for j in range(3):
            offsets[i] -= lines[i, j] * solution[j]
    fits = 1
    for v in range(vectors.shape[0]):
        project(n, lines, offsets, vectors, v, projection, order)
        for side in range(2):
            accepted, mask, more = grow(n, table, limit, order, side * (n - SEED), sums)
            fits += more
            if accepted:
                return True, mask, fits
    return False, 0, fits


@njit
def search_all(data: SearchData, limit: FloatArray, vectors: FloatArray) -> None:
    n = data.slots.shape[1]
    order, scratch = np.empty(n, dtype=np.int64), np.empty((3, max(n, PRODUCTS)))
    for b in range(data.alarm.shape[0]):
        if data.alarm[b]:
            case = data.rows[b], data.lines[b], data.offsets[b], data.table[b]
            found = search(*case, limit, vectors, order, scratch)
            data.solved[b], data.mask[b], data.positionings[b] = found


@settings_record
class SrvRaim(ConsistencyTest):
    """Residual test of all satellites in view; after an alarm, two groups by residual vectors.

    Notes
    -----
    ``memory["group"]`` is (B, n): 1 and 2 for the groups, all 1 without an alarm, and 0 for what
    is not known: no verdict, or nothing found.
    """

    frame: str = setting(default="ned", one_of=("ned", "ecef"), help="Axes of the search vectors.")
    exclude: bool = exclusion("the second group, which may be the authentic one, has")

    paper: ClassVar[str] = "wu2024"

    def search(self, data: SearchData) -> None:
        search_all(data, self._limit, SEARCH_VECTORS)


@njit
def leave_out(
    n: int,
    size: int,
    table: FloatArray,
    limit: FloatArray,
    sums: FloatArray,
    left: FloatArray,
    after: FloatArray,
    chosen: IntArray,
) -> tuple[bool, int, int]:
    """Leave out all subsets of one size, in lexicographic order. `sums`, `left` (size + 1,
    PRODUCTS) scratch, a stack: in row d, sums of what stays before the last of the first d that are
    left out, and of these d; `after` (n + 1, PRODUCTS) sums of the rows from i on, 0 in the last
    one; `chosen` (size,) scratch, rows that are left out."""
    tests = 2 if size >= MIN_SATELLITES else 1
    last_first = 0 if 2 * size == n else n - size
    fits, d = 0, 0
    chosen[0] = 0
    sums[:2] = 0.0
    left[0] = 0.0
    while d >= 0:
        i = chosen[d]
        if i <= (last_first if d == 0 else n - size + d):
            if d < size - 1:
                add(left, d, table, i, left, d + 1)
                d += 1
                chosen[d] = i + 1
                add(sums, d, after, n, sums, d + 1)
                continue
            fits += tests
            if squared_residual_of_both(sums, size, after, i + 1) < limit[n - size] and (
                tests == 1 or squared_residual_of_both(left, d, table, i) < limit[size]
            ):
                mask = (1 << n) - 1
                for k in range(size):
                    mask -= 1 << chosen[k]
                return True, mask, fits
        else:
            d -= 1
            if d < 0:
                break
        i = chosen[d]
        add(sums, d + 1, table, i, sums, d + 1)
        chosen[d] = i + 1
    return False, 0, fits


@njit
def search_path(
    n: int,
    table: FloatArray,
    limit: FloatArray,
    largest_group: int,
    after: FloatArray,
    stack: FloatArray,
    chosen: IntArray,
) -> tuple[bool, int, int]:
    """Search the smallest subset to leave out of n >= 5 satellites: as of `search`. `after` (N + 1,
    PRODUCTS), `stack` (2, largest_group + 1, PRODUCTS), `chosen` (largest_group,) scratch."""
    after[n] = 0.0
    for i in range(n - 1, -1, -1):
        add(after, i + 1, table, i, after, i)
    if squared_residual(after, 0) < limit[n]:
        return True, (1 << n) - 1, 1
    fits = 1
    for size in range(1, min(largest_group, n // 2, n - MIN_SATELLITES) + 1):
        found, mask, more = leave_out(n, size, table, limit, stack[0], stack[1], after, chosen)
        fits += more
        if found:
            return True, mask, fits
    return False, 0, fits


@njit
def search_all_paths(data: SearchData, limit: FloatArray, largest_group: int) -> None:
    n = data.slots.shape[1]
    after, stack = np.empty((n + 1, PRODUCTS)), np.empty((2, largest_group + 1, PRODUCTS))
    chosen = np.empty(largest_group, dtype=np.int64)
    for b in range(data.alarm.shape[0]):
        if data.alarm[b]:
            data.solved[b], data.mask[b], data.positionings[b] = search_path(
                data.rows[b], data.table[b], limit, largest_group, after, stack, chosen
            )


@settings_record
class TraversalRaim(ConsistencyTest):
    """Residual test of all satellites in view; after an alarm, the smallest group to leave out.

    Notes
    -----
    ``memory["group"]`` is as in `SrvRaim`.
    """

    largest_group: int = setting(
        default=LARGEST_GROUP, least=1, help="Most satellites to leave out."
    )
    exclude: bool = exclusion("those left out, which may be the authentic ones, have")

    paper: ClassVar[str] = "wu2024"

    def search(self, data: SearchData) -> None:
        search_all_paths(data, self._limit, self.largest_group)
