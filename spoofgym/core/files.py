"""Files that are whole or absent, even with other writers: the one way to write them."""

from __future__ import annotations

import errno
import os
import platform
import re
import time
import uuid
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_PART = re.compile(r"spoofgym-([0-9a-f]{8})-(\d+)-[0-9a-f]{32}\.part")
STALE_S = 7 * 86_400.0  # age at which a temporary file, of any machine, counts as left behind


def write_file(path: Path, content: bytes, *, exclusive: bool = False) -> None:
    with whole_file(path, exclusive=exclusive) as part:
        part.write_bytes(content)


@contextmanager
def whole_file(path: Path, *, exclusive: bool = False) -> Iterator[Path]:
    """Temporary file in the folder of `path`, which takes its name when the block has ended well.
    The folder is made where it is missing. A file of that name is replaced, or, if `exclusive`, is
    left and raises FileExistsError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"spoofgym-{_machine()}-{os.getpid()}-{uuid.uuid4().hex}.part")
    try:
        yield part
        with part.open("rb+") as file:
            os.fsync(file.fileno())
        if exclusive:
            _link(part, path)
        else:
            os.replace(part, path)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
    finally:
        part.unlink(missing_ok=True)


def _link(part: Path, path: Path) -> None:
    try:
        os.link(part, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        with path.open("xb") as file:
            try:
                file.write(part.read_bytes())
            except BaseException:
                path.unlink(missing_ok=True)
                raise


def remove_stale_parts(folder: Path) -> None:
    """Remove temporary files of dead processes of this machine, and of any where they are old."""
    for part in folder.glob("spoofgym-*.part"):
        found = _PART.fullmatch(part.name)
        dead = found and found[1] == _machine() and not _may_live(int(found[2]))
        if found and (dead or _is_old(part)):
            part.unlink(missing_ok=True)


def _is_old(part: Path) -> bool:
    """Whether a file was written so long ago that no writer can still be at it."""
    try:
        return time.time() - part.stat().st_mtime > STALE_S
    except FileNotFoundError:  # its writer has finished
        return False


def _machine() -> str:
    """Digits of where a process number means one process: the host and, on Linux, the container."""
    name = platform.node()
    with suppress(OSError):
        name += os.readlink("/proc/self/ns/pid")
    return f"{zlib.crc32(name.encode()):08x}"


def _may_live(process: int) -> bool:
    if os.name == "nt":  # where signal 0 is an interrupt
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True
