r"""Residual, residual-vector and traversal RAIM.

Classical receiver autonomous integrity monitoring: the least-squares residual.

A fit of position and clock to all pseudoranges leaves residuals, and these are too large when the
satellites do not agree.  One satellite that is wrong alone can be found: without it, the others
agree.  Satellites that are wrong together, as those of a spoofer are, can only be noticed.

.. math:: \mathrm{SSE} = \sqrt{\frac{r^T r}{n - 4}} >
    \sigma \sqrt{\frac{\chi^2_{1 - \alpha}(n - 4)}{n - 4}}, \qquad
    r = \left(I - G (G^T G)^{-1} G^T\right) y

Symbols: y pseudorange minus the range from the predicted position [m], G = (-u, 1) with lines of
sight u, n satellites, :math:`\sigma` noise of a pseudorange, :math:`\alpha` probability of a false
alarm.
The satellite to blame is the one with the largest :math:`r_i^2 / (1 - h_{ii})`, h being the
diagonal of the projection on G: that without which the residual is smallest.

Assumptions: white Gaussian noise, the same for all satellites; what all measurements have in
common, the receiver's clock above all, is part of the fit.  Spoofing of all satellites by the same
position and clock is consistent, and passes: "consistent" is not "authentic".

Deviations from `brown1992`:

1. The alarm has its own false-alarm probability; whether the others agree without the one to blame
   is tested with `confidence`.
2. With fewer than 5 satellites, or a singular geometry, there is no verdict: statistic 0.  With 5
   nobody can be blamed.

Source: `brown1992`, section on the least-squares-residuals method; `wu2024`, eq. 23.

SRV-RAIM: two groups of satellites, separated by the directions of their residual vectors.

Residuals of the fit to all satellites are made vectors along the rows of the geometry.  Those of
authentic and of spoofed satellites point to different sides of space, so that along one of 40
directions the five largest or the five smallest are likely of one kind; five that agree are a
seed, which takes in whatever agrees with it, and what is left over has to agree, too.  Some 20 fits
are enough, where a search of all subsets takes thousands.

.. math:: \mathrm{SRV}_i = r_i g_i, \qquad p_i(v) = v^T \mathrm{SRV}_i, \qquad
    \mathrm{SSE}(S) = \sqrt{\frac{r_S^T r_S}{|S| - 4}} < \mathrm{TH}(|S|) =
    \sigma \sqrt{\frac{\chi^2_p(|S| - 4)}{|S| - 4}}

Symbols: r residuals of the fit to all satellites, g rows (-u, 1) of the geometry, v search vectors,
r_S residuals of a fit to the subset S, :math:`\sigma` noise of a pseudorange, p confidence.

Assumptions: spoofed satellites agree on one position and clock; noise is white and Gaussian.  Which
group is authentic is not decided: the first one is that which was found first.  It was made for 12
satellites; with uniformly drawn subsets and errors of the paper it is right in some 80 % of the
cases with 10 satellites and in half with 8, and with fewer than 10 a second group of less than 5
is accepted untested.

Deviations from `wu2024`:

1. The growth of the seed (steps 12 to 19 of the printed algorithm) is repeated until a pass adds
   nothing; the printed single pass gives nearly twice the false separations of the paper's table 5
   with one spoofed satellite.
2. The detector searches only after an alarm of all satellites in view, with a false-alarm
   probability of its own; ``false_alarm = 0.05`` is the paper's confidence.
3. Step 39, whether the groups stay consistent for some seconds, is left out, as in the paper.
4. With fewer than 5 satellites, or a singular geometry, there is no verdict: statistic 0.

The search vectors belong to axes: groups found in ECEF and in north-east-down axes may differ, and
the latter serve for any local frame, whose axes are the same but for order and sign.

Source: `wu2024`, algorithm 1, eqs. 9, 15, 20 to 23.

Traversal RAIM: the smallest set of satellites without which all others agree.

All subsets are left out in turn, the smaller ones first; the first one that leaves satellites that
agree, and agrees itself where it is large enough to disagree, is the second group.  It finds
whatever the test of consistency can find, and takes thousands of fits where half of the satellites
are spoofed.

.. math:: \mathrm{SSE}(S) = \sqrt{\frac{r_S^T r_S}{|S| - 4}} < \mathrm{TH}(|S|) =
    \sigma \sqrt{\frac{\chi^2_p(|S| - 4)}{|S| - 4}}

for S the satellites that are kept, and for those left out where there are 5 or more.

Symbols: r_S residuals of a fit to the subset S, :math:`\sigma` noise of a pseudorange, p
confidence.

Assumptions: spoofed satellites agree on one position and clock; noise is white and Gaussian.  Which
group is authentic is not decided, and the larger one is kept.

Deviations from `wu2024`, where it is the method to compare with:

1. Nothing left out comes first, "no spoofing"; it costs one fit, which the paper's counts for one
   spoofed satellite seem to lack.
2. The detector searches only after an alarm of all satellites in view, with a false-alarm
   probability of its own; ``false_alarm = 0.05`` is the paper's confidence.
3. The second group has at most `largest_group` satellites: 6 is all there is with 12 in view, while
   20 would take half a million fits without it.
4. With fewer than 5 satellites, or a singular geometry, there is no verdict: statistic 0.

Source: `wu2024`, section 3, tables 7 and 8.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from itertools import product
from typing import ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.compile import njit
from ..core.registry import check_choice
from ..receiver.epoch import Epoch
from ..receiver.snapshot import (
    PRODUCTS,
    STATES,
    add,
    solve,
    squared_residual,
    squared_residual_of_both,
)
from .base import Detector, DetectorContext, Verdict
from .consistency import (
    FRAMES,
    MIN_SATELLITES,
    Partition,
    SearchData,
    check_channels,
    check_test,
    checked_rows,
    fit_thresholds,
    frame_axes,
    line_up_all,
    noise_sd,
    partition_of,
    search_data,
    write_groups,
)
from .innovation import check_probability

__all__ = ["Raim", "SrvRaim", "TraversalRaim"]


FloatArray = NDArray[np.float64]


class ConsistencyTest(Detector):
    """Residual test of all satellites in view; after an alarm, a search of groups that agree. A
    subclass is a dataclass with the settings below, which `Raim` describes."""

    sigma_m: float | None
    confidence: float
    false_alarm: float
    exclude: bool
    frame: str = "ecef"

    needs: ClassVar[frozenset[str]] = frozenset({"pseudorange", "satellite_position"})

    def __post_init__(self) -> None:
        check_test(self.sigma_m, self.confidence)
        check_probability("false_alarm", self.false_alarm)

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        b, n = context.receivers, context.channels
        check_channels(n)
        sigma = noise_sd(self.sigma_m, context.epoch_sd, n)
        most = max(n, MIN_SATELLITES)
        self._limit = fit_thresholds(sigma, 1.0 - self.confidence, most)
        self._alarm_limit = fit_thresholds(sigma, self.false_alarm, most)
        self._axes = np.tile(np.eye(3), (b, 1, 1))
        self._data = search_data(b, n)  # overwritten at every epoch
        self.memory.declare("group", np.zeros((b, n), dtype=np.int8))

    @abstractmethod
    def search(self, data: SearchData) -> None:
        """Divide the satellites of every receiver with an alarm: `found` and `mask`."""

    def judge(self, epoch: Epoch) -> Verdict:
        """Test one epoch. Returns (B, 1) SSE of all in view [m], threshold and alarm; (B, 2n)
        weights with `exclude`."""
        b, n = epoch.visible.shape
        statistic, threshold = np.empty((b, 1)), np.empty((b, 1))
        weights = np.empty((b, 2 * n))
        line_up_all(
            cast(FloatArray, epoch.pseudorange),
            cast(FloatArray, epoch.satellite_position),
            epoch.visible,
            epoch.predicted_position,
            self._axes if self.frame == "ecef" else frame_axes(epoch.predicted_position),
            self._alarm_limit,
            self._data,
            statistic,
            threshold,
            self.memory["group"],
            weights,
        )
        alarm: NDArray[np.bool_] = statistic > threshold
        if alarm.any():
            self.search(self._data)
            write_groups(self._data, epoch.visible, self.memory["group"], weights)
        return Verdict(statistic, threshold, alarm, weights if self.exclude else None)


def residual_statistic(line_of_sight: ArrayLike, offset: ArrayLike) -> float:
    r"""Test statistic of all satellites in view.

    .. math:: \mathrm{SSE} = \sqrt{r^T r / (n - 4)}

    `line_of_sight` (n, 3) unit vectors to the satellites; `offset` (n,) pseudorange minus predicted
    range [m]; what isn't finite is left out; returns SSE [m].
    """
    data, s2 = checked_rows(line_of_sight, offset)
    return math.sqrt(s2 / (data.rows[0] - STATES))


@njit
def blame(n: int, table: FloatArray, limit: FloatArray, kept: FloatArray) -> int:
    """The one satellite without which the others agree. `table` (N + 1, PRODUCTS) products;
    `limit`: limit of s^2 by number of satellites [m^2]; `kept` (1, PRODUCTS) scratch."""
    best, least = -1, limit[n - 1]
    for i in range(n if n > MIN_SATELLITES else 0):
        kept[:] = 0.0
        for k in range(n):
            if k != i:
                add(kept, 0, table, k, kept, 0)
        s2 = squared_residual(kept, 0)
        if s2 < least:
            best, least = i, s2
    return best


@njit
def blame_all(data: SearchData, limit: FloatArray) -> None:
    """Look for the satellite to blame in all receivers with an alarm."""
    kept = np.empty((1, PRODUCTS))
    for b in range(data.alarm.shape[0]):
        if data.alarm[b]:
            worst = blame(data.rows[b], data.table[b], limit, kept)
            if worst >= 0:
                data.found[b] = True
                data.mask[b] -= 1 << worst


@dataclass
class Raim(ConsistencyTest):
    """Least-squares residual of all satellites in view.

    Parameters
    ----------
    sigma_m : float or None
        Noise of a pseudorange [m]; None takes what the receiver assumes.
    confidence : float
        Probability that satellites that agree pass for it when somebody is to be blamed, in (0, 1).
    false_alarm : float
        Probability of an alarm in one epoch, in (0, 1).
    exclude : bool
        Give the satellite to blame weights 0, pseudorange and range rate, as long as the alarm
        lasts.

    Notes
    -----
    ``memory["group"]`` is (B, n): 1 for satellites that agree, 2 for the one to blame, 0 for
    what is not known.
    """

    described_as = "Raim"
    sigma_m: float | None = None
    confidence: float = 0.95
    false_alarm: float = 1e-5
    exclude: bool = False

    paper: ClassVar[str] = "brown1992"

    def search(self, data: SearchData) -> None:
        blame_all(data, self._limit)


SEED = 5
"""Satellites of a seed: the least number that can disagree."""


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
    order: NDArray[np.int64],
) -> None:
    """Projections of the residual vectors, and their order. `lines`, `residual` (N, 3), (N,) g and
    r [m]; `vectors` (V, 4) search vectors; `projection` (N,), written [m]; `order` (N,), written:
    rows by falling projection, equal ones by index."""
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
    n: int,
    table: FloatArray,
    limit: FloatArray,
    order: NDArray[np.int64],
    first: int,
    sums: FloatArray,
) -> tuple[bool, int, int]:
    """Test a seed, let it grow, and test what is left. `table` (N + 1, PRODUCTS) products; `limit`:
    limit of s^2 by number of satellites [m^2]; `order` (N,) rows by projection; `sums` (1,
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
    order: NDArray[np.int64],
    scratch: FloatArray,
) -> tuple[bool, int, int]:
    """Search two groups that agree. `n`: number of satellites, at least 5, of a geometry that isn't
    singular; `limit` (N + 1,) limit of s^2 by number of satellites [m^2]; `vectors` (V, 4) search
    vectors; `order` (N,) scratch; `scratch` (3, at least N and PRODUCTS) scratch; returns
    `positionings`: number of fits, that of all in view included."""
    projection, solution, sums = scratch[0], scratch[1], scratch[2:]
    solve(table, table.shape[0] - 1, solution)
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
    """Search in all receivers with an alarm, as `search` does."""
    n = data.slots.shape[1]
    order, scratch = np.empty(n, dtype=np.int64), np.empty((3, max(n, PRODUCTS)))
    for b in range(data.alarm.shape[0]):
        if data.alarm[b]:
            data.found[b], data.mask[b], data.positionings[b] = search(
                data.rows[b],
                data.lines[b],
                data.offsets[b],
                data.table[b],
                limit,
                vectors,
                order,
                scratch,
            )


