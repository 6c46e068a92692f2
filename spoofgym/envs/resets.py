"""What the caller of ``reset`` asks for, beside the seed."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

RESET_MASK = "reset_mask"
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


def warn_unknown(options: Mapping[str, Any] | None, valid: Sequence[str] = ()) -> None:
    """Warn of options that nothing is done with.

    Parameters
    ----------
    options : mapping, optional
        Of the user.
    valid : sequence of str
        Names of the options that there are.

    Raises
    ------
    TypeError
        When `options` is no mapping.
    """
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
    """Which receivers are to begin anew.

    Parameters
    ----------
    options : mapping, optional
        Of the user.
    receivers : int
        B.

    Returns
    -------
    ndarray or None
        (B,) bool, a copy; None for all of them.

    Raises
    ------
    TypeError
        When the mask is no array of bool.
    ValueError
        When its shape is another, or nothing in it is True.
    """
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
    """Seed of every receiver.

    Parameters
    ----------
    seed : int, sequence of int or None
        Of the user; receiver i gets ``seed + i``, or its element.
    receivers : int
        B.

    Returns
    -------
    list
        None where the stream of the receiver goes on.

    Raises
    ------
    ValueError
        When there are not as many, or one is no seed.
    """
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
    """Raise unless there is such a seed.

    Parameters
    ----------
    seed : int or None
        Of the user.

    Raises
    ------
    ValueError
        When it is neither None nor a whole number, at least 0.
    """
    whole = isinstance(seed, int | np.integer) and not isinstance(seed, bool)
    if seed is not None and not (whole and seed >= 0):
        raise ValueError(f"a seed must be a whole number, at least 0, got {seed!r}")


def of_rows(given: Mapping[str, Any], rows: NDArray[np.intp], count: int) -> dict[str, Any]:
    """Circumstances of some receivers, of those told of all.

    Parameters
    ----------
    given : mapping
        Each one value, or one for every receiver.
    rows : ndarray
        Which receivers.
    count : int
        Number of all.

    Returns
    -------
    dict
        Each one value, or one for every row.

    Raises
    ------
    ValueError
        When there are as many values of something as of neither.
    """
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
