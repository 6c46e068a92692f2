"""Whether a network may be used: what its file holds, and a trial of it.

The same observation has to give the same finite action, bit for bit, in any batch.  A foreign file
is read and tried in a process of its own, with limits on time and memory, once for each digest.
What this process has exported, and what comes with the package, is tried here.
"""

from __future__ import annotations

import hashlib
import json
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

import numpy as np
import platformdirs

from ..core.children import child_environment, limit_resources
from ..core.files import write_file
from ..core.settings import compute_digest
from . import zoo
from .card import PolicyFile, Record, Space, State
from .contract import FloatArray, NotFinite
from .onnx_file import check_signature, get_opset, read_model
from .onnx_model import Float32Array, OnnxModel

VERSION = 2
"""Of what is checked; a file that passed another version is tried again."""
TRIED, PARTS = 16, (1, 2, 3)
"""Observations that a network is tried on, and sizes of smaller batches of the same."""
TILED, ROLLED = (8, 65, 1024), 128
"""How many times as many are a larger batch, and decisions in a row of a network with states."""
WIDEST = 10.0
"""Largest element of these observations."""
TIME_S, MEMORY, PATIENCE_S = 5, 1 << 30, 120.0
"""Time of the processor and memory of a trial, and how long another process may be waited for."""
_own: set[str] = set()
"""Digests of what this process has exported."""
_passed: set[str] = set()


class Claim(Record):
    """What a card says of a network."""

    path: str
    file: PolicyFile
    observation: Space
    action: Space
    state: tuple[State, ...] = ()

    @property
    def key(self) -> str:
        """Digest of all that the outcome of a trial depends on."""
        fields = self.model_dump(exclude={"path"})
        return compute_digest({**fields, "checks": VERSION, "onnxruntime": version("onnxruntime")})


def trust(content: bytes) -> None:
    """Note that this process has made a network."""
    _own.add(hashlib.sha256(content).hexdigest())


def check_policy(model: OnnxModel, claim: Claim) -> None:
    """Raise a ValueError unless a network may be used, and fits what its card says."""
    key = claim.key
    file = Path(platformdirs.user_cache_dir("spoofgym")) / "policies" / key
    if key in _passed or file.is_file():
        return
    if model.sha256 in _own or Path(model.path).parent == zoo.ZOO_FOLDER:
        examine(model, claim)
    else:
        _try_apart(claim)
        with suppress(OSError):  # it is tried again where nothing can be stored
            write_file(file, b"passed\n")
    _passed.add(key)


def examine(model: OnnxModel, claim: Claim) -> None:
    """Read a file and try its network, here."""
    read = read_model(model.content, model.path)
    if get_opset(read) != claim.file.opset:
        raise ValueError(
            f"{model.path} is of opset {get_opset(read)}, and {claim.file.opset} on its card"
        )
    sizes = len(claim.observation.names), len(claim.action.names)
    check_signature(read, *sizes, model.path, claim.state)
    check_answers(model, claim.observation)


def _try_apart(claim: Claim) -> None:
    """Read a file and try its network in another process."""
    try:
        done = subprocess.run(
            [sys.executable, "-m", "spoofgym.policies.trial"],
            input=claim.model_dump_json(),
            env=child_environment(),
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise ValueError(f"the trial of {claim.path} did not end in {PATIENCE_S:g} s") from error
    if done.returncode == -getattr(signal, "SIGXCPU", 0):
        raise ValueError(
            f"{claim.path} needs more than {TIME_S} s for {TRIED} observations and parts of them"
        )
    try:
        found = json.loads(done.stdout)["error"]
    except (ValueError, KeyError) as error:
        last = done.stderr.strip().splitlines()[-1:] or ["nothing on stderr"]
        raise ValueError(
            f"the trial of {claim.path} ended with {done.returncode} ({last[0]}): it may use "
            f"{MEMORY >> 30} GiB of memory and {TIME_S} s"
        ) from error
    if found is not None:
        raise ValueError(found)


def examine_claim() -> None:
    """Examine the network of a claim on stdin, within the limits; print what is wrong with it."""
    claim = Claim.model_validate_json(sys.stdin.read())
    limit_resources(MEMORY, TIME_S)
    error = None
    try:
        size = len(claim.action.names)
        examine(OnnxModel(Path(claim.path), claim.file, size, claim.state), claim)
    except (ValueError, MemoryError) as found:
        error = str(found)
        if isinstance(found, MemoryError) or "allocate memory" in error:
            error = f"{claim.path} needs more than {MEMORY >> 30} GiB of memory"
    print(json.dumps({"error": error}))


def check_answers(model: OnnxModel, space: Space) -> None:
    """Raise unless the same observation has the same finite answer, again and in any batch."""
    low, high = (np.clip(side, -WIDEST, WIDEST) for side in (space.low, space.high))
    rng = np.random.default_rng(0)
    seen = rng.uniform(low, high, (TRIED, len(low))).astype(np.float32)
    seen[0] = np.clip(0.0, low, high)  # as at the start of an attack
    # half of the states are as at the start of an episode
    states = [np.zeros((TRIED, each.size), np.float32) for each in model.state]
    for each in states:
        each[::2] = rng.uniform(-1.0, 1.0, each[::2].shape)
    slices = [slice(k, k + n) for n in PARTS for k in range(0, TRIED - n + 1, n)]
    try:
        whole, again = _step_batch(model, seen, states), _step_batch(model, seen, states)
        parts = [_step_batch(model, seen[k], [each[k] for each in states]) for k in slices]
        larger = [
            _step_batch(model, np.tile(seen, (n, 1)), [np.tile(each, (n, 1)) for each in states])
            for n in TILED
        ]
        apart = _roll_out(model, seen, states, 1) if model.state else whole
        rolled = _roll_out(model, seen, states, TRIED) if model.state else whole
    except NotFinite as error:
        raise ValueError(f"{model.path}, tried within the bounds on its card: {error}") from error
    if again.tobytes() != whole.tobytes():
        raise ValueError(f"{model.path} answers the same observation differently the second time")
    pairs = [(part, whole[k]) for part, k in zip(parts, slices, strict=True)]
    pairs += [(large, np.tile(whole, (n, 1))) for n, large in zip(TILED, larger, strict=True)]
    pairs += [(apart, rolled[: len(apart)])]
    if any(mine.tobytes() != other.tobytes() for mine, other in pairs):
        raise ValueError(
            f"{model.path} answers the same observation differently in another batch: nothing may "
            "mix the rows of a batch, as batch normalization does"
        )


def _step_batch(model: OnnxModel, seen: Float32Array, states: Sequence[Float32Array]) -> FloatArray:
    action, after = model.step(seen, states)
    return np.hstack([action, *after])


def _roll_out(
    model: OnnxModel, seen: Float32Array, states: Sequence[Float32Array], rows: int
) -> FloatArray:
    """Actions and states of some rows after many decisions, each on another observation."""
    now = [each[:rows] for each in states]
    for k in range(ROLLED):
        action, now = model.step(np.roll(seen, k, axis=0)[:rows], now)
    return np.hstack([action, *now])


if __name__ == "__main__":
    examine_claim()
