"""Checks of single settings: each names the setting, what it must be, and what it is."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any


def check_finite(name: str, value: Any) -> None:
    """Raise unless a setting is a finite number."""
    if not _is_number(value):
        raise ValueError(f"`{name}` must be a finite number, got {value!r}")


def check_above_zero(name: str, value: Any) -> None:
    """Raise unless a setting is a finite number above 0."""
    if not (_is_number(value) and value > 0):
        raise ValueError(f"`{name}` must be a finite number > 0, got {value!r}")


def check_truth(name: str, value: Any) -> None:
    """Raise unless a setting is True or False."""
    if value is not True and value is not False:
        raise ValueError(f"`{name}` must be True or False, got {value!r}")


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(float(value))
