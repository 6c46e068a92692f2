"""Warmed-up pasts on a device: begun on the processor, run to their onsets by kernels."""

from __future__ import annotations

from functools import cache
from typing import Any, cast

import numpy as np

from ..envs.core import SpoofCore
from ..simulation.engine import seed_pasts
from ..simulation.tight import TightlyCoupledSimulator
from . import _kernels
from ._compile import compile_kernel
from ._lanes import SIMULATED
from .memory import Arrays, Layout, Tensors

THREADS = 64  # of a block
PIECE = 8  # epochs of a launch, so that a desktop's watchdog lets it end


@cache
def get_kernel(name: str) -> Any:
    return compile_kernel(getattr(_kernels, name))


def launch(name: str, receivers: int, stream: Any, *arguments: Any) -> None:
    """Run a kernel with a thread for each receiver; the simulator is spared idle threads."""
    threads = 1 if SIMULATED else THREADS
    get_kernel(name)[-(-receivers // threads), threads, stream](*arguments)


class Pool:
    """M receivers that are at their onset. `lasting`: what is copied to a receiver that starts from
    one of them, by name, with what belongs to its episode; `shared`: what all read."""

    def __init__(self, torch: Any, core: SpoofCore, device: Any, stream: Any) -> None:
        simulator = cast(TightlyCoupledSimulator, core.engine.simulator)
        pasts, setup = core.receivers, core.setup
        simulator.start_episodes(seed_pasts(np.arange(pasts)))
        self.layout = Layout(simulator)
        self.shared = self.layout.share(torch, device)
        arrays = self.layout.gather(simulator)
        both = Tensors(torch, arrays | self.layout.scratch(pasts), device)
        receivers = self.layout.name_receivers(both)
        shared = self.shared.name_views(_kernels.Shared)
        phases = np.full(pasts, setup.filter_only), simulator.ages - setup.filter_only
        left = Tensors(torch, {"settling": phases[0], "live": phases[1]}, device)
        alarms = Tensors(torch, {"warmup_alarm": simulator.memory["warmup_alarm"]}, device)
        rest = PIECE, self.layout.detector
        for phase, what in (("settling", 0), ("live", _kernels.JUDGED)):
            for _ in range(-(-int(left[phase].max()) // PIECE)):
                views = alarms.views["warmup_alarm"], left.views[phase]
                launch("age", pasts, stream, receivers, shared, *views, *rest, what)
        self.faults = both["faults"]
        simulator.buffers.position_e[:] = both["out"][:, 2:5].cpu().numpy()
        simulator.sensors.epoch[:] = both["epochs"].cpu().numpy()
        core.commands.aim(core.heading_rad)
        self.lasting = {name: both[name] for name in arrays}
        self.words = both.words
        self.lasting |= {"warmup_alarm": alarms["warmup_alarm"]}
        self.lasting |= Tensors(torch, self._episodes(core, simulator), device).tensors

    def _episodes(self, core: SpoofCore, simulator: TightlyCoupledSimulator) -> Arrays:
        plain = np.zeros((core.receivers, len(core.setup.action_names), 0))
        return {
            "matrix": plain if core.commands.is_plain else core.commands._matrix,
            "onset": simulator.onset,
            "direction": simulator.memory["direction"],
            "origin": simulator.origin_ne(),
        }

    @property
    def bytes_each(self) -> int:
        """Memory of a receiver, its scratch memory included."""
        lasting = sum(int(t.element_size() * t[:1].numel()) for t in self.lasting.values())
        return lasting + sum(array.nbytes for array in self.layout.scratch(1).values())
