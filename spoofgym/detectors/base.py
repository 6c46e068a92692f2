"""Detector, Verdict, and the check of a verdict where it enters a simulation.

The filter multiplies its gain with the weights in compiled code that checks no bounds, so that
nothing may reach it but what `Verdict` promises.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from contextlib import suppress
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.compile import njit
from ..core.memory import Memory
from ..receiver.augmented import FIRST, FilterModel
from ..receiver.epoch import OPTIONAL, Epoch, TracedEpoch
from ..receiver.states import STATES

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
HAVE_IT = "a tightly coupled receiver has one, in worlds with the same sensors and errors"
"""Which victims have a `DetectorContext.model`, for messages."""
MISSED = 1e-3
"""Probability, at an epoch, of an error beyond the protection level without an alarm."""
DETECTORS: dict[str, type[Detector]] = {}
"""Detectors by name; the package has them all."""


def find_name(kind: type[Detector]) -> str | None:
    """Registered name of a class of detectors."""
    return next((name for name, each in DETECTORS.items() if each is kind), None)


class Verdict(NamedTuple):
    """Judgement of an epoch by a detector.

    Attributes
    ----------
    statistic : ndarray
        (B, c) raw test statistic; c channels, or 1 for a test of the whole receiver.
    threshold : ndarray
        (B, c) what it is compared with, above 0: a calibration multiplies it by a factor.
    alarm : ndarray
        (B, c) bool.
    weights : ndarray or None
        (B, m) in [0, 1] on the columns of the Kalman gain, pseudoranges first; None for a
        passive detector.
    """

    statistic: FloatArray
    threshold: FloatArray
    alarm: BoolArray
    weights: FloatArray | None = None


def compare(
    statistic: FloatArray, threshold: FloatArray | float, weights: FloatArray | None = None
) -> Verdict:
    """Verdict with an alarm where a statistic (B, c) exceeds its threshold, (B, c) or a number."""
    limit = np.full(statistic.shape, threshold, dtype=np.float64)
    return Verdict(statistic, limit, statistic > limit, weights)


class YoungMemoryWarning(UserWarning):
    """A detector has not been live for as long as it remembers when an attack begins."""


class DetectorContext(NamedTuple):
    """What a detector is given once, before the first epoch.

    Attributes
    ----------
    receivers, channels : int
        B and n; a receiver whose measurement is a position has no channels, n = 0.
    epoch_interval_s : float
        Time between epochs.
    noise_variance : ndarray
        (m,) R that the filter assumes, pseudoranges first [m^2], [m^2/s^2]; or of the coordinates
        of a position.
    satellite_ids : tuple of str
        (n,) id of each slot, ``""`` for an empty one.
    single_epoch_sd : ndarray or None
        (m,) standard deviations of the errors of one epoch alone, as the filter assumes them [m],
        [m/s]; None for the root of `noise_variance`.  A filter without states for lasting errors
        assumes more noise than one epoch has: a test of single epochs takes these instead.
    states : int
        Error states of a tightly coupled filter, s of the fields of an epoch.
    min_satellites : int
        Fewest satellites with which a tightly coupled filter updates; with fewer it coasts.
    inertial_states : int
        How many of `states` are of navigation, clock and inertial sensors.  The others are errors
        of signals; in `transition` they act on no other state.
    model : FilterModel or None
        For a filter beside the victim's (`own_filter`): the errors of sensors and signals that the
        victim's designer assumes.  None unless the victim is tightly coupled, and all its episodes
        have the same grade of sensors and the same kind of errors.
    """

    receivers: int
    channels: int
    epoch_interval_s: float
    noise_variance: FloatArray
    satellite_ids: tuple[str, ...]
    single_epoch_sd: FloatArray | None = None
    states: int = STATES
    min_satellites: int = 4
    inertial_states: int = FIRST
    model: FilterModel | None = None


class Detector(ABC):
    """A detector with memory of B receivers; it has no truth, clock time or random generator.

    A subclass declares its arrays in `bind` (``self.memory.declare(name, initial)``, with a leading
    axis of receivers) and keeps nothing else from one epoch to the next: then reset (when a run
    starts), batches, and episodes that move between batches need no further code.

    Attributes
    ----------
    paper : str
        Key in references.bib; a detector from outside the package needs none.
    needs : frozenset of str
        Optional fields of `Epoch` that it reads; a field is None unless listed in `needs`.
    scope : {"channel", "receiver"}
        Whether it judges every channel, c = n (every coordinate of a position, c = m), or the
        receiver as a whole, c = 1.
    measures : {"satellites", "position", "any"}
        What it takes for a measurement: satellites' ranges, a position (n = 0), or either.
    oracle : bool
        Whether it is given what no receiver can know; never part of a comparison by default.
    drifts : bool
        Whether its statistic subtracts a drift and is 0 below it, as a cumulative sum.  Where the
        innovations are smaller than the filter believes it is 0 in most epochs, which no factor
        on the threshold mends; innovations can then be rescaled (`Calibrated`).
    alarm_is_state : bool
        Whether an alarm is more than statistic above threshold, such as a flag that stays up.  Such
        a detector is a dataclass with a setting `alarm_scale`, 1 by default: the factor on the
        thresholds of its alarm, and of nothing else, so that up to the first alarm nothing depends
        on it.
    calibrates : bool
        Whether its alarms depend on thresholds; False for a detector that never alarms.
    has_nominal : bool
        Whether it has thresholds of its own, as published or on its card.
    draws : bool
        Whether it alarms at random, as `Lottery`, with the last bits of its innovations as the
        source.  These differ between kinds of processor: runs of its calibrations are not replayed.
    label : str or None
        What it is called in tables; None for its registered name, or that of its class.
    card : DetectorCard or None
        Of a detector that was loaded from a file.
    judges : tuple of Detector
        Members of a pool; none of any other detector.
    from_start : bool
        Whether it is shown the filter-only warm-up, too (`watch`), in which nothing counts.
    needs_model : bool
        Whether it takes a victim that has a `DetectorContext.model`.
    silent_epochs : int
        Epochs after a reset in which it can't alarm, since a window is not full; set by `bind`, as
        `check_detector` says.
    memory_epochs : int
        Epochs after which it no longer matters when it went live: the length of its longest
        window, set by `bind`; 0 without one.
    memory : Memory
        What it remembers of every receiver.
    judged_rows : ndarray or None
        (r,) the receivers whose verdicts count, while other detectors of a pool judge the rest of
        the batch; None for all.  A costly detector can leave the rest out: any finite statistic,
        a threshold above 0 and no alarm.
    """

    paper: ClassVar[str] = ""
    needs: ClassVar[frozenset[str]] = frozenset()
    scope: ClassVar[str] = "receiver"
    measures: ClassVar[str] = "satellites"
    oracle: ClassVar[bool] = False
    drifts: ClassVar[bool] = False
    calibrates: ClassVar[bool] = True
    draws: ClassVar[bool] = False
    label: ClassVar[str | None] = None
    alarm_is_state: bool = False
    card: ClassVar[Any] = None
    judges: ClassVar[tuple[Detector, ...]] = ()
    has_nominal: bool = True
    from_start: bool = False
    needs_model: bool = False
    silent_epochs: int = 0
    memory_epochs: int = 0
    memory: Memory
    judged_rows: NDArray[np.intp] | None = None

    def bind(self, context: DetectorContext) -> None:
        """Prepare for a batch of receivers; one that remembers calls this first, then declares.

        Parameters
        ----------
        context : DetectorContext
            Sizes, interval, noise and satellites.
        """
        check_needs(self)
        measured = "satellites" if context.channels else "position"
        if self.measures not in (measured, "any"):
            raise ValueError(
                f"{type(self).__name__} measures {self.measures}, but the receiver measures "
                f"{measured}"
            )
        self.memory, self.judged_rows = Memory(context.receivers), None

    def is_armed(self, epoch: Epoch) -> NDArray[np.bool_] | None:
        """Whose alarms are on at an epoch.

        Parameters
        ----------
        epoch : Epoch
            Read-only, valid during this call.

        Returns
        -------
        ndarray or None
            (B,) bool; None for all.
        """
        return None

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget everything about some receivers.

        Parameters
        ----------
        mask : ndarray, optional
            (B,) bool, which ones; all by default.
        """
        self.memory.reset(mask)

    @abstractmethod
    def judge(self, epoch: Epoch) -> Verdict:
        """Judge one epoch of all receivers.

        Parameters
        ----------
        epoch : Epoch
            Read-only, valid during this call.

        Returns
        -------
        Verdict
            Fresh arrays, finite, 0 and no alarm where a channel is invisible.
        """

    def watch(self, epoch: Epoch) -> None:
        """See an epoch of the filter-only warm-up, whose verdict does not count.

        Parameters
        ----------
        epoch : Epoch
            Read-only, valid during this call.
        """
        self.judge(epoch)

    def protection_level(self, epoch: Epoch, scale: float = 1.0) -> FloatArray | None:
        """Horizontal protection level at an epoch that has just been judged.

        Parameters
        ----------
        epoch : Epoch
            Read-only, valid during this call.
        scale : float
            Factor on the thresholds, as of `Calibrated`.

        Returns
        -------
        ndarray or None
            (B,) what the horizontal position error exceeds without an alarm with a probability of
            at most `MISSED`, whatever the attack [m]; None of a detector that has none.
        """
        return None


