r"""A detector at a stated rate of false alarms: the thresholds are scaled, the weights are not.

``{"name": "ewma", "false_alarms_per_hour": 0.2}`` is a detector whose thresholds are multiplied by
the factor that clean runs of its world give (`calibration_file`).  Its alarm is

.. math:: \text{statistic} > \text{scale} \times \text{threshold}

and its weights stay as published: a factor on them would be another detector.  Where the alarm is a
state that outlasts its cause, the detector itself takes the factor, `Detector.alarm_scale`.  A pool
calibrates its members one by one, so that each keeps the rate, and with them any mixture.

With ``"thresholds": "rescaled"`` common mode and complement of the innovations are scaled by a
factor each before they are judged, so that their variance in clean runs is what the filter
believes.  That is for tests with a drift term, whose sums a factor on the threshold can't mend.
"""

from __future__ import annotations

import dataclasses
import json
import shlex
import warnings
from typing import Any, ClassVar, Protocol

import numpy as np

from ..core.compile import njit
from ..core.declared import setting, settings_record
from ..core.registry import inspect_settings
from ..core.settings import list_written, outside_sources
from ..receiver.epoch import Epoch
from .base import (
    DETECTORS,
    BoolArray,
    Detector,
    DetectorContext,
    FloatArray,
    Verdict,
    compare,
    find_name,
)
from .calibration_file import (
    Calibration,
    Conditions,
    OperatingPoint,
    check_rate,
    describe_as_json,
    load_stored,
    nearest,
)

STANDARD_RATE = 0.2
"""False alarms an hour where calibrated thresholds are requested without a rate."""
DEFAULT_RATE: float | None = STANDARD_RATE
"""False alarms an hour of a detector in a world whose spec has no thresholds; None for nominal."""
NOISY_WARMUP = 0.2
"""Share of clean runs with an alarm before the attack above which there is a warning."""


LARGEST_FACTOR = 10.0
"""Factor on the thresholds of a test with a drift term above which there is a warning."""


class UncalibratedWarning(UserWarning):
    """A detector plays with thresholds whose rate of false alarms is unknown."""


class CalibrationWorld(Protocol):
    """What a calibration is looked up by: a `Setup`."""

    @property
    def conditions(self) -> Conditions: ...

    def check_fit(self, detector: Detector) -> None:
        """Raise a ValueError where a detector, with any thresholds, can't judge here."""


