"""Wrappers of the single environment; `vector` has their twins of the same names.

All but `RecordEpochs` only set something in the engine before the game begins: nothing outside
could sit between the halves of an epoch.  So each is the same as an argument of the environment.
"""

from .single import DetectorWrapper, RecordEpochs, StealthBudget, WatchWrapper

__all__ = ["DetectorWrapper", "RecordEpochs", "StealthBudget", "WatchWrapper"]
