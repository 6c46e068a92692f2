"""Checks of one's own detectors, attacks and spoofers, like Gymnasium's `check_env`.

They run an object through what its contract promises, and raise an AssertionError that says what
was expected, what came instead, and how to mend it.
"""

from .ages import check_ages, check_stationary
from .attack import check_attack
from .detector import check_detector
from .spoofer import check_spoofer

__all__ = ["check_ages", "check_attack", "check_detector", "check_spoofer", "check_stationary"]
