"""What terms look at: the episodes at one instant."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...simulation.setup import Setup
from ...simulation.simulator import Simulator


class Snapshot(NamedTuple):
    """The episodes after a step; all truth is here, and terms choose what an agent may see.

    Attributes
    ----------
    setup : Setup
        World, victim, attack, detector, timeline.
    simulator : Simulator
        State of the receivers.
    step : ndarray
        (B,) int64 epochs since the attack started.
    twin : Simulator or None
        Clean twins of the receivers, where there are any.
    """

    setup: Setup
    simulator: Simulator
    step: NDArray[np.int64]
    twin: Simulator | None = None


def holds_for_call(term: object, name: str) -> bool:
    """Whether an attribute, which kernels use in place of `__call__`, is of the same class as it.

    A subclass with another `__call__` inherits the attribute, which is not true of it any more.
    """
    first = next((cls for cls in type(term).__mro__ if {name, "__call__"} & vars(cls).keys()), None)
    return first is not None and {name, "__call__"} <= vars(first).keys()