def srv_raim(
    line_of_sight: ArrayLike, offset: ArrayLike, sigma_m: float, confidence: float = 0.95
) -> Partition:
    """Two groups of satellites that each agree, by their residual vectors. `line_of_sight` (n, 3)
    unit vectors to the satellites, in the axes that the search vectors belong to; `offset` (n,)
    pseudorange minus predicted range [m]; what isn't finite is left out; `sigma_m`: noise of a
    pseudorange [m]; `confidence`: probability that satellites that agree pass for it, in (0, 1)."""
    check_test(sigma_m, confidence)
    data, _ = checked_rows(line_of_sight, offset)
    limit = fit_thresholds(sigma_m, 1.0 - confidence, data.slots.shape[1])
    search_all(data, limit, SEARCH_VECTORS)
    return partition_of(data, len(np.asarray(offset)))


@dataclass
class SrvRaim(ConsistencyTest):
    """Residual test of all satellites in view; after an alarm, two groups by residual vectors.

    Parameters
    ----------
    sigma_m : float or None
        Noise of a pseudorange [m]; None takes what the receiver assumes.
    confidence : float
        Probability that satellites that agree pass for it in the search, in (0, 1).
    false_alarm : float
        Probability of an alarm in one epoch, in (0, 1).
    frame : {"ned", "ecef"}
        Axes of the search vectors.
    exclude : bool
        Give the second group weights 0, pseudoranges and range rates, as long as the alarm lasts.
        It may be the authentic one.

    Notes
    -----
    ``memory["group"]`` is (B, n): 1 and 2 for the groups, all 1 without an alarm, and 0 for what
    is not known: no verdict, or nothing found.
    """

    described_as = "SrvRaim"
    sigma_m: float | None = None
    confidence: float = 0.95
    false_alarm: float = 1e-5
    frame: str = "ned"
    exclude: bool = False

    paper: ClassVar[str] = "wu2024"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("frame", self.frame, FRAMES)

    def search(self, data: SearchData) -> None:
        search_all(data, self._limit, SEARCH_VECTORS)


