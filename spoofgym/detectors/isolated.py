"""A detector in a process of its own, which gets epochs and gives verdicts.

Truth, reward, seeds and the parent's objects never reach that process.  The parent takes nothing
from it but numbers of known shapes, texts, and bytes that only such processes read again.
"""

from __future__ import annotations

import dataclasses
import json
import os
import pickle
import socket
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Mapping
from contextlib import suppress
from mmap import mmap
from typing import Any, ClassVar

import cloudpickle
import numpy as np
from numpy.typing import NDArray

from ..core.children import (
    WATCH_S,
    Channel,
    child_environment,
    count_family,
    end_family,
    open_shared_file,
)
from ..core.declared import setting, settings_record
from ..core.memory import Memory
from ..core.registry import require
from ..receiver.epoch import Epoch
from .base import BoolArray, Detector, DetectorContext, FloatArray, Verdict
from .build import split_spec
from .calibrated import Calibrated, name_kind
from .pool import PooledDetector

PROGRAM = "spoofgym.detectors.isolated_child"
ISOLATED = "spoofgym.detectors.isolated:Isolated"
"""Name of the class in specs."""
WORDS = ("paper", "scope", "measures", "label")
LONGEST_WORDS = 2000
"""Characters of what a process says of a failure."""
MOST_PRINTED = 1 << 14
"""Bytes of what a process and its forks print that are shown."""
PROCESSES = 256
"""That a detector may have at a time, beside one for each batch."""
FLAGS = (
    *("oracle", "drifts", "calibrates", "draws", "alarm_is_state"),
    *("has_nominal", "from_start", "needs_model"),
)
"""Attributes of a detector that are texts, and those that are True or False."""


class IsolationError(RuntimeError):
    """A detector in a process of its own raised, judged badly, took too long, ended, or has
    started too many others.

    Parameters
    ----------
    message : str
        Epoch, receiver, detector, and what it did.
    reason : {"raises", "hangs", "ends", "forks"}
        What it did, in a word.
    time_s : float, optional
        Epoch at which it did; None before the first one.
    receiver : int, optional
        Row of the batch that made it fail; None where any may have.
    """

    def __init__(
        self, message: str, reason: str, time_s: float | None = None, receiver: int | None = None
    ) -> None:
        super().__init__(message, reason, time_s, receiver)
        self.reason, self.time_s, self.receiver = reason, time_s, receiver

    def __str__(self) -> str:
        return str(self.args[0])


class _Host:
    """Process that has loaded a detector; a copy of it is forked for every batch."""

    running: ClassVar[weakref.WeakValueDictionary[tuple[int, bytes], _Host]] = (
        weakref.WeakValueDictionary()
    )
    starting: ClassVar[threading.RLock] = threading.RLock()

    def __init__(self, content: bytes, limit_s: float, name: str) -> None:
        own, other = socket.socketpair()
        self.process = subprocess.Popen(
            [sys.executable, "-m", PROGRAM, str(other.fileno())],
            env=child_environment(),
            stdin=subprocess.DEVNULL,
            bufsize=0,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            pass_fds=[other.fileno()],
            start_new_session=True,
        )
        other.close()
        self.channel = Channel(own)
        printed = threading.Thread(target=_show, args=(self.process.stdout, name), daemon=True)
        printed.start()
        self.end = weakref.finalize(self, _end_host, self.process, own, os.getpid(), printed)
        self.batches: weakref.WeakSet[Channel] = weakref.WeakSet()
        self._seen = 0.0
        try:
            self.traits = _ask(self.channel, content, limit_s, f"{name}, when loaded,", self)
        except BaseException:
            self.end()
            raise

    @classmethod
    def find(cls, content: bytes, limit_s: float, name: str) -> _Host:
        """The process of a detector, started if it is not running."""
        key = os.getpid(), content
        with cls.starting:
            found = cls.running.get(key)
            if found is None or not found.end.alive:
                found = cls.running[key] = cls(content, limit_s, name)
        return found

    def fork(self, memory: int) -> Channel:
        own, other = socket.socketpair()
        with other, self.starting:
            socket.send_fds(self.channel.socket, [b"f"], [other.fileno(), memory])
        channel = Channel(own)
        self.batches.add(channel)
        return channel

    def watch(self) -> None:
        """Refuse what has started too many processes, now and then."""
        if time.monotonic() < self._seen + WATCH_S:
            return
        most = PROCESSES + len(self.batches)
        if count_family(self.process.pid, most) > most:
            raise ChildProcessError(f"has more than {PROCESSES} processes")
        self._seen = time.monotonic()


