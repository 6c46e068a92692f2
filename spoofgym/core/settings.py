"""Settings as JSON, a digest of them, and digests of what is not spoofgym's."""

from __future__ import annotations

import ast
import dataclasses
import hashlib
import importlib.util
import inspect
import json
import math
import sys
from collections.abc import Iterable, Iterator, Mapping
from datetime import date
from itertools import accumulate
from pathlib import Path, PurePath
from typing import Any

import numpy as np

LIBRARIES = {"spoofgym", "numpy", "pandas", *sys.stdlib_module_names}  # they have versions
OMITTED = {"omitted": True}  # metadata of a default that is not written down: records are older
NEWER = {**OMITTED, "newer": True}  # of one that no text names, calibrations and specs included
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def describe(value: Any) -> Any:
    """Settings as JSON: records by their fields, arrays by a digest."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"a setting must be finite, got {value}")
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray):
        content = np.ascontiguousarray(value)
        digest = hashlib.sha256(f"{content.dtype.str}{content.shape}".encode() + content.tobytes())
        return f"sha256:{digest.hexdigest()[:16]}"
    if isinstance(value, date):
        return value.isoformat()
    if isinstance(value, PurePath):
        return value.name
    return _describe_parts(value)


def list_written(record: Any, names: Iterable[str]) -> list[str]:
    """Settings of a record by name, without those that are newer than what is stored and have their
    default."""
    fields = getattr(record, "__dataclass_fields__", {})
    newer = {name for name, field in fields.items() if field.metadata.get("newer")}
    return [n for n in names if n not in newer or getattr(record, n) != fields[n].default]


def _describe_parts(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        named = {
            f.name: describe(getattr(value, f.name))
            for f in dataclasses.fields(value)
            if not (f.metadata.get("omitted") and getattr(value, f.name) == f.default)
        }
        return {"kind": get_kind(type(value)), **named}
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {str(key): describe(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [describe(item) for item in value]
    raise TypeError(
        f"a setting of type {type(value).__qualname__} can't be written down: {value!r}"
    )


def get_kind(record: type) -> str:
    """Word that stands for a class in what is stored: its name, or its own `described_as`.

    Calibrations, cards and tasks are found by these words, so that a class of the package that
    gets another name declares the old one.
    """
    return str(vars(record).get("described_as", record.__qualname__))


def compute_digest(config: Any) -> str:
    text = json.dumps(config, sort_keys=True, allow_nan=False, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def outside_sources(*things: Any) -> dict[str, str | None]:
    """Digests of what is not spoofgym's in `things` and their settings, by name.

    They are those of modules: of the classes, their bases, and what these import, but for what is
    installed; and those of ONNX files and their cards.  A class whose source can't be read, such
    as one that was typed in, has None.  What is loaded elsewhere has a method `list_sources`.
    """
    found: dict[str, str | None] = {}
    for thing in _within(things):
        if isinstance(thing, str | PurePath):
            file = Path(thing)
            for path in (file, file.with_suffix(".json")) if file.suffix == ".onnx" else ():
                if path.is_file():
                    found[str(path)] = _digest_file(path)
            continue
        if hasattr(thing, "list_sources"):
            found |= thing.list_sources()
        for kind in type(thing).__mro__:
            if _is_outside(kind.__module__, type(thing)):
                try:
                    inspect.getsource(kind)
                except (OSError, TypeError):
                    found[f"{kind.__module__}:{kind.__qualname__}"] = None
                else:
                    found |= _sources(kind)
    return found


def _within(value: Any) -> Iterator[Any]:
    """An object that `describe` takes, and all that its settings hold."""
    yield value
    if value is None or isinstance(value, bool | int | float | str | np.generic | np.ndarray):
        return
    if isinstance(value, date | PurePath):
        return
    if isinstance(value, Mapping):
        parts = list(value.values())
    elif isinstance(value, list | tuple):
        parts = list(value)
    else:
        parts = [getattr(value, name, None) for name in inspect.signature(type(value)).parameters]
    for part in parts:
        yield from _within(part)


def _digest_file(path: Path) -> str:
    content = path.read_bytes()
    return digest_of_code(content) if path.suffix == ".py" else digest_of_bytes(content)


def digest_of_bytes(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def digest_of_code(source: bytes) -> str:
    """Digest of what Python source does: neither comments nor docstrings nor layout count."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            node.body = node.body[1:] or [ast.Pass()]
    return digest_of_bytes(ast.dump(tree).encode())


def _find_file(module: str) -> str:
    """A module's file, imported or not; empty for what has none, or can't be found."""
    if module in sys.modules:
        return getattr(sys.modules[module], "__file__", None) or ""
    package = module.rpartition(".")[0]
    if package and package not in sys.modules:  # which to find the module would import
        return ""
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, ValueError):
        return ""
    return spec.origin or "" if spec and spec.has_location else ""


def _is_outside(module: str, kind: type) -> bool:
    """Whether a module is the user's; an installed one is where the class is of its package."""
    package = module.partition(".")[0]
    if package in LIBRARIES:
        return False
    installed = bool({"site-packages", "dist-packages"} & {*Path(_find_file(module)).parts})
    return package == kind.__module__.partition(".")[0] or not installed


def _sources(kind: type) -> dict[str, str]:
    """Digests of a class's module and of the user's modules that it imports, anywhere in it."""
    found: dict[str, str] = {}
    waiting = [kind.__module__]
    while waiting:
        name = waiting.pop()
        if name in found or not _is_outside(name, kind) or not (file := _find_file(name)):
            continue
        path = Path(file)
        found[name] = _digest_file(path)
        if path.suffix == ".py":
            package = name if path.name == "__init__.py" else name.rpartition(".")[0]
            waiting += _list_imports(path.read_bytes(), package)
    return found


def _list_imports(source: bytes, package: str) -> Iterator[str]:
    """Modules that source in a package imports, and what may be one, each after its packages."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            relative = "." * node.level + (node.module or "")
            try:
                base = importlib.util.resolve_name(relative, package)
            except ImportError:  # beyond the top, where it would fail, too
                continue
            names = [f"{base}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            yield from accumulate(name.split("."), "{}.{}".format)


def diff_settings(one: Any, other: Any, where: str = "") -> list[tuple[str, Any, Any]]:
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        found = []
        for name in [*one, *(name for name in other if name not in one)]:
            inside = f"{where}.{name}" if where else str(name)
            found += diff_settings(one.get(name), other.get(name), inside)
        return found
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        one, other = list(one), list(other)
    return [] if one == other else [(where, one, other)]


def format_card_diff(card: Any, here: Any, where: str = "") -> list[str]:
    return [
        f"{name}: {a!r} on the card, {b!r} here" for name, a, b in diff_settings(card, here, where)
    ]
