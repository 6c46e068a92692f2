"""Digest of the sources that the figures of a paper come from.

What only tells or draws is left out, so that a better sentence does not cost a run: comments,
docstrings, texts, `rows` and `figures` of a paper's module, and all modules of the checkout that
the functions of its parts do not import.
"""

from __future__ import annotations

import ast
import hashlib
import sys
from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from types import CodeType

import numba
import numpy as np
import scipy

ROOT = Path(__file__).resolve().parents[2]
LIBRARY = "spoofgym"
OUTSIDE = ("__main__.py", "cli", "sb3", "testing")
"""Files and folders of the library that no figure comes from."""
FRAME = "baselines.papers.frame"
"""Says what a part is, and computes nothing."""
TOLD_NAMES = ("TITLE", "CLAIMS", "FOUND", "READINGS", "rows", "figures")
"""Names in a module that tell or draw."""


@lru_cache(maxsize=1)
def library_digest() -> str:
    """Digest of the package and of what computes beneath it."""
    digest = hashlib.sha256()
    for part in (sys.version_info[:3], np.__version__, scipy.__version__, numba.__version__):
        digest.update(repr(part).encode())
    library = ROOT / LIBRARY
    for path in sorted(library.rglob("*.py")):
        place = path.relative_to(library)
        if place.parts[0] not in OUTSIDE:
            _add_source(digest, place.as_posix(), path)
    return digest.hexdigest()


def digest_of_modules(modules: Iterable[str]) -> str:
    """Digest of everything that the functions of some modules can call.

    `modules`: modules of a checkout, outside the library, by their dotted names.  Returns 16
    hexadecimal digits, of the library, of these modules and of all that they import.
    """
    digest = hashlib.sha256(library_digest().encode())
    known: set[str] = set()
    waiting = set(modules)
    while waiting:
        known |= waiting
        found = {name for module in waiting for name in _imported(module)}
        waiting = {name for name in found if name != FRAME} - known
    for module in sorted(known):
        _add_source(digest, module, _file_of(module))
    return digest.hexdigest()[:16]


def _file_of(module: str) -> Path | None:
    """File of a module of the checkout, outside the library; None for any other."""
    if module.split(".")[0] == LIBRARY:
        return None
    path = ROOT.joinpath(*module.split("."))
    for file in (path.with_suffix(".py"), path / "__init__.py"):
        if file.is_file():
            return file
    return None


def _imported(module: str) -> Iterator[str]:
    """Modules of the checkout that a module imports, in its functions too."""
    file = _file_of(module)
    if file is None:
        return
    package = module.split(".") if file.name == "__init__.py" else module.split(".")[:-1]
    for node in ast.walk(_computing(file)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parents = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*parents, *filter(None, [node.module])])
            inner = [f"{base}.{alias.name}" for alias in node.names]
            # a name that is no module of its own is one of the package's
            names = [name if _file_of(name) else base for name in inner]
        else:
            continue
        yield from (name for name in names if _file_of(name))


def _computing(file: Path) -> ast.Module:
    """Source without what only tells."""
    tree = ast.parse(file.read_bytes())
    tree.body = [node for node in tree.body if not _only_tells(node)]
    return tree


def _add_source(digest: hashlib._Hash, name: str, file: Path | None) -> None:
    digest.update(name.encode())
    if file is not None:
        # the highest optimization drops docstrings
        _add_code(digest, compile(_computing(file), name, "exec", optimize=2))


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
