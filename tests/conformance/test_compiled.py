"""What is compiled stands where the cache is named by the sources that it comes from."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from spoofgym.core.compile import COMPILED_LAYERS, layer_of
from spoofgym.core.compile import FOUNDATION as FOUNDATION_FILES

from . import sources

PLAIN = {"core", "policies"}
"""What knows no physics, and cards and sessions of ONNX files: nothing that a kernel could take in,
but for the foundation."""
FOUNDATION = {Path(name).stem for name in FOUNDATION_FILES}
"""Modules of `core` that are in every digest."""
OF_NUMBA = {"core/compile.py", "core/simd.py"}
"""The decorator, how it compiles, and the types of vectors."""
BRIDGES = {"envs/spoofer_binding.py": ("spoofgym.envs", "spoofer_binding")}
"""Files of compiled layers that may know of other packages, since nothing compiled imports them."""


@pytest.fixture(params=sources.files(), ids=sources.name_of)
def source(request):
    return request.param


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


def test_numba_is_used_by_the_one_decorator_alone(source):
    tree = sources.tree_of(source)
    used = [name for name, _ in sources.imported(tree, source) if name.split(".")[0] == "numba"]
    assert sources.name_of(source) in OF_NUMBA or not used


def test_compiled_functions_stand_in_compiled_layers(source):
    tree = sources.tree_of(source)
    parts = source.relative_to(sources.ROOT).parts
    takes = [
        (module, names)
        for module, names in sources.imported(tree, source)
        if module == "spoofgym.core.compile"
    ]
    decorators = {"njit", "inlined", "joined"}
    for name in decorators:
        assert f"compile.{name}" not in source.read_text().replace("spoofgym.core.compile", ""), (
            "by its name"
        )
    if parts == ("core", "compile.py") or not any(decorators & set(names) for _, names in takes):
        return
    assert len(parts) > 1, "only packages are compiled"
    assert parts[0] in COMPILED_LAYERS, f"{parts[0]} must be named in `compile.COMPILED_LAYERS`"
    for module, names in takes:
        assert module == "spoofgym.core.compile", (
            "import the decorator itself, so that its use shows"
        )
        assert set(names) <= decorators


def test_decorators_are_bare(source):
    """``@njit(...)`` would have settings of its own."""
    tree = sources.tree_of(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            for decorator in node.decorator_list:
                called = isinstance(decorator, ast.Call) and ast.unparse(decorator.func)
                assert called not in {"njit", "inlined", "joined"}, node.name


def test_compiled_layers_import_only_from_those_whose_sources_count(source):
    """A constant or a function of a layer that isn't in the digest would go stale."""
    parts = source.relative_to(sources.ROOT).parts
    if len(parts) < 2 or parts[0] not in COMPILED_LAYERS or sources.name_of(source) in BRIDGES:
        return
    counted = COMPILED_LAYERS[: COMPILED_LAYERS.index(parts[0]) + 1]
    tree = sources.tree_of(source)
    for module, names in sources.imported(tree, source):
        path = module.split(".")
        if path[0] != "spoofgym":
            continue
        for package in path[1:2] or names:
            assert package in PLAIN | FOUNDATION or package in counted, (
                f"{package} is not in its digest"
            )


def test_no_module_of_a_compiled_layer_imports_a_bridge(source):
    parts = source.relative_to(sources.ROOT).parts
    if parts[0] not in COMPILED_LAYERS or source.name == "__init__.py":
        return
    for module, names in sources.imported(sources.tree_of(source), source):
        for package, bridge in BRIDGES.values():
            assert module != f"{package}.{bridge}"
            assert module != package or bridge not in names


def test_no_layer_reaches_for_threads_of_its_own(source):
    """After a parallel region of GNU OpenMP, a forked child dies."""
    assert "prange" not in source.read_text()


def test_every_layer_is_a_package_in_the_order_of_the_imports():
    for package in COMPILED_LAYERS:
        assert (sources.ROOT / package / "__init__.py").is_file()
    assert [layer_of(f"spoofgym.{package}.x") for package in COMPILED_LAYERS] == list(
        range(len(COMPILED_LAYERS))
    )
