"""The other side of `isolated`: a process that has loaded a detector, and forks for each batch.

The one that loads never sees an epoch, so that a bound detector can't find in its process what
another one has seen, such as the same run without the attack.
"""

from __future__ import annotations

import copy
import dataclasses
import json
import mmap
import os
import pickle
import re
import signal
import socket
import sys
import traceback
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..core.children import (
    Channel,
    adopt_orphans,
    confine_process,
    end_with_parent,
    limit_resources,
)
from ..core.compile import share_notice
from ..core.memory import Memory
from ..core.registry import require
from ..receiver.epoch import Epoch
from .base import Detector, DetectorContext, Verdict, is_sound, judge_epoch
from .build import bare_detector
from .calibrated import describe_identity, name_kind
from .isolated import FLAGS, LONGEST_WORDS, WORDS

MEMORY = 8 << 30
"""Bytes that the process of a detector may have."""


def describe_traits(detector: Detector) -> dict[str, Any]:
    """What the parent has to know of a detector, as JSON."""
    kind = type(detector)
    try:
        identity: Any = describe_identity(detector)
    except TypeError as error:
        identity = str(error)
    return {
        **{name: getattr(detector, name) for name in (*WORDS, *FLAGS)},
        "label": detector.label or name_kind(kind).rpartition(":")[2],
        "needs": sorted(detector.needs),
        "members": len(detector.judges),
        "arms": kind.is_armed is not Detector.is_armed,
        "protects": kind.protection_level is not Detector.protection_level,
        "identity": identity,
    }


def locate_error(error: BaseException) -> str:
    """An error with its line of the detector's code."""
    frames = [
        each
        for each in traceback.extract_tb(error.__traceback__)
        if f"{os.sep}spoofgym{os.sep}" not in each.filename and each.filename[:1] != "<"
    ]
    line = f" ({os.path.basename(frames[-1].filename)}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {str(error)[: LONGEST_WORDS - 200]}{line}"


