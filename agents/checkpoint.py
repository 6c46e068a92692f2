"""Checkpoint of a model of stable-baselines3 and its `VecNormalize`: one file, no pickle."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from spoofgym.core.files import write_file

WEIGHTS, STATE = "parameters.pt", "state.json"
RUNNING = {"obs_rms": ("mean", "var", "count"), "ret_rms": ("mean", "var", "count")}
"""Running statistics of a `VecNormalize`."""


def save_checkpoint(
    path: Path,
    model: BaseAlgorithm,
    envs: VecNormalize,
    state: dict[str, Any],
    files: Sequence[Path] = (),
) -> None:
    """Write a checkpoint, whole or not at all. `model`: its weights and optimizers are kept, and
    how many steps it has taken; `files`: files that belong to this state of the training, such as
    the best policy; those that are there are kept."""
    running = {
        # in double precision, also what is a number of Python by itself
        name: {key: torch.tensor(np.float64(getattr(getattr(envs, name), key))) for key in keys}
        for name, keys in RUNNING.items()
    }
    weights, content = BytesIO(), BytesIO()
    torch.save({**model.get_parameters(), **running}, weights)
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr(WEIGHTS, weights.getvalue())
        archive.writestr(STATE, json.dumps({**state, "steps": model.num_timesteps}))
        for file in files:
            if file.is_file():
                archive.writestr(file.name, file.read_bytes())
    write_file(path, content.getvalue())


def load_checkpoint(
    path: Path, model: BaseAlgorithm, envs: VecNormalize, folder: Path
) -> dict[str, Any]:
    """Take over a checkpoint; its state."""
    try:
        with zipfile.ZipFile(path) as archive:
            state = dict(json.loads(archive.read(STATE)))
            found = torch.load(BytesIO(archive.read(WEIGHTS)), weights_only=True)
            files = {
                name: archive.read(name)
                for name in archive.namelist()
                if name not in (WEIGHTS, STATE) and Path(name).name == name
            }
        for name, keys in RUNNING.items():
            running = getattr(envs, name)
            for key in keys:
                value = found[name][key]
                setattr(running, key, value.numpy() if value.ndim else value.item())
            del found[name]
        model.set_parameters(found, device="cpu")
        model.num_timesteps = state["steps"]
    except (zipfile.BadZipFile, KeyError, ValueError, RuntimeError, OSError) as error:
        raise ValueError(f"{path} is damaged, or of another model: {error}") from error
    for name, content in files.items():
        write_file(folder / name, content)
    return state
