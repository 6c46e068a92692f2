"""A learned spoofer: a policy in an ONNX file, and the card that describes it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..policies.onnx_file import SUFFIX
from ..policies.onnx_model import OnnxModel
from .base import FloatArray, Spoofer, SpooferContext
from .card import Card
from .zoo import ZOO_FOLDER, shipped


@dataclass
class OnnxPolicy(Spoofer):
    """Acts as a network in an ONNX file does; the card of the same name is in the same folder.

    Parameters
    ----------
    file : str or path-like
        Name of a shipped one, or path of an ``.onnx`` file.
    sha256 : str, optional
        Digest that the file must have; by default the card's.

    Attributes
    ----------
    card : Card
        What it fits, what it knows, how it was made.
    knowledge, label, designed_on, decision_interval_s, between : optional
        Of the card.
    """

    described_as = "OnnxPolicy"
    file: str
    sha256: str | None = None

    knowledge = "of its card"

    def __post_init__(self) -> None:
        self.file = os.fspath(self.file)
        path = path_of(self.file)
        if not path.is_file():
            raise ValueError(f"there is no ONNX file {path}")
        if not path.with_suffix(".json").is_file():
            raise ValueError(f"{path} has no card: there is no {path.with_suffix('.json')}")
        self.card = card = Card.load(path.with_suffix(".json"))
        if card.file is None or card.observation is None:
            raise ValueError(f"{path} has the card of a {card.kind}, not of an onnx-policy")
        self.model = OnnxModel(path, card.file, card.observation, card.action, self.sha256)
        self.sha256 = self.model.sha256
        self.knowledge = card.knowledge.run_time
        self.designed_on = card.knowledge.design_time
        self.label = card.name
        self.action_terms = card.env_kwargs.get("action")
        self.decision_interval_s = card.env_kwargs.get("decision_interval_s")
        self.between = card.env_kwargs.get("between", "hold")

    def bind(self, context: SpooferContext) -> None:
        found = self.card.differences(context)
        if found:
            raise ValueError(f"{self.file} does not fit this attack: {'; '.join(found)}")
        super().bind(context)

    def act(self, observation: NDArray[np.float32]) -> FloatArray:
        """Command the attack for the coming epoch. `observation` (B, o) of all receivers; returns
        (B, a) in [-1, 1], C-contiguous."""
        return self.model.act(observation)


def path_of(file: str) -> Path:
    if file.endswith(SUFFIX):
        return Path(file)
    if file not in shipped():
        raise ValueError(
            f"`file` must be the path of an {SUFFIX} file or the name of a shipped spoofer "
            f"({', '.join(shipped()) or 'there is none'}), got {file!r}"
        )
    return ZOO_FOLDER / f"{file}{SUFFIX}"