@settings_record
class Calibrated(Detector):
    """A detector with scaled thresholds; its weights stay as they are.

    Attributes
    ----------
    point : OperatingPoint or None
        What it was looked up with.

    Examples
    --------
    >>> from spoofgym.detectors import Calibrated, SnapshotChi2
    >>> Calibrated(SnapshotChi2(), scale=0.8).scale
    0.8
    """

    detector: Detector = setting(
        help="Any but a pool, which calibrates its members; copied with this one."
    )
    scale: float | None = setting(
        default=None,
        above=0.0,
        help="Factor on its thresholds; None to look it up where the world is known.",
    )
    false_alarms_per_hour: float | None = setting(
        default=None, above=0.0, help="Rate by which to look it up."
    )
    rescaled: bool = setting(
        default=False,
        help="Whether innovations are scaled before they are judged; for detectors with a drift "
        "term.",
    )
    rescale: tuple[float, ...] | None = setting(
        default=None,
        above=0.0,
        help="Four factors on innovations: common mode and complement of the pseudoranges, then "
        "of the range rates; None to look them up.",
    )
    calibration: str | None = setting(
        default=None, help="File to take instead of those of the package and of the user."
    )

    paper: ClassVar[str] = "vovk2005"
    measures: ClassVar[str] = "any"
    point: ClassVar[OperatingPoint | None] = None
    resolved_for: ClassVar[str | None] = None

    def __post_init__(self) -> None:
        inner = self.detector
        if not isinstance(inner, Detector) or isinstance(inner, Calibrated):
            raise TypeError(f"`detector` must be a Detector that is not calibrated, got {inner!r}")
        if inner.judges:
            raise TypeError("a pool calibrates its members: ask them for the rate, one by one")
        if self.scale is None and self.false_alarms_per_hour is None:
            raise ValueError("a calibrated detector needs `scale` or `false_alarms_per_hour`")
        if self.false_alarms_per_hour is not None:
            self.false_alarms_per_hour = float(self.false_alarms_per_hour)
        if self.rescaled:
            check_drifts(inner)
        if self.rescale is not None:
            self.rescale = tuple(float(factor) for factor in self.rescale)
            if len(self.rescale) != 4:
                raise ValueError(f"`rescale` must be four factors above 0, got {self.rescale}")
        for name in ("paper", "needs", "scope", "measures", "oracle", "from_start", "needs_model"):
            setattr(self, name, getattr(inner, name))

    @property
    def resolved(self) -> bool:
        return self.scale is not None and (self.rescale is not None or not self.rescaled)

    def bind(self, context: DetectorContext) -> None:
        if self.scale is None or not self.resolved:
            raise ValueError(
                f"{type(self.detector).__name__} has no threshold for "
                f"{self.false_alarms_per_hour:g} false alarms an hour, and no "
                "world is known to look its thresholds up for: give it to an "
                "environment, or take `thresholds` 'nominal'"
            )
        inner = self.detector
        if inner.alarm_is_state:
            inner = dataclasses.replace(inner, alarm_scale=self.scale)  # type: ignore[type-var]
        self._judge, self._scale = inner, self.scale
        self._factors = np.array(self.rescale or (1.0,) * 4)
        inner.bind(context)
        self.memory, self.silent_epochs = inner.memory, inner.silent_epochs

    def reset(self, mask: BoolArray | None = None) -> None:
        self._judge.reset(mask)

    def is_armed(self, epoch: Epoch) -> BoolArray | None:
        return self.detector.is_armed(epoch)

    def watch(self, epoch: Epoch) -> None:
        self._judge.watch(self._rescale_epoch(epoch))

    def _rescale_epoch(self, epoch: Epoch) -> Epoch:
        if not self.rescaled:
            return epoch
        innovation = np.empty(epoch.innovation.shape)
        rescale_innovations(epoch.innovation, epoch.visible, self._factors, innovation)
        return epoch._replace(innovation=innovation)

    def judge(self, epoch: Epoch) -> Verdict:
        epoch = self._rescale_epoch(epoch)
        self._judge.judged_rows = self.judged_rows
        try:
            verdict = self._judge.judge(epoch)
        finally:
            self._judge.judged_rows = None
        if self.detector.alarm_is_state:
            return verdict
        return compare(verdict.statistic, self._scale * verdict.threshold, verdict.weights)

    def protection_level(self, epoch: Epoch, scale: float = 1.0) -> FloatArray | None:
        return self._judge.protection_level(epoch, scale * self._scale)

    def look_up(self, world: CalibrationWorld) -> None:
        conditions, identity = world.conditions, describe_identity(self.detector)
        rate = check_rate(self.false_alarms_per_hour)
        failure: ValueError | None = None
        for found in self._load_candidates(conditions, identity):
            try:
                self.take(found, rate)
                self.resolved_for = conditions.digest  # type: ignore[misc]
                return
            except ValueError as error:
                failure = error
        raise failure or ValueError(self._missing(conditions, identity))

    def find_calibration(self, world: CalibrationWorld) -> Calibration | None:
        """The stored calibration that gave its scale; None where the scale was passed."""
        if self.point is None:
            return None
        rate = self.point.false_alarms_per_hour
        found = self._load_candidates(world.conditions, describe_identity(self.detector))
        return next((x for x in found if x.has(rate) and x.point(rate) == self.point), None)

    def take(self, calibration: Calibration, rate: float) -> None:
        point = calibration.point(rate)
        self.scale, self.point = point.scale, point  # type: ignore[misc]
        self.rescale = calibration.rescale if self.rescaled else None
        if point.warmup_alarms > NOISY_WARMUP:
            name = self.detector.label or describe_identity(self.detector)["name"]
            warnings.warn(noisy_warmup(name, point), stacklevel=2)
        if self.detector.drifts and point.scale > LARGEST_FACTOR:
            warnings.warn(describe_blunt(self.detector, point), stacklevel=2)

    def _load_candidates(
        self, conditions: Conditions, identity: dict[str, Any]
    ) -> list[Calibration]:
        if self.calibration is None:
            return list(load_stored(conditions, identity, self.rescaled))
        found = Calibration.load(self.calibration)
        found.check_matches(conditions.settings, identity, conditions.label, self.rescaled)
        return [found]

    def _missing(self, conditions: Conditions, identity: dict[str, Any]) -> str:
        rate = f"{self.false_alarms_per_hour:g}"
        shown = {"name": identity["name"], **collect_settings(self.detector)}
        line = calibration_command(
            self.detector, conditions, self.false_alarms_per_hour, rescaled=self.rescaled
        )
        near = nearest(conditions, identity, self.rescaled)
        seen = ""
        if near is not None and near[1]:
            seen = f" The nearest one, {near[0]}, differs in {'; '.join(near[1][:4])}."
        nominal = {**shown, "thresholds": "nominal"}
        other = f"take its nominal thresholds: {json.dumps(nominal)}"
        if not self.detector.has_nominal:
            other = f"give a threshold: {json.dumps({**shown, 'threshold': 0.9})}"
        return (
            f"there is no calibration of {shown['name']} in {conditions.label} to set its "
            f"thresholds for {rate} false alarms an hour by. Make one with {line}, or "
            f"{other}. A detector that a wrapper sets needs none before: detector='never'.{seen}"
        )


