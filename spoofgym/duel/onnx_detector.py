"""A learned detector: a policy of the duel in an ONNX file, and its card.

It observes what a `DetectorView` observes, and judges no `Epoch`, so that it belongs to the duel
and not to the detectors.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..policies.card import PolicyCard, PolicyFile, Space, unlike_spaces
from ..policies.contract import FloatArray
from ..policies.onnx_model import SUFFIX, OnnxModel, check_signature, file_of, read_model
from .calibration import Calibration
from .policy import DetectorPolicy, PolicyContext


class DetectorCard(PolicyCard):
    """The card of a detector policy, on disk a JSON file with its ONNX file.

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
        Of the game that it was made in.
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
    threshold: float | None = Field(default=None, gt=0.0, le=1.0)
    calibration: dict[str, Any] = Field(default_factory=dict)
    training: dict[str, Any] = Field(default_factory=dict)
    file: PolicyFile


def card_path(file: str | os.PathLike[str]) -> Path:
    """Where the card of an ONNX file lies."""
    path = Path(file)
    if path.suffix != SUFFIX:
        raise ValueError(f"`file` must be the path of an {SUFFIX} file, got {os.fspath(file)!r}")
    return path.with_suffix(".json")


def write_card(
    file: str | os.PathLike[str],
    view: Any,
    *,
    name: str,
    calibration: Calibration | None = None,
    training: dict[str, Any] | None = None,
) -> DetectorCard:
    """Write the card of a detector policy that was made in a view.

    Parameters
    ----------
    file : path-like
        The ONNX file, of one float32 input (batch, o) and one float32 output (batch, a).
    view : DetectorView or DetectorVectorView
        Where it was made; knows names, bounds and delay.
    name : str
        Of the detector.
    calibration : Calibration, optional
        Of this policy.
    training : dict, optional
        How it was made, JSON-able.

    Returns
    -------
    DetectorCard
        As it was written.
    """
    path, content = card_path(file), Path(file).read_bytes()
    duel = view.unwrapped.core.duel
    agent, size = duel.agent, len(duel.agent.action_names)
    check_signature(read_model(content, str(file)), len(agent.observer.names), size, str(file))
    card = DetectorCard(
        name=name,
        observation=Space(
            names=agent.observer.names,
            low=tuple(agent.observer.low.tolist()),
            high=tuple(agent.observer.high.tolist()),
        ),
        action=Space(names=agent.action_names, low=(-1.0,) * size, high=(1.0,) * size),
        statistic=agent.statistic,
        weighs=agent.weighs,
        exclusion_s=agent.exclusion_s,
        decision_delay=duel.decision_delay,
        threshold=None if calibration is None else calibration.threshold,
        calibration={} if calibration is None else {**vars(calibration)},
        training=training or {},
        file=file_of(Path(file).name, content),
    )
    card.save(path)
    return card


class OnnxDetector(DetectorPolicy):
    """Decides as a network in an ONNX file does; the card of the same name is in the same folder.

    Parameters
    ----------
    file : str or path-like
        Path of the ONNX file.

    Attributes
    ----------
    card : DetectorCard
        What it fits, and its threshold.

    Raises
    ------
    ValueError
        When file or card are missing, damaged, or don't fit each other.
    """

    def __init__(self, file: str | os.PathLike[str]) -> None:
        self.file = os.fspath(file)
        path = card_path(file)
        if not Path(file).is_file():
            raise ValueError(f"there is no ONNX file {self.file}")
        self.card = card = DetectorCard.load(path)
        self.model = OnnxModel(Path(file), card.file, card.observation, card.action)

    def bind(self, context: PolicyContext) -> None:
        """Prepare for a batch of receivers."""
        super().bind(context)
        found = unlike_spaces(self.card.observation, self.card.action, context)
        if found:
            raise ValueError(
                f"the detector {self.card.name!r} ({self.file}) does not fit this duel: "
                f"{'; '.join(found)}"
            )

    def decide(self, observation: NDArray[np.float32]) -> FloatArray:
        """Decide on one epoch.  `observation` (B, o); returns (B, a) in [-1, 1]."""
        return self.model.act(observation)

    def digest(self) -> str:
        """Digest of the file."""
        return self.card.file.sha256[:16]
