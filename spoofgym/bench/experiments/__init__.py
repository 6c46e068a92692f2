"""Experiments: cells that are computed in any order, on any machine, and kept one file each.

store      a folder of results, complete or absent, of one experiment
runner     what is missing, computed here, in processes, or on a cluster
identity   what results depend on besides settings: code, versions, files
"""

from .runner import Context, Experiment, Interrupted, parse_shard, run
from .store import Cell, Reader, Result, Store

__all__ = [
    "Cell",
    "Context",
    "Experiment",
    "Interrupted",
    "Reader",
    "Result",
    "Store",
    "parse_shard",
    "run",
]
