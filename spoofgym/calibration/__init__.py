"""Thresholds from clean runs, for a rate of false alarms, and their check on fresh runs."""

from .holdouts import HoldOut, check, hold_out, transfer
from .thresholds import calibrate

__all__ = ["HoldOut", "calibrate", "check", "hold_out", "transfer"]
