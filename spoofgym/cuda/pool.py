"""Receivers that are begun on the processor, and run by kernels: the pasts of a pool."""

from __future__ import annotations

import threading
from typing import Any, cast

import numpy as np
from numba import cuda

from ..attacks._offset_kernels import measure_scratch
from ..calibration.clean_runs import check_stopped
from ..core.devices import SIMULATED, check_free_memory, import_torch
from ..detectors.charts import Ewma
from ..envs.core import SpoofCore
from ..receiver.epoch import ReceiverBuffers
from ..simulation.engine import seed_pasts
from ..simulation.simulator import FilterDiverged
from ..simulation.tight import ATTACK_FORMS, TightlyCoupledSimulator, split_scale
from . import _kernels
from ._compile import compile_kernel
from .memory import DETECTORS, OF_OFFSETS, Arrays, Tensors, view_for_kernels

THREADS = 64  # of a block
PIECE = 8  # epochs of a launch, so that a desktop's watchdog lets it end
Stop = threading.Event | None


def launch(name: str, receivers: int, device: Any, *arguments: Any) -> None:
    """Run a kernel with a thread for each receiver, in the stream of PyTorch."""
    threads, stream = 1, 0
    if not SIMULATED:
        threads, current = THREADS, import_torch().cuda.current_stream(device)
        stream = cuda.external_stream(current.cuda_stream)
    compile_kernel(getattr(_kernels, name))[-(-receivers // threads), threads, stream](*arguments)


def raise_faults(faults: Any) -> None:
    """Raise what kernels have found, (B,): a filter that has diverged, or an unsound verdict."""
    if bool(faults.any()):
        b = int((faults != 0).nonzero()[0])
        if int(faults[b]) & _kernels.DIVERGED:
            raise FilterDiverged(f"the filter of receiver {b} of {len(faults)} has diverged")
        raise ValueError(f"the detector's verdict on receiver {b} is not finite")


class Fleet:
    """M receivers without an attack, as a simulator has begun them. `attack`, `detector`: which
    they have, by number; `tensors`: all that there is of receivers, by name; `shared`: what all
    read, as kernels take it."""

    def __init__(self, torch: Any, simulator: TightlyCoupledSimulator, device: Any) -> None:
        self._device, self._phases = device, (simulator.setup.filter_only, simulator.ages)
        m, n, attack = simulator.receivers, simulator.setup.world.channels, simulator.attack
        self.attack = ATTACK_FORMS.get(type(attack), _kernels.OFFSETS)
        inner, scale = split_scale(simulator.detector)
        self.detector, remembered, settings = DETECTORS[type(inner)]
        whole = inner.scope == "receiver" or self.detector == _kernels.NEVER
        if isinstance(inner, Ewma) and inner.weight_scale is None:
            self.detector = _kernels.PASSIVE_EWMA
        wanted = ("innovation_cov",) if self.detector >= _kernels.SNAPSHOT else ()
        one = ReceiverBuffers(1, n, wanted)
        self._places, first = one.places.astype(np.int64), (*settings(inner), 0.0, 0.0, 0.0)[:3]
        shared = {
            **simulator.shared_arrays(),
            "C_en": simulator.setup.C_en,
            "axes_e": getattr(attack, "axes_e", np.zeros((1, 1, 6))),
            "places": self._places,
            "settings": np.array([*first, scale, *getattr(inner, "_rows", (0, n))], dtype=float),
            "limits": np.asarray(getattr(inner, "_thresholds", np.zeros(1)), dtype=float),
        }
        self.shared = Tensors(torch, shared, device, shared=True).name_views(_kernels.Shared)
        nothing, columns, sizes = np.zeros((m, 0)), 1 if whole else n, (1, 1)
        known = [np.asarray(inner.memory[name], dtype=float) for name in remembered]
        if self.attack == _kernels.OFFSETS:
            sizes = measure_scratch(n, *(attack.memory[x].shape[1] for x in ("rate", "bases")))
        arrays: Arrays = {
            **simulator.lasting_arrays(),
            **{name: attack.memory.get(name, nothing.astype(t)) for name, t in OF_OFFSETS.items()},
            **dict(zip(("first", "second"), (*known, nothing, nothing), strict=False)),
            "judged": inner.memory.get("seen", np.zeros(m, dtype=np.int64)),
            "out": np.zeros((m, len(one.seen_floats))),
            **dict.fromkeys(("range_offset", "rate_offset"), np.zeros((m, n))),
            "visible": np.zeros((m, n), dtype=np.bool_),
            **dict.fromkeys(("coasting", "alarmed"), np.zeros(m, dtype=np.bool_)),
            "statistic": np.zeros((m, columns)),
            "threshold": np.full((m, columns), scale),
            "alarm": np.zeros((m, columns), dtype=np.bool_),
            "weights": np.ones((m, 2 * n)),
            "ratio": np.zeros(m),
            "work": np.zeros((m, simulator.work_rows)),
            "spans": np.zeros((m, 4, 1), dtype=np.int64),
            "offset_work": np.zeros((m, *sizes)),
            "command": np.zeros((m, len(simulator.setup.action_names))),
            **dict.fromkeys(("faults", "left"), np.zeros(m, dtype=np.int64)),
        }
        check_free_memory(torch.cuda, device, m, sum(x.nbytes / len(x) for x in arrays.values()))
        self.tensors = Tensors(torch, arrays, device)
        length = simulator.setup.epochs_each
        self._left = length - 1 - simulator.epochs % length
        found = (self.tensors.views[name] for name in ("alarmed", "ratio", "left", "command"))
        self._known = self.name_receivers(self.tensors), self.shared, *found

    def name_receivers(self, tensors: Tensors) -> Any:
        """`Receivers` of kernels, with a view of the innovations' covariance where it is shown."""
        out, m = tensors["out"], 2 * tensors["visible"].shape[1]
        receivers, place = len(out), int(self._places[2])
        shape = receivers, *((m, m) if place >= 0 else (0, 0))
        part = out.as_strided(shape, (1, m * receivers, receivers), max(place, 0) * receivers)
        tensors.views["covariance"] = view_for_kernels(part)
        return tensors.name_views(_kernels.Receivers)

    def warm_up(self, stopped: Stop = None) -> tuple[Any, Any]:
        """Run all to their onsets, with the detector where it is on; what `run` says of that."""
        settling, whole = self._phases
        self.run(settling, stopped, 0)
        return self.run(whole - settling, stopped)

    def run(
        self, epochs: Any, stopped: Stop = None, what: int = _kernels.JUDGED, command: Any = None
    ) -> tuple[Any, Any]:
        """Run `epochs` of each receiver: (M,) the largest ratio of statistic to threshold, and
        whether there was an alarm. `command` (M, a) of the attack, None holds its rate."""
        tensors, m, torch = self.tensors, len(self.tensors["left"]), import_torch()
        left = np.broadcast_to(np.asarray(epochs, dtype=np.int64), m).copy()
        if (left > self._left).any():
            raise ValueError(f"an epoch beyond the world: it has {self._left.min()} more")
        self._left -= left
        tensors["left"].copy_(torch.from_numpy(left))
        if command is not None:
            tensors["command"].copy_(torch.from_numpy(np.array(command, dtype=float)))
        tensors["alarmed"].zero_()
        tensors["ratio"].zero_()
        for _ in range(-(-int(left.max()) // PIECE)):
            check_stopped(stopped)
            kinds = command is None, self.attack, self.detector, what
            launch("age", m, self._device, *self._known, PIECE, *kinds)
        raise_faults(tensors["faults"])
        return tensors["ratio"].cpu().numpy().copy(), tensors["alarmed"].cpu().numpy().copy()


def start_pasts(torch: Any, core: SpoofCore, device: Any) -> Fleet:
    """As many receivers at their onset as a core has, with what belongs to their episodes."""
    simulator = cast(TightlyCoupledSimulator, core.engine.simulator)
    simulator.start_episodes(seed_pasts(np.arange(core.receivers)))
    fleet = Fleet(torch, simulator, device)
    fleet.warm_up()
    tensors = fleet.tensors
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
    fleet.tensors |= Tensors(torch, episodes, device)
    return fleet
