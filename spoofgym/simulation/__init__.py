"""B receivers of a victim in step: the world, the filter and the detector, without Gymnasium.

A `Setup` is computed once; its `simulator` runs B receivers; an `Engine` adds threads, prefetched
warm-ups and clean twins.
"""

from .domain import Domain as Domain
from .engine import Engine as Engine
from .loose import LooselyCoupledSetup as LooselyCoupledSetup
from .robot import WheeledRobotSetup as WheeledRobotSetup
from .setup import Setup as Setup
from .setup import Timeline as Timeline
from .simulator import Simulator as Simulator
from .snapshot import SnapshotSetup as SnapshotSetup
from .tight import TightlyCoupledSetup as TightlyCoupledSetup