def collect_settings(detector: Detector) -> dict[str, Any]:
    """Settings of a detector that are not its defaults, as far as they are JSON-able."""
    if hasattr(detector, "spec"):
        return dict(detector.spec)
    if hasattr(detector, "identity"):
        return {}
    defaults = inspect_settings(type(detector))
    given = {key: getattr(detector, key, default) for key, default in defaults.items()}
    try:
        return {key: describe_as_json(x) for key, x in given.items() if x != defaults[key]}
    except (TypeError, ValueError):
        return {}


def calibration_command(
    detector: Detector, conditions: Conditions, rate: float | None, *, rescaled: bool = False
) -> str:
    """What calibrates a detector in a world for a rate of false alarms, for messages."""
    if not conditions.options:
        return (
            "`spoofgym.calibration.calibrate_detectors(env.unwrapped.core.setup, ...)`, since no "
            "command line can name this world"
        )
    try:
        name = describe_identity(detector)["name"]
    except TypeError:  # it does not keep its settings
        name = name_kind(type(detector))
    shown = {"name": name, **collect_settings(detector)}
    quoted = shlex.quote(str(shown["name"]) if len(shown) == 1 else json.dumps(shown))
    variant = " --rescaled" if rescaled else ""
    return (
        f"`spoofgym calibrate {conditions.options} --detector {quoted} "
        f"--false-alarms-per-hour {rate:g}{variant}`"
    )


def name_kind(kind: type[Detector]) -> str:
    """Registered name of a class of detectors, or ``"module:Class"``."""
    return find_name(kind) or f"{kind.__module__}:{kind.__qualname__}"


def check_drifts(detector: Detector) -> None:
    if not detector.drifts:
        raise ValueError(
            f"`thresholds` 'rescaled' is for detectors with a drift term, which "
            f"{type(detector).__name__} is not: for it a factor on the threshold does the same"
        )


