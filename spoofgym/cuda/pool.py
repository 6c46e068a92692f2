"""Receivers that are begun on the processor, and run by kernels: pasts, and clean runs."""

from __future__ import annotations

import copy
import threading
from collections.abc import Sequence
from functools import cache
from typing import Any, cast

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from ..calibration.clean_runs import CleanRuns, check_stopped
from ..detectors import Detector
from ..envs.core import SpoofCore
from ..simulation.engine import seed_pasts
from ..simulation.setup import Setup
from ..simulation.simulator import FilterDiverged, run_serially
from ..simulation.tight import TightlyCoupledSimulator
from . import _kernels
from ._compile import SIMULATED, compile_kernel
from .memory import Arrays, Layout, Tensors
from .supported import check_receivers, import_torch

THREADS = 64  # of a block
PIECE = 8  # epochs of a launch, so that a desktop's watchdog lets it end
TOGETHER = 16_384
"""Clean runs that are played side by side."""
Maxima = tuple[NDArray[np.float64], NDArray[np.bool_]]
"""Largest ratio (M,) of statistic to threshold in some epochs, and whether there was an alarm."""
_one_at_a_time = threading.Lock()


@cache
def get_kernel(name: str) -> Any:
    return compile_kernel(getattr(_kernels, name))


def launch(name: str, receivers: int, device: Any, *arguments: Any) -> None:
    """Run a kernel with a thread for each receiver, in the stream of PyTorch; the simulator has
    none, and is spared idle threads."""
    threads, stream = 1, 0
    if not SIMULATED:
        threads, current = THREADS, import_torch().cuda.current_stream(device)
        stream = cuda.external_stream(current.cuda_stream)
    get_kernel(name)[-(-receivers // threads), threads, stream](*arguments)


def raise_faults(faults: Any) -> None:
    """Raise what kernels have found, `faults` (B,): `FilterDiverged`, or a verdict that is not
    finite."""
    if bool(faults.any()):
        b = int((faults != 0).nonzero()[0])
        if int(faults[b]) & _kernels.DIVERGED:
            raise FilterDiverged(f"the filter of receiver {b} of {len(faults)} has diverged")
        raise ValueError(f"the detector's verdict on receiver {b} is not finite")


class Flight:
    """M receivers without an attack, as a simulator has begun them. `tensors`: all that there is of
    them by name, of which `gathered` lasts; `shared`: what all read."""

    def __init__(self, torch: Any, simulator: TightlyCoupledSimulator, device: Any) -> None:
        self.layout, self._device, m = Layout(simulator), device, simulator.receivers
        self.shared = self.layout.share(torch, device)
        self.gathered = self.layout.gather()
        found = {"alarmed": np.zeros(m, bool), "ratio": np.zeros(m), "left": np.zeros(m, int)}
        arrays = self.gathered | self.layout.scratch(m) | found
        self.tensors = Tensors(torch, arrays, device)
        receivers = self.layout.name_receivers(self.tensors)
        views = (self.tensors.views[name] for name in found)
        self._known = receivers, self.shared.name_views(_kernels.Shared), *views
        self._phases = simulator.setup.filter_only, simulator.ages - simulator.setup.filter_only

    def warm_up(self, stopped: threading.Event | None = None) -> Maxima:
        """Run all to their onsets, the last epochs with the detector, which `Maxima` are of."""
        self.run(self._phases[0], 0, stopped)
        return self.run(self._phases[1], _kernels.JUDGED, stopped)

    def run(self, epochs: Any, what: int, stopped: threading.Event | None = None) -> Maxima:
        """Run `epochs` of each receiver."""
        tensors, m = self.tensors, len(self.tensors["left"])
        left = np.broadcast_to(np.asarray(epochs, dtype=np.int64), m).copy()
        tensors["left"].copy_(import_torch().from_numpy(left))
        tensors["alarmed"].zero_()
        tensors["ratio"].zero_()
        for _ in range(-(-int(left.max()) // PIECE)):
            check_stopped(stopped)
            launch("age", m, self._device, *self._known, PIECE, self.layout.detector, what)
        raise_faults(tensors["faults"])
        return tensors["ratio"].cpu().numpy().copy(), tensors["alarmed"].cpu().numpy().copy()


def start_pasts(torch: Any, core: SpoofCore, device: Any) -> tuple[Flight, Tensors]:
    """As many receivers at their onset as a core has, and what belongs to their episodes."""
    simulator = cast(TightlyCoupledSimulator, core.engine.simulator)
    simulator.start_episodes(seed_pasts(np.arange(core.receivers)))
    flight = Flight(torch, simulator, device)
    flight.warm_up()
    tensors = flight.tensors
    simulator.buffers.position_e[:] = tensors["out"][:, 2:5].cpu().numpy()
    simulator.sensors.epoch[:] = tensors["epochs"].cpu().numpy()
    core.commands.aim(core.heading_rad)
    plain = np.zeros((core.receivers, len(core.setup.action_names), 0))
    episodes: Arrays = {
        "matrix": plain if core.commands.is_plain else core.commands._matrix,
        "onset": simulator.onset,
        "direction": simulator.memory["direction"],
        "origin": simulator.origin_ne(),
        "warmup_alarm": tensors["alarmed"].cpu().numpy(),
    }
    return flight, Tensors(torch, episodes, device)


def play_batch(
    setup: Setup,
    detectors: Sequence[Detector],
    in_loop: bool,
    rngs: Sequence[np.random.Generator],
    stopped: threading.Event | None,
    *,
    device: str = "cuda",
) -> CleanRuns:
    """Play clean runs on a device, of one detector after the other, as `Player` does."""
    torch, found = import_torch(), []
    for detector in detectors:
        judged = setup.copy_with(detector=detector, monitors=())
        check_receivers(judged)
        simulator = cast(TightlyCoupledSimulator, judged.simulator(len(rngs), run_serially))
        simulator.start_episodes(copy.deepcopy(rngs))
        with _one_at_a_time, torch.no_grad():
            flight = Flight(torch, simulator, torch.device("cpu" if SIMULATED else device))
            before = flight.warm_up(stopped)
            window = flight.run(setup.steps + setup.hold, _kernels.JUDGED, stopped)
        found.append((before[0], window[0], before[1], window[1]))
    columns = [np.stack(each, axis=1) for each in zip(*found, strict=True)]
    age_s = np.asarray(simulator.ages * setup.interval_s, dtype=np.float64)
    return CleanRuns._make((*columns, simulator.onset // setup.epochs_each, age_s))
