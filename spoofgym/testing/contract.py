"""What all checks share: a broken promise, and comparison bit by bit."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray


def require(kept: bool | np.bool_, message: str) -> None:
    """Raise when a contract is broken."""
    if not kept:
        raise AssertionError(message)


def same_bits(first: NDArray[Any] | None, second: NDArray[Any] | None) -> bool:
    """Whether two arrays, or two missing ones, are the same to the last bit."""
    if first is None or second is None:
        return first is None and second is None
    alike = first.shape == second.shape and first.dtype == second.dtype
    return alike and first.tobytes() == second.tobytes()


def first_difference(first: NDArray[Any] | None, second: NDArray[Any] | None) -> str:
    """Where two arrays differ first, for messages.

    Returns for example ``"[2, 0]: 1.0 and 1.5"``.
    """
    if first is None or second is None or first.shape != second.shape:
        shapes = ["None" if a is None else f"shape {a.shape}" for a in (first, second)]
        return " and ".join(shapes)
    both_nan = np.isnan(first) & np.isnan(second)
    differ = np.argwhere(~((first == second) | both_nan))
    if not len(differ):
        return f"types {first.dtype} and {second.dtype}, or the sign of a zero"
    index = tuple(int(i) for i in differ[0])
    return f"{list(index)}: {first[index]} and {second[index]}"


def require_fresh(
    what: str, array: NDArray[Any], owners: dict[str, NDArray[Any]], until: str
) -> None:
    """Raise when an array that was handed out belongs to somebody else.

    `owners`: arrays that it must not share memory with, by name.
    """
    for owner, other in owners.items():
        require(
            not np.may_share_memory(array, other),
            f"{what} is (part of) {owner}, which changes with {until}; return a copy",
        )


@contextmanager
def read_only_given(word: str, given: str) -> Iterator[None]:
    """Say what it means when NumPy or numba refuses to write to an array in the block."""
    try:
        yield
    except (ValueError, TypeError) as error:
        if "read-only" not in str(error) and "readonly" not in str(error):
            raise
        raise AssertionError(
            f"the {word} writes into its {given}, which is read-only ({error}); copy the array "
            "first"
        ) from error


@contextmanager
def no_global_chance(word: str) -> Iterator[None]:
    """Raise when the block draws from, or seeds, the global generators."""
    before = random.getstate(), _numpy_state()
    yield
    require(
        (random.getstate(), _numpy_state()) == before,
        f"the {word} uses the global random numbers of `random` or `numpy.random`, which makes "
        "runs depend on each other; it must not use chance at all",
    )


def _numpy_state() -> tuple[Any, ...]:
    name, keys, *rest = np.random.get_state(legacy=True)  # noqa: NPY002 - only looked at
    return name, np.asarray(keys).tobytes(), *rest
