"""What Gymnasium sees: one step path over any victim, terms, wrappers, single and vector."""

from ..simulation import Domain, Engine, Setup, TightlyCoupledSetup, Timeline
from .core import SpoofCore
from .observer import Observer
from .spoofer_binding import attach
from .terms import TERMS, make_terms
from .terms.observation import default_terms
from .victims import (
    LooselyCoupledEnv,
    LooselyCoupledVectorEnv,
    SnapshotEnv,
    SnapshotVectorEnv,
    SpoofEnv,
    SpoofVectorEnv,
    WheeledRobotEnv,
    WheeledRobotVectorEnv,
)

__all__ = [
    "TERMS",
    "Domain",
    "Engine",
    "LooselyCoupledEnv",
    "LooselyCoupledVectorEnv",
    "Observer",
    "Setup",
    "SnapshotEnv",
    "SnapshotVectorEnv",
    "SpoofCore",
    "SpoofEnv",
    "SpoofVectorEnv",
    "TightlyCoupledSetup",
    "Timeline",
    "WheeledRobotEnv",
    "WheeledRobotVectorEnv",
    "attach",
    "default_terms",
    "make_terms",
]
