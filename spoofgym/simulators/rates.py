"""What simulators share whose spoofer commands a displacement by rates, one per axis."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from .base import Rngs, Simulator, domain_keys, episode_seeds

FloatArray = NDArray[np.float64]


class RateSimulator(Simulator):
    """B receivers under `RateCommands`; all that they remember lies in `memory`. ``epoch`` (B,),
    ``displacement`` and ``rate`` (B, a), in the order of `Setup.action_names`."""

    def _allocate(self) -> None:
        none = np.zeros((self.receivers, len(self.setup.action_names)))
        self.memory.declare("epoch", np.zeros(self.receivers, dtype=np.int64))
        self.memory.declare("displacement", none)
        self.memory.declare("rate", none)

    def _draw(self, rngs: Rngs) -> NDArray[np.uint64]:
        self.memory.reset()
        episodes = episode_seeds(rngs)
        for row, episode in enumerate(episodes):
            self._seed(row, episode)
        return domain_keys(episodes)

    @abstractmethod
    def _seed(self, row: int, episode: np.random.SeedSequence) -> None:
        """Draw the keys of a receiver's noise, and what else is drawn once per episode."""

    @property
    def epochs(self) -> NDArray[np.int64]:
        """(B,) index of each receiver's epoch."""
        return self.memory["epoch"]

    def _move(self, command: FloatArray | None) -> None:
        """Move the counterfeit over one epoch, by a new rate or by the present one."""
        memory, length = self.memory, self.setup.length
        late = np.flatnonzero(memory["epoch"] - memory["first"] >= length)
        if len(late):
            raise RuntimeError(
                f"an episode has at most {length} epochs, and receivers {late.tolist()} are at its "
                "end; start a new one"
            )
        command = self.command_with(command)
        if command is not None:
            memory["rate"] = command * self.setup.attack.limits
        memory["displacement"] = memory["displacement"] + memory["rate"] * self.setup.interval_s
