"""The victim's own broadcast of its position: reports that arrive late, in steps.

What is broadcast is the solution that the victim believes, as an aircraft's surveillance reports
have it.  A report is sent at fixed intervals, arrives after a latency that is drawn for each, and
gives the position in steps.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from ._kernels import latest_reports
from .monitors import Monitor, Monitored

FloatArray = NDArray[np.float64]
KEPT = 64
"""Epochs of which positions are kept."""


class PastPositions(Monitor):
    """Positions that the victims have believed at the last `KEPT` epochs that were judged.
    `memory`: ``position`` (B, KEPT, d) in the axes of `Setup.true_position` [m], and ``of`` (B,
    KEPT) the epoch of each, -1 for none; that of epoch k is at the place k modulo `KEPT`."""

    needs: ClassVar[frozenset[str]] = frozenset()

    def bind(self, simulator: Monitored) -> None:
        receivers, setup = simulator.receivers, simulator.setup  # type: ignore[attr-defined]
        axes = setup.true_position.shape[1]
        self.memory = Memory(receivers)
        self.memory.declare("position", np.zeros((receivers, KEPT, axes)))
        self.memory.declare("of", np.full((receivers, KEPT), -1, dtype=np.int64))

    def update(self, simulator: Any) -> None:
        """Nothing: what the victim believes of the epoch is known after the update."""

    def corrected(self, simulator: Any) -> None:
        rows, epochs = np.arange(simulator.receivers), simulator.epochs
        self.memory["position"][rows, epochs % KEPT] = simulator.position
        self.memory["of"][rows, epochs % KEPT] = epochs


def reports(
    simulator: Any, every: int, latency_epochs: float
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Positions of the newest reports that have arrived, (B, d), and their epochs, (B,). A report
    is of every so many epochs from the onset on, before it, too; its latency is uniform between 0
    and `latency_epochs`. Where none has arrived yet the epoch is -1 and the position 0."""
    past = simulator.monitor(PastPositions).memory
    epochs, onset, keys = simulator.epochs, simulator.onset, simulator.memory["key"]
    newest = np.empty(len(epochs), dtype=np.int64)
    latest_reports(epochs, onset, keys, every, latency_epochs, newest)
    rows, places = np.arange(len(epochs)), newest % KEPT
    kept = past["of"][rows, places] == newest
    position = np.where(kept[:, None], past["position"][rows, places], 0.0)
    return position, np.where(kept, newest, -1)
