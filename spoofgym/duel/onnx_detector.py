"""A learned detector: a policy in an ONNX file, run by onnxruntime, with a card beside it."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from .._files import write_file
from ..spoofers import SPOOFERS, SUFFIX
from ..spoofers.card_parts import PolicyFile, Record, Space, kind_of, told
from ..spoofers.onnx_file import check_signature, opset_of, read_model
from ..spoofers.onnx_policy import make_session
from .calibration import Calibration
from .policy import DetectorPolicy, FloatArray, PolicyContext, checked_decision


class DetectorCard(Record):
    """The card of a detector policy, on disk a JSON file beside its ONNX file.

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
    model = read_model(content, str(file))
    duel = view.unwrapped.core.duel
    agent, size = duel.agent, len(duel.agent.action_names)
    check_signature(model, len(agent.sight.names), size, str(file))
    told = {} if calibration is None else {**vars(calibration)}
    card = DetectorCard(
        name=name,
        observation=Space(
            names=agent.sight.names,
            low=tuple(agent.sight.low.tolist()),
            high=tuple(agent.sight.high.tolist()),
        ),
        action=Space(names=agent.action_names, low=(-1.0,) * size, high=(1.0,) * size),
        statistic=agent.statistic,
        weighs=agent.weighs,
        exclusion_s=agent.exclusion_s,
        decision_delay=duel.decision_delay,
        threshold=None if calibration is None else calibration.threshold,
        calibration=told,
        training=training or {},
        file=PolicyFile(
            name=Path(file).name,
            sha256=hashlib.sha256(content).hexdigest(),
            bytes=len(content),
            opset=opset_of(model),
        ),
    )
    write_file(path, (json.dumps(card.model_dump(), indent=1, allow_nan=False) + "\n").encode())
    return card


class OnnxDetector(DetectorPolicy):
    """Decides what a network in an ONNX file says; the card of the same name lies beside it.

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
        try:
            self._content = Path(file).read_bytes()
            text = path.read_text(encoding="utf-8")
        except OSError as error:
            raise ValueError(f"{self.file}: there is no {error.filename}") from error
        try:
            self.card = DetectorCard.model_validate_json(text)
        except ValidationError as error:
            kind = kind_of(text)
            if kind in SPOOFERS:
                raise ValueError(
                    f"{path} is the card of a spoofer ({kind}), which is no detector policy: it "
                    "belongs into the pool of a DetectorView"
                ) from error
            raise ValueError(f"{path} is no card of a detector policy: {told(error)}") from error
        digest = hashlib.sha256(self._content).hexdigest()
        if digest != self.card.file.sha256:
            raise ValueError(f"{self.file} is not the file of its card: its digest is {digest}")
        model = read_model(self._content, self.file)
        sizes = len(self.card.observation.names), len(self.card.action.names)
        check_signature(model, *sizes, self.file)
        self._session: Any = None
        self._process = 0

    def bind(self, context: PolicyContext) -> None:
        """Prepare for a batch of receivers."""
        super().bind(context)
        here = Space(
            names=context.observation_names,
            low=context.observation_low,
            high=context.observation_high,
        )
        for word, card, names in (
            ("observation", self.card.observation, context.observation_names),
            ("action", self.card.action, context.action_names),
        ):
            if card.names != names:
                odd = [
                    name
                    for name in (*card.names, *names)
                    if (name in card.names) != (name in names)
                ]
                raise ValueError(
                    f"the detector {self.card.name!r} ({self.file}) does not fit this duel: its "
                    f"{word} has {len(card.names)} elements, and {len(names)} here; "
                    f"{', '.join(odd[:4]) or 'in another order'}"
                )
        if self.card.observation != here:
            raise ValueError(
                f"the detector {self.card.name!r} ({self.file}) does not fit this duel: the bounds "
                "of its observation differ"
            )

    def decide(self, observation: NDArray[np.float32]) -> FloatArray:
        """Decide on one epoch.  `observation` (B, o); returns (B, a) in [-1, 1]."""
        if self._session is None or self._process != os.getpid():
            self._session = make_session(self._content)
            self._input = self._session.get_inputs()[0].name
            self._process = os.getpid()
        given = np.ascontiguousarray(observation, dtype=np.float32)
        action = self._session.run(None, {self._input: given})[0]
        return checked_decision(action, self.context, self.file)

    def digest(self) -> str:
        """Digest of the file."""
        return self.card.file.sha256[:16]

    def __getstate__(self) -> dict[str, Any]:
        """All but the session, which neither pickles nor copies."""
        return {**self.__dict__, "_session": None}