def has_protection_level(detector: Detector) -> bool:
    inner = getattr(detector, "detector", None)  # of a calibrated one; a spec of an isolated one
    inner = inner if isinstance(inner, Detector) else detector
    return type(inner).protection_level is not Detector.protection_level


def check_needs(reader: object) -> frozenset[str]:
    """`needs` of a detector or monitor; a ValueError unless they are optional fields of `Epoch`."""
    needs: Any = getattr(reader, "needs", None)
    unknown = sorted(needs.difference(OPTIONAL)) if isinstance(needs, frozenset) else needs
    if unknown or not isinstance(needs, frozenset):
        raise ValueError(
            f"`{type(reader).__name__}.needs` must be a frozenset of optional fields of an epoch "
            f"({', '.join(OPTIONAL)}), got {needs!r}; not valid: {unknown!r}"
        )
    return needs


FLOAT, BOOL = np.dtype(np.float64), np.dtype(np.bool_)


def judge_epoch(detector: Detector, epoch: Epoch, rows: NDArray[np.intp] | None = None) -> Verdict:
    """Let a bound detector judge an epoch, and check its verdict. `rows`: `Detector.judged_rows`.
    A new victim calls its detector only through this function. An `UndeclaredFieldError`
    says where the detector fails because a field is None that it does not declare."""
    detector.judged_rows = rows
    try:
        return check_verdict(detector.judge(epoch), detector, epoch)
    except UndeclaredFieldError:  # of a detector in a pool
        raise
    except Exception as error:
        traced = TracedEpoch(*epoch)
        with suppress(Exception):
            detector.judge(traced)
        message = describe_undeclared(detector, traced)
        if message:
            raise UndeclaredFieldError(message) from error
        raise
    finally:
        detector.judged_rows = None


