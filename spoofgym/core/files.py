"""Files that are whole or absent, even with other writers: the one way to write them."""

from __future__ import annotations

import errno
import importlib.util
import io
import os
import platform
import re
import time
import uuid
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

_PART = re.compile(r"spoofgym-([0-9a-f]{8})-(\d+)-[0-9a-f]{32}\.part")
STALE_S = 7 * 86_400.0  # age at which a temporary file, of any machine, counts as left behind


COLUMN_FILES = (".mat", ".parquet")


def check_pyarrow() -> None:
    """An ImportError that names the extra, where Parquet can't be written."""
    if importlib.util.find_spec("pyarrow") is None:
        raise ImportError(
            "Parquet needs pyarrow of the extra `flights`: pip install 'spoofgym[flights]'"
        )


def write_columns(path: Path, columns: Mapping[str, Any], head: Mapping[str, str] = {}) -> None:
    """Arrays of equal first length as a Parquet table, further axes as lists, with `head` as its
    metadata; or as variables of a MATLAB file (version 5), texts as cells."""
    buffer = io.BytesIO()
    if path.suffix.lower() == ".mat":
        from scipy.io import savemat

        texts = {k: v.astype(object) for k, v in columns.items() if v.dtype.kind == "U"}
        savemat(buffer, {**columns, **texts}, do_compression=True, oned_as="column")
    else:
        check_pyarrow()
        import pyarrow as pa
        import pyarrow.parquet as pq

        arrays = {}
        for name, values in columns.items():
            arrays[name] = pa.array(values.reshape(-1))
            if values.ndim > 1:
                width = values.size // len(values)
                arrays[name] = pa.FixedSizeListArray.from_arrays(arrays[name], width)
        pq.write_table(pa.table(arrays).replace_schema_metadata(dict(head)), buffer)
    write_file(path, buffer.getvalue())


def write_file(path: Path, content: bytes, *, exclusive: bool = False) -> None:
    with whole_file(path, exclusive=exclusive) as part:
        part.write_bytes(content)


def check_writable(folder: Path) -> None:
    """Make a folder where it is missing; raises the system's error where no file can be there."""
    write_file(part := folder / f".{uuid.uuid4().hex}", bytes(4096))
    part.unlink()


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
