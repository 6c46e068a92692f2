"""The innovation-rate test of `ke2022`, and its two variants that are given the truth."""

from __future__ import annotations

from .detector import InnovationRate
from .oracle import OracleRamp, OracleStep

__all__ = ["InnovationRate", "OracleRamp", "OracleStep"]
