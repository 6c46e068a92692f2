"""Spoofers: who decides what the attack does, one idea a file, behind the contract of `base`."""

from __future__ import annotations

from typing import Any

from .._registry import build
from .accelerating_ramp import AcceleratingRamp
from .base import KNOWLEDGE, ScriptedSpoofer, Spoofer, SpooferContext
from .none import NoSpoofer
from .ramp import Ramp
from .step import Step

__all__ = [
    "KNOWLEDGE",
    "SPOOFERS",
    "AcceleratingRamp",
    "NoSpoofer",
    "Ramp",
    "ScriptedSpoofer",
    "Spoofer",
    "SpooferContext",
    "Step",
    "make_spoofer",
]

SPOOFERS: dict[str, type[Spoofer]] = {
    "accelerating-ramp": AcceleratingRamp,
    "none": NoSpoofer,
    "ramp": Ramp,
    "step": Step,
}
"""Spoofers by name."""


def make_spoofer(spec: str | dict[str, Any] | Spoofer) -> Spoofer:
    """Spoofer by name, by name and settings, or a copy of an object.

    Parameters
    ----------
    spec : str, dict or Spoofer
        A name in `SPOOFERS`; ``{"name": ..., "setting": value, ...}``; or a spoofer, which is
        copied.

    Returns
    -------
    Spoofer
        Not bound yet.

    Raises
    ------
    ValueError
        When the name or a setting is unknown; the valid ones are listed.
    TypeError
        When `spec` is something else.

    Examples
    --------
    >>> from spoofgym.spoofers import make_spoofer
    >>> make_spoofer({"name": "ramp", "rate_mps": 0.2})
    Ramp(heading_deg=90.0, rate_mps=0.2)
    """
    return build("spoofer", SPOOFERS, Spoofer, spec)