def _show(pipe: Any, name: str) -> None:
    """Show what a process prints, which is no result of a command; the rest is read, and lost."""
    left, cut = MOST_PRINTED, f"\n{name} has printed {MOST_PRINTED} bytes: no more is shown\n"
    with pipe:
        while part := pipe.read(1 << 16):
            if left >= 0:
                with suppress(OSError):  # our standard error may be closed
                    os.write(2, part[:left] + cut.encode() * (left < len(part)))
                left -= len(part)


def _end_host(
    process: subprocess.Popen[bytes], channel: socket.socket, parent: int, printed: threading.Thread
) -> None:
    channel.close()
    if os.getpid() == parent:  # and not in a fork of it
        end_family(process.pid)
        process.wait()
        printed.join(1.0)


def _ask(
    channel: Channel,
    content: bytes,
    limit_s: float,
    name: str,
    host: _Host,
    epoch: Epoch | None = None,
    raw: bool = False,
) -> Any:
    """Answer to a message: JSON, or `raw` bytes. `name`: subject of what is said of a failure."""
    time_s = None if epoch is None else float(epoch.time[0])
    receivers = "" if epoch is None else f" of {len(epoch.time)} receivers: "
    at = "" if epoch is None else f"epoch at {time_s:g} s"
    try:
        channel.send(content, limit_s)
        answer = channel.receive(limit_s, host.watch)
        host.watch()
    except TimeoutError:
        message = f"{at}{receivers}{name} took longer than {limit_s:g} s"
        raise IsolationError(message, "hangs", time_s) from None
    except ChildProcessError as many:
        raise IsolationError(f"{at}{receivers}{name} {many}", "forks", time_s) from None
    except (EOFError, OSError):
        message = f"{at}{receivers}{name} ended its process"
        raise IsolationError(message, "ends", time_s) from None
    row = None
    try:
        if answer[:1] == b"=":
            return answer[1:] if raw else json.loads(answer[1:])
        failure = json.loads(answer[1:])
        words = "".join(x if x.isprintable() else " " for x in failure["error"][:LONGEST_WORDS])
        error, row = f"raises {words}", failure.get("receiver")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        error = "gives no valid answer"
    row = row if type(row) is int else None
    one = "" if row is None else f", receiver {row}"
    raise IsolationError(f"{at}{one}{receivers}{name} {error}", "raises", time_s, row)


