"""Runs of spoofers on a GPU: receivers stay there, and what is read of them comes back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.devices import SIMULATED, check_device, import_torch
from ...detectors import Verdict
from ...detectors.calibrated import resolve_thresholds
from ...simulation.engine import Engine
from ...simulation.setup import Setup
from ...simulation.simulator import FixedChoices, Rngs, Rows, Sequel
from ...simulation.tight import TightlyCoupledSimulator

TOGETHER = 16_384
"""Runs that attacks of one pass have together."""


def find_lacking(setup: Setup, device: str) -> str | None:
    """What a device lacks that a world and its detector have, as an error says it; None where
    nothing."""
    from ...cuda.supported import check_receivers

    check_device(device)
    resolve_thresholds(setup.detector, setup)
    if setup.monitors:
        return f"device='cuda' does not have the monitor {type(setup.monitors[0]).__name__}"
    try:
        check_receivers(setup)
    except ValueError as error:
        return str(error)
    return None


class DeviceEngine(Engine):
    """Receivers that go through their epochs on a GPU, with the bits of the processor. `simulator`
    has what spoofers and scores read of the last epoch: position, commands, weights and verdict."""

    simulator: TightlyCoupledSimulator

    def __init__(self, receivers: int, setup: Setup, *, device: str) -> None:
        if lacking := find_lacking(setup, device):
            raise ValueError(lacking)
        super().__init__(receivers, setup, threads=1)
        self._device = import_torch().device("cpu" if SIMULATED else device)
        self._fleet: Any = None

    def _begin(self) -> None:
        """Bring the receivers to the device, as the simulator has them."""
        from ...cuda.pool import Fleet

        self._fleet = Fleet(import_torch(), self.simulator, self._device)

    def reset(
        self, rngs: Rngs, rows: Rows | None = None, given: FixedChoices | None = None
    ) -> None:
        """Start new episodes of all receivers on the processor, and warm them up on the device."""
        assert rows is None  # a `WarmStart` starts all
        self.simulator.start_episodes(rngs, given)
        self._begin()
        _, self.simulator.memory["warmup_alarm"][:] = self._fleet.warm_up()
        self._show()

    def take_over(self, other: Engine, rows: Rows) -> None:
        from ...cuda.memory import ALIKE

        assert isinstance(other, DeviceEngine)  # both are of one `WarmStart`
        super().take_over(other, rows)
        self._begin()
        theirs, chosen = other._fleet.tensors, import_torch().from_numpy(rows)
        own: set[str] = set()
        if self.setup.attack != other.setup.attack:  # which begins in these rows
            attacks = self.simulator.attack.memory, other.simulator.attack.memory
            own = {*attacks[0], *attacks[1], "offset_work", "command"}
        for name, tensor in self._fleet.tensors.tensors.items():
            alike = name in ALIKE and len(theirs[name]) == 1
            if name not in own:
                tensor.copy_(theirs[name] if alike else theirs[name][chosen])

    def step(self, command: NDArray[np.float64] | None, sequel: Sequel | None = None) -> Verdict:
        from ...cuda._kernels import ALL, JUDGED

        clean = self.simulator.clean
        attacked = clean is None or not clean.all()
        self._fleet.run(1, what=ALL if attacked else JUDGED, command=command)
        self._show()
        assert self.simulator.verdict is not None  # as it has just been shown
        return self.simulator.verdict

    def _show(self) -> None:
        """Bring back what is read of the last epoch."""
        simulator, tensors = self.simulator, self._fleet.tensors

        def read(tensor: Any) -> NDArray[Any]:
            return np.array(tensor.cpu().numpy(), order="C")

        simulator.sensors.epoch[:] = read(tensors["epochs"])
        simulator.buffers.position_e[:] = read(tensors["out"][:, 2:5])
        simulator.buffers.coasting[:] = read(tensors["coasting"])
        memory = simulator.attack.memory
        for name in memory.keys() & tensors.tensors.keys():
            memory[name] = read(tensors[name])
        simulator.weights = read(tensors["weights"])
        found = {name: read(tensors[name]) for name in ("statistic", "threshold", "alarm")}
        simulator.verdict = Verdict(**found, weights=simulator.weights)
