"""A learned spoofer: a policy in an ONNX file, run by onnxruntime, and a card that describes it.

Nothing is unpickled, nothing outside of the file is read, and the same observation gives the same
action, bit for bit, in any batch.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .base import FloatArray, Spoofer, SpooferContext
from .card import Card
from .onnx_file import check_signature, opset_of, read_model
from .zoo import ZOO_FOLDER, shipped

SUFFIX = ".onnx"


@dataclass
class OnnxPolicy(Spoofer):
    """Does what a network in an ONNX file says; the card of the same name lies beside it.

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
    knowledge, label, designed_on : str
        Of the card.
    """

    file: str
    sha256: str | None = None

    knowledge = "of its card"

    def __post_init__(self) -> None:
        """Check file and card; the network is not run yet."""
        self.file = os.fspath(self.file)
        path = path_of(self.file)
        if not path.is_file():
            raise ValueError(f"there is no ONNX file {path}")
        if not path.with_suffix(".json").is_file():
            raise ValueError(f"{path} has no card: there is no {path.with_suffix('.json')}")
        self.card = Card.load(path.with_suffix(".json"))
        self._content = _read(path, self.card, self.sha256)
        self._session: Any = None
        self._process = 0
        self.sha256 = hashlib.sha256(self._content).hexdigest()
        self.knowledge = self.card.knowledge.run_time
        self.designed_on = self.card.knowledge.design_time
        self.label = self.card.name

    def bind(self, context: SpooferContext) -> None:
        """Prepare for a batch of receivers."""
        found = self.card.differences(context)
        if found:
            raise ValueError(f"{self.file} does not fit this attack: {'; '.join(found)}")
        super().bind(context)

    def act(self, observation: NDArray[np.float32]) -> FloatArray:
        """Command the attack for the coming epoch.

        `observation` (B, o) of all receivers; returns (B, a) in [-1, 1], C-contiguous.
        """
        given = np.ascontiguousarray(observation, dtype=np.float32)
        try:
            action = np.asarray(self._running().run(None, {self._input: given})[0])
        except _failures() as error:
            raise ValueError(f"{self.file} can't be run: {error}") from error
        shape = (self.context.receivers, len(self.context.action_names))
        if action.shape != shape:
            raise ValueError(f"{self.file} returned actions of shape {action.shape}, not {shape}")
        if np.isnan(action).any():
            raise ValueError(
                f"{self.file} returned NaN for receiver {np.argwhere(np.isnan(action))[0][0]}"
            )
        return np.clip(action.astype(np.float64, order="C"), -1.0, 1.0)

    def _running(self) -> Any:
        """Session of this process, made when it is needed."""
        if self._session is None or self._process != os.getpid():
            self._session = make_session(self._content)
            self._input = self._session.get_inputs()[0].name
            self._process = os.getpid()
        return self._session

    def __getstate__(self) -> dict[str, Any]:
        """All but the session, which neither pickles nor copies."""
        return {**self.__dict__, "_session": None}


def path_of(file: str) -> Path:
    """Path of a policy."""
    if file.endswith(SUFFIX):
        return Path(file)
    if file not in shipped():
        raise ValueError(
            f"`file` must be the path of an {SUFFIX} file or the name of a shipped spoofer "
            f"({', '.join(shipped()) or 'there is none'}), got {file!r}"
        )
    return ZOO_FOLDER / f"{file}{SUFFIX}"


def _read(path: Path, card: Card, sha256: str | None) -> bytes:
    """Content of a file that fits its card."""
    if card.file is None or card.observation is None:
        raise ValueError(f"{path} has the card of a {card.kind}, not of an onnx-policy")
    size = path.stat().st_size
    if size != card.file.bytes:
        raise ValueError(f"{path} has {size} bytes, and {card.file.bytes} on its card")
    content = path.read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    for word, wanted in (("its card says", card.file.sha256), ("`sha256` must be", sha256)):
        if wanted is not None and digest != wanted:
            raise ValueError(f"{path} has the SHA-256 {digest}; {word} {wanted}")
    model = read_model(content, str(path))
    if opset_of(model) != card.file.opset:
        raise ValueError(f"{path} is of opset {opset_of(model)}, and {card.file.opset} on its card")
    check_signature(model, len(card.observation.names), len(card.action.names), str(path))
    return content


def make_session(content: bytes) -> Any:
    """Session of onnxruntime on one thread of the processor."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    options.log_severity_level = 4  # errors are raised, and need not be printed as well
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


def _failures() -> tuple[type[Exception], ...]:
    """What onnxruntime raises: classes of its own, that share only `Exception`."""
    from onnxruntime.capi import onnxruntime_pybind11_state as state

    kinds = (getattr(state, name) for name in dir(state))
    return tuple(k for k in kinds if isinstance(k, type) and issubclass(k, Exception))
