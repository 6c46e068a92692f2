"""The card of a learned detector, and the policy in its ONNX file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ..policies.card import PolicyCard, PolicyFile, Space, State, unlike_spaces
from ..policies.contract import DetectorPolicy, PolicyContext
from ..policies.onnx_file import SUFFIX
from ..policies.onnx_model import OnnxModel
from .base import FloatArray
from .observation import make_detector_terms
from .zoo import path_of


class DetectorCard(PolicyCard):
    """The card of a learned detector, on disk a JSON file with its ONNX file.

    Attributes
    ----------
    format : int
        Of the card: 1.
    name : str
        Of the detector.
    kind : str
        ``"detector-policy"``.
    observation, action : Space
        What it observes and decides.
    statistic : {"receiver", "channel"}
        One statistic, or one for every slot.
    weighs : bool
        Whether it weighs satellites.
    exclusion_s : float or None
        Allowance of exclusion in an episode.
    decision_delay : {0, 1}
        Whether it judges an epoch by a decision on itself, or by one on the epoch before.
    terms : tuple of dict or None
        What it observes, as `make_detector_terms` takes it; None for those of the duel.
    state : tuple of State
        What a recurrent network hands on from one epoch to the next; empty for a plain one.
    quiet_epochs : int or None
        Epochs after it is switched on in which it does not decide, as in the monitored warm-up of
        the duel that it was made in.  None on older cards: the warm-up of a duel in its pools, 0
        elsewhere.
    channels : int or None
        Slots of the receiver that it was made for; None on older cards.
    interval_s : float or None
        Time between epochs that it was made for [s]; None on older cards, for any.
    threshold : float or None
        Calibrated; None where that has not been done.
    calibration : dict
        How: interval, runs, false-alarm rate; empty without one.
    training : dict
        How it was made.
    file : PolicyFile
        The policy.
    """

    other_kinds: ClassVar = dict.fromkeys(
        ("onnx-policy", "profile"),
        "a spoofer, which is no detector policy: it belongs into the pool of a DetectorView",
    )

    format: Literal[1] = 1
    name: str = Field(min_length=1)
    kind: Literal["detector-policy"] = "detector-policy"
    observation: Space
    action: Space
    statistic: Literal["receiver", "channel"]
    weighs: bool
    exclusion_s: float | None = Field(default=None, ge=0.0)
    decision_delay: Literal[0, 1]
    terms: tuple[dict[str, Any], ...] | None = Field(default=None, min_length=1)
    state: tuple[State, ...] = ()
    quiet_epochs: int | None = Field(default=None, ge=0)
    channels: int | None = Field(default=None, ge=1)
    interval_s: float | None = Field(default=None, gt=0.0)
    threshold: float | None = Field(default=None, gt=0.0, le=1.0)
    calibration: dict[str, Any] = Field(default_factory=dict)
    training: dict[str, Any] = Field(default_factory=dict)
    file: PolicyFile

    @model_validator(mode="after")
    def _check(self) -> Self:
        names = [each.name for each in self.state]
        if len(set(names)) < len(names):
            raise ValueError(f"names of `state` must differ, got {', '.join(names)}")
        if self.terms is not None:
            make_detector_terms(self.terms)
        return self


def card_path(file: str | os.PathLike[str]) -> Path:
    """Where the card of an ONNX file lies."""
    path = Path(file)
    if path.suffix != SUFFIX:
        raise ValueError(f"`file` must be the path of an {SUFFIX} file, got {os.fspath(file)!r}")
    return path.with_suffix(".json")


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
        path = path_of(file)
        card_file = card_path(path)
        if not path.is_file():
            raise ValueError(f"there is no ONNX file {self.file}")
        self.card = card = DetectorCard.load(card_file)
        self.model = OnnxModel(path, card.file, card.observation, card.action, sha256, card.state)

    def bind(self, context: PolicyContext) -> None:
        super().bind(context)
        found = unlike_spaces(self.card.observation, self.card.action, context)
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
