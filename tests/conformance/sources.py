"""The project's own sources and modules, for tests of how it is written."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

import spoofgym

ROOT = Path(spoofgym.__file__).parent
CHECKOUT = ROOT.parent


def files() -> list[Path]:
    return sorted(ROOT.rglob("*.py"))


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@cache
def imports_of(path: Path) -> list[tuple[str, list[str]]]:
    """Absolute name and imported names of every import of a file."""
    package, found = ("spoofgym", *path.relative_to(ROOT).parent.parts), []
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            found += [(alias.name, []) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join((*base, *(node.module or "").split("."))).strip(".")
            found.append((module, [alias.name for alias in node.names]))
    return found


def modules() -> Iterator[ModuleType]:
    """All modules but those that need packages which are not installed."""
    for info in pkgutil.walk_packages(spoofgym.__path__, "spoofgym."):
        if info.name.endswith("__main__"):
            continue
        try:
            yield importlib.import_module(info.name)
        except ModuleNotFoundError as error:
            if error.name is None or error.name.startswith("spoofgym"):
                raise


def public_classes() -> list[type]:
    """Public classes, in the modules that define them."""
    return [
        member
        for module in modules()
        for name, member in vars(module).items()
        if inspect.isclass(member) and member.__module__ == module.__name__
        if not name.startswith("_")
    ]
