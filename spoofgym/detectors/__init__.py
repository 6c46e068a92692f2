"""Detectors: one algorithm a file, all behind the contract of `base`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..core.registry import make
from . import calibrated
from .averages import Aime, ClockDrift, CumulativeBank, FiniteMovingAverage
from .base import Detector, DetectorContext, Verdict
from .build import made_by
from .calibrated import Calibrated
from .calibration_file import Calibration, OperatingPoint
from .charts import Ewma, JointChart, Shewhart
from .chi_square import SequentialChi2, SnapshotChi2, WindowedChi2
from .controls import Lottery, Never
from .cusum import Cusum, LagCusum
from .dead_reckoning import Acna, Rio
from .glr import GlrRamp, GlrStep
from .innovation_rate import InnovationRate, OracleRamp, OracleStep
from .learned import LearnedDetector
from .pool import PooledDetector
from .raim import Raim, SrvRaim, TraversalRaim
from .solution_separation import SolutionSeparation
from .zoo import shipped

__all__ = [
    "DETECTORS",
    "Acna",
    "Aime",
    "Calibrated",
    "Calibration",
    "ClockDrift",
    "CumulativeBank",
    "Cusum",
    "Detector",
    "DetectorContext",
    "Ewma",
    "FiniteMovingAverage",
    "GlrRamp",
    "GlrStep",
    "InnovationRate",
    "JointChart",
    "LagCusum",
    "LearnedDetector",
    "Lottery",
    "Never",
    "OperatingPoint",
    "OracleRamp",
    "OracleStep",
    "PooledDetector",
    "Raim",
    "Rio",
    "SequentialChi2",
    "Shewhart",
    "SnapshotChi2",
    "SolutionSeparation",
    "SrvRaim",
    "TraversalRaim",
    "Verdict",
    "WindowedChi2",
    "detector_in_world",
    "make_detector",
]

DETECTORS: dict[str, type[Detector]] = {
    "acna": Acna,
    "aime": Aime,
    "clock-drift": ClockDrift,
    "cumulative-bank": CumulativeBank,
    "cusum": Cusum,
    "ewma": Ewma,
    "fma": FiniteMovingAverage,
    "glr-ramp": GlrRamp,
    "glr-step": GlrStep,
    "innovation-rate": InnovationRate,
    "joint-chart": JointChart,
    "lag-cusum": LagCusum,
    "lottery": Lottery,
    "never": Never,
    "oracle-ramp": OracleRamp,
    "oracle-step": OracleStep,
    "pool": PooledDetector,
    "raim": Raim,
    "rio": Rio,
    "sequential-chi2": SequentialChi2,
    "shewhart": Shewhart,
    "snapshot-chi2": SnapshotChi2,
    "solution-separation": SolutionSeparation,
    "srv-raim": SrvRaim,
    "traversal-raim": TraversalRaim,
    "windowed-chi2": WindowedChi2,
}
"""Detectors by name."""


def make_detector(spec: str | Mapping[str, Any] | Detector) -> Detector:
    """Detector by name, by name and settings, by file, or a copy of an object.

    A name may be the path of an ``.onnx`` file with its card (`LearnedDetector`), whose nominal
    threshold is that of the card, or ``"threshold"`` in (0, 1].

    Besides the settings of its class a detector can be asked for its thresholds:
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
        When the name or a setting is unknown, the valid ones are listed; or a file does not fit
        its card.
    TypeError
        When `spec` is something else.

    Examples
    --------
    >>> from spoofgym.detectors import make_detector
    >>> make_detector({"name": "snapshot-chi2", "signals": "pseudorange"})
    SnapshotChi2(false_alarm=1e-05, signals='pseudorange', bias_window_s=0.0, two_sided=False)
    >>> make_detector({"name": "snapshot-chi2", "false_alarms_per_hour": 0.2}).resolved
    False
    """
    return made_by(_built, spec)


def detector_in_world(spec: str | Mapping[str, Any] | Detector) -> Detector:
    """Detector of an environment, a duel or a benchmark, at the default rate of false alarms.

    As `make_detector`, but that a name without a word on its thresholds has those of the default
    rate, which are looked up when the detector is bound to a world.

    Parameters
    ----------
    spec : str, mapping or Detector
        As `make_detector` takes it.

    Returns
    -------
    Detector
        Not bound yet.
    """
    return made_by(_built, spec, calibrated.DEFAULT_RATE)


def _built(spec: Any) -> Detector:
    return make("detector", DETECTORS, Detector, spec, shipped())
