"""Checkpoint of a training: tensors, a JSON state, and files, in one file without pickle."""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from spoofgym.core.files import remove_stale_parts, write_file
from spoofgym.core.reading import Archive, parse_json

WEIGHTS, STATE = "parameters.pt", "state.json"
RUNNING = {"obs_rms": ("mean", "var", "count"), "ret_rms": ("mean", "var", "count")}
"""Running statistics of a `VecNormalize`."""
DAMAGED = (
    *(zipfile.BadZipFile, zlib.error, struct.error, LookupError, ValueError, TypeError),
    *(RuntimeError, OSError, EOFError, UnpicklingError, AttributeError, AssertionError),
)


def write_checkpoint(
    path: Path, tensors: Mapping[str, Any], state: Mapping[str, Any], files: Sequence[Path] = ()
) -> None:
    """Write a checkpoint, whole or not at all. `files`: what belongs to this state of the training,
    such as the best policy; those that are there are kept."""
    weights, content = BytesIO(), BytesIO()
    torch.save(dict(tensors), weights)
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr(WEIGHTS, weights.getvalue())
        archive.writestr(STATE, json.dumps(state))
        for file in files:
            if file.is_file():
                archive.writestr(file.name, file.read_bytes())
    write_file(path, content.getvalue())
    remove_stale_parts(path.parent)


@contextmanager
def open_checkpoint(
    path: Path, files: Sequence[Path] = ()
) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Tensors and state of a checkpoint, whose files are written beside it when the block has taken
    them over; a ValueError where they are damaged, fit nothing there, or are none of `files`."""
    try:
        with Archive(path) as archive:
            state = parse_json(archive.read(STATE), STATE)
            tensors = torch.load(BytesIO(archive.read(WEIGHTS)), weights_only=True)
            names = {*archive.namelist()} - {WEIGHTS, STATE}
            if strange := names - {each.name for each in files}:
                raise ValueError(f"it holds {', '.join(sorted(strange))}, which is not its own")
            found = {name: archive.read(name) for name in names}
        yield tensors, state
    except DAMAGED as error:
        first = str(error).strip().partition("\n")[0]
        raise ValueError(
            f"{path} is damaged, or of another model ({first}): remove it, and the training begins "
            "anew"
        ) from error
    for name, content in found.items():
        write_file(path.parent / name, content)
    remove_stale_parts(path.parent)


def save_checkpoint(
    path: Path,
    model: BaseAlgorithm,
    envs: VecNormalize,
    state: Mapping[str, Any],
    files: Sequence[Path] = (),
) -> None:
    """Write a model of stable-baselines3: weights, optimizers, and how many steps it has taken."""
    running = {
        # in double precision, also what is a number of Python by itself
        name: {key: torch.tensor(np.float64(getattr(getattr(envs, name), key))) for key in keys}
        for name, keys in RUNNING.items()
    }
    tensors = {**model.get_parameters(), **running}
    write_checkpoint(path, tensors, {**state, "steps": model.num_timesteps}, files)


def load_checkpoint(
    path: Path, model: BaseAlgorithm, envs: VecNormalize, files: Sequence[Path] = ()
) -> dict[str, Any]:
    """Take over a checkpoint; its state. `files` as `save_checkpoint` takes them."""
    with open_checkpoint(path, files) as (tensors, state):
        for name, keys in RUNNING.items():
            found = tensors.pop(name)
            for key in keys:
                value = found[key]
                setattr(getattr(envs, name), key, value.numpy() if value.ndim else value.item())
        model.set_parameters(tensors, device="cpu")
        model.num_timesteps = state["steps"]
    return state
