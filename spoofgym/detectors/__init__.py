"""Detectors: one algorithm a file, all behind the contract of `base`."""

from __future__ import annotations

from ..receiver.epoch import Epoch
from .averages import Aime, ClockDrift, CumulativeBank, FiniteMovingAverage
from .base import DETECTORS, Detector, DetectorContext, Verdict
from .build import detector_in_world, make_detector
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
    "Epoch",
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

DETECTORS |= {
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
