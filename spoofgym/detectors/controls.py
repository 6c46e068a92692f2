r"""The detector without a defence, and the one that alarms by chance: the ends of any comparison.

`Never` is the baseline: what a spoofer induces where nothing watches.

`Lottery` is a negative control (`lipsitch2010`).  It looks at the innovations of its first epoch
alone, before there is an attack, and makes a uniform number of their bits: no random number, the
same in any batch.  From it follows a waiting time w, exponential with mean 1, and with t the time
since that epoch

.. math:: \text{statistic} = t / w, \qquad \text{threshold} = T

so that the alarm comes at the time :math:`T w`, and its hazard is 1/T at any time, with an attack
or without.  At one rate of false alarms it is worth as much as `Never`; a score by which it is
worth more counts alarms that have nothing to do with an attack.  It must be live for an epoch
before the attack; otherwise the attack has a say in the draw.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.declared import setting, settings_record
from ..receiver.epoch import Epoch
from .base import Detector, DetectorContext, FloatArray, Verdict, compare


@dataclass
class Never(Detector):
    """No defence: statistic 0, threshold 1, never an alarm, no weights."""

    paper: ClassVar[str] = "groves2013"
    measures: ClassVar[str] = "any"
    calibrates: ClassVar[bool] = False

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)

    def judge(self, epoch: Epoch) -> Verdict:
        return compare(np.zeros((len(epoch.time), 1)), 1.0)


@settings_record
class Lottery(Detector):
    """Alarms by chance, at the same rate at any time, and stays alarmed."""

    mean_wait_s: float = setting(
        default=18_000.0,
        above=0.0,
        unit="s",
        help="Mean waiting time from the first epoch to the alarm, T; by default 0.2 alarms an "
        "hour.",
    )

    paper: ClassVar[str] = "lipsitch2010"
    measures: ClassVar[str] = "any"
    draws: ClassVar[bool] = True

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        self.memory.declare_all(since=np.zeros(context.receivers), wait=np.zeros(context.receivers))

    def judge(self, epoch: Epoch) -> Verdict:
        since, wait = self.memory["since"], self.memory["wait"]
        new = wait == 0.0
        since = np.where(new, 0.0, since + epoch.interval)
        if new.any():
            wait = wait.copy()
            wait[new] = unit_exponential(hash_rows(epoch.innovation[new]))
        self.memory["since"], self.memory["wait"] = since, wait
        return compare((since / wait)[:, None], self.mean_wait_s)


def hash_rows(values: FloatArray) -> NDArray[np.uint64]:
    """64 bits of each row of values (B, m), mixed element by element as SplitMix64 does."""
    bits = (np.ascontiguousarray(values, dtype=np.float64) + 0.0).view(np.uint64)
    state = np.zeros(len(bits), dtype=np.uint64)
    for column in bits.T:
        state = (state ^ column) + np.uint64(0x9E3779B97F4A7C15)
        state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        state ^= state >> np.uint64(31)
    return state


def unit_exponential(bits: NDArray[np.uint64]) -> FloatArray:
    uniform = ((bits >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53
    return np.array([-math.log1p(-each) for each in uniform.tolist()])
