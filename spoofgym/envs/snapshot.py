"""What observations and rewards are made of: the game at one instant."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .engine import Batch
from .setup import Setup

FloatArray = NDArray[np.float64]


class Snapshot(NamedTuple):
    """The game after a step; all truth is here, and terms choose what an agent may see.

    Attributes
    ----------
    setup : Setup
        World, victim, attack, detector, timeline.
    batch : Batch
        State of the receivers.
    step : ndarray
        (B,) int64 epochs since the attack began.
    twin : Batch or None
        Clean twins of the receivers, where there are any.
    """

    setup: Setup
    batch: Batch
    step: NDArray[np.int64]
    twin: Batch | None = None


def position_error_n(setup: Setup, batch: Batch) -> FloatArray:
    """Error of the estimated position, in the local axes at the onset of the attack.

    Returns (B, 3) estimate minus truth, north, east, down [m].
    """
    error_e = batch.buffers.state.position_e - setup.world.position_e[batch.epochs]
    # a sum of products, since the bits of a matrix product depend on the size of the batch
    result: FloatArray = (error_e[:, :, None] * setup.world.C_en[batch.onset]).sum(axis=1)
    return result
