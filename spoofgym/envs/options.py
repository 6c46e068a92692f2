"""What the caller of an environment gives and gets: seeds, options, actions, spaces, infos."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from ..core.declared import check_word
from ..core.registry import check_choice, whole_number
from ..simulation.domain import expand_values
from ._kernels import within
from .core import Core

Array = NDArray[Any]
RESET_MASK = "reset_mask"
InfoSpec = str | Sequence[str]
TOLERANCE = 1e-6  # how far an action may lie outside of [-1, 1], by rounding
HALFWAY = (
    "an interrupt or error has left the last step or reset halfway: call reset() before step()"
)


@contextmanager
def whole_reset(env: Any) -> Iterator[None]:
    """Take an environment as halfway until its reset has ended; as before, if it is refused."""
    before, env._halfway = env._halfway, True
    try:
        yield
    except Exception:
        env._halfway = before
        raise
    env._halfway = False


def warn_unknown(options: Mapping[str, Any] | None, valid: Sequence[str]) -> None:
    if options is not None and not isinstance(options, Mapping):
        raise TypeError(f"`options` of a reset must be a dict, got {options!r}")
    for name in options or ():
        if name not in valid:
            warnings.warn(
                f"reset has no option {name!r}; valid: {', '.join(valid)}",
                UserWarning,
                stacklevel=3,
            )


def read_mask(options: Mapping[str, Any] | None, receivers: int) -> NDArray[np.bool_]:
    """Which receivers are to be reset, all by default: (B,) bool, a new array."""
    if options is None or RESET_MASK not in options:
        return np.ones(receivers, dtype=np.bool_)
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


def list_seeds(seed: Any, receivers: int) -> list[int | None]:
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


def reseed(
    rngs: Sequence[np.random.Generator], seeds: Sequence[int | None], mask: NDArray[np.bool_]
) -> list[np.random.Generator]:
    """A generator a receiver: new ones at first, and where a receiver of the mask has a seed."""
    if not rngs:
        return [np.random.default_rng(seed) for seed in seeds]
    return [
        rng if seed is None or not fresh else np.random.default_rng(seed)
        for rng, seed, fresh in zip(rngs, seeds, mask, strict=True)
    ]


def checked_seed(seed: Any) -> int | None:
    return None if seed is None else whole_number("a seed", seed)


def of_rows(given: Mapping[str, Any], rows: NDArray[np.intp], count: int) -> dict[str, Any]:
    values = {name: expand_values(name, value, count) for name, value in given.items()}
    return {name: [each[row] for row in rows] for name, each in values.items()}


def domain_option(options: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    given = (options or {}).get("domain")
    if given is not None and not isinstance(given, Mapping):
        raise TypeError(f"the option `domain` of a reset must be a dict, got {given!r}")
    return given


def observation_space(core: Core) -> spaces.Space[Any]:
    low, high = core.bounds
    return spaces.Box(low.copy(), high.copy(), dtype=np.float32)


def action_space(core: Core) -> spaces.Space[Any]:
    return spaces.Box(-1.0, 1.0, (len(core.action_names),), dtype=np.float32)


def checked_action(action: Any, shape: tuple[int, ...], names: tuple[str, ...]) -> NDArray[Any]:
    """Action as the engine takes it: of a shape (B, a) or (a,), float64, C-contiguous, a copy."""
    array = np.array(action, dtype=np.float64, order="C")
    if array.shape != shape:
        raise ValueError(
            f"an action must have shape {shape} ({', '.join(names)}), got {array.shape}"
        )
    if not within(array, 1.0 + TOLERANCE):
        where = tuple(np.argwhere(~(np.abs(array) <= 1.0 + TOLERANCE))[0])
        whose = f" of receiver {where[0]}" if array.ndim == 2 else ""
        metres = "; `spoofgym.envs.offsets_action` makes actions of metres"
        raise ValueError(
            f"an action must be finite and in [-1, 1]; {names[where[-1]]!r}{whose} is "
            f"{array[where]}{metres if names[where[-1]].endswith('_offset') else ''}"
        )
    return array


def parse_autoreset_mode(given: str | AutoresetMode) -> AutoresetMode:
    if isinstance(given, AutoresetMode):
        return given
    word = str(given).lower().removeprefix("autoresetmode.")
    check_word("autoreset_mode", word, [mode.name.lower() for mode in AutoresetMode])
    return AutoresetMode[word.upper()]


def check_vector_settings(num_envs: int, render_mode: object) -> None:
    whole_number("`num_envs`", num_envs, 1)
    if render_mode is not None:
        raise ValueError(
            "`render_mode` must be None, there is nothing to render in a vector environment: the "
            f"single one seeded with seed + i shows receiver i; got {render_mode!r}"
        )


def info_keys(spec: InfoSpec, valid: Sequence[str]) -> frozenset[str] | None:
    if isinstance(spec, str):
        check_word("infos", spec, ("all", "none"))
        return None if spec == "all" else frozenset()
    keys = tuple(spec)
    for key in keys:
        check_choice("info", key, valid)
    return frozenset(keys)


def select_info(info: Mapping[str, Array], keys: frozenset[str] | None) -> Mapping[str, Array]:
    if keys is None:
        return info
    return {name: array for name, array in info.items() if name in keys}


def add_masks(info: Mapping[str, Array], mask: NDArray[np.bool_]) -> dict[str, Any]:
    """Arrays with the masks of the receivers that have them.  `info` (B,) arrays."""
    masks = np.empty((len(info), len(mask)), dtype=np.bool_)  # a row each, so that none is shared
    masks[:] = mask
    result: dict[str, Any] = dict(info)
    result.update(zip(["_" + name for name in info], masks, strict=True))
    return result