class _Bound:
    """A detector of one batch in another process; it goes on there when it is copied or pickled.

    - `content`: pickled detector, or spec; `start`: what the process does first, and with what.
    """

    def __init__(self, content: bytes, name: str, limits: tuple[float, float], start: Any) -> None:
        self._content, self._name, self._limits, self._start = content, name, limits, start
        self.failure: IsolationError | None = None
        self._lock = threading.RLock()
        self._open()

    def _open(self) -> None:
        self._parent, self._judged = os.getpid(), False
        self._shapes: dict[str, tuple[str, tuple[int, ...]]] = {}
        self._host = _Host.find(self._content, self._limits[1], self._name)
        self._file = open_shared_file()
        self.channel = self._host.fork(self._file.fileno())
        self.end = weakref.finalize(self, _close_all, self.channel.socket, self._file)
        self.sizes = self.request(*self._start)

    def __getstate__(self) -> dict[str, Any]:
        names = "_content", "_name", "_limits", "failure"
        with self._lock:
            start = self._start if self.failure else ("restore", self.request("save", raw=True))
            return {**{name: getattr(self, name) for name in names}, "_start": start}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._lock = threading.RLock()
        if self.failure is None:
            self._open()

    def request(self, work: str, *given: Any, epoch: Epoch | None = None, raw: bool = False) -> Any:
        """What a method of `isolated_child.Server` returns. `raw`: bytes."""
        with self._lock:  # searches copy one detector in several threads
            return self._request(work, given, epoch, raw)

    def _request(self, work: str, given: tuple[Any, ...], epoch: Epoch | None, raw: bool) -> Any:
        if self.failure is not None:
            raise self.failure
        if self._parent != os.getpid():
            raise RuntimeError(
                f"{self._name} was bound before this process was forked: make a new one here"
            )
        limit_s, content = self._limits[not self._judged], pickle.dumps((work, *given))
        self.failure = IsolationError(f"{self._name} was stopped", "hangs")  # as by Ctrl-C
        try:
            answer = _ask(self.channel, content, limit_s, self._name, self._host, epoch, raw)
            self._judged, self.failure = self._judged or work == "judge", None
        except IsolationError as error:
            self.failure = error
            raise
        finally:
            if self.failure is not None:
                self.end()
                if self.failure.reason in ("hangs", "forks"):  # nothing else ends what goes on
                    self._host.end()
        return answer

    def show(self, epoch: Epoch, needs: frozenset[str], columns: int) -> None:
        """Write an epoch to the memory that the other process shares."""
        fields = {
            name: array
            for name, array in epoch._asdict().items()
            if array is not None and (name in needs or name not in Epoch._field_defaults)
        }
        shapes = {name: (array.dtype.str, array.shape) for name, array in fields.items()}
        if shapes != self._shapes:
            self._share(shapes, epoch.innovation.shape, columns)
        for name, array in fields.items():
            self._arrays[name][...] = array

    def _share(
        self, shapes: dict[str, tuple[str, tuple[int, ...]]], sizes: tuple[int, ...], columns: int
    ) -> None:
        b, m = sizes
        answers: dict[str, tuple[str, tuple[int, ...]]]
        answers = {"statistic": ("f8", (b, columns)), "threshold": ("f8", (b, columns))}
        answers |= {"alarm": ("u1", (b, columns)), "weights": ("f8", (b, m))}
        answers |= {"of_receivers": ("f8", (b,))}
        kind = np.dtype([(name, *each) for name, each in {**shapes, **answers}.items()], align=True)
        handle = self._file.fileno()
        os.ftruncate(handle, max(kind.itemsize, os.fstat(handle).st_size))  # it may only grow
        record = np.ndarray((), kind, mmap(handle, kind.itemsize))
        self._arrays = {name: record[name] for name in kind.names or ()}
        self.request("share", kind)
        self._shapes = shapes

    def read(self, name: str) -> FloatArray:
        """A copy of an answer, which the other process can't change any more."""
        return np.array(self._arrays[name])


def _close_all(*things: Any) -> None:
    for each in things:
        each.close()


class RemoteMemory(Memory):
    """Memory of a detector in another process."""

    def __init__(self, bound: _Bound, receivers: int) -> None:
        super().__init__(receivers)
        self.bound = bound

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        self.bound.request("reset_memory", mask)

    def copy_rows(self, to: NDArray[np.intp], other: Any, rows: NDArray[np.intp]) -> None:
        content = other.bound.request("take_memory", raw=True)
        self.bound.request("put_memory", to, content, rows)


