"""What the caller of ``reset`` asks for, beside the seed."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._registry import whole_number

RESET_MASK = "reset_mask"


def warn_unknown(options: Mapping[str, Any] | None, valid: Sequence[str] = ()) -> None:
    """Warn of options that nothing is done with."""
    if options is not None and not isinstance(options, Mapping):
        raise TypeError(f"`options` of a reset must be a dict, got {options!r}")
    for name in options or ():
        if name not in valid:
            warnings.warn(
                f"reset has no option {name!r}; valid: {', '.join(valid) or 'none'}",
                UserWarning,
                stacklevel=3,
            )


def mask_of(options: Mapping[str, Any] | None, receivers: int) -> NDArray[np.bool_] | None:
    """Which receivers are to be reset: (B,) bool, a copy; None for all of them."""
    if options is None or RESET_MASK not in options:
        return None
    mask = options[RESET_MASK]
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
        said = f"dtype {mask.dtype}" if isinstance(mask, np.ndarray) else repr(mask)
        raise TypeError(f"`options['{RESET_MASK}']` must be an array of dtype bool, got {said}")
    if mask.shape != (receivers,):
        raise ValueError(
            f"`options['{RESET_MASK}']` must have shape ({receivers},), got {mask.shape}"
        )
    if not mask.any():
        raise ValueError(f"`options['{RESET_MASK}']` must be True for at least one receiver")
    return mask.copy()


def seeds_of(seed: Any, receivers: int) -> list[int | None]:
    """Seed of every receiver.  Returns None where the stream of the receiver goes on."""
    if seed is None:
        return [None] * receivers
    if isinstance(seed, str) or not isinstance(seed, Sequence | np.ndarray):
        first = whole_number("a seed", seed)
        return [first + i for i in range(receivers)]
    seeds = [checked_seed(each) for each in seed]
    if len(seeds) != receivers:
        raise ValueError(f"`seed` must have {receivers} elements, got {len(seeds)}")
    return seeds


def checked_seed(seed: Any) -> int | None:
    """A seed as Python's own int, or None; raises where it is neither."""
    return None if seed is None else whole_number("a seed", seed)


def of_rows(given: Mapping[str, Any], rows: NDArray[np.intp], count: int) -> dict[str, Any]:
    """Circumstances of some receivers, of those given for all."""
    chosen = {}
    for name, value in given.items():
        if isinstance(value, str) or np.ndim(value) == 0:
            chosen[name] = value
            continue
        values = list(value)
        if len(values) != count:
            raise ValueError(f"`{name}` must be one value or {count} of them, got {len(values)}")
        chosen[name] = [values[row] for row in rows]
    return chosen
