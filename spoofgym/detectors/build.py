"""Detectors from specs, files and objects; which thresholds a spec requests.

Nominal thresholds, those of a calibration at a rate of false alarms, rescaled innovations, a factor
of the user's own, or a file: `calibrated` has what they mean.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.declared import check_number, check_word
from ..core.registry import build_spec, inspect_settings, make
from ..policies.card import DETECTOR
from ..policies.zoo import list_shipped, resolve_path
from . import calibrated
from .base import DETECTORS, Detector
from .calibrated import STANDARD_RATE, Calibrated
from .calibration_file import check_rate

THRESHOLDS = ("nominal", "calibrated", "rescaled")
"""Valid values of a spec's `thresholds`."""
THRESHOLD_KEYS = ("false_alarms_per_hour", "thresholds", "threshold_scale", "calibration")
"""Keys of a detector's spec that are not settings of its class."""


NOMINAL: tuple[dict[str, Any], ...] = ({}, {"thresholds": "nominal"})
"""Requests with which a detector keeps the thresholds of its class, or of its card."""


def split_spec(spec: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """A detector's spec without its request for thresholds, and that request."""
    plain = {key: value for key, value in spec.items() if key not in THRESHOLD_KEYS}
    request = {key: spec[key] for key in THRESHOLD_KEYS if spec.get(key) is not None}
    if "thresholds" in request:
        check_word("thresholds", request["thresholds"], THRESHOLDS)
    for key, stated, what in (
        ("thresholds", request.get("thresholds") == "nominal", "`thresholds` 'nominal'"),
        (
            "threshold_scale",
            "threshold_scale" in request,
            "`threshold_scale`, a factor of your own,",
        ),
    ):
        others = [f"`{k}`" for k in request if k != key]
        if stated and others:
            raise ValueError(
                f"detector {spec.get('name')!r} has {what} and {', '.join(others)}: leave out one"
            )
    if not isinstance(request.get("calibration", ""), str | Path):
        raise TypeError(f"`calibration` must be the path of a file, got {request['calibration']!r}")
    return plain, request


def with_thresholds(detector: Detector, request: Mapping[str, Any]) -> Detector:
    """A detector with the requested thresholds; one that never alarms has only its own."""
    rate, scale = request.get("false_alarms_per_hour"), request.get("threshold_scale")
    if request in NOMINAL:
        return detector
    if rate is None and scale is None:
        rate = STANDARD_RATE
    if not detector.calibrates:
        if rate is not None:
            check_rate(rate)
        return detector
    path = str(request["calibration"]) if "calibration" in request else None
    rescaled = request.get("thresholds") == "rescaled"
    return Calibrated(detector, scale, rate, rescaled=rescaled, calibration=path)


LOADERS: dict[str, Callable[[Mapping[str, Any]], Detector]] = {}
"""What loads a detector from a file, by the ending of its name; `learned` has its own here."""


def make_detector(spec: str | Mapping[str, Any] | Detector) -> Detector:
    """Detector by name, by name and settings, by file, or a copy of an object.

    A name may be the path of an ``.onnx`` file with its card (`LearnedDetector`), whose nominal
    threshold is that of the card, or ``"threshold"`` in (0, 1].

    Besides the settings of the detector's class a spec can request thresholds:
    ``"false_alarms_per_hour"`` is a rate by which a world looks up the factor on them
    (`Calibrated`), ``"thresholds"`` is ``"nominal"``, ``"calibrated"`` or ``"rescaled"``,
    ``"threshold_scale"`` a factor of one's own, and ``"calibration"`` a file.  A pool hands them on
    to its members.

    Parameters
    ----------
    spec : str, mapping or Detector
        A name in `DETECTORS`, or of a file; ``{"name": ..., "setting": value, ...}``; or a
        detector, which is copied.

    Returns
    -------
    Detector
        Not bound yet.

    Raises
    ------
    ValueError
        When the name or a setting is unknown, with the valid ones; or a file does not fit its card.
    TypeError
        When `spec` is something else.

    Examples
    --------
    >>> from spoofgym.detectors import make_detector
    >>> make_detector({"name": "snapshot-chi2", "signals": "pseudorange"}).signals
    'pseudorange'
    >>> make_detector({"name": "snapshot-chi2", "false_alarms_per_hour": 0.2}).resolved
    False
    """
    return _build(spec, None)


DetectorSpec = str | Mapping[str, Any] | Detector | type[Detector]


def detector_in_world(spec: DetectorSpec, false_alarms_per_hour: float | None = None) -> Detector:
    """Detector of an environment, a duel or a benchmark, at a rate of false alarms.

    As `make_detector`, except that a name or a class that requests no thresholds gets those of the
    default rate, 0.2 an hour.  They are looked up when the detector is bound to a world.

    Parameters
    ----------
    spec : str, mapping, Detector or type
        As `make_detector` takes it; or the class of a detector that needs no settings.
    false_alarms_per_hour : float, optional
        Rate instead of the default one; for an object, which else has its own thresholds, too.

    Returns
    -------
    Detector
        Not bound yet.

    Raises
    ------
    ValueError
        As in `make_detector`; or where both `spec` and `false_alarms_per_hour` request thresholds.
    """
    rate = false_alarms_per_hour
    if isinstance(spec, type) and issubclass(spec, Detector):
        rate = calibrated.DEFAULT_RATE if rate is None else rate
        return detector_in_world(_instantiate(spec), rate)
    if rate is None:
        return _build(spec, calibrated.DEFAULT_RATE)
    given = _as_mapping(spec)
    own = asks(given) if isinstance(given, Mapping) else isinstance(given, Calibrated)
    if own:
        raise ValueError(
            f"`false_alarms_per_hour` = {rate!r} is given, but {spec!r} has thresholds of its own: "
            "leave out one"
        )
    if isinstance(given, Mapping):
        return _build({**given, "false_alarms_per_hour": rate}, None)
    return with_thresholds(_build(given, None), {"false_alarms_per_hour": rate})


def _instantiate(kind: type[Detector]) -> Detector:
    try:
        return kind()
    except TypeError as error:
        raise ValueError(f"detector {kind.__name__}: {error}") from error


def bare_detector(spec: DetectorSpec) -> Detector:
    """As `make_detector`, but it takes a class, too, and a file needs no threshold: its request for
    one is ignored."""
    if isinstance(spec, type) and issubclass(spec, Detector):
        return _instantiate(spec)
    load = _loader(spec)
    return make_detector(spec) if load is None else load(_as_mapping(spec))


def _build(spec: Any, default: float | None) -> Detector:
    """Detector of a spec, at the `default` rate where it requests no thresholds. An object plays as
    it is; a pool hands its request on to members without one."""
    spec = _as_mapping(spec)
    if not isinstance(spec, Mapping):
        return make("detector", DETECTORS, Detector, spec, list_shipped(DETECTOR))
    plain, request = split_spec(spec)
    load = _loader(plain)
    if not request and default is not None and not has_own_threshold(plain):
        request = {"false_alarms_per_hour": default}
    if load is not None:
        return _with_own_threshold(load(plain), plain, request)
    if plain.get("name") == "pool":
        plain["members"] = _request_thresholds(plain, request)
    made = make("detector", DETECTORS, Detector, plain, list_shipped(DETECTOR))
    return made if made.judges else with_thresholds(made, request)


def _as_mapping(spec: Any) -> Any:
    return {"name": spec} if isinstance(spec, str) else spec


def _loader(spec: Any) -> Callable[[Mapping[str, Any]], Detector] | None:
    """What loads the file that a spec names, or that a shipped detector has."""
    name = spec.get("name") if isinstance(spec, Mapping) else spec
    if not isinstance(name, str):
        return None
    path = str(resolve_path(name, DETECTOR))
    return next((load for end, load in LOADERS.items() if path.endswith(end)), None)


def _with_own_threshold(
    made: Detector, plain: Mapping[str, Any], request: Mapping[str, Any]
) -> Detector:
    """A loaded detector with its threshold. Its statistic is compared with 1, so that a factor on
    that is a threshold; the nominal one is that of the card."""
    name, own = plain["name"], plain.get("threshold")
    if own is not None:
        check_number("threshold", own, above=0.0, most=1.0)
        if request not in NOMINAL:
            raise ValueError(
                f"detector {name!r} has a `threshold` of its own, and a request for another one: "
                "leave out one"
            )
        return Calibrated(made, scale=float(own))
    if request not in NOMINAL:
        return with_thresholds(made, request)
    if made.card.threshold is not None:
        return Calibrated(made, scale=made.card.threshold)
    raise ValueError(
        f"{name} has no threshold on its card: ask for `false_alarms_per_hour`, which "
        "`spoofgym calibrate` finds a threshold for, or give one as `threshold`"
    )


def asks(spec: Mapping[str, Any]) -> bool:
    """Whether a detector's spec says which thresholds it is to have."""
    return bool({*THRESHOLD_KEYS} & {*spec}) or has_own_threshold(spec)


def has_own_threshold(spec: Mapping[str, Any]) -> bool:
    """Whether a detector in a file is given a threshold in place of a rate of false alarms."""
    return _loader(spec) is not None and spec.get("threshold") is not None


def _request_thresholds(pool: Mapping[str, Any], request: Mapping[str, Any]) -> Any:
    members = pool.get("members", inspect_settings(DETECTORS["pool"])["members"])
    if not request or isinstance(members, str | Mapping) or not isinstance(members, Sequence):
        return members
    return [
        {**each, **request} if isinstance(each, Mapping) and not asks(each) else each
        for each in map(_as_mapping, members)
    ]


def get_default_request() -> dict[str, Any]:
    """What a spec without thresholds requests in a world, by the keys of `THRESHOLD_KEYS`."""
    return {**dict.fromkeys(THRESHOLD_KEYS), "false_alarms_per_hour": calibrated.DEFAULT_RATE}


def spec_with_thresholds(detector: Detector, spec_of: Callable[[Any], Any]) -> dict[str, Any]:
    """Spec from which an equal detector is made; `build_spec` gives that of one not calibrated."""
    if not isinstance(detector, Calibrated):
        spec = dict(spec_of(detector))
        plain = calibrated.DEFAULT_RATE is None or bool(detector.judges)
        return spec if plain or not detector.calibrates else {**spec, "thresholds": "nominal"}
    rate = detector.false_alarms_per_hour
    request = {
        "false_alarms_per_hour": rate,
        "threshold_scale": detector.scale if rate is None else None,
        "thresholds": "rescaled" if detector.rescaled else None,
        "calibration": detector.calibration,
    }
    given = {key: value for key, value in request.items() if value is not None}
    return {**spec_of(detector.detector), **given}


def spec_of_judge(detector: Detector) -> dict[str, Any]:
    """Name and all settings of a detector, and its request for thresholds."""
    if detector.card is not None:  # as it is, not as its card has it
        return {**_spec_of_detector(detector), "threshold_scale": 1.0}
    return spec_with_thresholds(detector, _spec_of_detector)


def _spec_of_detector(detector: Any) -> dict[str, Any]:
    """Name and all settings of a detector; a file also by its digest."""
    if detector.card is None:
        return build_spec("detector", DETECTORS, detector)
    return {**detector.spec, "sha256": detector.sha256}
