"""Detectors that have learned and come with the package: NAME.onnx, with its card NAME.json."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

ZOO_FOLDER = Path(__file__).parent


@cache  # asked whenever a detector is made by its name
def shipped() -> tuple[str, ...]:
    """Names of the shipped detectors.

    Returns
    -------
    tuple of str
        Sorted.
    """
    return tuple(sorted(path.stem for path in ZOO_FOLDER.glob("*.onnx")))


def path_of(file: str | os.PathLike[str]) -> Path:
    """Path of an ONNX file, or of that of a shipped detector by its name."""
    return ZOO_FOLDER / f"{file}.onnx" if os.fspath(file) in shipped() else Path(file)
