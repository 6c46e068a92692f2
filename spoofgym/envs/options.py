"""What the caller of an environment asks for: seeds, options of a reset, choice of infos."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from .._registry import check_choice

Array = NDArray[Any]
RESET_MASK = "reset_mask"
InfoSpec = str | Sequence[str]
WORDS = ("all", "none")
AUTORESET_MODES = {
    "next_step": AutoresetMode.NEXT_STEP,
    "same_step": AutoresetMode.SAME_STEP,
    "disabled": AutoresetMode.DISABLED,
}


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
    if isinstance(seed, int | np.integer):
        check_seed(seed)
        return [int(seed) + i for i in range(receivers)]
    if isinstance(seed, str) or not isinstance(seed, Sequence | np.ndarray):
        check_seed(seed)
    seeds = list(seed)
    if len(seeds) != receivers:
        raise ValueError(f"`seed` must have {receivers} elements, got {len(seeds)}")
    for each in seeds:
        check_seed(each)
    return seeds


def check_seed(seed: Any) -> None:
    """Raise unless there is such a seed."""
    whole = isinstance(seed, int | np.integer) and not isinstance(seed, bool)
    if seed is not None and not (whole and seed >= 0):
        raise ValueError(f"a seed must be a whole number, at least 0, got {seed!r}")


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


def domain_option(options: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    """Circumstances that a reset is given instead of drawing them, ``options["domain"]``."""
    given = (options or {}).get("domain")
    if given is not None and not isinstance(given, Mapping):
        raise TypeError(f"the option `domain` of a reset must be a dict, got {given!r}")
    return given


def autoreset_mode_of(given: str | AutoresetMode) -> AutoresetMode:
    """Autoreset mode by name."""
    if isinstance(given, str):
        word = given.lower().removeprefix("autoresetmode.")
        check_choice("autoreset mode", word, AUTORESET_MODES)
        return AUTORESET_MODES[word]
    if given not in AUTORESET_MODES.values():
        raise ValueError(
            f"`autoreset_mode` must be one of {', '.join(AUTORESET_MODES)}, got {given}"
        )
    return given


def check_vector_settings(num_envs: int, render_mode: object) -> None:
    """Raise unless there are receivers, and nothing is to be rendered."""
    if not isinstance(num_envs, int | np.integer) or isinstance(num_envs, bool):
        raise ValueError(f"`num_envs` must be a whole number, got {num_envs!r}")
    if num_envs < 1:
        raise ValueError(f"`num_envs` must be at least 1, got {num_envs}")
    if render_mode is not None:
        raise ValueError(
            "`render_mode` must be None, there is nothing to render in a vector environment: the "
            f"single one seeded with seed + i shows receiver i; got {render_mode!r}"
        )


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
