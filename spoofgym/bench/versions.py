"""Versions of the programs that a result was made with."""

from __future__ import annotations

import hashlib
from importlib.metadata import version
from pathlib import Path

from .. import __version__


def versions() -> dict[str, str]:
    """What results depend on besides the settings."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    packages = {name: version(name) for name in ("numba", "numpy", "scipy")}
    return {"spoofgym": __version__, "sources": digest.hexdigest()[:16], **packages}