def describe_blunt(detector: Detector, point: OperatingPoint) -> str:
    return (
        f"{detector.label or name_kind(type(detector))} hardly ever alarms at an attack here: at "
        f"{point.false_alarms_per_hour:g} false alarms an hour its threshold is {point.scale:.3g} "
        "times the published one, since its sums grow in clean runs of this world"
    )


def noisy_warmup(name: str, point: OperatingPoint) -> str:
    return (
        f"{name} alarms before the attack in {100.0 * point.warmup_alarms:.0f} % of the clean runs "
        f"at {point.false_alarms_per_hour:g} false alarms an hour: its memory is not settled when "
        "the attack starts, or the world's beginning is not like the rest of it"
    )


@njit
def rescale_innovations(
    innovation: FloatArray, visible: BoolArray, factors: FloatArray, out: FloatArray
) -> None:
    r"""Scale common mode and complement of the innovations of each signal.

    .. math:: z' = a \bar z + b (z - \bar z)

    `out` (B, 2n) is written; `factors` (4,) a and b of the pseudoranges, then of the range rates;
    the mean is over the visible channels.
    """
    receivers, n = visible.shape
    for b in range(receivers):
        for signal in range(2):
            total, count = 0.0, 0
            for j in range(n):
                if visible[b, j]:
                    total += innovation[b, signal * n + j]
                    count += 1
            mean = total / max(count, 1)
            for j in range(n):
                r = signal * n + j
                out[b, r] = 0.0
                if visible[b, j]:
                    rest = innovation[b, r] - mean
                    out[b, r] = factors[2 * signal] * mean + factors[2 * signal + 1] * rest


def describe_identity(detector: Detector) -> dict[str, Any]:
    """Resolved settings of a detector, JSON-able, to which its calibration belongs. Settings that
    are not its own, such as those of a policy, a class gives by a method `identity`."""
    own = getattr(detector, "identity", None)
    if own is not None:
        return dict(describe_as_json(own()))
    kind = type(detector)
    name = name_kind(kind)
    settings = {*inspect_settings(kind)} - {"alarm_scale"}
    missing = sorted(key for key in settings if not hasattr(detector, key))
    if missing:
        raise TypeError(
            f"detector {name!r} must keep its settings under their names to be calibrated; it has "
            f"no {', '.join(map(repr, missing))}"
        )
    written = list_written(detector, sorted(settings))
    found = {"name": name, **{key: describe_as_json(getattr(detector, key)) for key in written}}
    sources = {} if kind in DETECTORS.values() else outside_sources(detector)
    readable = {name: digest for name, digest in sources.items() if digest is not None}
    return {**found, "sources": readable} if readable else found


def unwrap(detector: Detector) -> Any:
    """A detector without a factor on its thresholds."""
    return detector.detector if isinstance(detector, Calibrated) else detector


def calibrated_parts(detector: Detector) -> list[Calibrated]:
    """What of a detector, or of the members of a pool, has scaled thresholds."""
    return [each for each in detector.judges or (detector,) if isinstance(each, Calibrated)]


def find_requested_rate(detector: Detector) -> float | None:
    """False alarms an hour that a detector is calibrated to, the most of a pool; None without."""
    parts = calibrated_parts(detector)
    return max((each.false_alarms_per_hour or 0.0 for each in parts), default=0.0) or None


def resolve_thresholds(detector: Detector, world: CalibrationWorld) -> None:
    """Look up the factors of a detector, or of the members of a pool, that are not known in a
    world. Where there are none, a detector that does not fit the world at all is refused first."""
    for part in calibrated_parts(detector):
        if not part.resolved or part.resolved_for not in (None, world.conditions.digest):
            try:
                part.look_up(world)
            except ValueError:
                world.check_fit(part.detector)
                raise


def list_factors(detector: Detector) -> list[tuple[float | None, tuple[float, ...] | None]]:
    return [(each.scale, each.rescale) for each in calibrated_parts(detector)]
