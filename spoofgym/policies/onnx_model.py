"""A network in an ONNX file, run by onnxruntime: self-contained, standard, of any batch.

The same observation gives the same action, bit for bit, in any batch.  A recurrent network has an
input and an output for each of its declared states; it keeps none itself.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .card import PolicyFile, Space, State
from .contract import FloatArray, NotFinite, checked_action
from .onnx_file import LARGEST_BYTES, NEXT, TRIED, check_signature, opset_of, read_model

PARTS = (1, 2, 3)
"""Sizes of smaller batches, in which the observations that it is tried on are asked again."""
TILED, ROLLED = 8, 128
"""How many times as many are one larger batch, and decisions in a row of a network with states."""
WIDEST = 10.0
"""Largest element of these observations."""
Float32Array = NDArray[np.float32]
_consistent: set[tuple[str, tuple[float, ...], tuple[float, ...]]] = set()
"""Digests of the files that have passed, in this process, with the bounds of their observations."""


class OnnxModel:
    """The network of one file; it pickles and copies, without the session of onnxruntime. `file`:
    what the card says of it; `observation`, `action`: spaces of the card; `sha256`: a digest that
    the file must have, besides the card's; `state`: what a recurrent network hands on."""

    def __init__(
        self,
        path: Path,
        file: PolicyFile,
        observation: Space,
        action: Space,
        sha256: str | None = None,
        state: Sequence[State] = (),
    ) -> None:
        self.path = os.fspath(path)
        size = path.stat().st_size
        if size > LARGEST_BYTES:
            raise ValueError(
                f"{path} has {size / (1 << 20):.1f} MiB; a policy may have "
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
        model = read_model(self.content, self.path)
        if opset_of(model) != file.opset:
            raise ValueError(f"{path} is of opset {opset_of(model)}, and {file.opset} on its card")
        self.size, self.state = len(action.names), tuple(state)
        self._given, self._returned = check_signature(
            model, len(observation.names), self.size, self.path, self.state
        )
        key = (self.sha256, observation.low, observation.high)
        if key not in _consistent:
            self._check_answers(observation)
            _consistent.add(key)

    def _check_answers(self, space: Space) -> None:
        """Raise unless the same observation has the same finite answer, again and in any batch."""
        low, high = (np.clip(side, -WIDEST, WIDEST) for side in (space.low, space.high))
        rng = np.random.default_rng(0)
        seen = rng.uniform(low, high, (TRIED, len(low))).astype(np.float32)
        seen[0] = np.clip(0.0, low, high)  # as at the start of an attack
        # half of the states are as at the start of an episode
        states = [np.zeros((TRIED, each.size), np.float32) for each in self.state]
        for each in states:
            each[::2] = rng.uniform(-1.0, 1.0, each[::2].shape)
        slices = [slice(k, k + n) for n in PARTS for k in range(0, TRIED - n + 1, n)]
        try:
            whole, again = self._tried(seen, states), self._tried(seen, states)
            parts = [self._tried(seen[k], [each[k] for each in states]) for k in slices]
            large = self._tried(
                np.tile(seen, (TILED, 1)), [np.tile(each, (TILED, 1)) for each in states]
            )
            apart = self._rolled(seen, states, 1) if self.state else whole
            rolled = self._rolled(seen, states, TRIED) if self.state else whole
        except NotFinite as error:
            raise ValueError(
                f"{self.path}, tried within the bounds on its card: {error}"
            ) from error
        if again.tobytes() != whole.tobytes():
            raise ValueError(f"{self.path} answers the same observation otherwise when asked again")
        pairs = [(part, whole[k]) for part, k in zip(parts, slices, strict=True)]
        pairs += [(large, np.tile(whole, (TILED, 1))), (apart, rolled[: len(apart)])]
        if any(mine.tobytes() != other.tobytes() for mine, other in pairs):
            raise ValueError(
                f"{self.path} answers the same observation otherwise in another batch: nothing may "
                "mix the rows of a batch, as a normalization over it does"
            )

    def _tried(self, seen: Float32Array, states: Sequence[Float32Array]) -> FloatArray:
        action, after = self.step(seen, states)
        return np.hstack([action, *after])

    def _rolled(self, seen: Float32Array, states: Sequence[Float32Array], rows: int) -> FloatArray:
        """Actions and states of some rows after many decisions, each on another observation."""
        now = [each[:rows] for each in states]
        for k in range(ROLLED):
            action, now = self.step(np.roll(seen, k, axis=0)[:rows], now)
        return np.hstack([action, *now])

    def act(self, observation: Float32Array) -> FloatArray:
        """Action (B, a) in [-1, 1] of a network without states."""
        return self.step(observation, ())[0]

    def step(
        self, observation: Float32Array, states: Sequence[Float32Array]
    ) -> tuple[FloatArray, list[Float32Array]]:
        """Action (B, a) in [-1, 1], and the states (B, s) of the next decision."""
        if self._session is None or self._process != os.getpid():  # or in a forked child
            self._session, self._process = make_session(self.content), os.getpid()
        given = {self._given: np.ascontiguousarray(observation, dtype=np.float32)}
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
        return checked_action(action, rows, self.size, self.path), after

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_session": None}


def make_session(content: bytes) -> Any:
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
