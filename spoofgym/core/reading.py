"""Reading files of others: what they may hold is limited before any of it is unpacked or parsed.

All that can be wrong with a file is a `FileError`, which names it, the place, and what is valid.
"""

from __future__ import annotations

import errno
import gzip
import io
import json
import math
import os
import tomllib
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from .extras import name_extra

if TYPE_CHECKING:
    import pandas

GZIP_MAGIC = b"\x1f\x8b"
OTHER_MAGIC = {  # first bytes of what other programs pack
    b"\x1f\x9d": "compress (`gzip -d` unpacks it)",
    b"PK\x03\x04": "zip, as spreadsheets and KMZ files are",
    b"BZh91AY&SY": "bzip2",
    b"\xfd7zXZ\0": "xz",
    b"\x28\xb5\x2f\xfd": "zstd",
}
LARGEST_SIZE = 64 * 2**20  # of a file, unpacked [bytes]: twice a day of records once a second
LARGEST_TOML = 2**18  # [bytes]
LARGEST_ARCHIVE = 2**30  # of all members of a zip file, unpacked [bytes]
MOST_LINES, MOST_VALUES, MOST_DIGITS = 2**20, 2**21, 60
"""Lines of a text, objects and elements of JSON, and digits of a whole number in it."""
MOST_CELLS, MOST_COLUMNS = 2**23, 1000
"""Values and columns of a table."""
DEEPEST = 100
"""Objects and lists of JSON within each other."""
TOO_DEEP = f"valid are at most {DEEPEST} lists and objects within each other"


class FileError(ValueError):
    """A file that isn't what it should be; the message names file, place and what is valid."""


@contextmanager
def name_file(path: str | os.PathLike[str] | None) -> Iterator[None]:
    """Name the file in errors of what its content is made into; None where it is no file."""
    try:
        yield
    except (TypeError, ValueError, OverflowError) as error:
        if path is None or os.fspath(path) in str(error):
            raise
        raise FileError(f"{os.fspath(path)}: {error}") from error


def read_file(path: Path, most: int | None = None) -> bytes:
    """All of a file, unpacked where its first bytes say that gzip packed it. More than `most`
    bytes, by default `LARGEST_SIZE`, are a `FileError`, as are damaged gzip data."""
    most = LARGEST_SIZE if most is None else most
    with path.open("rb") as file:
        packed = file.read(len(GZIP_MAGIC)) == GZIP_MAGIC
        file.seek(0)
        try:
            content = (gzip.GzipFile(fileobj=file) if packed else file).read(most + 1)
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise FileError(f"{path}: its gzip data are damaged or cut short: {error}") from error
    if len(content) > most:
        size = f"{most // 2**20} MiB" if most >= 2**20 else f"{most // 2**10} KiB"
        raise FileError(f"{path} is too large: valid are at most {size}{' unpacked' * packed}")
    return content


def read_lines(path: Path) -> bytes:
    """Content of a file of text, of at most `MOST_LINES` lines."""
    content = read_file(path)
    if name := next((x for magic, x in OTHER_MAGIC.items() if content.startswith(magic)), None):
        raise FileError(f"{path} is packed by {name}: unpack it first, only gzip is read packed")
    if (lines := max(content.count(b"\n"), content.count(b"\r"))) > MOST_LINES:
        raise FileError(f"{path} must have at most {MOST_LINES:,} lines, got {lines:,}")
    return content


def read_json(path: str | os.PathLike[str], kind: type = dict, most: int | None = None) -> Any:
    """JSON of a file as `parse_json` has it, of at most so many bytes."""
    return parse_json(read_file(Path(path), most), os.fspath(path), kind)


def read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(read_file(path, LARGEST_TOML).decode())
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path} is not TOML: {error}") from error


def parse_json(content: bytes | str, where: str, kind: type = dict) -> Any:
    """JSON of a text in UTF-8, an object, or any with ``kind=object``; `where` names it in the
    `FileError` of what is no JSON, or none that a computation can take: too deep, too many values,
    numbers that are too large or none."""
    try:
        text = content.decode("utf-8-sig") if isinstance(content, bytes) else content
        if (values := sum(map(text.count, ",[{"))) > MOST_VALUES:
            raise ValueError(f"valid are at most {MOST_VALUES:,} values, got {values:,}")
        found = json.loads(
            text, parse_constant=_refuse, parse_float=_parse_float, parse_int=_parse_int
        )
        _check_depth(found)
        if "\\u" in text:
            json.dumps(found, ensure_ascii=False).encode()  # or half of a surrogate pair
    except RecursionError as error:
        raise FileError(f"{where} is not JSON: {TOO_DEEP}") from error
    except ValueError as error:
        raise FileError(f"{where} is not JSON: {error}") from error
    if not isinstance(found, kind):
        raise FileError(f"{where} must be an object of JSON, got {type(found).__name__}")
    return found


def _check_depth(found: Any) -> None:
    level = [found] if isinstance(found, dict | list) else []
    for _ in range(DEEPEST + 1):
        level = [
            item
            for each in level
            for item in (each.values() if isinstance(each, dict) else each)
            if isinstance(item, dict | list)
        ]
        if not level:
            return
    raise ValueError(TOO_DEEP)


def _refuse(word: str) -> NoReturn:
    raise ValueError(f"{word} is no number")


def _parse_float(text: str) -> float:
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{text[:MOST_DIGITS]} is no number that a computer holds")
    return value


def _parse_int(text: str) -> int:
    if len(text) > MOST_DIGITS:
        raise ValueError(f"a number has at most {MOST_DIGITS} digits, got {len(text)}")
    return int(text)


