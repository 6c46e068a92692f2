"""Detectors as Gymnasium wrappers: ready ones, a recorder of alarms, a check, and a score.

`vector` has the twins for vector environments, and `spoofgym.sb3` those for stable-baselines3.
"""

from .alarms import AlarmRecorder, AlarmSummary
from .evaluate import AttackOutcome, WrappedScore, check_wrapper, evaluate_wrapped
from .single import (
    DetectorWrapper,
    EpochInfo,
    PassiveDetector,
    RecordEpochs,
    ResidualAction,
    StealthBudget,
    WatchWrapper,
)

__all__ = [
    "AlarmRecorder",
    "AlarmSummary",
    "AttackOutcome",
    "DetectorWrapper",
    "EpochInfo",
    "PassiveDetector",
    "RecordEpochs",
    "ResidualAction",
    "StealthBudget",
    "WatchWrapper",
    "WrappedScore",
    "check_wrapper",
    "evaluate_wrapped",
]
