"""Experiments: cells that are computed in any order, on any machine, and stored one file each.

store      a folder of results, complete or absent, of one experiment
runner     what is missing, computed here, in processes, or on a cluster
identity   what results depend on besides settings: code, versions, files
"""

from .runner import Context as Context
from .runner import Experiment as Experiment
from .runner import Interrupted as Interrupted
from .runner import parse_shard as parse_shard
from .runner import run_experiment as run_experiment
from .store import Cell as Cell
from .store import MemoryStore as MemoryStore
from .store import Reader as Reader
from .store import Result as Result
from .store import Store as Store
