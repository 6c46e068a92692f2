"""What an object remembers of every receiver: named arrays with a leading axis of receivers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .registry import require


class Memory(dict[str, NDArray[Any]]):
    """Arrays by name, one row a receiver, that can be reset, taken out and put back by rows.

    Declare every array once, with the values that an episode starts with; write into the arrays
    afterwards, or assign new ones of the same shape.

    `stamp`: equal to that of no other memory in any process, another one whenever an array is
    assigned.

    Examples
    --------
    >>> import numpy as np
    >>> memory = Memory(2)
    >>> memory.declare("count", np.zeros(2))
    >>> memory["count"] = memory["count"] + 1.0
    >>> memory.reset(np.array([True, False]))
    >>> memory["count"]
    array([0., 1.])
    """

    stamp: Any = None

    def __init__(self, receivers: int = 0) -> None:
        super().__init__()
        self.receivers = receivers
        self._initial: dict[str, NDArray[Any]] = {}

    def __setitem__(self, name: str, array: NDArray[Any]) -> None:
        super().__setitem__(name, array)
        self.stamp = object()

    @property
    def declared(self) -> Mapping[str, NDArray[Any]]:
        return self._initial

    def declare(self, name: str, initial: NDArray[Any]) -> None:
        """Add an array.  `initial` (B, ...) values at the start of an episode."""
        array = np.array(initial)
        require(
            array.ndim != 0 and array.shape[0] == self.receivers,
            f"memory {name!r} needs a leading axis of {self.receivers} receivers, "
            f"got shape {array.shape}",
        )
        self[name] = array
        alike = bool((array[:1] == array).all())  # one row stands for all then
        first = array[:1].copy()
        self._initial[name] = np.broadcast_to(first, array.shape) if alike else array.copy()

    def declare_all(self, **initial: NDArray[Any]) -> None:
        for name, array in initial.items():
            self.declare(name, array)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        for name, initial in self._initial.items():
            if mask is None:
                self[name] = initial.copy()
            else:
                restored = np.array(self[name])
                restored[mask] = initial[mask]
                self[name] = restored

    def copy_rows(self, to: NDArray[np.intp], other: Memory, rows: NDArray[np.intp]) -> None:
        """Take over rows of another memory of the same names. `to`: rows of this memory that are
        overwritten."""
        whole = np.array_equal(to, np.arange(self.receivers))
        for name in self._initial:
            taken = other[name][rows]
            if not whole:
                merged = self[name].copy()
                merged[to] = taken
            self[name] = taken if whole else merged
