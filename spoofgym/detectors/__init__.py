"""Detectors: one algorithm a file, all behind the contract of `base`."""

from __future__ import annotations

import copy
import dataclasses
import difflib
from typing import Any

from .base import Detector, DetectorContext, Verdict
from .ewma import Ewma
from .never import Never
from .snapshot_chi2 import SnapshotChi2

__all__ = [
    "DETECTORS",
    "Detector",
    "DetectorContext",
    "Ewma",
    "Never",
    "SnapshotChi2",
    "Verdict",
    "make_detector",
]

DETECTORS: dict[str, type[Detector]] = {
    "ewma": Ewma,
    "never": Never,
    "snapshot-chi2": SnapshotChi2,
}
"""Detectors by name."""


def make_detector(spec: str | dict[str, Any] | Detector) -> Detector:
    """Detector by name, by name and settings, or a copy of an object.

    Parameters
    ----------
    spec : str, dict or Detector
        A name in `DETECTORS`; ``{"name": ..., "setting": value, ...}``; or a detector, which
        is copied.

    Returns
    -------
    Detector
        Not bound yet.

    Raises
    ------
    ValueError
        When the name or a setting is unknown; the valid ones are listed.
    TypeError
        When `spec` is something else.

    Examples
    --------
    >>> from spoofgym.detectors import make_detector
    >>> make_detector({"name": "ewma", "weight_scale": None})
    Ewma(smoothing=0.1, false_alarm=1e-05, weight_scale=None)
    """
    if isinstance(spec, Detector):
        return copy.deepcopy(spec)
    if isinstance(spec, str):
        spec = {"name": spec}
    if not isinstance(spec, dict) or not isinstance(spec.get("name"), str):
        raise TypeError(
            "a detector is a name, a dict with a `name`, or a Detector (subclass "
            f"spoofgym.detectors.Detector), got {spec!r}"
        )
    settings = dict(spec)
    name = settings.pop("name")
    if name not in DETECTORS:
        near = difflib.get_close_matches(name, DETECTORS, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"unknown detector {name!r}; valid: {', '.join(sorted(DETECTORS))}{hint}")
    kind = DETECTORS[name]
    valid = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
    for setting in settings:
        if setting not in valid:
            raise ValueError(
                f"detector {name!r} has no setting {setting!r}; valid: {', '.join(valid) or 'none'}"
            )
    return kind(**settings)
