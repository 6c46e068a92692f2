"""Versions of the programs that a result was made with, and the digest of a campaign."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path, PurePath
from typing import Any

from ... import __version__
from ...core.settings import digest_of
from ...policies.onnx_file import SUFFIX


def versions() -> dict[str, str]:
    """What results depend on besides the settings."""
    root = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    packages = {name: version(name) for name in ("numba", "numpy", "scipy")}
    return {"spoofgym": __version__, "sources": digest.hexdigest()[:16], **packages}


def campaign_digest(config: Mapping[str, Any]) -> str:
    """Digest of the configuration of a campaign, in which ONNX files are by content, not path."""
    outside = {_moved(name, digest): digest for name, digest in config["outside"].items()}
    return digest_of({**_without_folders(dict(config)), "outside": outside})


def _moved(name: str, digest: str) -> str:
    """Name of an outside source: of an ONNX file or its card without the folder."""
    path = PurePath(name)
    return f"{path.name}:{digest}" if path.suffix in (SUFFIX, ".json") else name


def _without_folders(value: Any) -> Any:
    """Settings with paths of ONNX files by their last part."""
    if isinstance(value, Mapping):
        return {key: _without_folders(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_folders(item) for item in value]
    return PurePath(value).name if isinstance(value, str) and value.endswith(SUFFIX) else value
