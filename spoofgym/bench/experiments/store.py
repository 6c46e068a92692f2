"""Results of an experiment in a folder: one file a cell, complete or absent.

The bytes of a file are a function of the cell and of what it has returned alone.
"""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import struct
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ...core.files import remove_stale_parts, write_file
from ...core.reading import Archive, FileError, parse_array, parse_json, read_json
from ...core.settings import compute_digest, diff_settings
from .identity import code_identity

FORMAT = 1
CONFIG, CELLS = "config.json", "cells"
HEAD, RECORD, ARRAY = "head.json", "record.json", ".npy"
"""Members of a cell's file: what it is of, what is no array, and arrays as in any .npz."""
SUMMARY, REPORT, REPLAY = OUTPUTS = "summary.json", "report.html", "replay.json"
"""Files beside the cells: scores, the page that shows them, and the run that it plays again."""
DATE = (1980, 1, 1, 0, 0, 0)
LONGEST_NAME, SHOWN = 100, 5
DAMAGED = (
    *(ValueError, KeyError, TypeError, EOFError, NotImplementedError, RuntimeError),
    *(zipfile.BadZipFile, zlib.error, struct.error),
)


class Cell(NamedTuple):
    """A part of an experiment that is computed and stored as one.

    - `identity`: what its result depends on besides the experiment's `config`, as JSON; None where
      this can't be written down: then the result is in memory only;
    - `work`: how long it takes, in a unit of the experiment; `after`: keys of cells that are
      finished first, which it may read; `group`: cells of one are computed in one call.
    """

    key: str
    identity: Mapping[str, Any] | None
    work: float = 1.0
    after: tuple[str, ...] = ()
    group: str = ""


class Result(NamedTuple):
    """What a cell has returned, by name; it depends on no time, machine or other cell."""

    arrays: Mapping[str, NDArray[Any]] = {}  # never written to
    record: Any = None
    deflated: bool = False