class Server:
    """A detector of one batch, and what the parent can have it do."""

    def __init__(self, channel: Channel, memory: int, detector: Detector) -> None:
        self.channel, self.memory, self.original = channel, memory, detector
        self.detector = detector
        self.context: DetectorContext | None = None

    def bind(self, context: DetectorContext, alarm_scale: float) -> Any:
        if alarm_scale != 1.0:
            self.original = dataclasses.replace(self.original, alarm_scale=alarm_scale)  # type: ignore[type-var]
        self.detector, self.context = copy.deepcopy(self.original), context
        self.detector.bind(context)
        require(hasattr(self.detector, "memory"), "`bind` must call `super().bind(context)`")
        return self.describe_bound()

    def restore(self, content: bytes) -> Any:
        self.original, self.detector, self.context = pickle.loads(content)
        return self.describe_bound()

    def describe_bound(self) -> Any:
        return {name: getattr(self.detector, name) for name in ("silent_epochs", "memory_epochs")}

    def save(self) -> bytes:
        return pickle.dumps((self.original, self.detector, self.context))

    def reset(self, mask: NDArray[np.bool_] | None) -> None:
        self.detector.reset(mask)

    def reset_memory(self, mask: NDArray[np.bool_] | None) -> None:
        self.detector.memory.reset(mask)

    def take_memory(self) -> bytes:
        return pickle.dumps(self.detector.memory)

    def put_memory(self, to: NDArray[np.intp], content: bytes, rows: NDArray[np.intp]) -> None:
        other: Memory = pickle.loads(content)
        self.detector.memory.copy_rows(to, other, rows)

    def share(self, kind: np.dtype[np.void]) -> None:
        """Take arrays that the parent writes to, fields of an epoch, and those that it reads."""
        record = np.ndarray((), kind, mmap.mmap(self.memory, kind.itemsize))
        arrays = {name: record[name] for name in kind.names or ()}
        self.answers = {name: arrays.pop(name) for name in ("of_receivers", *Verdict._fields)}
        for array in arrays.values():
            array.flags.writeable = False
        self.epoch = Epoch(**arrays)

    def judge(self, rows: NDArray[np.intp] | None) -> Any:
        verdict = judge_epoch(self.detector, self.epoch, rows)
        for name, part in verdict._asdict().items():
            if part is not None:
                self.answers[name][...] = part
        return verdict.weights is not None

    def watch(self) -> None:
        self.detector.watch(self.epoch)

    def is_armed(self) -> bool:
        return self._answer(self.detector.is_armed(self.epoch))

    def protection_level(self, scale: float) -> bool:
        return self._answer(self.detector.protection_level(self.epoch, scale))

    def _answer(self, found: NDArray[Any] | None) -> bool:
        if found is not None:
            self.answers["of_receivers"][...] = found
        return found is not None

    def serve(self) -> None:
        """Do what the parent wants, until it goes or something fails."""
        own, failed = os.getpid(), False
        while not failed:
            work, *given = pickle.loads(self.channel.receive())
            try:
                found = getattr(self, work)(*given)
                answer = found if isinstance(found, bytes) else json.dumps(found).encode()
            except BaseException as error:
                failed, answer = True, json.dumps(self.describe_failure(work, error)).encode()
            if os.getpid() != own:  # the detector has forked: the copy has no say
                os._exit(0)
            self.channel.send((b"!" if failed else b"=") + answer)

    def describe_failure(self, work: str, error: BaseException) -> dict[str, Any]:
        found = re.search(r"for receiver (\d+) of", str(error))
        row = int(found[1]) if found else None
        if work == "judge" and isinstance(error, Exception) and row is None:
            row = self.find_receiver(type(error))
        return {"error": locate_error(error), "receiver": row}

    def find_receiver(self, kind: type[Exception]) -> int | None:
        """The one receiver that makes the detector fail, as it is now; None without any."""
        rows = np.arange(len(self.epoch.time))
        while len(rows) > 1:
            failing = [each for each in np.array_split(rows, 2) if self._fails(each, kind)]
            if len(failing) != 1:
                return None
            (rows,) = failing
        return int(rows[0])

    def _fails(self, rows: NDArray[np.intp], kind: type[Exception]) -> bool:
        other, context = copy.deepcopy(self.original), self.context
        try:
            assert context is not None
            other.bind(context._replace(receivers=len(rows)))
            other.memory.copy_rows(np.arange(len(rows)), self.detector.memory, rows)
            fields = (None if each is None else each[rows] for each in self.epoch)
            judge_epoch(other, Epoch(*fields))  # type: ignore[arg-type]
        except Exception as error:
            return isinstance(error, kind)
        return False


def load_kernels() -> None:
    """Load the compiled check of verdicts, which each fork would load again."""
    one = np.ones((1, 1))
    is_sound(one, one, None)
    is_sound(one, one, one)


def serve_host(channel: Channel) -> None:
    """Load a detector, say what it is, and fork for every socket that the parent sends."""
    share_notice(lambda: False)  # the parent, which compiles more, says so
    try:
        given = pickle.loads(channel.receive())
        detector = given if isinstance(given, Detector) else bare_detector(given)
        answer = b"=" + json.dumps(describe_traits(detector)).encode()
    except BaseException as error:
        channel.send(b"!" + json.dumps({"error": locate_error(error)}).encode())
        return
    channel.send(answer)
    load_kernels()
    adopt_orphans()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the system forgets those that have ended
    while True:
        channel.socket.settimeout(None)
        request, handles, _, _ = socket.recv_fds(channel.socket, 1, 2)
        if not request:
            return
        if os.fork() == 0:
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            end_with_parent()
            channel.socket.close()
            _serve_batch(Channel(socket.socket(fileno=handles[0])), handles[1], detector)
        for handle in handles:
            os.close(handle)


def _serve_batch(channel: Channel, memory: int, detector: Detector) -> NoReturn:
    try:
        Server(channel, memory, detector).serve()
    except (EOFError, OSError):
        pass
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)


if __name__ == "__main__":
    confine_process()
    limit_resources(MEMORY)
    serve_host(Channel(socket.socket(fileno=int(sys.argv[1]))))
