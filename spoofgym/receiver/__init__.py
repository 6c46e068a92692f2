"""The victim: receivers that turn samples and ranges into a position."""

from .least_squares import Fix, least_squares_fix
from .replay import Recording, Solution, replay
from .tight import NavState, NoiseModel, TightlyCoupled

__all__ = [
    "Fix",
    "NavState",
    "NoiseModel",
    "Recording",
    "Solution",
    "TightlyCoupled",
    "least_squares_fix",
    "replay",
]
