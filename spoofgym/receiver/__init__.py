"""The victim: receivers that turn samples and ranges into a position."""

from .adaptive import SelfTuning
from .log import InnovationLog
from .loose import LooselyCoupled
from .plausibility import ImplausibleWarning
from .recording import PositionRecording, Recording
from .replay import Solution, replay
from .snapshot import Fix, least_squares_fix
from .tight import NavState, NoiseModel, TightlyCoupled

__all__ = [
    "Fix",
    "ImplausibleWarning",
    "InnovationLog",
    "LooselyCoupled",
    "NavState",
    "NoiseModel",
    "PositionRecording",
    "Recording",
    "SelfTuning",
    "Solution",
    "TightlyCoupled",
    "least_squares_fix",
    "replay",
]
