"""Digest of the sources that the figures of a paper come from.

What only tells or draws is left out, so that a better sentence does not cost a run: comments,
docstrings, texts, `rows` and `figures` of a paper's module, and all modules of the checkout that
the functions of its parts do not import.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path

from spoofgym.core.settings import compute_digest, digest_of_code

ROOT = Path(__file__).resolve().parents[2]
LIBRARY = "spoofgym"
FRAME = "baselines.papers.frame"
"""Says what a part is, and computes nothing."""
REPORT_NAMES = ("TITLE", "CLAIMS", "FINDINGS", "READINGS", "rows", "figures")
"""Names in a module that tell or draw."""


def digest_of_modules(modules: Iterable[str]) -> str:
    """Digest of everything that the functions of some modules can call. `modules`: dotted names of
    modules of a checkout; what they import of it counts, too, but for the library, whose digest is
    kept with every result."""
    known: set[str] = set()
    waiting = set(modules)
    while waiting:
        known |= waiting
        found = {name for module in waiting for name in _list_imports(module)}
        waiting = {name for name in found if name != FRAME} - known
    files = {module: _find_file(module) for module in sorted(known)}
    sources = {name: file and ast.unparse(_computing(file)) for name, file in files.items()}
    return compute_digest(
        [(name, text and digest_of_code(text.encode())) for name, text in sources.items()]
    )


def _find_file(module: str) -> Path | None:
    """File of a module of the checkout, outside the library; None for any other."""
    if module.split(".")[0] == LIBRARY:
        return None
    path = ROOT.joinpath(*module.split("."))
    for file in (path.with_suffix(".py"), path / "__init__.py"):
        if file.is_file():
            return file
    return None


def _list_imports(module: str) -> Iterator[str]:
    """Modules of the checkout that a module imports, in its functions too."""
    file = _find_file(module)
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
            names = [name if _find_file(name) else base for name in inner]
        else:
            continue
        yield from (name for name in names if _find_file(name))


def _computing(file: Path) -> ast.Module:
    """Source without what only tells."""
    tree = ast.parse(file.read_bytes())
    tree.body = [node for node in tree.body if not _only_tells(node)]
    return tree


def _only_tells(node: ast.stmt) -> bool:
    """Whether a statement of a module is a text of the paper, or makes its rows or figures."""
    if isinstance(node, ast.FunctionDef):
        return node.name in REPORT_NAMES
    if isinstance(node, ast.AnnAssign):
        return isinstance(node.target, ast.Name) and node.target.id in REPORT_NAMES
    if isinstance(node, ast.Assign):
        return any(isinstance(t, ast.Name) and t.id in REPORT_NAMES for t in node.targets)
    return False
