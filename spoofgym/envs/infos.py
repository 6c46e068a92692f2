"""Which information a vector environment hands out: all, none, or some by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._registry import check_choice

Array = NDArray[Any]
InfoSpec = str | Sequence[str]
WORDS = ("all", "none")


def info_keys(spec: InfoSpec, valid: Sequence[str]) -> frozenset[str] | None:
    """Keys that are asked for."""
    if isinstance(spec, str):
        check_choice("choice of infos", spec, WORDS)
        return None if spec == "all" else frozenset()
    keys = tuple(spec)
    for key in keys:
        check_choice("info", key, valid)
    return frozenset(keys)


def chosen(info: Mapping[str, Array], keys: frozenset[str] | None) -> Mapping[str, Array]:
    """Information that is asked for."""
    if keys is None:
        return info
    return {name: array for name, array in info.items() if name in keys}


def masked(info: Mapping[str, Array], mask: NDArray[np.bool_]) -> dict[str, Any]:
    """Arrays with the masks of the receivers that have them.  `info` (B,) arrays."""
    masks = np.empty((len(info), len(mask)), dtype=np.bool_)  # a row each, so that none is shared
    masks[:] = mask
    result: dict[str, Any] = dict(info)
    result.update(zip(["_" + name for name in info], masks, strict=True))
    return result
