"""What parts have returned: a file each, whole or absent."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from spoofgym.core.files import remove_stale_parts, write_file
from spoofgym.core.registry import slug

from .frame import Part

STAMP = "stamp"
"""Name of the member that holds what is no array; arrays are members ``array/<key>``."""


class Store:
    """Folder with the finished parts of one paper."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        remove_stale_parts(folder)

    def path(self, part: str) -> Path:
        """File of a part."""
        return self.folder / f"{slug(part)}.npz"

    def save(
        self, part: Part, identity: dict[str, Any], told: dict[str, Any], result: dict[str, Any]
    ) -> None:
        """Write what a part has returned.

        `identity`: what has to agree when it is taken up again; `told`: what is only told, such as
        versions and times.
        """
        arrays: dict[str, Any] = {}
        values: dict[str, Any] = {}
        for key, value in result.items():
            where = f"part {part.name!r} returns {key!r}"
            if not isinstance(key, str):
                raise TypeError(f"{where}: a name must be a word")
            if isinstance(value, np.ndarray):
                if value.dtype.hasobject:
                    raise TypeError(f"{where}: an array of objects")
                arrays[f"array/{key}"] = value
                continue
            try:
                values[key] = json.loads(json.dumps(value, default=_plain))
            except TypeError as error:
                raise TypeError(f"{where}: {error}") from error
        stamp = json.dumps({"identity": identity, "told": told, "values": values})
        content = io.BytesIO()
        arrays[STAMP] = np.array(stamp)
        np.savez_compressed(content, **arrays)
        write_file(self.path(part.name), content.getvalue())

    def load(self, part: str) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]] | None:
        """Read what a part has returned.

        Returns identity, what is told, and the result; None where there is no such file.
        """
        path = self.path(part)
        try:
            with np.load(path, allow_pickle=False) as file:
                stamp = json.loads(str(file[STAMP]))
                arrays = {
                    name.removeprefix("array/"): file[name] for name in file.files if name != STAMP
                }
            return stamp["identity"], stamp["told"], {**stamp["values"], **arrays}
        except FileNotFoundError:
            return None
        except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
            raise ValueError(
                f"{path} is not the result of a part ({error}); remove it, and its part runs anew"
            ) from error


def _plain(value: Any) -> Any:
    """Numbers and arrays of NumPy within lists, as JSON has them."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"a {type(value).__name__} cannot be stored")