LARGEST_GROUP = 6
"""Half of 12 satellites."""


@njit
def leave_out(
    n: int,
    size: int,
    table: FloatArray,
    limit: FloatArray,
    kept: FloatArray,
    left: FloatArray,
    after: FloatArray,
    chosen: NDArray[np.int64],
) -> tuple[bool, int, int]:
    """Leave out all subsets of one size, in lexicographic order.

    `table` (N + 1, PRODUCTS) products; `limit`: limit of s^2 by number of satellites [m^2]; `kept`,
    `left` (size + 1, PRODUCTS) scratch, a stack: in row d, sums of what is kept before the last of
    the first d that are left out, and of these d; `after` (n + 1, PRODUCTS) sums of the rows from i
    on, 0 in the last one; `chosen` (size,) scratch, rows that are left out.
    """
    tests = 2 if size >= MIN_SATELLITES else 1
    last_first = 0 if 2 * size == n else n - size
    fits, d = 0, 0
    chosen[0] = 0
    kept[:2] = 0.0
    left[0] = 0.0
    while d >= 0:
        i = chosen[d]
        if i <= (last_first if d == 0 else n - size + d):
            if d < size - 1:
                add(left, d, table, i, left, d + 1)
                d += 1
                chosen[d] = i + 1
                add(kept, d, after, n, kept, d + 1)
                continue
            fits += tests
            if squared_residual_of_both(kept, size, after, i + 1) < limit[n - size] and (
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
        add(kept, d + 1, table, i, kept, d + 1)
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
    chosen: NDArray[np.int64],
) -> tuple[bool, int, int]:
    """Search the smallest subset to leave out. `n`: number of satellites, at least 5; `table` (N +
    1, PRODUCTS) products; `limit`: limit of s^2 by number of satellites [m^2]; `after` (N + 1,
    PRODUCTS) scratch; `stack` (2, largest_group + 1, PRODUCTS) scratch; `chosen` (largest_group,)
    scratch."""
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
    """Search in all receivers with an alarm, as `search` does."""
    n = data.slots.shape[1]
    after, stack = np.empty((n + 1, PRODUCTS)), np.empty((2, largest_group + 1, PRODUCTS))
    chosen = np.empty(largest_group, dtype=np.int64)
    for b in range(data.alarm.shape[0]):
        if data.alarm[b]:
            data.found[b], data.mask[b], data.positionings[b] = search_path(
                data.rows[b], data.table[b], limit, largest_group, after, stack, chosen
            )


