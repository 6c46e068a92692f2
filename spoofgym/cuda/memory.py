"""Receivers on a device: tensors with the receivers last in memory, and views of them for kernels.

A receiver has on a device what a batch of one has on the processor.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from ..detectors.charts import Ewma, Shewhart
from ..detectors.chi_square import SnapshotChi2
from ..detectors.controls import Never
from ..detectors.cusum import Cusum
from ..receiver._kernels import work_rows
from ..receiver.epoch import ReceiverBuffers
from ..simulation.tight import ATTACK_FORMS, TightlyCoupledSimulator
from ..truth.noise import pad_count
from ..truth.signal_errors import OBLIQUITIES
from . import _kernels
from ._lanes import SIMULATED
from .supported import split_scale

Arrays = dict[str, NDArray[Any]]
NUMBERS: dict[type[Any], int] = {
    Never: _kernels.NEVER,
    Shewhart: _kernels.SHEWHART,
    Cusum: _kernels.CUSUM,
    SnapshotChi2: _kernels.SNAPSHOT,
}


def put(torch: Any, array: NDArray[Any], device: Any, shared: bool = False) -> Any:
    """Copy an array (B, ...) to a tensor whose last axis in memory is that of the receivers, or one
    that all receivers share as it is."""
    last = np.array(array if shared else np.asarray(array).T, order="C", copy=True)
    if last.dtype == np.uint64:
        last = last.view(np.int64)
    tensor = torch.from_numpy(last).to(device)
    return tensor if shared else tensor.permute(tuple(reversed(range(tensor.ndim))))


def view_for_kernels(tensor: Any, words: bool = False) -> Any:
    """The memory of a tensor, as kernels take it; `words`: unsigned integers."""
    array = tensor.numpy() if SIMULATED else cuda.as_cuda_array(tensor)
    return array.view(np.uint64) if words else array


class Tensors:
    """Arrays of receivers by name, as tensors, and in a named tuple of kernels."""

    def __init__(
        self, torch: Any, arrays: Mapping[str, NDArray[Any]], device: Any, *, shared: bool = False
    ) -> None:
        put_each = {name: put(torch, array, device, shared) for name, array in arrays.items()}
        self.tensors: dict[str, Any] = put_each
        self.words = {name for name, array in arrays.items() if array.dtype == np.uint64}
        self.views = {
            name: view_for_kernels(tensor, name in self.words)
            for name, tensor in self.tensors.items()
        }

    def __getitem__(self, name: str) -> Any:
        return self.tensors[name]

    def name_views(self, kind: Any) -> Any:
        return kind(**{name: self.views[name] for name in kind._fields})


class Layout:
    """What kernels need to know of a simulator: `attack` and `detector` by number, `places` in what
    is shown of an epoch, and sizes."""

    def __init__(self, simulator: TightlyCoupledSimulator) -> None:
        self.setup, world = simulator.setup, simulator.setup.world
        self._attack = simulator.attack
        inner, scale = split_scale(simulator.detector)
        self.attack, self.detector = ATTACK_FORMS[type(self._attack)], number_detector(inner)
        n = self.channels = world.channels
        wanted = ("innovation_cov",) if self.detector == _kernels.SNAPSHOT else ()
        one = ReceiverBuffers(1, n, wanted)
        self.places, self.shown = one.places.astype(np.int64), len(one.seen_floats)
        self.sizes = pad_count(6 * world.most_samples), pad_count(2 * n)
        rows = getattr(inner, "_rows", (0, n))
        self.settings, self.limits = np.zeros(6), np.zeros(1)
        self.settings[3:] = scale, *rows
        self.memory: Arrays = {"first": np.zeros((1, 0)), "second": np.zeros((1, 0))}
        if isinstance(inner, Ewma):
            self.settings[:3] = inner.kernel_settings
            self.memory = {"first": np.zeros((1, n)), "second": np.ones((1, n))}
        elif isinstance(inner, Shewhart):
            self.settings[1] = inner._quantile
        elif isinstance(inner, Cusum):
            self.settings[:2] = inner.allowance, inner.limit
            sums = np.zeros((1, rows[1] - rows[0]))
            self.memory = {"first": sums, "second": sums}
        elif isinstance(inner, SnapshotChi2):
            self.limits = np.asarray(inner._thresholds, dtype=np.float64)
        whole = inner.scope == "receiver" or self.detector == _kernels.NEVER
        self.columns = 1 if whole else n

    def share(self, torch: Any, device: Any) -> Tensors:
        """What all receivers read, in C order."""
        setup, world, attack = self.setup, self.setup.world.at_hand, self._attack
        rules = setup.receiver
        whether = rules.covariance_code, rules.min_satellites, rules.orthonormalize
        axes_e = getattr(attack, "axes_e", np.zeros((1, 1, 6)))
        no_mappings = np.zeros((0, self.channels, OBLIQUITIES))
        shared = {
            **{name: getattr(world, name) for name in ("run", "epoch_time", "epoch_end")},
            **{name: getattr(world, name) for name in ("satellites", "position_e", "velocity_e")},
            "C_en": world.C_en,
            "axes_e": axes_e,
            "captured": attack.mask,
            "slots": attack.slots.astype(np.int64),
            "attack_settings": attack.kernel_settings,
            "rules": np.array((*whether, *self.sizes), dtype=np.int64),
            "places": self.places,
            "mappings": setup.mappings if setup.mappings.size else no_mappings,
            "settings": self.settings,
            "limits": self.limits,
        }
        return Tensors(torch, shared, device, shared=True)

    def gather(self, simulator: TightlyCoupledSimulator) -> Arrays:
        """Of receivers that have just started, all that lasts, as (M, ...) arrays."""
        buffers, sensors, memory = simulator.buffers, simulator.sensors, simulator.attack.memory
        m, n, c = simulator.receivers, self.channels, self.columns
        nowhere = np.zeros((m, 6))
        shown = np.zeros((m, self.shown))
        return {
            "x": buffers.fields.gather(),
            "assumed": buffers.assumed.gather(),
            "out": shown,
            "visible": np.zeros((m, n), dtype=np.bool_),
            "coasting": np.zeros(m, dtype=np.bool_),
            "sensors": sensors.fields.gather(),
            "constants": sensors.constants.gather(),
            "keys": sensors.words.gather(),
            "epochs": sensors.epoch,
            "range_offset": np.zeros((m, n)),
            "rate_offset": np.zeros((m, n)),
            "in_run": sensors.in_run.gather(),
            "signals": sensors.signals.gather(),
            "displacement": memory["displacement"],
            "rate": memory["rate"],
            "target_error": memory.get("target_error", nowhere),
            **{name: np.repeat(one, m, axis=0) for name, one in self.memory.items()},
            "statistic": np.zeros((m, c)),
            "threshold": np.full((m, c), self.settings[3]),
            "alarm": np.zeros((m, c), dtype=np.bool_),
            "weights": np.ones((m, 2 * n)),
        }

    def scratch(self, receivers: int) -> Arrays:
        return {
            "work": np.zeros((receivers, work_rows(self.channels, *self.sizes))),
            "spans": np.zeros((receivers, 4, 1), dtype=np.int64),
            "faults": np.zeros(receivers, dtype=np.int64),
        }

    def name_receivers(self, lasting: Tensors) -> Any:
        """`Receivers` of kernels, with views of what is shown of an epoch."""
        views, out, m = lasting.views, lasting["out"], 2 * self.channels
        receivers = out.shape[0]
        for name, place in zip(("innovation", "variance"), self.places[:2].tolist(), strict=True):
            views[name] = view_for_kernels(out[:, place : place + m])
        place = max(int(self.places[2]), 0)
        size = m if self.places[2] >= 0 else 0
        strides = 1, m * receivers, receivers
        part = out.as_strided((receivers, size, size), strides, place * receivers)
        views["covariance"] = view_for_kernels(part)
        views["authentic"] = view_for_kernels(out[:0, :m])
        return lasting.name_views(_kernels.Receivers)


def number_detector(detector: Any) -> int:
    if isinstance(detector, Ewma):
        return _kernels.PASSIVE_EWMA if detector.weight_scale is None else _kernels.EWMA
    return NUMBERS[type(detector)]
