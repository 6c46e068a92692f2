"""Processes: memory of this one; those for code and files of others, their limits, messages."""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
LONGEST = 1 << 31
"""Bytes of a message."""


def child_environment() -> dict[str, str]:
    """Environment variables with which Python finds the same modules, and has one thread."""
    paths = os.pathsep.join(filter(None, sys.path))
    return {**os.environ, **ONE_THREAD, "PYTHONPATH": paths}


def release_free_memory() -> None:
    """Give back to the system what large arrays have left free, where the C library can."""
    with suppress(AttributeError, OSError, TypeError):  # of another system
        ctypes.CDLL(None).malloc_trim(0)


def limit_resources(memory: int, cpu_s: int | None = None) -> None:
    """Limit this process: bytes of memory, time of the processor, and no core file."""
    with suppress(ImportError, ValueError, OSError):  # a system without such limits
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if cpu_s is not None:
            resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


def confine_process() -> bool:
    """Give up access to the memory of other processes, and signals to them, where the kernel has
    landlock; False where it has not. Files and the network stay as they are."""
    if sys.platform != "linux":
        return False
    libc = ctypes.CDLL(None, use_errno=True)
    version = libc.syscall(444, None, 0, 1)  # landlock_create_ruleset
    if version < 1:
        return False
    no_device_files = 1 << 11  # a ruleset must forbid some access to files
    rules = struct.pack("QQQ", no_device_files, 0, 3 if version >= 6 else 0)
    ruleset = libc.syscall(444, rules, 24 if version >= 6 else 8, 0)
    libc.prctl(38, 1, 0, 0, 0)  # PR_SET_NO_NEW_PRIVS
    confined = ruleset >= 0 and libc.syscall(446, ruleset, 0) == 0  # landlock_restrict_self
    if ruleset >= 0:
        os.close(ruleset)
    return bool(confined)


def open_shared_file() -> IO[Any]:
    """Empty file to map in several processes, which none of them can make shorter, where the
    system seals files: else one that does ends the others."""
    if sys.platform != "linux":
        return tempfile.TemporaryFile()
    import fcntl

    handle = os.memfd_create("epochs", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    fcntl.fcntl(handle, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_SEAL)
    return os.fdopen(handle, "r+b")


def end_with_parent() -> None:
    """Let the kernel end this process when that which forked it ends, where it can."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, 9, 0, 0, 0)  # PR_SET_PDEATHSIG, SIGKILL


def adopt_orphans() -> None:
    """Let the kernel give this process the children of its descendants that end, where it can."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)  # PR_SET_CHILD_SUBREAPER


def list_children(process: int) -> list[int]:
    """Numbers of the processes that one has started or adopted; none where no /proc says them, or
    once it has ended."""
    found: list[int] = []
    with suppress(OSError):  # it may end, or a thread of it, while it is looked at
        for task in os.listdir(f"/proc/{process}/task"):
            with suppress(OSError):
                found += map(int, Path(f"/proc/{process}/task/{task}/children").read_text().split())
    return found


def count_family(process: int, most: int) -> int:
    """Number of processes below one, counted up to some more than `most`."""
    found = [process]
    for each in found:  # which grows meanwhile
        found += list_children(each) if len(found) <= most + 1 else []
    return len(found) - 1


def end_family(process: int) -> None:
    """Kill what a group's leader has started or adopted, wait until it is gone, then kill the
    group: children that outlived their parent would stay as zombies where no init reaps them."""
    with suppress(ProcessLookupError):
        os.kill(process, signal.SIGSTOP)  # it starts no more
        end = time.monotonic() + ENDING_S
        while (children := list_children(process)) and time.monotonic() < end:
            for child in children:  # the children of one that is killed are `process`'s own now
                with suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
            time.sleep(0.001)
        os.killpg(process, signal.SIGKILL)


ENDING_S = 5.0
"""How long processes that go on forking, or that a busy machine ends slowly, are followed."""
WATCH_S = 0.2
"""How often a process that others wait for is looked at."""


class Channel:
    """Messages of bytes over a socket. `receive`: a TimeoutError after `limit_s`, an EOFError once
    the other side has ended, `watch` is called while it waits; the reader of a message must not
    trust it."""

    def __init__(self, own: socket.socket) -> None:
        self.socket = own

    def send(self, content: bytes, limit_s: float | None = None) -> None:
        self.socket.settimeout(limit_s)
        self.socket.sendall(struct.pack("I", len(content)) + content)

    def receive(
        self, limit_s: float | None = None, watch: Callable[[], None] = lambda: None
    ) -> bytes:
        end = None if limit_s is None else time.monotonic() + limit_s
        (size,) = struct.unpack("I", self._read(4, end, watch))
        if size > LONGEST:
            raise EOFError(f"a message of {size} bytes")
        return self._read(size, end, watch)

    def _read(self, size: int, end: float | None, watch: Callable[[], None]) -> bytes:
        parts = bytearray()
        while len(parts) < size:
            left = None if end is None else end - time.monotonic()
            if left is not None and left <= 0.0:
                raise TimeoutError
            self.socket.settimeout(None if left is None else min(left, WATCH_S))
            try:
                part = self.socket.recv(min(size - len(parts), 1 << 20))
            except TimeoutError:
                watch()
                continue
            if not part:
                raise EOFError("the other side has ended")
            parts += part
        return bytes(parts)
