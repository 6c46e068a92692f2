"""Thresholds from clean runs, for a rate of false alarms, and their check on fresh runs."""

from .holdouts import HoldOut as HoldOut
from .holdouts import check as check
from .holdouts import hold_out as hold_out
from .holdouts import transfer as transfer
from .thresholds import calibrate_detectors as calibrate_detectors
