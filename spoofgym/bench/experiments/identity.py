"""What results depend on besides their settings: the code that computes, versions, and files."""

from __future__ import annotations

import functools
import hashlib
import json
import platform
from collections.abc import Iterable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

from ... import __version__
from ...core.compile import cache_parent
from ...core.files import write_file
from ...core.reading import read_json
from ...core.settings import compute_digest, digest_of_code

PACKAGES = ("numpy", "scipy", "numba", "onnxruntime")
NOT_COMPUTING = {"cli", "report", "testing", "__main__", "progress", "files", "runner"}
"""Names of packages and modules that no number depends on."""
LIBRARY = Path(__file__).parents[2]
KNOWN, MOST_KNOWN = "sources.json", 5_000
"""File of digests by the bytes of their source, in the cache folder, and how many it keeps."""


def code_identity(packages: Iterable[str] = ()) -> dict[str, str]:
    """Digest of the library's code, without comments, docstrings, layout and what is
    `NOT_COMPUTING`, and versions, of further packages, too, where given."""
    return {
        "sources": digest_of_sources(LIBRARY),
        "python": platform.python_version(),
        **{name: version(name) for name in (*PACKAGES, *packages)},
    }


def versions() -> dict[str, str]:
    """What a card or a manifest says that it was made with."""
    return {"spoofgym": __version__, **code_identity()}


@functools.cache
def digest_of_sources(folder: Path) -> str:
    """Digest of the code in a folder; as it was at the first call in this process."""
    known = _load_digests()
    before = len(known)
    found = [
        (folder.name, path.relative_to(folder).as_posix(), _digest_of_module(path, known))
        for path in sorted(folder.rglob("*.py"))
        if not NOT_COMPUTING & {*path.relative_to(folder).with_suffix("").parts}
    ]
    if len(known) > before:
        text = json.dumps(dict([*known.items()][-MOST_KNOWN:]))
        with suppress(OSError):  # it only saves the time to parse
            write_file(cache_parent() / KNOWN, text.encode())
    return compute_digest(found)


def _load_digests() -> dict[str, str]:
    """Digests that were computed before; parsing all of the library takes seconds."""
    try:
        return dict(read_json(cache_parent() / KNOWN))
    except (OSError, ValueError):
        return {}


def _digest_of_module(path: Path, known: dict[str, str]) -> str:
    content = path.read_bytes()
    key = f"{platform.python_version()} {hashlib.sha256(content).hexdigest()}"
    if key not in known:
        known[key] = digest_of_code(content)
    return known[key]
