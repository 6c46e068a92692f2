r"""Traversal RAIM: the smallest set of satellites without which all others agree.

All subsets are left out in turn, the smaller ones first; the first one that leaves satellites that
agree, and agrees itself where it is large enough to disagree, is the second group.  It finds
whatever the test of consistency can find, and takes thousands of fits where half of the satellites
are spoofed.

.. math:: \mathrm{SSE}(S) = \sqrt{\frac{r_S^T r_S}{|S| - 4}} < \mathrm{TH}(|S|) =
    \sigma \sqrt{\frac{\chi^2_p(|S| - 4)}{|S| - 4}}

for S the satellites that are kept, and for those left out where there are 5 or more.

Symbols: r_S residuals of a fit to the subset S, :math:`\sigma` noise of a pseudorange, p
confidence.

Assumptions: spoofed satellites tell one position and clock; noise is white and Gaussian.  Which
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

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._jit import njit
from ..receiver.epoch import Epoch
from ..receiver.raim import (
    MIN_SATELLITES,
    PRODUCTS,
    Partition,
    add,
    check_channels,
    check_test,
    checked_rows,
    fit_thresholds,
    noise_sd,
    partition_of,
    squared_residual,
    test_all,
    write_groups,
)
from .base import Detector, DetectorContext, Verdict
from .thresholds import check_probability

FloatArray = NDArray[np.float64]

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
    sums: FloatArray,
) -> tuple[bool, int, int]:
    """Leave out all subsets of one size, in lexicographic order.

    Parameters
    ----------
    n, size : int
        Satellites, and how many to leave out, at least 1; of two halves only that with row 0.
    table : ndarray
        (N + 1, PRODUCTS) products.
    limit : ndarray
        Limit of s^2 by number of satellites [m^2].
    kept, left : ndarray
        (size + 1, PRODUCTS) scratch, a stack: sums of what is kept before the last of the first d
        that are left out, and of these.
    after : ndarray
        (n + 1, PRODUCTS) sums of the rows from i on.
    chosen : ndarray
        (size,) scratch, rows that are left out.
    sums : ndarray
        (PRODUCTS,) scratch.

    Returns
    -------
    found : bool
        Whether both groups agree.
    mask : int
        Those that are kept.
    positionings : int
        Number of fits, of both groups where both are tested.
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
            add(left[d], table[i], left[d + 1])
            if d < size - 1:
                d += 1
                chosen[d] = i + 1
                kept[d + 1] = kept[d]
                continue
            add(kept[size], after[i + 1], sums)
            fits += tests
            if squared_residual(sums) < limit[n - size] and (
                tests == 1 or squared_residual(left[size]) < limit[size]
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
        add(kept[d + 1], table[i], kept[d + 1])
        chosen[d] = i + 1
    return False, 0, fits


@njit
def search(
    n: int,
    table: FloatArray,
    limit: FloatArray,
    largest_group: int,
    after: FloatArray,
    stack: FloatArray,
    chosen: NDArray[np.int64],
) -> tuple[bool, int, int]:
    """Search the smallest subset to leave out.

    Parameters
    ----------
    n : int
        Number of satellites, at least 5.
    table : ndarray
        (N + 1, PRODUCTS) products.
    limit : ndarray
        Limit of s^2 by number of satellites [m^2].
    largest_group : int
        Most satellites to leave out.
    after : ndarray
        (N + 1, PRODUCTS) scratch.
    stack : ndarray
        (3, largest_group + 1, PRODUCTS) scratch.
    chosen : ndarray
        (largest_group,) scratch.

    Returns
    -------
    found : bool
        Whether a partition has been found.
    mask : int
        Bit i for row i that is kept.
    positionings : int
        Number of fits.
    """
    after[n] = 0.0
    for i in range(n - 1, -1, -1):
        add(after[i + 1], table[i], after[i])
    if squared_residual(after[0]) < limit[n]:
        return True, (1 << n) - 1, 1
    fits = 1
    for size in range(1, min(largest_group, n // 2, n - MIN_SATELLITES) + 1):
        found, mask, more = leave_out(
            n, size, table, limit, stack[0], stack[1], after, chosen, stack[2, 0]
        )
        fits += more
        if found:
            return True, mask, fits
    return False, 0, fits


def traversal_raim(
    line_of_sight: ArrayLike,
    offset: ArrayLike,
    sigma_m: float,
    confidence: float = 0.95,
    largest_group: int = LARGEST_GROUP,
) -> Partition:
    """Two groups of satellites that each agree, the second one as small as can be.

    Parameters
    ----------
    line_of_sight : array_like
        (n, 3) unit vectors to the satellites.
    offset : array_like
        (n,) pseudorange minus predicted range [m]; what isn't finite is left out.
    sigma_m : float
        Noise of a pseudorange [m].
    confidence : float
        Probability that satellites that agree pass for it, in (0, 1).
    largest_group : int
        Most satellites to leave out.

    Returns
    -------
    Partition
        The groups, and the number of fits.

    Raises
    ------
    ValueError
        With fewer than 5 satellites, a singular geometry, or a setting out of range.
    """
    check_test(sigma_m, confidence)
    check_largest_group(largest_group)
    rows = checked_rows(line_of_sight, offset)
    n = len(rows.slots)
    found = search(
        n,
        rows.table,
        fit_thresholds(sigma_m, 1.0 - confidence, n),
        largest_group,
        np.empty((n + 1, PRODUCTS)),
        np.empty((3, largest_group + 1, PRODUCTS)),
        np.empty(largest_group, dtype=np.int64),
    )
    return partition_of(rows, len(np.asarray(offset)), *found)


def check_largest_group(largest_group: int) -> None:
    """Raise unless at least one satellite may be left out."""
    if largest_group < 1:
        raise ValueError(f"`largest_group` must be at least 1, got {largest_group}")


@njit
def judge_receivers(
    pseudorange: FloatArray,
    satellite_position: FloatArray,
    visible: NDArray[np.bool_],
    position: FloatArray,
    alarm_limit: FloatArray,
    limit: FloatArray,
    largest_group: int,
    statistic: FloatArray,
    threshold: FloatArray,
    group: NDArray[np.int8],
    weights: FloatArray,
) -> None:
    """Test all receivers, and search where there is an alarm.

    Parameters
    ----------
    pseudorange, satellite_position, visible, position : ndarray
        (B, n), (B, n, 3), (B, n), (B, 3) of the epoch.
    alarm_limit, limit : ndarray
        Limits of s^2 by number of satellites [m^2], of the alarm and of agreement.
    largest_group : int
        Most satellites to leave out.
    statistic, threshold : ndarray
        (B, 1), written [m].
    group : ndarray
        (B, n), written.
    weights : ndarray
        (B, 2n), written.
    """
    n = visible.shape[1]
    axes = np.eye(3)
    slots, chosen = np.empty(n, dtype=np.int64), np.empty(largest_group, dtype=np.int64)
    lines, offsets = np.empty((n, 3)), np.empty(n)
    table, after = np.empty((n + 1, PRODUCTS)), np.empty((n + 1, PRODUCTS))
    stack = np.empty((3, largest_group + 1, PRODUCTS))
    for b in range(visible.shape[0]):
        count, verdict = test_all(
            pseudorange[b],
            satellite_position[b],
            visible[b],
            position[b],
            axes,
            alarm_limit,
            slots,
            lines,
            offsets,
            table,
            statistic[b],
            threshold[b],
        )
        found, mask = verdict == 1, (1 << count) - 1
        if verdict == 2:
            found, mask, _ = search(count, table, limit, largest_group, after, stack, chosen)
        write_groups(found, mask, count, slots, visible[b], group[b], weights[b])


@dataclass
class TraversalRaim(Detector):
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

    sigma_m: float | None = None
    confidence: float = 0.95
    false_alarm: float = 1e-5
    largest_group: int = LARGEST_GROUP
    exclude: bool = False

    paper: ClassVar[str] = "wu2024"

    def __post_init__(self) -> None:
        """Check the settings."""
        check_test(self.sigma_m, self.confidence)
        check_probability("false_alarm", self.false_alarm)
        check_largest_group(self.largest_group)

    def bind(self, context: DetectorContext) -> None:
        """Prepare the limits for every number of satellites.

        Parameters
        ----------
        context : DetectorContext
            Sizes and noise.
        """
        super().bind(context)
        n = context.channels
        check_channels(n)
        sigma = noise_sd(self.sigma_m, context.noise_variance, n)
        most = max(n, MIN_SATELLITES)
        self._limit = fit_thresholds(sigma, 1.0 - self.confidence, most)
        self._alarm = fit_thresholds(sigma, self.false_alarm, most)
        self.memory.declare("group", np.zeros((context.receivers, n), dtype=np.int8))

    def judge(self, epoch: Epoch) -> Verdict:
        """Test one epoch.

        Parameters
        ----------
        epoch : Epoch
            Read-only.

        Returns
        -------
        Verdict
            (B, 1) SSE of all in view [m], threshold and alarm; (B, 2n) weights with `exclude`.
        """
        b = len(epoch.time)
        statistic, threshold = np.empty((b, 1)), np.empty((b, 1))
        weights = np.empty((b, 2 * epoch.visible.shape[1]))
        judge_receivers(
            epoch.pseudorange,
            epoch.satellite_position,
            epoch.visible,
            epoch.predicted_position,
            self._alarm,
            self._limit,
            self.largest_group,
            statistic,
            threshold,
            self.memory["group"],
            weights,
        )
        in_loop = weights if self.exclude else None
        return Verdict(statistic, threshold, statistic > threshold, in_loop)