@contextmanager
def _name_damage() -> Iterator[None]:
    """A place outside of the file is damage, and no failure of the disk."""
    try:
        yield
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
        raise zipfile.BadZipFile("a place in it is outside of the file") from error


class Archive(zipfile.ZipFile):
    """A zip file that is read: no member is unpacked beyond the size in its header, nor all of them
    beyond `LARGEST_ARCHIVE`."""

    def __init__(self, file: Path) -> None:
        with _name_damage():
            super().__init__(file)
        names = self.namelist()
        for each in self.infolist():
            if each.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise zipfile.BadZipFile(f"{each.filename!r} is packed in a way that is not read")
        if len({*names}) < len(names):
            raise zipfile.BadZipFile("two of its members have one name")
        if (size := sum(each.file_size for each in self.infolist())) > LARGEST_ARCHIVE:
            most = f"{LARGEST_ARCHIVE >> 20:,} MiB"
            raise zipfile.BadZipFile(f"unpacked it has {size >> 20:,} MiB, valid are {most}")

    def read(self, name: str, pwd: bytes | None = None) -> bytes:  # type: ignore[override]
        with _name_damage(), self.open(name, pwd=pwd) as member:
            return member.read(self.getinfo(name).file_size)


def check_table(rows: int, columns: int) -> None:
    """Raise a ValueError where a table would be too large for the memory."""
    if columns > MOST_COLUMNS:
        raise ValueError(f"it must have at most {MOST_COLUMNS} columns, got {columns}")
    if rows * columns > MOST_CELLS:
        raise ValueError(f"it must hold at most {MOST_CELLS} values, got {rows * columns}")


def choose_columns(names: Sequence[str], row: Sequence[str]) -> dict[str, Any]:
    """For pandas, by a table's head and first row: the named columns where rows end with separators
    alone; a ValueError where they have values without a name, for which it would shift all columns.
    One more is sound where R has numbered the rows."""
    more = row[len(names) :]
    if any(more) and (len(more) > 1 or row[0] not in ("0", "1")):
        raise ValueError(f"its head names {len(names)} columns, its first row has {len(row)}")
    return {"index_col": False, "usecols": range(len(names))} if more and not any(more) else {}


def read_table(path: Path, columns: Sequence[str] = (), *, header: bool = True) -> pandas.DataFrame:
    """Table of a CSV or Parquet file; of Parquet the named columns alone, where there are any.
    Without a `header` the columns have the names 1, 2, 3."""
    packed = ".parquet" in path.suffixes
    try:
        import pandas

        if packed:
            from pyarrow.parquet import ParquetFile
    except ImportError as error:
        raise name_extra("a table", error, "flights") from error
    if not packed:
        content = read_lines(path)
        lines = (*content.split(b"\n", 2), b"")[:2]
        head, row = ([x.strip() for x in line.decode("latin-1").split(",")] for line in lines)
        check_table(content.count(b"\n") + 1, len(head))
        numbers = range(1, len(head) + 1)
        return pandas.read_csv(
            io.BytesIO(content),
            encoding="utf-8-sig",
            skipinitialspace=True,
            na_values=["nan(ind)", "-nan(ind)"],  # of Microsoft's C library
            **(choose_columns(head, row) if header else {"header": None, "names": numbers}),
        )
    file = ParquetFile(io.BytesIO(read_file(path)))
    found = [name for name in columns or file.schema.names if name in file.schema.names]
    check_table(file.metadata.num_rows, len(found))
    return file.read(columns=found).to_pandas()


KINDS = {"number": "fiu", "whole number": "fiu", "text": "U"}
"""Types of NumPy that a field of an array file may have, by the words for it."""


def read_npz(path: Path, fields: Mapping[str, tuple[str, str]]) -> dict[str, NDArray[Any]]:
    """Those of the `fields` that a .npz file has, as `check_arrays` has them."""
    with Archive(path) as archive:
        members = {name.removesuffix(".npy"): name for name in archive.namelist()}
        found = {x: parse_array(archive.read(members[x])) for x in fields if x in members}
    return check_arrays(found, fields)


def check_arrays(
    found: Mapping[str, NDArray[Any]], fields: Mapping[str, tuple[str, str]]
) -> dict[str, NDArray[Any]]:
    """Arrays of a file, each of its kind (`KINDS`) and with one of its numbers of axes, such as
    "12"; no infinities, and whole numbers that are some."""
    for name, array in found.items():
        kind, axes = fields[name]
        if array.dtype.kind not in KINDS[kind] or str(array.ndim) not in axes:
            raise FileError(
                f"`{name}` must hold {kind}s on {' or '.join(axes)} axes, got {array.dtype} on "
                f"{array.ndim}"
            )
        if kind == "text" or array.dtype.kind != "f":
            continue
        bad = np.isinf(array)
        if kind == "whole number":
            bad |= (array != np.round(array)) | (np.abs(array) > 2**53)
        if bad.any():
            raise FileError(f"`{name}` must hold finite {kind}s, got {array[bad][0]:g}")
    return dict(found)


def parse_array(data: bytes) -> NDArray[Any]:
    """Array of a .npy file, whose header must say as many bytes as follow it."""
    stream = io.BytesIO(data)
    try:
        version = npy.read_magic(stream)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, _, dtype = read(stream)
    except Exception as error:  # it is parsed as Python is, which raises many kinds
        raise FileError(f"its header is not that of an array: {error}") from error
    size, left = math.prod(shape) * dtype.itemsize, len(data) - stream.tell()
    if min((0, *shape)) < 0 or dtype.hasobject or size != left:
        raise FileError(f"an array of {dtype} {shape} has {size} bytes, and {left} are there")
    stream.seek(0)
    return npy.read_array(stream, allow_pickle=False)
