"""What the watching detectors of a game tell in ``info``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from .witness import Witness


def needed(terms: Iterable[Any]) -> list[Witness]:
    """Witnesses that terms rely on.

    Returns one of each class, in the order in which they are named.
    """
    kinds = dict.fromkeys(kind for term in terms for kind in getattr(term, "needs", ()))
    return [kind() for kind in kinds]


class WatchBooks:
    """Alarms and statistics of the detectors that watch.

    `names`: of the detectors, as `Watch` has them; `begin_names`, `step_names`: keys in the
    information at the start of an episode, and of a step.
    """

    def __init__(self, names: tuple[str, ...], receivers: int) -> None:
        self.begin_names = tuple(f"watch_{name}_warmup_alarm" for name in names)
        self._alarm_names = tuple(f"watch_{name}_alarm" for name in names)
        self._ratio_names = tuple(f"watch_{name}_ratio" for name in names)
        self.step_names = (*self.begin_names, *self._alarm_names, *self._ratio_names)
        self._warmup_alarm = np.zeros((receivers, len(names)), dtype=np.bool_)

    def reset(self, rows: NDArray[np.intp], watched: Memory) -> None:
        """Take down the alarms of the warm-up."""
        self._warmup_alarm[rows] = watched["alarmed"][rows]

    @staticmethod
    def forget(watched: Memory) -> None:
        """Begin to count the alarms of a step."""
        watched["alarmed"][:] = False

    def begin_info(self) -> dict[str, NDArray[Any]]:
        """Information at the start of an episode: (B,) bool of each detector."""
        return {name: self._warmup_alarm[:, k].copy() for k, name in enumerate(self.begin_names)}

    def step_info(self, watched: Memory) -> dict[str, NDArray[Any]]:
        """Information of a step, the time to alert included: (B,) arrays of each detector."""
        alarms = {name: watched["alarmed"][:, k].copy() for k, name in enumerate(self._alarm_names)}
        ratios = {name: watched["ratio"][:, k].copy() for k, name in enumerate(self._ratio_names)}
        return {**self.begin_info(), **alarms, **ratios}
