"""What the spec of a detector asks of its thresholds, and the detector that it makes.

Nominal thresholds, those of a calibration at a rate of false alarms, rescaled innovations, a factor
of the user's own, or a file: `calibrated` has what they mean.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ..core.registry import check_choice, spec_of
from ..policies.onnx_file import SUFFIX
from . import calibrated
from .base import Detector
from .calibrated import STANDARD_RATE, Calibrated
from .calibration_file import check_rate
from .pool import PooledDetector
from .zoo import shipped

THRESHOLDS = ("nominal", "calibrated", "rescaled")
"""Which thresholds a detector may be asked for with."""
ASKED = ("false_alarms_per_hour", "thresholds", "threshold_scale", "calibration")
"""Keys of a detector's spec that are not settings of its class."""


class Asked(NamedTuple):
    """What a spec asks of the thresholds: a rate, a variant, a factor, a file; None for nothing."""

    false_alarms_per_hour: float | None = None
    thresholds: str | None = None
    threshold_scale: float | None = None
    calibration: str | None = None


def split_spec(spec: Any) -> tuple[Any, Asked]:
    """A detector's spec without what it asks of the thresholds, and that."""
    if not isinstance(spec, Mapping):
        return spec, Asked()
    plain = {key: value for key, value in spec.items() if key not in ASKED}
    asked = Asked(**{key: spec[key] for key in ASKED if key in spec})
    word = repr(spec.get("name"))
    if asked.thresholds is not None:
        check_choice("choice of `thresholds`", asked.thresholds, THRESHOLDS)
    for key, stated, what in (
        ("thresholds", asked.thresholds == "nominal", "`thresholds` 'nominal'"),
        (
            "threshold_scale",
            asked.threshold_scale is not None,
            "`threshold_scale`, a factor of your own,",
        ),
    ):
        others = [f"`{k}`" for k in ASKED if k != key and getattr(asked, k) is not None]
        if stated and others:
            raise ValueError(
                f"detector {word} is asked for {what} and for {', '.join(others)}: leave out one"
            )
    if asked.calibration is not None and not isinstance(asked.calibration, str | Path):
        raise TypeError(f"`calibration` must be the path of a file, got {asked.calibration!r}")
    return plain, asked


def with_thresholds(detector: Detector, asked: Asked) -> Detector:
    """A detector with the thresholds that are asked for; one that never alarms has but its own."""
    rate, scale = asked.false_alarms_per_hour, asked.threshold_scale
    if rate is None and scale is None and asked != Asked():
        rate = STANDARD_RATE
    if asked in (Asked(), Asked(thresholds="nominal")):
        return detector
    if not detector.calibrates:
        if rate is not None:
            check_rate(rate)
        return detector
    path = None if asked.calibration is None else str(asked.calibration)
    rescaled = asked.thresholds == "rescaled"
    return Calibrated(detector, scale, rate, rescaled=rescaled, calibration=path)


def made_by(make: Callable[[Any], Detector], spec: Any, default: float | None = None) -> Detector:
    """Detector of a spec that may ask for thresholds, made by `make` from the rest of it. One that
    is named by an ONNX file is read. `default` is the rate where nothing is asked. An object plays
    as it is. A pool hands on to its members, by names or dicts, what they do not ask for
    themselves."""
    if isinstance(spec, str):
        spec = {"name": spec}
    if not isinstance(spec, Mapping):
        return make(spec)
    plain, asked = split_spec(spec)
    if asked == Asked() and default is not None and not has_threshold(plain):
        asked = Asked(false_alarms_per_hour=default)
    if is_file(plain):
        from .learned import of_file

        return of_file(plain, asked)
    if plain.get("name") == "pool":
        return make({**plain, "members": _members_asked(plain, asked)})
    return with_thresholds(make(plain), asked)


def is_file(spec: Any) -> bool:
    """Whether a detector is named by an ONNX file, or is a shipped one that has such a file."""
    name = spec.get("name") if isinstance(spec, Mapping) else spec
    return isinstance(name, str) and (name.endswith(SUFFIX) or name in shipped())


def has_threshold(spec: Any) -> bool:
    """Whether a detector in a file is given a threshold in place of a rate of false alarms."""
    return is_file(spec) and isinstance(spec, Mapping) and spec.get("threshold") is not None


def asks(spec: Mapping[str, Any]) -> bool:
    """Whether a detector's spec says which thresholds it is to have."""
    return bool({*ASKED} & {*spec}) or has_threshold(spec)


def _members_asked(pool: Mapping[str, Any], asked: Asked) -> Any:
    members = pool.get("members", PooledDetector.members)
    if asked == Asked() or isinstance(members, str | Mapping) or not isinstance(members, Sequence):
        return members
    words = {key: value for key, value in asked._asdict().items() if value is not None}
    named = [{"name": each} if isinstance(each, str) else each for each in members]
    return [
        {**each, **words} if isinstance(each, Mapping) and not asks(each) else each
        for each in named
    ]


def asked_by_default() -> dict[str, Any]:
    """What a spec without a word on its thresholds asks for in a world, by the keys of `ASKED`."""
    return {**dict.fromkeys(ASKED), "false_alarms_per_hour": calibrated.DEFAULT_RATE}


def spec_with_thresholds(detector: Detector, spec_of: Callable[[Any], Any]) -> dict[str, Any]:
    """Spec from which an equal detector is made; `spec_of` gives that of one not calibrated."""
    if not isinstance(detector, Calibrated):
        spec = dict(spec_of(detector))
        plain = calibrated.DEFAULT_RATE is None or isinstance(detector, PooledDetector)
        return spec if plain or not detector.calibrates else {**spec, "thresholds": "nominal"}
    asked: dict[str, Any] = {}
    if detector.false_alarms_per_hour is not None:
        asked["false_alarms_per_hour"] = detector.false_alarms_per_hour
    elif detector.scale is not None:
        asked["threshold_scale"] = detector.scale
    if detector.rescaled:
        asked["thresholds"] = "rescaled"
    if detector.calibration is not None:
        asked["calibration"] = detector.calibration
    return {**spec_of(detector.detector), **asked}


def spec_of_judge(detector: Detector) -> dict[str, Any]:
    """Name and all settings of a detector, and what it asks of its thresholds."""
    from .learned import LearnedDetector

    if isinstance(detector, LearnedDetector):  # as it is, not as its card has it
        return {**_spec_of_detector(detector), "threshold_scale": 1.0}
    return spec_with_thresholds(detector, _spec_of_detector)


def _spec_of_detector(detector: Detector) -> dict[str, Any]:
    """Name and all settings of a detector; a file also by its digest."""
    from . import DETECTORS
    from .learned import LearnedDetector

    if isinstance(detector, LearnedDetector):
        return {**detector.spec, "sha256": detector.sha256}
    return spec_of("detector", DETECTORS, detector)
