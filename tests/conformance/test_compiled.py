"""What is compiled stands where the cache is named by the sources that it comes from."""

from __future__ import annotations

import ast
from pathlib import Path

from spoofgym.core.compile import COMPILED_LAYERS, find_layer
from spoofgym.core.compile import FOUNDATION as FOUNDATION_FILES

from . import sources

PLAIN = {"core", "policies"}
"""What knows no physics, and cards and sessions of ONNX files: nothing that a kernel could take in,
but for the foundation."""
FOUNDATION = {Path(name).stem for name in FOUNDATION_FILES}
"""Modules of `core` that are in every digest."""
OF_NUMBA = {"core/compile.py", "core/simd.py"}
"""The decorator, how it compiles, and the types of vectors."""
DECORATORS = {"njit", "inline_njit", "joined"}
BRIDGES = {"envs/spoofer_binding.py"}
"""Files of compiled layers that may know of other packages, since nothing compiled imports them."""


def test_imports_are_told_by_their_absolute_names():
    path = sources.ROOT / "detectors" / "somewhere.py"
    code = (
        "import os.path\nfrom ..core.compile import njit\nfrom . import base\n"
        "from ..truth.clock import a, b"
    )
    assert list(sources.imported(ast.parse(code), path)) == [
        ("os.path", []),
        ("spoofgym.core.compile", ["njit"]),
        ("spoofgym.detectors", ["base"]),
        ("spoofgym.truth.clock", ["a", "b"]),
    ]
    outside = list(sources.imported(ast.parse("from .. import core"), path))
    assert outside == [("spoofgym", ["core"])]


def imports_of(path):
    return list(sources.imported(sources.tree_of(path), path))


def in_layer(path):
    """Place of a file's package among the layers with compiled code, None for others."""
    parts = path.relative_to(sources.ROOT).parts
    known = len(parts) > 1 and parts[0] in COMPILED_LAYERS
    return COMPILED_LAYERS.index(parts[0]) if known else None


def test_numba_is_used_by_the_one_decorator_alone():
    users = {
        sources.name_of(path)
        for path in sources.files()
        for name, _ in imports_of(path)
        if name.split(".")[0] == "numba"
    }
    assert users <= OF_NUMBA


def test_compiled_functions_stand_in_compiled_layers_and_decorators_are_bare():
    """``@njit(...)`` would have settings of its own, and a use by module or alias be hidden."""
    for path in sources.files():
        where, text = sources.name_of(path), path.read_text().replace("spoofgym.core.compile", "")
        takes = {
            name
            for module, names in imports_of(path)
            if module == "spoofgym.core.compile"
            for name in names
        }
        assert not any(f"compile.{name}" in text for name in DECORATORS), where
        if where != "core/compile.py" and DECORATORS & takes:
            assert in_layer(path) is not None, f"{where}: add its package to COMPILED_LAYERS"
            assert takes <= DECORATORS, where
        for node in ast.walk(sources.tree_of(path)):
            for decorator in getattr(node, "decorator_list", ()):
                called = isinstance(decorator, ast.Call) and ast.unparse(decorator.func)
                assert called not in DECORATORS, (where, node.name)


def test_compiled_layers_import_only_from_those_whose_sources_count():
    """A constant or a function of a layer that isn't in the digest would go stale."""
    for path in sources.files():
        where, layer = sources.name_of(path), in_layer(path)
        if layer is None:
            continue
        counted = {*PLAIN, *FOUNDATION, *COMPILED_LAYERS[: layer + 1]}
        for module, names in imports_of(path):
            package = module.split(".")
            if package[0] == "spoofgym" and where not in BRIDGES:
                assert {*(package[1:2] or names)} <= counted, (where, module)
            for bridge in BRIDGES if path.name != "__init__.py" else ():
                room, name = bridge.removesuffix(".py").split("/")
                assert module != f"spoofgym.{room}.{name}", where
                assert module != f"spoofgym.{room}" or name not in names, where


def test_no_layer_reaches_for_threads_of_its_own():
    """After a parallel region of GNU OpenMP, a forked child dies."""
    assert [path for path in sources.files() if "prange" in path.read_text()] == []


def test_every_layer_is_a_package_in_the_order_of_the_imports():
    for package in COMPILED_LAYERS:
        assert (sources.ROOT / package / "__init__.py").is_file()
    assert [find_layer(f"spoofgym.{package}.x") for package in COMPILED_LAYERS] == list(
        range(len(COMPILED_LAYERS))
    )