class Store:
    """A folder of results, opened for one experiment; it can be pickled."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._config: dict[str, Any] | None = None

    def open(
        self,
        experiment: str,
        config: Mapping[str, Any],
        *,
        outputs: Sequence[str] = (),
        overwrite: bool = False,
    ) -> None:
        """Start an experiment in the folder, or go on with it; raise where it holds another.

        `outputs`: names of what is written there besides cells; `overwrite` removes them, too.
        """
        if self.path.exists() and not self.path.is_dir():
            raise ValueError(f"{self.path} is not a folder; choose another one")
        for folder in (self.path, self.path / CELLS):
            remove_stale_parts(folder)
        mine = {"experiment": experiment, "format": FORMAT, "code": code_identity()}
        mine = json.loads(_json({**mine, "config": config}, f"config of {experiment}"))
        if (self.path / CONFIG).is_file():
            if overwrite:
                self._read_config()
                self._remove(outputs)
        elif (strange := self._content()) and not (self.path / CONFIG).is_file():
            raise ValueError(
                f"{self.path} is not empty and holds no {CONFIG} of an experiment "
                f"({', '.join(strange[:SHOWN])}); choose another folder"
            )
        try:
            self._write(self.path / CONFIG, _json(mine, CONFIG, indent=1), exclusive=True)
        except FileExistsError:
            if (found := self._read_config(experiment)) != mine:
                raise ValueError(
                    f"{self.path} holds other results ({_format_diff(found, mine)}); choose "
                    "another folder, or overwrite them"
                ) from None
        self._config = mine

    def reopen(self, experiment: str | None = None) -> dict[str, Any]:
        """Read what is there, whatever code has made it; returns the config of the experiment, by
        default of any."""
        if not (self.path / CONFIG).is_file():
            inside = sorted(str(each.parent) for each in self.path.glob(f"*/{CONFIG}"))
            hint = f"; {', '.join(inside[:SHOWN])} has one" if inside else ""
            raise ValueError(f"{self.path} holds no results: there is no {CONFIG}{hint}")
        self._config = self._read_config(experiment)
        return dict(self._config["config"])

    def _content(self) -> list[str]:
        """What the folder holds, but for folders of other experiments."""
        items = self.path.iterdir() if self.path.is_dir() else ()
        own = (item for item in items if not (item / CONFIG).is_file())
        return sorted(item.name for item in own if not item.name.endswith(".part"))

    def _read_config(self, experiment: str | None = None) -> dict[str, Any]:
        """Configuration in the folder, of this format; raises where it is of another experiment."""
        path = self.path / CONFIG
        try:
            found = read_json(path, object)
        except FileError as error:
            raise ValueError(f"{path} is damaged ({error}); choose another folder") from error
        keys = {"experiment", "format", "config"}
        if not isinstance(found, dict) or not keys <= {*found} or type(found["config"]) is not dict:
            raise ValueError(
                f"{path} is of an older format, or of another program; choose another folder"
            )
        if found["format"] != FORMAT:
            raise ValueError(
                f"{path} has the format {found['format']!r}, and this version of spoofgym reads "
                f"{FORMAT}; choose another folder"
            )
        if experiment not in (None, found["experiment"]):
            raise ValueError(
                f"{self.path} holds the experiment {found['experiment']!r} and not "
                f"{experiment!r}; choose another folder"
            )
        return found

    def _remove(self, outputs: Iterable[str]) -> None:
        """Remove what an experiment writes, and nothing else; its configuration comes last."""
        if (self.path / CELLS).is_dir():
            shutil.rmtree(self.path / CELLS)
        for name in (*outputs, CONFIG):
            (self.path / name).unlink(missing_ok=True)

    @property
    def config(self) -> dict[str, Any]:
        """What the folder was opened for: experiment, format, code, and the experiment's config."""
        if self._config is None:
            raise ValueError(f"{self.path} has not been opened for an experiment")
        return self._config

    def check_code(self) -> None:
        """Raise where this process has other code or versions than the one that opened it."""
        if unlike := _format_diff(code_identity(), self.config["code"]):
            raise ValueError(
                f"a worker has other code than the process that opened {self.path}: {unlike}; "
                "install the same versions for both"
            )

    def build_path(self, key: str) -> Path:
        name = re.sub(r"[^A-Za-z0-9._=]+", "-", key).strip("-.")[:LONGEST_NAME]
        whole = name if name == key else f"{name}--{compute_digest(key)[:8]}"
        return self.path / CELLS / f"{whole}.npz"

    def has(self, cell: Cell) -> bool:
        """Whether a cell is finished; raises where its file is of something else."""
        return self._read(cell, whole=False) is not None

    def get(self, cell: Cell) -> Result | None:
        """Result of a cell; None where it is not finished."""
        return self._read(cell, whole=True)

    def read_all(self) -> Iterator[tuple[Cell, Result]]:
        """Finished cells, whatever names them."""
        for path in sorted((self.path / CELLS).glob("*.npz")):
            try:
                with Archive(path) as file:
                    head = parse_json(file.read(HEAD), HEAD)
                cell = Cell(head["key"], head["identity"])
            except DAMAGED as error:
                raise ValueError(f"{path} is damaged ({error}); delete it and run again") from error
            found = self.get(cell)
            if found is not None:
                yield cell, found

    def _read(self, cell: Cell, *, whole: bool) -> Result | None:
        path = self.build_path(cell.key)
        try:
            with Archive(path) as file:
                head = parse_json(file.read(HEAD), HEAD)
                members = head.pop("members")
                unlisted = sorted({*file.namelist()} ^ {HEAD, *members})
                content = {name: file.read(name) for name in members if whole and not unlisted}
            result = _unpack_result(content)
        except FileNotFoundError:
            return None
        except DAMAGED as error:
            raise ValueError(f"{path} is damaged ({error}); delete it and run again") from error
        if unlisted:
            raise ValueError(
                f"{path} has other arrays than its head says ({', '.join(unlisted[:SHOWN])}); "
                "delete it and run again"
            )
        mine = json.loads(_json(self._head(cell), cell.key))
        if head != mine:
            raise ValueError(
                f"{path} is another cell than the one requested ({_format_diff(head, mine)}); "
                "delete it and run again, or choose another folder"
            )
        return result

    def _head(self, cell: Cell) -> dict[str, Any]:
        """What a cell's file is of."""
        if cell.identity is None:
            raise ValueError(
                f"{cell.key!r} can't be written: no `identity` says which code it depends on"
            )
        return {
            "format": FORMAT,
            "experiment": self.config["experiment"],
            "config": compute_digest(self.config),
            "key": cell.key,
            "identity": cell.identity,
        }

    def put(self, cell: Cell, result: Result) -> None:
        content = _pack_result(self._head(cell), result, f"cell {cell.key!r}")
        if self._read_config() != self.config:
            raise ValueError(
                f"{self.path} has been taken by another experiment meanwhile; choose another folder"
            )
        self._write(self.build_path(cell.key), content)

    def write(self, name: str, content: bytes) -> Path:
        self._write(self.path / name, content)
        return self.path / name

    def _write(self, path: Path, content: bytes, *, exclusive: bool = False) -> None:
        """Write a file; errors name it, and not the temporary one."""
        try:
            write_file(path, content, exclusive=exclusive)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from error


