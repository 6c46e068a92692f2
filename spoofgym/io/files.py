"""Contents of recorded files: unpacked, of a bounded size, or refused by one error."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

GZIP_MAGIC = b"\x1f\x8b"
LARGEST_SIZE = 64 * 2**20
"""Of a file, unpacked [bytes]; a day of records once a second, twenty quantities each, is half."""


class FileError(ValueError):
    """A file that isn't what it should be; the message names file, place and what is valid."""


def read_file(path: Path) -> bytes:
    """All of a file, unpacked where its first bytes say that gzip packed it. More than
    `LARGEST_SIZE` bytes are a `FileError`, as are damaged gzip data."""
    with path.open("rb") as file:
        packed = file.read(len(GZIP_MAGIC)) == GZIP_MAGIC
        file.seek(0)
        try:
            content = (gzip.GzipFile(fileobj=file) if packed else file).read(LARGEST_SIZE + 1)
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise FileError(f"{path}: its gzip data are damaged or cut short: {error}") from error
    if len(content) > LARGEST_SIZE:
        size = f"{LARGEST_SIZE // 2**20} MiB{' unpacked' if packed else ''}"
        raise FileError(f"{path} is too large: valid are at most {size}")
    return content
