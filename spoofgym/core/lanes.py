"""Quantities of many receivers as lane arrays: group by group of eight, or of a single one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .simd import ALIGNMENT, LANES

Shapes = Mapping[str, tuple[int, ...]]


def first_rows(shapes: Shapes) -> dict[str, int]:
    """First row of every quantity in a lane array that holds them one after the other."""
    sizes = [int(np.prod(shape, dtype=int)) for shape in shapes.values()]
    return dict(zip(shapes, np.cumsum([0, *sizes]).tolist(), strict=False))


class LaneFields:
    """Quantities of B receivers by name, in the memory order of the kernels.

    `data` is one lane array: for each group of eight receivers the rows of all quantities, (groups
    x rows, 8), or (rows,) for a single receiver.  Lanes without a receiver follow the last one.
    ``fields[name]`` gathers a quantity, (B, ...), as a copy that can't be written to;
    ``fields[name] = values`` and `put` write it.

    `shapes`: what a receiver has of every quantity, in the order of the rows; `shared`: whether all
    receivers have the same, which is stored once, as one group: what is put for some is put for
    all.
    """

    def __init__(
        self, receivers: int, shapes: Shapes, dtype: type = np.float64, *, shared: bool = False
    ) -> None:
        self.receivers, self.shapes, self.shared = receivers, dict(shapes), shared
        self.lanes = 1 if receivers == 1 else LANES
        self.groups = 1 if shared else -(-receivers // self.lanes)
        self.first = first_rows(shapes)
        self.rows = sum(int(np.prod(shape, dtype=int)) for shape in shapes.values())
        self.data = _allocate_aligned(self.groups * self.rows * self.lanes, dtype)
        if self.lanes > 1:
            self.data = self.data.reshape(-1, self.lanes)

    @property
    def _grouped(self) -> NDArray[Any]:
        return self.data.reshape(self.groups, self.rows, self.lanes)

    def _find_rows(self, name: str) -> slice:
        size = int(np.prod(self.shapes[name], dtype=int))
        return slice(self.first[name], self.first[name] + size)

    def get(self, name: str, receivers: Any = None) -> NDArray[Any]:
        """A quantity of some receivers, all by default: (b, ...), a copy."""
        part = self._grouped[:, self._find_rows(name)].transpose(0, 2, 1)
        part = part.reshape(self.groups * self.lanes, -1)[: self.receivers]
        if self.shared:
            part = np.broadcast_to(part[0], (self.receivers, part.shape[1]))
        values = part.copy() if receivers is None else part[receivers]
        return values.reshape(len(values), *self.shapes[name])

    def gather(self) -> NDArray[Any]:
        """All rows of every receiver, (B, rows), or (1, rows) where they are shared; a copy."""
        rows = self._grouped.transpose(0, 2, 1).reshape(self.groups * self.lanes, self.rows)
        return rows[: 1 if self.shared else self.receivers].copy()

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Gather a quantity of all receivers; a copy, which can't be written to."""
        values = self.get(name)
        values.flags.writeable = False
        return values

    def put(self, name: str, receivers: Any, values: Any) -> None:
        """Write a quantity of some receivers; `values` as NumPy broadcasts them to (b, ...)."""
        index = np.arange(self.receivers)[receivers]
        shape, rows = (len(index), *self.shapes[name]), self._find_rows(name)
        flat = np.broadcast_to(np.asarray(values), shape).reshape(
            len(index), rows.stop - rows.start
        )
        if self.shared:
            self._put_shared(rows, flat)
            return
        self._grouped[index // self.lanes, rows, index % self.lanes] = flat
        self._fill_lanes()

    def _put_shared(self, rows: slice, values: NDArray[Any]) -> None:
        if not len(values):
            return
        if (values != values[0]).any():
            raise ValueError("receivers that share their values can't have different values")
        self._grouped[0, rows] = values[0][:, None]

    def __setitem__(self, name: str, values: Any) -> None:
        self.put(name, slice(None), values)

    def copy_rows(self, to: NDArray[np.intp], other: LaneFields, rows: NDArray[np.intp]) -> None:
        groups = 0 * rows if other.shared else rows // other.lanes
        taken = other._grouped[groups, :, rows % other.lanes]
        if self.shared:
            self._put_shared(slice(0, self.rows), taken)
            return
        self._grouped[to // self.lanes, :, to % self.lanes] = taken
        self._fill_lanes()

    def _fill_lanes(self) -> None:
        """Let lanes without a receiver be like the last one, so that they compute the same."""
        last = (self.receivers - 1) % self.lanes
        if last + 1 < self.lanes:
            group = self._grouped[-1]
            group[:, last + 1 :] = group[:, last : last + 1]

    def scratch(self, rows: int) -> NDArray[Any]:
        memory = _allocate_aligned(rows * self.lanes, np.float64)
        return memory if self.lanes == 1 else memory.reshape(rows, self.lanes)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        data = self.data
        self.data = _allocate_aligned(data.size, data.dtype.type).reshape(data.shape)
        self.data[...] = data


def _allocate_aligned(size: int, dtype: type) -> NDArray[Any]:
    memory: NDArray[Any] = np.zeros(size + ALIGNMENT // 8, dtype=dtype)
    first = (ALIGNMENT - memory.ctypes.data % ALIGNMENT) % ALIGNMENT // 8
    return memory[first : first + size]
