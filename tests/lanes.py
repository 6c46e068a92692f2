"""Kernels of lane arrays: what they do to eight receivers they do to each alone, bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from spoofgym.core.simd import LANES


def side_by_side(columns: Sequence[Any]) -> np.ndarray:
    """(rows, 8) lane array of eight receivers' rows."""
    assert len(columns) == LANES
    return np.stack([np.ravel(column) for column in columns], axis=1)


def in_all_lanes(kernel: Callable[..., object], *arrays: np.ndarray, scratch: int = 0) -> None:
    """Call a kernel with lane arrays, (rows, 8), which it may write; and with each lane alone.

    What the last `scratch` arrays hold afterwards has no meaning.
    """
    alone = [[np.ascontiguousarray(array[:, i]) for array in arrays] for i in range(LANES)]
    with np.errstate(all="ignore"):  # of which compiled code says nothing
        for each in (arrays, *alone):
            kernel(*each)
    for i, single in enumerate(alone):
        results = list(zip(arrays, single, strict=True))[: len(arrays) - scratch]
        for number, (wide, narrow) in enumerate(results):
            assert wide[:, i].tobytes() == narrow.tobytes(), (i, number)
