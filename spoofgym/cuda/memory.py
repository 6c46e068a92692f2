"""Receivers on a device: tensors with the receivers last, and views of them for kernels."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from ..core.devices import SIMULATED
from ..detectors.charts import Ewma, Shewhart
from ..detectors.chi_square import SnapshotChi2, WindowedChi2
from ..detectors.controls import Never
from ..detectors.cusum import Cusum
from . import _kernels

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
SCRATCH = "work", "spans", "offset_work", "faults", "alarmed", "ratio", "left", "command"
"""What does not last, or is of a fleet without an attack."""
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
        shared = {name: x for name, x in self.tensors.items() if name in ALIKE and len(x) == 1}
        other.take({name: _make_zeros(x, receivers) for name, x in self.tensors.items()} | shared)
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