class MemoryStore(Store):
    """Results that this process holds; of a folder, too, where one is given."""

    def __init__(self, folder: Store | None = None) -> None:
        super().__init__("memory" if folder is None else folder.path)
        self._folder, self._results = folder, dict[str, Result]()

    def open(self, experiment: str, config: Mapping[str, Any], **options: Any) -> None:
        if self._folder is not None:
            self._folder.open(experiment, config, **options)

    def _read(self, cell: Cell, *, whole: bool) -> Result | None:
        if self._folder is None or cell.identity is None or cell.key in self._results:
            return self._results.get(cell.key)
        return self._folder._read(cell, whole=whole)

    def put(self, cell: Cell, result: Result) -> None:
        """Hold a finished cell, and write it where that can be."""
        if self._folder is not None and cell.identity is not None:
            self._folder.put(cell, result)
        self._results[cell.key] = result


class Reader(Mapping[str, Result]):
    """Results of the finished ones of some cells, by key."""

    def __init__(self, store: Store, cells: Iterable[Cell]) -> None:
        self.store = store
        self.cells = {cell.key: cell for cell in cells}

    def __getitem__(self, key: str) -> Result:
        """Read one; a KeyError says whether it is unknown here, or not finished."""
        if key not in self.cells:
            raise KeyError(f"{key!r} is not among the cells that may be read: {[*self.cells]}")
        result = self.store.get(self.cells[key])
        if result is None:
            raise KeyError(f"{key!r} is not finished in {self.store.path}")
        return result

    def __iter__(self) -> Iterator[str]:
        return (key for key, cell in self.cells.items() if self.store.has(cell))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    @property
    def missing(self) -> list[str]:
        """Keys of cells that are not finished."""
        return [key for key, cell in self.cells.items() if not self.store.has(cell)]


def _pack_result(head: Mapping[str, Any], result: Result, name: str) -> bytes:
    parts = {RECORD: _json(result.record, f"record of {name}")}
    for key, array in result.arrays.items():
        buffer = io.BytesIO()
        try:
            npy.write_array(buffer, np.asarray(array, order="C"), allow_pickle=False)
        except ValueError as error:
            raise ValueError(f"{name} returns {key!r}, which can't be stored: {error}") from error
        parts[f"{key}{ARRAY}"] = buffer.getvalue()
    parts = {HEAD: _json({**head, "members": [*parts]}, name), **parts}
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as file:
        for member, data in parts.items():
            info = zipfile.ZipInfo(member, DATE)
            info.create_system, info.external_attr = 3, 0o600 << 16
            info.compress_type = zipfile.ZIP_DEFLATED if result.deflated else zipfile.ZIP_STORED
            file.writestr(info, data)
    return content.getvalue()


def _unpack_result(parts: Mapping[str, bytes]) -> Result:
    """Result in a file's members; empty without any."""
    own = {name: data for name, data in parts.items() if name != RECORD}
    arrays = {name.removesuffix(ARRAY): parse_array(data) for name, data in own.items()}
    return Result(arrays, parse_json(parts.get(RECORD, b"null"), RECORD, object))


def _json(value: Any, name: str, indent: int | None = None) -> bytes:
    """JSON of a value; an error names what it is of."""
    try:
        return json.dumps(value, indent=indent, allow_nan=False, default=_plain).encode()
    except (TypeError, ValueError) as error:
        raise type(error)(f"{name} can't be written as JSON: {error}") from error


def _plain(value: Any) -> Any:
    """Numbers and arrays of NumPy as JSON has them."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"a {type(value).__name__} is no JSON")


def _format_diff(found: Mapping[str, Any], mine: Mapping[str, Any]) -> str:
    """What differs, in a few words."""
    lines = [f"{name}: {_short(a)}, not {_short(b)}" for name, a, b in diff_settings(found, mine)]
    more = f"; and {len(lines) - SHOWN} more" if len(lines) > SHOWN else ""
    return "; ".join(lines[:SHOWN]) + more


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 50 else f"{text[:47]}..."
