"""Detectors: one algorithm a file, all behind the contract of `base`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .._registry import build
from .base import Detector, DetectorContext, Verdict
from .ewma import Ewma
from .never import Never
from .snapshot_chi2 import SnapshotChi2
from .windowed_chi2 import WindowedChi2

__all__ = [
    "DETECTORS",
    "Detector",
    "DetectorContext",
    "Ewma",
    "Never",
    "SnapshotChi2",
    "Verdict",
    "WindowedChi2",
    "make_detector",
]

DETECTORS: dict[str, type[Detector]] = {
    "ewma": Ewma,
    "never": Never,
    "snapshot-chi2": SnapshotChi2,
    "windowed-chi2": WindowedChi2,
}
"""Detectors by name."""


def make_detector(spec: str | Mapping[str, Any] | Detector) -> Detector:
    """Detector by name, by name and settings, or a copy of an object.

    Parameters
    ----------
    spec : str, mapping or Detector
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
    return build("detector", DETECTORS, Detector, spec)
