"""Digest of the sources that the figures of a paper come from.

What only tells or draws is left out, so that a better sentence does not cost a run: comments,
docstrings, the texts of a paper's module, its `rows` and its `figures`.
"""

from __future__ import annotations

import ast
import hashlib
import sys
from functools import lru_cache
from pathlib import Path
from types import CodeType

import numba
import numpy as np
import scipy

HERE = Path(__file__).resolve().parent
LIBRARY = HERE.parents[1] / "spoofgym"
OUTSIDE = ("__main__.py", "cli.py", "sb3.py", "testing")
"""Files and folders of the library that no figure comes from."""
MACHINERY = (
    *("__init__", "__main__", "frame", "page", "paper", "run"),
    *("sources", "store", "tables", "work"),
)
"""Modules of this folder that run and tell, but compute nothing."""
TOLD_FILES = ("figures.py", "rows.py", "texts.py")
"""Files of a paper's package that tell or draw."""
TOLD_NAMES = ("TITLE", "CLAIMS", "FOUND", "READINGS", "rows", "figures")


@lru_cache(maxsize=1)
def library_digest() -> str:
    """Digest of the package and of what computes beneath it.

    Returns
    -------
    str
        Hexadecimal.
    """
    digest = hashlib.sha256()
    for part in (sys.version_info[:3], np.__version__, scipy.__version__, numba.__version__):
        digest.update(repr(part).encode())
    for path in sorted(LIBRARY.rglob("*.py")):
        place = path.relative_to(LIBRARY)
        if place.parts[0] not in OUTSIDE:
            _add_source(digest, place.as_posix(), path)
    return digest.hexdigest()


def paper_digest(key: str, keys: tuple[str, ...]) -> str:
    """Digest of everything that a paper's figures come from.

    Parameters
    ----------
    key : str
        The paper.
    keys : tuple of str
        All papers; the modules of the others count for nothing.

    Returns
    -------
    str
        16 hexadecimal digits.
    """
    digest = hashlib.sha256(library_digest().encode())
    others = {*MACHINERY, *keys} - {key}
    for path in sorted(HERE.rglob("*.py")):
        place = path.relative_to(HERE)
        if place.parts[0].removesuffix(".py") in others:
            continue
        if len(place.parts) > 1 and place.name in TOLD_FILES:
            continue
        _add_source(digest, place.as_posix(), path)
    return digest.hexdigest()[:16]


def _add_source(digest: hashlib._Hash, place: str, path: Path) -> None:
    digest.update(place.encode())
    tree = ast.parse(path.read_bytes())
    tree.body = [node for node in tree.body if not _only_tells(node)]
    # the highest optimization drops docstrings
    _add_code(digest, compile(tree, place, "exec", optimize=2))


def _only_tells(node: ast.stmt) -> bool:
    """Whether a statement of a module is a text of the paper, or makes its rows or figures."""
    if isinstance(node, ast.FunctionDef):
        return node.name in TOLD_NAMES
    if isinstance(node, ast.AnnAssign):
        return isinstance(node.target, ast.Name) and node.target.id in TOLD_NAMES
    if isinstance(node, ast.Assign):
        return any(isinstance(t, ast.Name) and t.id in TOLD_NAMES for t in node.targets)
    return False


def _add_code(digest: hashlib._Hash, code: CodeType) -> None:
    """Add what a code object does, wherever it stands in its file."""
    digest.update(code.co_code)
    for names in (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars):
        digest.update(repr(names).encode())
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            _add_code(digest, constant)
        elif isinstance(constant, frozenset):
            digest.update(repr(sorted(map(repr, constant))).encode())
        else:
            digest.update(repr(constant).encode())
