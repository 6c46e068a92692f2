"""Receivers on a device: tensors with the receivers last in memory, and views of them for kernels.

A receiver has on a device what a batch of one has on the processor.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from ..attacks._offset_kernels import scratch_shape
from ..detectors.charts import Ewma, Shewhart
from ..detectors.chi_square import SnapshotChi2, WindowedChi2
from ..detectors.controls import Never
from ..detectors.cusum import Cusum
from ..receiver.epoch import ReceiverBuffers
from ..simulation.tight import ATTACK_FORMS, TightlyCoupledSimulator, split_scale
from . import _kernels
from ._compile import SIMULATED

Arrays = dict[str, NDArray[Any]]
DETECTORS: dict[type[Any], tuple[int, tuple[str, ...], Callable[[Any], Iterable[float]]]] = {
    Never: (_kernels.NEVER, (), lambda _: ()),
    Ewma: (_kernels.EWMA, ("average", "decay"), lambda it: it.kernel_settings),
    Shewhart: (_kernels.SHEWHART, (), lambda it: (0.0, it._quantile)),
    Cusum: (_kernels.CUSUM, ("above", "below"), lambda it: (it.allowance, it.limit)),
    SnapshotChi2: (_kernels.SNAPSHOT, (), lambda _: ()),
    WindowedChi2: (
        _kernels.WINDOWED,
        ("past", "past_rows"),
        lambda it: (it.silent_epochs, it._per_satellite),
    ),
}
"""Number of a detector in kernels, what it remembers by name, and its first settings."""
ALIKE = "assumed", "constants"
"""What is one for all receivers where all are alike."""
OF_OFFSETS = dict(requested=float, taken=bool, orders=int, bases=int, residual=float)
"""What an attack by offsets remembers, beside what all do."""


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
    """Arrays of receivers by name, as tensors, and as kernels take them: `views`."""

    def __init__(
        self, torch: Any, arrays: Mapping[str, NDArray[Any]], device: Any, *, shared: bool = False
    ) -> None:
        self.words = {name for name, array in arrays.items() if array.dtype == np.uint64}
        self.take({name: put(torch, array, device, shared) for name, array in arrays.items()})

    def take(self, tensors: dict[str, Any]) -> None:
        self.tensors = tensors
        self.views = {name: view_for_kernels(x, name in self.words) for name, x in tensors.items()}

    def __getitem__(self, name: str) -> Any:
        return self.tensors[name]

    def __or__(self, other: Tensors) -> Tensors:
        both = copy.copy(self)
        both.words = self.words | other.words
        both.take(self.tensors | other.tensors)
        return both

    def resize(self, receivers: int) -> Tensors:
        """The same of so many receivers, all 0, but for what all share."""
        other = copy.copy(self)
        other.take(
            {
                name: x if name in ALIKE and len(x) == 1 else _make_zeros(x, receivers)
                for name, x in self.tensors.items()
            }
        )
        return other

    @property
    def bytes_each(self) -> int:
        """Memory of a receiver."""
        return sum(int(x.element_size() * x[:1].numel()) for x in self.tensors.values())

    def name_views(self, kind: Any) -> Any:
        return kind(**{name: self.views[name] for name in kind._fields})


def _make_zeros(like: Any, receivers: int) -> Any:
    zeros = like.new_zeros((*reversed(like.shape[1:]), receivers))
    return zeros.permute(tuple(reversed(range(like.ndim))))


class Layout:
    """What kernels need to know of a simulator: `attack` and `detector` by number, `places` in what
    is shown of an epoch, and sizes."""

    def __init__(self, simulator: TightlyCoupledSimulator) -> None:
        self._simulator, attack = simulator, simulator.attack
        self.attack = ATTACK_FORMS.get(type(attack), _kernels.OFFSETS)
        inner, scale = split_scale(simulator.detector)
        self.detector, self._remembered, settings = DETECTORS[type(inner)]
        if isinstance(inner, Ewma) and inner.weight_scale is None:
            self.detector = _kernels.PASSIVE_EWMA
        n = self.channels = simulator.setup.world.channels
        first = (*settings(inner), 0.0, 0.0, 0.0)[:3]
        self.settings = np.array([*first, scale, *getattr(inner, "_rows", (0, n))], dtype=float)
        self.limits = np.asarray(getattr(inner, "_thresholds", np.zeros(1)), dtype=float)
        whole = inner.scope == "receiver" or self.detector == _kernels.NEVER
        self.columns = 1 if whole else n
        wanted = ("innovation_cov",) if self.detector >= _kernels.SNAPSHOT else ()
        one = ReceiverBuffers(1, n, wanted)
        self.places, self.shown = one.places.astype(np.int64), len(one.seen_floats)
        self._offset_work: tuple[int, int] = 1, 1
        if self.attack == _kernels.OFFSETS:
            shapes = (attack.memory[name].shape[1] for name in ("displacement", "bases"))
            self._offset_work = scratch_shape(n, *shapes)

    def share(self, torch: Any, device: Any) -> Tensors:
        """What all receivers read, in C order."""
        simulator = self._simulator
        shared = {
            **simulator.shared_arrays(),
            "C_en": simulator.setup.C_en,
            "axes_e": getattr(simulator.attack, "axes_e", np.zeros((1, 1, 6))),
            "places": self.places,
            "settings": self.settings,
            "limits": self.limits,
        }
        return Tensors(torch, shared, device, shared=True)

    def gather(self) -> Arrays:
        """All that lasts of receivers that have just started, as (M, ...) arrays."""
        simulator, m, n = self._simulator, self._simulator.receivers, self.channels
        attack, judge = simulator.attack.memory, split_scale(simulator.detector)[0].memory
        known, nothing = [judge[name] for name in self._remembered], np.zeros((m, 0))
        first, second, *_ = (np.asarray(x, dtype=float) for x in (*known, nothing, nothing))
        return {
            **simulator.lasting_arrays(),
            **{name: attack.get(name, nothing.astype(t)) for name, t in OF_OFFSETS.items()},
            "first": first,
            "second": second,
            "judged": judge.get("seen", np.zeros(m, dtype=np.int64)),
            "out": np.zeros((m, self.shown)),
            "range_offset": np.zeros((m, n)),
            "rate_offset": np.zeros((m, n)),
            "visible": np.zeros((m, n), dtype=np.bool_),
            "coasting": np.zeros(m, dtype=np.bool_),
            "statistic": np.zeros((m, self.columns)),
            "threshold": np.full((m, self.columns), self.settings[3]),
            "alarm": np.zeros((m, self.columns), dtype=np.bool_),
            "weights": np.ones((m, 2 * n)),
        }

    def scratch(self, receivers: int) -> Arrays:
        return {
            "work": np.zeros((receivers, self._simulator.work_rows)),
            "spans": np.zeros((receivers, 4, 1), dtype=np.int64),
            "offset_work": np.zeros((receivers, *self._offset_work)),
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