def traversal_raim(
    line_of_sight: ArrayLike,
    offset: ArrayLike,
    sigma_m: float,
    confidence: float = 0.95,
    largest_group: int = LARGEST_GROUP,
) -> Partition:
    """Two groups of satellites that each agree, the second one as small as can be. `line_of_sight`
    (n, 3) unit vectors to the satellites; `offset` (n,) pseudorange minus predicted range [m]; what
    isn't finite is left out; `sigma_m`: noise of a pseudorange [m]; `confidence`: probability that
    satellites that agree pass for it, in (0, 1)."""
    check_test(sigma_m, confidence)
    check_largest_group(largest_group)
    data, _ = checked_rows(line_of_sight, offset)
    search_all_paths(
        data, fit_thresholds(sigma_m, 1.0 - confidence, data.slots.shape[1]), largest_group
    )
    return partition_of(data, len(np.asarray(offset)))


def check_largest_group(largest_group: int) -> None:
    """Raise unless at least one satellite may be left out."""
    if largest_group < 1:
        raise ValueError(f"`largest_group` must be at least 1, got {largest_group}")


@dataclass
class TraversalRaim(ConsistencyTest):
    """Residual test of all satellites in view; after an alarm, the smallest group to leave out.

    Parameters
    ----------
    sigma_m : float or None
        Noise of a pseudorange [m]; None takes what the receiver assumes.
    confidence : float
        Probability that satellites that agree pass for it in the search, in (0, 1).
    false_alarm : float
        Probability of an alarm in one epoch, in (0, 1).
    largest_group : int
        Most satellites to leave out.
    exclude : bool
        Give the second group weights 0, pseudoranges and range rates, as long as the alarm lasts.
        It may be the authentic one.

    Notes
    -----
    ``memory["group"]`` is (B, n): 1 for satellites that are kept, all without an alarm, 2 for those
    left out, and 0 for what is not known: no verdict, or nothing found.
    """

    described_as = "TraversalRaim"
    sigma_m: float | None = None
    confidence: float = 0.95
    false_alarm: float = 1e-5
    largest_group: int = LARGEST_GROUP
    exclude: bool = False

    paper: ClassVar[str] = "wu2024"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_largest_group(self.largest_group)

    def search(self, data: SearchData) -> None:
        search_all_paths(data, self._limit, self.largest_group)