class UndeclaredFieldError(TypeError):
    """A detector reads an optional field of an epoch that its `needs` doesn't name."""


def describe_undeclared(detector: Detector, epoch: TracedEpoch) -> str:
    absent = {name for name, array in epoch._asdict().items() if array is None}
    read = sorted(epoch.read_fields & absent)
    if not read:
        return ""
    names = ", ".join(f"`epoch.{name}`" for name in read)
    needs = ", ".join(repr(name) for name in sorted(detector.needs.union(read)))
    return (
        f"{type(detector).__name__} reads {names}, None here, without declaring it; write `needs = "
        f"frozenset({{{needs}}})` into the class"
    )


def check_verdict(verdict: Verdict, detector: Detector, epoch: Epoch) -> Verdict:
    """Check the verdict of a bound detector; errors name detector, time, receiver, and value."""
    # one compiled pass over what has the usual form; `_examine` finds the words where it fails
    if type(verdict) is Verdict:
        statistic, threshold, alarm, weights = verdict
        b, m = epoch.innovation.shape
        shape = (b, (epoch.visible.shape[1] or m) if detector.scope == "channel" else 1)
        if (
            type(statistic) is type(threshold) is np.ndarray
            and type(alarm) is np.ndarray
            and statistic.shape == threshold.shape == alarm.shape == shape
            and statistic.dtype == threshold.dtype == FLOAT
            and alarm.dtype == BOOL
            and statistic.flags.carray
            and threshold.flags.carray
            and (
                weights is None
                or (
                    type(weights) is np.ndarray
                    and weights.shape == (b, m)
                    and weights.dtype == FLOAT
                    and weights.flags.carray
                )
            )
            and is_sound(statistic, threshold, weights)
        ):
            return verdict
    _examine(verdict, detector, epoch)
    return verdict


