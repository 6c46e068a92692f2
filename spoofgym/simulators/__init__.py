"""B receivers of a victim in step: the world, the filter and the detector, without Gymnasium.

A `Setup` is computed once; its `simulator` runs B receivers; an `Engine` adds threads, prefetched
warm-ups and clean twins.
"""

from .base import Simulator as Simulator
from .calibration import calibrate as calibrate
from .domain import Domain as Domain
from .engine import Engine as Engine
from .holdouts import HoldOut as HoldOut
from .holdouts import check as check
from .holdouts import hold_out as hold_out
from .holdouts import transfer as transfer
from .loosely_coupled import LooselyCoupledSetup as LooselyCoupledSetup
from .setup import Setup as Setup
from .snapshot_positioning import SnapshotSetup as SnapshotSetup
from .tightly_coupled import TightlyCoupledSetup as TightlyCoupledSetup
from .timeline import Timeline as Timeline
from .wheeled_robot import WheeledRobotSetup as WheeledRobotSetup
