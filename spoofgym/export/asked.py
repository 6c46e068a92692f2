"""What an export is asked for, looked at before anything is traced."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from .._registry import check_choice
from ..policies.card import State, seeds_in, text_of
from ..policies.contract import NotFinite
from ..simulators.splits import SPLITS

OWN_NAMES = ("observation", "action")
"""Names of the first input and output of a file, which no state may have."""


def check_training(training: Any, name: str) -> None:
    """Raise unless `training` is a mapping, and names runs that there are."""
    if training is None:
        return
    if not isinstance(training, Mapping):
        raise ValueError(f"`training` must be a mapping, got {training!r}")
    for _, split in sorted(seeds_in(training, name)):
        check_choice("split", split, SPLITS)


def checked_states(state: Any) -> dict[str, int]:
    """Size of each state by its name; a ValueError where one can't be."""
    if state is None:
        return {}
    if not isinstance(state, Mapping):
        raise ValueError(f"`state` must be sizes by name, such as {{'hidden': 32}}, got {state!r}")
    for name, size in state.items():
        with one_line(f"state {name!r} of size {size!r}"):
            State(name=name, size=size)
        if name in OWN_NAMES:
            raise ValueError(f"a state can't have the name {name!r}, which the file has already")
    return {str(name): int(size) for name, size in state.items()}


@contextmanager
def trial_of(path: Path) -> Iterator[Path]:
    """Path of a trial in a folder of its own; what is wrong with it is said of `path`."""
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / path.name
        try:
            yield trial
        except ValueError as error:
            if folder not in str(error):
                raise
            kind = NotFinite if isinstance(error, NotFinite) else ValueError
            raise kind(str(error).replace(folder, str(path.parent))) from error


@contextmanager
def one_line(what: str) -> Iterator[None]:
    """Say in one line what is wrong with a part of a card."""
    try:
        yield
    except ValidationError as error:
        raise ValueError(f"{what}: {text_of(error)}") from error
