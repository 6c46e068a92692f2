"""A network in an ONNX file, run by onnxruntime.

A recurrent network has an input and an output for each of its declared states; it keeps none
itself.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .card import PolicyFile, State
from .contract import FloatArray, NotFinite, clip_action
from .onnx_file import LARGEST_BYTES, NEXT

Float32Array = NDArray[np.float32]


class OnnxModel:
    """The network of one file; it pickles and copies, without the session of onnxruntime. `file`:
    what the card says of it; `size`: elements of its action; `state`: what a recurrent network
    hands on; `sha256`: a digest that the file must have, besides the card's."""

    def __init__(
        self,
        path: Path,
        file: PolicyFile,
        size: int,
        state: Sequence[State] = (),
        sha256: str | None = None,
    ) -> None:
        self.path, self.size, self.state = os.fspath(path), size, tuple(state)
        length = path.stat().st_size
        if length > LARGEST_BYTES:
            raise ValueError(
                f"{path} has {length / (1 << 20):.1f} MiB; a policy may have "
                f"{LARGEST_BYTES >> 20} MiB"
            )
        self.content = path.read_bytes()
        self._session: Any = None
        self._process = 0
        if len(self.content) != file.bytes:
            raise ValueError(f"{path} has {len(self.content)} bytes, and {file.bytes} on its card")
        self.sha256 = hashlib.sha256(self.content).hexdigest()
        for word, wanted in (("its card has", file.sha256), ("`sha256` must be", sha256)):
            if wanted is not None and self.sha256 != wanted:
                raise ValueError(f"{path} has the SHA-256 {self.sha256}; {word} {wanted}")

    def act(self, observation: Float32Array) -> FloatArray:
        """Action (B, a) in [-1, 1] of a network without states."""
        return self.step(observation, ())[0]

    def step(
        self, observation: Float32Array, states: Sequence[Float32Array]
    ) -> tuple[FloatArray, list[Float32Array]]:
        """Action (B, a) in [-1, 1], and the states (B, s) of the next decision."""
        if self._session is None or self._process != os.getpid():  # or in a forked child
            self._open()
        given = {self._observation_input: np.ascontiguousarray(observation, dtype=np.float32)}
        for state, array in zip(self.state, states, strict=True):
            given[state.name] = np.ascontiguousarray(array, dtype=np.float32)
        wanted = [self._returned, *(f"{NEXT}{each.name}" for each in self.state)]
        try:
            action, *after = self._session.run(wanted, given)
        except _failures() as error:
            raise ValueError(f"{self.path} can't be run: {error}") from error
        rows = len(observation)
        for state, array in zip(self.state, after, strict=True):
            what = f"{self.path} returned the state {NEXT}{state.name}"
            if array.shape != (rows, state.size):
                raise ValueError(f"{what} of shape {array.shape}, not {(rows, state.size)}")
            finite = np.isfinite(array).all(axis=1)
            if not finite.all():
                row = int(np.argmin(finite))
                raise NotFinite(f"{what} with a value that is not finite for receiver {row}")
        return clip_action(action, rows, self.size, self.path), after

    def _open(self) -> None:
        """Start a session; the names of observation and action are those that are no state's."""
        try:
            session = make_session(self.content)
        except _failures() as error:
            raise ValueError(f"{self.path} can't be run: {error}") from error
        states = {each.name for each in self.state}
        states |= {f"{NEXT}{name}" for name in states}
        (self._observation_input,) = (x.name for x in session.get_inputs() if x.name not in states)
        (self._returned,) = (x.name for x in session.get_outputs() if x.name not in states)
        self._session, self._process = session, os.getpid()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_session": None}


def make_session(content: bytes) -> Any:
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # else it sends, and writes into the home
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    options.log_severity_level = 4  # errors are raised, and need not be printed as well
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


def _failures() -> tuple[type[Exception], ...]:
    """What onnxruntime raises: also classes of its own, that share only `Exception`."""
    from onnxruntime.capi import onnxruntime_pybind11_state as state

    kinds = (getattr(state, name) for name in dir(state))
    own = (k for k in kinds if isinstance(k, type) and issubclass(k, Exception))
    return (RuntimeError, ValueError, *own)