def checked_weights(weights: FloatArray, epoch: Epoch) -> FloatArray:
    _examine_part("an update", epoch, "weights", weights, epoch.innovation.shape, "")
    return weights


@njit
def is_sound(statistic: FloatArray, threshold: FloatArray, weights: FloatArray | None) -> bool:
    sound = True
    for b in range(statistic.shape[0]):
        for c in range(statistic.shape[1]):
            sound &= abs(statistic[b, c]) < np.inf and 0.0 < threshold[b, c] < np.inf
    if weights is not None:
        for b in range(weights.shape[0]):
            for c in range(weights.shape[1]):
                sound &= 0.0 <= weights[b, c] <= 1.0
    return sound


def _examine(verdict: Verdict, detector: Detector, epoch: Epoch) -> None:
    kind = type(detector).__name__
    if not isinstance(verdict, Verdict):
        raise TypeError(
            f"{_at(kind, epoch, 0)} `judge` must return a `Verdict`, got {type(verdict).__name__}; "
            "`from spoofgym.detectors import Verdict`"
        )
    (b, m), n = epoch.innovation.shape, epoch.visible.shape[1]
    columns = (n or m) if detector.scope == "channel" else 1
    measured = f"{n} channels" if n else f"a position of {m} coordinates"
    sizes = f" for {b} receivers with {measured} and scope {detector.scope!r}"
    for name, part in verdict._asdict().items():
        if part is not None or name != "weights":
            shape = (b, m if name == "weights" else columns)
            _examine_part(kind, epoch, name, part, shape, sizes)


def _examine_part(
    kind: str, epoch: Epoch, name: str, part: Any, shape: tuple[int, ...], sizes: str
) -> None:
    where = f"{_at(kind, epoch, 0)} `{name}`"
    if type(part) is not np.ndarray:
        raise TypeError(f"{where} must be an array, got {type(part).__name__}")
    if part.shape != shape:
        raise ValueError(f"{where} must have shape {shape}{sizes}, got {part.shape}")
    dtype = BOOL if name == "alarm" else FLOAT
    if part.dtype != dtype:
        raise TypeError(
            f"{where} must be of type {dtype}, got {part.dtype}; a comparison gives bool, "
            "`np.empty(shape)` float64"
        )
    if name == "weights":
        valid, bad = "lie within 0 and 1", ~((part >= 0.0) & (part <= 1.0))
    else:
        valid, bad = "be finite", ~np.isfinite(part)
        if name == "threshold":  # statistics are compared with it as ratios
            valid, bad = "be finite and above 0", ~((part > 0.0) & (part < np.inf))
    for row, column in np.argwhere(bad)[:1].tolist():
        raise ValueError(
            f"{_at(kind, epoch, row)} `{name}` must {valid}, got {part[row, column]} for "
            f"receiver {row} of {len(part)}, column {column}"
        )
    if name == "weights" and not part.flags.carray:
        raise ValueError(
            f"{where} must be a C-contiguous array that may be written to, since the kernels are "
            "compiled for such; `np.array(weights)` makes one"
        )


def _at(kind: str, epoch: Epoch, row: int) -> str:
    return f"{kind}, epoch at {epoch.time[row]:g} s:"


@njit
def cholesky_of_rows(
    innovation_cov: FloatArray,
    judged: BoolArray,
    first: int,
    last: int,
    rows: IntArray,
    factor: FloatArray,
) -> int:
    """Cholesky's factor of the rows of one receiver that take part, with inverted diagonal.
    `innovation_cov` (2n, 2n); `rows` (last - first,) and the first rows and columns of `factor` are
    written; returns how many rows take part, -1 where S is not positive definite."""
    n = judged.shape[0]
    count = 0
    for r in range(first, last):
        if judged[r % n]:
            rows[count] = r
            count += 1
    for i in range(count):
        for j in range(i + 1):
            value = innovation_cov[rows[i], rows[j]]
            for k in range(j):
                value -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = value * factor[j, j]
            elif value > 0.0:
                factor[i, i] = 1.0 / math.sqrt(value)
            else:
                return -1
    return count
