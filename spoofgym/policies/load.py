"""A policy from its file: the card, the network, and a detector that decides by it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .card import Card, DetectorCard, diff_spaces
from .contract import DetectorPolicy, FloatArray, PolicyContext
from .onnx_file import SUFFIX
from .onnx_model import OnnxModel
from .trial import Claim, check_policy
from .zoo import list_shipped, resolve_path

CardT = TypeVar("CardT", bound=Card)


def card_path(file: str | os.PathLike[str], side: str | None = None) -> Path:
    """Where the card of an ONNX file lies; a ValueError where the file has another ending. `side`:
    whose shipped policies are named then."""
    path = Path(file)
    if path.suffix != SUFFIX:
        names = ", ".join(list_shipped(side)) or "none"
        further = "" if side is None else f" or the name of a shipped {side} ({names})"
        raise ValueError(
            f"`file` must be the path of an {SUFFIX} file{further}, got {os.fspath(file)!r}"
        )
    return path.with_suffix(".json")


def load_policy(
    file: str | os.PathLike[str], kind: type[CardT], sha256: str | None = None
) -> tuple[CardT, OnnxModel]:
    """Card and network of an ONNX file, or of a shipped policy by its name; `kind`: of the card,
    `Card` for either side."""
    path = resolve_path(os.fspath(file), kind.own_side)
    beside = card_path(path, kind.own_side)
    if not path.is_file():
        raise ValueError(f"there is no ONNX file {path}")
    if not beside.is_file():
        raise ValueError(f"{path} has no card: there is no {beside}")
    card: CardT = kind.load(beside)
    if card.file is None or card.observation is None:
        raise ValueError(f"{path} has the card of a {card.kind}, not of an onnx-policy")
    states = card.state if isinstance(card, DetectorCard) else ()
    model = OnnxModel(path, card.file, len(card.action.names), states, sha256)
    claim = Claim(
        path=model.path,
        file=card.file,
        observation=card.observation,
        action=card.action,
        state=states,
    )
    check_policy(model, claim)
    return card, model


class OnnxDetector(DetectorPolicy):
    """Decides as a network in an ONNX file does; the card of the same name is in the same folder.

    Parameters
    ----------
    file : str or path-like
        Path of the ONNX file, or the name of a shipped detector.
    sha256 : str, optional
        Digest that the file must have; by default the card's.

    Attributes
    ----------
    card : DetectorCard
        What it fits, and its threshold.
    """

    def __init__(self, file: str | os.PathLike[str], sha256: str | None = None) -> None:
        self.file = os.fspath(file)
        self.card, self.model = load_policy(file, DetectorCard, sha256)

    def bind(self, context: PolicyContext) -> None:
        super().bind(context)
        found = diff_spaces(self.card.observation, self.card.action, context)
        interval_s = self.card.interval_s
        if interval_s is not None and interval_s != context.interval_s:
            found.append(f"interval_s: {interval_s:g} on the card, {context.interval_s:g} here")
        if found:
            raise ValueError(
                f"the detector {self.card.name!r} ({self.file}) does not fit here: "
                f"{'; '.join(found)}"
            )
        for state in self.card.state:
            zeros = np.zeros((context.receivers, state.size), dtype=np.float32)
            self.memory.declare(state.name, zeros)

    def decide(self, observation: NDArray[np.float32]) -> FloatArray:
        """Decide on one epoch.  `observation` (B, o); returns (B, a) in [-1, 1]."""
        names = [each.name for each in self.card.state]
        action, after = self.model.step(observation, [self.memory[name] for name in names])
        for name, array in zip(names, after, strict=True):
            self.memory[name] = array
        return action

    def digest(self) -> str:
        return self.card.file.sha256[:16]