@settings_record
class Isolated(Detector):
    """A detector in a process of its own, with the verdicts that it has in this one.

    The process has the detector, sizes and noise of a `DetectorContext`, and one epoch at a time,
    in memory of its own: nothing that it writes there changes what others see.  Each bound batch
    has a fork of a process that has not seen any epoch.  A detector given as text is imported
    there alone.  What fails is an `IsolationError`, after which the process is ended, as it is
    when this object goes.  Forks need Linux or macOS.

    Examples
    --------
    >>> from spoofgym.detectors.isolated import Isolated
    >>> Isolated("snapshot-chi2", limit_s=1.0).needs == frozenset({"innovation_cov"})
    True
    """

    detector: Any = setting(
        help="Any but a pool and one with scaled thresholds, whose parts are isolated; or its spec."
    )
    limit_s: float = setting(
        default=20.0, above=0.0, unit="s", help="Longest time that a judgement of a batch may take."
    )
    start_limit_s: float = setting(
        default=120.0,
        above=0.0,
        unit="s",
        help="The same for the import and for all up to the first judgement, which may compile.",
    )
    alarm_scale: float = setting(
        default=1.0, above=0.0, help="Of a detector whose alarm is a state: see `Detector`."
    )

    paper: ClassVar[str] = ""
    label: ClassVar[str | None] = None

    def __post_init__(self) -> None:
        require(hasattr(os, "fork"), "detectors are isolated by forks, which this system has not")
        given = self.detector
        if not isinstance(given, str | Mapping | Detector) or isinstance(given, Calibrated):
            raise TypeError(
                f"`detector` must be a Detector that is not calibrated, or its spec, got {given!r}"
            )
        self._content = cloudpickle.dumps(given)
        spec = given if isinstance(given, Mapping) else {"name": given}
        name = name_kind(type(given)) if isinstance(given, Detector) else str(spec.get("name"))
        self._host = _Host.find(self._content, self.start_limit_s, name)
        self._traits = self._host.traits
        for name in (*WORDS, *FLAGS):
            setattr(self, name, (str if name in WORDS else bool)(self._traits[name]))
        self.needs = frozenset(map(str, self._traits["needs"]))  # type: ignore[misc]
        if self._traits["members"]:
            raise TypeError("a pool isolates its members: `isolate` does so")

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_host"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._host = _Host.find(self._content, self.start_limit_s, str(self.label))

    def identity(self) -> Any:
        """As `describe_identity` has it of the detector itself."""
        if isinstance(self._traits["identity"], str):
            raise TypeError(self._traits["identity"])
        return self._traits["identity"]

    def list_sources(self) -> dict[str, str | None]:
        """As `outside_sources` has them of the detector; None by name where none is readable."""
        found: dict[str, str | None] = self.identity().get("sources", {})
        return found or {str(self.identity()["name"]): None}

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        limits = self.limit_s, self.start_limit_s
        start = "bind", context, self.alarm_scale
        self._bound = _Bound(self._content, str(self.label), limits, start)
        self.memory = RemoteMemory(self._bound, context.receivers)
        self.silent_epochs = int(self._bound.sizes["silent_epochs"])
        self.memory_epochs = int(self._bound.sizes["memory_epochs"])

    def reset(self, mask: BoolArray | None = None) -> None:
        self._bound.request("reset", mask)

    def judge(self, epoch: Epoch) -> Verdict:
        weighs = self._request("judge", epoch, self.judged_rows)
        read = self._bound.read
        return Verdict(
            read("statistic"),
            read("threshold"),
            read("alarm") != 0,
            read("weights") if weighs else None,
        )

    def watch(self, epoch: Epoch) -> None:
        self._request("watch", epoch)

    def is_armed(self, epoch: Epoch) -> BoolArray | None:
        has = self._traits["arms"] and self._request("is_armed", epoch)
        return self._bound.read("of_receivers") != 0.0 if has else None

    def protection_level(self, epoch: Epoch, scale: float = 1.0) -> FloatArray | None:
        has = self._traits["protects"] and self._request("protection_level", epoch, scale)
        return self._bound.read("of_receivers") if has else None

    def _request(self, work: str, epoch: Epoch, *given: Any) -> Any:
        m, n = epoch.innovation.shape[1], epoch.visible.shape[1]
        self._bound.show(epoch, self.needs, (n or m) if self.scope == "channel" else 1)
        return self._bound.request(work, *given, epoch=epoch)


def is_foreign(detector: str | Mapping[str, Any] | Detector) -> bool:
    """Whether a detector, or a part of it, is of a class that is not the package's own.

    `spoofgym audit` calls it on what it was given, before anything is imported, and plays what is
    foreign as `isolate` returns it: a spec goes through stores and workers like any other, an
    object as the `thing` of a `PlayerSpec`.  An ``.onnx`` file is not foreign: it holds no code.
    """
    if isinstance(detector, str | Mapping):
        name = detector if isinstance(detector, str) else str(detector.get("name", ""))
        members = () if isinstance(detector, str) else detector.get("members", ())
        own = ":" not in name or name.startswith("spoofgym.")
        return not own or any(map(is_foreign, members))
    parts = detector.judges or ([detector.detector] if isinstance(detector, Calibrated) else [])
    kind = type(detector)
    module = sys.modules.get(kind.__module__) if kind.__module__.startswith("spoofgym.") else None
    return getattr(module, kind.__qualname__, None) is not kind or any(map(is_foreign, parts))


def isolate(detector: Any, **limits: float) -> Any:
    """A detector, or its spec, whose foreign parts are `Isolated` with some `limits`; as it is
    where nothing is foreign. Thresholds stay outside."""
    if not is_foreign(detector):
        return detector
    if isinstance(detector, str | Mapping):
        spec = {"name": detector} if isinstance(detector, str) else dict(detector)
        if ":" not in spec["name"]:
            return {**spec, "members": [isolate(each, **limits) for each in spec["members"]]}
        plain, request = split_spec(spec)
        return {"name": ISOLATED, "detector": plain, **limits, **request}
    if isinstance(detector, PooledDetector):
        members = [isolate(each, **limits) for each in detector.judges]
        return PooledDetector(members, detector.weights)
    if isinstance(detector, Calibrated):
        return dataclasses.replace(detector, detector=isolate(detector.detector, **limits))
    return Isolated(detector, **limits)
