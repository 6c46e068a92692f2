"""What simulators share whose spoofer commands a displacement by rates, one per axis."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .base import Simulator, detector_name, domain_keys, episode_seeds
from .frame import EpisodeLayout, FrameData, SkyData

FloatArray = NDArray[np.float64]


class RateSimulator(Simulator):
    """B receivers under `RateCommands`; all that they remember lies in `memory`.

    ``epoch`` (B,), ``displacement`` and ``rate`` (B, a), in the order of `Setup.action_names`.
    """

    def _allocate(self) -> None:
        none = np.zeros((self.receivers, len(self.setup.action_names)))
        self.memory.declare("epoch", np.zeros(self.receivers, dtype=np.int64))
        self.memory.declare("displacement", none)
        self.memory.declare("rate", none)

    def _draw(self, rngs: Sequence[np.random.Generator]) -> NDArray[np.uint64]:
        self.memory.reset()
        episodes = episode_seeds(rngs)
        for row, episode in enumerate(episodes):
            self._seed(row, episode)
        return domain_keys(episodes)

    @abstractmethod
    def _seed(self, row: int, episode: np.random.SeedSequence) -> None:
        """Draw the keys of a receiver's noise, and what else is drawn once per episode."""

    @abstractmethod
    def _ground_ne(self, epochs: slice) -> FloatArray:
        """(K, 2) true position at epochs, north and east of the first receiver's onset [m]."""

    @property
    def epochs(self) -> NDArray[np.int64]:
        """(B,) index of each receiver's epoch."""
        epochs: NDArray[np.int64] = self.memory["epoch"]
        return epochs

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

    def _sky(self) -> SkyData | None:
        """Satellites over the first receiver."""
        return None

    def layout(self) -> EpisodeLayout:
        """What stays the same in a picture of the first receiver's episode."""
        setup, onset = self.setup, int(self.onset[0])
        return EpisodeLayout(
            title=f"{setup.kind} receiver against {detector_name(setup.detector)}",
            track_ne=self._ground_ne(slice(onset, onset + setup.steps + setup.hold + 1)),
            interval_s=setup.interval_s,
            steps=setup.steps,
            attack_s=setup.steps * setup.interval_s,
            hold_s=setup.hold * setup.interval_s,
            onset_s=float(setup.epoch_time[onset]),
            commands_position=True,
            has_sky=self._sky() is not None,
        )

    def frame(self) -> FrameData:
        """The first receiver now, for a picture."""
        epoch = int(self.epochs[0])
        return FrameData(
            position_ne=self._ground_ne(slice(epoch, epoch + 1))[0],
            error_ne=self.error_n()[0, :2],
            displacement_ne=self.memory["displacement"][0, :2].copy(),
            ratio=float(self.ratio()[0]),
            sky=self._sky(),
        )
